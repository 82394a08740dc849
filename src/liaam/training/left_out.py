"""Fit left-out images to calibrate the quality of fits."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from liaam.fitting.methods import Method, needed_by
from liaam.model import AAM, VIEWS, Level
from liaam.model.appearance import COPIED_APPEARANCES, AppearanceModel, Textures, train_appearance_model
from liaam.model.missing import Missing
from liaam.model.pca import Variance
from liaam.model.regressor import LandmarkRegressor
from liaam.model.shape import Recipe, shape_model_on
from liaam.model.views import shape_model_of
from liaam.photometry.encoding import as_colour
from liaam.training.entries import Entry
from liaam.training.lamps import Copies
from liaam.training.poses import poses_of
from liaam.training.refiner import Refinement
from liaam.training.regressor import Regression
from liaam.training.reliability import (
    LeftOutFits,
    LeftOutImage,
    calibrate,
    fits_near,
    least_shrunk_of_each,
    with_distant_and_wrong_fits,
)
from liaam.training.textures import FITTED, SOURCES, Sampled, Steps, learning_cost

# Largest numbers of left-out images to fit from near the objects, whose errors say how far fits are off, and from other
# starts. Each fit takes as long as sampling FITTED images.
NEAR_PICTURES = 40
OTHER_PICTURES = 20


@dataclass(frozen=True, eq=False)
class ViewSettings:
    """What the models of a view are trained with.

    Attributes
    ----------
    recipe : Recipe
        Settings of the covariance of shapes.
    shape_variance, appearance_variance : Variance
        Share of the variance of shapes and of appearances to keep, or how to choose it.
    """

    recipe: Recipe
    shape_variance: Variance
    appearance_variance: Variance


def calibrated(
    model: AAM,
    entries: list[Entry],
    shapes: np.ndarray,
    missing: Missing | None,
    sampled: Sampled,
    copied: Copies,
    settings: Mapping[str, ViewSettings],
    methods: Sequence[Method],
    folds: list[np.ndarray],
    steps: Steps,
    regression: Regression | None = None,
    refinement: Refinement | None = None,
    *,
    has_sides: bool = False,
) -> AAM:
    """Calibrate the quality of methods' fits on left-out images, original and relit by left-out lamps.

    Images of one object, recognised by their names, are left out together. With each fold one half of the lamps is left
    out, because the light of later images differs from all lamps, and more than neighbouring lamps differ.

    Parameters
    ----------
    model : AAM
        Model of all images.
    entries : list of Entry
        All m images.
    shapes : (m, n, 2) float64
        Their landmarks.
    missing : Missing, optional
        Which of these are estimates, that fits are not compared with; None if all are known.
    sampled : Sampled
        Their textures, and those of their copies.
    copied : Copies
        How images are relit.
    settings : mapping of str to ViewSettings
        What the whole model was trained with, by view.
    methods : sequence of Method
    folds : list of arrays of int
        Images that are left out together, by index.
    steps : Steps
        Reports each image.
    regression : Regression, optional
        Whether a regressor is needed, and what it is learnt from; None if there is to be none.
    refinement : Refinement, optional
        What a refiner is learnt from, and whether it helps; None if there is to be none.
    has_sides : bool
        Whether fits will try both sides of objects, so that fits of the wrong side are among the wrong ones.

    Returns
    -------
    AAM
        The model, with the calibrations in its views, the methods that could not be calibrated, a regressor if fits to
        left-out images need one, a refiner if it helps them, and the accuracy of the first method in its card.
    """
    halves = [np.zeros(0, int)] if copied.lamps is None else copied.lamps.halves()
    lamps_of_folds = [halves[i % len(halves)] for i in range(len(folds))]
    # Models without a fold are small beside the textures of all copies, so that all are kept.
    parts = []
    for i, (fold, lamps) in enumerate(zip(folds, lamps_of_folds, strict=True)):
        steps.next(f"leaving out part {i + 1} of {len(folds)}", learning_cost(model.n_textures))
        under_other_lamps = np.flatnonzero(~np.isin(copied.lit_by, lamps))
        part = _without(model, fold, shapes, missing, sampled, settings, methods, under_other_lamps)
        refiner = None if refinement is None else refinement.learn(without=fold, textures=under_other_lamps)
        parts.append(part if refiner is None else replace(part, refiner=refiner))

    def images(models: Sequence[AAM], most: int = NEAR_PICTURES) -> Iterator[LeftOutImage]:
        """Yield some images of each fold, and their copies under other lamps, with the model of the other folds."""
        for part, fold, lamps in zip(models, folds, lamps_of_folds, strict=True):
            for j in fitted_of(fold, folds, most):
                steps.next(f"fitting {entries[j].name}", FITTED)
                image = as_colour(entries[j].read_image(), entries[j].name)
                name = entries[j].name
                yield LeftOutImage(part, image, shapes[j], entries[j].known, has_sides=has_sides, name=name)
                for relit in copied.relit(j, image, shapes[j], model.response, lamps):
                    yield LeftOutImage(part, relit, shapes[j], entries[j].known, relit=True, name=name)

    near, share = _best_near(fits_near(model, images(parts), methods), refinement)
    if regression is not None and regression.is_needed(near):
        steps.total += len(folds) * learning_cost(model.n_textures) + cost_of_fits(folds, NEAR_PICTURES)
        data = regression.data()
        with_regressors = []
        for i, (part, fold) in enumerate(zip(parts, folds, strict=True)):
            steps.next(f"regressor without part {i + 1} of {len(folds)}", learning_cost(model.n_textures))
            regressor = data.learn(shape_model_of(part.views), without=fold)
            with_regressors.append(replace(part, regressor=regressor))
        regressed = _best_near(fits_near(model, images(with_regressors), methods), refinement)
        if regression.helps(near, regressed[0]):
            near, share = regressed
            parts = with_regressors
            model = replace(model, regressor=data.learn(shape_model_of(model.views)))
    parts = [_refining_by(share, part, part.refiner) for part in parts]
    if share is not None and refinement is not None:
        model = _refining_by(share, model, refinement.learn())
    tried = with_distant_and_wrong_fits(model, images(parts, OTHER_PICTURES), methods, near)
    reliabilities = calibrate(model, tried, methods)
    for view in VIEWS:
        names = [method.name for method in methods if method.view == view]
        model = model.with_view(
            view, reliabilities={name: reliabilities[name] for name in names if name in reliabilities}
        )
    failing = tuple(method.name for method in methods if method.name not in reliabilities)
    of_first = tried.get(methods[0].name, LeftOutFits())
    if faults := of_first.describe_faults():
        warnings.warn(faults, stacklevel=5)  # the caller of train, which is decorated
    card = replace(model.card, accuracy=of_first.describe())
    return replace(model, failing_methods=failing, card=card)


def _best_near(
    fits: Mapping[str, Sequence[LeftOutFits]], refinement: Refinement | None
) -> tuple[dict[str, LeftOutFits], float | None]:
    """Return the best fits from near the objects of each method, and the share of their refiners; None if no help."""
    if refinement is not None:
        share = refinement.best_share(fits)
        shared = {name: [each.refined_by(share) for each in candidates] for name, candidates in fits.items()}
        refined = least_shrunk_of_each(shared, refined=True)
        if refinement.helps(refined):
            return refined, share
    return least_shrunk_of_each(fits, refined=False), None


def _refining_by(share: float | None, model: AAM, refiner: LandmarkRegressor | None) -> AAM:
    """Return a model that refines fits with a refiner and its share; or not, without either."""
    if share is None or refiner is None:
        return model if model.refiner is None else replace(model, refiner=None)
    return replace(model, refiner=replace(refiner, share=share))


def can_be_calibrated(method: Method) -> bool:
    """Return whether a method fits appearances that can be learnt again without some images."""
    return not set(needed_by(method)) & {*SOURCES, "features"}


def cost_of_fits(folds: list[np.ndarray], most: int) -> int:
    """Return the steps of training that fits of at most so many left-out images take."""
    return FITTED * sum(len(fitted_of(fold, folds, most)) for fold in folds)


def fitted_of(fold: np.ndarray, folds: list[np.ndarray], most: int) -> np.ndarray:
    """Return the images of a left-out fold to fit, by index: all, or some at even distances, at most so many of all."""
    n_fitted = min(max(1, most // len(folds)), len(fold))
    return fold[np.linspace(0, len(fold) - 1, n_fitted).astype(int)]


def _without(
    model: AAM,
    fold: np.ndarray,
    shapes: np.ndarray,
    missing: Missing | None,
    sampled: Sampled,
    settings: Mapping[str, ViewSettings],
    methods: Sequence[Method],
    under_other_lamps: np.ndarray,
) -> AAM:
    """Train a model without a fold, on the frame and with the settings of the whole model.

    Of the textures of :data:`COPIED_APPEARANCES`, only those under lamps that are not left out are used: the indices
    ``under_other_lamps``.
    """
    others = np.setdiff1d(np.arange(len(shapes)), fold)
    for name in dict.fromkeys(method.view for method in methods):
        view = model.views[name]
        of_view = settings[name]
        needed = set().union(*(needed_by(method) for method in methods if method.view == name))
        levels = []
        for i, level in enumerate(view.levels):
            appearances = {}
            for kind in needed & level.appearances.keys():
                rows = sampled.rows(kind, others)
                if kind in COPIED_APPEARANCES:
                    rows = np.intersect1d(rows, under_other_lamps)
                appearances[kind] = _learnt_again(
                    level.appearances[kind], sampled.textures[kind][i], rows, of_view.appearance_variance
                )
            levels.append(Level(level.blur, appearances))
        shape_variance = of_view.shape_variance
        modes = len(view.shape_model.modes) if shape_variance == "auto" else shape_variance
        shape_model = shape_model_on(
            view.shape_model.mean,
            shapes[others],
            modes,
            of_view.recipe,
            missing=None if missing is None else missing.of(others),
        )
        warp = replace(view.warp, shape_model=shape_model)
        model = model.with_view(name, warp=warp, levels=tuple(levels))
    if model.poses is None:
        return model
    return replace(model, poses=poses_of(shapes[others], model.shape_model.mean))


def _learnt_again(whole: AppearanceModel, textures: Textures, rows: np.ndarray, variance: Variance) -> AppearanceModel:
    """Learn an appearance from some rows of its textures, with as many modes as the whole one if that is automatic."""
    modes = whole.n_modes if variance == "auto" else variance  # a number of modes, or a share of the variance
    part = train_appearance_model(textures, modes, rows, left_out=None)
    # The error on unseen images is that of the whole model's folds.
    return replace(part, unexplained=whole.unexplained)
