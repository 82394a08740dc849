"""Mirrored models: they fit mirrored images, and a file holds them once."""

from dataclasses import replace

import numpy as np
import pytest
from test_model_file import forge, parts

import liaam
from liaam.errors import ModelFileError
from liaam.model.mirror import mirrored_model
from liaam.model.shape import mirror_order


@pytest.fixture(scope="module")
def order(model):
    found = mirror_order(model.shape_model.mean)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def of_three(model, order):
    side = replace(model, light=None, points=None)
    return replace(model, others=(side, mirrored_model(side, order)))


def test_a_model_mirrored_twice_is_itself(of_three, order):
    again = mirrored_model(of_three.others[1], order)
    assert again.to_bytes() == of_three.others[0].to_bytes()
    assert of_three.others[1].to_bytes() != of_three.others[0].to_bytes()


def test_it_fits_the_mirrored_image_as_well(of_three, order, lit_scene):
    image = lit_scene.image
    start = lit_scene.landmarks + 1.0
    flipped, width = np.ascontiguousarray(image[:, ::-1]), image.shape[1] - 1.0
    across = lambda points: (points * [-1.0, 1.0] + [width, 0.0])[order]  # noqa: E731
    expected = liaam.fit(of_three.others[0], image, start)
    found = liaam.fit(of_three.others[1], flipped, across(start))
    assert np.abs(found.landmarks - across(expected.landmarks)).max() < 0.05
    assert found.evidence == pytest.approx(expected.evidence, abs=0.005)


def test_a_file_holds_a_mirrored_part_once(of_three, tmp_path):
    path = tmp_path / "three.liaam"
    of_three.save(path)
    header, tensors = parts(path)
    assert header["schema"] == 7 and not any(key.startswith("others/1/") for key in tensors)
    again = liaam.load_model(path)
    assert [part.to_bytes() for part in again.parts] == [part.to_bytes() for part in of_three.parts]
    assert again.to_bytes() == path.read_bytes()


def test_a_mirrored_part_that_is_saved_alone_keeps_its_grid(of_three, tmp_path):
    part, path = of_three.others[1], tmp_path / "side.liaam"
    part.save(path)
    ours, theirs = (each.views["surroundings"].warp.every(3.0) for each in (part, liaam.load_model(path)))
    assert np.array_equal(ours, theirs)
    assert not np.array_equal(ours, replace(part.views["surroundings"].warp, from_right=False).every(3.0))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda order: order[:-1], "has not"),
        (lambda order: [*order[:-1], len(order)], "has not"),
        (lambda order: np.roll(np.arange(len(order)), 1).tolist(), "does not exchange pairs"),
    ],
)
def test_a_wrong_order_is_refused(of_three, tmp_path, change, match):
    path = tmp_path / "three.liaam"
    of_three.save(path)
    header, tensors = parts(path)
    header["others"][1]["mirrored"] = change(header["others"][1]["mirrored"])
    forge(path, header, tensors)
    with pytest.raises(ModelFileError, match=match):
        liaam.load_model(path)
