"""Generated objects that vary: the same from a seed, with landmarks where they are drawn."""

import numpy as np
import pytest

from scenes.varied import AnimalFromAbove, Fish, JointedBars, WalkingAnimal

KINDS = {Fish: 14, WalkingAnimal: 22, AnimalFromAbove: 9, JointedBars: 12}


@pytest.mark.parametrize(("kind", "n_landmarks"), KINDS.items(), ids=lambda each: getattr(each, "__name__", ""))
def test_pictures_follow_from_the_seed(kind, n_landmarks):
    def drawn(seed: int):
        rng = np.random.default_rng(seed)
        return kind.drawn(rng).picture(rng)

    image, landmarks = drawn(3)
    again, same_landmarks = drawn(3)
    assert image.dtype == np.uint8 and landmarks.shape == (n_landmarks, 2)
    np.testing.assert_array_equal(again, image)
    np.testing.assert_array_equal(same_landmarks, landmarks)
    assert not np.allclose(drawn(4)[1], landmarks)
    height, width = image.shape[:2]
    inside = ((landmarks >= 0) & (landmarks <= (width - 1, height - 1))).all(axis=1)
    assert inside.mean() > 0.8


def test_landmarks_of_bars_are_their_corners(rng):
    kind = JointedBars.drawn(rng)
    _, landmarks = kind.picture(rng)
    corners = landmarks.reshape(3, 4, 2)
    widths = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    lengths = np.linalg.norm(corners[:, 2] - corners[:, 1], axis=1)
    np.testing.assert_allclose(lengths / lengths[0], kind.lengths / kind.lengths[0])
    np.testing.assert_allclose(widths / widths[0], kind.widths / kind.widths[0])


def test_a_fish_varies_by_the_amount(rng):
    kind = Fish.drawn(rng)
    depths = np.array([kind.varied(rng, 0.1).depth for _ in range(400)])
    assert np.log(depths / kind.depth).std() == pytest.approx(0.1, rel=0.15)
    assert kind.varied(rng, 0.0).depth == kind.depth
