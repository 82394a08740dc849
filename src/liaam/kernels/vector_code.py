"""Numba's types and code of the vectors of :mod:`liaam.kernels.vectors`."""

import operator
from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.registry import cpu_target
from numba.core.typing.templates import AbstractTemplate, infer_global as _infer_global, signature
from numba.extending import intrinsic as _intrinsic, lower_builtin, models, register_model

from liaam.kernels.spans import pointer_to
from liaam.kernels.vectors import SIZE, Operation

intrinsic: Any = _intrinsic
infer_global: Any = _infer_global

_INDEX = ir.IntType(32)
_LLVM = {types.float32: ir.VectorType(ir.FloatType(), SIZE), types.float64: ir.VectorType(ir.DoubleType(), SIZE)}
_FLAGS = ("contract", "reassoc", "nsz")  # a product and a sum may be one instruction


class _Vector(types.Type):
    """Numba's type of eight numbers."""

    def __init__(self, number: Any) -> None:
        self.number = number
        super().__init__(f"{number}x8")


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _LLVM[kind.number])


VECTORS = {number: _Vector(number) for number in _LLVM}
vector = VECTORS[types.float32]


def _place(context: Any, builder: Any, kind: Any, span: Any, at: Any) -> Any:
    if context.enable_boundscheck:
        last = builder.add(at, at.type(SIZE - 1))
        pointer_to(context, builder, kind, span, [last])
    return builder.bitcast(pointer_to(context, builder, kind, span, [at]), _LLVM[kind.dtype].as_pointer())


def _mixed(builder: Any, a: Any, b: Any, lanes: Sequence[int]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_INDEX, len(lanes)), list(lanes)))


def _every(builder: Any, number: Any) -> Any:
    nothing = ir.Constant(ir.VectorType(number.type, SIZE), ir.Undefined)
    return _mixed(builder, builder.insert_element(nothing, number, _INDEX(0)), nothing, [0] * SIZE)


@intrinsic
def _emit_load(_context, span, at):
    def codegen(context, builder, sig, args):
        loaded = builder.load(_place(context, builder, sig.args[0], *args))
        loaded.align = span.dtype.bitwidth // 8
        return loaded

    return VECTORS[span.dtype](span, types.intp), codegen


@intrinsic
def _emit_store(_context, span, at, numbers):
    def codegen(context, builder, sig, args):
        stored = builder.store(args[2], _place(context, builder, sig.args[0], *args[:2]))
        stored.align = span.dtype.bitwidth // 8
        return context.get_dummy_value()

    return types.void(span, types.intp, VECTORS[span.dtype]), codegen


@intrinsic
def _emit_every(_context, number):
    def codegen(_context, builder, _signature, args):
        return _every(builder, args[0])

    return VECTORS[number](number), codegen


@intrinsic(prefer_literal=True)
def _emit_lane(_context, numbers, which):
    if not isinstance(which, types.IntegerLiteral):
        return None
    number = which.literal_value

    def codegen(_context, builder, _signature, args):
        return builder.extract_element(args[0], _INDEX(number))

    return types.float32(numbers, which), codegen


@intrinsic
def _emit_total(_context, numbers):
    def codegen(_context, builder, _signature, args):
        rest = args[0]
        for half in (4, 2, 1):
            low, high = (_mixed(builder, rest, rest, range(first, first + half)) for first in (0, half))
            rest = builder.fadd(low, high, flags=_FLAGS)
        return builder.extract_element(rest, _INDEX(0))

    return types.float32(vector), codegen


@intrinsic
def _emit_interleave(_context, to, at, lines, first, stride):
    def codegen(context, builder, sig, args):
        to, at, lines, first, stride = args
        rows = []
        for k in range(SIZE):
            place = builder.add(first, builder.mul(stride, stride.type(k)))
            rows.append(builder.load(_place(context, builder, sig.args[2], lines, place)))
            rows[-1].align = 4
        low = [0, 8, 1, 9, 2, 10, 3, 11]
        high = [4 + place for place in low]
        for _ in range(3):  # three perfect shuffles of 8 by 8 numbers transpose them
            rows = [_mixed(builder, rows[k], rows[k + 4], lanes) for k in range(4) for lanes in (low, high)]
        for k, row in enumerate(rows):
            place = builder.add(at, at.type(SIZE * k))
            builder.store(row, _place(context, builder, sig.args[0], to, place)).align = 4
        return context.get_dummy_value()

    return types.void(to, types.intp, lines, types.intp, types.intp), codegen


@intrinsic
def _emit_halves(_context, low, high):
    def codegen(_context, builder, _signature, args):
        return _mixed(builder, args[0], args[1], [0, 1, 2, 3, 8, 9, 10, 11])

    return vector(low, high), codegen


def _define(operation: Any, instruction: str) -> None:
    """Define an operator for two vectors, and for a number and a vector."""

    @infer_global(operation)
    class _Template(AbstractTemplate):
        def generic(self, args, _kws):
            known = len(args) == 2 and isinstance(args[1], _Vector) and args[0] in (args[1], args[1].number)
            return signature(args[1], *args) if known else None

    @lower_builtin(operation, _Vector, _Vector)
    def _both(_context, builder, _signature, args):
        return getattr(builder, instruction)(*args, flags=_FLAGS)

    @lower_builtin(operation, types.Float, _Vector)
    def _scaled(_context, builder, _signature, args):
        return getattr(builder, instruction)(_every(builder, args[0]), args[1], flags=_FLAGS)


_define(operator.add, "fadd")
_define(operator.sub, "fsub")
_define(operator.mul, "fmul")


_EMITTERS = (_emit_load, _emit_store, _emit_every, _emit_lane, _emit_total, _emit_interleave, _emit_halves)
_BY_NAME = {each.__name__.removeprefix("_emit_"): each for each in _EMITTERS}


def type_of(operation: Operation) -> Any:
    """Return numba's type of an operation."""
    context: Any = cpu_target.typing_context
    return context.resolve_value_type(_BY_NAME[operation.name])
