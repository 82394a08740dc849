"""Train an active appearance model from landmarked images."""

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from typing import Any

import numpy as np

from liaam.errors import TrainingError
from liaam.fitting.methods import Method
from liaam.io.files import fingerprint_of
from liaam.model import AAM, MESH, SURROUNDINGS, VIEWS, Level, View
from liaam.model.cost import TooLargeError, check_cost
from liaam.model.file_format import ALL_ROTATIONS, UPRIGHT
from liaam.model.missing import Missing
from liaam.model.shape import (
    Recipe,
    ShapeModel,
    choose_recipe,
    mean_in_box,
    mirror_order,
    scaled_mean,
    shape_model_on,
)
from liaam.model.views import shape_model_of
from liaam.photometry import CameraModel
from liaam.photometry.camera import check_camera
from liaam.photometry.features import FeatureFunction
from liaam.progress import Progress, reported
from liaam.scale.choice import shared_length
from liaam.training import faces
from liaam.training.compacting import ALL, chosen, keep_only, wanted
from liaam.training.entries import (
    Entry,
    TrainingData,
    check_flat,
    read_entries,
    with_all_landmarks,
    without_folded,
)
from liaam.training.features import encoder_of
from liaam.training.filling import is_enough
from liaam.training.images import check_images
from liaam.training.lamps import Copies, LearntLamps, learn_lamps
from liaam.training.left_out import (
    NEAR_PICTURES,
    OTHER_PICTURES,
    ViewSettings,
    calibrated,
    can_be_calibrated,
    cost_of_fits,
)
from liaam.training.objects import folds_of, groups_of
from liaam.training.options import AUTO, TrainingOptions
from liaam.training.points import Points, map_of_points, points_of
from liaam.training.poses import poses_of
from liaam.training.refiner import Refinement, RefinerLearner, seen_of
from liaam.training.regressor import LEAST_OBJECTS, Regression, RegressorData
from liaam.training.rotations import rotations_of
from liaam.training.search_filter import FilterLearner
from liaam.training.shapes import shape_groups
from liaam.training.sides import counted, of_all, on_one_side
from liaam.training.symmetry import describe_offset, sideways_offset
from liaam.training.textures import Sampled, Steps, Wanted, learning_cost, level_appearances, sample_all
from liaam.training.triangulation import MeshOfLandmarks, mesh_of
from liaam.workers import one_blas_thread


