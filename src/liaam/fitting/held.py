"""Which appearances methods need, and for which methods a model was trained."""

from collections.abc import Iterable

from liaam.errors import MethodError
from liaam.fitting.methods import METHODS, Method
from liaam.model import AAM


def needed_by(method: Method) -> set[str]:
    """Return the names of the appearances that a method needs at each level of its view."""
    return {method.appearance, *(("illumination",) if method.illumination else ())}


def methods_of(model: AAM) -> tuple[str, ...]:
    """Return the names of the methods that a model can fit with."""
    return tuple(name for name, method in METHODS.items() if not _missing(model, method))


def check_holds(model: AAM, method: Method) -> None:
    """Raise an error if the model lacks what the method needs."""
    if method.view not in model.views:
        raise MethodError(
            f"method {method.name}: the model has no view {method.view}; train it again, or use method "
            f"'{'li' if model.is_colour else 'grey'}'"
        )
    missing = _missing(model, method)
    if missing & {"varied", "illumination"} and not model.n_lamps:
        raise MethodError(
            f"method {method.name} needs a model trained on relit images; train it with lamps "
            "and at least one copy of each image ('liaam train --lamps', or train(..., lamps=...))"
        )
    if missing:
        raise MethodError(
            f"method {method.name}: the model was trained for {_listed(methods_of(model))}; train it again with "
            f"'--methods {method.name.partition('+')[0]}' (train(..., methods=...)), or use one of these"
        )
    levels = model.views[method.view].levels
    if method.loss == "learnt" and any(level.appearances[method.appearance].unexplained is None for level in levels):
        raise MethodError(f"method {method.name}: the model has no variances of its errors; train it again")


def _missing(model: AAM, method: Method) -> set[str]:
    """Names of the appearances that the model lacks."""
    if method.view not in model.views:
        return needed_by(method)
    return set().union(*(needed_by(method) - set(level.appearances) for level in model.views[method.view].levels))


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "no method"
