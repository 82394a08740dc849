"""Functions that are compiled once and call each other by symbol, and named tuples of arrays, numbers and functions.

Numba links a function into each caller, compiles it again there, and makes a wrapper for the interpreter. The loop of a
fit took more than twice as long to compile that way. A :class:`Compiled` function takes the types that its annotations
declare: arrays as ``Annotated[np.ndarray, dtype, ndim]`` (:mod:`liaam.kernels.fields`), ``int``, ``float``, ``bool``,
``Callable``, and named tuples of these, passed as the address of a table. Compiled code reads fields by name and
calls functions in fields, as the interpreter does, so the reference kernel runs the same code. A function in a field is
compiled when its tuple's table is made; functions that a method does not use are never compiled.
"""

import ctypes
from array import array
from collections.abc import Callable, Iterator
from dis import get_instructions
from functools import cached_property, lru_cache
from struct import pack, unpack
from types import NoneType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core.cgutils import get_or_insert_function
from numba.core.compiler_lock import global_compiler_lock
from numba.core.imputils import lower_constant as _lower_constant
from numba.core.typing.templates import AttributeTemplate, signature
from numba.core.typing.templates import infer_getattr as _infer_getattr
from numba.extending import lower_builtin, models, register_model, typeof_impl
from numba.extending import lower_getattr_generic as _lower_getattr_generic

from liaam.kernels.jit import jit
from liaam.kernels.spans import SpanType, make_span

infer_getattr: Any = _infer_getattr
lower_getattr_generic: Any = _lower_getattr_generic
lower_constant: Any = _lower_constant

_WORD = ir.IntType(64)
_NUMBERS = {int: types.int64, float: types.float64, bool: types.boolean, NoneType: types.none, None: types.none}
_IN_C = {
    types.int64: ctypes.c_int64,
    types.float64: ctypes.c_double,
    types.boolean: ctypes.c_uint8,
    types.none: ctypes.c_int64,
}

_FINE = (0, -2)
"""Return codes of numba's functions without an error: a value, or None."""


class RecordType(types.Type):
    """Numba's type of the address of a named tuple's table."""

    def __init__(self, fields: type) -> None:
        self.fields = fields
        super().__init__(f"record({fields.__module__}.{fields.__qualname__})")


class _FunctionType(types.Callable):
    """Numba's type of a function that is called by its address."""

    def __init__(self, name: str, result: Any, args: tuple) -> None:
        self.result, self.args = result, args
        super().__init__(name)

    def get_call_type(self, _context, _args, _kws):
        return signature(self.result, *self.args, recvr=self)

    def get_call_signatures(self):
        return [signature(self.result, *self.args)], False

    def get_impl_key(self, _sig):
        return type(self)


class FieldType(_FunctionType):
    """Numba's type of a function in a field; its address is in the table."""


class NamedType(_FunctionType):
    """Numba's type of a function that is called by its linker symbol."""


for _kind in (RecordType, FieldType):

    @register_model(_kind)
    class _Address(models.PrimitiveModel):
        def __init__(self, manager: Any, kind: Any) -> None:
            super().__init__(manager, kind, _WORD)


register_model(NamedType)(models.OpaqueModel)


def type_of(annotation: Any) -> Any:
    """Return numba's type for the annotation of a field or an argument."""
    if get_origin(annotation) is Annotated:
        _, *what = get_args(annotation)
        return RecordType(*what) if len(what) == 1 else SpanType(*what)
    if get_origin(annotation) is tuple:
        return types.BaseTuple.from_types(tuple(map(type_of, get_args(annotation))))
    if get_origin(annotation) is not None:
        *args, result = get_args(annotation)
        result, args = type_of(result), tuple(map(type_of, args[0]))
        return FieldType(f"function{args} -> {result}", result, args)
    return _NUMBERS[annotation] if annotation in _NUMBERS else RecordType(annotation)


@lru_cache
def _layout(fields: type) -> dict[str, tuple[Any, int]]:
    """Return the type and the first table word of each field of a named tuple class."""
    hints, found, size = get_type_hints(fields, include_extras=True), {}, 0
    for name in fields._fields:
        found[name] = type_of(hints[name]), size
        size += 1 + getattr(found[name][0], "ndim", 0)
    return found


def _words(name: str, kind: SpanType, given: np.ndarray) -> tuple[int, ...]:
    """Return address and sizes of an array, and check that it has the declared type."""
    if given.dtype != kind.numpy or given.ndim != kind.ndim or not given.flags.c_contiguous:
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
        for value, (name, (kind, _)) in zip(fields, _layout(type(fields)).items(), strict=True):
            if isinstance(kind, SpanType):
                words += _words(name, kind, value)
            elif isinstance(kind, RecordType):
                self.kept.append(Record(value))
                words.append(self.kept[-1].address)
            elif isinstance(kind, FieldType):
                words.append(value.address if isinstance(value, Compiled) else 0)  # 0 if the method does not use it
            else:
                words += unpack("q", pack("d", value)) if kind == types.float64 else (int(value),)
        table = array("q", words)
        self.kept.append(table)
        self.address = table.buffer_info()[0]


