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

"""Parameter files that several nodes share: keys of other nodes, and misspelt keys."""

from conftest import at_night
import pytest
from rigid_body_ros import scene
from rigid_body_ros.commands import main
from rigid_body_ros.scene import InputError, Scene

INERTIA = {'inertia.ixx': 1.0, 'inertia.iyy': 2.0, 'inertia.izz': 2.5}
#: Names of parameters in common stacks.
FOREIGN = (
    'rate', 'frame_id', 'update_rate', 'controller.kp', 'publish_frequency', 'publish_cloud',
    'model', 'node', 'steps', 'links', 'base_frame', 'odom_frame', 'map_frame', 'world_frame',
    'mass', 'gravity', 'max_speed', 'xy_goal_tolerance', 'initial_altitude', 'stop_time',
    'diagnostic_updater.use_fqn', 'use_tf_static', 'tf_prefix', 'body.inertia.ixx')
SHARED = """\
/**:
  ros__parameters:
    use_sim_time: false
    rate: 50.0
    plugins: []
    qos_overrides: {/scan: {subscription: {reliability: best_effort}}}
    controller: {kp: 2.0, gains: [1.0, 2.0]}
/camera:
  ros__parameters: {torque_timout: 1.0}
/attitude_node:
  ros__parameters:
    frame_id: imu
    inertia: {ixx: 1.0, iyy: 2.0, izz: 2.5}
"""


@pytest.mark.parametrize('name', FOREIGN)
def test_a_key_of_another_node_is_ignored_and_noted(name):
    found = Scene.from_values({**INERTIA, name: 3})
    assert found.values == Scene.from_values(INERTIA).values
    assert found.ignored == (name,)
    assert found.notes == [f'parameters that are not those of a scene are ignored: {name}']


@pytest.mark.parametrize(('name', 'meant'), [
    ('torque_timout', 'torque_timeout'), ('Inertia.ixx', 'inertia.ixx'),
    ('inertia.Ixx', 'inertia.ixx'), ('inital_attitude.x', 'initial_attitude.x'),
    ('inertia_ixx', 'inertia.ixx'), ('inertai.ixx', 'inertia.ixx'), ('tolerence', 'tolerance'),
    ('histroy', 'history'), ('publishRate', 'publish_rate'), ('publish-rate', 'publish_rate'),
    ('Mode', 'mode'), ('solvers', 'solver'), ('torque_topic', 'torque_topics'),
    ('robot_descripton', 'robot_description'), ('use_sim_tme', 'use_sim_time')])
def test_a_misspelt_key_is_an_error_that_names_the_key(name, meant):
    with pytest.raises(InputError) as caught:
        Scene.from_values({**INERTIA, name: 3})
    assert str(caught.value) == f'{name}: unknown key; did you mean {meant}?'


def test_without_keys_of_other_nodes_there_is_no_note():
    given = {**INERTIA, 'use_sim_time': True, 'qos_overrides./torque.subscription.depth': 5}
    assert Scene.from_values(given).notes == []


@pytest.mark.parametrize('section', ['/**', '/attitude_node'])
def test_a_misspelt_key_is_an_error_in_every_section(tmp_path, section):
    path = tmp_path / 'shared.yaml'
    path.write_text(f'{SHARED}{section}:\n  ros__parameters: {{max_futur: 0.1}}\n')
    with pytest.raises(InputError, match='max_futur: unknown key; did you mean max_future'):
        scene.load(path)


@pytest.mark.slow
@pytest.mark.parametrize('command', ['replay', *at_night('tradeoff')])
def test_every_command_notes_keys_of_other_nodes_once(tmp_path, capsys, command):
    path, recording = tmp_path / 'shared.yaml', tmp_path / 'torques.csv'
    path.write_text(SHARED)
    recording.write_text('time,tx,ty,tz\n0.0,0.1,0.0,0.0\n0.1,0.0,0.0,0.0\n')
    run = {'replay': lambda: main.attitude_replay([str(recording), '--scene', str(path)]),
           'tradeoff': lambda: main.attitude_tradeoff(['--recording', str(recording), '--scene',
                                                      str(path), '--target', '0.1'])}[command]
    assert run() == 0
    assert capsys.readouterr().err == (
        f'attitude_{command}: note: {path}: parameters that are not those of a scene are '
        'ignored: rate, plugins, controller.kp, controller.gains, frame_id\n')
    path.write_text(SHARED.replace('frame_id', 'body_frames'))
    assert run() == 2
    assert capsys.readouterr().err == (
        f'attitude_{command}: error: {path}: body_frames: unknown key; did you mean body_frame?\n')
