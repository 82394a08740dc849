"""'liaam relight' as a person types it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from liaam.io import read_image, write_image, write_landmarks
from scenes import lateral
from setups import moving_scene

SIDE = lateral("left", ambient_strength=0.4)


@pytest.fixture(scope="module")
def files(head_model, tmp_path_factory):
    """A model, a picture under side light and another under a light from the other side."""
    folder = tmp_path_factory.mktemp("relight")
    head_model.save(folder / "head.liaam")
    write_image(folder / "lit.png", moving_scene(0.3, SIDE).image)
    write_image(folder / "other.png", moving_scene(0.6, lateral("right", ambient_strength=0.4)).image)
    return folder


@pytest.fixture
def relight(run, files, monkeypatch):
    monkeypatch.chdir(files)
    return lambda *arguments: run("relight", "head.liaam", "lit.png", *arguments)


def test_flat_is_what_one_gets_without_a_light(relight, files, tmp_path):
    code, out, err = relight()
    assert (code, err) == (0, "")
    assert "lit_flat.png" in out
    assert relight("--light", "flat", "-o", tmp_path / "named.png")[0] == 0
    flat, named = read_image(files / "lit_flat.png"), read_image(tmp_path / "named.png")
    np.testing.assert_array_equal(flat, named)
    scene, truth = moving_scene(0.3, SIDE), moving_scene(0.3).image.astype(float)
    errors = [np.abs(picture[scene.mask] - truth[scene.mask]).mean() for picture in (scene.image, flat)]
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.slow
def test_a_lamp_and_another_picture(relight, files, tmp_path):
    mask = moving_scene(0.3).mask
    y, x = np.nonzero(mask)
    halves = [(y[side], x[side]) for side in (x < np.median(x), x > np.median(x))]

    def tilt(picture):
        left, right = (np.log(picture[half].astype(float).mean()) for half in halves)
        return right - left

    assert relight("-o", tmp_path / "flat.png")[0] == 0
    assert "lit_relit.png" in relight("--light", "1,0,0.3")[1]
    assert relight("--light=-1,0,0.3", "-o", tmp_path / "left.png")[0] == 0
    assert relight("--light", "other.png", "-o", tmp_path / "like.png")[0] == 0
    flat, left, like = (tilt(read_image(tmp_path / f"{name}.png")) for name in ("flat", "left", "like"))
    right = tilt(read_image(files / "lit_relit.png"))
    assert left < flat - 0.2 < flat + 0.2 < right
    assert like > flat + 0.2


def test_a_lamp_by_its_name_with_colour_ambient_light_and_strength(relight, tmp_path):
    def shown(*options):
        path = tmp_path / "shown.png"
        code, _, err = relight(*options, "-o", path)
        assert (code, err) == (0, "")
        return read_image(path).astype(int)

    left = shown("--light", "left")
    np.testing.assert_array_equal(left, shown("--light=-1,0,0.5"))
    taken = moving_scene(0.3, SIDE).image.astype(int)
    np.testing.assert_array_equal(shown("--light", "left", "--strength", 0), taken)
    half = shown("--light", "left", "--strength", 0.5)
    assert 0.3 < np.abs(half - taken).mean() / np.abs(left - taken).mean() < 0.7
    changed = np.abs(left - taken).sum(axis=2) > 10
    even = shown("--light", "left", "--ambient", 1)
    assert left[changed].std() > even[changed].std()
    warm = shown("--light", "left", "--colour", "1,0.6,0.2")
    ratios = (warm[changed] / np.maximum(left[changed], 1)).mean(axis=0)
    assert ratios[0] > 1.1 * ratios[2]


def test_a_start_for_each_picture(relight, tmp_path):
    for name, time in (("lit", 0.3), ("other", 0.6)):
        write_landmarks(tmp_path / f"{name}.pts", moving_scene(time).landmarks)
    options = ("--init", tmp_path, "--light", "other.png")
    assert relight(*options, "-o", tmp_path / "out.jpg", "-m", "li")[0] == 0
    assert read_image(tmp_path / "out.jpg").shape == (160, 120, 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--light", "0,0,0"), "not all 0"),
        (("--light", "1,nan,0"), "give flat, own, the direction of a lamp as x,y,z"),
        (("--light", "1,2"), "give flat, own, the direction of a lamp as x,y,z"),
        (("--light", "own", "--no-balance"), "which --no-balance keeps"),
        (("-o", "lit.png"), "lit.png is one of the input images"),
        (("--light", "other.png", "-o", "other.png"), "other.png is one of the input images"),
        (("-o", "lit.txt"), "name of an image file, such as lit.png"),
        (("-o", "nowhere/a.png"), "nowhere does not exist"),
        (("-m", "grey"), "method grey does not fit a log-RGB appearance"),
        (("--light", "gone.png"), "gone.png"),
        (("--light", "north"), r"or its name \(left, right, above, below, front\)"),
        (("--light", "left", "--colour", "red"), "--colour red: give red, green and blue from 0 to 1"),
        (("--light", "left", "--colour", "1,2,0"), "give red, green and blue from 0 to 1"),
        (("--strength", "1.5"), "strength 1.5: give a share of the change"),
        (("--light", "left", "--ambient", "-1"), "ambient light -1: give a fraction"),
    ],
)
def test_what_makes_no_sense_is_refused(relight, files, options, message):
    before = (files / "lit.png").read_bytes(), (files / "other.png").read_bytes(), sorted(files.iterdir())
    code, _, err = relight(*options)
    assert code == 1
    assert err.startswith("error: ")
    assert re.search(message, err), err
    assert ((files / "lit.png").read_bytes(), (files / "other.png").read_bytes(), sorted(files.iterdir())) == before


def test_grey_pictures_are_refused(run, files, tmp_path):
    grey = moving_scene(0.3).image.mean(axis=2).astype(np.uint8)
    write_image(tmp_path / "grey.png", grey)
    code, _, err = run("relight", files / "head.liaam", tmp_path / "grey.png", "-o", tmp_path / "out.png")
    assert code == 1
    assert "grey.png" in err
    assert "grey (three equal channels)" in err
    assert not (tmp_path / "out.png").exists()


def test_grey_models_are_refused(run, files, head_model, tmp_path):
    replace(head_model, is_colour=False).save(tmp_path / "grey.liaam")
    code, _, err = run("relight", tmp_path / "grey.liaam", files / "lit.png", "-o", tmp_path / "out.png")
    assert code == 1
    assert "grey.liaam: the model was trained on grey images" in err
    assert "train on colour images" in err


def test_a_fit_that_fails_is_told_and_the_picture_written(run, files, tmp_path, rng):
    write_image(tmp_path / "noise.png", rng.integers(40, 200, (160, 120, 3)).astype(np.uint8))
    code, out, err = run("relight", files / "head.liaam", tmp_path / "noise.png", "-o", tmp_path / "out.png")
    assert code == 1
    assert "noise.png: " in err
    assert "the image was relit all the same: check it" in " ".join(err.split())
    assert "written to" in out
    assert read_image(tmp_path / "out.png").shape == (160, 120, 3)


def test_several_images_go_into_a_folder_and_a_broken_one_stops_nothing(run, files, tmp_path):
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"no image")
    code, out, err = run(
        "relight", files / "head.liaam", files / "lit.png", broken, files / "other.png", "-o", tmp_path
    )
    assert code == 1
    assert f"written to {tmp_path}" in out
    assert "broken.png" in err
    assert [path.name for path in sorted(tmp_path.glob("*_flat.png"))] == ["lit_flat.png", "other_flat.png"]


def test_several_images_need_a_folder(run, files, tmp_path):
    images = files / "lit.png", files / "other.png"
    code, _, err = run("relight", files / "head.liaam", *images, "-o", tmp_path / "one.png")
    assert code == 1
    assert "one.png is not a folder" in err


def test_images_of_one_name_in_two_folders_do_not_overwrite_each_other(run, files, tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_image(tmp_path / name / "lit.png", moving_scene(0.3, SIDE).image)
    code, _, err = run("relight", files / "head.liaam", tmp_path / "a/lit.png", tmp_path / "b/lit.png", "-o", tmp_path)
    assert (code, err) == (0, "")
    assert len(list(tmp_path.glob("*_flat.png"))) == 2


def test_a_map_of_certainty_is_written_beside_the_picture(relight, tmp_path):
    code, _, _ = relight("--certainty", "-o", tmp_path / "flat.png")
    assert code == 0
    known = read_image(tmp_path / "flat_certainty.png")
    assert known.shape[:2] == read_image(tmp_path / "flat.png").shape[:2]
    assert known.max() > 150
    assert known[0, 0].max() == 0


def test_strict_writes_nothing_of_what_is_doubtful(run, files, tmp_path, rng):
    write_image(tmp_path / "noise.png", rng.integers(0, 255, (120, 90, 3), np.uint8))
    code, _, err = run("relight", files / "head.liaam", tmp_path / "noise.png", "--strict", "-o", tmp_path / "out.png")
    assert code == 1
    assert "nothing was written" in err
    assert not (tmp_path / "out.png").exists()
