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

"""Import the kernels so that their marks compile: with the modules of this folder in place."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
import pkgutil
import sys
from types import ModuleType
from typing import Any

PACKAGE = Path(__file__).resolve().parents[1] / 'rigid_body_ros'


def exported() -> list[Any]:
    """Return all kernels that Python calls, as numba's dispatchers."""
    # The package itself would import what needs its compiled kernels.
    package = sys.modules['rigid_body_ros'] = ModuleType('rigid_body_ros')
    package.__path__ = [str(PACKAGE)]
    for name in ('jit', 'lanes', 'four'):
        sys.modules[f'rigid_body_ros.kernels.{name}'] = import_module(name)
    for found in pkgutil.iter_modules([str(PACKAGE / 'kernels')], 'rigid_body_ros.kernels.'):
        import_module(found.name)
    return import_module('jit').EXPORTED
