"""The parts of a model, from the header and the tensors of its file: views, appearances, calibrations, light."""

import re
from dataclasses import dataclass, replace

import numpy as np

from liaam.errors import shortened
from liaam.model.appearance import CHANNELS, COPIED_APPEARANCES, AppearanceModel, spread, strongest_modes
from liaam.model.file_checks import (
    ROUNDED,
    UNIT,
    are_unit,
    check_covariances,
    check_magnitude,
    check_variances,
    checked_tensor,
    finite,
    half_or_single,
    number_of,
)
from liaam.model.file_format import (
    LARGEST_FILTER,
    LARGEST_UNIT,
    LEAST_FREEDOM,
    LEAST_SHARE,
    LEAST_SHARPNESS,
    LEAST_UNIT,
    MAX_BLUR,
    MAX_DIAGONAL,
    MAX_FACTOR,
    MAX_LEVELS,
    MAX_LIGHTS,
    MAX_LOG_LIGHT,
    MAX_POINTS,
    MAX_SCALE,
    MAX_VALUE,
    MAX_VARIANCE,
    MOST_EXPANSION,
    MOST_POSES,
    MOST_SHARPNESS,
    MOST_STEPS,
    MOST_WEIGHT,
    OLDER_SHARPNESS,
    RELIEF_STEPS,
    ROOMY,
    STORED,
    UNNAMED,
)
from liaam.model.light_basis import SIDE, LightBasis
from liaam.model.mesh import signed_areas
from liaam.model.point_map import LEAST_NOISE, PointErrors, PointMap
from liaam.model.presence import Presence
from liaam.model.regressor import N_FEATURES, SIZE, USUAL_SHARE, LandmarkRegressor, RegressionStep
from liaam.model.rounding import decoded
from liaam.model.shape import ShapeModel, diagonal_of, similarity_modes
from liaam.model.views import MESH, N_QUALITY_FEATURES, VIEWS, Level, Reliability, View
from liaam.photometry.features import LARGEST, WIDEST, Features

FEWEST_WEIGHTS = 3  # Of the quality in the oldest files: for 1 and two features
# Key of the weights of a method's calibration
WEIGHTS_KEY = re.compile(r"(?P<calibration>reliability(?:/(?P<method>[a-z0-9-]{1,40}))?)\.weights")


def read_search_filter(tensors: dict[str, np.ndarray]) -> np.ndarray | None:
    """Return the filter of the search, (h, w, 5) float32, or (h, w, 2) in older files; None if the model has none."""
    key = "search_filter"
    if key not in tensors:
        return None
    search_filter = half_or_single(tensors, key, (None, None, None))
    height, width, n_channels = search_filter.shape
    if not (1 <= height <= LARGEST_FILTER and 1 <= width <= LARGEST_FILTER and n_channels in (2, 5)):
        raise ValueError(f"{key} has shape {search_filter.shape}")
    check_magnitude(key, search_filter, MAX_VALUE)
    return search_filter


@dataclass(frozen=True)
class AppearanceLimits:
    """What the size of an appearance may be: its channels, and the number of textures that it was learnt from."""

    n_channels: int
    n_textures: int


def limits_of_appearances(n_images: int, n_textures: int, features: Features | None) -> dict[str, AppearanceLimits]:
    """Return the limits on each appearance, by name; ``n_textures`` is the number of images with their copies."""
    limits = {}
    for name, n_channels in CHANNELS.items():
        if name == "features" and features is not None:
            n_channels = features.width
        n_learnt = max(n_images, n_textures) if name in COPIED_APPEARANCES else n_images
        limits[name] = AppearanceLimits(n_channels, n_learnt)
    return limits


