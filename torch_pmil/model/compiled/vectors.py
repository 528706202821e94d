"""Vectors of eight float64 for Numba, which LLVM lowers to AVX2, AVX-512 or NEON alike.

Numba does not vectorise a loop over scalars that calls the exponential of the C library. Here the
exponential is a power of two, computed as a polynomial of whole vectors. A loop written by hand
also controls which numbers stay in registers.

Indices count the entries of a C-contiguous array from its first. The first argument of each
function, ``typing``, is Numba's: a call leaves it out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import models, register_model

from torch_pmil.model.compiled.building import intrinsic

WIDTH = 8
Emitter = tuple[Any, Callable[..., Any]]

_DOUBLES = ir.VectorType(ir.DoubleType(), WIDTH)
_INTEGERS = ir.VectorType(ir.IntType(64), WIDTH)
_INDEX = ir.IntType(32)

# 2^r = 1 + r p(r) for |r| <= 1/2, p by interpolation at Chebyshev's points: 0.13 ulp
_COEFFICIENTS = (
    1.0,
    0.6931471805599453,
    0.24022650695910097,
    0.0555041086648216,
    0.009618129107606888,
    0.0013333558146416936,
    0.0001540353044173605,
    1.525273382983612e-05,
    1.321544258792169e-06,
    1.0178062445845774e-07,
    7.072585949269223e-09,
    4.4549605981865186e-10,
)
LOG2_E = 1.4426950408889634
_ROUNDER = 1.5 * 2.0**52  # a double plus this is rounded to an integer, in its last bits
# sin(pi r / 2) = r s(r²) and cos(pi r / 2) = c(r²) for |r| <= 1/2, the same way: 0.2 ulp
_SINE = (
    1.5707963267948966,
    -0.6459640975062443,
    0.07969262624604301,
    -0.004681754132340976,
    0.0001604411507421909,
    -3.59864335298231e-06,
    5.633933781537854e-08,
)
_COSINE = (
    1.0,
    -1.2337005501361513,
    0.25366950789986475,
    -0.02086348073494657,
    0.000919259950041661,
    -2.520013526428479e-05,
    4.6552961874867623e-07,
)
_LEAST, _BEYOND = -1022.0, 1024.0  # least normal power of two, and the first that is no double


class Vector(types.Type):
    """Numba's type of eight float64."""

    def __init__(self) -> None:
        super().__init__(name="Vector")


vector = Vector()


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, numba_type: Any) -> None:
        super().__init__(manager, numba_type, _DOUBLES)


@intrinsic
def load(typing: Any, array: Any, index: Any) -> Emitter:
    """The eight numbers of an array from an index on."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_address(context, builder, signature, arguments, _DOUBLES), align=8)

    return vector(array, types.intp), emit


@intrinsic
def store(typing: Any, array: Any, index: Any, values: Any) -> Emitter:
    """Write eight numbers into an array, from an index on."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        target = _address(context, builder, signature, arguments, _DOUBLES)
        builder.store(arguments[2], target, align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), emit


@intrinsic
def spread(typing: Any, array: Any, index: Any) -> Emitter:
    """One number of an array, eight times."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        address = _address(context, builder, signature, arguments, ir.DoubleType())
        return _splat(builder, builder.load(address))

    return vector(array, types.intp), emit


@intrinsic
def splat(typing: Any, number: Any) -> Emitter:
    """A number, eight times."""
    return vector(types.float64), lambda context, builder, _, arguments: _splat(builder, *arguments)


@intrinsic
def add(typing: Any, a: Any, b: Any) -> Emitter:
    """a + b."""
    return vector(vector, vector), lambda context, builder, _, arguments: builder.fadd(*arguments)


@intrinsic
def multiply(typing: Any, a: Any, b: Any) -> Emitter:
    """a b, entry by entry."""
    return vector(vector, vector), lambda context, builder, _, arguments: builder.fmul(*arguments)


@intrinsic
def multiply_add(typing: Any, a: Any, b: Any, c: Any) -> Emitter:
    """a b + c, rounded once where the processor can do so."""
    return (
        vector(vector, vector, vector),
        lambda context, builder, _, arguments: _multiply_add(builder, *arguments),
    )


@intrinsic
def total(typing: Any, values: Any) -> Emitter:
    """The sum of the eight numbers."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        (values,), width = arguments, WIDTH
        while width > 1:
            width //= 2
            parts = (_indices(range(start, start + width)) for start in (0, width))
            values = builder.fadd(*(builder.shuffle_vector(values, values, p) for p in parts))
        return builder.extract_element(values, _INDEX(0))

    return types.float64(vector), emit


