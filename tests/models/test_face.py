"""The face model that comes with liaam."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import liaam
from liaam.cli.inputs import model_and_inputs
from liaam.datasets import load_face
from liaam.errors import LiaamError
from liaam.fitting import Fitter
from liaam.fitting.loop.objective import pixels_for
from liaam.io import read_image, read_landmarks
from liaam.models import model_file
from liaam.morphometry import read_specimens
from liaam.morphometry.schemes import in_scheme
from liaam.relighting import Relighter

ROOT = Path(__file__).resolve().parents[2]
MADE_BY = ROOT / "making/face"
FACE_PICTURE = ROOT / "src/liaam/datasets/pictures/face/lisa.jpg"

EIGHT = {
    "right_eye_outer": 35,
    "right_eye_inner": 39,
    "left_eye_inner": 44,
    "left_eye_outer": 48,
    "mouth_right": 86,
    "mouth_left": 92,
    "upper_lip_top": 89,
    "lower_lip_bottom": 103,
}
"""Landmarks of the model that the photograph also has, in its own scheme."""


@pytest.fixture(scope="module")
def face():
    return liaam.load_model("face")


def far_from_photograph(names, points) -> float:
    """Mean distance of the eight common points from those of the photograph, in parts of the eyes' distance."""
    sample = load_face()
    truth = sample.landmarks.points[list(EIGHT.values())]
    own = np.asarray(points)[[list(names).index(name) for name in EIGHT]]
    eyes = np.linalg.norm(truth[:2].mean(0) - truth[2:4].mean(0))
    return float(np.linalg.norm(own - truth, axis=1).mean() / eyes)


def test_it_names_its_landmarks_and_credits_its_sources(face):
    assert face is liaam.load_model("face")  # read once
    assert set(EIGHT) | {"chin"} <= set(face.landmark_names)
    assert "CC BY 4.0" in face.card.licence and "10.6084/m9.figshare.5047666" in face.card.credit
    assert not face.card.missing
    assert model_file("face").stat().st_size <= 12e6


def test_its_parts_hold_all_pixels_that_fits_use(face):
    for part in face.parts:
        view = part.views["surroundings"]
        for level in view.levels:
            assert level.appearances["soft"].mask[pixels_for(view.warp, level.blur)].all()


def test_it_has_the_relief_of_a_face(face):
    """Cheeks face outwards, and the middle of the face the viewer."""
    assert face.relief is not None
    x = face.relief[64, :, 0]
    assert x[50] < -0.1 < 0.1 < x[78]
    assert np.abs(x[64]) < 0.2


def test_turned_copies_are_no_further_images(face, run):
    assert face.n_all_images == face.n_images == 254 and face.n_copies > 3 * 254
    _, out, _ = run("show", "face")
    assert "254 images and" in out and "3, each with a model of its own, from copies of the same images" in out


def test_bits_do_not_depend_on_the_threads_of_blas():
    image = read_image(FACE_PICTURE)
    fits = []
    for n_threads in (1, 3):
        with threadpool_limits(n_threads, user_api="blas"):
            fitter = Fitter(liaam.load_model(model_file("face")))  # nothing is prepared yet
            result = fitter.fit(image)
            fits.append((result, Relighter.of(fitter, image, result)))
    (one, relit_by_one), (several, relit_by_several) = fits
    np.testing.assert_array_equal(one.landmarks, several.landmarks)
    np.testing.assert_array_equal(one.landmark_covariances, several.landmark_covariances)
    np.testing.assert_array_equal(relit_by_one.frame_shading.log, relit_by_several.frame_shading.log)
    np.testing.assert_array_equal(relit_by_one.flat(), relit_by_several.flat())


def test_left_and_right_are_the_persons(face):
    mean = dict(zip(face.landmark_names, face.shape_model.mean, strict=True))
    for name in face.landmark_names:
        if "right" in name:
            assert mean[name][0] < mean[name.replace("right", "left")][0]


def test_it_fits_the_photograph_that_comes_with_liaam():
    result = liaam.fit("face", load_face().image)
    assert result.status.ok and result.quality > 0.5
    assert far_from_photograph(result.landmark_names, result.landmarks) < 0.06


def test_a_turned_head_is_relit_by_the_light_that_was_learnt_of_frontal_ones(face):
    image, fitter = read_image(load_face().image), Fitter(face)
    result = fitter.fit(image)
    assert face.light is not None and face.parts[1].light is None
    flat, turned = (Relighter.of(fitter, image, replace(result, part=part)).flat() for part in (0, 1))
    assert np.array_equal(flat, turned)


