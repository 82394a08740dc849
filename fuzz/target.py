"""What is fuzzed: a way to make hostile inputs, and the code that gets them."""

from __future__ import annotations

import importlib
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

MODULES = (
    *("fuzz.landmarks", "fuzz.pictures", "fuzz.files", "fuzz.studio", "fuzz.commands"),
    *("fuzz.engine", "fuzz.requests"),
)
"""Modules whose ``TARGETS`` are fuzzed."""


def _nothing() -> None:
    """Prepare nothing."""


@dataclass(frozen=True)
class Target:
    """Code that reads what may come from anywhere.

    The property: :attr:`check` returns, or raises a LiaamError, within the limits on time and memory.
    """

    name: str
    """What the command line calls it."""
    make: Callable[[np.random.Generator], Any]
    """Makes an input, most often bytes, of random numbers and nothing else: the same numbers give the same input."""
    check: Callable[[Any], object]
    """Feeds an input to the code, and asserts what else has to hold. The working folder is empty and its own."""
    prepare: Callable[[], object] = _nothing
    """Done once in each process, before time and memory count: imports, compilation, models."""
    suffix: str = ".bin"
    """Ending of the files that failing inputs are kept in."""
    share: float = 1.0
    """Share of the cases of ``all``, against 1 of the others: less for what is slow."""

    def input_of(self, seed: int, case: int) -> Any:
        """Make the input of a case: it depends on target, seed and number alone."""
        return self.make(np.random.default_rng([seed, zlib.crc32(self.name.encode()), case]))


def targets_of(*modules: str) -> dict[str, Target]:
    """Targets of some modules by name."""
    return {target.name: target for module in modules for target in importlib.import_module(module).TARGETS}
