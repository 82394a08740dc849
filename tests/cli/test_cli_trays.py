"""Trays of several specimens, from the photograph to the table, as it is typed."""

import json
import re

import numpy as np
import pandas as pd
import pytest

from liaam.datasets import Sample
from liaam.io import Landmarks, read_image, write_image
from liaam.training import train
from scenes.tray import NAMES, draw_leaf_on_paper, draw_tray, random_leaf

pytest.importorskip("zxingcpp")

TEXTS = ("HB-17", "HB-4", "HB-230", "HB-88", "HB-9", "HB-31")
PERIOD = 8.0  # pixels of a millimetre


@pytest.fixture(scope="module")
def leaf_model(trained_once, tmp_path_factory):
    """Train on twelve photographs of one leaf each."""

    def made():
        rng = np.random.default_rng(7)
        photographs = [draw_leaf_on_paper(random_leaf(rng), rng) for _ in range(12)]
        shown = [
            Sample(f"{i}", each.image, Landmarks(each.landmarks[0], names=NAMES)) for i, each in enumerate(photographs)
        ]
        return train(shown, diagonal=70, lamps=None, prior="sample", regressor=False)  # one would not be kept

    path = tmp_path_factory.mktemp("leaves") / "leaf.liaam"
    trained_once("leaves", made).save(path)
    return path


@pytest.fixture
def tray(rng, tmp_path):
    """Write a tray of six leaves with codes and a ruler, trays/tray.png."""
    drawn = draw_tray([random_leaf(rng) for _ in range(6)], rng, texts=TEXTS, ruler=PERIOD)
    (tmp_path / "trays").mkdir()
    write_image(tmp_path / "trays/tray.png", drawn.image)
    return drawn


def millimetres(tray) -> dict[str, float]:
    """Give the true length of each leaf, by its code."""
    lengths = [np.linalg.norm(marks[0] - marks[1]) / PERIOD for marks in tray.landmarks]
    return dict(zip(TEXTS, lengths, strict=True))


def assert_right(table: pd.DataFrame, truth: dict[str, float]) -> None:
    table = table[table["status"] == "converged"]  # the search may also take a label for a leaf, whose fit is lost
    assert table["specimen"].tolist() == list(truth)
    errors = table["distance_base_tip_mm"] - list(truth.values())
    assert (np.abs(errors) < 5 * table["distance_base_tip_mm_se"]).all()
    assert (table["distance_base_tip_mm_se"] < 0.1).all()


