"""What a model keeps: the appearances of the default method, of the search and of relighting, and those asked for."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from liaam.fitting.methods import DEFAULT_METHOD, METHODS, Method, check_holds, get_method, methods_of, needed_by
from liaam.fitting.objective import pixels_for
from liaam.fitting.templates import pixels_for_search
from liaam.model import AAM, MESH
from liaam.model.appearance import CHANNELS, AppearanceModel
from liaam.model.rounding import rounded

ALL = "all"  # Value of methods: all of METHODS that a model can have

Methods = Iterable[str | Method] | str

# Appearances whose modes are rounded to 8 bits, unless a method that is asked for fits them; others have 16. Half of
# 560 fits of soft-li move by less than 0.004 % of the distance between the eyes.
EIGHT_BITS = ("soft", "search", "log")


def chosen(methods: Methods) -> tuple[Method, ...]:
    """Return the default method and those of the given names."""
    names = METHODS if methods == ALL else [methods] if isinstance(methods, str) else methods
    return (METHODS[DEFAULT_METHOD], *map(get_method, names))


def wanted(methods: Sequence[Method], view: str, level: int, n_levels: int) -> list[str]:
    """Return the names of the appearances that a level of a view keeps."""
    needed = set().union(*(needed_by(method) for method in methods if method.view == view))
    if view == MESH and level == 0:
        needed.add("search")
    if view == MESH and level == n_levels - 1:  # for relighting and drawings
        needed.add("log")
    if "illumination" in needed:  # learnt relative to these
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
    kept = chosen(methods_of(model) if methods == ALL else methods)
    for method in kept[1:]:
        check_holds(model, method)
    return keep_only(model, kept)


def keep_only(model: AAM, methods: Sequence[Method]) -> AAM:
    """Return a model that holds only what these methods, the search and relighting need, in few bits.

    Of ``soft``, levels before the last keep only the pixels that fits use, and of ``search`` those of the search.
    """
    asked = set().union(*(needed_by(method) for method in methods if method.view == MESH))
    for view_name, view in model.views.items():
        n, levels = len(view.levels), []
        for i, level in enumerate(view.levels):
            names, found = {*wanted(methods, view_name, i, n), "features"}, {}
            for name, known in level.appearances.items():
                if name not in names:
                    continue
                if name == "soft" and i < n - 1:
                    known = known.only_at(pixels_for(view.warp, level.blur))
                if name == "search":
                    known = known.only_at(pixels_for_search(view.warp))
                if name in EIGHT_BITS and name not in asked:
                    errors = None if known.unexplained is None else _half(known.unexplained)
                    mean, usable = _half(known.mean), _half(known.usable)
                    found[name] = AppearanceModel(mean, rounded(known.modes), known.eigenvalues, usable, errors)
                else:
                    found[name] = replace(known, modes=_half(known.modes))
            levels.append(replace(level, appearances=found))
        model = model.with_view(view_name, levels=tuple(levels))
    if model.light is not None:
        model = replace(model, light=replace(model.light, modes=rounded(model.light.modes)))
    if model.others:
        model = replace(model, others=tuple(keep_only(other, methods) for other in model.others))
    return model


def _half(values: np.ndarray) -> np.ndarray:
    """Round to 16 bits."""
    return values.astype(np.float16).astype(np.float32)
