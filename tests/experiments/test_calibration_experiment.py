"""The calibration experiment: small, complete, and the same however it is run."""

import pytest

from experiments import calibration
from experiments.calibration import calibration_experiment, summarise
from experiments.runner import run_experiment
from liaam.errors import LiaamError


@pytest.fixture(scope="module", autouse=True)
def small_scenes():
    """Scenes of a size that tests have time for."""
    size, calibration.SIZE = calibration.SIZE, (90, 120)
    yield
    calibration.SIZE = size


def test_every_kind_is_measured_for_each_camera_and_noise(tmp_path):
    summary = run_experiment(calibration_experiment(trials=2, sigmas=(2.0,)), tmp_path, 1)
    cells = {(c["camera"], c["kind"]): c for c in summary["cells"]}
    assert len(cells) == len(calibration.CAMERAS) * 4
    for kind in ("chart", "pair", "scene"):
        assert cells["line sensors", kind]["observable"] == 2
        assert cells["line sensors", kind]["worst_deg"] < 0.5
        assert cells["broad sensors", kind]["worst_deg"] < 3
    header, *rows = (tmp_path / "results.csv").read_text().splitlines()
    assert header.startswith("camera,kind,sigma_n,trial,error_deg")
    assert len(rows) == 2 * len(cells)
    assert (tmp_path / "figure.png").exists() and "| line sensors | pair | 2 |" in (tmp_path / "report.md").read_text()


def row(error, told, inside):
    numbers = {"error_deg": error, "standard_error_deg": 0.5, "plain_error_deg": -2.0}
    return {"camera": "c", "kind": "pair", "sigma_n": 2.0, "observable": told, "inside": inside, **numbers}


def test_only_angles_that_are_told_count():
    (cell,) = summarise([row(0.2, 1, 1), row(-0.4, 1, 0), row(30.0, 0, 1)])["cells"]
    assert (cell["trials"], cell["observable"]) == (3, 2)
    assert cell["median_deg"] == pytest.approx(0.3)
    assert cell["coverage"] == 0.5
    assert cell["plain_median_deg"] == 2.0


def test_nothing_told_is_no_number():
    (cell,) = summarise([row(30.0, 0, 1)])["cells"]
    assert cell["median_deg"] is None and cell["coverage"] is None


@pytest.mark.parametrize("wrong", [{"trials": 0}, {"sigmas": (99.0,)}])
def test_options_that_make_no_sense_are_refused(wrong):
    with pytest.raises(LiaamError, match="at least one trial"):
        calibration_experiment(**wrong)
