"""Compile functions to machine code with numba (:class:`liaam.kernels.compiled.Compiled`)."""

import gc
from types import NoneType
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.core import typed_passes, untyped_passes
from numba.core.cgutils import get_or_insert_function
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager
from numba.core.imputils import lower_constant as _lower_constant
from numba.core.typing.templates import AttributeTemplate, infer_getattr as _infer_getattr, signature
from numba.extending import (
    lower_builtin,
    lower_getattr_generic as _lower_getattr_generic,
    models,
    register_model,
    typeof_impl,
)

from liaam.kernels import vector_code
from liaam.kernels.fields import Declared, FunctionOf, Inlined, RecordOf, Span, layout
from liaam.kernels.machine_code import Code
from liaam.kernels.spans import SpanType, make_span
from liaam.kernels.vectors import Operation

infer_getattr: Any = _infer_getattr
lower_getattr_generic: Any = _lower_getattr_generic
lower_constant: Any = _lower_constant

_WORD = ir.IntType(64)
_NUMBERS = {int: types.int64, float: types.float64, bool: types.boolean, NoneType: types.none}


class _Library(JITCodeLibrary):
    """Machine code that is optimised as a whole; numba's own library optimises each function before, too."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout


class _Compiler(CompilerBase):
    """The passes of numba that this code needs: they take three quarters of the time of all.

    The code has no closures, literals, array expressions or inlined overloads, and owns no references that would have
    to be released. A variable has one type in a function, so that versions of it (static single assignment) are
    needless.
    """

    def define_pipelines(self) -> list[PassManager]:
        self.state.library = _Library(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        self.state.library.enable_object_caching()
        passes = PassManager("liaam")
        for each in (
            untyped_passes.TranslateByteCode,
            untyped_passes.FixupArgs,
            typed_passes.NopythonTypeInference,
            typed_passes.AnnotateTypes,
            typed_passes.NativeLowering,
            typed_passes.NoPythonBackend,
        ):
            passes.add_pass(each, each.__name__)
        passes.finalize()
        return [passes]


_OPTIONS: dict[str, Any] = {
    "pipeline_class": _Compiler,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "nogil": True,
    # Without "nnan": points of a diverging fit may be NaN.
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
    "error_model": "numpy",
}
_njit: Any = numba.njit(**_OPTIONS)
_inlined: dict[Inlined, Any] = {}


def compile_function(function: Declared) -> Code:
    """Compile a function. Those that it calls must be linked."""
    args, result = function.kind
    collects = gc.isenabled()
    gc.disable()  # a tenth of the time
    try:
        with global_compiler_lock:
            made = _njit(function.py_func)
            made.compile(signature(numba_type(result), *map(numba_type, args)))
            (overload,) = made.overloads.values()
            _, _, (binary, _) = overload.library.serialize_using_object_code()
            calls = [each.name for each in overload.library._final_module.functions if each.is_declaration]
    finally:
        if collects:
            gc.enable()
    return Code(overload.fndesc.llvm_func_name, [name for name in calls if not name.startswith("llvm.")], binary)


class RecordType(types.Type):
    """Numba's type of the address of a named tuple's table."""

    def __init__(self, kind: RecordOf) -> None:
        self.fields = kind.fields
        super().__init__(str(kind))


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


def numba_type(kind: Any) -> Any:
    """Return numba's type of a kind (:func:`liaam.kernels.fields.kind_of`)."""
    if isinstance(kind, Span):
        return SpanType(kind.dtype, kind.ndim)
    if isinstance(kind, RecordOf):
        return RecordType(kind)
    if isinstance(kind, tuple):
        return types.BaseTuple.from_types(tuple(map(numba_type, kind)))
    if isinstance(kind, FunctionOf):
        args, result = tuple(map(numba_type, kind.args)), numba_type(kind.result)
        return FieldType(f"function{args} -> {result}", result, args)
    return _NUMBERS[kind]


@typeof_impl.register(Declared)
def _of_declared(function: Declared, _context: Any) -> NamedType:
    args, result = function.kind
    return NamedType(function.symbol, numba_type(result), tuple(map(numba_type, args)))


@typeof_impl.register(Inlined)
def _of_inlined(function: Inlined, _context: Any) -> Any:
    if function not in _inlined:
        _inlined[function] = _njit(function.py_func)
    return numba.typeof(_inlined[function])


@typeof_impl.register(Operation)
def _of_operation(operation: Operation, _context: Any) -> Any:
    return vector_code.type_of(operation)


@infer_getattr
class _Attributes(AttributeTemplate):
    key = RecordType

    def generic_resolve(self, kind, name):
        found = layout(kind.fields).get(name)
        return None if found is None else numba_type(found[0])


@lower_getattr_generic(RecordType)
def _getattr(context, builder, record, address, name):
    kind, at = layout(record.fields)[name]
    kind = numba_type(kind)
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
