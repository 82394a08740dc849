"""Named tuples of arrays that compiled code passes by reference.

Passed as it is, a tuple of fifty arrays takes the compiler half a second in every function that it goes through. As a
reference it takes none, and its fields are read by the same names.
"""

from collections.abc import Callable
from typing import Any

from numba import types
from numba.core.typing.templates import signature
from numba.experimental import structref
from numba.extending import intrinsic as _intrinsic

from liaam.jit import jit

intrinsic: Any = _intrinsic


@structref.register
class RecordType(types.StructRef):
    """Numba's type of a reference to the fields of a named tuple."""


class Record(structref.StructRefProxy):
    """A reference as the interpreter holds it; what is in it the interpreter reads from the tuple."""


structref.define_boxing(RecordType, Record)


@intrinsic
def _referenced(typing_context, fields):
    if not isinstance(fields, types.NamedTuple):
        return None
    kind = RecordType([(name, types.unliteral(field)) for name, field in zip(fields.fields, fields, strict=True)])
    made, allocate = structref.new._defn(typing_context, types.TypeRef(kind))

    def codegen(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        record = allocate(context, builder, made, args)
        for i, name in enumerate(fields.fields):
            write: Callable = context.get_setattr(name, signature(types.void, kind, fields[i]))
            write(builder, (record, builder.extract_value(args[0], i)))
        return record

    return kind(fields), codegen


@jit
def by_reference(fields):
    """Record of a named tuple: the same arrays, and copies of its numbers."""
    return _referenced(fields)