def test_fit_without_a_model_takes_it_and_writes_other_schemes(run, tmp_path):
    code, out, err = run("fit", load_face().image, "-o", tmp_path)
    assert (code, err) == (0, "") and "converged" in out
    found = read_landmarks(tmp_path / "lisa.json")
    assert far_from_photograph(found.names, found.points) < 0.06
    assert (tmp_path / "lisa_fit.png").exists()
    scheme = ("--scheme", "ibug-68", "--format", "json,pts")
    assert run("fit", load_face().image, *scheme, "-o", tmp_path)[0] == 0  # over it
    points = read_landmarks(tmp_path / "lisa.pts").points
    assert np.allclose(points, in_scheme(found.points, found.names, "ibug-68"), atol=0.01)
    names = dict(zip((36, 39, 42, 45, 48, 54, 51, 57), EIGHT, strict=True))
    assert far_from_photograph(names.values(), points[list(names)]) < 0.06
    fit = json.loads((tmp_path / "lisa.json").read_text())
    assert len(fit["landmarks"]) == 68 and not {"landmark_names", "sd", "covariance"} & fit.keys()
    assert len(read_specimens(tmp_path)[0].points) == 68


@pytest.mark.parametrize(
    ("files", "model"),
    [
        ("a.JPG", "face"),
        ("a.nef b.png", "face"),
        ("face a.jpg", "face"),
        ("m.liaam a.jpg b", "m.liaam"),
        ("m a", "m"),
        ("images/**", "face"),  # as of 'liaam batch'
        ("-", "face"),
        ("talk.mp4", "face"),  # as of 'liaam track'
        ("0", "face"),
    ],
)
def test_a_first_file_that_is_no_image_is_the_model(files, model):
    files = [Path(name) for name in files.split()]
    found, images = model_and_inputs(files, "fit")
    assert found == Path(model)
    assert images == files[len(files) - len(images) :] and images


def test_a_model_file_is_no_pattern_and_no_camera_whatever_its_name(tmp_path):
    for name in ("m[1].liaam", "0"):
        path = tmp_path / name
        path.touch()
        assert model_and_inputs([path, Path("a.jpg")], "fit") == (path, [Path("a.jpg")])


def test_a_model_without_images_is_refused(run):
    for command in ("fit", "relight"):
        code, _, err = run(command, "face")
        assert code == 1 and f"give the images, too, as in 'liaam {command} MODEL IMAGE...'" in err


def test_many_images_and_videos_need_no_model_either(run, tmp_path):
    folder = tmp_path / "frames"
    folder.mkdir()
    shutil.copy(FACE_PICTURE, folder / "1.jpg")
    for command, table in (("batch", tmp_path / "r.csv"), ("track", tmp_path / "t.csv")):
        code, _, err = run(command, folder, "-o", table)
        assert (code, err) == (0, "")
        assert len(table.read_text().splitlines()) == 2
    code, _, err = run("track", "face", folder, folder)
    assert code == 1 and "2 videos are given; give one" in err


def test_show_tells_its_terms(run, face, tmp_path):
    for command in (("show", "face", "-o", tmp_path / "face.png"), ("show",)):
        code, out, _ = run(*command)
        assert code == 0 and "CC BY 4.0" in out and "figshare.5047666" in out
    assert (tmp_path / "face.png").exists()
    assert all(text in " ".join(out.split()) for text in face.card.stated.values())  # long ones are wrapped


def test_the_card_is_kept_in_files(face, tmp_path):
    liaam.compact(face).save(tmp_path / "other.liaam")
    assert liaam.load_model(tmp_path / "other.liaam").card == face.card


def test_what_makes_it_agrees_with_it(face):
    """The names and contours are those of the model, and the smiling faces have all of its landmarks."""
    made = json.loads((MADE_BY / "points.json").read_text())
    assert tuple(point["name"] for point in made["points"]) == face.landmark_names
    lines = [
        [face.landmark_names[i] for i in line] + [face.landmark_names[line[0]]] * closed
        for line, closed in face.contours
    ]
    assert lines == made["contours"]


def test_its_data_and_terms_are_told(face):
    text = (ROOT / "LICENSE-DATA").read_text(encoding="utf-8")
    for doi in ("5047666.v5", "4220517.v1", "4055130.v1"):
        assert doi in text and doi in face.card.credit
    assert len(list((ROOT / "src/liaam/datasets/pictures/face").glob("*.jpg"))) <= 12
    assert load_face().image.stat().st_size <= 40_000


def test_a_scheme_refuses_what_it_cannot_use(face):
    mean = face.shape_model.mean
    with pytest.raises(LiaamError, match="scheme 'x' is unknown; choose from ibug-68"):
        in_scheme(mean, face.landmark_names, "x")
    with pytest.raises(LiaamError, match="jaw_right_1 is missing; use that model, or leave the scheme out"):
        in_scheme(mean, (), "ibug-68")


def test_the_scheme_mirrors_with_the_face(face):
    """Right and left are exchanged, and nothing else changes."""
    mean = face.shape_model.mean
    swapped = [
        re.sub("right|left", lambda side: {"right": "left", "left": "right"}[side[0]], name)
        for name in face.landmark_names
    ]
    own, other = in_scheme(mean, face.landmark_names, "ibug-68"), in_scheme(mean * [-1, 1], swapped, "ibug-68")
    assert np.allclose(own[[*range(17)]], other[[*range(16, -1, -1)]] * [-1, 1])
    assert np.allclose(own[[48, 54, 60, 61, 67]], other[[54, 48, 64, 63, 65]] * [-1, 1])
    assert np.allclose(own[[36, 37, 41, 31]], other[[45, 44, 46, 35]] * [-1, 1])
