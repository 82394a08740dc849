"""``liaam measure``, as it is typed."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image, TiffImagePlugin

from liaam.io import Landmarks, write_collection
from liaam.io.files import real_path
from liaam.io.fit_files import write_fit
from liaam.io.landmarks import LandmarkFile
from liaam.plotting.specimens import figure_of_specimens
from liaam.studio.folder import Folder
from liaam.studio.store import Store
from liaam.studio.template import Template

POINTS = np.array([[1.0, 2], [11, 2], [11, 22], [1, 22]])
STATE_IT = "state it, as in --scale '0.012 mm', or --scale mm for that of the files"


@pytest.fixture
def fits(tmp_path):
    """A folder of three fits, one of which is lost."""
    folder = tmp_path / "fits"
    folder.mkdir()
    for i, status in enumerate(("converged", "light unobservable", "diverged")):
        facts = {"status": status, "covariance": np.tile([1.0, 0, 1], (4, 1))}
        for suffix in (".json", ".csv"):
            write_fit(folder / f"wing{i}{suffix}", Landmarks(POINTS), facts, (30, 40))
    return folder


def test_fits_are_measured(run, fits, tmp_path):
    table = tmp_path / "table.csv"
    code, out, err = run("measure", fits, "distance:1-2", "area:1-2-3-4", "-o", table, "--scale", 0.5)
    assert (code, out) == (0, f"{table}: 3 specimens (the scale has no unit: {STATE_IT})\n")
    assert err.startswith("1 of 3 have no shape")
    assert "wing2" in err
    read = pd.read_csv(table)
    assert read["specimen"].tolist() == ["wing0", "wing1", "wing2"]
    np.testing.assert_allclose(read["distance_1_2"], [5, 5, np.nan])
    np.testing.assert_allclose(read["distance_1_2_se"], [0.5**0.5, 0.5**0.5, np.nan])
    np.testing.assert_allclose(read["area_1_2_3_4"], [50, 50, np.nan])


def test_scale_of_tps_is_used(run, tmp_path):
    marks = {f"{i}.png": Landmarks(POINTS, scale=0.1) for i in range(3)}
    write_collection(tmp_path / "all.tps", marks, dict.fromkeys(marks, (30, 40)))
    code, out, err = run("measure", tmp_path / "all.tps", "distance:1-2", "-o", tmp_path / "t.csv")
    assert (code, err) == (0, "")
    assert "pixels" not in out
    read = pd.read_csv(tmp_path / "t.csv")
    np.testing.assert_allclose(read["distance_1_2"], 1)
    assert not [name for name in read if name.endswith("_se")]


def test_curves_are_resampled_and_slid(run, tmp_path):
    def record(i, n):
        line = "\n".join(f"{j} {(2 + i) * np.sin(np.pi * j / n)}" for j in range(n + 1))
        return f"LM=1\n5 -{3 + i}\nCURVES=1\nPOINTS={n + 1}\n{line}\nIMAGE={i}.png\n"

    (tmp_path / "a.tps").write_text("".join(record(i, 8 + 3 * i) for i in range(4)))
    given = ("measure", tmp_path / "a.tps", "distance:1-2", "-o", tmp_path / "t.csv")
    tables = []
    for more in ((), ("--slide", "bending"), ("--slide", "procrustes")):
        code, _, err = run(*given, "--resample", "7", *more)
        assert (code, err) == (0, "")
        tables.append(pd.read_csv(tmp_path / "t.csv"))
    assert all(len(table) == 4 and "X8" in table and "X9" not in table for table in tables)
    np.testing.assert_allclose(tables[1]["distance_1_2"], tables[0]["distance_1_2"])  # ends stay
    assert not np.allclose(tables[1]["X5"], tables[0]["X5"])
    assert not np.allclose(tables[2]["X5"], tables[1]["X5"])
    for more, words in (
        (("--resample", "x"), "curves of x points: give 3 to 1000"),
        (("--slide", "x"), "slide by 'x'"),
    ):
        code, _, err = run(*given, *more)
        assert code == 1 and words in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["1-2"], "measure '1-2': give distance:1-5"),
        (["distance:1-9"], "there is no landmark '9'; give numbers from 1 to 4"),
        (["--scale", "5 apples"], "scale '5 apples': give the length of a pixel"),
        (["-o", "t.txt"], "give a name that ends in .csv"),
        (["-o", "fits/wing0.csv"], "is an input, or a file in it"),
        (["-o", "no/t.csv"], "cannot be written"),
    ],
)
def test_wrong_input_is_one_line(run, fits, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    before = (fits / "wing0.csv").read_bytes()
    output = [] if "-o" in arguments else ["-o", "t.csv"]
    code, _, err = run("measure", fits, *arguments, *output)
    assert code == 1
    assert words in " ".join(err.split())
    assert "Traceback" not in err
    assert not (tmp_path / "t.csv").exists()
    assert (fits / "wing0.csv").read_bytes() == before


def test_pixels_are_named(run, fits, tmp_path):
    _, out, _ = run("measure", fits, "-o", tmp_path / "t.csv")
    assert "3 specimens in pixels (give --scale for other units)" in out


@pytest.mark.parametrize(("count", "suffix"), [(1, ".svg"), (5, ".png"), (70, ".pdf")])
def test_shapes_are_drawn(run, tmp_path, rng, count, suffix):
    marks = {f"$wing{i}.png": Landmarks(POINTS + rng.normal(size=(4, 2))) for i in range(count)}
    write_collection(tmp_path / "all.csv", marks)
    figure = tmp_path / f"shapes{suffix}"
    code, out, _ = run("measure", tmp_path / "all.csv", "-o", tmp_path / "t.csv", "--plot", figure)
    assert code == 0 and out.endswith(f"{figure}: shapes\n")
    assert figure.stat().st_size > 1000


def test_landmarks_in_figures_have_the_numbers_of_the_table():
    columns = {"specimen": ["a", "b"], "X3": [0.0, 0.1], "Y3": [0.0, 0.0], "X4": [1.0, 1.0], "Y4": [1.0, 0.9]}
    shapes = figure_of_specimens(columns).axes[0]  # of landmarks 1 and 2, the ends of a scale bar, there is no shape
    assert [text.get_text() for text in shapes.texts] == ["3", "4"]


def test_figures_that_cannot_be_drawn_are_refused(run, tmp_path):
    marks = {f"{i}.png": Landmarks([[1, 2], [np.nan, np.nan], [5, 6]]) for i in range(3)}
    write_collection(tmp_path / "all.csv", marks)
    given = ("measure", tmp_path / "all.csv", "-o", tmp_path / "t.csv", "--plot")
    for name, words in (("a.txt", "written as .png, .pdf or .svg"), ("a.png", "no specimen has a shape to draw")):
        code, _, err = run(*given, tmp_path / name)
        assert code == 1 and words in err
        assert not (tmp_path / name).exists()


FACE = np.array([[-30.0, 20], [30, 20], [-40, -25], [40, -25], [0, 45], [0, -50]]) + 100
FACE_NAMES = ("left_eye", "right_eye", "left_jaw", "right_jaw", "top", "chin")


@pytest.fixture
def wings(tmp_path, rng) -> Path:
    """A table of left and right wings of six flies, digitised twice."""
    shape = FACE + np.array([[0, 5], [9, 0], [0, 0], [4, 7], [0, 0], [3, 3]])
    marks = {}
    for fly in range(6):
        own = shape + rng.normal(0, 3, (6, 2))
        for side, sign in (("left", -1), ("right", 1)):
            of_side = own + rng.normal(0, 1, (6, 2))
            for record in (1, 2):
                points = (of_side + rng.normal(0, 0.2, (6, 2))) * [sign, 1] + [200, 0]
                marks[f"fly{fly}_{side}_{record}.png"] = Landmarks(points)
    write_collection(tmp_path / "wings.csv", marks)
    return tmp_path / "wings.csv"


def test_sides_are_reflected_and_said(run, wings, tmp_path):
    code, out, err = run("measure", wings, "-o", tmp_path / "t.csv")
    assert (code, err) == (0, "")
    # Without --replicates, records are specimens of their own, whose names still tell the side.
    assert "12 left specimens were reflected, to be compared with the right ones" in out
    table = pd.read_csv(tmp_path / "t.csv")
    assert table["side"].tolist() == ["left", "left", "right", "right"] * 6
    assert table.filter(regex=r"^[XY]\d+$").to_numpy().std(axis=0).max() < 0.1
    code, out, _ = run("measure", wings, "-o", tmp_path / "t.csv", "--side", "ignore")
    assert code == 0 and "specimens were reflected" not in out
    unreflected = pd.read_csv(tmp_path / "t.csv")
    assert "side" not in unreflected
    assert unreflected.filter(regex=r"^[XY]\d+$").to_numpy().std(axis=0).max() > 0.2


GUIDE = Path(__file__).parents[2] / "docs" / "how-to" / "measure-specimens.md"


def test_a_table_of_ones_own_tells_individuals_sides_and_groups_of_a_folder_of_fits(run, tmp_path, rng, monkeypatch):
    folder = tmp_path / "fits"
    folder.mkdir()
    wing = np.array([[0.0, 0], [90, 20], [200, 30], [240, 80], [150, 110], [30, 50]])
    rows = ["photo;individual;side;sex"]
    for i in range(8):
        own = wing + rng.normal(0, 3, wing.shape)
        for j, side in enumerate(("left", "right")):
            points = own * [1 - 2 * (side == "left"), 1] + [300, 50] + rng.normal(0, 0.5, wing.shape)
            name = f"IMG_{2 * i + j}"
            facts = {"status": "converged", "covariance": np.tile([1.0, 0, 1], (6, 1)), "image": f"{name}.JPG"}
            write_fit(folder / f"{name}.json", Landmarks(points), facts, (200, 600))
            rows.append(f"{name}.JPG;F{i};{side};{'mf'[i % 2]}")
    (tmp_path / "own.csv").write_text("\n".join([*rows, "none.JPG;F9;left;m"]))
    given = ("measure", folder, "--specimens", tmp_path / "own.csv", "-o", tmp_path / "t.csv")
    code, out, err = run(*given, "--groups", "sex", "--symmetry", "matching", "--permutations", 9)
    assert (code, err) == (0, "") and "variance of shape of 16 specimens of 8 individuals" in out
    assert "own.csv: 1 row of no specimen: none.JPG\n" in out
    assert "own.csv: read photo, individual, side, sex\n" in out and "are compared by specimens" not in out
    table = pd.read_csv(tmp_path / "t.csv")
    assert table["individual"].tolist()[:3] == ["F0", "F0", "F1"] and table["sex"].tolist() == [*"mmff"] * 4
    assert table["side"].tolist() == ["left", "right"] * 8
    assert pd.read_csv(tmp_path / "t_asymmetry.csv")["individual"].tolist() == [f"F{i}" for i in range(8)]
    code, _, err = run(*given, "--groups", "age")
    assert code == 1 and "has no column 'age': it has photo, individual, side, sex" in err
    code, _, err = run("measure", folder, "-o", tmp_path / "t.csv", "--groups", "sex")
    assert code == 1 and "if sex is a column of your own table, give that, too (--specimens TABLE.csv)" in " ".join(
        err.split()
    )
    (tmp_path / "own.csv").write_text("\n".join(["photo;fly;Seite;sex", *rows[1:]]))
    code, out, err = run(*given, "--groups", "sex", "--permutations", 9)
    assert (code, err) == (0, "") and "groups are compared by specimens, which are taken as independent" in out
    assert "read photo, sex; not used: fly, Seite (there is no column individual and no column side" in out
    (tmp_path / "own.csv").write_text("\n".join(["photo;fly;side;sex", *rows[1:-1], rows[-1].replace("G_15", "GG_15")]))
    code, _, err = run(*given)
    assert code == 1 and "own.csv: 1 row of no specimen: IMGG_15.JPG (is it IMG_15?)" in err
    (tmp_path / "own.csv").write_text("\n".join(["photo;fly;side;sex", *rows[1:]]))
    code, _, err = run(*given, "--symmetry", "matching")
    assert code == 1 and "own.csv does not state which left and right specimens are of one individual: " in err
    assert "it has no column individual, but photo, fly, side, sex" in err
    (tmp_path / "own.csv").write_text("\n".join(rows))
    points[1] = np.nan
    write_fit(folder / f"{name}.json", Landmarks(points), facts, (200, 600))
    monkeypatch.chdir(tmp_path)
    guide = GUIDE.read_text(encoding="utf-8")
    (command,) = re.findall(r"^`liaam (measure fits .* --specimens own\.csv .*)`", guide, re.MULTILINE)
    (example,) = (code for code in re.findall(r"^```python\n(.*?)^```$", guide, re.M | re.S) if "own.csv" in code)
    assert run(*shlex.split(command))[0] == 0
    by_command = pd.read_csv("table.csv")
    assert by_command["estimated"].dropna().tolist() == [2.0] and "distance_1_5_mm" in by_command
    exec(example, {})
    pd.testing.assert_frame_equal(pd.read_csv("table.csv"), by_command)
    (tmp_path / "own.csv").write_text("\n".join(rows[:5]))
    _, _, err = run(*given[:-1], tmp_path / "u.csv", "--side", "ignore")
    assert "12 of 16 specimens have no row in" in err
    code, _, err = run(*given[:-1], tmp_path / "own.csv")
    assert code == 1 and "own.csv is an input" in " ".join(err.split())


def test_specimens_without_a_side_are_refused_by_name(run, tmp_path):
    marks = {f"{name}.png": Landmarks(FACE) for name in ("a_left", "a_right", "stray")}
    write_collection(tmp_path / "all.csv", marks)
    code, _, err = run("measure", tmp_path / "all.csv", "-o", tmp_path / "t.csv")
    assert code == 1 and "1 of 3 specimens have no side (stray)" in err
    assert not (tmp_path / "t.csv").exists()


def test_matching_symmetry_is_printed_and_written(run, wings, tmp_path):
    given = ("measure", wings, "-o", tmp_path / "t.csv", "--symmetry", "matching", "--replicates", "_")
    code, out, err = run(*given, "--permutations", 99, "--seed", 5, "--plot", tmp_path / "t.png")
    assert (code, err) == (0, "")
    assert "error: from 2 replicates of each side" in out
    assert " records" in out.splitlines()[0]  # of fewer specimens
    assert "t.png: asymmetry" in out and (tmp_path / "t.png").stat().st_size > 1000
    anova = pd.read_csv(tmp_path / "t_anova.csv").set_index(["trait", "effect"])
    assert anova["df"].tolist() == [5, 1, 5, 12, 23] * 2
    assert anova["P"].tolist()[2] == pytest.approx(0.01)
    indices = pd.read_csv(tmp_path / "t_asymmetry.csv")
    assert indices["individual"].tolist() == [f"fly{i}" for i in range(6)]
    components = pd.read_csv(tmp_path / "t_components.csv", keep_default_na=False)
    assert components["component"].tolist().count("directional") == 2
    assert pd.read_csv(tmp_path / "t_replicates.csv")["specimens"].tolist()[0] == 12  # wings, not flies
    facts = json.loads((tmp_path / "t_asymmetry.json").read_text())
    assert (facts["seed"], facts["permutations"], facts["sides"]) == (5, 99, ["left", "right"])
    assert facts["anova"][0]["SS"] == pytest.approx(anova["SS"].iloc[0])
    assert pd.read_csv(tmp_path / "t_replicates.csv")["specimens"].iloc[0] == 12  # wings, not flies
    first = (tmp_path / "t_anova.csv").read_bytes()
    run(*given, "--permutations", 99, "--seed", 5)
    assert (tmp_path / "t_anova.csv").read_bytes() == first


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("t_replicates.csv", ("--replicates", "_")),
        ("t_anova.csv", ("--symmetry", "matching")),
        ("t_asymmetry.json", ("--symmetry", "matching")),
    ],
)
def test_tables_beside_the_output_do_not_replace_the_input(run, wings, tmp_path, name, options):
    file = wings.rename(tmp_path / name)
    before = file.read_bytes()
    code, _, err = run("measure", file, "-o", tmp_path / "t.csv", *options)
    assert code == 1 and "is an input, or a file in it; give the output a name elsewhere" in " ".join(err.split())
    assert file.read_bytes() == before and not (tmp_path / "t.csv").exists()


def faces(rng, n: int = 6) -> dict[str, Landmarks]:
    """Return faces that differ by a pixel or two, with names of landmarks."""
    return {f"face{i}.png": Landmarks(FACE + rng.normal(0, 1.5, (6, 2)), names=FACE_NAMES) for i in range(n)}


def write_fits_of_faces(folder: Path, rng, variance: float, present: dict[int, float] | None = None) -> Path:
    """Write fits of faces to a new folder; of some, the first landmark is present with a probability only."""
    folder.mkdir()
    for i, (name, marks) in enumerate(faces(rng).items()):
        facts = {
            "status": "converged",
            "covariance": np.tile([variance, 0, variance], (6, 1)),
            "landmark_names": FACE_NAMES,
        }
        if present is not None:
            facts["present"] = [present.get(i, 1.0), *[1.0] * 5]
        write_fit(folder / name.replace(".png", ".json"), marks, facts, (300, 300))
    return folder


def test_object_symmetry_takes_pairs_from_names_and_errors_from_fits(run, tmp_path, rng):
    folder = write_fits_of_faces(tmp_path / "fits", rng, 0.09)
    given = ("measure", folder, "-o", tmp_path / "t.csv", "--symmetry", "object", "--permutations", 99)
    code, out, err = run(*given)
    assert (code, err) == (0, "")
    assert "error: expected from the covariances of the fitted landmarks, as there are no replicates" in out
    facts = json.loads((tmp_path / "t_asymmetry.json").read_text())
    assert facts["error_term"] == "covariances" and facts["twins"] == [2, 1, 4, 3, 5, 6]
    assert facts["anova"][2]["P"] == pytest.approx(0.01)
    code, out, _ = run(*given, "--pairs", "1-2")
    assert code == 0 and json.loads((tmp_path / "t_asymmetry.json").read_text())["twins"] == [2, 1, 3, 4, 5, 6]


def test_a_stated_error_beyond_the_differences_between_sides_is_reported(run, tmp_path, rng):
    folder = write_fits_of_faces(tmp_path / "fits", rng, 25.0)
    given = ("measure", folder, "-o", tmp_path / "t.csv", "--symmetry", "object", "--permutations", 99)
    code, out, err = run(*given)
    assert code == 0 and "taken as independent on both sides" in out
    told = " ".join(err.split())
    assert told.startswith("the stated error exceeds the differences between the sides (F = 0.")
    assert "place the landmarks of some individuals by hand, twice on both sides" in told
    assert json.loads((tmp_path / "t_asymmetry.json").read_text())["error_exceeds_differences"] is True


def test_object_symmetry_takes_pairs_from_the_studios_template(run, tmp_path, rng):
    folder = tmp_path / "project"
    folder.mkdir()
    marks = {name: Landmarks(each.points) for name, each in faces(rng).items()}
    write_collection(folder / "all.csv", marks)
    given = ("measure", folder, "-o", tmp_path / "t.csv", "--symmetry", "object", "--permutations", 9)
    code, _, err = run(*given)
    assert code == 1
    assert "the landmarks have no names that tell pairs" in err and "they may be 1-2,3-4" in err
    template = Template(tuple("abcdef"), mirror=(1, 0, 3, 2, 4, 5))
    store = Store(Folder(real_path(folder)))
    store.put("template", {"": template.as_json()})
    store.close()
    code, out, _ = run(*given)
    assert code == 0 and "error: unknown, so that fluctuating asymmetry is not tested" in out
    assert json.loads((tmp_path / "t_asymmetry.json").read_text())["twins"] == [2, 1, 4, 3, 5, 6]


def test_estimates_of_fits_are_named_in_tables_of_asymmetry(run, tmp_path, rng):
    folder = write_fits_of_faces(tmp_path / "fits", rng, 0.09, present={2: 0.1})
    given = ("measure", folder, "-o", tmp_path / "t.csv", "--symmetry", "object", "--permutations", 9)
    code, out, err = run(*given, "--plot", tmp_path / "t.png")
    assert code == 0 and "without 1 record with estimated landmarks" in out
    told = " ".join(err.split())
    assert "1 of 6 individuals have estimated landmarks" in told and "their asymmetry: face2; see" in told
    assert "1 specimen with estimated landmarks (see 'estimated'): face2" in told
    table = pd.read_csv(tmp_path / "t_asymmetry.csv").set_index("individual")
    assert table["estimated"].dropna().to_dict() == {"face2": FACE_NAMES[0]}


def test_missing_landmarks_are_estimated_and_named(run, tmp_path, rng):
    marks = faces(rng)
    points = marks["face2.png"].points.copy()
    points[3] = np.nan
    marks["face2.png"] = Landmarks(points, names=FACE_NAMES)
    write_collection(tmp_path / "all.csv", marks)
    given = ("measure", tmp_path / "all.csv", "distance:left_jaw,right_jaw", "-o", tmp_path / "t.csv")
    code, _, err = run(*given)
    assert code == 0 and err == "1 of 6 have no shape, because landmarks are missing: face2\n"
    for method in ("tps", "regression"):
        code, _, err = run(*given, "--estimate", method)
        told = err.splitlines()
        assert (code, told[-1]) == (0, "1 specimen with estimated landmarks (see 'estimated'): face2")
        if method == "tps":
            assert len(told) == 1
        else:  # by five specimens with five landmarks: several times the error of tps
            assert "face2: right_jaw (" in " ".join(told[:-1]) and "take --estimate tps" in " ".join(told[:-1])
        table = pd.read_csv(tmp_path / "t.csv").set_index("specimen")
        assert table["estimated"].dropna().to_dict() == {"face2": "right_jaw"}
        assert table["distance_left_jaw_right_jaw"].tolist()[2] == pytest.approx(80, abs=15)


def test_doubtful_estimates_are_reported_as_such(run, tmp_path, rng):
    shape = np.array([[0.0, 0], [30, -12], [60, -14], [80, -7], [88, 2], [78, 11], [52, 15], [28, 11], [30, 0]])
    points = 4 * (shape + rng.normal(0, 1, (24, 9, 2))) + 200
    points[5, 3:6] = np.nan
    write_collection(tmp_path / "all.csv", {f"w{i:02d}.png": Landmarks(each) for i, each in enumerate(points)})
    given = ("measure", tmp_path / "all.csv", "-o", tmp_path / "t.csv", "--estimate")
    assert "estimated far" not in run(*given, "tps")[2]
    code, _, err = run(*given, "regression")
    told = " ".join(err.split())
    assert code == 0 and "Check them; " in told and "They are in the table (--strict stops instead)" in told
    assert pd.read_csv(tmp_path / "t.csv")["estimated"].notna().sum() == 1
    assert "1 specimen with landmarks estimated far from where they lie in complete specimens" in told
    assert "w05: 4 (" in told and "take --estimate tps" in told
    (tmp_path / "t.csv").unlink()
    code, _, err = run(*given, "regression", "--strict")
    assert code == 1 and "w05: 4 (" in " ".join(err.split()) and not (tmp_path / "t.csv").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--symmetry", "both"], "symmetry 'both' is unknown: give object or matching"),
        (["--symmetry", "matching"], "(face0, face1, face2 and 3 more) have no sides: name them such as wing1_left"),
        (["--pairs", "1-2"], "give --symmetry object, too"),
        (["--symmetry", "object", "--pairs", "1-1"], "the pair 1-1 names the same landmark twice"),
        (["--symmetry", "object", "--permutations", "-5"], "-5 permutations: give 0 to 100000"),
        (["--side", "left"], "--side left: no specimen has a known side"),
        (["--estimate", "mean"], "cannot be estimated by 'mean': give tps or regression"),
    ],
)
def test_wrong_choices_are_one_line_and_write_nothing(run, tmp_path, rng, arguments, words):
    write_collection(tmp_path / "all.csv", faces(rng))
    code, _, err = run("measure", tmp_path / "all.csv", "-o", tmp_path / "t.csv", *arguments)
    assert code == 1
    assert words in " ".join(err.split())
    assert [file.name for file in tmp_path.glob("t*")] == []


def test_strict_refuses_individuals_that_would_be_left_out(run, wings, tmp_path):
    lines = wings.read_text().splitlines(keepends=True)
    wings.write_text("".join(line for line in lines if not line.startswith("fly3_left_2")))
    given = ("measure", wings, "-o", tmp_path / "t.csv", "--symmetry", "matching", "--replicates", "_")
    code, _, err = run(*given, "--permutations", 9)
    assert code == 0
    assert "fly3: it has 1 left and 2 right records with a shape, where most have 2 of each side; it is left out" in err
    code, _, err = run(*given, "--strict", "-o", tmp_path / "u.csv")
    assert code == 1 and "fly3" in err and not (tmp_path / "u.csv").exists()


def test_a_flipped_photograph_is_reported_and_not_compared(run, wings, tmp_path):
    marks = {
        name: Landmarks(each.points * [-1, 1] if "fly3_left" in name else each.points)
        for name, each in LandmarkFile.read(wings).entries.items()
    }
    write_collection(tmp_path / "flipped.csv", marks)
    given = ("measure", tmp_path / "flipped.csv", "-o", tmp_path / "t.csv", "--replicates", "_")
    code, out, err = run(*given, "--symmetry", "matching", "--permutations", 9)
    assert code == 0
    assert "2 specimens of another side than stated: fly3_left_1 (stated left, right by the shape), fly3_left_2" in out
    assert "if the photograph is flipped, flip it back" in out
    assert err == "fly3: fly3_left_1 is stated left, and is right by its landmarks; it is left out\n"
    assert len(pd.read_csv(tmp_path / "t_asymmetry.csv")) == 5
    assert (
        pd.read_csv(tmp_path / "t_replicates.csv")["specimens"].iloc[0] == 12
    )  # these are no replicates of fly3_right
    table = pd.read_csv(tmp_path / "t.csv")
    assert table["side"].tolist().count("left") == 10
    assert table.filter(regex=r"^[XY]\d+$").to_numpy().std(axis=0).max() < 0.1
    code, _, err = run(*given, "--strict", "-o", tmp_path / "u.csv")
    assert code == 1 and "of another side than stated: fly3_left_1" in err and not (tmp_path / "u.csv").exists()


def tps(path, scales):
    """Write square specimens with scales, one record each."""
    records = (
        f"LM=4\n1 2\n11 2\n11 22\n1 22\nIMAGE=w{i}.png\nID={i}\n{f'SCALE={scale}{chr(10)}' if scale else ''}"
        for i, scale in enumerate(scales)
    )
    path.write_text("".join(records))
    return path


def test_units_are_said_and_written(run, tmp_path):
    file = tps(tmp_path / "all.tps", [0.01] * 9 + [0.1])
    code, out, err = run("measure", file, "distance:1-2", "-o", tmp_path / "t.csv", "--scale", "mm")
    assert code == 0 and out == f"{tmp_path / 't.csv'}: 10 specimens in mm\n"
    assert "1 of 10 have a scale unlike the usual 0.01 mm per pixel; check it: w9 (0.1)" in " ".join(err.split())
    assert list(pd.read_csv(tmp_path / "t.csv"))[:3] == ["specimen", "scale_mm_per_px", "distance_1_2_mm"]
    file = tps(tmp_path / "some.tps", [0.01, 0, 0.01])
    code, out, err = run("measure", file, "distance:1-2", "-o", tmp_path / "t.csv", "--scale", "mm")
    assert code == 0 and "1 of 3 have no scale, so that they have no sizes: w1" in " ".join(err.split())
    file = tps(tmp_path / "none.tps", [0, 0, 0])
    code, _, err = run("measure", file, "-o", tmp_path / "none.csv", "--scale", "mm")
    assert code == 1 and "no file states a scale that could be in mm: give the length of a pixel" in " ".join(
        err.split()
    )
    assert "'liaam scale'" in err and not (tmp_path / "none.csv").exists()


def test_the_calibration_of_tiffs_is_used_and_said(run, tmp_path):
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[270] = "ImageJ=1.53t\nunit=mm\n"
    tags[282] = tags[283] = 20.0
    Image.fromarray(np.zeros((40, 30, 3), np.uint8)).save(tmp_path / "a.tif", tiffinfo=tags)
    (tmp_path / "a.csv").write_text("x,y\n1,2\n11,2\n5,9\n")
    code, out, _ = run("measure", tmp_path / "a.csv", "distance:1-2", "-o", tmp_path / "t.csv")
    assert code == 0
    assert "the scale of 1 specimen is that of ImageJ's calibration (0.05 mm per pixel)" in " ".join(out.split())
    assert pd.read_csv(tmp_path / "t.csv")["distance_1_2_mm"].tolist() == [0.5]
    tags[283] = 10.0
    Image.fromarray(np.zeros((40, 30, 3), np.uint8)).save(tmp_path / "a.tif", tiffinfo=tags)
    code, out, err = run("measure", tmp_path / "a.csv", "distance:1-2", "-o", tmp_path / "t.csv")
    assert code == 0 and "not square" in " ".join(err.split()) and "in pixels" in out


def test_a_missing_end_of_a_scale_bar_is_no_missing_shape(run, tmp_path, rng):
    bar = np.array([[0.0, 0.0], [50.0, 0.0]])
    marks = {f"{i}.png": Landmarks(np.vstack([bar, POINTS + rng.normal(size=(4, 2))])) for i in range(3)}
    bar[0] = np.nan
    marks["1.png"] = Landmarks(np.vstack([bar, POINTS]))
    write_collection(tmp_path / "all.csv", marks)
    code, out, err = run("measure", tmp_path / "all.csv", "-o", tmp_path / "t.csv", "--scale", "1-2=5 mm")
    assert "landmarks 1 and 2 are the ends of the scale, and no part of the shapes" in " ".join(out.split())
    assert code == 0 and " ".join(err.split()) == "1 of 3 have no scale, so that they have no sizes: 1"


def test_a_table_of_scales_is_used(run, tmp_path):
    file = tps(tmp_path / "all.tps", [0, 0])
    (tmp_path / "s.csv").write_text(
        "image,scale,unit,scale_se,how\nw0.png,0.1,mm,0.001,a ruler in the image\nw1.png,,,,\n"
    )
    code, out, err = run("measure", file, "distance:1-2", "-o", tmp_path / "t.csv", "--scale", tmp_path / "s.csv")
    assert code == 0 and "a ruler in the image (0.1 mm per pixel)" in " ".join(out.split())
    table = pd.read_csv(tmp_path / "t.csv")
    assert table["distance_1_2_mm"].tolist()[0] == pytest.approx(1) and np.isnan(table["distance_1_2_mm"][1])
    assert table["scale_mm_per_px_se"][0] == 0.001
    assert "1 of 2 have no scale" in " ".join(err.split())
    (tmp_path / "s.csv").write_text("specimen,scale,unit\nw0,100,um\nw1,0.05,mm\n")
    code, out, _ = run("measure", file, "-o", tmp_path / "t.csv", "--scale", tmp_path / "s.csv")
    assert code == 0 and "the scale of 2 specimens is that of the table of scales (0.05 mm to 100 um per pixel)" in out


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("s.csv", ("--scale", "s.csv")),
        ("t_groups.csv", ("--groups", "t_groups.csv")),
        ("t_anova.csv", ("--symmetry", "object", "--pairs", "t_anova.csv")),
        ("mine/t.csv", ("--compare", "mine")),
    ],
)
def test_what_options_name_is_not_overwritten(run, tmp_path, monkeypatch, name, options):
    monkeypatch.chdir(tmp_path)
    tps(tmp_path / "all.tps", [0, 0])
    Path(name).parent.mkdir(exist_ok=True)
    Path(name).write_text("a person's work")
    output = "t.csv" if name.startswith("t_") else name
    code, _, err = run("measure", "all.tps", "-o", output, *options)
    assert code == 1 and f"{name} is an input, or a file in it; give the output a name elsewhere" in " ".join(
        err.split()
    )
    assert Path(name).read_text() == "a person's work"


def test_the_agreement_with_people_and_the_variance_of_groups_are_written(run, tmp_path, rng):
    folder = tmp_path / "fits"
    folder.mkdir()
    shapes = POINTS + rng.normal(0, 1.0, (12, 4, 2))
    shapes[::2, 0] -= 2.0
    for i, points in enumerate(shapes):
        facts = {"status": "converged", "covariance": np.tile([0.04, 0, 0.04], (4, 1))}
        write_fit(folder / f"wing{i}.json", Landmarks(points), facts, (30, 40))
    for name in ("first", "second"):
        marks = {f"wing{i}.png": Landmarks(points + rng.normal(0, 0.3, (4, 2))) for i, points in enumerate(shapes)}
        write_collection(tmp_path / f"{name}.csv", marks, dict.fromkeys(marks, (30, 40)))
    groups = tmp_path / "groups.csv"
    groups.write_text("specimen,group\n" + "".join(f"wing{i},{'ab'[i % 2]}\n" for i in range(12)), encoding="utf-8")
    options = ("--compare", tmp_path / "first.csv", "--compare", tmp_path / "second.csv", "--groups", groups)
    code, out, err = run("measure", folder, "-o", tmp_path / "t.csv", *options)
    assert code == 0, err
    assert "of the shapes of two people" in out and "for the section Methods of a paper: " in out
    assert "a – b: means" in out and "reliability ratio" in out
    sizes = r"centroid_size: a \d\S* \(n 6\), b \d\S* \(n 6\); difference between the means: P = \S+"
    assert re.search(sizes, " ".join(out.split()))
    agreement = json.loads((tmp_path / "t_agreement.json").read_text())
    assert agreement["n_specimens"] == 12 and 0.8 < agreement["slope"] < 1.2
    table = pd.read_csv(tmp_path / "t.csv")
    assert table["group"].tolist() == ["a", "b"] * 6 and "individual" not in table
    scores = pd.read_csv(tmp_path / "t_scores.csv")
    assert scores["group"].tolist() == ["a", "b"] * 6 and (scores["PC1_se"] > 0).all()
    assert len(pd.read_csv(tmp_path / "t_groups.csv")) == 2 * 4
    assert json.loads((tmp_path / "t_variation.json").read_text())["tests"][0]["specimens"] == 12
    assert (tmp_path / "t_agreement.png").exists() and len(pd.read_csv(tmp_path / "t_bias.csv")) == 4
    assert "absent landmarks" not in err
    code, _, err = run("measure", folder, "-o", tmp_path / "u.csv", "--compare", folder)
    assert code == 1 and "the landmarks by hand are copies of the automatic landmarks (12 of 12 specimens)" in err
    assert not (tmp_path / "u.csv").exists()
    shapes[0, 2] = np.nan
    write_fit(folder / "wing0.json", Landmarks(shapes[0]), facts, (30, 40))
    for more in ((), ("--estimate", "tps")):
        _, out, err = run("measure", folder, "-o", tmp_path / "v.csv", "--compare", tmp_path / "first.csv", *more)
        assert "1 fit with absent landmarks left out of the comparison with people's landmarks: wing0; " in err
        assert "shapes of 11 specimens (1 left out, which lack landmarks)" in out
