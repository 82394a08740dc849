"""Pictures of photometry: whatever there is to show, they can be drawn."""

import numpy as np
import pytest

from liaam.calibration import Agreement, Averaged
from liaam.photometry import CameraModel
from liaam.plotting import save_figure
from liaam.plotting.photometry import figure_of_agreement, figure_of_response, shortened


@pytest.mark.parametrize("n", [2, 5, 20])
def test_agreement_is_drawn_where_correlations_are_low_negative_or_not_told(n, tmp_path, rng):
    pairs = [(i, j) for i in range(n) for j in range(i)]
    correlations = np.linspace(-1, 1, len(pairs))
    found = [Agreement(i, j, value, -value, 0.5) for (i, j), value in zip(pairs, correlations, strict=True)]
    found += [Agreement(0, 1, float("nan"), 0.2, 0.0)]
    pictures = [rng.random((12, 16, 3)).astype(np.float32) for _ in range(n)]
    values = rng.random((n, 6, 8))
    names = [f"a picture with a rather long name {i}.png" for i in range(n)]
    save_figure(figure_of_agreement(pictures, names, Averaged(values, values, 48), found), tmp_path / "agreement.png")
    assert (tmp_path / "agreement.png").stat().st_size > 1000


@pytest.mark.parametrize(("vignetting", "panels"), [((), 1), ((-0.3,), 2)])
def test_vignetting_is_drawn_where_there_is_any(vignetting, panels, tmp_path):
    figure = figure_of_response(CameraModel(vignetting=vignetting))
    assert len(figure.axes) == panels
    save_figure(figure, tmp_path / "response.png")


def test_long_names_lose_their_middle():
    assert shortened("cat.10.png") == "cat.10.png"
    short = shortened("a_very_long_name_of_a_series_0017.png", 16)
    assert len(short) == 16 and short.startswith("a_ver…") and short.endswith("_0017.png")
