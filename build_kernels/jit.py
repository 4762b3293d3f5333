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

"""The marks of `rigid_body_ros.kernels.jit`, which compile here."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

from llvmlite import ir
import numba
from numba.core import types
from numba.core.cgutils import alloca_once
from numba.extending import intrinsic, overload
from numba.np.arrayobj import populate_array
import numpy as np

#: In an annotation: the kernel writes to the array.
WRITTEN = 'written'
#: All kernels that Python calls.
EXPORTED: list[Any] = []

# Arithmetic follows IEEE 754 (no fast-math), so a kernel returns the same bits wherever it is
# inlined. The boundary in C replaces numba's wrappers.
_OPTIONS = {'error_model': 'numpy', 'no_cpython_wrapper': True, 'no_cfunc_wrapper': True}


def njit(kernel: Any) -> Any:
    """Register a kernel, see `rigid_body_ros.kernels.jit.njit`."""
    compiled = numba.njit(**_OPTIONS)(kernel)
    EXPORTED.append(compiled)
    return compiled


def internal(kernel: Any) -> Any:
    """Compile a function that kernels call."""
    return _Internal(kernel)


def inlined(kernel: Any) -> Any:
    """Inline a function into each kernel that calls it."""
    return _Internal(kernel, forceinline=True)


def optional(kernel: Any) -> Any:
    """Compile an inlined function that returns None if its first argument is None."""
    compiled = inlined(kernel)

    def choose(first: Any, *rest: Any) -> None:
        raise NotImplementedError

    def by_type(first: Any, *rest: Any) -> Any:
        if isinstance(first, numba.types.NoneType):
            return lambda first, *rest: None
        return lambda first, *rest: compiled(first, *rest)

    overload(choose, strict=False, jit_options={**_OPTIONS, 'forceinline': True})(by_type)
    return choose


def record(fields: list[tuple[Any, ...]]) -> np.dtype[Any]:
    """Return a structured type whose fields a kernel reads as attributes."""
    return np.dtype(fields, align=True)


@intrinsic(prefer_literal=True)
def scratch(_context: Any, count: Any) -> Any:
    """Return an array of a constant size on the stack."""
    kind, size = types.Array(types.float64, 1, 'C'), count.literal_value

    def generate(context: Any, builder: Any, _: Any, __: Any) -> Any:
        place = alloca_once(builder, ir.ArrayType(ir.DoubleType(), size))
        place.align = 64  # a vector that lies in two cache lines takes longer
        array = context.make_array(kind)(context, builder)
        populate_array(array, builder.bitcast(place, ir.DoubleType().as_pointer()),
                       *([ir.Constant(ir.IntType(64), number)] for number in (size, 8)),
                       ir.Constant(ir.IntType(64), 8), None)
        return array._getvalue()
    return kind(count), generate


class _Internal:
    """To numba a compiled function. Most are called by a few kernels: it is made when needed."""

    def __init__(self, kernel: Callable[..., Any], **options: bool) -> None:
        self._kernel, self._options = kernel, options

    @property
    def _numba_type_(self) -> Any:
        return self._compiled._numba_type_

    @cached_property
    def _compiled(self) -> Any:
        return numba.njit(**_OPTIONS, **self._options)(self._kernel)
