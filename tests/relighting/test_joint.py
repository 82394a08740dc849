"""Appearance and shading told at once: exact where the picture is as the model says, and never undefined."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.relit import train_on_flat_light
from liaam.model import MESH
from liaam.relighting.appearance import ShadowFree
from liaam.relighting.extrapolation import averaged
from liaam.relighting.shading import appearance_in_light, as_in_training
from scenes import Head

AMBIENT, LAMP = np.array([0.10, 0.12, 0.15]), np.array([1.1, 0.9, 0.6])
NOISE = 1e-6


@pytest.fixture(scope="module")
def faces():
    return train_on_flat_light(Head(5), 6, (240, 180), leave_out=False, diagonal=110.0)


def first_guess(faces) -> ShadowFree:
    known = faces.levels[-1].appearances["log"]
    return ShadowFree(known.mean, np.zeros(known.n_modes), np.sqrt(known.eigenvalues))


def one_lamp(faces) -> np.ndarray:
    """Logarithm of what lamp and ambient light send, (n_pixels, 3): from shadow on the left, with a cast shadow."""
    x, y = (faces.frame.pixels[:, ::-1] / np.array(faces.frame.size)).T
    share = np.clip(1.4 * x - 0.2, 0, 1) * ~((x > 0.55) & (x < 0.7) & (y > 0.5) & (y < 0.8))
    return np.log(AMBIENT + share[:, None] * LAMP)


def seen_as(faces, log_rgb: np.ndarray, usable: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n = faces.n_pixels
    return log_rgb.astype(np.float32), np.full(n, usable, np.float32), np.full((n, 3), NOISE, np.float32)


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def a_face(faces, rng) -> tuple[np.ndarray, np.ndarray]:
    known = faces.levels[-1].appearances["log"]
    lam = rng.normal(0, 1, known.n_modes) * np.sqrt(known.eigenvalues)
    return lam, known.texture(lam)


def test_one_lamp_is_taken_off(faces, rng):
    _, truth = a_face(faces, rng)
    start = first_guess(faces)
    found = appearance_in_light(faces, *seen_as(faces, truth + one_lamp(faces)))[0]
    assert rms(found.log_rgb - truth) < 0.2 * rms(start.log_rgb - truth)


def test_another_exposure_and_white_balance_are_no_light(faces, rng):
    _, truth = a_face(faces, rng)
    level = np.array([-0.2, -0.3, -0.4])
    unlit, lit = (
        appearance_in_light(faces, *seen_as(faces, truth + more))[0] for more in (level, level + one_lamp(faces))
    )
    assert np.abs(unlit.light).max() < 0.02
    assert np.abs(lit.light).max() > 0.3


def test_without_a_change_of_light_the_appearance_is_the_picture(faces, rng):
    _, truth = a_face(faces, rng)
    found = appearance_in_light(faces, *seen_as(faces, truth))[0]
    assert rms(found.log_rgb - truth) < 0.1 * rms(first_guess(faces).log_rgb - truth)


def test_the_level_of_light_is_not_taken_for_the_object(faces, rng):
    _, truth = a_face(faces, rng)
    found, other = (appearance_in_light(faces, *seen_as(faces, truth + level))[0] for level in (0.0, -1.2))
    np.testing.assert_allclose(other.log_rgb, found.log_rgb, atol=0.02)


def test_what_the_picture_does_not_show_stays_as_it_was(faces):
    start = first_guess(faces)
    found = appearance_in_light(faces, *seen_as(faces, np.full((faces.n_pixels, 3), -5.0), 0.0))[0]
    np.testing.assert_array_equal(found.lam, start.lam)
    assert not found.light.any()


@pytest.mark.parametrize("usable", [1, 2, 50])
def test_a_few_pixels_are_enough_for_an_answer(faces, rng, usable):
    _, truth = a_face(faces, rng)
    seen = seen_as(faces, truth + one_lamp(faces), 0.0)
    seen[1][rng.permutation(faces.n_pixels)[: usable * 10]] = 1.0
    found = appearance_in_light(faces, *seen)[0]
    assert np.isfinite(found.log_rgb).all()
    assert np.isfinite(found.deviations).all()


def test_models_without_pictures_left_out_will_do(faces, rng):
    level = faces.levels[-1]
    known = replace(level.appearances["log"], unexplained=None)
    plain = faces.with_view(
        MESH, levels=(*faces.levels[:-1], replace(level, appearances={**level.appearances, "log": known}))
    )
    _, truth = a_face(faces, rng)
    found = appearance_in_light(plain, *seen_as(plain, truth + one_lamp(plain)))[0]
    assert rms(found.log_rgb - truth) < 0.3 * rms(first_guess(plain).log_rgb - truth)


def test_averages_stay_on_their_side_of_an_edge(rng):
    seen = np.zeros((40, 50, 3), np.float32)
    seen[:, 25:] = -2.0
    layers = np.where(seen[..., :1] < 0, 5.0, 1.0) + rng.normal(0, 0.3, (40, 50, 1))
    smooth = averaged(layers, seen, 8.0)
    assert np.abs(smooth[:, :25] - 1.0).max() < 0.3
    assert np.abs(smooth[:, 25:] - 5.0).max() < 0.3
    np.testing.assert_allclose(averaged(np.full((9, 12, 2), 3.0), rng.normal(size=(9, 12, 3)), 4.0), 3.0, rtol=1e-5)


def test_no_light_is_more_likely_where_the_data_say_so():
    assert as_in_training(np.zeros(4), 0.1 * np.eye(4)) > 0.98
    assert as_in_training(np.full(4, 2.0), 0.1 * np.eye(4)) < 1e-6
    assert as_in_training(np.zeros(4), np.eye(4)) == pytest.approx(0.5)  # nothing was learnt