def test_from_a_tray_to_millimetres_by_codes(run, leaf_model, tray, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, _, err = run("fit", leaf_model, "trays/tray.png", "--all", "--name-by", "code", "--crops", "-o", "fits")
    assert "code" not in err
    code, _, _ = run("scale", "trays/tray.png", "--ruler", "1 mm", "-o", "scales.csv")
    assert code == 0
    measure = ("distance:base-tip", "--scale", "scales.csv", "-o", "table.csv")
    code, out, _ = run("measure", "fits", *measure)
    assert code == 0 and "specimens in mm" in out
    truth = millimetres(tray)
    in_order = {name: truth[name] for name in sorted(truth, key=lambda name: int(name[3:]))}
    assert_right(pd.read_csv("table.csv"), in_order)
    facts = json.loads((tmp_path / "fits/tray_3.json").read_text())
    assert (facts["specimen"], facts["code"], facts["object"]) == ("HB-230", "HB-230", 3)
    left, top, right, bottom = facts["crop"]
    np.testing.assert_array_equal(read_image("fits/tray_3_crop.png"), tray.image[top:bottom, left:right])
    inside = tray.landmarks[2] - (left, top)
    assert (inside > 0).all() and (inside < (right - left, bottom - top)).all()


@pytest.mark.parametrize("name", ["fits.csv", "fits.jsonl", "fits.parquet"])
def test_tables_of_batches_name_specimens(run, leaf_model, tray, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    code, _, _ = run("batch", leaf_model, "trays", "--all", "--name-by", "code", "-o", name)
    assert code == 0
    code, _, _ = run("scale", "trays/tray.png", "--ruler", "1 mm", "-o", "scales.csv")
    code, _, _ = run("measure", name, "distance:base-tip", "--scale", "scales.csv", "-o", "table.csv")
    assert code == 0
    assert_right(pd.read_csv("table.csv"), millimetres(tray))


def test_positions_name_specimens_of_all_photographs(run, leaf_model, rng, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "trays").mkdir()
    for i, turn in enumerate((0, 5)):
        drawn = draw_tray([random_leaf(rng) for _ in range(6)], rng, turn=turn)
        write_image(tmp_path / f"trays/t_{i}.png", drawn.image)
    code, _, _ = run("batch", leaf_model, "trays", "--all", "-o", "fits.csv")
    assert code == 0
    names = [f"t_{i}#{k}" for i in range(2) for k in range(1, 7)]
    assert pd.read_csv("fits.csv")["specimen"].tolist() == names
    code, _, err = run("measure", "fits.csv", "--replicates", "image", "-o", "table.csv")
    assert code == 1 and "no specimen has replicates" in err
    code, _, _ = run("measure", "fits.csv", "--replicates", "_", "-o", "table.csv")  # each place in both photographs
    error = pd.read_csv("table_replicates.csv")
    assert code == 0 and error[["specimens", "replicates"]].iloc[0].tolist() == [6, 12]


def test_photographs_with_other_counts_are_no_replicates_by_position(run, leaf_model, rng, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "trays").mkdir()
    leaves = [random_leaf(rng) for _ in range(4)]
    for i, shown in enumerate((leaves, leaves[1:])):
        drawn = draw_tray(shown, rng, columns=2, cell=(340, 240), texts=[f"L{leaves.index(leaf)}" for leaf in shown])
        write_image(tmp_path / f"trays/t_{i}.png", drawn.image)
    code, _, _ = run("batch", leaf_model, "trays", "--all", "--name-by", "code", "-o", "fits.csv")
    assert code == 0
    code, _, err = run("measure", "fits.csv", "--replicates", "code", "-o", "table.csv")
    assert code == 0
    assert "the code L1 names t_0#2, t_1#1: their positions name them" in err
    counts = pd.read_csv("table_replicates.csv").iloc[0]
    assert counts[["specimens", "replicates"]].tolist() == [4, 7] and counts["repeatability"] > 0.9
    rows = pd.read_csv("fits.csv").assign(code="")
    rows.to_csv("positions.csv", index=False)
    code, _, err = run("measure", "positions.csv", "--replicates", "_", "-o", "table.csv")
    assert code == 1 and "t_0 has 4 specimens and t_1 3, so that positions do not identify replicates" in err


def test_what_is_not_clear_is_said(run, leaf_model, rng, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    leaves = [random_leaf(rng, (150.0, 150.0)) for _ in range(3)]
    drawn = draw_tray(leaves, rng, texts=("A", "B", "A"))
    write_image(tmp_path / "t.png", drawn.image)
    _, _, err = run("fit", leaf_model, "t.png", "--all", "--name-by", "code", "-o", "o")
    assert "t.png: the code 'A' is at 2 places, so that it names no specimen" in err
    names = [json.loads((tmp_path / f"o/t_{i}.json").read_text())["specimen"] for i in (1, 2, 3)]
    assert names == ["t#1", "B", "t#3"]
    _, _, err = run("fit", leaf_model, "t.png", "--all", "--name-by", "label", "-o", "p")
    assert "t.png: 2 codes (A, B) where one names the photograph" in err
    close = draw_tray(leaves, rng, cell=(300, 78))
    write_image(tmp_path / "close.png", close.image)
    _, _, err = run("fit", leaf_model, "close.png", "--all", "-o", "q")
    assert re.search(r"close#\d and close#\d touch, or nearly: check their landmarks", err)


def test_one_specimen_is_named_by_its_label(run, leaf_model, rng, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    drawn = draw_tray([random_leaf(rng)], rng, columns=1, texts=["HB-5"])
    write_image(tmp_path / "a.png", drawn.image)
    code, _, _ = run("fit", leaf_model, "a.png", "--name-by", "code", "-o", "o", "--format", "json,tps")
    assert code == 0 and json.loads((tmp_path / "o/a.json").read_text())["specimen"] == "HB-5"
    assert "ID=HB-5" in (tmp_path / "o/a.tps").read_text()
    run("measure", "o", "-o", "table.csv")
    assert pd.read_csv("table.csv")["specimen"].tolist() == ["HB-5"]


@pytest.mark.parametrize("command", ["fit", "batch"])
def test_unknown_ways_of_naming_are_refused(run, leaf_model, tmp_path, command):
    write_image(tmp_path / "a.png", np.zeros((50, 50, 3), np.uint8))
    code, _, err = run(command, leaf_model, tmp_path / "a.png", "--name-by", "size", "-o", tmp_path / "o.csv")
    assert code == 1 and "named by position, code, label, not by 'size'" in err


def test_crops_overwrite_no_image_and_need_a_folder(run, leaf_model, tray, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_image("trays/tray_crop.png", tray.image[:40])
    code, _, err = run("fit", leaf_model, "trays/tray.png", "--crops", "-o", "trays")
    assert code == 1 and "tray_crop.png exists and is not from an earlier fit" in err
    np.testing.assert_array_equal(read_image("trays/tray_crop.png"), tray.image[:40])
    code, _, err = run("fit", leaf_model, "trays/tray.png", "--crops", "-o", "tray.pts")
    assert code == 1 and "--crops writes more; give a folder" in err


def test_crops_are_not_fitted_again(run, leaf_model, tray, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        run("fit", leaf_model, "trays", "--crops", "-o", "trays")
    assert sorted(path.name for path in (tmp_path / "trays").glob("*_crop.png")) == ["tray_crop.png"]
