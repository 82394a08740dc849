"""Agreement of two observers on the page: also the measures that statistics of shape need."""

import numpy as np
import pytest
from people import shoot, untrained, violations, wait_for

from liaam.io import Landmarks, write_image, write_landmarks
from liaam.studio.project import Project
from liaam.studio.sets import make_set

pytestmark = pytest.mark.slow


def test_two_observers_are_compared_by_slope_ratio_and_correlation(serve, page, tmp_path, artefacts):
    rng = np.random.default_rng(3)
    root = tmp_path / "wings"
    root.mkdir()
    base = np.array([[40, 40], [280, 50], [260, 190], [60, 200], [150, 120], [200, 80]], float)
    names = [f"w{i}" for i in range(10)]  # the last two are not placed by both
    truth = [base + rng.normal(0, 6, base.shape) for _ in names]
    for name, points in zip(names, truth, strict=True):
        write_image(root / f"{name}.png", np.full((240, 320, 3), 120, np.uint8))
        if name != "w9":
            write_landmarks(root / f"{name}.ljson", Landmarks(points, (), tuple("abcdef")))
    project = Project(root)
    make_set(project, {"name": "anna", "same": True})
    project.store.close()
    for name, points in zip(names[:8], truth, strict=False):
        write_landmarks(
            root / "anna" / f"{name}.ljson", Landmarks(points + rng.normal(0, 1, base.shape), (), tuple("abcdef"))
        )
    untrained(page)
    page.goto(serve(root).address)
    wait_for(page, "() => window.liaamStudio?.annotate?.source()")
    page.locator("[data-testid=agreement]").click()
    page.locator("[data-testid=shape-slope]").wait_for()
    slope = float(page.locator("[data-testid=shape-slope]").inner_text().split()[0])
    assert 0.7 < slope < 1.3
    assert 0.7 < float(page.locator("[data-testid=shape-icc]").inner_text()) <= 1
    left_out = page.locator("[data-testid=agreement-left-out]")
    left_out.get_by_text("Left out: 2 pictures of 10").click()
    reasons = ["1 picture is finished in Main set only – w8.png", "1 picture is not finished by any observer – w9.png"]
    assert left_out.locator("li").all_inner_texts() == reasons
    shoot(page, artefacts, "agreement-1280")
    assert not violations(page)
    left_out.get_by_text("w8.png").click()
    wait_for(page, "() => window.liaamStudio.state.current === 'w8.png'")
