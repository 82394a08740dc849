"""Numba options and cache of the compiled loops."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import config
from numba.core.caching import FunctionCache

F = np.float32

_njit: Any = numba.njit

_OPTIONS: dict[str, Any] = {
    "nogil": True,
    # Without "nnan": points of a diverging fit may be NaN.
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
    "error_model": "numpy",
}


def _state_of_sources() -> tuple[tuple[str, int, int], ...]:
    """Return names, sizes and modification times of the modules with compiled code."""
    package = Path(__file__).parents[1]
    files = [
        path
        for folder in ("fitting", "kernels", "model", "photometry")
        for path in sorted((package / folder).glob("*.py"))
    ]
    return tuple((str(path.relative_to(package)), path.stat().st_size, path.stat().st_mtime_ns) for path in files)


_SOURCES = _state_of_sources()


class _Cache(FunctionCache):
    """Numba's cache on disk, invalidated by a change of any module: compiled functions include what they call."""

    def __init__(self, function: Callable) -> None:
        super().__init__(function)
        # The version is unpickled first: the rest may refer to classes that no longer exist.
        self._cache_file._version += str((_SOURCES, getattr(config, "BOUNDSCHECK", None)))


def jit(function: Callable, **options: Any) -> Any:
    """Decorate a function to be compiled when it is first called, and cached on disk."""
    made = _njit(no_cfunc_wrapper=True, **_OPTIONS, **options)(function)
    made._cache = _Cache(made.py_func)
    return made
