"""Targets of the fuzzer: generators of inputs, and the code that receives them."""

from __future__ import annotations

import importlib
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

MODULES = (
    *("fuzz.landmarks", "fuzz.pictures", "fuzz.files", "fuzz.studio", "fuzz.commands"),
    *("fuzz.engine", "fuzz.forged", "fuzz.shapes", "fuzz.requests"),
)
"""Modules whose ``TARGETS`` are fuzzed."""


def _nothing() -> None:
    """Prepare nothing."""


@dataclass(frozen=True)
class Target:
    """Code that reads untrusted input.

    Property: :attr:`check` returns or raises a LiaamError within the limits on time and memory.
    """

    name: str
    """Name on the command line."""
    make: Callable[[np.random.Generator], Any]
    """Makes an input, usually bytes, that depends only on the random numbers."""
    check: Callable[[Any], object]
    """Passes an input to the code and asserts further properties. Its working folder is empty."""
    prepare: Callable[[], object] = _nothing
    """Called once per process, outside the limits: imports, compilation, models."""
    suffix: str = ".bin"
    """Suffix of the files of failing inputs."""
    share: float = 1.0
    """Relative number of cases in ``all``; less than 1 for slow targets."""

    def input_of(self, seed: int, case: int) -> Any:
        """Make the input of a case. It depends only on target, seed and number."""
        return self.make(np.random.default_rng([seed, zlib.crc32(self.name.encode()), case]))


def targets_of(*modules: str) -> dict[str, Target]:
    """Targets of some modules by name."""
    targets = [target for module in modules for target in importlib.import_module(module).TARGETS]
    by_name = {target.name: target for target in targets}
    assert len(by_name) == len(targets), "two targets have one name, and only one of them would be run"
    return by_name
