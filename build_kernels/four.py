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

"""Four doubles as numba compiles them: in one SIMD register, or in four registers of lanes."""

from __future__ import annotations

from collections.abc import Callable
import operator
from typing import Any

import lanes
from llvmlite import ir
from numba.core import types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model


class _Type(types.Type):

    def __init__(self) -> None:
        super().__init__('Four')


class _Lanes(types.Type):

    def __init__(self) -> None:
        super().__init__('FourLanes')


_REGISTER = ir.VectorType(ir.DoubleType(), 4)
_REGISTERS = ir.ArrayType(lanes.REGISTER, 4)
_BITS = ir.VectorType(ir.IntType(64), 4)
_FOUR, _LANES = _Type(), _Lanes()


@register_model(_Type)
class _Model(models.PrimitiveModel):

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _REGISTER)


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _REGISTERS)


@infer_global(operator.getitem)
class _Element(AbstractTemplate):

    def generic(self, arguments: Any, _: Any) -> Any:
        if isinstance(arguments[0], _Type):
            return signature(types.float64, *arguments)
        if isinstance(arguments[0], _Lanes) and isinstance(arguments[1], types.IntegerLiteral):
            return signature(lanes.NUMBERS, *arguments)
        return None


@lower_builtin(operator.getitem, _Type, types.Integer)
def _element(_: Any, builder: Any, __: Any, values: Any) -> Any:
    return builder.extract_element(*values)


@lower_builtin(operator.getitem, _Lanes, types.IntegerLiteral)
def _lanes_of_element(_: Any, builder: Any, kinds: Any, values: Any) -> Any:
    return builder.extract_value(values[0], kinds.args[1].literal_value)


#: For annotations only.
Four = tuple[float, float, float, float]


def _operation(count: int, generate: Callable[..., Any],
               for_lanes: Callable[..., Any]) -> Callable[..., Any]:
    # Return an operation for the kernels. It is given by the number of its arguments and functions
    # that generate its LLVM instructions: for registers, and for lanes from the four registers of
    # each argument.
    def typed(*arguments: Any) -> Any:
        if _LANES not in arguments and lanes.NUMBERS not in arguments:
            return (_FOUR(*(kind if kind == _FOUR else types.float64 for kind in arguments)),
                    lambda _, builder, __, values: generate(builder, *values))
        return _LANES(*arguments), lambda _, builder, __, values: _collect(builder, for_lanes(
            builder, *(_spread(builder, *each) for each in zip(arguments, values))))
    by_count = (lambda _, a: typed(a), lambda _, a, b: typed(a, b),
                lambda _, a, b, c: typed(a, b, c), lambda _, a, b, c, d: typed(a, b, c, d))
    return intrinsic(by_count[count - 1])


def _spread(builder: Any, kind: Any, value: Any) -> list[Any]:
    # Return the four registers of an argument. What has no lanes is the same in each lane.
    if kind == _LANES:
        return [builder.extract_value(value, place) for place in range(4)]
    if kind == _FOUR:
        return [lanes.splat(builder, builder.extract_element(value, ir.Constant(
            ir.IntType(32), place))) for place in range(4)]
    return [lanes.splat(builder, value)] * 4


def _collect(builder: Any, registers: list[Any]) -> Any:
    result = ir.Constant(_REGISTERS, ir.Undefined)
    for place, register in enumerate(registers):
        result = builder.insert_value(result, register, place)
    return result


def _elementwise(count: int, generate: Callable[..., Any]) -> Callable[..., Any]:
    # Return an operation on each element.
    return _operation(
        count, generate,
        lambda builder, *operands: [generate(builder, *values) for values in zip(*operands)])


def _build_register(builder: Any, *values: Any) -> Any:
    register = ir.Constant(_REGISTER, ir.Undefined)
    for place, value in enumerate(values):
        register = builder.insert_element(register, value, ir.Constant(ir.IntType(32), place))
    return register


def _permutation(order: str, signs: str = '++++') -> Callable[..., Any]:
    # Return an operation that reorders the elements and applies these signs.
    places = ['xyzw'.index(letter) for letter in order]
    factors = [-1.0 if sign == '-' else 1.0 for sign in signs]

    def generate(builder: Any, a: Any) -> Any:
        mask = ir.Constant(ir.VectorType(ir.IntType(32), 4), places)
        bits = builder.bitcast(builder.shuffle_vector(a, a, mask), _BITS)
        flips = ir.Constant(_BITS, [int(factor < 0.0) << 63 for factor in factors])
        return builder.bitcast(builder.xor(bits, flips), _REGISTER)
    return _operation(
        1, generate,
        lambda builder, a: [builder.fneg(a[place]) if factor < 0.0 else a[place]
                            for factor, place in zip(factors, places)])


