"""``liaam scale``, as it is typed, and its table in ``liaam measure``."""

import numpy as np
import pandas as pd
import pytest
from PIL import Image, TiffImagePlugin

from liaam.drawing import LOST, rgb
from liaam.io import Landmarks, read_image, write_collection, write_image
from liaam.morphometry import of_one_side, read_specimens
from scenes.ruler import draw

MARKS = np.array([[1.0, 2.0], [11.0, 2.0], [5.0, 9.0]])


@pytest.fixture
def images(tmp_path, rng):
    """Two images with a ruler of 10 pixels per millimetre, and one without."""
    for name, kind in (("a", "plain"), ("b", "hierarchical"), ("c", "none")):
        scene = draw(kind, rng, size=None if kind == "none" else 10.0, angle=4.0)
        write_image(tmp_path / f"{name}.png", scene.image)
        (tmp_path / f"{name}.csv").write_text("x,y\n1,2\n101,2\n50,90\n")
    return tmp_path


def test_rulers_from_the_photograph_to_the_table(run, images):
    files = [images / f"{name}.png" for name in "abc"]
    code, out, err = run("scale", *files, "--ruler", "1 mm", "-o", images / "s.csv")
    assert code == 0 and "the scale of 2 of 3 images" in " ".join(out.split())
    assert "c.png: no ruler with 10 even ticks" in " ".join(err.split())
    table = pd.read_csv(images / "s.csv")
    assert table["scale"][:2].tolist() == pytest.approx([0.1, 0.1], rel=1e-3) and np.isnan(table["scale"][2])
    assert table["unit"][0] == "mm" and 0 < table["scale_se"][0] < 1e-4
    assert sorted(path.name for path in (images / "s").iterdir()) == ["a_scale.png", "b_scale.png"]
    drawn = read_image(images / "s/a_scale.png")
    assert (np.abs(drawn.astype(int) - rgb(LOST)).max(axis=2) < 60).any()  # marks at the ticks
    for name in "abc":
        (images / f"{name}.png").rename(images / f"{name}.off")
    (images / "m").mkdir()
    for name in "abc":
        (images / f"{name}.csv").rename(images / "m" / f"{name}.csv")
    given = ("measure", images / "m", "distance:1-2", "--scale", images / "s.csv", "-o", images / "t.csv")
    code, out, err = run(*given)
    assert code == 0 and "3 specimens in mm" in out
    measured = pd.read_csv(images / "t.csv")
    assert measured["distance_1_2_mm"].tolist()[:2] == pytest.approx([10, 10], rel=1e-3)
    assert np.isnan(measured["distance_1_2_mm"][2]) and measured["scale_mm_per_px_se"][0] > 0


def test_wings_in_folders_of_sides_have_scales_of_their_own(run, tmp_path):
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[270] = "ImageJ=1.53t\nunit=mm\n"
    files = []
    for side, per_unit in (("left", 20.0), ("right", 10.0)):
        (tmp_path / side).mkdir()
        tags[282] = tags[283] = per_unit
        for name in "ab":
            files.append(tmp_path / side / f"{name}.tif")
            Image.fromarray(np.zeros((40, 30, 3), np.uint8)).save(files[-1], tiffinfo=tags)
    code, _, _ = run("scale", *files, "-o", tmp_path / "s.csv")
    assert code == 0
    marks = {f"{side}/{name}.tif": Landmarks(MARKS) for side in ("left", "right") for name in "ab"}
    (tmp_path / "m").mkdir()
    write_collection(tmp_path / "m" / "all.csv", marks)
    given = ("measure", tmp_path / "m" / "all.csv", "distance:1-2", "--scale", tmp_path / "s.csv")
    code, _, err = run(*given, "-o", tmp_path / "t.csv")
    assert (code, err) == (0, "")
    assert pd.read_csv(tmp_path / "t.csv")["distance_1_2_mm"].tolist() == pytest.approx([0.5, 0.5, 1.0, 1.0])


def test_fits_of_images_in_folders_of_sides_have_scales_of_their_own(run, model_file, scenes, tmp_path):
    for side, scene in (("left", scenes[0]), ("right", scenes[1])):
        (tmp_path / "new" / side).mkdir(parents=True)
        write_image(tmp_path / "new" / side / "a.png", (255 * scene.image.clip(0, 1)).astype(np.uint8))
    run("fit", model_file, f"{tmp_path}/new/**", "-m", "igo", "-o", tmp_path / "fits")
    assert sorted(path.name for path in (tmp_path / "fits").glob("*.json")) == ["left_a.json", "right_a.json"]
    (tmp_path / "s.csv").write_text("image,scale,unit\nleft/a.png,0.5,mm\nright/a.png,0.25,mm\n")
    given = (
        "measure",
        tmp_path / "fits",
        "--scale",
        tmp_path / "s.csv",
        "--side",
        "reflected",
        "-o",
        tmp_path / "t.csv",
    )
    code, _, err = run(*given)
    assert code == 0 and "may be of the images" not in err
    measured = pd.read_csv(tmp_path / "t.csv")
    assert measured["scale_mm_per_px"].tolist() == [0.5, 0.25]
    specimens, _ = of_one_side(read_specimens(tmp_path / "fits"))
    assert [(each.individual, each.side) for each in specimens] == [("a", "left"), ("a", "right")]


