"""Patches over generated persons."""

import cv2
import numpy as np
import pytest

from experiments import occlusion

pytestmark = pytest.mark.slow

METHODS = ("rgb", "li")


@pytest.mark.parametrize("kind", occlusion.PATCHES)
def test_a_patch_covers_a_fifth_of_the_object(rng, kind):
    image = rng.integers(0, 256, (150, 200, 3)).astype(np.uint8)
    angles = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    landmarks = np.array([100.0, 75.0]) + np.stack([45 * np.cos(angles), 60 * np.sin(angles)], axis=1)
    hull = cv2.fillConvexPoly(np.zeros((150, 200), np.uint8), np.rint(landmarks).astype(np.int32), 1) > 0
    places = set()
    for _ in range(5):
        patched = occlusion.covered(image, landmarks, kind, rng)
        changed = (patched != image).any(axis=2)
        assert patched.dtype == np.uint8
        assert not (changed & ~hull).any()
        assert changed.sum() / hull.sum() == pytest.approx(occlusion.COVERED, rel=0.08)
        places.add(tuple(np.argwhere(changed)[0]))
    assert len(places) > 1


def test_patches_take_turns_and_starts_are_shared(done, folder):
    cases = occlusion.occlusion_experiment(folder, METHODS).tasks
    assert [case.key for case in cases[:2]] == ["person 03, diffuse", "person 03, spot"]
    assert [[case.patch(trial) for trial in range(2)] for case in cases[1:3]] == [
        ["colours", "copy"],
        ["copy", "colours"],
    ]
    for case in cases:
        assert not {sample.name for sample in case.split.training} & {sample.name for sample in case.split.tested}
    summary, rows, _ = done("occlusion")
    assert [row["patch"] for row in rows[:4]] == ["none", "none", "colours", "colours"]
    for method in METHODS:
        for light in ("diffuse", "spot"):
            cell = summary["methods"][method][f"{light}, covered"]
            errors = [
                float(r["nme"]) for r in rows if (r["method"], r["light"]) == (method, light) and r["patch"] != "none"
            ]
            assert cell["nme_median"] == pytest.approx(np.median(errors), abs=1e-6)
            assert cell["fits"] == summary["methods"][method][f"{light}, bare"]["fits"] == 3
