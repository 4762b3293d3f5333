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
Marks of the kernels, for the build step that compiles them.

The build step replaces this module by one that compiles. Here the functions stay what they are:
plain Python, which computes the same bits, hundreds of times slower.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from rigid_body_ros.common.arrays import Floats

#: In an annotation: the kernel writes to the array.
WRITTEN = 'written'

Kernel = TypeVar('Kernel', bound=Callable[..., Any])


def njit(kernel: Kernel) -> Kernel:
    """
    Mark a kernel that Python calls.

    It is compiled once for each combination of types that its annotations allow. An array is
    annotated with its shape, ``Annotated[Floats, 'n 3']``, and with WRITTEN if the kernel writes
    to it. A dimension is a number, a variable, or linear in a variable: '7m', '2d+1'; it is the
    same in all arguments. With '|' follow other dimensions that are allowed: 'n|0'. L is the
    number of lanes, see `lanes`.
    """
    return kernel


def internal(kernel: Kernel) -> Kernel:
    """Mark a function that kernels call."""
    return kernel


def inlined(kernel: Kernel) -> Kernel:
    """
    Mark a function that is inlined into each kernel that calls it.

    Without inlining, a call passes tuples in memory, which takes as long as the arithmetic of a
    short step.
    """
    return kernel


def optional(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """
    Mark an inlined function for a part that not every scene has.

    If its first argument is None, it returns None. The compiler chooses by type, so a scene that
    lacks the part is compiled without its code.
    """
    def choose(first: Any, *rest: Any) -> Any:
        return None if first is None else kernel(first, *rest)
    return choose


def record(fields: list[tuple[Any, ...]]) -> Any:
    """Return a structured type whose fields a kernel reads as attributes."""
    return np.dtype((np.record, np.dtype(fields, align=True)))


def scratch(count: int) -> Floats:
    """
    Return an array of a constant size, not yet filled, for one call; compiled, on the stack.

    It ends with the function that makes it, also if that is inlined: do not return it.
    """
    return np.empty(count)
