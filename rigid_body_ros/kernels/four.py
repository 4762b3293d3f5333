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

"""
Four doubles in one SIMD register, for the compiled kernels: a quaternion, or a vector and a zero.

Operations act on each element and round as operations on single doubles do, so results do not
depend on the size of a machine's registers. Kernels read the elements as a[0] to a[3]. Without
numba, four doubles are a tuple.
"""

from __future__ import annotations

from collections.abc import Callable
import operator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.kernels import jit

if jit.COMPILES:
    from llvmlite import ir
    from numba.core import types
    from numba.core.cgutils import get_or_insert_function
    from numba.core.typing.templates import AbstractTemplate, infer_global, signature
    from numba.extending import intrinsic, lower_builtin, models, register_model

    class _Type(types.Type):

        def __init__(self) -> None:
            super().__init__('Four')

    _REGISTER = ir.VectorType(ir.DoubleType(), 4)
    _BITS = ir.VectorType(ir.IntType(64), 4)
    _TYPES = {'four': _Type(), 'float': types.float64}

    @register_model(_Type)
    class _Model(models.PrimitiveModel):

        def __init__(self, manager: Any, kind: Any) -> None:
            super().__init__(manager, kind, _REGISTER)

    @infer_global(operator.getitem)
    class _Element(AbstractTemplate):

        def generic(self, arguments: Any, _: Any) -> Any:
            if isinstance(arguments[0], _Type):
                return signature(types.float64, *arguments)
            return None

    @lower_builtin(operator.getitem, _Type, types.Integer)
    def _element(_: Any, builder: Any, __: Any, values: Any) -> Any:
        return builder.extract_element(*values)

Four = tuple[float, float, float, float]


def _operation(plain: Callable[..., Any], kinds: str,
               generate: Callable[..., Any]) -> Callable[..., Four]:
    # Return an operation for the kernels. It is given by its Python form, the types of its
    # arguments, and a function that generates its LLVM instructions.
    if not jit.COMPILES:
        return plain
    arguments = [_TYPES[kind] for kind in kinds.split()]
    typed = (_TYPES['four'](*arguments),
             lambda _, builder, __, values: generate(builder, *values))
    by_count = (lambda _, a: typed, lambda _, a, b: typed, lambda _, a, b, c: typed,
                lambda _, a, b, c, d: typed)
    return intrinsic(by_count[len(arguments) - 1])


def _elementwise(operation: Callable[..., float]) -> Callable[..., tuple[float, ...]]:
    return lambda *operands: tuple(map(operation, *operands))


def _call_intrinsic(builder: Any, name: str, *values: Any) -> Any:
    kind = ir.FunctionType(_REGISTER, [_REGISTER] * len(values))
    return builder.call(get_or_insert_function(builder.module, kind, f'{name}.v4f64'), values)


def _build_register(builder: Any, *values: Any) -> Any:
    register = ir.Constant(_REGISTER, ir.Undefined)
    for place, value in enumerate(values):
        register = builder.insert_element(register, value, ir.Constant(ir.IntType(32), place))
    return register


def _permutation(order: str, signs: str = '++++') -> Callable[[Four], Four]:
    # Return an operation that reorders the elements and applies these signs.
    places = ['xyzw'.index(letter) for letter in order]
    factors = [-1.0 if sign == '-' else 1.0 for sign in signs]

    def generate(builder: Any, a: Any) -> Any:
        mask = ir.Constant(ir.VectorType(ir.IntType(32), 4), places)
        bits = builder.bitcast(builder.shuffle_vector(a, a, mask), _BITS)
        flips = ir.Constant(_BITS, [int(factor < 0.0) << 63 for factor in factors])
        return builder.bitcast(builder.xor(bits, flips), _REGISTER)
    return _operation(
        lambda a: tuple(factor * a[place] for factor, place in zip(factors, places)), 'four',
        generate)


#: Build four doubles from four floats, or from one float four times.
of = _operation(lambda *values: values, 'float float float float', _build_register)
broadcast = _operation(lambda value: (value,) * 4, 'float',
                       lambda builder, value: _build_register(builder, *[value] * 4))
add = _operation(_elementwise(operator.add), 'four four',
                 lambda builder, a, b: builder.fadd(a, b))
subtract = _operation(_elementwise(operator.sub), 'four four',
                      lambda builder, a, b: builder.fsub(a, b))
multiply = _operation(_elementwise(operator.mul), 'four four',
                      lambda builder, a, b: builder.fmul(a, b))
negative = _operation(_elementwise(operator.neg), 'four', lambda builder, a: builder.fneg(a))
absolute = _operation(_elementwise(abs), 'four',
                      lambda builder, a: _call_intrinsic(builder, 'llvm.fabs', a))
#: a b + c of each element, rounded once.
fma = _operation(_elementwise(jit.fma), 'four four four',
                 lambda builder, *values: _call_intrinsic(builder, 'llvm.fma', *values))
#: The components of a vector in the order y, z, x and z, x, y.
yzx, zxy = _permutation('yzxw'), _permutation('zxyw')
#: Hamilton's product q i, q j and q k of a quaternion q.
times_i, times_j, times_k = (_permutation('wzyx', '++--'), _permutation('zwxy', '-++-'),
                             _permutation('yxwz', '+-+-'))


def _plain_load(values: NDArray[np.float64], start: int) -> Four:
    a, b, c, d = values[start:start + 4].tolist()
    return a, b, c, d


def _plain_store(values: NDArray[np.float64], start: int, four: Four) -> None:
    values[start:start + 4] = four


if jit.COMPILES:
    def _pointer(context: Any, builder: Any, kind: Any, array: Any, start: Any) -> Any:
        data = context.make_array(kind)(context, builder, array).data
        return builder.bitcast(builder.gep(data, [start]), _REGISTER.as_pointer())

    @intrinsic
    def _load(_context: Any, values: Any, start: Any) -> Any:
        def generate(context: Any, builder: Any, _: Any, operands: Any) -> Any:
            return builder.load(_pointer(context, builder, values, *operands), align=8)
        return _TYPES['four'](values, types.intp), generate

    @intrinsic
    def _store(_context: Any, values: Any, start: Any, four: Any) -> Any:
        def generate(context: Any, builder: Any, _: Any, operands: Any) -> Any:
            array, start, value = operands
            builder.store(value, _pointer(context, builder, values, array, start), align=8)
            return context.get_dummy_value()
        return types.void(values, types.intp, four), generate

#: Read or write four successive elements of a contiguous array, shape (n,), from an index on.
load: Callable[[NDArray[np.float64], int], Four] = _load if jit.COMPILES else _plain_load
store: Callable[[NDArray[np.float64], int, Four], None] = \
    _store if jit.COMPILES else _plain_store
