"""Odd folders and images, as a new user has them: every mishap has a message that names the remedy."""

import json
import re

import numpy as np
import pytest

from liaam.io import read_image, write_image, write_landmarks
from scenes import Head, make_set
from scenes.ruler import draw

FAST = ("--diagonal", 40, "--copies", 0, "--no-leave-out")


@pytest.fixture(scope="module")
def scenes():
    return make_set(9, head=Head(5), size=(160, 120))


@pytest.fixture
def folder(scenes, tmp_path):
    """Nine landmarked portraits."""
    path = tmp_path / "faces"
    path.mkdir()
    for i, scene in enumerate(scenes):
        write_image(path / f"face{i}.png", scene.image)
        write_landmarks(path / f"face{i}.pts", scene.landmarks)
    return path


def make_grey(*paths):
    for path in paths:
        write_image(path, read_image(path).mean(axis=2).astype(np.uint8))


def test_a_mixed_folder_trains_with_one_line_about_its_grey_images(run, folder, tmp_path):
    make_grey(folder / "face1.png", folder / "face4.png")
    code, out, err = run("train", folder, "-o", tmp_path / "m.liaam", *FAST)
    assert code == 0, err
    line = (
        "2 of 9 images are grey (face1, face4): soft-li learns from their brightness, the other methods leave them out"
    )
    assert err == f"{line}\n"
    assert "trained on 9 images; shape modes: " in out
    code, out, err = run("check", folder)
    assert (code, err) == (0, "")
    assert line in out


def test_a_folder_of_grey_images_only_is_not_worth_a_line(run, folder):
    make_grey(*folder.glob("*.png"))
    code, out, _ = run("check", folder)
    assert code == 0 and "are grey" not in out


@pytest.mark.parametrize("command", ["train", "check"])
def test_all_damaged_images_are_named(run, folder, tmp_path, command):
    (folder / "face2.png").write_bytes((folder / "face2.png").read_bytes()[:2000])
    (folder / "face5.png").write_bytes(b"")
    options = ("-o", tmp_path / "m.liaam", *FAST) if command == "train" else ()
    code, _, err = run(command, folder, *options)
    assert code == 1
    assert "face2.png is cut short" in err and "face5.png is empty" in err


@pytest.mark.parametrize("command", ["train", "check"])
def test_files_that_do_not_match_are_listed(run, folder, tmp_path, command):
    (folder / "face2.pts").rename(folder / "face2_old.pts")
    (folder / "face5.pts").rename(folder / "face5.dta")
    _, out, _ = run(command, folder, *(("-o", tmp_path / "m.liaam", *FAST) if command == "train" else ()))
    assert "left out 2: the image has no landmarks (face2.png, face5.png)" in out
    assert "left out 1: no image has its name (face2_old.pts)" in out
    assert re.search(r"left out 1: unknown format; landmarks are read from \.pts, .* \(face5\.dta\)", out)


@pytest.mark.parametrize("command", ["train", "check"])
def test_subfolders_are_offered(run, folder, command):
    options = ("-o", folder.parent / "m.liaam") if command == "train" else ()
    code, _, err = run(command, folder.parent, *options)
    assert code == 1
    assert "images in its subfolders only (faces/face0.png" in err and "/**" in err
    code, out, _ = run("check", folder.parent / "**")
    assert "samples" in out


@pytest.mark.parametrize("command", ["train", "check"])
def test_images_of_subfolders_that_are_not_read_are_counted(run, folder, scenes, tmp_path, command):
    (folder / "more").mkdir()
    for i in range(2):
        write_image(folder / "more" / f"new{i}.png", scenes[i].image)
        write_landmarks(folder / "more" / f"new{i}.pts", scenes[i].landmarks)
    options = ("-o", tmp_path / "m.liaam", *FAST) if command == "train" else ()
    _, _, err = run(command, folder, *options)
    assert f"images in subfolders that are not read: 2; give '{folder}/**' to read these, too" in err
    for pattern in ("**", "face*"):
        _, _, err = run(command, f"{folder}/{pattern}", *options)
        assert "not read" not in err


@pytest.fixture
def overlays(run, model_file, folder, scenes, tmp_path):
    """Folders of results of ``liaam fit`` and ``liaam scale``, which hold overlays and no photographs."""
    image = tmp_path / "a.png"
    write_image(image, scenes[0].image)
    run("fit", model_file, image, "-m", "igo", "--crops", "-o", tmp_path / "results" / "fits")
    write_image(image, draw("plain", np.random.default_rng(0), size=10.0, angle=4.0).image)
    run("scale", image, "--ruler", "1 mm", "-o", tmp_path / "results" / "s.csv")
    image.unlink()
    return tmp_path / "results"


