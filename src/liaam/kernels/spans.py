"""Spans: the array type of compiled loops, a pointer and a size per axis.

The strides, owners and reference counts of numba's arrays take a quarter of the compile time of a loop. A span is
C-contiguous and owns nothing: its caller must keep the array alive. Loops use it like an array: ``span[i]``,
``span[i, j]``, a row ``span[i]`` of several axes, ``span[a:b]`` of one axis, ``len`` and ``shape``. Negative indices
are not supported. Indices are checked only with ``NUMBA_BOUNDSCHECK=1``; ends of slices never.
"""

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import from_dtype, types
from numba.core import cgutils
from numba.core.typing.templates import (
    AbstractTemplate,
    AttributeTemplate,
    infer_getattr as _infer_getattr,
    infer_global as _infer_global,
    signature,
)
from numba.extending import lower_builtin, lower_getattr, models, register_model

infer_global: Any = _infer_global
infer_getattr: Any = _infer_getattr


class SpanType(types.Type):
    """Numba's type of a span."""

    def __init__(self, dtype: str, ndim: int) -> None:
        self.numpy, self.ndim = np.dtype(dtype), ndim
        self.dtype = from_dtype(self.numpy)
        super().__init__(f"span({dtype}, {ndim})")


@register_model(SpanType)
class _SpanModel(models.StructModel):
    def __init__(self, manager: Any, kind: SpanType) -> None:
        sizes = [(f"size{axis}", types.intp) for axis in range(kind.ndim)]
        super().__init__(manager, kind, [("data", types.CPointer(kind.dtype)), *sizes])


def make_span(context: Any, builder: Any, kind: SpanType, data: Any, sizes: Sequence[Any]) -> Any:
    """Emit code that makes a span from a pointer and sizes."""
    made = ir.Constant(context.get_value_type(kind), ir.Undefined)
    for place, value in enumerate([data, *sizes]):
        made = builder.insert_value(made, value, place)
    return made


def sizes_of(builder: Any, kind: SpanType, span: Any) -> list:
    """Emit code that reads a span's sizes."""
    return [builder.extract_value(span, 1 + axis) for axis in range(kind.ndim)]


def pointer_to(context: Any, builder: Any, kind: SpanType, span: Any, indices: Sequence[Any]) -> Any:
    """Emit code that computes the address of an element or a row of a span."""
    sizes, place = sizes_of(builder, kind, span), None
    for axis, size in enumerate(sizes):
        if axis < len(indices) and context.enable_boundscheck:
            cgutils.do_boundscheck(context, builder, indices[axis], size, axis)
        place = builder.mul(place, size, flags=["nsw"]) if place is not None else None
        if axis < len(indices):
            place = builder.add(place, indices[axis], flags=["nsw"]) if place is not None else indices[axis]
    return builder.gep(builder.extract_value(span, 0), [place], inbounds=True)


def _index(at: Any) -> tuple[Any, int]:
    """Return the type of an integer index and its number of axes; (None, 0) for any other index."""
    if isinstance(at, types.Integer):
        return types.intp, 1
    within = list(getattr(at, "types", ()))
    if within and all(isinstance(each, types.Integer) for each in within):
        return types.UniTuple(types.intp, len(within)), len(within)
    return None, 0


@infer_global(operator.getitem)
class _Get(AbstractTemplate):
    def generic(self, args, _kws):
        kind, at = args
        if not isinstance(kind, SpanType):
            return None
        if isinstance(at, types.SliceType) and kind.ndim == 1:
            return signature(kind, kind, types.slice2_type)
        index, n = _index(at)
        if index is None or n > kind.ndim:
            return None
        return signature(kind.dtype if n == kind.ndim else SpanType(kind.numpy.name, kind.ndim - n), kind, index)


@infer_global(operator.setitem)
class _Set(AbstractTemplate):
    def generic(self, args, _kws):
        kind, at, _ = args
        if not isinstance(kind, SpanType) or _index(at)[1] != kind.ndim:
            return None
        return signature(types.none, kind, _index(at)[0], kind.dtype)


@infer_global(len)
class _Len(AbstractTemplate):
    def generic(self, args, _kws):
        return signature(types.intp, *args) if isinstance(args[0], SpanType) else None


@infer_getattr
class _Attributes(AttributeTemplate):
    key = SpanType

    def resolve_shape(self, kind):
        return types.UniTuple(types.intp, kind.ndim)


def _indices(builder: Any, kind: Any, at: Any) -> list:
    return list(cgutils.unpack_tuple(builder, at)) if isinstance(kind, types.BaseTuple) else [at]


@lower_builtin(operator.getitem, SpanType, types.Integer)
@lower_builtin(operator.getitem, SpanType, types.BaseTuple)
def _getitem(context, builder, sig, args):
    kind, indices = sig.args[0], _indices(builder, sig.args[1], args[1])
    pointer = pointer_to(context, builder, kind, args[0], indices)
    if len(indices) == kind.ndim:
        return context.unpack_value(builder, kind.dtype, pointer)
    return make_span(context, builder, sig.return_type, pointer, sizes_of(builder, kind, args[0])[len(indices) :])


@lower_builtin(operator.getitem, SpanType, types.SliceType)
def _slice(context, builder, sig, args):
    cut, n = context.make_helper(builder, sig.args[1], args[1]), builder.extract_value(args[0], 1)
    stop = builder.select(builder.icmp_signed("<", cut.stop, n), cut.stop, n)
    start = builder.select(builder.icmp_signed("<", cut.start, stop), cut.start, stop)
    pointer = builder.gep(builder.extract_value(args[0], 0), [start], inbounds=True)
    return make_span(context, builder, sig.return_type, pointer, [builder.sub(stop, start)])


@lower_builtin(operator.setitem, SpanType, types.Integer, types.Any)
@lower_builtin(operator.setitem, SpanType, types.BaseTuple, types.Any)
def _setitem(context, builder, sig, args):
    kind = sig.args[0]
    pointer = pointer_to(context, builder, kind, args[0], _indices(builder, sig.args[1], args[1]))
    context.pack_value(builder, kind.dtype, args[2], pointer)
    return context.get_dummy_value()


@lower_builtin(len, SpanType)
def _len(_context, builder, _sig, args):
    return builder.extract_value(args[0], 1)


@lower_getattr(SpanType, "shape")
def _shape(_context, builder, kind, span):
    return cgutils.pack_array(builder, sizes_of(builder, kind, span))
