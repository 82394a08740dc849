"""The compiled core: the extension for this processor, or the functions of the same names in NumPy.

The sources are in ``src/core``, compiled once for each instruction set. ``LIAAM_CPU`` forces one of them, or ``numpy``.
Where no extension could be built, liaam works with NumPy, slowly; ``LIAAM_REQUIRE_CORE=1`` makes that an error.
"""

import hashlib
import importlib
import os
import warnings
from pathlib import Path
from types import ModuleType

from liaam import encoding_constants
from liaam.errors import CoreWarning

INSTRUCTION_SETS = ("baseline", "avx2")
"""Instruction sets that may be built, from the least to the most."""

NUMPY = "numpy"

TIMES_SLOWER = 20
"""How many times slower a fit is in NumPy (``benchmarks fit``)."""


def _warn_without_core() -> None:
    """Say how to get the core, once and not in each worker. No line of code is to blame, so that none is named."""
    import multiprocessing  # only here: it takes a while

    if multiprocessing.parent_process() is not None:
        return
    warnings.warn_explicit(
        f"liaam was installed without its compiled core, so that fits take about {TIMES_SLOWER} times as long. "
        "Install a C++ compiler (Debian, Ubuntu: apt install g++; macOS: xcode-select --install; Windows: Build Tools "
        "for Visual Studio), and then liaam again, with 'pip install --no-cache-dir --force-reinstall --no-deps' in "
        "place of 'pip install'",
        CoreWarning,
        filename="liaam",
        lineno=0,
    )


def _extension(name: str) -> ModuleType | None:
    try:
        return importlib.import_module(f"liaam._core_{name}")
    except ModuleNotFoundError as error:
        if error.name != f"liaam._core_{name}":
            raise
        return None


def _chosen() -> tuple[str, ModuleType | None]:
    """Return the name and the module of the best extension that the processor runs."""
    asked = os.environ.get("LIAAM_CPU", "")
    if asked and asked not in (*INSTRUCTION_SETS, NUMPY):
        raise ImportError(f"LIAAM_CPU={asked} is unknown; choose from {', '.join((*INSTRUCTION_SETS, NUMPY))}")
    if asked == NUMPY:
        return NUMPY, None
    baseline = _extension("baseline")
    best = asked or (baseline.best_instruction_set() if baseline is not None else "baseline")
    extension = baseline if best == "baseline" else _extension(best)
    if asked and extension is None:
        raise ImportError(f"LIAAM_CPU={asked}: this installation of liaam has no such extension")
    return (best, extension) if extension is not None else ("baseline", baseline)


INSTRUCTION_SET, _module = _chosen()
"""Name of the instruction set in use; ``numpy`` without an extension."""

BUILT = _module is not None
"""Whether an extension is in use."""

if _module is None:
    if os.environ.get("LIAAM_REQUIRE_CORE"):
        raise ImportError("LIAAM_REQUIRE_CORE is set, but liaam was installed without its compiled core")
    if os.environ.get("LIAAM_CPU") != NUMPY:
        _warn_without_core()
    INSTRUCTION_SET = NUMPY
    _module = importlib.import_module("liaam.image_reference")


def _warn_if_stale(digest: str) -> None:
    """Warn if this is a checkout whose sources have changed since the extension was built."""
    sources = Path(__file__).resolve().parents[1] / "core"
    if not (sources / "level.cpp").is_file():
        return
    files = sorted(path for path in sources.iterdir() if path.suffix in (".cpp", ".hpp"))
    digests = "".join(hashlib.sha256(path.read_bytes()).hexdigest() for path in files)
    if hashlib.sha256(digests.encode()).hexdigest() != digest:
        warnings.warn(
            "the compiled core of liaam is older than its sources; build it again with "
            "'pip install --no-build-isolation -e .'",
            CoreWarning,
            stacklevel=3,
        )


if BUILT:
    _warn_if_stale(_module.SOURCES)
    _module._set_encoding_constants(encoding_constants.TABLE)

globals().update({name: value for name, value in vars(_module).items() if not name.startswith("_")})
