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
Decorators that mark the kernels for the build step.

The build step replaces this module with one that compiles the kernels. The decorators defined here
do almost nothing, so the kernels run as plain Python. The results are then bit-identical to those
of compiled kernels, but the kernels run hundreds of times slower.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from rigid_body_ros.common.arrays import Floats

#: Put this mark in the annotation of an array that the kernel writes to.
WRITTEN = 'written'

Kernel = TypeVar('Kernel', bound=Callable[..., Any])


def njit(kernel: Kernel) -> Kernel:
    """
    Mark a kernel that is called from Python.

    The build step compiles the kernel once for each combination of types that its annotations
    allow. The annotation of an array gives the shape, as in ``Annotated[Floats, 'n 3']``, and adds
    WRITTEN if the kernel writes to the array. Each dimension is a number, a variable, or a linear
    function of a variable, such as '7m' or '2d+1'. A variable has the same value in all arguments
    of a kernel. Alternatives are separated by '|', as in 'n|0'. The variable L is the number of
    lanes; see `lanes`.
    """
    return kernel


def combined(*names: tuple[str, ...]) -> Callable[[Any], Any]:
    """
    Mark a named tuple of which only some combinations of optional fields occur.

    Each argument lists the fields that are not None in a combination. The build step compiles
    kernels for these combinations only.
    """
    def marked(kind: Any) -> Any:
        kind.combinations = names
        return kind
    return marked


def internal(kernel: Kernel) -> Kernel:
    """Mark a function that other kernels call."""
    return kernel


def inlined(kernel: Kernel) -> Kernel:
    """
    Mark a function that is inlined into each kernel that calls it.

    If a call is not inlined, its tuples are passed through memory, which takes as long as all the
    arithmetic of a short step.
    """
    return kernel


def optional(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """
    Mark an inlined function that handles an optional part of a scene.

    If the first argument is None, the function returns None without running its body. The compiler
    makes this choice from the type of the argument, so kernels for scenes without the part do not
    contain any code for it.
    """
    def choose(first: Any, *rest: Any) -> Any:
        return None if first is None else kernel(first, *rest)
    return choose


def record(fields: list[tuple[Any, ...]]) -> Any:
    """Return a structured dtype whose fields kernels can read as attributes."""
    return np.dtype((np.record, np.dtype(fields, align=True)))


def scratch(count: int) -> Floats:
    """
    Return an uninitialized array of constant size, for use during one call.

    In compiled kernels, the array lives on the stack. It is valid only until the function that
    called `scratch` returns, even if that function is inlined. So never return the array from that
    function.
    """
    return np.empty(count)
