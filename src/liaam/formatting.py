"""Values as text: objects by their fields, numbers as ranges, and arrays for JSON."""

import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np


def short_repr(self: Any) -> str:
    """Return the fields of a dataclass as text, arrays by shape and type: the ``__repr__`` of classes with arrays."""
    values = {each.name: _short(getattr(self, each.name)) for each in fields(self)}
    return f"{type(self).__name__}({', '.join(f'{name}={value}' for name, value in values.items())})"


def changed_repr(self: Any) -> str:
    """Return a dataclass as text, with the fields that differ from their defaults: the ``__repr__`` of options."""
    changed = (each.name for each in fields(self) if each.repr and getattr(self, each.name) != each.default)
    return f"{type(self).__name__}({', '.join(f'{name}={getattr(self, name)!r}' for name in changed)})"


def _short(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.shape} {value.dtype}"
    if isinstance(value, float):
        return f"{value:g}"
    return repr(str(value)) if isinstance(value, str) else repr(value)  # str() of an enumeration is its value


def ranges_of(numbers: Sequence[int], most: int = 8) -> str:
    """Format sorted numbers as ranges, at most `most` of them."""
    ranges: list[list[int]] = []
    for number in numbers:
        if ranges and number == ranges[-1][1] + 1:
            ranges[-1][1] = number
        else:
            ranges.append([number, number])
    shown = ", ".join(f"{a}" if a == b else f"{a}–{b}" for a, b in ranges[:most])
    return shown + (f" and {len(ranges) - most} more ranges" if len(ranges) > most else "")


def finite_list(values: np.ndarray) -> list:
    """Convert an array to (nested) lists, with None for numbers that are not finite, as JSON has no NaN."""
    plain = np.asarray(values, dtype=object)
    plain[~np.isfinite(values)] = None
    return plain.tolist()


def finite_or_none(value: float) -> float | None:
    """Return a number for JSON, None if it is not finite."""
    return float(value) if np.isfinite(value) else None


def json_value(value: object) -> object:
    """Convert arrays, tuples and numbers to JSON types, with None for numbers that are not finite."""
    if isinstance(value, dict):
        return {str(key): json_value(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return json_value(value.tolist())
    if isinstance(value, (list, tuple)):
        return [json_value(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value