@pytest.mark.parametrize("command", ["fit", "batch", "scale", "check", "train"])
def test_overlays_are_not_taken_for_images(run, model_file, folder, overlays, tmp_path, command):
    assert {path.name for path in overlays.rglob("*.png")} == {"a_fit.png", "a_crop.png", "a_scale.png"}
    given = {"fit": (model_file,), "batch": (model_file,)}.get(command, ())
    outputs = {"batch": "b.csv", "scale": "s.csv", "train": "m.liaam", "fit": "fits"}
    options = ("-o", tmp_path / outputs[command]) if command in outputs else ()
    for results in ("fits", "s"):
        code, out, err = run(command, *given, overlays / results, *options)
        assert code == 1 and "overlays" in err
    overlays.rename(folder / "results")
    more = {"train": FAST, "fit": ("-m", "igo"), "batch": ("-m", "igo")}.get(command, ())
    source = f"{folder}/**" if command in ("check", "train") else folder
    _, out, err = run(command, *given, source, *options, *more)
    assert "a_fit" not in out + err and "a_scale" not in out + err and "a_crop" not in out + err


@pytest.mark.parametrize("command", ["fit", "batch", "scale"])
def test_an_image_that_is_given_twice_is_taken_once(run, model_file, folder, tmp_path, command):
    given = {"fit": (model_file,), "batch": (model_file,)}.get(command, ())
    output = tmp_path / ("fits" if command == "fit" else "t.csv")
    image = folder / "face0.png"
    more = ("-m", "igo") if given else ("--ruler", "1 mm")
    _, out, err = run(command, *given, image, folder / ".." / folder.name / "face0.png", *more, "-o", output)
    assert "1 image given more than once, and taken once: " in err
    if command == "fit":
        assert sorted(path.name for path in output.iterdir()) == ["face0.json", "face0_fit.png"]
    if command == "batch":
        assert "1 row: " in out
    if command == "scale":
        assert err.count("no ruler") == 1


def test_an_unknown_format_names_those_that_can_be_read(run, folder, tmp_path):
    for path in folder.glob("*.pts"):
        path.rename(path.with_suffix(".dta"))
    code, _, err = run("train", folder, "-o", tmp_path / "m.liaam")
    assert code == 1
    assert "unknown format: face0.dta, face1.dta" in err and "Convert them to one of .pts, " in err
    assert "the simplest is a .csv of a line 'x,y'" in err


def test_landmarks_of_another_size_of_the_image_are_named_before_any_work(run, scenes, folder, tmp_path):
    for i in (0, 3):
        write_landmarks(folder / f"face{i}.pts", scenes[i].landmarks * 3.0)
    code, _, err = run("train", folder, "-o", tmp_path / "m.liaam", *FAST)
    assert code == 1
    assert re.search(r"face0: \d+ of 58 landmarks lie outside the image of 120×160 pixels .*; face3: ", err)
    assert "images of this size; correct or remove them" in err


def test_an_image_of_three_faces_offers_all_and_init(run, model_file, scenes, tmp_path):
    image = tmp_path / "three.png"
    write_image(image, np.concatenate([scenes[i].image for i in range(3)], axis=1))
    _, out, err = run("fit", model_file, image, "-o", tmp_path / "fits")
    assert "converged" in out
    assert "three.png: 2 more objects in the image: add --all to fit each, or --init to choose one" in err
    _, out, err = run("fit", model_file, image, "-o", tmp_path / "fits", "--all")
    assert out.count("converged") == 3
    assert "more object" not in err


def test_a_turned_object_offers_rotations(run, model_file, scenes, folder, tmp_path):
    image = tmp_path / "turned.png"
    write_image(image, np.ascontiguousarray(np.rot90(scenes[0].image)))
    code, _, err = run("fit", model_file, image, "-o", tmp_path / "fits")
    assert code == 1
    assert "turned.png: the search may have found something else" in err and "add --rotations all" in err
    assert "--side both" not in err and "alone" not in err  # faces are symmetric, and there is one image
    _, _, err = run("fit", model_file, image, folder / "face0.png", "-o", tmp_path / "fits")
    assert "add --rotations all; fit these images alone again, with the same -o" in err
    assert "face0.png" not in err
    code, _, err = run("fit", model_file, image, "-o", tmp_path / "none", "--all")
    assert code == 1 and "--rotations all" in err
    code, out, err = run("fit", model_file, image, "-o", tmp_path / "turned", "--rotations", "all")
    assert code == 0 and "converged" in out


