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

"""The processor levels that the kernels are compiled for."""

from __future__ import annotations

from dataclasses import dataclass
import os
from pathlib import Path
import platform

from setuptools.errors import CompileError

#: Which levels are compiled: those of this processor, or 'all' for other machines, too.
VARIABLE = 'RIGID_BODY_ROS_LEVELS'
#: Builds of Debian and RPM packages set this variable. They must not depend on this processor.
_REPRODUCIBLE = 'SOURCE_DATE_EPOCH'


@dataclass(frozen=True)
class Level:
    """A processor level."""

    #: As `platform.machine` names it.
    machine: str
    #: Options of the compiler.
    options: tuple[str, ...]
    #: The end of the names of its code.
    suffix: str
    #: Bodies in a step, see `rigid_body_ros.kernels.lanes`. No result depends on it.
    lanes: int
    #: What the processor needs to have, as Linux names it.
    features: frozenset[str] = frozenset()
    #: If it has code of its own only where that pays, see `generate.py`: the level of the rest.
    rest: str = ''


_V3 = frozenset({'avx2', 'bmi1', 'bmi2', 'fma'})
_V4 = _V3 | {'avx512f', 'avx512vl', 'avx512dq', 'avx512bw', 'avx512cd'}
#: All levels by name; of those that a processor has, the first is the best.
LEVELS = {
    # Without the options, GCC uses only half of the registers.
    'x86-64-v4': Level('x86_64', ('-march=x86-64-v4', '-mtune=skylake-avx512',
                                  '-mprefer-vector-width=512'), '_v4', 8, _V4, 'x86-64-v3'),
    'x86-64-v3': Level('x86_64', ('-march=x86-64-v3',), '_v3', 4, _V3),
    'x86-64-v2': Level('x86_64', ('-march=x86-64-v2',), '_v2', 4),
    'aarch64': Level('aarch64', (), '_arm', 4)}
#: Names of the levels of each kind of machine.
MACHINES = {machine: [name for name, level in LEVELS.items() if level.machine == machine]
            for machine in ('x86_64', 'aarch64')}


def wanted(machine: str) -> list[str]:
    """Return the names of the levels to compile; a level needs the code of its `rest`."""
    names, chosen = MACHINES[machine], os.environ.get(VARIABLE, '')
    if chosen not in ('', 'all'):
        raise CompileError(f'{VARIABLE}: expected all, found {chosen!r}')
    if chosen or _REPRODUCIBLE in os.environ or machine != platform.machine():
        return names
    features = set(Path('/proc/cpuinfo').read_text(encoding='ascii').split())
    usable = [name for name in names if LEVELS[name].features <= features]
    best = LEVELS[usable[0]]
    return [name for name in usable if name in (usable[0], best.rest)]
