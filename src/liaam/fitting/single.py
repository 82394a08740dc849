"""Fit one image, with fitters that are kept for the next call."""

from dataclasses import replace
from threading import Lock

from liaam.fitting.fitter import Fitter
from liaam.fitting.loop.encoded_image import MARGIN
from liaam.fitting.methods import DEFAULT_METHOD, Method
from liaam.fitting.result import FitResult
from liaam.fitting.sides import AUTO
from liaam.model import AAM
from liaam.model.aam import named_model
from liaam.photometry import CameraModel

FITTERS_KEPT = 4
"""Number of fitters that are kept with a model: :func:`fit` in a loop then costs what :meth:`Fitter.fit` costs."""

_turn = Lock()


def kept_fitter(model: AAM | str, method: str | Method, camera: CameraModel | None, **settings) -> Fitter:
    """Return a fitter, of an earlier call with equal settings if it is kept; a model's are dropped with it."""
    named = named_model(model)
    cache = vars(named).setdefault("_fitters", {}) if isinstance(named, AAM) else {}
    key = method, camera, *sorted(settings.items())
    try:
        hash(key)
    except TypeError:  # no setting is a list or an array: refused by name
        return Fitter.of(named, method, camera=camera, caller=fit, **settings)
    with _turn:
        fitter = cache.get(key)
    if fitter is None:
        fitter = Fitter.of(named, method, camera=camera, caller=fit, **settings)
    with _turn:
        cache.pop(key, None)
        cache[key] = fitter  # the last used is dropped last
        while len(cache) > FITTERS_KEPT:
            cache.pop(next(iter(cache)))
    return fitter


def fit(
    model: AAM | str,
    image,
    init=None,
    method: str | Method = DEFAULT_METHOD,
    *,
    camera: CameraModel | None = None,
    rotations: str | None = None,
    restarts: bool = True,
    margin: float = MARGIN,
    side: str = AUTO,
    **options,
) -> FitResult:
    """Fit a model to one image. For many images use :func:`fit_many`, or make a :class:`Fitter` once.

    Parameters
    ----------
    model : AAM or "face"
        A model, or the name of one that comes with liaam (:data:`liaam.models.MODELS`).
    image : (h, w, 3) uint8, uint16 or float array, or path
    init : (n, 2) shape, (m, 2) points, (x0, y0, x1, y1) box, (x, y, diagonal), or Detection, optional
        Start, image pixels (see :meth:`Fitter.fit`). If None, the object is searched for.
    method : str or Method
        See :data:`liaam.fitting.METHODS`.
    camera, rotations, restarts, margin, side
        As for :class:`Fitter`.
    **options
        Fields of :class:`liaam.fitting.SolverOptions`, such as ``max_iterations``.

    Returns
    -------
    FitResult
        Also for a fit that fails: see its ``status``.

    Raises
    ------
    ImageError, StartError, MethodError
        If an argument is invalid.
    """
    settings = {"rotations": rotations, "restarts": restarts, "margin": margin, "side": side, **options}
    return _with_image(kept_fitter(model, method, camera, **settings).fit(image, init), image)


def fit_all(
    model: AAM | str,
    image,
    method: str | Method = DEFAULT_METHOD,
    *,
    camera: CameraModel | None = None,
    rotations: str | None = None,
    restarts: bool = True,
    margin: float = MARGIN,
    side: str = AUTO,
    **options,
) -> list[FitResult]:
    """Fit a model to every object that the search finds in an image.

    Parameters
    ----------
    model, image, method, camera, rotations, restarts, margin, side, **options
        As for :func:`fit`.

    Returns
    -------
    list of FitResult
        In reading order: by rows from the top, in each from the left. At most 20.

    Raises
    ------
    ImageError, StartError, MethodError
        If an argument is invalid, or if no object is found.
    """
    settings = {"rotations": rotations, "restarts": restarts, "margin": margin, "side": side, **options}
    return [_with_image(result, image) for result in kept_fitter(model, method, camera, **settings).fit_all(image)]


def _with_image(result: FitResult, image) -> FitResult:
    """Return a result with its image, unless it has the path."""
    return result if result.image is not None else replace(result, image=image)