#: Build four doubles from four floats, or from one float four times.
of = _operation(4, _build_register,
                lambda builder, *values: [registers[0] for registers in values])
broadcast = _operation(1,
                       lambda builder, value: _build_register(builder, *[value] * 4),
                       lambda builder, value: value)
add = _elementwise(2, lambda builder, a, b: builder.fadd(a, b))
subtract = _elementwise(2, lambda builder, a, b: builder.fsub(a, b))
multiply = _elementwise(2, lambda builder, a, b: builder.fmul(a, b))
negative = _elementwise(1, lambda builder, a: builder.fneg(a))
absolute = _elementwise(1, lambda builder, a: lanes.call(builder, 'llvm.fabs', a))
#: a b + c of each element, rounded once.
fma = _elementwise(3,
                   lambda builder, *values: lanes.call(builder, 'llvm.fma', *values))
#: The components of a vector in the order y, z, x and z, x, y.
yzx, zxy = _permutation('yzxw'), _permutation('zxyw')
#: Hamilton's product q i, q j and q k of a quaternion q.
times_i, times_j, times_k = (_permutation('wzyx', '++--'), _permutation('zwxy', '-++-'),
                             _permutation('yxwz', '+-+-'))


def _kind_in(array: Any) -> Any:
    # Return the type of what is in an array.
    return _FOUR if array.ndim == 1 else _LANES


def _pointer(context: Any, builder: Any, kind: Any, array: Any, start: Any) -> Any:
    # A row of lanes has as many doubles as there are lanes.
    width = 1 if kind.ndim == 1 else lanes.LANES
    data = context.make_array(kind)(context, builder, array).data
    place = builder.mul(start, ir.Constant(start.type, width))
    register = _REGISTER if kind.ndim == 1 else _REGISTERS
    return builder.bitcast(builder.gep(data, [place]), register.as_pointer())


def _read(builder: Any, pointer: Any) -> Any:
    if pointer.type.pointee == _REGISTER:
        return builder.load(pointer, align=8)
    return _collect(builder, [
        builder.load(_register_at(builder, pointer, place), align=8) for place in range(4)])


def _write(builder: Any, value: Any, pointer: Any) -> None:
    if pointer.type.pointee == _REGISTER:
        builder.store(value, pointer, align=8)
        return
    for place in range(4):
        builder.store(builder.extract_value(value, place),
                      _register_at(builder, pointer, place), align=8)


def _register_at(builder: Any, pointer: Any, place: int) -> Any:
    return builder.gep(pointer, [ir.Constant(ir.IntType(32), k) for k in (0, place)])


@intrinsic
def load(_context: Any, values: Any, start: Any) -> Any:
    """
    Return four successive elements of a contiguous array, shape (n,), from an index on.

    In lanes these are four rows of an array, shape (n, LANES).
    """
    def generate(context: Any, builder: Any, _: Any, operands: Any) -> Any:
        return _read(builder, _pointer(context, builder, values, *operands))
    return _kind_in(values)(values, types.intp), generate


@intrinsic
def store(_context: Any, values: Any, start: Any, four: Any) -> Any:
    """Write the elements that `load` returns."""
    def generate(context: Any, builder: Any, _: Any, operands: Any) -> Any:
        array, start, value = operands
        _write(builder, value, _pointer(context, builder, values, array, start))
        return context.get_dummy_value()
    return types.void(values, types.intp, four), generate


zero = lanes.zero


@intrinsic
def choose(_context: Any, condition: Any, one: Any, other: Any) -> Any:
    """Return one of two fours, in each lane: the first where a condition holds."""
    def generate(_: Any, builder: Any, __: Any, values: Any) -> Any:
        if one == _FOUR:
            return builder.select(*values)
        return _collect(builder, [builder.select(values[0], *pair) for pair in zip(
            _spread(builder, one, values[1]), _spread(builder, other, values[2]))])
    return one(condition, one, other), generate


@intrinsic
def has_lanes(_context: Any, values: Any) -> Any:
    """Return whether an array has lanes; the compiler leaves out code for the other case."""
    return types.boolean(values), lambda *_: ir.Constant(ir.IntType(1), values.ndim == 2)