class Compiled:
    """A function that is compiled once and called by its address, by compiled code and by the interpreter.

    Keyword arguments override its annotations.
    """

    def __init__(self, function: Callable, **kinds: Any) -> None:
        self.py_func, self.kinds, self.__doc__ = function, kinds, function.__doc__
        self._address: int | None = None
        self.symbol = (
            f"{function.__module__}.{function.__qualname__}{''.join(str(type_of(each)) for each in kinds.values())}"
        )

    @cached_property
    def kind(self) -> NamedType:
        """Numba type of the function: arguments and result."""
        hints = get_type_hints(self.py_func, include_extras=True) | self.kinds
        result = type_of(hints.pop("return"))
        return NamedType(self.symbol, result, tuple(map(type_of, hints.values())))

    @property
    def address(self) -> int:
        """Address of the code; the first access compiles it or loads it from the cache, with all functions it calls."""
        if self._address is None:
            with global_compiler_lock:
                self._address = self._address or self._compile()
        return self._address

    def _compile(self) -> int:
        for called in _called_by(self.py_func):
            called.address  # noqa: B018 (registers its symbol with the linker)
        self._function = jit(self.py_func, no_cpython_wrapper=True)
        self._function.compile(signature(self.kind.result, *self.kind.args))
        made = self._function.overloads[self.kind.args]
        address = made.library.get_pointer_to_function(made.fndesc.llvm_func_name)
        if not address:
            raise RuntimeError(f"{self.symbol}: the compiled code was not found")
        binding.add_symbol(self.symbol, address)
        return address

    @cached_property
    def _in_c(self) -> Any:
        kinds: list = [ctypes.c_void_p, ctypes.c_void_p]
        for kind in self.kind.args:
            if isinstance(kind, SpanType):
                kinds += [ctypes.c_int64] * (1 + kind.ndim)
            else:
                kinds.append(ctypes.c_int64 if isinstance(kind, RecordType) else _IN_C[kind])
        return ctypes.CFUNCTYPE(ctypes.c_int32, *kinds)(self.address)

    def __call__(self, *args: Any) -> Any:
        """Call the function from the interpreter with records, arrays and numbers; releases the GIL."""
        words: list = []
        for arg, kind in zip(args, self.kind.args, strict=True):
            if isinstance(kind, SpanType):
                words += _words(self.symbol, kind, arg)
            elif isinstance(kind, RecordType):
                if type(arg.kept[0]) is not kind.fields:
                    raise TypeError(f"{self.symbol} takes a {kind.fields.__name__}, not a {type(arg.kept[0]).__name__}")
                words.append(arg.address)
            else:
                words.append(float(arg) if kind == types.float64 else int(arg))
        result = _IN_C[self.kind.result]()
        raised = ctypes.c_void_p()
        if self._in_c(ctypes.addressof(result), ctypes.addressof(raised), *words) not in _FINE:
            raise IndexError(f"{self.symbol}: an index is out of bounds")
        if self.kind.result == types.none:
            return None
        return bool(result.value) if self.kind.result == types.boolean else result.value


def _called_by(function: Any) -> Iterator[Compiled]:
    """Yield the compiled functions that a function calls, also through functions linked into it."""
    for line in get_instructions(function):
        called = function.__globals__.get(line.argval) if line.opname == "LOAD_GLOBAL" else None
        if isinstance(called, Compiled):
            yield called
            continue
        linked = getattr(called, "py_func", function)
        if linked is not function:
            yield from _called_by(linked)


compiled: Any = Compiled
"""Decorator of functions that are compiled once, on first access to their address."""


@typeof_impl.register(Compiled)
def _typeof(function: Compiled, _context: Any) -> NamedType:
    return function.kind


@infer_getattr
class _Attributes(AttributeTemplate):
    key = RecordType

    def generic_resolve(self, kind, name):
        found = _layout(kind.fields).get(name)
        return None if found is None else found[0]


@lower_getattr_generic(RecordType)
def _getattr(context, builder, record, address, name):
    kind, at = _layout(record.fields)[name]
    table = builder.inttoptr(address, _WORD.as_pointer())

    def word(place: int) -> Any:
        return builder.load(builder.gep(table, [_WORD(place)], inbounds=True))

    if isinstance(kind, SpanType):
        data = builder.inttoptr(word(at), context.get_value_type(types.CPointer(kind.dtype)))
        return make_span(context, builder, kind, data, [word(at + 1 + axis) for axis in range(kind.ndim)])
    if kind == types.float64:
        return builder.bitcast(word(at), ir.DoubleType())
    return builder.trunc(word(at), ir.IntType(1)) if kind == types.boolean else word(at)


@lower_constant(NamedType)
def _constant(context, _builder, _kind, _function):
    return context.get_dummy_value()


@lower_builtin(FieldType, types.VarArg(types.Any))
@lower_builtin(NamedType, types.VarArg(types.Any))
def _call(context, builder, sig, args):
    convention, (function, *args), (kind, *kinds) = context.call_conv, args, sig.args
    code = convention.get_function_type(sig.return_type, kinds)
    if isinstance(kind, FieldType):
        called = builder.inttoptr(function, code.as_pointer())
    else:
        called = get_or_insert_function(builder.module, code, kind.name)
    status, result = convention.call_function(builder, called, sig.return_type, kinds, args)
    with builder.if_then(status.is_error, likely=False):
        convention.return_status_propagate(builder, status)
    return result
