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
The marks of kernels, for the build step that compiles them.

The build step replaces this module with a module that compiles the kernels. In this module, a mark
does nothing. The functions stay plain Python, which computes the same bits but is hundreds of
times slower.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from rigid_body_ros.common.arrays import Floats

#: In the annotation of an array, this mark means that the kernel writes to the array.
WRITTEN = 'written'

Kernel = TypeVar('Kernel', bound=Callable[..., Any])


def njit(kernel: Kernel) -> Kernel:
    """
    Mark a kernel that Python calls.

    The kernel is compiled once for each combination of types that its annotations allow. The
    annotation of an array contains the shape, as in ``Annotated[Floats, 'n 3']``, and WRITTEN if
    the kernel writes to it. A dimension is a number, a variable, or a linear function of a
    variable, such as '7m' or '2d+1'. A variable has the same value in all arguments. '|' separates
    alternatives, as in 'n|0'. L is the number of lanes; see `lanes`.
    """
    return kernel


def internal(kernel: Kernel) -> Kernel:
    """Mark a function that kernels call."""
    return kernel


def inlined(kernel: Kernel) -> Kernel:
    """
    Mark a function that is inlined into each kernel that calls it.

    A call that is not inlined passes tuples in memory. This takes as long as the arithmetic of a
    short step.
    """
    return kernel


def optional(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """
    Mark an inlined function for a part that is absent in some scenes.

    If the first argument is None, the function returns None. The compiler decides this by type, so
    the kernels for scenes without the part are compiled without its code.
    """
    def choose(first: Any, *rest: Any) -> Any:
        return None if first is None else kernel(first, *rest)
    return choose


def record(fields: list[tuple[Any, ...]]) -> Any:
    """Return a structured type whose fields a kernel reads as attributes."""
    return np.dtype((np.record, np.dtype(fields, align=True)))


def scratch(count: int) -> Floats:
    """
    Return an array of constant size, not yet filled, for use during one call.

    In compiled kernels the array is on the stack. The array is valid until the function that makes
    it ends, even if that function is inlined. So do not return the array.
    """
    return np.empty(count)