def tensors_below(tensors: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Return the tensors whose names start with a prefix, by the rest of their names."""
    return {key.removeprefix(prefix): tensor for key, tensor in tensors.items() if key.startswith(prefix)}


def read_light(tensors: dict[str, np.ndarray], n: int) -> LightBasis:
    """Return the light basis of a model with n landmarks."""
    mean = checked_tensor(tensors, "light.mean", np.float64, (n, 2))
    stored = _stored_pixels(tensors, "light", SIDE * SIDE)
    if stored is None:
        modes = _modes(tensors, "light", (None, SIDE, SIDE, 3))
    else:
        modes = _modes(tensors, "light", (None, int(stored.sum()), 3))
    if not 1 <= len(modes) <= MAX_LIGHTS:
        raise ValueError(f"light.modes has shape {modes.shape}")
    if stored is not None:
        modes = spread(modes, stored, axis=1).reshape(-1, SIDE, SIDE, 3)
    remainder = checked_tensor(tensors, "light.remainder", np.float16, (SIDE, SIDE))
    # The mean shape has a diagonal of 1, up to rounding, and the remainder are standard deviations.
    if np.abs(mean).max() > 1.0 or diagonal_of(mean) < 0.5 or (remainder < 0).any():
        raise ValueError("the light basis has values out of range")
    check_magnitude("light.modes", modes, MAX_LOG_LIGHT)
    check_magnitude("light.remainder", remainder, MAX_LOG_LIGHT)
    return LightBasis(mean, modes, remainder)


def read_features(header: dict, tensors: dict[str, np.ndarray]) -> Features | None:
    """Return what a model knows of the user's function whose channels it fits; None if there is none."""
    if "features" not in header:
        return None
    mean = checked_tensor(tensors, "features.mean", np.float64, (None,))
    projection = checked_tensor(tensors, "features.projection", np.float64, (len(mean), None))
    name = str(header["features"])
    width = projection.shape[1]
    if not name.isidentifier() or not 1 <= width <= WIDEST or not are_unit(projection.T):
        raise ValueError("features.projection is not a projection")
    if np.abs(mean).max(initial=0.0) > LARGEST:
        raise ValueError("features.mean is out of range")
    return Features(name, mean, projection)


def read_point_map(tensors: dict[str, np.ndarray], n: int) -> PointMap | None:
    """Return the map from another landmarker's points to the n landmarks; None if the model has none."""
    if "points.weights" not in tensors:
        return None
    weights = checked_tensor(tensors, "points.weights", np.float64, (n, None))
    if not 3 <= weights.shape[1] <= MAX_POINTS or weights.shape[1] == n or np.abs(weights).max() > MOST_WEIGHT:
        raise ValueError("points.weights do not map another landmarker's points")
    of_points = _point_errors(tensors, "points", n)
    return PointMap(weights, of_points.errors, of_points.noise)


def read_relief(tensors: dict[str, np.ndarray]) -> np.ndarray | None:
    """Return the normals of a model's surface, (SIDE, SIDE, 2) float32; None if they are not known."""
    if "relief" not in tensors:
        return None
    stored = checked_tensor(tensors, "relief", np.int8, (SIDE, SIDE, 2))
    relief = (stored / np.float32(RELIEF_STEPS)).astype(np.float32)
    if (np.square(relief).sum(axis=2) > 1.0 + 2.0 / RELIEF_STEPS).any():  # they are rounded
        raise ValueError("relief holds no components of normals")
    return relief


def read_refiner(tensors: dict[str, np.ndarray], mean: np.ndarray) -> LandmarkRegressor | None:
    """Return the refiner of a model with a mean shape (n, 2), with shapes of its own; None if the model has none."""
    if "refiner.weights" not in tensors:
        return None
    refiner = read_regressor(tensors, "refiner", _shape_model({}, tensors_below(tensors, "refiner."), mean))
    if refiner is None:
        return None
    share = _number_or(USUAL_SHARE, tensors, "refiner.share")
    if not 0.0 <= share <= 1.0:
        raise ValueError("refiner.share is not from 0 to 1")
    sharpness = _number_or(OLDER_SHARPNESS, tensors, "refiner.sharpness")
    if not LEAST_SHARPNESS <= sharpness <= MOST_SHARPNESS:
        raise ValueError(f"refiner.sharpness is not from {LEAST_SHARPNESS:g} to {MOST_SHARPNESS:g}")
    return replace(refiner, share=share, sharpness=sharpness)


def read_poses(tensors: dict[str, np.ndarray], n: int) -> np.ndarray | None:
    """Return the shapes (k, n, 2) float32 that fits start from; None if the model has none."""
    if "poses" not in tensors:
        return None
    poses = checked_tensor(tensors, "poses", np.float32, (None, n, 2))
    if not 1 <= len(poses) <= MOST_POSES:
        raise ValueError(f"there are not 1 to {MOST_POSES} poses")
    check_magnitude("poses", poses, MAX_DIAGONAL)
    if min(diagonal_of(pose) for pose in poses) < 1.0:
        raise ValueError("the landmarks of a pose coincide")
    return poses


def read_in_box(tensors: dict[str, np.ndarray], n: int) -> np.ndarray | None:
    """Return the mean positions (n, 2) of landmarks in their box, from -0.5 to 0.5; None in older files."""
    if "in_box" not in tensors:
        return None
    positions = checked_tensor(tensors, "in_box", np.float64, (n, 2))
    if np.abs(positions).max() > 0.5:
        raise ValueError("positions in the box are not from -0.5 to 0.5")
    return positions


def read_regressor(tensors: dict[str, np.ndarray], kind: str, shapes: ShapeModel) -> LandmarkRegressor | None:
    """Return the regressor or the refiner of a model; None if it has none.

    ``kind`` is "regressor" or "refiner", and ``shapes`` the shape model under which its landmarks are combined.
    """
    if f"{kind}.weights" not in tensors:
        return None
    n = shapes.n_points
    spacings = checked_tensor(tensors, f"{kind}.spacings", np.float64, (None,))
    n_steps = len(spacings)
    if not 1 <= n_steps <= MOST_STEPS or not ((spacings >= 1.0) & (spacings <= SIZE)).all():
        raise ValueError(f"{kind}.spacings are not 1 to {MOST_STEPS} distances from 1 to {SIZE:g} pixels")
    weights = half_or_single(tensors, f"{kind}.weights", (n_steps, n, N_FEATURES, 2))
    offsets = checked_tensor(tensors, f"{kind}.offsets", np.float64, (n_steps, n, 2))
    variances = checked_tensor(tensors, f"{kind}.variances", np.float64, (n_steps, n, 2, 2))
    check_magnitude(f"{kind}.weights", weights, MAX_VALUE)
    check_magnitude(f"{kind}.offsets", offsets, MAX_VALUE)
    for of_step in variances:
        check_covariances(f"{kind}.variances", of_step, MAX_VARIANCE)
    steps = [
        RegressionStep(float(spacings[i]), weights=weights[i], offsets=offsets[i], errors=variances[i])
        for i in range(n_steps)
    ]
    return LandmarkRegressor(shape_model=shapes, steps=tuple(steps), left_out=_point_errors(tensors, kind, n))


def _point_errors(tensors: dict[str, np.ndarray], prefix: str, n: int) -> PointErrors:
    """Return the errors of another landmarker's n landmarks; ``prefix`` starts the names of their tensors."""
    errors = checked_tensor(tensors, f"{prefix}.errors", np.float64, (None, 2 * n))
    noise = float(checked_tensor(tensors, f"{prefix}.noise", np.float64, (1,))[0])
    if np.abs(errors).max(initial=0.0) > MAX_DIAGONAL or not LEAST_NOISE <= noise <= MAX_DIAGONAL**2:
        raise ValueError(f"{prefix}.errors or {prefix}.noise are out of range")
    return PointErrors(errors, noise)


def read_view(
    name: str,
    description: dict,
    tensors: dict[str, np.ndarray],
    mean: np.ndarray,
    triangles: np.ndarray,
    in_pieces: bool,
    limits: dict[str, AppearanceLimits],
) -> View:
    """Return one view of a model.

    Parameters
    ----------
    name : str
    description : dict
        The view in the header.
    tensors : dict of arrays
        Tensors of the model.
    mean : (n, 2) float64
        Mean shape, and with ``triangles`` (t, 3) and ``in_pieces`` the mesh, which all views share.
    limits : dict of AppearanceLimits
        What the sizes of the appearances may be, by name.
    """
    if name not in VIEWS:
        raise ValueError(f"view {shortened(name)!r} is unknown; the views are {', '.join(VIEWS)}")
    if not isinstance(description, dict):
        raise ValueError(f"view {name} is described by {shortened(description)}")
    tensors = tensors_below(tensors, f"{name}/")
    blurs = [finite(blur) for blur in description["blurs"]]
    n_pixels = description["n_pixels"]
    if not 1 <= len(blurs) <= MAX_LEVELS or not all(0 <= blur <= MAX_BLUR for blur in blurs):
        raise ValueError(f"blurs {shortened(blurs)}: 1 to {MAX_LEVELS} numbers between 0 and {MAX_BLUR:g} are expected")
    if not isinstance(n_pixels, int) or n_pixels < 1:
        raise ValueError(f"{shortened(n_pixels)} is not a positive integer")
    if blurs != sorted(blurs, reverse=True):
        raise ValueError(f"blurs {blurs} do not fall from coarse to fine")
    # Appearances first: their tensors limit the number of pixels to what the size of the file allows.
    levels = []
    for i, blur in enumerate(blurs):
        appearances = {}
        for kind in CHANNELS:
            if f"{i}/{kind}.mean" in tensors:
                appearances[kind] = _appearance(tensors, f"{i}/{kind}", n_pixels, limits[kind])
        # In files without an appearance for the search, it is the strongest modes of the orientations.
        if name == MESH and i == 0 and "search" not in appearances and "orientation" in appearances:
            appearances["search"] = strongest_modes(appearances["orientation"])
        levels.append(Level(blur, appearances))
    if _lacks_appearance(name, levels):
        raise ValueError(f"view {name} lacks an appearance")
    # Before the reference frame is made: one that is much larger would need more memory than the file's size suggests.
    if signed_areas(mean, triangles).sum() > ROOMY * n_pixels:
        raise ValueError(f"the reference frame of view {name} does not match its number of pixels")
    warp = VIEWS[name](_shape_model(description, tensors, mean), triangles, in_pieces)
    if n_pixels != warp.frame.n_pixels:
        raise ValueError(f"the reference frame of view {name} does not match its number of pixels")
    warp = replace(warp, from_right=bool(description.get("from_right", False)))
    return View(warp, tuple(levels), _reliabilities(tensors, len(mean)))


def _lacks_appearance(view: str, levels: list[Level]) -> bool:
    """Return whether a view lacks an appearance that every model has."""
    if view == MESH:
        # The drawings of a model and the light on its object need the logarithms of the sharpest level.
        return "log" not in levels[-1].appearances
    return not all(level.appearances for level in levels)


def _reliabilities(tensors: dict[str, np.ndarray], n: int) -> dict[str, Reliability]:
    """Return the calibrations in the tensors of a view with n landmarks, by method."""
    prefixes = {}
    for key in sorted(tensors):
        match = WEIGHTS_KEY.fullmatch(key)
        if match is not None:
            prefixes[match["method"] or UNNAMED] = match["calibration"]
    return {method: _reliability(tensors, prefix, n) for method, prefix in prefixes.items()}


def _shape_model(description: dict, tensors: dict[str, np.ndarray], mean: np.ndarray) -> ShapeModel:
    """Return the shape model of a view from its header and its tensors."""
    n = len(mean)
    modes = checked_tensor(tensors, "shape.modes", np.float64, (None, 2 * n))
    if len(modes) > 2 * n - 4:  # they are orthogonal to each other and to the four similarity vectors
        raise ValueError(f"{len(modes)} shape modes are too many for {n} landmarks")
    basis = np.concatenate([modes, similarity_modes(mean)])
    products = np.einsum("id,jd->ij", modes, basis)  # threads of BLAS would wait longer than this takes
    if not are_unit(modes) or np.abs(products - np.eye(len(modes), len(basis))).max(initial=0.0) > UNIT:
        raise ValueError("shape.modes are not orthonormal")
    eigenvalues = checked_tensor(tensors, "shape.eigenvalues", np.float64, (len(modes),))
    key = "shape.unexplained"
    unexplained = checked_tensor(tensors, key, np.float64, (n, 2, 2)) if key in tensors else None
    if unexplained is not None:
        check_covariances(key, unexplained, MAX_VARIANCE)
    check_magnitude("shape.eigenvalues", eigenvalues, n * MAX_VARIANCE)
    freedom = finite(description["freedom"]) if "freedom" in description else np.inf
    if not freedom >= LEAST_FREEDOM:
        raise ValueError(f"freedom {freedom:g} is below {LEAST_FREEDOM:g}")
    return ShapeModel(mean, modes, eigenvalues, unexplained, freedom)


def _reliability(tensors: dict[str, np.ndarray], prefix: str, n: int) -> Reliability:
    """Return the calibration of a method with n landmarks; ``prefix`` starts the names of its tensors."""
    landmarks = checked_tensor(tensors, f"{prefix}.landmarks", np.float64, (n, 2, 2))
    bias = checked_tensor(tensors, f"{prefix}.bias", np.float64, (n, 2, 2))
    check_covariances(f"{prefix}.landmarks", landmarks, MAX_VARIANCE)
    check_covariances(f"{prefix}.bias", bias, MAX_VARIANCE)
    key = f"{prefix}.scales"
    scales = checked_tensor(tensors, key, np.float64, (n, 2, 2)) if key in tensors else None
    if scales is not None:
        check_covariances(key, scales, MAX_SCALE)

    unit = number_of(tensors, f"{prefix}.unit")
    if not unit > 0.0:
        raise ValueError(f"{prefix}.unit is not positive")
    if not LEAST_UNIT <= unit <= LARGEST_UNIT:
        raise ValueError(f"{prefix}.unit {unit:g} is not between {LEAST_UNIT:g} and {LARGEST_UNIT:g}")
    factor = number_of(tensors, f"{prefix}.variance_factor")
    if factor < 1.0:
        raise ValueError(f"{prefix}.variance_factor is below 1")
    check_magnitude(f"{prefix}.variance_factor", np.array(factor), MAX_FACTOR)
    typical = number_of(tensors, f"{prefix}.typical")
    if not 0.0 <= typical <= 1.0:
        raise ValueError(f"{prefix}.typical is not a probability")
    prior = _number_or(1.0, tensors, f"{prefix}.prior")
    if not prior > 0.0:
        raise ValueError(f"{prefix}.prior is not positive")
    if not 1.0 / MAX_FACTOR <= prior <= MAX_FACTOR:
        raise ValueError(f"{prefix}.prior {prior:g} is not between {1.0 / MAX_FACTOR:g} and {MAX_FACTOR:g}")
    final_prior = _number_or(1.0, tensors, f"{prefix}.final_prior")
    if not 0.0 <= final_prior <= 1.0:
        raise ValueError(f"{prefix}.final_prior is not between 0 and 1")
    expansion = _number_or(1.0, tensors, f"{prefix}.expansion")
    if not 1.0 <= expansion <= MOST_EXPANSION:
        raise ValueError(f"{prefix}.expansion {expansion:g} is not between 1 and {MOST_EXPANSION:g}")

    weights = checked_tensor(tensors, f"{prefix}.weights", np.float64, (None,))
    if not FEWEST_WEIGHTS <= len(weights) <= 1 + N_QUALITY_FEATURES:
        raise ValueError(f"{prefix}.weights has type {weights.dtype} and shape {weights.shape}")
    check_magnitude(f"{prefix}.weights", weights, MAX_FACTOR)

    return Reliability(
        landmarks=landmarks,
        bias=bias,
        unit=unit,
        weights=weights,
        variance_factor=factor,
        typical=typical,
        prior=prior,
        final_prior=final_prior,
        expansion=expansion,
        presence=_presence(tensors, prefix, n),
        scales=scales,
    )


def _number_or(older: float, tensors: dict[str, np.ndarray], name: str) -> float:
    """Return a number, or that which was used when files did not hold it."""
    return number_of(tensors, name) if name in tensors else older


def _presence(tensors: dict[str, np.ndarray], prefix: str, n: int) -> Presence | None:
    """Return the calibration of whether n landmarks are present; older files have none."""
    if f"{prefix}.presence.usual" not in tensors:
        return None
    fields = {}
    for name in STORED["presence"]:
        key = f"{prefix}.presence.{name}"
        fields[name] = checked_tensor(tensors, key, np.float64, (n,))
        check_magnitude(key, fields[name], MAX_FACTOR)
    if not (np.minimum(fields["variances"], fields["spreads"]) >= 1.0 / MAX_FACTOR).all():
        raise ValueError(f"{prefix}.presence has values out of range")
    return Presence(**fields)


def _appearance(
    tensors: dict[str, np.ndarray], prefix: str, n_pixels: int, limits: AppearanceLimits
) -> AppearanceModel:
    """Return an appearance on all pixels of a view, from the tensors whose names start with ``prefix``."""
    channels = limits.n_channels
    stored = _stored_pixels(tensors, prefix, n_pixels)
    n_stored = n_pixels if stored is None else int(stored.sum())
    modes = _modes(tensors, prefix, (None, n_stored, channels))
    # More modes than images would need more memory in a fit than the file's size suggests.
    most = min(n_pixels * channels, limits.n_textures)
    if len(modes) > most:
        raise ValueError(f"{prefix} has {len(modes)} modes; the maximum is {most}")
    # Modes of which only the used pixels are stored, or not 0, are shorter than they were learnt.
    is_part = stored is not None or not modes.any(axis=(0, 2)).all()
    if not are_unit(modes.reshape(len(modes), n_stored * channels), at_most=is_part):
        raise ValueError(f"{prefix}.modes are not of unit length")
    unexplained = _unexplained(tensors, f"{prefix}.unexplained", n_stored, channels)
    mean = half_or_single(tensors, f"{prefix}.mean", (n_stored, channels))
    check_magnitude(f"{prefix}.mean", mean, MAX_VALUE)
    eigenvalues = checked_tensor(tensors, f"{prefix}.eigenvalues", np.float64, (len(modes),))
    check_magnitude(f"{prefix}.eigenvalues", eigenvalues, n_pixels * channels * MAX_VALUE**2)
    appearance = AppearanceModel(
        mean=mean,
        modes=modes,
        eigenvalues=eigenvalues,
        usable=half_or_single(tensors, f"{prefix}.usable", (n_stored,)),
        unexplained=unexplained,
    )
    return appearance if stored is None else appearance.spread(stored)


def _unexplained(tensors: dict[str, np.ndarray], key: str, n_pixels: int, channels: int) -> np.ndarray | None:
    """Return the covariance of an appearance's errors at each pixel, (n_pixels, channels, channels) float32, or None.

    Files store the upper triangle of each matrix, row by row; those of version 4 the whole matrices.
    """
    if key not in tensors:
        return None
    if tensors[key].ndim == 3:
        matrices = half_or_single(tensors, key, (n_pixels, channels, channels))
    else:
        rows, columns = np.triu_indices(channels)
        triangle = half_or_single(tensors, key, (n_pixels, len(rows)))
        matrices = np.empty((n_pixels, channels, channels), np.float32)
        matrices[:, rows, columns] = triangle
        matrices[:, columns, rows] = triangle
    check_variances(key, matrices)
    check_covariances(key, matrices, MAX_VALUE**2, ROUNDED)
    return matrices


def _stored_pixels(tensors: dict[str, np.ndarray], prefix: str, n_pixels: int) -> np.ndarray | None:
    """Mask of the pixels that are stored, (n_pixels,) bool; None if all are. Files store one bit of it per pixel."""
    key = f"{prefix}.known"
    if key not in tensors:
        return None
    n_bytes = -(-n_pixels // 8)  # rounded up
    bits = checked_tensor(tensors, key, np.uint8, (n_bytes,))
    stored = np.unpackbits(bits, count=n_pixels).astype(bool)
    if stored.sum() < LEAST_SHARE * n_pixels:
        raise ValueError(f"{prefix} has {stored.sum()} of {n_pixels} pixels; at least {LEAST_SHARE:.0%} are expected")
    return stored


def _modes(tensors: dict[str, np.ndarray], prefix: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """Modes in single precision; they are stored as codes and steps, or in 16 or 32 bits."""
    key = f"{prefix}.modes"
    if tensors[key].dtype != np.int8:
        return half_or_single(tensors, key, shape)
    codes = checked_tensor(tensors, key, np.int8, shape)
    steps = checked_tensor(tensors, f"{prefix}.steps", np.float32, (len(codes),))
    if (steps < 0).any() or steps.max(initial=0.0) > 1.0:
        raise ValueError(f"{prefix}.steps has values out of range")
    return decoded(codes, steps)
