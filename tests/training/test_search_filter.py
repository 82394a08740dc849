"""The learnt filter of the search: it responds to the object, in any rotation, and a mirrored model has its mirror."""

from dataclasses import replace

import numpy as np
import pytest

import liaam
from liaam.errors import ModelFileError
from liaam.fitting import Finder
from liaam.fitting.loop.levels import LinearImage
from liaam.fitting.search.templates import Grey
from liaam.model.mirror import mirrored_model
from liaam.model.shape import align, diagonal_of, mirror_order
from scenes import DIFFUSE, Head, Pose, narrow_band_camera, render
from setups import train_on


def photograph(roll: float):
    pose = Pose(scale=0.7, roll=np.deg2rad(roll))
    return render(Head(7), pose, lights=DIFFUSE, camera=narrow_band_camera(), size=(240, 300), mixing="planckian")


def strongest(model, image, size):
    """Return centre, response and rotation of the filter's strongest response at one size."""
    finder = Finder(model)
    field = Grey.of(image, model.response, 1.0).field(size, finder.small)
    peaks = finder.filters.peaks(field, 0, 1, 0.0)
    best = int(peaks.responses.argmax())
    return peaks.centres[best], peaks.responses[best], finder.filters.templates[peaks.templates[best]].turn


@pytest.mark.parametrize("roll", [-10.0, 0.0, 20.0])
def test_it_responds_most_where_the_object_is(model, roll):
    scene = photograph(roll)
    centre, response, turn = strongest(model, scene.image, diagonal_of(scene.landmarks))
    true = align(model.shape_model.mean, scene.landmarks)
    assert np.linalg.norm(centre - true.offset) < 0.1 * diagonal_of(scene.landmarks)
    assert response > 0.7  # on average 1 in training, where poses differ a little
    assert np.rad2deg(turn) == pytest.approx(roll, abs=10.1)


def test_responses_to_noise_are_low(model, rng):
    _, response, _ = strongest(model, rng.uniform(size=(240, 300, 3)), 100.0)
    assert response < 0.5


def test_a_mirrored_model_has_its_mirror_image(model):
    order = mirror_order(model.shape_model.mean)
    other = mirrored_model(replace(model, light=None, points=None), order)
    scene = photograph(10.0)
    size = diagonal_of(scene.landmarks)
    seen = strongest(model, scene.image, size)
    mirrored = strongest(other, np.ascontiguousarray(scene.image[:, ::-1]), size)
    assert mirrored[0] == pytest.approx([scene.image.shape[1] - 1 - seen[0][0], seen[0][1]], abs=1.5)
    assert mirrored[1] == pytest.approx(seen[1], abs=0.03) and mirrored[2] == -seen[2]


def test_models_without_it_look_with_templates(model):
    image = LinearImage(photograph(0.0).image, model.response)
    without = Finder(replace(model, search_filter=None))
    assert without.filters is without.templates
    assert len(without.others_in(image, 2)) <= len(Finder(model).others_in(image, 2)) + 2


def test_training_again_gives_the_same(scenes, model, lamps):
    again = train_on(scenes, diagonal=80.0, lamps=lamps, leave_out=False)
    np.testing.assert_array_equal(again.search_filter, model.search_filter)


def test_a_file_with_a_filter_of_a_wrong_shape_is_refused(model, tmp_path):
    replace(model, search_filter=np.zeros((3, 500, 2), np.float32)).save(tmp_path / "wrong.liaam")
    with pytest.raises(ModelFileError, match="search_filter has shape"):
        liaam.load_model(tmp_path / "wrong.liaam")
