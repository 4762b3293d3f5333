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

"""Rerun accepts the recordings of this package, and the example shows a motion in Rerun."""

import importlib.util
import os
import shutil
import subprocess
import sys

from conftest import CONFIG, RECORDINGS, ROOT
import pytest
from rigid_body_ros.commands import main

TORQUES, SCENE = str(RECORDINGS / 'tumbler.mcap'), CONFIG / 'tumbler.yaml'
ALSO = ['--also', 'imu', 'tf', 'markers', 'input']
RERUN = shutil.which('rerun', path=os.pathsep.join([os.path.dirname(sys.executable),
                                                    os.environ.get('PATH', '')]))
pytestmark = [pytest.mark.slow, pytest.mark.skipif(
    RERUN is None or importlib.util.find_spec('rerun') is None,
    reason='rerun is not installed: pip install rerun-sdk')]


@pytest.fixture(scope='module')
def with_rotors(tmp_path_factory):
    """Return a scene with rotors, and the motion under the torques."""
    folder = tmp_path_factory.mktemp('rotors')
    scene, motion = folder / 'rotors.yaml', folder / 'rotors.mcap'
    rotors = '    initial_rotor_momentum: {x: 0.01, y: 0.0, z: 0.02}\n'
    scene.write_text(SCENE.read_text() + rotors)
    assert main.attitude_replay([TORQUES, '--scene', str(scene), '-o', str(motion), *ALSO]) == 0
    return scene, motion


@pytest.fixture(scope='module')
def plain(tmp_path_factory):
    motion = tmp_path_factory.mktemp('plain') / 'motion.mcap'
    assert main.attitude_replay([TORQUES, '--scene', str(SCENE), '-o', str(motion), *ALSO]) == 0
    return motion


def rerun(folder, *arguments):
    """Run Rerun without statistics, and without its own files elsewhere."""
    environment = {**os.environ, 'HOME': str(folder), 'PYTHONPATH': ''}
    disabled = subprocess.run([RERUN, 'analytics', 'disable'], env=environment,
                              capture_output=True, check=False)
    assert disabled.returncode == 0
    result = subprocess.run([RERUN, *map(str, arguments)], env=environment, capture_output=True,
                            text=True, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout


def rows_of_check(folder, path):
    """Return the columns of each row that `rerun mcap check` prints: status, ..., issues."""
    lines = rerun(folder, 'mcap', 'check', path).splitlines()
    header = next(row for row, line in enumerate(lines) if line.startswith('Status'))
    return [line.split() for line in lines[header + 2:] if line]


TOPICS = '/attitude', '/euler_angles', '/angular_velocity', '/tf', '/imu/data', '/marker/body', \
    '/torque'


@pytest.mark.parametrize(('name', 'topics'), [
    ('plain', TOPICS), ('rotors', (*TOPICS, '/rotor_momentum')), ('bag', TOPICS[:3]),
    ('residuals', ['/error/rotation_vector'])])
def test_rerun_finds_no_fault(plain, with_rotors, tmp_path, name, topics):
    path = {'plain': plain, 'rotors': with_rotors[1]}.get(name, tmp_path / f'{name}.mcap')
    if name == 'bag':
        bag = tmp_path / 'bag'
        assert main.attitude_replay([TORQUES, '--scene', str(SCENE), '-o', str(bag)]) == 0
        path, = bag.glob('*.mcap')
    elif name == 'residuals':
        assert main.attitude_compare([str(plain), '--scene', str(SCENE), '--measured',
                                     '/attitude', '-o', str(path)]) == 0
    rows = rows_of_check(tmp_path, path)
    assert {row[3] for row in rows} >= {*topics}
    assert all(row[0] == 'ok' and row[4] == '—' for row in rows)


def shown(folder, scene):
    """Return the entities in the file that the example writes, and their numbers of rows."""
    output = folder / 'shown.rrd'
    subprocess.run([sys.executable, ROOT / 'examples' / 'show_in_rerun.py', TORQUES, '--scene',
                    scene, '--save', output], check=True, timeout=120)
    rerun(folder, 'rrd', 'verify', output)
    rows = {}
    for line in rerun(folder, 'rrd', 'print', output).splitlines():
        if line.startswith('Chunk(') and ' rows ' in line:
            entity, count = line.split(' - ')[1], int(line.split(' with ')[1].split()[0])
            rows[entity] = rows.get(entity, 0) + count
    return rows


@pytest.mark.parametrize('has_rotors', [False, True], ids=['plain', 'rotors'])
def test_the_example_shows_every_sample(with_rotors, tmp_path, has_rotors):
    rows = shown(tmp_path, with_rotors[0] if has_rotors else SCENE)
    for entity in ('/space/body', '/space/angular_momentum', '/space/angular_velocity',
                   '/plots/euler_angles', '/plots/quaternion', '/plots/angular_velocity',
                   '/plots/angular_momentum'):
        assert rows[entity] >= 3001, entity


def test_the_example_replaces_no_file(plain, tmp_path):
    result = subprocess.run(
        [sys.executable, ROOT / 'examples' / 'show_in_rerun.py', plain, '--scene', SCENE,
         '--save', plain], capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert result.stderr.splitlines()[-1].endswith('motion.mcap: the file exists')
