"""The experiments under a simulated shadow."""

from dataclasses import replace

import numpy as np
import pytest

from experiments import simulated
from experiments.displacement import SWEEP, displacement_experiment
from experiments.noise import noise_experiment
from experiments.runner import run_experiment
from experiments.simulated import angle_error, get_fitters, make_case, run_trial
from experiments.subjects import get_subject
from liaam.errors import LiaamError, MethodError
from setups import copy_files

pytestmark = pytest.mark.slow

LIGHT_INVARIANT = ("li", "li-lit", "li-pc", "li-pcs")


def medians(summary, method):
    column = summary["swept"]
    return {cell[column]: cell["error_px"]["median"] for cell in summary["methods"][method]}


def test_files_do_not_depend_on_the_number_of_workers(folder, tmp_path):
    person = copy_files(folder, tmp_path / "person", "03-*")
    experiment = displacement_experiment(person, ("rgb", "li"), trials=2, seed=3, gammas=(0, 8))
    for jobs in (1, 2):
        run_experiment(experiment, tmp_path / f"{jobs}", jobs)
    for name in ("results.csv", "summary.json", "report.md", "figure.svg"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes()


def test_li_holds_where_grey_and_rgb_drift(tmp_path):
    experiment = displacement_experiment(None, ("grey", "rgb", "li"), trials=2, seed=3, gammas=(0, 8))
    summary = run_experiment(experiment, tmp_path, jobs=1)
    for gamma in (0, 8):
        assert medians(summary, "li")[gamma] < 0.3
        assert min(medians(summary, method)[gamma] for method in ("grey", "rgb")) > 1.0
    header = (tmp_path / "results.csv").read_text().splitlines()[0]
    assert header == "method,gamma,trial,image,start_px,error_px,rms_px,theta_error_deg,iterations,status"
    report = (tmp_path / "report.md").read_text()
    assert "strength of the simulated shadow is not given" in report
    assert "| grey |" in report
    assert summary["start_px_median"][0] == [0, pytest.approx(0, abs=1e-6)]
    assert summary["start_px_median"][1][1] > 1.0


def test_noise_sweeps_noise_and_draws_a_bound(tmp_path):
    experiment = noise_experiment(None, ("grey", "li"), 1, sigmas=(0, 10))
    summary = run_experiment(experiment, tmp_path)
    assert summary["swept"] == "sigma_n"
    assert summary["settings"]["gamma"] == 4.0
    clean, noisy = summary["methods"]["li"]
    assert clean["error_px"]["median"] < noisy["error_px"]["median"] < 3.0
    assert clean["theta_error_deg"]["median"] < 0.1
    assert clean["statuses"] == {"converged": 1.0}
    assert summary["methods"]["grey"][0]["theta_error_deg"]["median"] is None
    assert [cell["sigma_n"] for cell in summary["bound"]] == [10]
    assert 0.05 < summary["bound"][0]["error_px"] < summary["bound"][0]["rms_px"]
    assert 0.5 < noisy["efficiency"] < 2.0  # one draw, which lies about the bound
    assert noisy["efficiency"] == pytest.approx(summary["bound"][0]["rms_px"] / noisy["rms_px"])
    assert clean["efficiency"] is None
    assert summary["methods"]["grey"][1]["efficiency"] is None
    assert "bound (li)" in (tmp_path / "figure.svg").read_text()
    assert "Median error of the image's θ" in (tmp_path / "report.md").read_text()


def test_what_is_drawn_depends_on_seed_and_trial_only():
    subject = get_subject(None)
    near, far, noisy = (make_case(subject, 1, 7, *at) for at in ((2.0, 0.0), (6.0, 0.0), (2.0, 5.0)))
    assert near.picture == 1
    assert np.allclose(3 * (near.start - near.truth), far.start - far.truth)
    assert np.array_equal(near.image, far.image)
    assert np.array_equal(near.start, noisy.start)
    assert np.std(noisy.image - near.image) == pytest.approx(5 / 255, rel=0.05)
    assert not np.allclose(make_case(subject, 2, 7, 2.0, 0.0).start, near.start)


def test_both_angles_turned_by_half_a_turn_are_the_same_camera():
    case = make_case(get_subject(None), 0, 0, 0.0, 0.0)
    result = get_fitters(None, ("li",), "liaam")["li"].fit(case.image, case.start)
    theta = simulated.PAPER_THETA
    for turn in (0.0, np.pi, -np.pi):
        turned = replace(result, theta=theta + 0.1 + turn, theta_model=theta + turn)
        assert angle_error(turned, theta) == pytest.approx(0.1)
    assert abs(angle_error(replace(result, theta=theta + np.pi, theta_model=theta), theta)) == pytest.approx(np.pi)
    assert np.isnan(angle_error(replace(result, theta=np.nan, theta_model=np.nan), theta))


def test_papers_solver_reaches_the_same_shape():
    setups = [simulated.Setup(None, ("li",), 1, 0, solver, SWEEP) for solver in ("liaam", "paper")]
    rows = [run_trial(setup, simulated.Trial(4.0, 0)) for setup in setups]
    assert all(row[0]["error_px"] < 0.3 for row in rows)


@pytest.mark.parametrize("make", [displacement_experiment, noise_experiment])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"methods": ("li", "magic")}, "unknown method 'magic'"),
        ({"methods": ("li", "li")}, "given twice"),
        ({"methods": ()}, "no method is given"),
        ({"solver": "oracle"}, "unknown solver 'oracle'; choose from liaam, liaam-smooth, liaam-sample, paper"),
        ({"trials": 0}, "at least 1"),
    ],
)
def test_refuses_before_the_work_starts(make, options, message):
    with pytest.raises(MethodError, match=message):
        make(**{"methods": ("li",), **options})


def test_a_value_given_twice_is_refused():
    with pytest.raises(LiaamError, match="given twice"):
        displacement_experiment(gammas=(4, 4))


def test_light_invariance_holds_on_a_real_person(shared_data, tmp_path):
    methods = ("grey", "rgb", *LIGHT_INVARIANT)
    experiment = displacement_experiment(shared_data / "one-person", methods, trials=3, gammas=(16,))
    summary = run_experiment(experiment, tmp_path, jobs=1)
    assert max(medians(summary, method)[16] for method in LIGHT_INVARIANT) < 0.3
    assert min(medians(summary, method)[16] for method in ("grey", "rgb")) > 2.5


@pytest.mark.parametrize("method", ["aia", "varied+tukey"])
def test_methods_that_need_other_lights_are_refused_before_any_work(tmp_path, method):
    with pytest.raises(LiaamError, match=r"trained with lamps; .* baselines"):
        displacement_experiment(None, (method,), 1)


def test_a_milder_shadow_leaves_more_light_and_a_negative_one_is_refused():
    subject = get_subject(None)
    deep, mild = (make_case(subject, 0, 0, 0.0, 0.0, strength).image for strength in (-1.8, -1.2))
    assert mild.mean() > deep.mean() + 0.01
    with pytest.raises(LiaamError, match=r"strength 0.5: give the shadow's change of log light"):
        displacement_experiment(None, ("li",), 1, strength=0.5)
