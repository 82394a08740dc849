"""Which part of a model of several shapes an object is of.

All parts are fitted at the coarsest level, which takes a tenth of the time of a fit, unless the first one is almost
surely right. Only those that are likely there go on to the next, and in general one to the sharpest.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from liaam.fitting.loop.levels import Target
from liaam.fitting.loop.options import SolverOptions
from liaam.fitting.one_shape_fitter import Blurred, OneShapeFitter
from liaam.fitting.result import FitResult, likeliness, odds_of
from liaam.fitting.search.finder import Finder

# What was measured for these is in experiments/notes/engine.md.
# Factor on the odds of the first part. A model's quality is that of fits at the sharpest level. The blurred ones
# underrate the part that has most appearance modes, which the first one is.
FIRST = 8.0
SURE = 0.99  # Quality at the coarsest level from which the first part is taken without a look at the others
LIKELY = 0.1  # Least odds, relative to the best, of parts that are fitted at the next blurred level
CLOSE = 0.3  # The same for the sharpest level
# Quality from which a fit is worth more time: at the blurred levels for the sharpest, and there for other starts. Of
# 302 fits with less at the blurred levels, 1 was right and not doubtful, of 658 with more 314.
HOPEFUL = 0.2
# Largest number of steps at the sharpest level of a fit with less, if others follow: enough for its result to have a
# quality, by which it is compared with these.
BRIEFEST = 2


class PartFit(NamedTuple):
    """A fit at blurred levels, and the index of the model's part that was fitted."""

    part: int
    fit: Blurred

    @property
    def odds(self) -> float:
        """Odds that the object is of this part."""
        return odds_of(self.fit.quality) * (FIRST if self.part == 0 else 1.0)


def targets_at(target: Target, finders: Sequence[Finder]) -> list[Target]:
    """Return the targets of all parts of a model, which start with their mean shape where a target does."""
    return [target._replace(start=finder.mean_at(target.start)) for finder in finders]


def fit_likeliest_part(
    fitters: Sequence[OneShapeFitter], targets: Sequence[Target], options: SolverOptions, is_last: bool
) -> tuple[int, FitResult]:
    """Fit an object with the part of a model that it is likely of.

    Parameters
    ----------
    fitters : sequence of OneShapeFitter
        One for each part.
    targets : sequence of Target
        The same image and start for each of them.
    options : SolverOptions
    is_last : bool
        Whether no fits at other places follow. If they do, the sharpest level gets :data:`BRIEFEST` steps only where
        the blurred levels give no hope.

    Returns
    -------
    tuple of int and FitResult
        The index of the part, and its fit. Where the blurred levels cannot be judged, each part is fitted.
    """
    fits: dict[int, FitResult] = {}  # by the index of the part
    if len(fitters) == 1 or not all(map(_can_be_judged, fitters, targets)):
        for part, (fitter, target) in enumerate(zip(fitters, targets, strict=True)):
            fits[part] = fitter.fit_target(target, options)
    else:
        likely = _likely_at_coarsest(fitters, targets, options)
        close = _likely([fit_further(fitters, each, options) for each in likely], CLOSE)
        for part, fit in close:
            fits[part] = _fit_sharpest(fitters[part], fit, options, is_last)
    best = max(fits, key=lambda part: (fits[part].status.ok, *likeliness(fits[part])))
    return best, fits[best]


def _likely_at_coarsest(
    fitters: Sequence[OneShapeFitter], targets: Sequence[Target], options: SolverOptions
) -> list[PartFit]:
    """Fit an object at the coarsest level with each part, or the first alone if it is sure; return the likely fits."""
    first = fit_coarsest(fitters[:1], targets[:1], options)
    if first[0].fit.quality >= SURE:
        return first
    others = [each._replace(part=each.part + 1) for each in fit_coarsest(fitters[1:], targets[1:], options)]
    return _likely([*first, *others], LIKELY)


def fit_coarsest(fitters: Sequence[OneShapeFitter], targets: Sequence[Target], options: SolverOptions) -> list[PartFit]:
    """Fit an object at the coarsest level with each part."""
    pairs = zip(fitters, targets, strict=True)
    return [PartFit(i, fitter.fit_coarsest(target, options)) for i, (fitter, target) in enumerate(pairs)]


def fit_further(fitters: Sequence[OneShapeFitter], coarsest: PartFit, options: SolverOptions) -> PartFit:
    """Fit the blurred levels that remain after the coarsest."""
    return coarsest._replace(fit=fitters[coarsest.part].fit_other_blurred(coarsest.fit, options))


def _fit_sharpest(fitter: OneShapeFitter, fit: Blurred, options: SolverOptions, is_last: bool) -> FitResult:
    """Fit the sharpest level: with few steps if there is no hope and fits at other places follow."""
    if not is_last and fit.quality < HOPEFUL:
        options = replace(options, max_iterations=min(BRIEFEST, options.max_iterations))
    return fitter.fit_sharpest(fit, options)


def _likely(fits: Sequence[PartFit], share: float) -> list[PartFit]:
    """Return the fits whose odds are at least a share of the best."""
    best = max(fit.odds for fit in fits)
    return [fit for fit in fits if fit.odds >= share * best]


def _can_be_judged(fitter: OneShapeFitter, target: Target) -> bool:
    """Return whether fits to a target at the blurred levels have a quality."""
    uses_all_levels = fitter.regressor is None and target.pull is None  # from given points, some are left out
    return uses_all_levels and fitter.reliability is not None and len(fitter.objectives) > 1