@one_blas_thread()
def train(
    data: Iterable,
    options: TrainingOptions | None = None,
    *,
    camera: CameraModel | None = None,
    lamps: LearntLamps | Iterable | None = AUTO,
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
        All must have the same number of points, in the same order. Images of one side, such as left wings, are
        reflected to the other (``sides``). Missing landmarks are (NaN, NaN): the shapes are learnt
        by expectation maximisation, and the appearance where known landmarks place it. :attr:`liaam.AAM.n_missing`
        counts them.
    options : TrainingOptions, optional
        How to train. The defaults suit most data.
    camera : CameraModel, optional
        The training camera. Default: an angle of 122 degrees and sRGB.
    lamps : "auto", LearntLamps, Dataset or iterable of Sample, optional
        Lamps under which copies of the images are relit, or images of a few objects under several lamps to learn these
        from (:func:`liaam.training.learn_lamps`); None for none. ``"auto"``: lamps of rendered heads if the objects
        are faces (:func:`liaam.training.faces.face_lamps`), else none.
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
        that is called with (done, total, what) before each step and at the end, in units of about the same time. If
        landmarks are missing, a count of its own for these comes first.
    **changes
        Fields of :class:`TrainingOptions` that replace those of ``options``, such as ``diagonal=100``.

    Returns
    -------
    AAM

    Raises
    ------
    TrainingError
        If there are fewer than 3 shapes, or shapes of different lengths, a landmark that is missing in all, black
        images and the like. The message names the sample. Samples with fewer than 3 landmarks, and those whose
        landmarks fold the mesh, are left out, with a warning, unless most do.
    """
    if not isinstance(options, TrainingOptions | None):
        raise TrainingError(f"options {options!r}: give TrainingOptions, or options, camera and lamps by name")
    options = (options or TrainingOptions()).changed(changes)
    camera = camera or CameraModel()
    check_camera(camera)
    samples = on_one_side(read_entries(data, contours, options.strict), options.sides)
    samples = with_all_landmarks(samples, folds_of(samples.names), progress)
    groups = shape_groups(samples.shapes, samples.names, options.shapes)
    if len(groups) > 1 and not isinstance(lamps, str | PathLike | LearntLamps | None):
        lamps = list(lamps)  # every model learns from them
    task = _Task(  # the same for all parts
        options=options,
        camera=camera,
        lamps=lamps,
        training_lamp=training_lamp,
        features=features,
        name=name,
        progress=progress,
    )
    models = []
    for group in groups:
        if len(groups) == 1:
            models.append(_train_one(samples, points, task))
        else:
            models.append(_train_one(_part_of(samples, group, progress), points_of(points, group), task))
    sides = of_all([model.sides for model in models])
    models = [replace(model, sides=sides) for model in models]
    scale = shared_length([entry.pixel for entry in samples.entries])
    if any(model.rotations == ALL_ROTATIONS for model in models):  # all shapes are searched for in one way
        models = [replace(model, rotations=ALL_ROTATIONS) for model in models]
    files = [entry.file for entry in samples.entries if entry.file is not None]
    prints = tuple(sorted({fingerprint_of(file) for file in files} - {""}))
    return replace(models[0], others=tuple(models[1:]), scale=scale, fingerprints=prints)


def _part_of(data: TrainingData, indices: np.ndarray, progress: Progress | bool | None) -> TrainingData:
    """Return some of the samples, whose missing landmarks are estimated anew from these alone if that is possible."""
    entries = [data.entries[i] for i in indices]
    missing = None if data.missing is None else data.missing.of(indices)
    part = replace(data, entries=entries, missing=missing)
    if missing is not None and not is_enough(missing.known):
        return part
    return with_all_landmarks(part, folds_of(part.names), progress)


@dataclass(frozen=True, eq=False)
class _Task:
    """What models of all kinds of shape are trained with: arguments of :func:`train`."""

    options: TrainingOptions
    camera: CameraModel
    lamps: LearntLamps | Iterable | None
    training_lamp: str | None
    features: FeatureFunction | None
    name: str
    progress: Progress | bool | None


@dataclass(frozen=True, eq=False)
class _Shapes:
    """What training learns from landmarks alone.

    Attributes
    ----------
    landmarks : (m, n, 2) float64
        Landmarks of all images.
    missing : Missing, optional
        Which of these are estimates, and how uncertain they are; None if all are known.
    folds : list of arrays
        Images that are left out together, by index.
    mean : (n, 2) float64
        Mean shape, pixels of the reference frame.
    recipes : dict of Recipe
        Settings of the covariance, by view.
    models : dict of ShapeModel
        Shape models, by view.
    mesh : MeshOfLandmarks
        Mesh of the mean shape.
    """

    landmarks: np.ndarray
    missing: Missing | None
    folds: list[np.ndarray]
    mean: np.ndarray
    recipes: dict[str, Recipe]
    models: dict[str, ShapeModel]
    mesh: MeshOfLandmarks


def _train_one(data: TrainingData, points: Points | None, task: _Task) -> AAM:
    """Train a model of one kind of shape; ``points`` are those of another landmarker, as of :func:`train`."""
    options = task.options
    camera = task.camera
    shapes = _learn_shapes(data, options)
    model = _without_appearances(data, shapes, task)
    entries, grey = check_images(data.entries, model.warp, camera.response)
    while True:
        sound = without_folded(entries, shapes.mean, shapes.mesh.triangles, options.strict)
        if len(sound) == len(entries):
            break
        # Learn again without the images that fold the mesh, until none does: each mesh is that of another mean shape.
        # The images are not read and checked again.
        data = _part_of(replace(data, entries=entries), sound, task.progress)
        entries = data.entries
        grey = grey[sound]
        points = points_of(points, sound)
        shapes = _learn_shapes(data, options)
        model = _without_appearances(data, shapes, task)
    if shapes.mesh.in_pieces:
        description = shapes.mesh.describe(len(entries), data.landmark_names, model.n_points)
        warnings.warn(description, stacklevel=4)  # the caller of train, which is decorated

    encoder = None if task.features is None else encoder_of(task.features, entries, shapes.mean, camera)
    lamps = _lamps(task, entries, shapes.mean) if options.n_copies else None
    mirrored = mirror_order(shapes.mean)
    copies = _copies(lamps, mirrored, entries, model, options)
    if copies.offset:
        warnings.warn(describe_offset(copies.offset), stacklevel=4)  # the caller of train, which is decorated
    model = replace(
        model,
        n_textures=len(copies.owners),
        n_lamps=len(lamps) if lamps is not None and copies.are_relit else 0,
        light=None if lamps is None else lamps.basis(mirrored is not None),
        points=None if points is None else map_of_points(points, data.entries, shapes.mean),
        features=None if encoder is None else encoder.features,
        is_colour=not grey.all(),
    )
    groups = groups_of([entry.name for entry in entries])
    regression = None
    if options.learns_regressor(under_lamps=lamps is not None):
        regression = Regression(
            data=partial(RegressorData.of, entries, shapes.landmarks, model, groups),
            n_objects=len(groups),
            forced=options.regressor is True,
        )
    refinement = None
    if options.learns_refiner:
        refinement = Refinement(
            learner=RefinerLearner(shapes.mean, camera.response),
            seen=seen_of(copies.owners),
            owners=copies.owners,
            groups=groups,
            forced=options.refiner is True,
        )
    appearance_names = _appearances_to_learn(options, has_features=encoder is not None)
    sides = counted(data.sides, entries)
    blurs = options.blurs_by_view
    with reported("training", task.progress) as report:
        steps = _steps(model, options, shapes.folds, report)
        filters = FilterLearner(model, blurs[MESH][0])  # which sees all images and copies while they are sampled
        sampled = sample_all(entries, grey, model, blurs, appearance_names, steps, copies, encoder, filters, refinement)
        model = replace(model, search_filter=filters.learnt())
        model = _with_appearances(model, sampled, appearance_names, shapes.folds, options, steps)
        _check_cost(model)
        if options.leave_out:
            model = calibrated(
                model,
                entries=entries,
                shapes=shapes.landmarks,
                missing=shapes.missing,
                sampled=sampled,
                copied=copies,
                settings=_settings_by_view(shapes, options),
                methods=_methods_to_calibrate(options),
                folds=shapes.folds,
                steps=steps,
                regression=regression,
                refinement=refinement,
                has_sides=sides is not None,
            )
        else:
            if regression is not None and regression.forced:
                model = replace(model, regressor=regression.data().learn(shape_model_of(model.views)))
            if refinement is not None and refinement.forced:
                model = replace(model, refiner=refinement.learn())
        steps.next("trained", 0)
    if options.regressor is True and model.regressor is None:
        warnings.warn(
            f"the model has no regressor, which is learnt from {LEAST_OBJECTS + 1} objects with all landmarks at "
            "least: give more of them",
            stacklevel=4,  # the caller of train, which is decorated
        )
    if options.refiner is True and model.refiner is None:
        warnings.warn(
            f"the model has no refiner, which is learnt from {LEAST_OBJECTS} objects at least that show each landmark: "
            "give more of them",
            stacklevel=4,  # the caller of train, which is decorated
        )
    model = replace(model, sides=sides)
    if options.keeps_all:  # a model of exactly the training images is not rounded
        return model
    return keep_only(model, chosen(options.methods))


def _learn_shapes(data: TrainingData, options: TrainingOptions) -> _Shapes:
    """Learn mean, shape models and mesh from the landmarks of images."""
    landmarks = data.shapes
    folds = folds_of(data.names)
    mean = scaled_mean(landmarks, options.diagonal)
    check_flat(mean, landmarks)
    mesh = mesh_of(data, mean, options.triangles)  # first, so that its faults are raised soon
    prior_of = options.priors(landmarks.shape[1])
    # Views with the same prior share recipe and shape model, which take time to learn.
    missing = data.missing
    recipes = {
        prior: choose_recipe(mean, landmarks, prior, folds, missing) for prior in dict.fromkeys(prior_of.values())
    }
    models = {
        prior: shape_model_on(mean, landmarks, options.variance, recipe, folds, missing)
        for prior, recipe in recipes.items()
    }
    return _Shapes(
        landmarks=landmarks,
        missing=missing,
        folds=folds,
        mean=mean,
        recipes={view: recipes[prior_of[view]] for view in VIEWS},
        models={view: models[prior_of[view]] for view in VIEWS},
        mesh=mesh,
    )


def _without_appearances(data: TrainingData, shapes: _Shapes, task: _Task) -> AAM:
    """Return a model of shapes and mesh, whose views have no levels yet."""
    mesh = shapes.mesh
    rotations = rotations_of(shapes.landmarks, shapes.mean)
    views = {
        view: View(warp=warp_of(shapes.models[view], mesh.triangles, mesh.in_pieces), levels=())
        for view, warp_of in VIEWS.items()
    }
    return AAM(
        views=views,
        triangles=mesh.triangles,
        in_pieces=mesh.in_pieces,
        poses=poses_of(shapes.landmarks, shapes.mean) if mesh.in_pieces else None,
        camera=task.camera,
        n_images=len(data.entries),
        contours=data.contours,
        landmark_names=data.landmark_names,
        name=task.name,
        n_missing=None if data.missing is None else data.missing.counts,
        in_box=mean_in_box(shapes.landmarks) if rotations == UPRIGHT else None,
        rotations=rotations,
    )


def _appearances_to_learn(options: TrainingOptions, has_features: bool) -> Wanted:
    """Return the names of the appearances to learn, by view and level; ``has_features`` of a function of the user."""
    methods = chosen(options.methods)
    names = {}
    for view in VIEWS:
        n_levels = len(options.blurs_by_view[view])
        names[view] = [wanted(methods, view, i, n_levels) for i in range(n_levels)]
    if has_features:
        names[MESH] = [[*of_level, "features"] for of_level in names[MESH]]
    return names


def _with_appearances(
    model: AAM,
    sampled: Sampled,
    appearance_names: Wanted,
    folds: list[np.ndarray],
    options: TrainingOptions,
    steps: Steps,
) -> AAM:
    """Learn the appearances of a model from sampled textures, and return it with all levels of its views."""
    for view in VIEWS:
        variance = options.appearance_variances[view]
        levels = []
        for i, blur in enumerate(options.blurs_by_view[view]):
            steps.next(f"appearance of the {view}", learning_cost(model.n_textures))
            names = appearance_names[view][i]
            appearances = level_appearances(sampled, names, i, model.camera.theta, variance, folds)
            levels.append(Level(float(blur), appearances))
        model = model.with_view(view, levels=tuple(levels))
    return model


def _settings_by_view(shapes: _Shapes, options: TrainingOptions) -> Mapping[str, ViewSettings]:
    """Return the settings of each view, with which models that leave images out are trained as this one was."""
    return {
        view: ViewSettings(
            recipe=shapes.recipes[view],
            shape_variance=options.variance,
            appearance_variance=options.appearance_variances[view],
        )
        for view in VIEWS
    }


def _methods_to_calibrate(options: TrainingOptions) -> list[Method]:
    """Return the methods whose fits are calibrated: the default one and those that were asked for by name.

    If all methods are asked for, only the default one: left-out images are fitted with each.
    """
    by_name = () if options.methods == ALL else options.methods
    methods = [method for method in chosen(by_name) if can_be_calibrated(method)]
    return list({method.name: method for method in methods}.values())  # each once


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
    lamps: LearntLamps | None, mirrored: np.ndarray | None, entries: list[Entry], model: AAM, options: TrainingOptions
) -> Copies:
    """Return which copies of the images are made, and how far the landmarks of mirrored ones are moved sideways.

    ``mirrored`` (n,) is the index of each landmark's mirror image; None if the landmarks are not symmetric.
    """
    n_copies = options.n_copies
    copies = Copies.of(lamps, len(entries), n_copies, mirrored if n_copies else None)
    if copies.order is None:  # none is mirrored
        return copies
    # The sharpest level of the surroundings, with which the default method ends.
    warp = model.views[SURROUNDINGS].warp
    blur = float(options.blurs_by_view[SURROUNDINGS][-1])
    return replace(copies, offset=sideways_offset(entries, copies.order, warp, model.camera, blur))


def _steps(model: AAM, options: TrainingOptions, folds: list[np.ndarray], progress: Progress) -> Steps:
    """Return the steps of training from its images on: sampling, learning, and fitting what is left out."""
    left_out = folds if options.leave_out else []
    n_levels = sum(len(blurs) for blurs in options.blurs_by_view.values())
    n_learnt = n_levels + len(left_out)  # a model without a fold takes about as long as a level
    of_fits = cost_of_fits(left_out, NEAR_PICTURES) + cost_of_fits(left_out, OTHER_PICTURES)
    total = model.n_textures + learning_cost(model.n_textures) * n_learnt + of_fits
    return Steps(progress, total)


def _lamps(task: _Task, entries: list[Entry], mean: np.ndarray) -> LearntLamps | None:
    """Return the lamps for copies of the images: given, learnt, or those of faces; None for none."""
    lamps = task.lamps
    training_lamp = task.training_lamp
    camera = task.camera
    if training_lamp is not None and (lamps is None or isinstance(lamps, str | LearntLamps)):
        raise TrainingError(
            f"training_lamp {training_lamp!r} names the training light in lamp images; give these images as lamps=, or "
            "leave it out"
        )
    if lamps is None:
        return None
    if isinstance(lamps, str | PathLike):
        if lamps != AUTO:
            raise TrainingError(
                f"lamps {str(lamps)!r}: give 'auto', lamps, images to learn them from, or None; for a file give "
                "liaam.training.load_lamps(file), for a folder liaam.load_folder(folder)"
            )
        return faces.face_lamps(entries, mean, camera)
    if not isinstance(lamps, LearntLamps):
        lamps = learn_lamps(lamps, training_lamp, response=camera.response)
    lamps.check_landmarks(len(mean), "the images")
    return lamps
