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
Write the table of `test/conformance/README.md`: what each installed engine reaches.

    python benchmarks/conformance.py
"""

from pathlib import Path
import subprocess
import sys
import tempfile

from tables import header, row

FOLDER = Path(__file__).resolve().parents[1] / 'test' / 'conformance'
ENGINES = {'rigid_body_ros': 'run_rigid_body_ros', 'RK4': 'rk4', 'Drake, RK5': 'run_drake',
           'Basilisk, RK4': 'run_basilisk', 'MuJoCo, RK4': 'run_mujoco',
           'MuJoCo, discrete': 'run_mujoco --integrator discrete',
           'MuJoCo, implicitfast': 'run_mujoco --integrator implicitfast'}


def errors(command):
    """Return the attitude errors of an engine by motion, as text, or None if it is missing."""
    script, *options = command.split()
    with tempfile.TemporaryDirectory() as folder:
        results = Path(folder) / 'results'
        ran = subprocess.run(
            [sys.executable, FOLDER / 'adapters' / f'{script}.py', results, '--step', '0.01',
             *options], text=True, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, check=False)
        if ran.returncode:
            print(f'left out: {command}: {ran.stderr.splitlines()[-1]}')
            return None
        checked = subprocess.run([sys.executable, FOLDER / 'check.py', results], text=True,
                                 stdout=subprocess.PIPE, check=True)
    rows = [line.strip('| ').split(' | ') for line in checked.stdout.splitlines()[2:]]
    return {row[0]: row[1] for row in rows}


def main():
    """Run all engines, and write the table into the page."""
    found = {name: table for name, command in ENGINES.items() if (table := errors(command))}
    motions = next(iter(found.values()))
    lines = [*header('motion', *found),
             *(row(motion, *(table[motion] for table in found.values())) for motion in motions)]
    page = FOLDER / 'README.md'
    text, mark, _ = page.read_text().partition('default settings:\n\n')
    page.write_text(f'{text}{mark}' + '\n'.join(lines) + '\n')
    print('\n'.join(lines))


if __name__ == '__main__':
    main()
