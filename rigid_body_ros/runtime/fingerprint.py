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

"""Software versions that determine the last bits of a motion for a given scene and torques."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
import platform

from rigid_body_ros.engine import COMPILES

NAME = 'rigid_body_ros'
#: Packages that compile the kernels.
_COMPILERS = ('numba', 'llvmlite')
#: Key in recordings of earlier versions, whose last bits also depended on the processor.
PROCESSOR = 'processor'


def fingerprint() -> dict[str, str]:
    """
    Return package versions by name; equal versions give equal bits on any processor.

    The version of a compiler that is not in use is 'none'.
    """
    found = {package: _version(package) for package in (NAME, 'numpy')}
    return {**found, **{package: _version(package) if COMPILES else 'none'
                        for package in _COMPILERS}}


def processor() -> str:
    """Return the processor name that earlier versions recorded under `PROCESSOR`."""
    try:
        from llvmlite import binding
    except ImportError:
        return platform.machine()
    return f'{platform.machine()} {binding.get_host_cpu_name()}'


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # run from the source folder
        return 'none'