def test_a_batch_of_turned_objects_offers_rotations(run, model_file, scenes, tmp_path):
    image = tmp_path / "turned.png"
    write_image(image, np.ascontiguousarray(np.rot90(scenes[1].image)))
    options = (image, "-o", tmp_path / "fits.csv", "--jobs", 1)
    code, out, err = run("batch", model_file, *options)
    assert code == 0 and re.search("1 row: 1 (doubtful|max iterations)", out)
    assert "fits that may be wrong: 1; check those, by the column 'status'; if the object is rotated" in err
    assert "add --rotations all; fit these images alone again, into another table" in err
    _, out, err = run("batch", model_file, *options, "--rotations", "all", "--restart")
    assert "1 row: 1 converged" in out and "doubtful" not in err


def test_all_images_of_a_folder_and_its_subfolders_are_fitted(run, model_file, folder, tmp_path):
    (folder / "more").mkdir()
    for name in ("face7.png", "face8.png"):
        (folder / name).rename(folder / "more" / name)
    run("fit", model_file, folder, "-o", tmp_path / "fits")
    assert {path.stem for path in (tmp_path / "fits").glob("*.json")} == {f"face{i}" for i in range(9)}


def test_results_are_not_written_to_a_folder_named_as_an_image(run, model_file, folder, tmp_path):
    code, _, err = run("fit", model_file, *folder.glob("*.png"), "-o", tmp_path / "fitted.png")
    assert code == 1 and not (tmp_path / "fitted.png").exists()
    assert "fitted.png is one file; give a folder with -o" in err


def test_every_object_of_an_image_is_trained_on(run, scenes, tmp_path):
    """dlib XML may hold several boxes of an image; one of these lacks a part."""
    folder, images, width = tmp_path / "parties", "", scenes[0].image.shape[1]
    folder.mkdir()
    for i in range(3):
        pair = scenes[2 * i : 2 * i + 2]
        write_image(folder / f"party{i}.png", np.concatenate([scene.image for scene in pair], axis=1))
        for j, scene in enumerate(pair):
            points = scene.landmarks[: 50 if i == j == 1 else None] + np.array([j * width, 0.0])
            parts = "".join(f"<part name='{k}' x='{x}' y='{y}'/>" for k, (x, y) in enumerate(points))
            box = f"<box width='{9 - j}' height='9'>{parts}</box>"
            images += f"<image file='party{i}.png'>{box}</image>"
    (folder / "all.xml").write_text(f"<dataset>{images}</dataset>")
    code, out, err = run("train", folder, "-o", tmp_path / "m.liaam", *FAST)
    assert code == 0, err
    assert "2 images hold 4 objects, each a sample, such as party0#2 (party0.png, party2.png)" in out
    assert "left out 1: one of several objects in an image lacks landmarks (party1#2)" in out
    assert "first: 8 of 58; place them or delete the object, in all.xml" in out
    assert "trained on 5 images" in out


def test_training_and_show_report_how_often_landmarks_are_missing(run, folder, scenes, tmp_path):
    for i in range(4):
        points = scenes[i].landmarks.copy()
        points[[3, 8 + i]] = np.nan
        write_landmarks(folder / f"face{i}.pts", points)
    model_file = tmp_path / "m.liaam"
    code, out, err = run("train", folder, "-o", model_file, *FAST)
    assert (code, err) == (0, "")
    said = "estimated from the others. Of 9 images, landmark 4 is missing in 4, 9 in 1, 10 in 1, 11 in 1, 12 in 1"
    assert f"missing landmarks: 8 of 522 (2%), {said}" in out
    code, out, _ = run("show", model_file, "-o", tmp_path / "facts.json")
    assert code == 0 and said in out
    facts = json.loads((tmp_path / "facts.json").read_text())
    assert facts["images"] == 9 and len(facts["landmarks"]) == 58
    assert facts["landmarks"][3] == {"number": 4, "name": None, "missing": 4}
    assert facts["landmarks"][0]["missing"] == 0
    code, _, err = run("show", model_file, "-o", tmp_path / "facts.txt")
    assert code == 1 and "give a name that ends in .png, .svg or .pdf, or in .json" in err


def test_strict_training_refuses_a_missing_landmark_before_any_work(run, folder, scenes, tmp_path):
    points = scenes[2].landmarks.copy()
    points[3] = np.nan
    write_landmarks(folder / "face2.pts", points)
    code, _, err = run("train", folder, "-o", tmp_path / "m.liaam", "--strict", *FAST)
    assert code == 1
    assert "landmarks are missing in 1 image (face2): place them, or train without --strict" in err
    assert not (tmp_path / "m.liaam").exists()
