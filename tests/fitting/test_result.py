"""What users do with a result: keep it as JSON, draw it, and look at it in a notebook."""

import io
import json
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from PIL import Image

import liaam
from liaam.errors import ImageError, LiaamError
from liaam.fitting import FitStatus, Fitter, fit_many
from liaam.io import write_image
from setups import disturb

matplotlib.use("Agg")


@pytest.fixture(scope="module")
def image(lit_scene) -> np.ndarray:
    return lit_scene.image


@pytest.fixture(scope="module")
def result(model, image, lit_scene) -> liaam.FitResult:
    return liaam.fit(model, image, disturb(lit_scene.landmarks))


def test_a_result_survives_json(result):
    facts = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    np.testing.assert_array_equal(facts["landmarks"], result.landmarks)
    assert facts["status"] == str(result.status)
    assert facts["method"] == "soft-li"
    assert facts["quality"] is None  # the model was trained without leaving images out
    assert facts["image"] is None  # an array has no name


def test_what_is_not_a_number_becomes_none(model, image):
    lost = liaam.fit(model, np.zeros_like(image), (10, 10, 60, 60))
    json.dumps(lost.to_dict(), allow_nan=False)


def test_a_result_draws_its_image_landmarks_and_ellipses(result, image):
    ax = result.plot()
    assert np.asarray(ax.images[0].get_array()).shape == image.shape
    dots = ax.lines[-1]  # over all else
    np.testing.assert_array_equal(np.transpose(dots.get_data()), result.landmarks)
    assert dots.get_color() == FitStatus.CONVERGED.colour
    n_ellipses = len(ax.lines) - len(result.contours) - 1
    assert n_ellipses == len(result.landmarks)
    assert len(result.plot(ellipses=False).lines) == len(ax.lines) - n_ellipses
    assert result.plot(ax=ax) is ax
    colours = {status.colour for status in FitStatus}
    assert len(colours) == 3  # may be used, to check, failed
    assert replace(result, status=FitStatus.DOUBTFUL).plot().lines[-1].get_color() == FitStatus.DOUBTFUL.colour


@pytest.fixture
def damaged(result) -> liaam.FitResult:
    """Give a fit whose second landmark is absent."""
    present = np.full(len(result.landmarks), 0.99)
    present[1] = 0.01
    return replace(result, present=present, status=liaam.FitStatus.CONVERGED, quality=0.9)


def test_absent_landmarks_are_empty_in_tables_unless_asked_for(damaged):
    facts = json.loads(json.dumps(damaged.to_dict(), allow_nan=False))
    assert facts["landmarks"][1] == [None, None]
    assert facts["sd"][1] is None
    assert facts["covariance"][1] == [None, None, None]
    assert facts["present"][:3] == [0.99, 0.01, 0.99]
    np.testing.assert_array_equal(facts["landmarks"][2], damaged.landmarks[2])
    table = damaged.to_dataframe()
    assert table.x.isna().tolist() == damaged.absent.tolist() == table.sd.isna().tolist()
    together = liaam.to_dataframe([damaged, damaged])
    assert together.x.isna().sum() == 2
    np.testing.assert_array_equal(damaged.to_dict("estimate")["landmarks"], damaged.landmarks)
    assert not damaged.to_dataframe(absent="estimate").isna().any().any()
    assert not liaam.to_dataframe([damaged, damaged], absent="estimate").isna().any().any()
    with pytest.raises(LiaamError, match="absent 'none' is unknown; choose from empty, estimate"):
        damaged.to_dict("none")


def test_a_specimen_has_what_the_fit_knows_of_it(damaged):
    of_left = replace(damaged, side="left", image=Path("new/fly.jpg"))
    specimen = liaam.Specimen.of_fit(of_left)
    assert (specimen.name, specimen.image, specimen.side, specimen.status) == ("fly", "fly.jpg", "left", "converged")
    assert np.isnan(specimen.points).any(axis=1).tolist() == damaged.absent.tolist() and specimen.estimated == ()
    estimated = liaam.Specimen.of_fit(of_left, "wing", absent="estimate")
    assert estimated.name == "wing" and estimated.estimated == (1,)
    np.testing.assert_array_equal(estimated.points, damaged.landmarks)
    with pytest.raises(LiaamError, match="the image of the fit is from no file: give the specimen a name"):
        liaam.Specimen.of_fit(damaged)


def test_a_message_names_the_absent_landmarks(damaged):
    assert "Absent: 2. The image there" in damaged.message
    names = tuple(f"p{i}" for i in range(len(damaged.landmarks)))
    assert "Absent: p1. " in replace(damaged, landmark_names=names).message
    assert "Absent" not in replace(damaged, present=None).message


def test_fits_that_are_not_ok_keep_all_landmarks_for_whom_corrects_them(damaged):
    doubtful = replace(damaged, status=liaam.FitStatus.DOUBTFUL)
    np.testing.assert_array_equal(doubtful.to_dict()["landmarks"], damaged.landmarks)
    assert "Absent" not in doubtful.message


def test_a_doubtful_fit_says_that_most_of_its_landmarks_are_absent(damaged):
    doubtful = replace(damaged, status=liaam.FitStatus.DOUBTFUL)
    assert doubtful.message == liaam.FitStatus.DOUBTFUL.message
    mostly = replace(doubtful, present=np.full(len(damaged.landmarks), 0.1))
    assert "the image around most of its landmarks is not what the model expects" in mostly.message
    assert "quality is low" not in mostly.message


def test_absent_landmarks_are_drawn_as_rings(damaged):
    ax = damaged.plot(ellipses=False)
    *_, points, rings = ax.lines
    assert len(points.get_xdata()) == len(damaged.landmarks) - 1
    np.testing.assert_array_equal(np.transpose(rings.get_data()), damaged.landmarks[1:2])


def test_a_notebook_shows_the_object(result):
    with Image.open(io.BytesIO(result._repr_png_())) as shown:
        pixels = np.asarray(shown.convert("RGB")).reshape(-1, 3)
    assert ((pixels == [0x40, 0xFF, 0x8C]).all(axis=1)).any()  # landmarks are drawn


def test_results_of_paths_know_their_image_and_others_keep_none(model, image, lit_scene, tmp_path):
    path = tmp_path / "face.png"
    write_image(path, (image * 255).astype(np.uint8))
    start = disturb(lit_scene.landmarks)
    fitter = Fitter(model)
    by_path = fitter.fit(path, start)
    assert by_path.to_dict()["image"] == "face.png"
    assert by_path._repr_png_() is not None
    by_array = fitter.fit(image, start)
    assert by_array.image is None
    assert by_array._repr_png_() is None
    assert by_array.plot(image).images
    assert not by_array.plot().images


def test_fit_and_fit_many_take_what_a_fitter_takes(model, image, lit_scene):
    start = disturb(lit_scene.landmarks)
    settings = {"restarts": False, "margin": 0.3, "max_iterations": 2}
    one = liaam.fit(model, image, start, "li", **settings)
    (many,) = fit_many(model, [image], start, "li", **settings)
    np.testing.assert_array_equal(one.landmarks, many.landmarks)
    np.testing.assert_array_equal(one.landmarks, Fitter.of(model, "li", **settings).fit(image, start).landmarks)


def test_a_result_whose_image_has_gone_says_so(model, image, lit_scene, tmp_path):
    path = tmp_path / "face.png"
    write_image(path, (image * 255).astype(np.uint8))
    result = Fitter(model).fit(path, disturb(lit_scene.landmarks))
    path.unlink()
    with pytest.raises(ImageError, match=r"face\.png"):
        result.plot()
