"""The command line as a person types it."""

import errno
import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from liaam.cli.fit import Outputs
from liaam.cli.inputs import names_in_folders, unique_stems
from liaam.cli.train import parse_contour
from liaam.errors import LiaamError
from liaam.io import read_image, read_landmarks, write_image, write_landmarks
from liaam.model import load_model
from liaam.morphometry import read_specimens
from scenes import Head, lateral, make_set, render

PLAIN = ("--diagonal", 40, "--copies", 0, "--lamps", "none")
"""Options of a training that has little to do before it comes to the textures."""


@pytest.fixture(scope="module")
def portraits(tmp_path_factory):
    """A folder of landmarked portraits, a differently lit picture, and its truth."""
    folder = tmp_path_factory.mktemp("portraits")
    for i, scene in enumerate(make_set(6, head=Head(5), size=(160, 120))):
        write_image(folder / f"face{i}.png", scene.image)
        write_landmarks(folder / f"face{i}.pts", scene.landmarks)
    scene = render(Head(5), lights=lateral("left"), size=(160, 120))
    aside = tmp_path_factory.mktemp("aside")
    write_image(aside / "new.png", scene.image)
    write_landmarks(aside / "truth.pts", scene.landmarks)
    return folder, aside / "new.png", aside / "truth.pts"


def test_compact_writes_a_small_model_and_says_what_it_fits_with(run, model_file, portraits, tmp_path):
    small = tmp_path / "small.liaam"
    code, out, _ = run("compact", model_file, "-o", small)
    assert code == 0 and "MB instead of" in out and out.strip().endswith("fits with soft-li")
    assert small.stat().st_size < 0.6 * model_file.stat().st_size
    init = portraits[2]
    assert run("fit", small, portraits[1], "--init", init, "-o", tmp_path)[0] == 0
    code, _, err = run("fit", small, portraits[1], "--init", init, "-o", tmp_path, "-m", "grey")
    assert code == 1 and "method grey: the model was trained for soft-li; train it again with '--methods grey'" in err
    out = run("compact", model_file, "-o", small, "--methods", "grey, igo")[1]
    assert "fits with soft-li, grey, rgb, grey-plain, grey-norm, igo" in out
    assert "grey-norm" in run("show", small)[1]


def test_a_card_is_written_into_the_model_and_shown(run, model_file, tmp_path):
    model = tmp_path / "m.liaam"
    model.write_bytes(model_file.read_bytes())
    code, out, _ = run("card", model, "--licence", "CC BY 4.0", "--data", "six heads of one person")
    assert code == 0 and "not stated  purpose, limits, credit (add them with 'liaam card')" in out
    assert run("card", model, "--credit", "the makers", "--data", "")[0] == 0
    shown = run("show", model, "-o", tmp_path / "m.json")[1]
    card = json.loads((tmp_path / "m.json").read_text())["card"]
    assert {**card, "accuracy": ""} == {"licence": "CC BY 4.0", "credit": "the makers", "accuracy": ""}
    assert all(text in shown for text in card.values())
    code, _, err = run("card", "face", "--licence", "mine")
    assert code == 1 and "face comes with liaam, and its card stays as it is" in err


def box_around(points):
    return ",".join(f"{v:.0f}" for v in [*points.min(0) - 3, *points.max(0) + 3])


def test_train_and_show(run, portraits, tmp_path):
    model = tmp_path / "m.safetensors"
    code, out, err = run("train", portraits[0] / "face[0-4]*", "-o", model, "--diagonal", 50, "--name", "me")
    assert (code, err) == (0, "")
    assert "5 samples" in out
    assert "trained on 5 images and 15 copies in other light (300 lamps); shape modes: " in out
    assert "limit of accuracy: the best shapes that the model can make for left-out images are off by " in out
    assert "% of the diagonal of the landmarks' box. Fits have larger errors" in out
    code, out, _ = run("show", model, "-o", tmp_path / "drawn.png")
    assert code == 0
    assert "me (" in out
    assert "5 images" in out
    assert read_image(tmp_path / "drawn.png").shape[2] == 3


