"""Instructions on vectors of float32, for the few inner loops whose shape a compiler does not find by itself.

Nothing here checks bounds or types: whoever calls sees to both. What numba has cached of functions in other files does
not notice a change in this one; remove the caches (``*.nbi``, ``*.nbc``) after it.
"""

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils

_INT, _I16, _I32, _FLOAT = ir.IntType(64), ir.IntType(16), ir.IntType(32), ir.FloatType()
_FLAGS = ("contract",)  # a product and a sum may be one instruction


class Lanes:
    """Writes instructions into a function that numba compiles (:func:`numba.extending.intrinsic`).

    Arrays are known by their place among the function's arguments; they are flat, and where something lies in them is
    counted in entries.
    """

    def __init__(self, context: Any, builder: Any, signature: Any, args: Any) -> None:
        self.builder = builder
        self._data = [
            context.make_array(kind)(context, builder, given).data if isinstance(kind, types.Array) else None
            for kind, given in zip(signature.args, args, strict=True)
        ]

    @staticmethod
    def whole(number: Any) -> Any:
        """Whole number, if it is not one of the function's already."""
        return ir.Constant(_INT, number) if isinstance(number, int) else number

    def plus(self, *numbers: Any) -> Any:
        """Sum of whole numbers."""
        total = self.whole(numbers[0])
        for number in numbers[1:]:
            total = self.builder.add(total, self.whole(number))
        return total

    def times(self, a: Any, b: Any) -> Any:
        """Product of whole numbers."""
        return self.builder.mul(self.whole(a), self.whole(b))

    def nought(self, size: int) -> Any:
        """Vector of noughts."""
        return ir.Constant(ir.VectorType(_FLOAT, size), [0.0] * size)

    def sums(self, count: int, size: int) -> list[Any]:
        """Vectors to add up in, nought."""
        sums = [cgutils.alloca_once(self.builder, ir.VectorType(_FLOAT, size)) for _ in range(count)]
        self.set(sums, [self.nought(size)] * count)
        return sums

    def set(self, sums: Sequence[Any], vectors: Sequence[Any]) -> None:
        """Set sums to vectors."""
        for total, vector in zip(sums, vectors, strict=True):
            self.builder.store(vector, total)

    def get(self, sums: Sequence[Any]) -> list[Any]:
        """Vectors that sums have come to."""
        return [self.builder.load(total) for total in sums]

    def product(self, a: Any, b: Any) -> Any:
        """Lane by lane, a b."""
        return self.builder.fmul(a, b, flags=_FLAGS)

    def sum(self, a: Any, b: Any) -> Any:
        """Lane by lane, a + b."""
        return self.builder.fadd(a, b, flags=_FLAGS)

    def less(self, a: Any, b: Any) -> Any:
        """Lane by lane, a - b."""
        return self.builder.fsub(a, b, flags=_FLAGS)

    def least(self, a: Any, b: Any) -> Any:
        """Lane by lane, the smaller one."""
        return self.builder.select(self.builder.fcmp_ordered("<", a, b), a, b)

    def add(self, total: Any, a: Any, b: Any | None = None) -> None:
        """Add a, or a times b, to a sum."""
        self.builder.store(self.sum(a if b is None else self.product(a, b), self.builder.load(total)), total)

    def number(self, array: int, at: Any) -> Any:
        """Read a number."""
        return self.builder.load(self.builder.gep(self._data[array], [at]))

    def _place(self, array: int, at: Any, kind: Any, size: int) -> Any:
        return self.builder.bitcast(self.builder.gep(self._data[array], [at]), ir.VectorType(kind, size).as_pointer())

    def vector(self, array: int, at: Any, size: int) -> Any:
        """Read numbers that lie side by side."""
        loaded = self.builder.load(self._place(array, at, _FLOAT, size))
        loaded.align = 4
        return loaded

    def steps(self, array: int, at: Any, size: int) -> Any:
        """Read whole numbers of 16 bits that lie side by side."""
        loaded = self.builder.load(self._place(array, at, _I16, size))
        loaded.align = 2
        longer = self.builder.sext(loaded, ir.VectorType(_I32, size))
        return self.builder.sitofp(longer, ir.VectorType(_FLOAT, size))

    def put(self, vector: Any, array: int, at: Any) -> None:
        """Write numbers side by side."""
        stored = self.builder.store(vector, self._place(array, at, _FLOAT, vector.type.count))
        stored.align = 4

    def mixed(self, a: Any, b: Any | None, order: Sequence[int]) -> Any:
        """Vector of entries of one or two others, by their places in both."""
        b = ir.Constant(a.type, ir.Undefined) if b is None else b
        return self.builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_I32, len(order)), list(order)))

    def every(self, number: Any, size: int) -> Any:
        """One number in all lanes."""
        return self.mixed(self.with_number(None, number, 0, size), None, [0] * size)

    def with_number(self, vector: Any | None, number: Any, lane: int, size: int) -> Any:
        """Vector, or an empty one, with a number in a lane."""
        vector = ir.Constant(ir.VectorType(_FLOAT, size), ir.Undefined) if vector is None else vector
        return self.builder.insert_element(vector, number, _I32(lane))

    def for_each(self, count: Any, work: Callable[[Any], None], step: int = 1) -> None:
        """Do something for 0, step, ... below a count; written out where that is known."""
        if isinstance(count, int):
            for i in range(0, count, step):
                work(self.whole(i))
            return
        with cgutils.for_range_slice(self.builder, _INT(0), count, _INT(step)) as (index, _):
            work(index)

    def where(self, first: Any, below: Any, work: Callable[[Any], None]) -> None:
        """Do something for a number if it is less than another."""
        with self.builder.if_then(self.builder.icmp_signed("<", first, below)):
            work(first)

    def neighbours(self, a: Any, b: Any) -> Any:
        """Sums of neighbouring lanes in each four, of a and then of b."""
        return self.sum(self.mixed(a, b, EVEN), self.mixed(a, b, ODD))


EVEN = [four + lane for four in range(0, 16, 4) for lane in (0, 2, 16, 18)]
"""Even lanes of each four of two vectors of 16, for which there is an instruction."""
ODD = [lane + 1 for lane in EVEN]
