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


@dataclass(frozen=True)
class Level:
    """A processor level."""

    #: As `platform.machine` names it.
    machine: str
    #: Its name in LLVM, and the end of the names of its code.
    processor: str
    suffix: str
    #: Bodies in a step, see `rigid_body_ros.kernels.lanes`. No result depends on it.
    lanes: int
    #: If it has code of its own only where that pays, see `generate.py`: the level of the rest.
    rest: str = ''

    @property
    def triple(self) -> str:
        """Return its triple in LLVM."""
        return f'{self.machine}-unknown-linux-gnu'


#: All levels by name; of those that a processor has, the first is the best.
LEVELS = {'x86-64-v4': Level('x86_64', 'x86-64-v4', '_v4', 8, 'x86-64-v3'),
          'x86-64-v3': Level('x86_64', 'x86-64-v3', '_v3', 4),
          'x86-64-v2': Level('x86_64', 'x86-64-v2', '_v2', 4),
          'aarch64': Level('aarch64', 'generic', '', 4)}
#: Names of the levels of each kind of machine.
MACHINES = {machine: [name for name, level in LEVELS.items() if level.machine == machine]
            for machine in ('x86_64', 'aarch64')}
