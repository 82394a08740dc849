"""Annotations for arrays in compiled code, type of numbers and number of axes, and the kinds they stand for."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from types import NoneType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np

F = np.float32

Single1 = Annotated[np.ndarray, "float32", 1]
Single2 = Annotated[np.ndarray, "float32", 2]
Single3 = Annotated[np.ndarray, "float32", 3]
Double1 = Annotated[np.ndarray, "float64", 1]
Double2 = Annotated[np.ndarray, "float64", 2]
Double3 = Annotated[np.ndarray, "float64", 3]
Int1 = Annotated[np.ndarray, "int32", 1]
Int2 = Annotated[np.ndarray, "int32", 2]
Long1 = Annotated[np.ndarray, "int64", 1]
Long2 = Annotated[np.ndarray, "int64", 2]
Short1 = Annotated[np.ndarray, "int16", 1]
Wide1 = Annotated[np.ndarray, "uint64", 1]
Byte1 = Annotated[np.ndarray, "uint8", 1]
Byte2 = Annotated[np.ndarray, "uint8", 2]
Byte3 = Annotated[np.ndarray, "uint8", 3]
Word2 = Annotated[np.ndarray, "uint16", 2]
Word3 = Annotated[np.ndarray, "uint16", 3]
Bool1 = Annotated[np.ndarray, "bool", 1]

NUMBERS = (int, float, bool, NoneType)
"""Kinds of a single value; ``NoneType`` is that of no result."""


@dataclass(frozen=True)
class Span:
    """Kind of an array: a pointer and a size per axis."""

    dtype: str
    ndim: int

    def __str__(self) -> str:
        return f"span({self.dtype}, {self.ndim})"


@dataclass(frozen=True)
class RecordOf:
    """Kind of the address of a named tuple's table."""

    fields: type

    def __str__(self) -> str:
        return f"record({self.fields.__module__}.{self.fields.__qualname__})"


@dataclass(frozen=True)
class FunctionOf:
    """Kind of a function in a field, called by its address."""

    result: Any
    args: tuple


def kind_of(annotation: Any) -> Any:
    """Return the kind of an annotated field, argument or result; a tuple of kinds for a tuple."""
    origin, given = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return RecordOf(given[1]) if len(given) == 2 else Span(*given[1:3])  # more may say what the sizes are
    if origin is tuple:
        return tuple(map(kind_of, given))
    if origin is not None:
        return FunctionOf(kind_of(given[1]), tuple(map(kind_of, given[0])))
    if annotation is None:
        return NoneType
    return annotation if annotation in NUMBERS else RecordOf(annotation)


@lru_cache
def layout(fields: type) -> dict[str, tuple[Any, int]]:
    """Return the kind and the first table word of each field of a named tuple class."""
    hints, found, size = get_type_hints(fields, include_extras=True), {}, 0
    for name in fields._fields:
        found[name] = kind_of(hints[name]), size
        size += 1 + getattr(found[name][0], "ndim", 0)
    return found


class Declared:
    """A function of the types that its annotations, or keyword arguments, declare, known by a symbol."""

    def __init__(self, function: Callable, **kinds: Any) -> None:
        self.py_func, self.kinds, self.__doc__ = function, kinds, function.__doc__
        by = "".join(str(kind_of(each)) for each in kinds.values())
        self.symbol = f"{function.__module__}.{function.__qualname__}{by}"

    @cached_property
    def kind(self) -> tuple[tuple, Any]:
        """Kinds of the arguments, and of the result."""
        hints = get_type_hints(self.py_func, include_extras=True) | self.kinds
        result = kind_of(hints.pop("return"))
        return tuple(map(kind_of, hints.values())), result


class Inlined:
    """A function that is compiled as a part of each compiled function that calls it, for any types."""

    def __init__(self, function: Callable) -> None:
        self.py_func, self.__doc__ = function, function.__doc__

    def __call__(self, *args: Any) -> Any:
        """Call the plain function."""
        return self.py_func(*args)
