"""Train an active appearance model from landmarked images."""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any

import numpy as np

from liaam.errors import TrainingError
from liaam.lamps import Copies, Lamps, learn_lamps
from liaam.model import AAM, MESH, SURROUNDINGS, VIEWS, Level, View
from liaam.model.cost import TooLargeError, check_cost
from liaam.model.shape import choose_recipe, mirror_order, scaled_mean, shape_model_on
from liaam.photometry import CameraModel
from liaam.photometry.camera import check_camera
from liaam.photometry.features import FeatureFunction
from liaam.progress import Progress, reported
from liaam.training import faces
from liaam.training.entries import Entry, check_flat, mesh_of, read_entries, without_folded
from liaam.training.features import encoder_of
from liaam.training.images import check_images
from liaam.training.kept import ALL, chosen, keep_only, wanted
from liaam.training.left_out import Settings, calibrated, can_be_calibrated, fitted_of, folds_of
from liaam.training.options import AUTO, TrainingOptions
from liaam.training.points import Points, map_of_points, points_of
from liaam.training.search_filter import FilterLearner
from liaam.training.shapes import shape_groups
from liaam.training.symmetry import describe_offset, sideways_offset
from liaam.training.textures import FITTED, Steps, learning_cost, level_appearances, sample_all
from liaam.workers import one_blas_thread


@one_blas_thread()
def train(
    data: Iterable,
    options: TrainingOptions | None = None,
    *,
    camera: CameraModel | None = None,
    lamps: Lamps | Iterable | None = AUTO,
    training_lamp: str | None = None,
    points: Points | None = None,
    features: FeatureFunction | None = None,
    contours: Iterable | None = None,
    name: str = "",
    progress: Progress | bool | None = None,
    **changes: Any,
) -> AAM:
    """Train an active appearance model.

    Parameters
    ----------
    data : Dataset, or iterable of Sample or (image, landmarks) pairs
        Images are (h, w, 3) arrays or paths; landmarks are (n, 2) arrays (x, y), :class:`liaam.io.Landmarks` or paths.
        All must have the same number of points, in the same order.
    options : TrainingOptions, optional
        How to train. The defaults suit most data.
    camera : CameraModel, optional
        The training camera. Default: an angle of 122 degrees and sRGB.
    lamps : "auto", Lamps, Dataset or iterable of Sample, optional
        Lamps under which copies of the images are relit, or images of a few objects under several lamps to learn these
        from (:func:`liaam.lamps.learn_lamps`); None for none. ``"auto"``: lamps of generated heads if the objects are
        faces (:func:`liaam.training.faces.face_lamps`), else none.
    training_lamp : str, optional
        Name of the light of ``data`` in the names of the images of ``lamps``.
    points : path, callable or sequence, optional
        Points of another landmarker on the images, so that fits can start from its points and weigh them in: a folder
        of landmark files named as the images, or ``"mediapipe"`` for its face mesh; a function that returns the points
        of an image, (m, 2) or None; or the points of each image in turn. Images without points are not used to learn
        the map. The number m must differ from that of the landmarks.
    features : callable, optional
        A function from an image (h, w, 3) float32, sRGB values in [0, 1], to its channels (h, w, c) float, for
        :func:`liaam.fitting.features_method`. The model keeps its name, and a projection to 7 channels if there are
        more.
    contours : iterable of sequences of int, optional
        Lines through landmarks, such as the jaw: their indices in turn, from 0, with the first once more at the end if
        the line is closed. Along contours landmarks are less certain than across. Default: those of the landmark files.
    name : str
        Name of the model, for display.
    progress : bool or callable, optional
        Whether to show a progress bar on standard error; by default on a terminal, after two seconds. Or a function
        that is called with (done, total, what) before each step and at the end, in units of about the same time.
    **changes
        Fields of :class:`TrainingOptions` that replace those of ``options``, such as ``diagonal=100``.

    Returns
    -------
    AAM

    Raises
    ------
    TrainingError
        If there are fewer than 3 shapes, or shapes of different lengths, missing (NaN) landmarks, black images and the
        like. The message names the sample. Samples whose landmarks fold the mesh are left out, with a warning, unless
        most do.
    """
    if not isinstance(options, TrainingOptions | None):
        raise TrainingError(f"options {options!r}: give TrainingOptions, or options, camera and lamps by name")
    options = (options or TrainingOptions()).changed(changes)
    camera = camera or CameraModel()
    check_camera(camera)
    entries, *about = read_entries(data, contours, options.strict)
    shapes, names = np.array([entry.points for entry in entries]), [entry.name for entry in entries]
    groups = shape_groups(shapes, names, options.shapes)
    if len(groups) > 1 and not isinstance(lamps, str | PathLike | Lamps | None):
        lamps = list(lamps)  # every model learns from them
    given = lamps, training_lamp, features
    models = []
    for group in groups:
        theirs = points if len(groups) == 1 else points_of(points, group)
        own = [entries[i] for i in group]
        models.append(_train_one(own, about, options, camera, given, theirs, name, progress))
    return replace(models[0], others=tuple(models[1:])) if len(groups) > 1 else models[0]


