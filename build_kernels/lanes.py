# Copyright 2026 The rigid_body_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Lanes as numba compiles them: a number of each of several bodies in one SIMD register."""

from __future__ import annotations

from collections.abc import Callable
import math
import operator
import os
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.cgutils import alloca_once, get_or_insert_function
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

#: Bodies in a step, see `levels.Level`.
LANES = int(os.environ['LANES'])


class Lanes(types.Type):
    """The type of numbers."""

    def __init__(self) -> None:
        super().__init__('Lanes')


class _Mask(types.Type):

    def __init__(self) -> None:
        super().__init__('Mask')


REGISTER = ir.VectorType(ir.DoubleType(), LANES)
_FLAGS = ir.VectorType(ir.IntType(1), LANES)
NUMBERS, _MASK = Lanes(), _Mask()


@register_model(Lanes)
class _NumbersModel(models.PrimitiveModel):

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, REGISTER)


@register_model(_Mask)
class _MaskModel(models.PrimitiveModel):

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _FLAGS)


def splat(builder: Any, value: Any) -> Any:
    """Return a register with the same number in each lane; a register is returned as it is."""
    if value.type == REGISTER:
        return value
    if isinstance(value.type, ir.IntType):
        value = builder.sitofp(value, ir.DoubleType())
    register = builder.insert_element(ir.Constant(REGISTER, ir.Undefined), value,
                                      ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(register, register, zeros)


def call(builder: Any, name: str, *values: Any) -> Any:
    """Call an intrinsic of LLVM for registers of any size."""
    register = values[0].type
    kind = ir.FunctionType(register, [register] * len(values))
    function = get_or_insert_function(builder.module, kind, f'{name}.v{register.count}f64')
    return builder.call(function, values)


def _define(operation: Callable[..., Any], result: Any, count: int,
            generate: Callable[..., Any]) -> None:
    """Define a Python operation if any of its arguments has lanes."""
    @infer_global(operation)
    class _Template(AbstractTemplate):

        def generic(self, arguments: Any, _: Any) -> Any:
            if len(arguments) == count and NUMBERS in arguments:
                return signature(result, *arguments)
            return None

    def lower(_: Any, builder: Any, __: Any, values: Any) -> Any:
        return generate(builder, *(splat(builder, value) for value in values))
    if count == 1:
        lower_builtin(operation, Lanes)(lower)
    else:
        for kinds in ((Lanes, Lanes), (Lanes, types.Float), (types.Float, Lanes),
                      (Lanes, types.Integer)):
            lower_builtin(operation, *kinds)(lower)


for _python, _llvm in ((operator.add, 'fadd'), (operator.iadd, 'fadd'),
                       (operator.sub, 'fsub'), (operator.mul, 'fmul'),
                       (operator.truediv, 'fdiv')):
    _define(_python, NUMBERS, 2,
            lambda builder, a, b, name=_llvm: getattr(builder, name)(a, b))
_define(operator.neg, NUMBERS, 1, lambda builder, a: builder.fneg(a))
_define(math.sqrt, NUMBERS, 1, lambda builder, a: call(builder, 'llvm.sqrt', a))
for _python, _sign in ((operator.gt, '>'), (operator.ge, '>='), (operator.lt, '<'),
                       (operator.le, '<=')):
    _define(_python, _MASK, 2,
            lambda builder, a, b, sign=_sign: builder.fcmp_ordered(sign, a, b))


@intrinsic
def fma(_context: Any, a: Any, b: Any, c: Any) -> Any:
    """
    Return a b + c, rounded once, of floats or lanes.

    It takes half the time of a product and a sum, and fma(a, b, -(a * b)) is the rounding
    error of a product. Kernels call it explicitly, because a compiler may fuse a formula in
    one place and not in another.
    """
    if NUMBERS not in (a, b, c):
        return types.float64(types.float64, types.float64, types.float64), \
            lambda _, builder, __, values: builder.fma(*values)
    return NUMBERS(a, b, c), lambda _, builder, __, values: call(
        builder, 'llvm.fma', *(splat(builder, value) for value in values))


def _place(context: Any, builder: Any, kind: Any, array: Any, row: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    start = builder.mul(row, ir.Constant(row.type, LANES))
    return builder.bitcast(builder.gep(data, [start]), REGISTER.as_pointer())


@intrinsic
def load(_context: Any, values: Any, row: Any) -> Any:
    """Return the numbers in a row of an array, shape (n, LANES)."""
    return NUMBERS(values, types.intp), lambda context, builder, _, operands: builder.load(
        _place(context, builder, values, *operands), align=8)


@intrinsic
def store(_context: Any, values: Any, row: Any, numbers: Any) -> Any:
    """Write numbers into a row of an array, shape (n, LANES)."""
    def generate(context: Any, builder: Any, _: Any, operands: Any) -> Any:
        array, row, register = operands
        builder.store(register, _place(context, builder, values, array, row), align=8)
        return context.get_dummy_value()
    return types.void(values, types.intp, NUMBERS), generate


@intrinsic
def align_stack(_context: Any) -> Any:
    """
    Align the stack of a function for registers.

    The compiler does this for variables in memory, but not for registers that it spills. Each
    of those would then take two cache lines.
    """
    def generate(context: Any, builder: Any, _: Any, __: Any) -> Any:
        place = alloca_once(builder, REGISTER)
        builder.asm(ir.FunctionType(ir.VoidType(), [place.type]), '', 'r', [place], True)
        return context.get_dummy_value()
    return types.void(), generate


@intrinsic
def zero(_context: Any, like: Any) -> Any:
    """Return zero, of the type of a float, of lanes or of a `four.Four`."""
    return like(like), lambda context, *_: ir.Constant(context.get_value_type(like), None)


@intrinsic
def no_count(_context: Any, like: Any) -> Any:
    """Return zero to count from: an integer, or lanes if a number has lanes."""
    kind = NUMBERS if like == NUMBERS else types.intp
    return kind(like), lambda context, _, __, ___: ir.Constant(
        context.get_value_type(kind), None if kind == NUMBERS else 0)


@intrinsic
def counted(_context: Any, condition: Any, count: Any) -> Any:
    """Return zero where a condition holds, and one more than the count elsewhere."""
    def generate(_: Any, builder: Any, __: Any, values: Any) -> Any:
        condition, number = values
        if count != NUMBERS:
            more = builder.add(number, ir.Constant(number.type, 1))
            return builder.select(condition, ir.Constant(number.type, 0), more)
        more = builder.fadd(number, ir.Constant(REGISTER, [1.0] * LANES))
        return builder.select(condition, ir.Constant(REGISTER, None), more)
    return count(condition, count), generate


@intrinsic
def where(_context: Any, condition: Any, one: Any, other: Any) -> Any:
    """Return one of two numbers, in each lane: the first where a condition holds."""
    return NUMBERS(condition, one, other), lambda _, builder, __, values: builder.select(
        values[0], *(splat(builder, value) for value in values[1:]))


@intrinsic
def truncated(_context: Any, numbers: Any) -> Any:
    """Return numbers without their fractions."""
    return NUMBERS(numbers), lambda _, builder, __, values: call(
        builder, 'llvm.trunc', *values)


def _bits(builder: Any, condition: Any, value: Any) -> Any:
    # Return a condition as an integer, a bit for each lane.
    return builder.bitcast(value, ir.IntType(LANES)) if condition == _MASK else value


@intrinsic
def every(_context: Any, condition: Any) -> Any:
    """Return whether a condition holds in every lane."""
    def generate(_: Any, builder: Any, __: Any, values: Any) -> Any:
        bits = _bits(builder, condition, values[0])
        return builder.icmp_signed('==', bits, ir.Constant(bits.type, -1))
    return types.boolean(condition), generate


@intrinsic
def some(_context: Any, condition: Any) -> Any:
    """Return whether a condition holds in some lane."""
    def generate(_: Any, builder: Any, __: Any, values: Any) -> Any:
        bits = _bits(builder, condition, values[0])
        return builder.icmp_signed('!=', bits, ir.Constant(bits.type, 0))
    return types.boolean(condition), generate


@intrinsic
def both(_context: Any, one: Any, other: Any) -> Any:
    """Return whether two conditions hold."""
    return one(one, other), lambda _, builder, __, values: builder.and_(*values)
