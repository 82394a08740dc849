"""The claims of the paper's section 7, each tested against the results of our experiments.

The tests do not assume the result: a claim that does not hold is reported as such.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

LI_METHODS = ("li", "li-lit", "li-pc", "li-pcs")

Summaries = Mapping[str, Mapping[str, Any]]
"""Summaries by the experiment's name."""


@dataclass(frozen=True)
class Verdict:
    """Answer to a claim, with the numbers that support it."""

    holds: bool
    evidence: str


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, the condition that our results must meet, and its test.

    ``ask`` makes a verdict from the summary of the experiment ``needs``.
    """

    name: str
    text: str
    criterion: str
    needs: str
    ask: Callable[[Mapping[str, Any]], Verdict | None]

    def of(self, summaries: Summaries) -> Verdict | None:
        """Return the verdict, or None if the experiment was not run or does not decide the claim."""
        return self.ask(summaries[self.needs]) if self.needs in summaries else None


def medians(summary: Mapping[str, Any], method: str, quantity: str = "error_px") -> dict[float, float]:
    """Median of a quantity by swept value. Values that are not finite count as infinite."""
    found = {cell[summary["swept"]]: cell[quantity]["median"] for cell in summary["methods"][method]}
    return {value: np.inf if median is None else median for value, median in found.items()}


def _li_is_lit(summary: Mapping[str, Any]) -> Verdict:
    gaps = summary["li_and_lit_px"]
    median, p90 = (max(np.inf if gap[name] is None else gap[name] for gap in gaps) for name in ("median", "p90"))
    evidence = f"median at most {median:.3f} px, 90th percentile at most {p90:.3f} px"
    return Verdict(median <= 0.01 and p90 <= 0.05, evidence)


def _li_stands_noise_best(summary: Mapping[str, Any]) -> Verdict | None:
    found = {method: medians(summary, method) for method in LI_METHODS}
    noisy = [value for value in found["li"] if value > 0]
    if not noisy:
        return None
    others = {v: min(found[method][v] for method in ("li-pc", "li-pcs")) for v in noisy}
    if not np.isfinite([*others.values(), *(found["li"][v] for v in noisy)]).all():
        return Verdict(False, "some methods have no finite median")
    worst = max(noisy, key=lambda v: found["li"][v] / max(others[v], 1e-9))
    holds = all(found["li"][v] <= 1.05 * others[v] for v in noisy)
    at = ", ".join(f"{method} {found[method][worst]:.2f}" for method in ("li", "li-pc", "li-pcs"))
    return Verdict(holds, f"{at} px at σn = {worst:g}, where li compares worst")


def _alike_under_displacement(summary: Mapping[str, Any]) -> Verdict:
    found = {method: medians(summary, method) for method in LI_METHODS}
    gaps = {}
    for value in found["li"]:
        errors = [found[method][value] for method in LI_METHODS]
        gaps[value] = (min(errors), max(errors))
    holds = all(high - low <= max(0.05, 0.25 * low) for low, high in gaps.values())
    worst = max(gaps, key=lambda v: gaps[v][1] - gaps[v][0])
    return Verdict(holds, f"{gaps[worst][0]:.3f} to {gaps[worst][1]:.3f} px at γ = {worst:g}, where they differ most")


def _only_li_finds_the_face(summary: Mapping[str, Any]) -> Verdict:
    highest = max(max(medians(summary, method).values()) for method in LI_METHODS)
    lowest = {method: min(medians(summary, method).values()) for method in ("grey", "rgb")}
    holds = highest < 0.3 and min(lowest.values()) > 2.5
    at_least = ", ".join(f"{method} at least {error:.1f} px" for method, error in lowest.items())
    return Verdict(holds, f"LI methods at most {highest:.2f} px; {at_least}")


def _values_diverge(summary: Mapping[str, Any]) -> Verdict:
    traces = {method: summary["methods"][method]["median"] for method in ("grey", "rgb", "li")}
    ends = {method: (trace[0], np.inf if trace[-1] is None else trace[-1]) for method, trace in traces.items()}
    holds = all(ends[m][1] > ends[m][0] for m in ("grey", "rgb")) and ends["li"][1] < ends["li"][0]
    return Verdict(holds, "; ".join(f"{method} {a:.2f} → {b:.2f} px" for method, (a, b) in ends.items()))


def _angle_suffers_from_noise(summary: Mapping[str, Any]) -> Verdict | None:
    found = medians(summary, "li", "theta_error_deg")
    values = sorted(found)
    if len(values) < 3:  # too few for a trend
        return None
    errors = [found[value] for value in values]
    rises = all(later >= 0.9 * earlier for earlier, later in pairwise(errors))
    holds = rises and errors[-1] > 3 * errors[0]
    return Verdict(holds, ", ".join(f"{found[value]:.2f}° at σn = {value:g}" for value in values))


def _shadow_is_taken_off(summary: Mapping[str, Any]) -> Verdict | None:
    kind, methods = next(iter(summary["kinds"].items()))
    cell = methods["li"]
    rebuilt, given = cell["rebuilt_rms"]["median"], cell["input_rms"]["median"]
    if rebuilt is None or given is None:  # a real light without ground truth
        return None
    return Verdict(rebuilt <= 0.05 and given >= 0.3, f"error of log light {given:.3f} → {rebuilt:.3f} ({kind})")


CLAIMS = (
    Claim(
        "li-is-lit",
        "LI and LI(LIT) perform alike.",
        "At every noise level the errors of li and li-lit, fit by fit, differ by at most 0.01 px in median and 0.05 px "
        "in nine of ten fits.",
        "noise",
        _li_is_lit,
    ),
    Claim(
        "noise",
        "Among the light-invariant methods, LI is the most robust to noise.",
        "At every noise level li's median error is at most 1.05 times that of li-pc and li-pcs.",
        "noise",
        _li_stands_noise_best,
    ),
    Claim(
        "displacement",
        "The displacement of the start hurts all light-invariant methods alike.",
        "At every displacement their median errors lie within 0.05 px, or within a quarter, of each other.",
        "displacement",
        _alike_under_displacement,
    ),
    Claim(
        "shadow",
        "Under a shadow the light-invariant methods find the face and grey and RGB do not.",
        "At every displacement each LI method's median error is below 0.3 px, that of grey and of rgb above 2.5 px.",
        "displacement",
        _only_li_finds_the_face,
    ),
    Claim(
        "divergence",
        "Under lateral light grey and RGB diverge and LI converges.",
        "After 50 iterations the median error of grey and of rgb is above that of the start, that of li below it.",
        "convergence",
        _values_diverge,
    ),
    Claim(
        "angle",
        "The error of the estimated angle grows with noise.",
        "Li's median angle error rises from one noise level to the next (within 10 %), threefold in all.",
        "noise",
        _angle_suffers_from_noise,
    ),
    Claim(
        "reconstruction",
        "The appearance without shading is recovered.",
        "Median error of log light at most 0.05 after, at least 0.3 before.",
        "reconstruct",
        _shadow_is_taken_off,
    ),
)
"""Claims in the order of the table."""


def up_to(summary: Mapping[str, Any], limit: float) -> dict[str, Any]:
    """Return a sweep's summary with the swept values up to a limit only."""
    swept = summary["swept"]
    kept = {method: [cell for cell in cells if cell[swept] <= limit] for method, cells in summary["methods"].items()}
    gaps = [gap for gap in summary["li_and_lit_px"] or [] if gap[swept] <= limit]
    return {**summary, "methods": kept, "li_and_lit_px": gaps}
