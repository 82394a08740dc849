"""Pictures of one person, and the shadow that is laid over them."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from experiments.subjects import (
    PAPER_THETA,
    folder_subject,
    head_scenes,
    random_side,
    reduced_points,
    scene_subject,
    simulated_shadow,
    subject_facts,
)
from liaam.errors import LiaamError
from liaam.io import write_image, write_landmarks
from liaam.model.shape import diagonal_of
from liaam.photometry import invariant, srgb_to_linear
from scenes import DIFFUSE, Head, make_set


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Give a folder of seven small portraits; one has an odd size."""
    path = tmp_path_factory.mktemp("person")
    for i, scene in enumerate(make_set(7, Head(5), size=(160, 120))):
        image = scene.image[:-1, :-1] if i == 0 else scene.image
        write_image(path / f"{i}.png", image)
        write_landmarks(path / f"{i}.pts", scene.landmarks)
    return path


def test_halving_keeps_landmarks_on_their_pixels():
    # The centre of the block of pixels (0, 0), (1, 0), (0, 1), (1, 1) is the new pixel (0, 0).
    assert np.allclose(
        reduced_points(np.array([[0.5, 0.5], [2.5, 4.5], [-0.5, -0.5]]), 2), [[0, 0], [1, 2], [-0.5, -0.5]]
    )
    blob = np.zeros((20, 30, 3))
    blob[7, 12] = blob[7, 13] = 1.0  # centre of mass: (12.5, 7)
    halved = blob.reshape(10, 2, 15, 2, 3).mean(axis=(1, 3))[..., 0]
    y, x = np.nonzero(halved)
    assert np.allclose(reduced_points(np.array([[12.5, 6.5]]), 2), [[x.mean(), y.mean()]])


def test_folder_gives_pictures_spread_over_it(folder):
    subject = folder_subject(folder, n_images=3)
    assert [image.shape for image in subject.images] == [(79, 59, 3), (80, 60, 3), (80, 60, 3)]
    assert all(image.dtype == np.float32 and 0 <= image.min() <= image.max() <= 1 for image in subject.images)
    assert subject_facts(folder, 3)["pictures"] == ["0", "3", "6"]
    whole = folder_subject(folder, n_images=3, halve=False)
    assert whole.images[1].shape == (160, 120, 3)
    assert np.allclose(2 * subject.shapes[1] + 0.5, whole.shapes[1])
    block = srgb_to_linear(whole.images[1][40:42, 30:32]).mean(axis=(0, 1))
    assert np.allclose(srgb_to_linear(subject.images[1][20, 15]), block, atol=2e-3)


def test_facts_notice_a_changed_picture(folder, tmp_path):
    digests = {subject_facts(folder, n)["digest"] for n in (3, 4)}
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    assert subject_facts(tmp_path, 3)["digest"] in digests
    write_landmarks(tmp_path / "3.pts", scene_subject(1).shapes[0])
    assert subject_facts(tmp_path, 3)["digest"] not in digests


def test_too_few_or_grey_pictures_are_refused(folder, tmp_path):
    with pytest.raises(LiaamError, match=r"holds 7 landmarked pictures, but 8 .*add some"):
        folder_subject(folder, 8)
    with pytest.raises(LiaamError, match="holds 7"):
        subject_facts(folder, 8)
    scene = make_set(1, size=(60, 60))[0]
    write_image(tmp_path / "a.png", np.repeat(scene.image[..., :1], 3, axis=2))
    write_landmarks(tmp_path / "a.pts", scene.landmarks)
    with pytest.raises(LiaamError, match="a is grey"):
        folder_subject(tmp_path, 1)


def test_generated_subject_is_without_noise_and_of_the_size_of_the_real_one():
    subject = scene_subject(2)
    assert all(170 < diagonal_of(shape) < 210 for shape in subject.shapes)
    assert subject.images[0].dtype == np.float32
    again = head_scenes(DIFFUSE, 2)[1]
    assert np.array_equal(again.image, subject.images[1])


@given(st.floats(0, 6.3), st.floats(-2.5, 0), st.floats(0, 0.9), st.integers(0, 2**32 - 1))
def test_shadow_does_not_move_the_invariant_of_its_camera(side, strength, temperature, seed):
    image = np.random.default_rng(seed).uniform(0.2, 0.95, (24, 32, 3)).astype(np.float32)
    shape = np.array([[6.0, 4.0], [25.0, 8.0], [16.0, 20.0]])
    shadowed, mask = simulated_shadow(image, shape, side, strength=strength, temperature=temperature)
    before, after = (np.log(srgb_to_linear(picture.astype(np.float64))) for picture in (image, shadowed))
    inside = shadowed.max(axis=-1) < 1.0  # not cut
    assert np.abs(invariant(after - before, PAPER_THETA)[inside]).max(initial=0.0) < 2e-4
    change = (after - before).sum(axis=-1)[inside]  # d is orthogonal to 1
    assert np.allclose(change, 3 * strength * mask[inside], atol=5e-4)


def test_shadow_covers_one_half_and_has_a_soft_edge(rng):
    image = np.full((41, 61, 3), 0.5, np.float32)
    shape = np.array([[20.0, 10.0], [40.0, 30.0]])
    _, mask = simulated_shadow(image, shape, 0.0)
    assert mask[:, 30] == pytest.approx(0.5)
    assert mask[20, 32] - mask[20, 28] == pytest.approx(np.tanh(1.0))
    assert mask[:, :15].max() < 1e-3
    assert mask[:, 45:].min() > 1 - 1e-3
    sides = np.array([random_side(rng) for _ in range(200)])
    assert 60 < (np.cos(sides) > 0).sum() < 140
    assert np.abs(np.cos(sides)).min() > np.cos(np.deg2rad(20.1))
