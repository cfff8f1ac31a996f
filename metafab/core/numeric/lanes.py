"""Complex arithmetic of compiled kernels on lanes: :data:`LANES` independent problems in one vector register.

A lane array is a flat float64 array. Its element k holds one complex number of each lane: ``LANES`` real parts, from
place 2 ``LANES`` k on, and then the imaginary parts. Numba vectorises a loop only behind a test that its arrays do not
overlap, and for short loops the tests take longer than the loops. The operations here are therefore written as vector
instructions. They run in kernels alone, on C-contiguous arrays, and check no bounds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numba.extending
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled

#: Numbers of double precision in a register of 512 bits. Processors with shorter registers take several for a vector.
LANES = 8
#: Numbers of one element of a lane array.
ELEMENT = 2 * LANES

#: Numba's helpers that write loops and variables; some of them lack type annotations.
_CODE: Any = cgutils
_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
#: Allows fused multiply-add, which rounds a product and a sum once.
_FUSED = ("contract",)


@compiled
def lane_array(count: int) -> FloatArray:
    """Lane array of ``count`` zeros, shape (ELEMENT count,), aligned to a cache line."""
    numbers = np.zeros(count * ELEMENT + LANES)
    first = (-(numbers.ctypes.data // 8)) % LANES
    return numbers[first : first + count * ELEMENT]


@dataclass(frozen=True)
class _Call:
    """Addresses of numbers in the arguments of one call, for the instructions that numba's ``builder`` collects."""

    context: Any
    builder: Any
    signature: Any
    arguments: Any

    def number(self, value: int) -> Any:
        """An integer constant."""
        return self.context.get_constant(types.intp, value)

    def address(self, array: int, place: Any, offset: int) -> Any:
        """Address of number ``place + offset`` of the array that is argument ``array``."""
        made = self.context.make_array(self.signature.args[array])(self.context, self.builder, self.arguments[array])
        return self.builder.gep(made.data, [self.builder.add(place, self.number(offset))])

    def vector(self, array: int, place: Any, offset: int = 0) -> Any:
        """Address of the vector that begins there."""
        return self.builder.bitcast(self.address(array, place, offset), _VECTOR.as_pointer())

    def load(self, address: Any) -> Any:
        """The number or vector at ``address``."""
        return self.builder.load(address, align=8)

    def parts(self, array: int, element: Any) -> list[Any]:
        """Addresses of the real and the imaginary parts of an element."""
        place = self.builder.mul(element, self.number(ELEMENT))
        return [self.vector(array, place, offset) for offset in (0, LANES)]

    def loaded(self, parts: Sequence[Any]) -> list[Any]:
        """Vectors at both addresses."""
        return [self.load(part) for part in parts]

    def store(self, values: Sequence[Any], parts: Sequence[Any]) -> None:
        """Write both vectors to their addresses."""
        for value, part in zip(values, parts, strict=True):
            self.builder.store(value, part, align=8)

    def less(self, c: Sequence[Any], f: Sequence[Any], x: Sequence[Any]) -> list[Any]:
        """The vectors of c - f x."""
        subtract, add, multiply = self.builder.fsub, self.builder.fadd, self.builder.fmul
        re = subtract(c[0], multiply(f[0], x[0], flags=_FUSED), flags=_FUSED)
        im = subtract(c[1], multiply(f[0], x[1], flags=_FUSED), flags=_FUSED)
        re = add(re, multiply(f[1], x[1], flags=_FUSED), flags=_FUSED)
        return [re, subtract(im, multiply(f[1], x[0], flags=_FUSED), flags=_FUSED)]

    def splat(self, number: Any) -> Any:
        """A vector of equal numbers."""
        undefined, integer = ir.Constant(_VECTOR, ir.Undefined), ir.IntType(32)
        first = self.builder.insert_element(undefined, number, ir.Constant(integer, 0))
        return self.builder.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(integer, LANES), None))


Write = Callable[[Any, Any, Any, Any], None]