@intrinsic
def power_of_two(typing: Any, exponents: Any) -> Emitter:
    """2^x of eight numbers, within 2 ulp; 2e-308 below -1022, not finite where it overflows."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        (x,) = arguments
        for sign, bound in (("<", _LEAST), (">", _BEYOND)):  # as one instruction each; NaN stays
            beyond = builder.fcmp_ordered(sign, x, _constant(bound))
            x = builder.select(beyond, _constant(bound), x)
        whole, rest = _rounded(builder, x)
        value = _polynomial(builder, _COEFFICIENTS, rest)
        shift = builder.shl(whole, _INTEGERS([52] * WIDTH))
        return builder.bitcast(builder.add(builder.bitcast(value, _INTEGERS), shift), _DOUBLES)

    return vector(vector), emit


@intrinsic
def sines_and_cosines(typing: Any, turns: Any) -> Emitter:
    """Sines and cosines of eight angles in quarter turns, below 2^50, within 2 ulp of one."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        whole, rest = _rounded(builder, arguments[0])
        square = builder.fmul(rest, rest)
        sine = builder.fmul(rest, _polynomial(builder, _SINE, square))
        cosine = _polynomial(builder, _COSINE, square)
        one, two, to_sign = (_INTEGERS([number] * WIDTH) for number in (1, 2, 62))
        odd = builder.icmp_unsigned("!=", builder.and_(whole, one), _INTEGERS([0] * WIDTH))
        results = []
        further = builder.add(whole, one)  # the cosine is the sine of an angle a quarter larger
        for quarter, even_one, odd_one in ((whole, sine, cosine), (further, cosine, sine)):
            sign = builder.shl(builder.and_(quarter, two), to_sign)
            value = builder.bitcast(builder.select(odd, odd_one, even_one), _INTEGERS)
            results.append(builder.bitcast(builder.xor(value, sign), _DOUBLES))
        return context.make_tuple(builder, signature.return_type, results)

    return types.UniTuple(vector, 2)(vector), emit


def _rounded(builder: Any, x: Any) -> tuple[Any, Any]:
    """Integers whose last bits are those of the nearest whole numbers, and what these leave."""
    moved = builder.fadd(x, _constant(_ROUNDER))
    rest = builder.fsub(x, builder.fsub(moved, _constant(_ROUNDER)))
    return builder.bitcast(moved, _INTEGERS), rest


def _polynomial(builder: Any, coefficients: tuple[float, ...], x: Any) -> Any:
    value = _constant(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = _multiply_add(builder, value, x, _constant(coefficient))
    return value


def _address(context: Any, builder: Any, signature: Any, arguments: Any, kind: Any) -> Any:
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    return builder.bitcast(builder.gep(array.data, [arguments[1]]), kind.as_pointer())


def _splat(builder: Any, number: Any) -> Any:
    single = builder.insert_element(_DOUBLES(ir.Undefined), number, _INDEX(0))
    return builder.shuffle_vector(single, single, _indices([0] * WIDTH))


def _multiply_add(builder: Any, a: Any, b: Any, c: Any) -> Any:
    signature = ir.FunctionType(_DOUBLES, [_DOUBLES] * 3)
    name = f"llvm.fmuladd.v{WIDTH}f64"
    return builder.call(cgutils.get_or_insert_function(builder.module, signature, name), [a, b, c])


def _constant(number: float) -> Any:
    return _DOUBLES([number] * WIDTH)


def _indices(numbers: Any) -> Any:
    chosen = list(numbers)
    return ir.VectorType(_INDEX, len(chosen))(chosen)