def _train_one(
    entries: list[Entry],
    about: Sequence,
    options: TrainingOptions,
    camera: CameraModel,
    given: tuple[Lamps | Iterable | None, str | None, FeatureFunction | None],
    points: Points | None,
    name: str,
    progress: Progress | bool | None,
    greys: np.ndarray | None = None,
) -> AAM:
    """Train a model of one kind of shape.

    ``about`` are the contours, edges and names of the landmarks, and ``given`` the lamps, the training lamp and the
    features, as of :func:`train`. ``greys`` says which images are grey if they have been checked, (m,) bool.
    """
    (contours, edges, names), (lamps, training_lamp, features) = about, given
    shapes, folds = np.array([entry.points for entry in entries]), folds_of([entry.name for entry in entries])

    priors = options.priors(shapes.shape[1])
    mean = scaled_mean(shapes, options.diagonal)
    recipes = {prior: choose_recipe(mean, shapes, prior, folds) for prior in dict.fromkeys(priors.values())}
    learnt = {prior: shape_model_on(mean, shapes, options.variance, r, folds) for prior, r in recipes.items()}
    check_flat(mean, shapes)
    triangles = mesh_of(mean, options.triangles, edges)

    model = AAM(
        views={view: View(warp_of(learnt[priors[view]], triangles), ()) for view, warp_of in VIEWS.items()},
        triangles=triangles,
        camera=camera,
        n_images=len(entries),
        contours=contours,
        landmark_names=names,
        name=name,
    )
    checked, grey = check_images(entries, model.warp, camera.response) if greys is None else (entries, greys)
    sound = without_folded(entries, mean, triangles, options.strict)
    if len(sound) < len(entries):
        rest, points = [checked[i] for i in sound], points_of(points, sound)
        return _train_one(rest, about, options, camera, given, points, name, progress, grey[sound])

    encoder = None if features is None else encoder_of(features, checked, mean, camera)
    lit = _lamps(lamps, training_lamp, checked, mean, camera) if options.n_copies else None
    symmetric = mirror_order(mean)
    copied = _copies(lit, symmetric, checked, model, options)
    if copied.offset:
        warnings.warn(describe_offset(copied.offset), stacklevel=4)
    model = replace(
        model,
        n_textures=len(copied.owners),
        n_lamps=len(lit) if lit is not None and copied.are_relit else 0,
        light=None if lit is None else lit.basis(symmetric is not None),
        points=None if points is None else map_of_points(points, entries, mean),
        features=None if encoder is None else encoder.features,
        is_colour=not grey.all(),
    )
    blurs, kept = options.blurs_by_view, options.appearance_variances
    methods = chosen(options.methods)
    names = {view: [wanted(methods, view, i, len(blurs[view])) for i in range(len(blurs[view]))] for view in VIEWS}
    if encoder is not None:
        names[MESH] = [[*each, "features"] for each in names[MESH]]
    with reported("training", progress) as report:
        steps = _steps(model, options, folds, report)
        filters = FilterLearner(model, blurs[MESH][0])
        sampled = sample_all(checked, grey, model, blurs, names, steps, copied, encoder, filters)
        model = replace(model, search_filter=filters.learnt())
        for view in VIEWS:
            levels = []
            for i, blur in enumerate(blurs[view]):
                steps.next(f"appearance of the {view}", learning_cost(model.n_textures))
                found = level_appearances(sampled, names[view][i], i, camera.theta, kept[view], folds)
                levels.append(Level(float(blur), found))
            model = model.with_view(view, levels=tuple(levels))
        _check_cost(model)

        if options.leave_out:
            settings: Settings = {view: (recipes[priors[view]], options.variance, kept[view]) for view in VIEWS}
            named = chosen(() if options.methods == ALL else options.methods)  # of all, only the default one
            known = list({method.name: method for method in named if can_be_calibrated(method)}.values())
            model = calibrated(model, checked, shapes, sampled, copied, settings, known, folds, steps)
        steps.next("trained", 0)
    # A model of exactly the training images is not rounded.
    return model if options.keeps_all else keep_only(model, methods)


