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

"""Import the kernels as the translator reads them."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
import pkgutil
import sys
from types import ModuleType
from typing import Any

from translate import RUNTIME, Symbol

PACKAGE = Path(__file__).resolve().parents[1] / 'rigid_body_ros'


def load() -> tuple[list[ModuleType], list[Any]]:
    """Return the modules of the kernels, and all kernels that Python calls."""
    # The package itself would import what needs its compiled kernels.
    package = sys.modules['rigid_body_ros'] = ModuleType('rigid_body_ros')
    package.__path__ = [str(PACKAGE)]
    jit, lanes = (import_module(f'rigid_body_ros.kernels.{name}') for name in ('jit', 'lanes'))
    exported = []

    def njit(kernel: Any) -> Any:
        exported.append(kernel)
        return kernel
    jit.njit, jit.optional, lanes.LANES = njit, jit.inlined, Symbol('int64_t(LANES)')
    return [import_module(f'rigid_body_ros.kernels.{found.name}')
            for found in pkgutil.iter_modules([str(PACKAGE / 'kernels')])
            if found.name not in RUNTIME], exported
