"""Claims are answered from numbers: each must hold for some and fail for others."""

import pytest

from experiments.claims import CLAIMS, LI_METHODS, up_to

BY_NAME = {claim.name: claim for claim in CLAIMS}


def sweep(column: str, errors: dict[str, list], angles: dict[str, list] | None = None, gap=(0.0, 0.0)) -> dict:
    """Summary of a sweep over 0, 1, 2 ... with the given medians."""
    angles = angles or {}
    return {
        "swept": column,
        "li_and_lit_px": [{column: float(i), **dict(zip(("median", "p90"), gap, strict=True))} for i in range(3)],
        "methods": {
            method: [
                {
                    column: float(i),
                    "error_px": {"median": error},
                    "theta_error_deg": {"median": angles.get(method, [None] * len(line))[i]},
                }
                for i, error in enumerate(line)
            ]
            for method, line in errors.items()
        },
    }


def alike(line: list, **others: list) -> dict[str, list]:
    return {**dict.fromkeys(LI_METHODS, line), **{name.replace("_", "-"): v for name, v in others.items()}}


@pytest.mark.parametrize(
    ("name", "summary", "holds"),
    [
        ("li-is-lit", sweep("sigma_n", alike([0, 1]), gap=(0.001, 0.01)), True),
        ("li-is-lit", sweep("sigma_n", alike([0, 1]), gap=(0.02, 0.03)), False),
        ("li-is-lit", sweep("sigma_n", alike([0, 1]), gap=(0.001, None)), False),
        ("noise", sweep("sigma_n", alike([0.0, 1.0, 2.0])), True),
        ("noise", sweep("sigma_n", alike([0.0, 1.0, 2.0], li_pc=[0.0, 1.2, 1.5])), False),
        ("noise", sweep("sigma_n", alike([9.0, 1.0, 2.0], li_pc=[0.1, 1.2, 2.0])), True),
        ("noise", sweep("sigma_n", alike([0.0, None, None])), False),
        ("displacement", sweep("gamma", alike([0.01, 0.02], li_pc=[0.04, 0.06])), True),
        ("displacement", sweep("gamma", alike([0.01, 0.02], li_pc=[0.04, 0.2])), False),
        ("displacement", sweep("gamma", alike([0.01, 0.02], li_pc=[0.04, None])), False),
        ("shadow", sweep("gamma", alike([0.1, 0.2], grey=[3, 4], rgb=[2.6, 3])), True),
        ("shadow", sweep("gamma", alike([0.1, 0.2], grey=[3, 4], rgb=[2.6, 2.4])), False),
        ("shadow", sweep("gamma", alike([0.1, 0.31], grey=[3, 4], rgb=[3, 4])), False),
        ("shadow", sweep("gamma", alike([0.1, 0.2], grey=[3, None], rgb=[3, 4])), True),
        ("angle", sweep("sigma_n", alike([1, 1, 1]), {"li": [0.1, 0.2, 0.5]}), True),
        ("angle", sweep("sigma_n", alike([1, 1, 1]), {"li": [0.1, 0.5, 0.4]}), False),
        ("angle", sweep("sigma_n", alike([1, 1, 1]), {"li": [0.1, 0.1, 0.2]}), False),
    ],
)
def test_a_sweep_answers_its_claims(name, summary, holds):
    claim = BY_NAME[name]
    verdict = claim.of({claim.needs: summary})
    assert verdict is not None
    assert verdict.holds is holds
    assert verdict.evidence


def traces(**lines: list) -> dict:
    return {"methods": {method: {"median": line} for method, line in lines.items()}}


@pytest.mark.parametrize(
    ("summary", "holds"),
    [
        (traces(grey=[3, 5], rgb=[3, None], li=[3, 0.1]), True),
        (traces(grey=[3, 2], rgb=[3, 5], li=[3, 0.1]), False),
        (traces(grey=[3, 5], rgb=[3, 5], li=[3, 4]), False),
    ],
)
def test_divergence_compares_the_end_with_the_start(summary, holds):
    assert BY_NAME["divergence"].of({"convergence": summary}).holds is holds


@pytest.mark.parametrize(
    ("given", "rebuilt", "holds"), [(0.9, 0.03, True), (0.9, 0.06, False), (0.2, 0.01, False), (None, None, None)]
)
def test_reconstruction_compares_with_the_truth_where_it_is_known(given, rebuilt, holds):
    cell = {"input_rms": {"median": given}, "rebuilt_rms": {"median": rebuilt}}
    verdict = BY_NAME["reconstruction"].of({"reconstruct": {"kinds": {"narrow": {"li": cell}}}})
    assert (verdict and verdict.holds) is holds


def test_what_was_not_run_has_no_verdict():
    assert [claim.of({}) for claim in CLAIMS] == [None] * len(CLAIMS)


def test_too_few_values_have_no_verdict():
    assert BY_NAME["noise"].of({"noise": sweep("sigma_n", alike([0.1]))}) is None
    assert BY_NAME["angle"].of({"noise": sweep("sigma_n", alike([0.1, 0.2]), {"li": [0.1, 0.9]})}) is None


def test_the_lower_part_of_a_sweep():
    summary = up_to(sweep("gamma", alike([0.1, 0.2, 9.0])), 1.0)
    assert [cell["gamma"] for cell in summary["methods"]["li"]] == [0.0, 1.0]
    assert [gap["gamma"] for gap in summary["li_and_lit_px"]] == [0.0, 1.0]
    assert BY_NAME["displacement"].of({"displacement": summary}).holds
