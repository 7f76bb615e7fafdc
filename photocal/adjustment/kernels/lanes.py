"""Eight numbers at once, as the processor's vectors hold them.

The compiler makes vectors of loops by itself, but not of those whose length it knows: it unrolls them. What
stands here tells it what is wanted. On a processor with shorter vectors it takes several for the eight.
"""

from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.core.datamodel.models import PrimitiveModel
from numba.extending import intrinsic, register_model

from photocal.base.compiled import inlined

LANES = 8
_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_INTEGER = ir.IntType(32)


class Lanes(types.Type):
    """Type of eight numbers within a kernel."""


_LANES = Lanes("Lanes")


@register_model(Lanes)
class _Model(PrimitiveModel):
    """How the compiler keeps them."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)  # type: ignore[no-untyped-call]


def _place(context: Any, builder: Any, kind: Any, array: Any, place: Any) -> Any:
    """Where eight elements of an array begin, counted through a contiguous one."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [place]), _VECTOR.as_pointer())


def _chosen(builder: Any, vector: Any, lanes: list[int]) -> Any:
    """Choose lanes of a vector."""
    chosen = ir.Constant(ir.VectorType(_INTEGER, len(lanes)), lanes)
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), chosen)


def _added(builder: Any, total: Any, one: Any, other: Any) -> Any:
    """Add a product, rounded once where the processor can."""
    product = builder.fmul(one, other, flags=("contract",))
    return builder.fadd(product, total, flags=("contract",))


def _none(_: Any) -> Any:
    """Eight zeros."""

    def generate(*_: Any) -> Any:
        """Emit the constant."""
        return ir.Constant(_VECTOR, [0.0] * LANES)

    return _LANES(), generate


def _load(_: Any, array: Any, place: Any) -> Any:
    """Eight elements of an array, counted through it, from a place on."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        """Emit the load."""
        return builder.load(_place(context, builder, signature.args[0], *arguments), align=8)

    return _LANES(array, place), generate


def _store(_: Any, array: Any, place: Any, value: Any) -> Any:
    """Put eight numbers into an array, counted through it, from a place on."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        """Emit the store."""
        array, place, value = arguments
        builder.store(value, _place(context, builder, signature.args[0], array, place), align=8)
        return context.get_dummy_value()

    return types.void(array, place, value), generate


def _plus(_: Any, total: Any, factor: Any, value: Any) -> Any:
    """Add eight numbers, all times one factor."""

    def generate(_: Any, builder: Any, __: Any, arguments: Any) -> Any:
        """Emit the sum of products."""
        total, factor, value = arguments
        unset, place = ir.Constant(_VECTOR, ir.Undefined), ir.Constant(_INTEGER, 0)
        first = builder.insert_element(unset, factor, place)
        return _added(builder, total, _chosen(builder, first, [0] * LANES), value)

    return _LANES(total, factor, value), generate


def _plus_each(_: Any, total: Any, one: Any, other: Any) -> Any:
    """Add the products of eight pairs."""

    def generate(_: Any, builder: Any, __: Any, arguments: Any) -> Any:
        """Emit the sum of products."""
        return _added(builder, *arguments)

    return _LANES(total, one, other), generate


def _summed(_: Any, value: Any) -> Any:
    """Sum of eight numbers, of halves first."""

    def generate(_: Any, builder: Any, __: Any, arguments: Any) -> Any:
        """Emit sums of one half and the other."""
        (vector,), left = arguments, LANES
        while left > 1:
            left //= 2
            low, high = range(left), range(left, 2 * left)
            vector = builder.fadd(_chosen(builder, vector, list(low)), _chosen(builder, vector, list(high)))
        return builder.extract_element(vector, ir.Constant(_INTEGER, 0))

    return types.float64(value), generate


none, load, store = (cast("Any", intrinsic(one)) for one in (_none, _load, _store))
plus, plus_each, summed = (cast("Any", intrinsic(one)) for one in (_plus, _plus_each, _summed))


def padded(count: int) -> int:
    """Round up to whole lanes."""
    return (count + LANES - 1) // LANES * LANES


filled = inlined(padded)
