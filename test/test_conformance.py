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

"""The motions of the folder `conformance`: this package, and other engines where installed."""

from importlib.util import find_spec
import json
from pathlib import Path
import subprocess
import sys

import pytest

FOLDER = Path(__file__).parent / 'conformance'
MOTIONS = sorted((FOLDER / 'motions').glob('*.json'))
#: Adapters, the modules that they need, and the motions that RK4 with steps of 10 ms misses.
ENGINES = [('rk4', 'numpy'), ('run_mujoco', 'mujoco'), ('run_drake', 'pydrake'),
           ('run_basilisk', 'Basilisk')]
TOO_FAST = 'thin_rod'


def adapted(adapter, folder):
    """Return the folder of the results of an adapter."""
    subprocess.run([sys.executable, FOLDER / 'adapters' / f'{adapter}.py', folder / adapter,
                    '--step', '0.01'], check=True)
    return folder / adapter


def check(results, *options):
    """Run the checker on results."""
    return subprocess.run([sys.executable, FOLDER / 'check.py', results, *options], text=True,
                          capture_output=True, check=False)


@pytest.mark.parametrize('path', MOTIONS, ids=lambda path: path.stem)
def test_decimal_and_hexadecimal_inputs_are_the_same_doubles(path):
    motion = json.loads(path.read_text(), parse_float=lambda text: float(text).hex())
    assert motion['inputs'] == motion['inputs_in_hexadecimal']


@pytest.fixture(scope='module')
def results(tmp_path_factory):
    return adapted('run_rigid_body_ros', tmp_path_factory.mktemp('results'))


@pytest.mark.slow
def test_this_package_computes_all_motions_to_rounding(results):
    checked = check(results, '--within', '2e-13')
    assert checked.returncode == 0, checked.stdout
    rows = [line.split(' | ') for line in checked.stdout.splitlines()[2:]]
    assert len(rows) == len(MOTIONS)
    for name, angle, _, rounding in rows:
        # Besides the inputs, intermediate results are rounded, too.
        assert float(angle) <= 4.0 * float(rounding.strip(' |')) + 1e-15, name


@pytest.mark.slow
def test_the_checker_finds_a_wrong_attitude_and_a_missing_time(results, tmp_path):
    path = tmp_path / 'sphere.csv'
    lines = (results / 'sphere.csv').read_text().splitlines()
    time_ns, x, y, z, w, *rates = lines[4].split(',')
    turned = [float(x) + 5e-10 * float(w), float(y) + 5e-10 * float(z),
              float(z) - 5e-10 * float(y), float(w) - 5e-10 * float(x)]  # by 1e-9 rad about x
    path.write_text('\n'.join([*lines[:4], ','.join([time_ns, *map(repr, turned), *rates]),
                               *lines[5:]]))
    checked = check(tmp_path, '--within', '1e-10')
    assert checked.returncode == 1
    assert '| sphere | 1.0e-09 |' in checked.stdout
    path.write_text('\n'.join(lines[1:]))
    checked = check(tmp_path)
    assert checked.returncode == 2
    assert checked.stderr == (f'{path}: expected a line with the time {lines[0].split(",")[0]} '
                              'ns, found none\n')


@pytest.mark.nightly
@pytest.mark.parametrize(('adapter', 'module'), ENGINES)
def test_other_engines_compute_the_motions(adapter, module, tmp_path):
    if find_spec(module) is None:
        pytest.skip(f'{module} is not installed')
    results = adapted(adapter, tmp_path)
    (results / f'{TOO_FAST}.csv').unlink()
    checked = check(results, '--within', '2e-6')
    assert checked.returncode == 0, checked.stdout
    assert sum(' | - | ' not in line for line in checked.stdout.splitlines()[2:]) >= 8
