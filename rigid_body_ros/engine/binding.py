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
Load the compiled kernels, or the Python sources from which they were compiled.

You can set the environment variable ``RIGID_BODY_ROS_KERNELS`` to a compiled processor level that
your processor supports. If you set the variable to ``python``, the Python sources run in place of
the compiled kernels. The Python sources compute exactly the same bits, but run hundreds of times
slower.
"""

from __future__ import annotations

from collections.abc import Callable
import os
from typing import Any, TypeVar

from rigid_body_ros.common.errors import InputError
from rigid_body_ros.kernels import lanes
from rigid_body_ros.kernels.sources import files_hash, sources_hash

Kernel = TypeVar('Kernel', bound=Callable[..., Any])

_VARIABLE = 'RIGID_BODY_ROS_KERNELS'
_BUILD = 'in the folder of its source, run pip install . or colcon build'


class KernelsError(InputError, ImportError):
    """Raised if the compiled kernels cannot be used; commands report this error in one line."""


def _loaded() -> tuple[dict[str, Any], str, int, str]:
    # Return the compiled kernels by name, their level, the number of lanes at that level, and the
    # hash of the sources from which they were compiled.
    choice = os.environ.get(_VARIABLE, '')
    if choice == 'python':
        return {}, choice, lanes.LANES, ''
    try:
        import rigid_body_ros.engine._compiled as _compiled
    except ImportError as error:
        raise KernelsError(f'the kernels of rigid_body_ros are not compiled: {_BUILD} ({error})') \
            from None
    if files_hash() != _compiled.FILES and sources_hash() != _compiled.SOURCES:
        raise KernelsError('the kernels of rigid_body_ros have changed since they were compiled: '
                           f'{_BUILD}, or set {_VARIABLE}=python')
    levels = _compiled.LEVELS
    if not levels:
        raise KernelsError('the kernels of rigid_body_ros are compiled for other processors, '
                           f"{' or '.join(_compiled.LANES)}: {_BUILD}")
    if choice and choice not in levels:
        raise KernelsError(f"{_VARIABLE}: expected python or {' or '.join(levels)}, "
                           f'found {choice!r}')
    level = choice or levels[0]
    return _compiled.kernels(level), level, _compiled.LANES[level], _compiled.SOURCES


#: LANES is the number of bodies that `run_each` steps at once.
_KERNELS, LEVEL, LANES, _HASH = _loaded()


def kernels_hash() -> str:
    """Return a hash of the kernel sources that ignores comments and docstrings."""
    return _HASH or sources_hash()


def bind(source: Kernel) -> Kernel:
    """Return the compiled kernel for `source`, or `source` itself if Python sources are used."""
    return _KERNELS[source.__name__] if _KERNELS else source
