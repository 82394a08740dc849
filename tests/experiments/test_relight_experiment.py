"""The measures of the relighting of unseen objects, and a small run."""

import json

import numpy as np
import pytest

from experiments.relight import PLAIN, hue_distance, log_luminance, seam_of, skin_of
from liaam.io import write_image, write_landmarks
from scenes import DIFFUSE, Head, lateral, random_expression, random_pose, render


def disc(size: int = 60) -> np.ndarray:
    y, x = np.indices((size, size)) - size / 2
    return np.hypot(x, y) < size / 4


def test_a_pasted_change_has_a_seam_and_a_ramp_has_none():
    inside, x = disc(), np.indices((60, 60))[1] / 60
    assert seam_of(x, inside) == pytest.approx(1.0, abs=0.1)
    assert seam_of(np.where(inside, 1.0 + x, 0.0), inside) > 10.0
    assert np.isnan(seam_of(np.zeros_like(x), inside))


def test_the_hue_distance_ignores_lightness():
    one, other = disc(), ~disc()
    lab = np.where(one[..., None], [40.0, 10.0, 12.0], [70.0, 13.0, 16.0])
    assert hue_distance(lab, one, other) == pytest.approx(5.0)
    assert np.isnan(hue_distance(lab, one, np.zeros_like(one)))


def test_skin_is_looked_for_above_and_below_and_nowhere_else():
    image, inside = np.full((60, 60, 3), (180, 140, 120), np.uint8), disc()
    image[:15] = (20, 20, 20)  # hair
    points = np.stack(np.nonzero(inside)[::-1], axis=1).astype(float)
    skin = skin_of(image, inside, points)
    assert skin["face"].sum() > 0.9 * inside.sum()
    assert skin["jaw"].sum() > 20
    assert not skin["brow"][:15].any()
    assert not (skin["brow"] | skin["jaw"])[inside].any()


@pytest.mark.parametrize("method", PLAIN)
def test_methods_without_a_model_return_images(method, rng):
    image = rng.integers(0, 255, (40, 50, 3)).astype(np.uint8)
    made = PLAIN[method](image)
    assert (made.shape, made.dtype) == (image.shape, image.dtype)
    assert np.isfinite(log_luminance(made)).all()


@pytest.mark.slow
def test_a_small_run(run_experiments, tmp_path):
    for folder, heads, lights in (("data", range(6), ("day",)), ("test", (7,), ("day", "left"))):
        (tmp_path / folder).mkdir()
        for head in heads:
            rng = np.random.default_rng(head)
            pose, expression = random_pose(rng, (160, 120)), random_expression(rng)
            for name in lights:
                light = DIFFUSE if name == "day" else lateral(name)
                scene = render(Head(head), pose, expression, light, size=(160, 120))
                write_image(tmp_path / folder / f"{head}-{name}.png", scene.image)
                write_landmarks(tmp_path / folder / f"{head}-{name}.pts", scene.landmarks)
    options = ("--data", tmp_path / "data", "--test", tmp_path / "test", "--training-lamp", "day", "--diagonal", "60")
    code, out, _ = run_experiments("relight", *options, "-o", tmp_path / "out", "--jobs", "1")
    assert code == 0
    assert "retinex" in out
    found = json.loads((tmp_path / "out" / "summary.json").read_text())["methods"]
    assert found["liaam"]["truth"] > found["input"]["truth"]