def _operation(function: Callable[..., tuple[Any, Write]]) -> Callable[..., None]:
    """Let kernels call ``function``, which returns its signature and the function that writes its instructions."""
    return cast("Callable[..., None]", numba.extending.intrinsic(function))


def _subtracts(fixed: int | None) -> Callable[..., None]:
    """Subtraction of products f[f_at + k] x[x_at + k] from c[c_at + k], k = 0 to ``count`` - 1.

    ``fixed`` is the argument whose element does not move with k, 0 for c and 2 for f: it stays in registers. Arrays are
    lane arrays, and places are elements.
    """

    def operation(_: Any, c: Any, c_at: Any, f: Any, f_at: Any, x: Any, x_at: Any, count: Any) -> tuple[Any, Write]:
        def write(*call: Any) -> None:
            this = _Call(*call)
            builder, arguments = this.builder, this.arguments

            def parts(array: int, step: Any) -> list[Any]:
                return this.parts(array, builder.add(arguments[array + 1], step))

            def products(f: Sequence[Any], x: Sequence[Any], into: Sequence[Any]) -> None:
                """Subtract one product of lanes."""
                f, x, sums = (this.loaded(each) for each in (f, x, into))
                this.store(this.less(sums, f, x), into)

            held = [] if fixed is None else [_CODE.alloca_once(builder, _VECTOR) for _ in range(2)]
            outside = [] if fixed is None else parts(fixed, this.number(0))
            for part, register in zip(outside, held, strict=True):
                builder.store(this.load(part), register)
            with _CODE.for_range(builder, arguments[6]) as loop:
                into, f_parts, x_parts = (held if array == fixed else parts(array, loop.index) for array in (0, 2, 4))
                products(f_parts, x_parts, into)
            if fixed == 0:
                for part, register in zip(outside, held, strict=True):
                    builder.store(this.load(register), part, align=8)

        return types.void(c, c_at, f, f_at, x, x_at, count), write

    return _operation(operation)


#: c[c_at + k] -= f[f_at + k] x[x_at + k].
subtract_products = _subtracts(None)
#: c[c_at + k] -= f[f_at] x[x_at + k].
subtract_multiple = _subtracts(2)
#: c[c_at] -= sum_k f[f_at + k] x[x_at + k].
subtract_dot = _subtracts(0)


@_operation
def subtract_multiples(
    _: Any, c: Any, c_at: Any, f: Any, f_at: Any, f_step: Any, x: Any, x_at: Any, x_step: Any, count: Any
) -> tuple[Any, Write]:
    """c[c_at + k] -= f[f_at] x[x_at + k] + f[f_at + f_step] x[x_at + x_step + k]."""

    def write(*call: Any) -> None:
        this = _Call(*call)
        add, (_, c_at, _, f_at, f_step, _, x_at, x_step, count) = this.builder.add, this.arguments
        factors = [this.loaded(this.parts(2, at)) for at in (f_at, add(f_at, f_step))]
        with _CODE.for_range(this.builder, count) as loop:
            into, first = this.parts(0, add(c_at, loop.index)), add(x_at, loop.index)
            rest = this.loaded(into)
            for factor, at in zip(factors, (first, add(first, x_step)), strict=True):
                rest = this.less(rest, factor, this.loaded(this.parts(5, at)))
            this.store(rest, into)

    return types.void(c, c_at, f, f_at, f_step, x, x_at, x_step, count), write


