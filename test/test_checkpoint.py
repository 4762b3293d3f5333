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

"""The file of a checkpoint returns the same bits, or one line with the reason why not."""

from dataclasses import replace
import os

from conftest import CONFIG, files_up_to
import numpy as np
import pytest
from rigid_body_ros import scene, State
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.live.checkpoint import Checkpoint

SCENE, NODE = scene.load(CONFIG / 'tumbler.yaml'), '/attitude_node'
STATE = State(1_767_225_600_123_456_789, (0.1, -0.2, 0.3, 0.9), (1e-300, -0.0, 1 / 3),
              (0.0, 5e-324, 7.0))


@pytest.fixture
def file(tmp_path):
    """Return a checkpoint file with a state."""
    path = tmp_path / 'checkpoint.json'
    Checkpoint(str(path), SCENE, NODE).save_last(STATE)
    return path


def test_a_state_comes_back_with_all_its_bits(file):
    found = Checkpoint(str(file), SCENE, NODE).start
    assert found.time_ns == STATE.time_ns
    for name in ('attitude', 'angular_velocity', 'rotor_momentum'):
        assert getattr(found, name).tobytes() == getattr(STATE, name).tobytes()


def test_no_file_is_no_state_in_a_folder_that_can_be_written(tmp_path):
    assert Checkpoint(str(tmp_path / 'none'), SCENE, NODE).start is None
    assert not [*tmp_path.iterdir()]
    with pytest.raises(InputError, match='cannot write: No such file'):
        Checkpoint(str(tmp_path / 'none' / 'file'), SCENE, NODE)


@pytest.mark.slow
def test_a_file_that_is_cut_or_harmed_anywhere_is_an_error_and_stays(file):
    whole, random = file.read_bytes(), np.random.default_rng(5)
    for place in range(0, len(whole), 7):
        harmed = bytearray(whole)
        harmed[place] ^= 1 << int(random.integers(8))
        for data, message in ((whole[:place], 'expected a checkpoint that a'), (harmed, '')):
            file.write_bytes(data)
            with pytest.raises(InputError, match=f'checkpoint {file}: {message}'):
                Checkpoint(str(file), SCENE, NODE)
            assert file.read_bytes() == data


def changed(**values):
    return scene.Scene.from_values({**SCENE.values, **{
        name.replace('__', '.'): value for name, value in values.items()}})


@pytest.mark.parametrize(('values', 'node', 'found'), [
    ({'inertia__ixx': 0.05}, NODE, 'with another inertia.ixx: 0.045 there, 0.05 here'),
    ({'initial_angular_velocity__x': 1.0}, NODE,
     'with another initial_angular_velocity.x: 0.15 there, 1.0 here'),
    ({'torque_timeout': 0.5}, NODE, 'with another torque_timeout: 0.0 there, 0.5 here'),
    ({}, '/two/attitude_node', "with another node: '/attitude_node' there, '/two/attitude_node'")])
def test_a_checkpoint_of_another_scene_is_an_error_and_stays(file, values, node, found):
    before = file.read_bytes()
    with pytest.raises(InputError, match=f'checkpoint {file}: expected a checkpoint of this node '
                       f'and scene, found one {found}'):
        Checkpoint(str(file), changed(**values), node)
    assert file.read_bytes() == before


def test_what_does_not_change_the_motion_may_change(file):
    other = changed(publish_rate=20.0, euler_sequence='XYZ', stale_after=0.0, mode='lockstep',
                    **{'imu.seed': 3, 'odometry.rate_variance': 1e-6,
                       'monitor.measured': ['/imu'], 'monitor.rate_noise': 1e-3})
    assert Checkpoint(str(file), other, NODE).start is not None


def test_a_file_that_another_program_has_changed_stays(file):
    checkpoint = Checkpoint(str(file), SCENE, NODE)
    file.write_text('mine')
    with pytest.raises(InputError, match='another program has changed the file'):
        checkpoint.save_last(replace(STATE, time_ns=5))
    assert file.read_text() == 'mine'


def test_a_full_disk_keeps_the_last_state_and_a_later_write_succeeds(file):
    checkpoint, before = Checkpoint(str(file), SCENE, NODE), file.read_bytes()
    later = replace(STATE, time_ns=STATE.time_ns + 5)
    with files_up_to(100), pytest.raises(InputError, match='cannot write: File too large'):
        checkpoint.save_last(later)
    assert file.read_bytes() == before
    assert os.listdir(file.parent) == [file.name]
    checkpoint.save_last(later)
    assert Checkpoint(str(file), SCENE, NODE).start.time_ns == later.time_ns