@pytest.mark.parametrize("command", ["fit", "batch"])
def test_scales_of_one_folder_are_not_those_of_another(run, model_file, scenes, tmp_path, command):
    folder = tmp_path / "mag"
    for name, scene in (("a", scenes[0]), ("b", scenes[1])):
        (folder / name).mkdir(parents=True)
        scene = (255 * scene.image.clip(0, 1)).astype(np.uint8)
        Image.fromarray(scene).save(
            folder / name / "fly.tif", tiffinfo={270: "ImageJ=1.53t\nunit=mm\n", 282: 20.0, 283: 20.0}
        )
    assert run("scale", folder / "a", "-o", tmp_path / "a.csv")[0] == 0

    def measured(images, name):
        output = tmp_path / f"{name}{'' if command == 'fit' else '.csv'}"
        run(command, model_file, images, "-m", "igo", "-o", output)
        given = ("measure", output, "--scale", tmp_path / "a.csv", "--side", "ignore", "-o", tmp_path / "t.csv")
        code, _, err = run(*given)
        return code, " ".join(err.split())

    assert measured(folder / "a", "fits_a")[0] == 0
    code, err = measured(folder / "b", "fits_b")
    assert code == 1 and "fly.tif in the table of scales is another image than that of specimen fly: run" in err
    code, err = measured(folder, "fits")
    assert code == 1 and "fly.tif in the table of scales is another image than that of specimen b" in err


def test_a_folder_stands_for_its_images(run, images, tmp_path):
    (images / "more").mkdir()
    (images / "b.png").rename(images / "more" / "b.png")
    code, _, _ = run("scale", images, "--ruler", "1 mm", "-o", tmp_path / "s.csv")
    assert code == 0
    assert pd.read_csv(tmp_path / "s.csv")["image"].tolist() == ["a.png", "c.png", "b.png"]
    code, _, _ = run("scale", f"{images}/more/**", "--ruler", "1 mm", "-o", tmp_path / "t.csv")
    assert code == 0
    assert pd.read_csv(tmp_path / "t.csv")["image"].tolist() == ["b.png"]


def test_a_table_that_exists_is_completed(run, images, tmp_path):
    table = tmp_path / "s.csv"
    assert run("scale", images / "a.png", "--ruler", "1 mm", "-o", table)[0] == 0
    by_hand = "image,scale,unit,scale_se,how,message,fingerprint,note\nc.png,0.2,mm,,,,,lens B\n"
    table.write_text(by_hand + "".join(f"{line},\n" for line in table.read_text().splitlines()[1:]))
    found = pd.read_csv(table)["scale"].tolist()
    code, out, _ = run("scale", images / "b.png", images / "c.png", "--ruler", "1 mm", "-o", table)
    assert code == 0 and "1 line of other images stay" in " ".join(out.split())
    assert "by hand or as no scale is found now: c.png" in " ".join(out.split())
    completed = pd.read_csv(table)
    assert completed["image"].tolist() == ["c.png", "a.png", "b.png"] and completed["note"][0] == "lens B"
    assert completed["scale"][:2].tolist() == found and completed["scale"][2] == pytest.approx(0.1, rel=1e-3)
    code, _, _ = run("scale", images / "a.png", images / "b.png", "--ruler", "7 mm", "-o", table)
    assert code == 0 and pd.read_csv(table)["scale"][1] == pytest.approx(0.7, rel=1e-3)  # found anew
    (tmp_path / "other.csv").write_text("x,y\n1,2\n")
    code, _, err = run("scale", images / "a.png", "--ruler", "1 mm", "-o", tmp_path / "other.csv")
    assert code == 1 and "exists, and cannot be completed" in " ".join(err.split())


def test_bars_are_found_too(run, tmp_path, rng):
    write_image(tmp_path / "a.png", draw("black", rng, size=200.0).image)
    code, _, _ = run("scale", tmp_path / "a.png", "--scale-bar", "5mm", "-o", tmp_path / "s.csv")
    assert code == 0
    assert pd.read_csv(tmp_path / "s.csv")["scale"].tolist() == pytest.approx([0.025], rel=2e-3)


@pytest.mark.parametrize("how", [[], ["--ruler", "1 mm"]])
def test_a_missing_file_is_named_once(run, tmp_path, monkeypatch, how):
    monkeypatch.chdir(tmp_path)
    code, _, err = run("scale", "x.png", "y.tif", *how)
    assert code == 1
    assert err.count("x.png") == 1 and "x.png: does not exist" in err
    assert err.count("y.tif") == 1 and "y.tif: does not exist" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--ruler", "1"], "--ruler 1: give the unit, too, such as '1 mm'"),
        (["--ruler", "x"], "length 'x': give a positive number and its unit"),
        (["--ruler", "1 mm", "--scale-bar", "1 mm"], "give one of them"),
        (["-o", "s.txt"], "give a name that ends in .csv"),
        ([], "a.png: no tag states the scale: give --ruler or --scale-bar"),
        (["--ruler", "1 mm"], "a.png: no ruler with 10 even ticks"),
        (["--scale-bar", "1 mm"], "a.png: no even, straight stroke"),
    ],
)
def test_what_cannot_be_done_is_one_line(run, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    write_image(tmp_path / "a.png", np.zeros((120, 120, 3), np.uint8))
    code, out, err = run("scale", tmp_path / "a.png", *arguments)
    assert code == 1 and words in " ".join(err.split())
    assert not out
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