def test_another_landmarkers_points_start_fits(run, portraits, tmp_path):
    """From files: trained with them, a fit starts from such a file and weighs it in; without, the message says how."""
    folder, image, truth = portraits
    rng, theirs = np.random.default_rng(0), tmp_path / "theirs"
    theirs.mkdir()

    def write_theirs(path, shape):
        write_landmarks(path, 0.5 * (shape[::2] + shape[1::2]) + rng.normal(0, 1, (len(shape) // 2, 2)))

    for file in sorted(folder.glob("*.pts")):
        write_theirs(theirs / file.name, read_landmarks(file).points)
    write_theirs(tmp_path / "new.pts", read_landmarks(truth).points)
    model = tmp_path / "m.liaam"
    options = ("--diagonal", 60, "--no-leave-out", "--lamps", "none")
    code, out, _ = run("train", folder, "-o", model, "--points", theirs, *options)
    assert code == 0
    assert "trained on 6 images and 6 mirrored copies; shape modes: " in out
    assert "the other landmarker's 29 points: mapped to the landmarks with an error of" in out
    assert "the quality and the ellipses of fits are not calibrated (--no-leave-out)" in out
    info = run("show", model)[1]
    assert "29 points of another landmarker" in info and "not calibrated" in info
    outputs = ("-o", tmp_path / "fits", "--format", "json,pts")
    code, out, err = run("fit", model, image, "--init", tmp_path / "new.pts", *outputs)
    assert (code, err) == (0, "")
    assert "not calibrated" in out
    found, wanted = read_landmarks(tmp_path / "fits" / "new.pts").points, read_landmarks(truth).points
    assert np.linalg.norm(found - wanted, axis=1).mean() < 2.0
    run("train", folder, "-o", model, *options)
    code, _, err = run("fit", model, image, "--init", tmp_path / "new.pts", "-o", tmp_path / "fits")
    assert code == 1
    assert "train with them ('liaam train --points FOLDER'" in err


def test_training_that_is_stopped_leaves_one_line_and_no_file(run, portraits, tmp_path, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("liaam.training.textures.train_appearance_model", stop)
    code, _, err = run("train", portraits[0] / "face[0-4]*", "-o", tmp_path / "m.liaam", *PLAIN)
    assert (code, err) == (130, "stopped\n")
    assert not list(tmp_path.iterdir())


def test_ctrl_c_while_options_are_read_is_reported(run, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("typer.core.TyperOption.process_value", stop)
    code, _, err = run("show")
    assert (code, err) == (130, "stopped\n")


def test_ctrl_c_between_the_steps_of_typer_is_reported(run, monkeypatch):
    def stop(*_, **__):
        raise SystemExit(130)  # what typer makes of it

    monkeypatch.setattr("liaam.cli.terminal._Commands.invoke", stop)
    code, _, err = run("show")
    assert (code, err) == (130, "stopped\n")


def test_ctrl_c_while_a_line_is_printed_is_reported(run, portraits, tmp_path, monkeypatch):
    from liaam.cli.terminal import error_console

    def stop(*_, **__):
        error_console._enter_buffer()  # as rich does before it prints
        raise KeyboardInterrupt

    monkeypatch.setattr("liaam.training.textures.train_appearance_model", stop)
    code, _, err = run("train", portraits[0] / "face[0-4]*", "-o", tmp_path / "m.liaam", *PLAIN)
    error_console._exit_buffer()
    assert (code, err) == (130, "stopped\n")


def test_contours_are_given_by_numbers_from_1():
    assert parse_contour("1-4") == [0, 1, 2, 3]
    assert parse_contour("5-3, 9,5") == [4, 3, 2, 8, 4]
    for text in ("", "0-3", "a-b", "1-2-3"):
        with pytest.raises(LiaamError, match="numbers of landmarks from 1"):
            parse_contour(text)


def test_fit_writes_landmarks_and_overlay(run, portraits, model_file, tmp_path):
    truth = read_landmarks(portraits[2]).points
    out = tmp_path / "fits"
    fitted = ("fit", model_file, portraits[1], "--init", box_around(truth), "-o")
    code, text, err = run(*fitted, out)
    assert (code, err) == (0, "")
    assert "converged" in text or "light unobservable" in text
    assert sorted(p.name for p in out.iterdir()) == ["new.json", "new_fit.png"]
    assert run(*fitted, out, "--format", "json, .PTS,csv")[0] == 0  # its own results may be renewed
    assert sorted(p.name for p in out.iterdir()) == ["new.csv", "new.json", "new.pts", "new_fit.png"]
    found = read_landmarks(out / "new.pts").points
    assert np.linalg.norm(found - truth, axis=1).mean() < 1.5
    assert np.allclose(found, read_landmarks(out / "new.csv").points, atol=1e-3)
    facts = json.loads((out / "new.json").read_text())
    assert facts["method"] == "soft-li"
    assert facts["theta_deg"] is None  # taken from the camera, not estimated
    assert 0.5 < facts["quality"] <= 1.0
    assert all(0 < deviation < 20 for deviation in facts["sd"])


def test_fit_writes_the_only_file_that_is_asked_for(run, portraits, model_file, tmp_path):
    folder = tmp_path / "new" / "folder"
    for name in ("mine.pts", "mine.json", "mine.PNG", "other.jpg"):
        code, _, err = run("fit", model_file, portraits[1], "--init", portraits[2], "-o", folder / name)
        assert (code, err) == (0, "")
        assert (folder / name).is_file()
    assert len(list(folder.iterdir())) == 4
    assert read_landmarks(folder / "mine.pts").points.shape == (58, 2)
    (folder / "mine.json").unlink()
    code, _, err = run("fit", model_file, portraits[1], "--init", portraits[2], "-o", folder / "mine.pts")
    assert code == 1 and "mine.pts exists and is not from an earlier fit; give another -o" in err
    images = (portraits[0] / "face0.png", portraits[0] / "face1.png")
    code, _, err = run("fit", model_file, *images, "-o", folder / "all.pts")
    assert code == 1 and "all.pts is one file; give a folder" in err
    code, _, err = run("fit", model_file, images[0], "-o", images[0])
    assert code == 1 and "face0.png is one of the input images" in err
    code, _, err = run("fit", model_file, images[0], "-o", folder, "--format", "json,xml")
    assert code == 1 and "--format xml is unknown; choose from json, pts, csv and tps" in err


def test_fit_with_li_tells_the_angle(run, portraits, model_file, tmp_path):
    truth = read_landmarks(portraits[2]).points
    code, *_ = run(
        "fit", model_file, portraits[1], "--init", box_around(truth), "-o", tmp_path, "-m", "li", "--ellipses"
    )
    assert code == 0
    facts = json.loads((tmp_path / "new.json").read_text())
    assert 90 < facts["theta_deg"] < 150
    assert facts["quality"] is None


def test_fit_searches_without_a_start(run, portraits, model_file, tmp_path):
    truth = read_landmarks(portraits[2]).points
    code, text, err = run("fit", model_file, portraits[1], "-o", tmp_path)
    assert (code, err) == (0, "")
    assert "searched" in text
    facts = json.loads((tmp_path / "new.json").read_text())
    assert np.linalg.norm(facts["landmarks"] - truth, axis=1).mean() < 1.5
    assert facts["start"] == "searched"
    assert facts["score"] > 0.52
    assert facts["detection_doubtful"] is False


def test_fit_says_how_it_was_started(run, portraits, model_file, tmp_path):
    code, text, _ = run("fit", model_file, portraits[1], "--init", portraits[2], "-o", tmp_path)
    assert code == 0
    assert "given" in text
    facts = json.loads((tmp_path / "new.json").read_text())
    assert (facts["start"], facts["score"], facts["detection_doubtful"]) == ("given", None, None)


def test_fit_all_numbers_what_it_finds(run, portraits, model_file, tmp_path):
    picture, truth = read_image(portraits[1]), read_landmarks(portraits[2]).points
    negative = 255 - picture  # no face to the model, and as full of edges
    write_image(tmp_path / "two.png", np.concatenate([picture, negative, picture], axis=1))
    code, text, _ = run("fit", model_file, tmp_path / "two.png", "--all", "-m", "igo", "-o", tmp_path / "o")
    assert code == 0
    assert text.count("searched") >= 2
    names = {path.name for path in (tmp_path / "o").iterdir()}
    assert {"two_1.json", "two_1_fit.png", "two_2.json", "two_2_fit.png"} <= names
    assert "two.json" not in names
    shapes = [json.loads(path.read_text())["landmarks"] for path in (tmp_path / "o").glob("*.json")]
    for shift in (0, 2 * picture.shape[1]):
        assert min(np.linalg.norm(shape - truth - [shift, 0], axis=1).mean() for shape in shapes) < 2


def test_fit_says_when_a_search_is_in_doubt(run, model_file, tmp_path, rng):
    write_image(tmp_path / "noise.png", rng.integers(0, 256, (120, 150, 3), dtype=np.uint8))
    _, _, err = run("fit", model_file, tmp_path / "noise.png", "-m", "igo", "-o", tmp_path / "o")
    assert "noise.png: the search may have found something else" in err
    assert json.loads((tmp_path / "o" / "noise.json").read_text())["detection_doubtful"] is True
    _, _, err = run("fit", model_file, tmp_path / "noise.png", "--all", "-m", "igo", "-o", tmp_path / "o")
    assert "noise_1: the search may have found something else" in err
    assert json.loads((tmp_path / "o" / "noise_1.json").read_text())["detection_doubtful"] is True
    write_image(tmp_path / "wall.png", np.full((120, 150, 3), 90, np.uint8))
    code, _, err = run("fit", model_file, tmp_path / "wall.png", "--all", "-o", tmp_path / "o")
    assert code == 1
    assert "error: wall.png: no object was found (the best score is 0.00, 0.52 is needed); give a start" in err


def test_fit_goes_on_after_a_bad_image_and_says_so(run, portraits, model_file, tmp_path):
    bad = tmp_path / "bad.png"
    bad.write_bytes(portraits[1].read_bytes()[:500])
    code, out, err = run("fit", model_file, bad, portraits[1], "--init", portraits[2], "-o", tmp_path / "o")
    assert code == 1
    assert "bad.png" in err
    assert "new.png" in out
    assert sorted(p.name for p in (tmp_path / "o").iterdir()) == ["new.json", "new_fit.png"]


def test_fit_takes_a_folder_of_starts(run, portraits, model_file, tmp_path):
    images = [portraits[0] / "face0.png", portraits[0] / "face1.png"]
    code, out, _ = run("fit", model_file, *images, "--init", portraits[0], "-o", tmp_path, "-m", "rgb")
    assert code == 0
    assert "face1.png" in out
    code, _, err = run("fit", model_file, portraits[1], "--init", portraits[0], "-o", tmp_path)
    assert code == 1
    assert "holds no landmark file for it; add one such as new.pts" in err


def test_failed_fit_has_advice_and_an_exit_status(run, portraits, model_file, tmp_path):
    write_image(tmp_path / "black.png", np.zeros((200, 150, 3), np.uint8))
    code, out, err = run("fit", model_file, tmp_path / "black.png", "--init", portraits[2], "-o", tmp_path, "-m", "rgb")
    assert code == 1
    assert "no texture" in out
    out = run("fit", model_file, tmp_path / "black.png", "-o", tmp_path / "searched")[1]
    assert "not found" in out and "found, 0" not in out
    assert "no valid values, where the fit started; check the start" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("train", "{missing}", "-o", "m"), "missing"),
        (("train", "{empty}", "-o", "m"), "no image"),
        (("train", "{portraits}", "-o", "{empty}/no/m"), "does not exist"),
        (("train", "{portraits}", "-o", "m", "--camera", "film"), "srgb, linear, or a gamma"),
        (("train", "{portraits}", "-o", "m", "--diagonal", "3"), "16 to 2000"),
        (("train", "{portraits}", "-o", "m", "--camera", "nan"), "in degrees"),
        (("train", "{portraits}", "-o", "m", "--camera", "40"), "in degrees"),
        (("train", "{portraits}/face0*", "-o", "m"), "too few"),
        (("train", "{portraits}/nose*", "-o", "m"), "matches nose*; they are face0"),
        (("train", "{portraits}/*/a/face*", "-o", "m"), "a pattern is for images' names"),
        (("train", "{portraits}", "-o", "m.png"), "a model ends in .liaam, not in .png; give a name such as m.liaam"),
        (("train", "{portraits}", "-o", "m.tps"), "a model ends in .liaam"),
        (("train", "{portraits}", "-o", "m", "--training-lamp", "07"), "give that folder with --lamps, or leave"),
        (("show", "{missing}"), "does not exist; make one with 'liaam train"),
        (("show", "{image}"), "is a PNG image, not a model file; give a model file in its place"),
        (("fit", "{image}", "{model}"), "a model comes first, as in 'liaam fit face.safetensors new.png'"),
        (("train", "{portraits}", "-o", "m", "--lamps", "no"), "a lamp file, a folder, 'auto' or 'none'"),
        (("show", "{model}", "-o", "x.gif"), "ends in .png, .svg or .pdf"),
        (("fit", "{model}", "{missing}.png", "--init", "1,2,3,4"), "missing"),
        (("fit", "{model}", "{image}", "--init", "nowhere.pts"), "no such file"),
        (("fit", "{model}", "{image}", "--rotations", "some"), "choose from upright, all"),
        (("fit", "{model}", "{image}", "--init", "1,2"), "four numbers"),
        (("fit", "{model}", "{image}", "--init", "900,900,950,980"), "outside the image"),
        (("fit", "{model}", "{image}", "--init", "50,50,20,90"), "is empty"),
        (("fit", "{model}", "{image}", "--init", "9,9,99,99", "--all"), "use only one of them"),
        (("fit", "{model}", "{image}", "--init", "9,9,99,99", "-m", "magic"), "choose from soft-li, grey, rgb, li"),
        (("fit", "{model}", "{image}", "--init", "9,9,99,99", "-o", "{image}"), "is one of the input images"),
    ],
)
def test_wrong_input_is_one_line_that_says_what_to_do(
    run, arguments, message, portraits, model_file, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    places = {
        "missing": tmp_path / "missing",
        "empty": tmp_path / "empty",
        "portraits": portraits[0],
        "image": portraits[1],
        "model": model_file,
    }
    places["empty"].mkdir()
    code, _, err = run(*(argument.format(**places) for argument in arguments))
    assert code == 1
    assert err.startswith("error: ")
    assert message in err
    assert "Traceback" not in err
    assert not (tmp_path / "m").exists()


def test_fit_does_not_overwrite_a_persons_landmarks(run, portraits, model_file, tmp_path):
    write_image(tmp_path / "mine.png", read_image(portraits[1]))
    write_landmarks(tmp_path / "mine.pts", read_landmarks(portraits[2]).points)
    before = (tmp_path / "mine.pts").read_bytes()
    arguments = ("fit", model_file, tmp_path / "mine.png", "--init", tmp_path)
    code, _, err = run(*arguments, "-o", tmp_path, "--format", "pts")
    assert code == 1
    assert "mine.pts exists and is not from an earlier fit" in err
    assert (tmp_path / "mine.pts").read_bytes() == before
    assert run(*arguments, "-o", tmp_path / "out")[0] == 0
    assert run(*arguments, "-o", tmp_path / "out")[0] == 0  # its own results may be renewed
    write_landmarks(tmp_path / "out/mine.pts", read_landmarks(portraits[2]).points)
    code, _, err = run(*arguments, "-o", tmp_path / "out")
    assert code == 1
    assert "mine.pts: its points were changed after the fit; give another -o" in err


def test_fits_that_may_not_be_used_are_only_in_files_that_say_so(run, model_file, tmp_path):
    write_image(tmp_path / "wall.png", np.full((120, 150, 3), 90, np.uint8))
    fitted = ("fit", model_file, tmp_path / "wall.png", "-o")
    code, out, err = run(*fitted, tmp_path / "a", "--format", "pts,tps,csv")
    assert code == 1 and f"written to {tmp_path / 'a'}" in " ".join(out.split())
    assert "wall.png: not written as .pts and .tps, which cannot state that a fit may not be used" in " ".join(
        err.split()
    )
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == ["wall.csv", "wall_fit.png"]
    (specimen,) = read_specimens(tmp_path / "a")
    assert specimen.status and not specimen.is_usable
    code, out, err = run(*fitted, tmp_path / "wall.tps")
    assert code == 1 and not (tmp_path / "wall.tps").exists() and "written to" not in out
    assert "give a name that ends in .json or .csv" in " ".join(err.split())
    code, _, err = run(*fitted, tmp_path / "b", "--format", "json,tps")
    assert code == 1 and (tmp_path / "b" / "wall.tps").exists() and "not written" not in err
    assert run(*fitted, tmp_path / "b", "--format", "tps")[0] == 1
    assert not (tmp_path / "b" / "wall.tps").exists()  # that of the earlier fit


def test_train_does_not_overwrite_a_picture(run, portraits, tmp_path):
    write_image(tmp_path / "holiday.png", read_image(portraits[1]))
    code, _, err = run("train", portraits[0], "-o", tmp_path / "holiday.png")
    assert code == 1
    assert "exists and is not a .liaam file, so it is kept" in err
    np.testing.assert_array_equal(read_image(tmp_path / "holiday.png"), read_image(portraits[1]))


def test_names_with_brackets_are_printed_as_they_are(run, portraits, tmp_path):
    model = tmp_path / "m.liaam"
    assert (
        run(
            "train", portraits[0], "-o", model, "--diagonal", 60, "--copies", 0, "--no-leave-out", "--name", "head [/b]"
        )[0]
        == 0
    )
    code, out, _ = run("show", model)
    assert code == 0
    assert "head [/b]" in out


def test_images_of_one_stem_do_not_overwrite_each_other(tmp_path):
    images = [
        tmp_path / "a" / "x.png",
        tmp_path / "b" / "x.png",
        tmp_path / "b" / "y.png",
        tmp_path / "b" / "x.jpg",
    ]
    assert unique_stems(images) == ["a_x_png", "b_x_png", "y", "b_x_jpg"]
    assert unique_stems(images[:3]) == ["a_x", "b_x", "y"]
    assert names_in_folders(images[:3]) == ["a/x.png", "b/x.png", "b/y.png"]
    assert names_in_folders(images[2:]) == ["y.png", "x.jpg"]


def test_help_and_methods(run):
    for command in ((), ("train",), ("fit",), ("track",)):
        code, out, _ = run(*command, "--help")
        assert code == 0
        assert "Usage" in out
    for command, argument in (("train", "FOLDER"), ("lamps", "FOLDER"), ("show", "FILE"), ("studio", "FOLDER")):
        assert argument in run(command, "--help")[1]  # as in messages and in the reference
    out = run("fit", "--help")[1]
    assert all(name in out for name in ("grey", "rgb", "li", "li-lit", "li-pc", "li-pcs", "chroma"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("fit", "x.png", "--elipses"), "No such option: --elipses (Possible options: --ellipses"),
        (("fti", "x.png"), "No such command 'fti'. Did you mean 'fit'? See '"),
        (("fit",), "Missing argument"),
        (("train", "faces", "-o", "m.liaam", "--diagonal", "wide"), "Invalid value for '--diagonal'"),
    ],
)
def test_a_misused_command_is_one_line_that_says_where_to_look(run, arguments, message):
    code, _, err = run(*arguments)
    assert code == 2
    assert err.startswith("error: ") and message in err and err.count("\n") == 1
    assert "--help'" in err


def test_a_group_without_a_command_prints_its_help_only(run):
    code, out, err = run("camera")
    assert (code, err) == (2, "") and "Usage: " in out


@pytest.mark.parametrize("command", ["fit", "compact"])
def test_after_a_misspelt_name_of_a_model_the_names_are_listed(run, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    write_image("a.png", np.zeros((20, 20, 3), np.uint8))
    arguments = ("fase", "a.png") if command == "fit" else ("fase", "-o", "small.liaam")
    code, _, err = run(command, *arguments)
    assert code == 1 and err.count("\n") == 1
    assert "fase: the model file does not exist; make one with" in err
    assert "or use one that comes with liaam (face)" in err


def test_show_checks_where_it_writes_before_it_draws(run, model_file, tmp_path, monkeypatch):
    monkeypatch.setattr("liaam.plotting.figure_of_model", lambda *_: pytest.fail("drawn in vain"))
    code, _, err = run("show", model_file, "-o", tmp_path / "no" / "x.png")
    assert code == 1
    assert "x.png cannot be written: the folder" in err


LONG = "a" * 300


@pytest.mark.parametrize(
    "arguments",
    [
        ["fit", f"{LONG}.liaam", "x.png"],
        ["fit", "{model}", f"{LONG}.png"],
        ["fit", "{model}", "{picture}", "--init", LONG],
        ["fit", "{model}", "{picture}", "--init", "1,2,3", "--camera", LONG],
        ["fit", "{model}", "{picture}", "--init", "1,2,3", "-o", LONG],
        ["show", LONG],
        ["show", LONG],
        ["show", "{model}", "-o", f"{LONG}.png"],
        ["train", LONG, "-o", "x.liaam"],
        ["train", "{folder}", "-o", LONG],
        ["train", "{folder}", "-o", f"{LONG}/x.liaam"],
        ["check", LONG],
        ["camera", "invariant", f"{LONG}.png"],
        ["lamps", "{folder}", "-o", f"{LONG}.lamps"],
        ["batch", "{model}", f"{LONG}.png", "-o", "x.csv"],
        ["batch", "{model}", "{picture}", "-o", f"{LONG}.csv"],
        ["batch", "{model}", "{picture}", "--init", LONG, "-o", "x.csv"],
        ["track", "{model}", f"{LONG}.mp4", "-o", "x.csv"],
        ["relight", "{model}", f"{LONG}.png"],
        ["measure", LONG, "-o", "x.csv"],
        ["measure", "{folder}", "-o", f"{LONG}.csv"],
    ],
    ids=lambda arguments: " ".join(arguments).replace(LONG, "LONG"),
)
def test_a_name_that_no_file_can_have_is_one_line(run, portraits, model_file, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    places = {"model": model_file, "picture": portraits[1], "folder": portraits[0]}
    status, _, err = run(*(text.format_map(places) for text in arguments))
    assert status == 1
    assert err.startswith("error: ") and len(err.splitlines()) == 1


@pytest.mark.parametrize(
    "arguments",
    [
        ["fit", "{model}", "loop.png", "--init", "1,2,3"],
        ["camera", "invariant", "loop.png"],
        ["camera", "invariant", "{picture}", "--camera", "loop.json"],
        ["relight", "loop.liaam", "{picture}", "-o", "loop.png"],
        ["camera", "register", "loop.png", "loop.png", "-o", "loop.png"],
        ["camera", "noise", "loop.png", "-o", "loop.json"],
        ["check", "loop", "-o", "loop.png"],
        ["track", "{model}", "loop.mp4", "-o", "loop.csv"],
    ],
    ids=" ".join,
)
def test_a_link_that_leads_to_itself_is_one_line(run, portraits, model_file, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    for name in ("loop", "loop.png", "loop.json", "loop.liaam", "loop.mp4", "loop.csv"):
        (tmp_path / name).symlink_to(name)
    status, _, err = run(*(text.format(model=model_file, picture=portraits[1]) for text in arguments))
    assert status == 1
    assert err.startswith("error: ") and len(err.splitlines()) == 1


def test_rights_that_are_missing_are_one_line(run, portraits, model_file, monkeypatch):
    def forbidden(*_, **__):
        raise PermissionError(13, "Permission denied", "secret/face.liaam")

    monkeypatch.setattr("liaam.model.load_model", forbidden)
    status, _, err = run("show", "face.liaam")
    assert status == 1
    remedy = "check the name, the permissions and the free space"
    assert err.strip() == f"error: secret/face.liaam: Permission denied; {remedy}"


WITHOUT_POWERS = """
import ctypes, os
if os.getuid() == 0:  # may read anything, unless it gives its capabilities up
    assert ctypes.CDLL(None).capset((ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()) == 0
from liaam.cli.main import main
main()
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="capabilities are Linux's")
def test_folders_without_permission_are_one_line(portraits, tmp_path):
    (tmp_path / "locked").mkdir()
    (tmp_path / "locked" / "x.png").write_bytes(b"x")
    (tmp_path / "locked").chmod(0)
    try:
        for command in (["check", "locked/sub"], ["lamps", ".", "-o", "locked/x.lamps"]):
            done = subprocess.run(
                [sys.executable, "-c", WITHOUT_POWERS, *command],
                cwd=tmp_path,
                capture_output=True,
                text=True,
                check=False,
            )
            assert done.returncode == 1, done.stderr
            assert "Permission denied" in done.stderr and "Traceback" not in done.stderr
            assert len(done.stderr.splitlines()) == 1
    finally:
        (tmp_path / "locked").chmod(0o700)


EVIL = "\x1b]0;owned\x07\x1b[31mred\x9b2J\u202eface"


def test_escape_sequences_of_a_models_name_do_not_reach_the_terminal(run, model_file, tmp_path):
    replace(load_model(model_file), name=EVIL).save(tmp_path / "evil.liaam")
    _, out, _ = run("show", tmp_path / "evil.liaam")
    assert not set("\x1b\x07\x9b\u202e") & set(out)
    assert "red" in out and "face" in out


def test_what_is_said_has_no_escape_sequences(run):
    for arguments in (["show", f"{EVIL}.liaam"], ["nonsense" + EVIL], ["fit", "x", "y", "--rotations", EVIL]):
        status, out, err = run(*arguments)
        assert status and not set("\x1b\x07\x9b\u202e") & set(out + err)


@pytest.mark.parametrize("name", ["", ".", "/"])
def test_a_folder_is_not_drawn(run, name):
    status, _, err = run("show", name)
    assert status == 1 and "is a folder" in err


@pytest.mark.parametrize("late", ["face", "other.liaam"])
def test_a_model_after_the_images_is_told_where_it_belongs(run, portraits, late):
    status, _, err = run("fit", portraits[1], late)
    assert status == 1 and f"as in 'liaam fit {late} {portraits[1].name}'" in err


def test_a_folder_that_is_called_as_a_model_is_a_folder_by_its_path(run, tmp_path):
    (tmp_path / "face").mkdir()
    assert "face: no images" in run("fit", tmp_path / "face")[2]
    assert "face: no images" in run("batch", tmp_path / "face", "-o", tmp_path / "t.csv")[2]


def test_a_folder_without_images_is_named(run, tmp_path):
    for arguments in ((tmp_path,), ("face", tmp_path)):
        status, _, err = run("fit", *arguments)
        assert status == 1 and f"{tmp_path}: no images" in err and "give a folder of images" in err


def test_an_image_without_texture_gets_no_advice_on_the_search(run, model_file, tmp_path):
    write_image(tmp_path / "black.png", np.zeros((200, 150, 3), np.uint8))
    code, out, err = run("fit", model_file, tmp_path / "black.png", "-o", tmp_path / "fits")
    assert code == 1 and "no texture" in out
    assert "black.png: no texture: " in err and "the search" not in err
    assert "no model was given" not in out
    code, out, _ = run("fit", tmp_path / "black.png", "-o", tmp_path / "of-faces")
    assert code == 1
    assert "no model was given, so faces were looked for; for other objects, give their model" in " ".join(out.split())


def test_tables_that_go_to_a_file_are_not_cut(capsys):
    from liaam.cli.terminal import show_table, table_of

    table = table_of("name", "value")
    table.add_row("a" * 150, "1.234")
    show_table(table)
    assert "a" * 150 in capsys.readouterr().out


def test_a_full_disk_ends_a_fit_with_one_error(run, model_file, portraits, tmp_path, monkeypatch):
    def full(path, _):
        try:
            raise OSError(errno.ENOSPC, "No space left on device")
        except OSError as fault:
            raise LiaamError(f"{path} cannot be written (No space left on device)") from fault

    monkeypatch.setattr("liaam.cli.fit.write_image", full)
    images = [portraits[0] / f"face{i}.png" for i in range(3)]
    code, _, err = run("fit", model_file, *images, "--init", portraits[2], "-o", tmp_path / "fits")
    assert code == 1
    assert err.count("error: ") == 1
    assert "stopped: 0 of 3 images are done; make room, and fit the others" in err
    assert not list((tmp_path / "fits").iterdir())  # no results without their pictures


def test_fits_of_earlier_runs_in_the_folder_are_named(run, portraits, model_file, tmp_path):
    for image in ("one.png", "two.png"):
        write_image(tmp_path / image, read_image(portraits[1]))
    out = tmp_path / "fits"
    _, said, err = run("fit", model_file, tmp_path / "one.png", tmp_path / "two.png", "-o", out)
    assert "earlier runs" not in said + err
    (out / "other.json").write_bytes(b"\xff\xfe")
    _, said, err = run("fit", model_file, tmp_path / "two.png", "-o", out)
    assert "fits also holds 1 fit of earlier runs: one" in " ".join((said + err).split())


def test_overlays_of_large_images_are_jpeg_and_replace_earlier_ones(run, portraits, model_file, tmp_path):
    box = box_around(read_landmarks(portraits[2]).points)
    image = tmp_path / "new.png"
    small = read_image(portraits[1])
    write_image(image, small)
    out = tmp_path / "fits"
    assert run("fit", model_file, image, "--init", box, "-o", out, "--numbers", "--mesh")[0] == 0
    assert sorted(path.name for path in out.iterdir()) == ["new.json", "new_fit.png"]
    large = np.zeros((1600, 1600, 3), np.uint8)
    large[: small.shape[0], : small.shape[1]] = small
    write_image(image, large)
    assert run("fit", model_file, image, "--init", box, "-o", out)[0] == 0
    assert sorted(path.name for path in out.iterdir()) == ["new.json", "new_fit.jpg"]


def test_names_are_drawn_where_there_are_names(run, portraits, model_file):
    code, _, err = run("fit", model_file, portraits[1], "--names")
    assert code == 1 and "--names: the model's landmarks have no names; use --numbers" in err
    code, _, err = run("fit", model_file, portraits[1], "--names", "--numbers")
    assert code == 1 and "--numbers and --names would be drawn on each other" in err


def test_a_folder_is_fitted_into_one_page(run, portraits, model_file, tmp_path):
    folder = tmp_path / "new"
    folder.mkdir()
    write_image(folder / "a.png", read_image(portraits[1]))
    (folder / "b.png").write_bytes(b"no image")
    page = tmp_path / "report.html"
    code, out, err = run("fit", model_file, folder, "-o", page)
    assert code == 1 and "b.png" in err
    assert "1 error" in out and f"written to {page}" in out
    assert "image    start" not in out  # the page has the table
    text = page.read_text()
    assert text.index(">b.png<") < text.index(">a.png<")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new", "report.html"]
    code, _, err = run("fit", model_file, folder, "-o", page, "--scheme", "ibug-68")
    assert code == 1 and "shows the model's own landmarks" in err
    code, _, err = run("fit", model_file, folder, "-o", page, "--mesh", "--format", "tps")
    assert code == 1 and "report.html shows every fit in one way: leave --mesh, --format out, or give a folder" in err


def test_a_page_of_errors_alone_is_said_to_be_written(run, model_file, tmp_path):
    (tmp_path / "b.png").write_bytes(b"no image")
    page = tmp_path / "report.html"
    code, out, _ = run("fit", model_file, tmp_path / "b.png", "-o", page)
    assert code == 1 and page.exists()
    assert "1 error" in out and f"written to {page}" in out


@pytest.mark.parametrize(
    ("output", "formats", "more", "said"),
    [
        ("fits", "json", {}, "in the files are empty (the messages in the .json files name them). --absent estimate"),
        (
            "fits",
            "json",
            {"absent": "estimate"},
            "in the files are estimates (the messages in the .json files name them)",
        ),
        ("fits", "tps", {}, "in the files are empty (--format json writes their names). --absent estimate"),
        ("a.png", "json", {}, "the picture has red rings at their places"),
        ("fits", "json", {"scheme": "ibug-68"}, "some of ibug-68 are estimates; fit without --scheme to see which"),
        ("report.html", "json", {}, "in the table of the page are empty (the messages there name them). --absent"),
    ],
)
def test_what_is_said_of_absent_landmarks_is_true_of_the_files(tmp_path, output, formats, more, said):
    asked = Outputs.asked(tmp_path / output, formats, scheme=more.get("scheme"), several=False)
    assert said in replace(asked, **more).on_absent


@pytest.mark.parametrize("more", [(), ("--all",)])
def test_fits_of_images_in_another_folder_are_not_replaced(run, portraits, model_file, tmp_path, more):
    for name, other in (("a", "face0.png"), ("b", "face1.png")):
        (tmp_path / name).mkdir()
        write_image(tmp_path / name / "x.png", read_image(portraits[0] / other))
    out = tmp_path / "fits"
    fitted = (*more, "-m", "igo", "-o", out)
    for _ in range(2):  # those of the same image are replaced
        assert run("fit", model_file, tmp_path / "a", *fitted)[0] == 0
    file = out / f"x{'_1' if more else ''}.json"
    earlier = file.read_bytes()
    assert json.loads(earlier)["path"] == "../a/x.png"
    code, _, err = run("fit", model_file, tmp_path / "b", *fitted)
    assert code == 1 and f"fits holds fits of other images of these names: {file.stem}; give another folder" in err
    assert file.read_bytes() == earlier
    (tmp_path / "a").rename(tmp_path / "moved")
    assert run("fit", model_file, tmp_path / "moved", *fitted)[0] == 0
    write_image(tmp_path / "moved" / "x.png", read_image(portraits[1]))
    assert run("fit", model_file, tmp_path / "moved", *fitted)[0] == 0  # the same image, which was changed


def test_overlays_of_earlier_fits_in_a_folder_are_not_fitted(run, portraits, model_file, tmp_path):
    write_image(tmp_path / "a.png", read_image(portraits[1]))
    for _ in range(2):
        assert run("fit", model_file, tmp_path, "-o", tmp_path / "fits")[0] == 0
    assert sorted(path.name for path in (tmp_path / "fits").iterdir()) == ["a.json", "a_fit.png"]
    code, _, err = run("fit", model_file, tmp_path / "fits")
    assert code == 1 and "its images are overlays of earlier fits" in err
