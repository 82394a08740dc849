"""Functions that are compiled once and call each other by symbol, and named tuples of arrays, numbers and functions.

Numba links a function into each caller, compiles it again there, and makes a wrapper for the interpreter. The loop of a
fit took more than twice as long to compile that way. A :class:`Compiled` function takes the types that its annotations
declare: arrays as ``Annotated[np.ndarray, dtype, ndim]`` (:mod:`liaam.kernels.fields`), ``int``, ``float``, ``bool``,
``Callable``, and named tuples of these, passed as the address of a table. Compiled code reads fields by name and
calls functions in fields, as the interpreter does, so the reference kernel runs the same code. A function in a field is
compiled when its tuple's table is made; functions that a method does not use are never compiled.

Numba is imported only to compile: machine code is kept (:mod:`liaam.kernels.machine_code`), and loaded without it.
"""

import ctypes
from array import array
from collections.abc import Callable, Iterator
from dis import get_instructions
from functools import cached_property
from struct import pack, unpack
from threading import RLock
from types import NoneType
from typing import Any

import numpy as np

from liaam.kernels.fields import NUMBERS, Declared, FunctionOf, Inlined, RecordOf, Span, layout

_IN_C = {int: ctypes.c_int64, float: ctypes.c_double, bool: ctypes.c_uint8, NoneType: ctypes.c_int64}

_FINE = (0, -2)
"""Return codes of numba's functions without an error: a value, or None."""

_LOCK = RLock()
_BY_SYMBOL: dict[str, "Compiled"] = {}


def _words(name: str, kind: Span, given: np.ndarray) -> tuple[int, ...]:
    """Return address and sizes of an array, and check that it has the declared type."""
    if given.dtype != kind.dtype or given.ndim != kind.ndim or not given.flags.c_contiguous:
        raise TypeError(f"{name} is not a C-contiguous {kind}: {given.dtype}, {given.shape}")
    try:  # four times as fast as the other way
        return ctypes.addressof(ctypes.c_char.from_buffer(given)), *given.shape  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError):  # read-only, or empty
        return given.ctypes.data, *given.shape


class Record:
    """Table of a named tuple: its numbers and the addresses of its arrays. A new array needs a new record."""

    __slots__ = ("address", "kept")

    def __init__(self, fields: Any) -> None:
        words: list[int] = []
        self.kept: list = [fields]
        for value, (name, (kind, _)) in zip(fields, layout(type(fields)).items(), strict=True):
            if isinstance(kind, Span):
                words += _words(name, kind, value)
            elif isinstance(kind, RecordOf):
                self.kept.append(Record(value))
                words.append(self.kept[-1].address)
            elif isinstance(kind, FunctionOf):
                words.append(value.address if isinstance(value, Compiled) else 0)  # 0 if the method does not use it
            else:
                words += unpack("q", pack("d", value)) if kind is float else (int(value),)
        table = array("q", words)
        self.kept.append(table)
        self.address = table.buffer_info()[0]


class Compiled(Declared):
    """A function that is compiled once and called by its address, by compiled code and by the interpreter.

    Keyword arguments override its annotations.
    """

    def __init__(self, function: Callable, **kinds: Any) -> None:
        super().__init__(function, **kinds)
        self._address: int | None = None
        _BY_SYMBOL[self.symbol] = self

    @property
    def address(self) -> int:
        """Address of the code; the first access loads or compiles it, with all functions it calls."""
        if self._address is None:
            with _LOCK:
                self._address = self._address or self._link()
        return self._address

    def _link(self) -> int:
        from liaam.kernels import machine_code  # llvmlite: imported when needed

        code = machine_code.find(self.symbol)
        called = _called_by(self.py_func) if code is None else [_BY_SYMBOL.get(name) for name in code.calls]
        for function in called:
            if function is not None:
                function.address  # noqa: B018 (makes the code known by its symbol)
        if not machine_code.is_complete(code):
            with machine_code.alone():
                code = machine_code.find(self.symbol)  # another process may have compiled it meanwhile
                if not machine_code.is_complete(code):
                    from liaam.kernels.compiler import compile_function  # numba: imported when needed

                    code = compile_function(self)
                    machine_code.keep(self.symbol, code)
        return machine_code.link(self.symbol, code)

    @cached_property
    def _in_c(self) -> Any:
        kinds: list = [ctypes.c_void_p, ctypes.c_void_p]
        for kind in self.kind[0]:
            kinds += [_IN_C[kind]] if kind in NUMBERS else [ctypes.c_int64] * (1 + getattr(kind, "ndim", 0))
        return ctypes.CFUNCTYPE(ctypes.c_int32, *kinds)(self.address)

    def __call__(self, *args: Any) -> Any:
        """Call the function from the interpreter with records, arrays and numbers; releases the GIL."""
        words: list = []
        kinds, result_kind = self.kind
        for arg, kind in zip(args, kinds, strict=True):
            if isinstance(kind, Span):
                words += _words(self.symbol, kind, arg)
            elif isinstance(kind, RecordOf):
                if type(arg.kept[0]) is not kind.fields:
                    raise TypeError(f"{self.symbol} takes a {kind.fields.__name__}, not a {type(arg.kept[0]).__name__}")
                words.append(arg.address)
            else:
                words.append(float(arg) if kind is float else int(arg))
        result = _IN_C[result_kind]()
        raised = ctypes.c_void_p()
        if self._in_c(ctypes.addressof(result), ctypes.addressof(raised), *words) not in _FINE:
            raise IndexError(f"{self.symbol}: an index is out of bounds")
        if result_kind is NoneType:
            return None
        return bool(result.value) if result_kind is bool else result.value


def _called_by(function: Any) -> Iterator[Compiled]:
    """Yield the compiled functions that a function calls, also through functions that become part of it."""
    for line in get_instructions(function):
        called = function.__globals__.get(line.argval) if line.opname == "LOAD_GLOBAL" else None
        if isinstance(called, Compiled):
            yield called
        elif isinstance(called, Inlined):
            yield from _called_by(called.py_func)


compiled: Any = Compiled
"""Decorator of functions that are compiled once, on first access to their address."""

inlined: Any = Inlined
"""Decorator of functions that become part of the compiled functions that call them."""