def _check_cost(model: AAM) -> None:
    """Raise TrainingError if the file of a model would be refused when it is read."""
    try:
        check_cost(model.views.values())
    except TooLargeError as fault:
        raise TrainingError(
            f"the model of {model.n_images} images is too large: {fault}. Give a smaller diagonal (now "
            f"{model.diagonal:g} pixels), a smaller variance of the appearance, or fewer lamps"
        ) from fault


def _copies(
    lit: Lamps | None, symmetric: np.ndarray | None, entries: list[Entry], model: AAM, options: TrainingOptions
) -> Copies:
    """Return which copies of the images are made, and by how much the landmarks of mirrored ones are moved."""
    each = options.n_copies
    copied = Copies.of(lit, len(entries), each, symmetric if each else None)
    if copied.order is None:
        return copied
    warp, blur = model.views[SURROUNDINGS].warp, float(options.blurs_by_view[SURROUNDINGS][-1])
    return replace(copied, offset=sideways_offset(entries, copied.order, warp, model.camera, blur))


def _steps(model: AAM, options: TrainingOptions, folds: list, progress: Progress) -> Steps:
    """Return the steps of training from its images on: sampling, learning, and fitting what is left out."""
    left_out = folds if options.leave_out else []
    n_models = sum(map(len, options.blurs_by_view.values())) + len(left_out)
    n_fitted = sum(len(fitted_of(fold, folds)) for fold in left_out)
    total = model.n_textures + learning_cost(model.n_textures) * n_models + FITTED * n_fitted
    return Steps(progress, total)


def _lamps(
    given: Lamps | Iterable | None,
    training_lamp: str | None,
    entries: list[Entry],
    mean: np.ndarray,
    camera: CameraModel,
) -> Lamps | None:
    """Return the lamps for copies of the images: given, learnt, or those of faces."""
    if training_lamp is not None and (given is None or isinstance(given, str | Lamps)):
        raise TrainingError(
            f"training_lamp {training_lamp!r} names the training light in lamp images; give these images as lamps=, or "
            "leave it out"
        )
    if isinstance(given, str | PathLike):
        if given != AUTO:
            raise TrainingError(
                f"lamps {str(given)!r}: give 'auto', lamps, images to learn them from, or None; for a file give "
                "liaam.lamps.load_lamps(file), for a folder liaam.load_folder(folder)"
            )
        return faces.face_lamps(entries, mean, camera)
    if given is not None and not isinstance(given, Lamps):
        given = learn_lamps(given, training_lamp, response=camera.response)
    if given is not None:
        given.check_landmarks(len(mean), "the images")
    return given
