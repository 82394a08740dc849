"""Relighting of an image in one call, from the fit to the picture."""

import warnings
from collections.abc import Sequence

import numpy as np

from liaam.errors import LiaamError
from liaam.fitting import FitResult, Fitter, Method
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.model import AAM
from liaam.relighting.lamp import AMBIENT, Lamp, check_ambient
from liaam.relighting.relighter import Relighter

UNCERTAIN = 0.6
"""Certainty of the light, of 1, below which a warning is given."""

Light = Sequence[float] | Lamp | Sequence[Lamp]


def relight(
    model: AAM,
    image,
    light: Light | None = None,
    *,
    like=None,
    ambient: float = AMBIENT,
    init=None,
    like_init=None,
    method: str | Method = DEFAULT_METHOD,
    **settings,
) -> np.ndarray:
    """Fit a model to an image, and show the object in another light.

    For many images or lights, make a :class:`liaam.relighting.Relighter` of a fit.

    Parameters
    ----------
    model : AAM
        Trained on colour images.
    image : (h, w, 3) uint8, uint16 or float array, or path
    light : (3,) float, Lamp, or sequence of Lamp, optional
        Direction to a distant lamp (x to the right, y down, z to the viewer), or lamps. By default the light of the
        training images, which removes the shading.
    like : image, optional
        Another image of such an object, whose light is used; not together with ``light``.
    ambient : float
        Fraction of ambient light with ``light``, 0 to 1.
    init, like_init : start, optional
        Starts of the fits to the two images, as for :func:`liaam.fit`. By default the objects are searched for.
    method : str or Method
        ``soft-li``, or a method on logarithms such as ``li``.
    **settings
        Other keyword arguments of :func:`liaam.fit`.

    Returns
    -------
    (h, w, 3) uint8 array

    Warns
    -----
    UserWarning
        If a fit may be wrong, or the light is uncertain.

    Raises
    ------
    LiaamError
        If ``light`` and ``like`` are given, an argument is invalid, or an image or the model is grey.

    Examples
    --------
    >>> flat = liaam.relight(model, "new.png")                                              # doctest: +SKIP
    >>> lit = liaam.relight(model, "new.png", (1, 0, 1))                                    # doctest: +SKIP
    """
    if light is not None and like is not None:
        raise LiaamError("light and like cannot be combined; give one of them")
    lamps = None if light is None else lamps_of(light)
    check_colour(model, model.name or "the model")
    check_ambient(ambient)
    fitter, other = Fitter.of(model, method, **settings), None
    if like is not None:
        other, result = separated(fitter, like, like_init, "like")
        _warn(result, "like")
    relighter, result = separated(fitter, image, init)
    _warn(result, "image")
    if relighter.certain < UNCERTAIN:
        warnings.warn(f"image: {uncertainty_of(relighter)}", stacklevel=2)
    return shown(relighter, lamps, other, ambient)


def check_colour(model: AAM, name: str) -> None:
    """Raise if a model was trained on grey images."""
    if not model.is_colour:
        raise LiaamError(
            f"{name}: the model was trained on grey images, and estimating shading needs colour; train on colour images"
        )


def lamps_of(light: Light) -> list[Lamp]:
    """Return the lamps of a direction, a lamp or several lamps."""
    if isinstance(light, Lamp):
        return [light]
    several = list(light)
    if several and all(isinstance(lamp, Lamp) for lamp in several):
        return several  # type: ignore[return-value]
    return [Lamp(several)]  # type: ignore[arg-type]


def shown(
    relighter: Relighter, lamps: Sequence[Lamp] | None = None, other: Relighter | None = None, ambient: float = AMBIENT
) -> np.ndarray:
    """Show an object under lamps, or the light of another image, or that of training."""
    if other is not None:
        return relighter.like(other)
    return relighter.flat() if lamps is None else relighter.under_lamps(lamps, ambient)


def separated(fitter: Fitter, image, init=None, name: str = "image") -> tuple[Relighter, FitResult]:
    """Fit an image and separate it into appearance and shading."""
    result = fitter.fit(image, init, name)
    return Relighter.of(fitter, image, result, name=name), result


def uncertainty_of(relighter: Relighter) -> str:
    """Say that the light of an image is not well known."""
    return (
        f"the light is uncertain ({relighter.certain:.2f} of 1): the image may be too dark, clipped or unlike the "
        "training images; look at the map of certainty"
    )


def _warn(result: FitResult, name: str) -> None:
    if not result.status.ok:
        warnings.warn(f"{name}: {result.status}: {result.message}", stacklevel=3)