@_operation
def add_turned(
    _: Any, into: Any, at: Any, values: Any, begin: Any, places: Any, turn: Any, i: Any, j: Any
) -> tuple[Any, Write]:
    """Add T_i V T_j^T, T_k = [[1, f_k], [-f_k, 1]] with ``turn`` f, to the elements at + ``places`` of ``into``.

    ``places`` are those of V_00, V_01, V_10 and V_11, at begin + ``places`` of ``values``. Equal places get equal sums.
    """

    def write(*call: Any) -> None:
        this = _Call(*call)
        add, (_, at, _, begin, places, _, i, j) = this.builder.add, this.arguments
        four = _CODE.unpack_tuple(this.builder, places, 4)
        v00, v01, v10, v11 = (this.loaded(this.parts(2, add(begin, place))) for place in four)
        factors = []
        for k in (i, j):
            re, im = this.loaded(this.parts(5, k))
            factors.append(((re, im), (this.builder.fneg(re), this.builder.fneg(im))))
        (f, less_f), (g, less_g) = factors
        v00, v10 = this.less(v00, less_f, v10), this.less(v10, f, v00)
        v01, v11 = this.less(v01, less_f, v11), this.less(v11, f, v01)
        v00, v01 = this.less(v00, less_g, v01), this.less(v01, g, v00)
        v10, v11 = this.less(v10, less_g, v11), this.less(v11, g, v10)
        sums = [this.parts(0, add(at, place)) for place in four]
        before = [this.loaded(each) for each in sums]
        for parts, old, new in zip(sums, before, (v00, v01, v10, v11), strict=True):
            this.store([this.builder.fadd(a, b) for a, b in zip(old, new, strict=True)], parts)

    return types.void(into, at, values, begin, places, turn, i, j), write


@_operation
def copy(_: Any, into: Any, first: Any, step: Any, values: Any, begin: Any, count: Any) -> tuple[Any, Write]:
    """Write into[first + k step] = values[begin + k], k = 0 to ``count`` - 1, elements of lane arrays."""

    def write(*call: Any) -> None:
        this = _Call(*call)
        builder, arguments = this.builder, this.arguments
        with _CODE.for_range(builder, arguments[5]) as loop:
            to = builder.add(arguments[1], builder.mul(loop.index, arguments[2]))
            places = (0, to), (3, builder.add(arguments[4], loop.index))
            for offset in (0, LANES):
                there, here = (
                    this.vector(array, builder.mul(place, this.number(ELEMENT)), offset) for array, place in places
                )
                builder.store(this.load(here), there, align=8)

    return types.void(into, first, step, values, begin, count), write


@_operation
def sum_terms(
    _: Any, values: Any, first: Any, coefficients: Any, row: Any, terms: Any, term: Any, count: Any
) -> tuple[Any, Write]:
    """Write values[first + k] = sum_t coefficients[row + k, t] terms[term + t], k = 0 to ``count`` - 1.

    ``values`` is a lane array, ``coefficients`` has shape (rows, n, 2), real and imaginary parts, and ``terms``, real,
    has shape (m, LANES).
    """

    def write(*call: Any) -> None:
        this = _Call(*call)
        builder, arguments = this.builder, this.arguments
        shape = this.context.make_array(this.signature.args[2])(this.context, builder, arguments[2]).shape
        n_terms = _CODE.unpack_tuple(builder, shape, 3)[1]
        sums = [_CODE.alloca_once(builder, _VECTOR) for _ in range(2)]
        with _CODE.for_range(builder, arguments[6]) as rows:
            for part in sums:
                builder.store(ir.Constant(_VECTOR, None), part)
            start = builder.mul(builder.add(arguments[3], rows.index), n_terms)
            with _CODE.for_range(builder, n_terms) as steps:
                value = this.load(
                    this.vector(4, builder.mul(builder.add(arguments[5], steps.index), this.number(LANES)))
                )
                place = builder.mul(builder.add(start, steps.index), this.number(2))
                for offset, part in enumerate(sums):
                    factor = this.splat(this.load(this.address(2, place, offset)))
                    product = builder.fmul(factor, value, flags=_FUSED)
                    builder.store(builder.fadd(builder.load(part), product, flags=_FUSED), part)
            into = builder.mul(builder.add(arguments[1], rows.index), this.number(ELEMENT))
            for offset, part in enumerate(sums):
                builder.store(builder.load(part), this.vector(0, into, offset * LANES), align=8)

    return types.void(values, first, coefficients, row, terms, term, count), write
