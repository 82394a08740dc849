"""What a model keeps: the appearances of the default method, of the search and of relighting, and those asked for."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from liaam.fitting.loop.objective import pixels_for
from liaam.fitting.methods import DEFAULT_METHOD, METHODS, Method, check_holds, get_method, methods_of, needed_by
from liaam.fitting.search.templates import pixels_for_search
from liaam.model import AAM, MESH, Level, View
from liaam.model.appearance import CHANNELS, AppearanceModel
from liaam.model.rounding import rounded
from liaam.model.warp import PiecewiseAffineWarp

ALL = "all"  # Value of methods: all of METHODS that a model can have

Methods = Iterable[str | Method] | str
"""Methods by name or as rows, or a single name, which may be ``ALL``."""

# Appearances whose modes are rounded to 8 bits, unless a method that was asked for fits them; the modes of others have
# 16. Of 560 fits of soft-li, half move by less than 0.004 % of the distance between the eyes.
EIGHT_BITS = ("soft", "search", "log")


def chosen(methods: Methods) -> tuple[Method, ...]:
    """Return the default method and those of the given names."""
    if methods == ALL:
        names: Iterable[str | Method] = METHODS
    elif isinstance(methods, str):
        names = [methods]
    else:
        names = methods
    return (METHODS[DEFAULT_METHOD], *map(get_method, names))


def wanted(methods: Sequence[Method], view: str, level: int, n_levels: int) -> list[str]:
    """Return the names of the appearances that a level of a view has: those of methods, search and relighting."""
    needed = set().union(*(needed_by(method) for method in methods if method.view == view))
    if view == MESH and level == 0:  # the search reduces the coarsest level
        needed.add("search")
    if view == MESH and level == n_levels - 1:  # for relighting and drawings
        needed.add("log")
    if "illumination" in needed:  # an illumination basis is learnt relative to the values
        needed.add("value")
    return [name for name in CHANNELS if name in needed]


def compact(model: AAM, methods: Methods = ()) -> AAM:
    """Return a model that holds what the default method, the search and relighting need, in few bits.

    Its file is as small as that of a model trained with the same ``methods``. Files of older versions of liaam hold all
    methods, in single precision.

    Parameters
    ----------
    model : AAM
    methods : names or Methods, or "all"
        Other methods to keep.

    Returns
    -------
    AAM

    Raises
    ------
    MethodError
        If the model lacks a method.
    """
    default, *others = chosen(methods_of(model) if methods == ALL else methods)
    for method in others:
        check_holds(model, method)
    return keep_only(model, [default, *others])


def keep_only(model: AAM, methods: Sequence[Method]) -> AAM:
    """Return a model that holds only what these methods, the search and relighting need, in few bits.

    Parameters
    ----------
    model : AAM
    methods : sequence of Method
        All methods to keep, with the default one.

    Returns
    -------
    AAM
        Its other parts, for other kinds of shape, are reduced in the same way.
    """
    for name, view in model.views.items():
        levels = tuple(_reduced_level(view, name, i, methods) for i in range(len(view.levels)))
        model = model.with_view(name, levels=levels)
    if model.light is not None:
        model = replace(model, light=replace(model.light, modes=rounded(model.light.modes)))
    if model.others:
        model = replace(model, others=tuple(keep_only(other, methods) for other in model.others))
    return model


def _reduced_level(view: View, view_name: str, i: int, methods: Sequence[Method]) -> Level:
    """Return level ``i`` of a view with only the appearances, pixels and bits that the methods need."""
    level = view.levels[i]
    n_levels = len(view.levels)
    # Features are learnt only if training was given a function, so they are always asked for.
    names = {*wanted(methods, view_name, i, n_levels), "features"}
    in_16_bits = _fitted_on_request(methods)
    appearances = {}
    for name, appearance in level.appearances.items():
        if name not in names:
            continue
        appearance = _used_pixels(name, appearance, view.warp, level.blur, is_last=i == n_levels - 1)
        if name in EIGHT_BITS and name not in in_16_bits:
            appearances[name] = _in_eight_bits(appearance)
        else:
            appearances[name] = replace(appearance, modes=_half(appearance.modes))
    return replace(level, appearances=appearances)


def _fitted_on_request(methods: Sequence[Method]) -> set[str]:
    """Return the names of the appearances that the methods fit which were asked for.

    The default method is kept unasked. It fits the view of the surroundings, and the others that of the mesh.
    """
    return set().union(*(needed_by(method) for method in methods if method.view == MESH))


def _used_pixels(
    name: str, appearance: AppearanceModel, warp: PiecewiseAffineWarp, blur: float, is_last: bool
) -> AppearanceModel:
    """Return an appearance with only the pixels that are used.

    Of ``soft``, levels before the last have only the pixels that fits use, and of ``search`` those of the search.
    """
    if name == "soft" and not is_last:
        return appearance.only_at(pixels_for(warp, blur))
    if name == "search":
        return appearance.only_at(pixels_for_search(warp))
    return appearance


def _in_eight_bits(appearance: AppearanceModel) -> AppearanceModel:
    """Return an appearance with modes of 8 bits, and 16 bits for the rest; eigenvalues stay as they are."""
    unexplained = appearance.unexplained
    return AppearanceModel(
        mean=_half(appearance.mean),
        modes=rounded(appearance.modes),
        eigenvalues=appearance.eigenvalues,
        usable=_half(appearance.usable),
        unexplained=None if unexplained is None else _half(unexplained),
    )


def _half(values: np.ndarray) -> np.ndarray:
    """Return values rounded to 16 bits, the half precision of IEEE 754, as float32."""
    return values.astype(np.float16).astype(np.float32)
