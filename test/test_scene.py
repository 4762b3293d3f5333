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

"""Scene files are read as ROS reads them, or rejected with one helpful line."""

from conftest import CONFIG
import numpy as np
import pytest
from rigid_body_ros import scene, State
from rigid_body_ros.commands import main
from rigid_body_ros.scene import InputError, Scene
from rigid_body_ros.scene.parts import at_start

INERTIA = {'inertia.ixx': 1.0, 'inertia.iyy': 2.0, 'inertia.izz': 2.5}


def load(tmp_path, text):
    path = tmp_path / 'scene.yaml'
    path.write_text(text)
    return scene.load(path)


def parameters(body):
    return '/**:\n  ros__parameters:\n    inertia: {ixx: 1.0, iyy: 2.0, izz: 2.5}\n' + body


@pytest.mark.parametrize(('text', 'value'), [
    ('1', 1.0), ('1.5E2', 150.0), ('.5', 0.5), ('+3.', 3.0), ('0x10', 16.0), ('010', 8.0),
    ('0' * 4999 + '1', 1.0), ('99999999999999999999e-19', 9.9999999999999999999)])
def test_numbers_are_read_as_rcl_reads_them(tmp_path, text, value):
    found = load(tmp_path, parameters(f'    torque_timeout: {text}'))
    assert found.values['torque_timeout'] == value
    assert isinstance(found.values['torque_timeout'], float)


@pytest.mark.parametrize('text', ['1_0', '0b11', '0o17', '١', '1,5', '1e', '.'])
def test_text_that_rcl_does_not_read_as_a_number_is_rejected(tmp_path, text):
    with pytest.raises(InputError, match='torque_timeout: expected a number'):
        load(tmp_path, parameters(f'    torque_timeout: {text}'))


def test_a_node_in_a_namespace_is_found(tmp_path):
    lines = ['robot:', '  attitude_node:',
             *('  ' + line for line in parameters('').splitlines()[1:])]
    assert load(tmp_path, '\n'.join(lines)).values['inertia.izz'] == 2.5


def test_nested_and_dotted_names_are_the_same(tmp_path):
    found = load(tmp_path, parameters(
        '    initial_attitude.w: 0\n    initial_attitude: {x: 1}\n'
        '    start_time: 1767225600123456789\n    initial_angular_velocity:\n      z: 0.5'))
    assert found.start.time_ns == 1767225600123456789
    assert found.start.attitude.tolist() == [1.0, 0.0, 0.0, 0.0]
    assert found.start.angular_velocity.tolist() == [0.0, 0.0, 0.5]


def test_damping_rotors_and_sources_are_read(tmp_path):
    found = load(tmp_path, parameters(
        '    damping: {dxx: 0.1, dyy: 0.2, dzz: 0.3, dxy: 0.01, dxz: -0.02, dyz: 0.03}\n'
        '    initial_rotor_momentum: {z: -0.5}\n'
        '    torque_topics: [control, /thrusters/torque]\n    wheels: true'))
    assert found.body.damping.tolist() == [[0.1, 0.01, -0.02], [0.01, 0.2, 0.03],
                                           [-0.02, 0.03, 0.3]]
    assert found.start.rotor_momentum.tolist() == [0.0, 0.0, -0.5]
    assert found.torque_topics == ('control', '/thrusters/torque')
    assert found.wheels
    plain = load(tmp_path, parameters(''))
    assert (plain.torque_topics, plain.wheels, plain.body.is_damped) == (('torque',), False, False)
    assert not plain.start.rotor_momentum.any()


def test_fields_are_read_by_name(tmp_path):
    found = load(tmp_path, parameters(
        '    fields: [magnet, pivot]\n    pivot: {moment: {z: -0.2}, field.z: -9.81}\n'
        '    magnet:\n      moment: {x: 0.1, y: -1}\n      field: {y: 3e-5}'))
    magnet, pivot = found.fields
    assert magnet.moment.tolist() == [0.1, -1.0, 0.0]
    assert magnet.field.tolist() == [0.0, 3e-5, 0.0]
    assert pivot.moment.tolist() == [0.0, 0.0, -0.2]
    assert pivot.field.tolist() == [0.0, 0.0, -9.81]
    for empty in (None, []):  # None: an empty list, as rclpy has it
        assert not Scene.from_values({**INERTIA, 'fields': empty}).fields


ORBIT = {'orbit.mean_motion': 1.1e-3, 'orbit.position.x': 0.0, 'orbit.position.y': 0.6,
         'orbit.position.z': 0.8, 'orbit.normal.x': -1.0, 'orbit.normal.z': 0.0}


def test_a_later_epoch_has_the_position_since_start_time_with_the_bits_of_its_dump():
    begin_ns, quarter_ns = 10 ** 9, round(0.5 * np.pi / 1.1e-3 * 1e9)
    first, = Scene.from_values({**INERTIA, **ORBIT}).problem(State(begin_ns)).fields
    np.testing.assert_allclose(first.position, [0.0, 0.6, 0.8], rtol=1e-15)
    run = Scene.from_values({**INERTIA, **ORBIT, 'start_time': begin_ns})
    epoch = State(begin_ns + quarter_ns)
    orbit, = run.problem(epoch).fields
    np.testing.assert_allclose(orbit.position, [0.0, 0.8, -0.6], rtol=0, atol=1e-12)
    dumped = {**run.values, **at_start(run.values, epoch.time_ns), 'start_time': epoch.time_ns}
    again, = Scene.from_values(dumped).problem(epoch).fields
    assert again.time_ns == orbit.time_ns == epoch.time_ns
    np.testing.assert_array_equal(again.position, orbit.position)
    np.testing.assert_array_equal(again.along, orbit.along)


def test_a_group_that_stands_twice_is_merged_as_by_rcl(tmp_path):
    found = load(tmp_path, parameters('    inertia: {ixy: 0.25}'))
    assert found.body.inertia[0].tolist() == [1.0, 0.25, 0.0]


@pytest.mark.parametrize(('text', 'message'), [
    ('    tolerance: 1e-6\n    mode: lockstep\n    tolerance: 1e-6', 'tolerance: {} 4 .* 6'),
    ('    inertia: {izz: 2.25}', 'inertia.izz: {} 3 .* 4'),
    ('    inertia.izz: 2.25', 'inertia.izz: {} 3 .* 4'),
    ('    torque_topics:\n    - a\n    torque_topics: [b]', 'torque_topics: {} 4 .* 6'),
    ('"**":\n  ros__parameters: {inertia.izz: 2.25}', 'inertia.izz: {} 3 .* 5')])
def test_a_parameter_that_is_given_twice_is_rejected_with_its_lines(tmp_path, text, message):
    message = message.format('expected each parameter once, found it in line')
    with pytest.raises(InputError, match=f'scene.yaml: {message}$'):
        load(tmp_path, parameters(text))


def test_parameters_of_the_node_come_on_top_of_those_for_all(tmp_path):
    found = load(tmp_path, 'attitude_node:\n  ros__parameters: {tolerance: 1e-6}\n'
                 + parameters('    tolerance: 1e-3\n    body_frame: "1"\n')
                 + '/camera:\n  ros__parameters: {gain: 3, gain: 3}\n')
    assert found.values['tolerance'] == 1e-6
    assert found.values['body_frame'] == '1'  # quoted text stays text


def test_a_dump_of_a_renamed_node_is_taken_alone(tmp_path):
    text = parameters('    use_sim_time: true\n    start_type_description_service: true\n'
                      '    qos_overrides: {/torque: {subscription: {depth: 5}}}')
    found = load(tmp_path, text.replace('/**', '/robot/plant'))
    assert found.values['inertia.izz'] == 2.5
    assert found.warnings == [
        'expected parameters of /** or attitude_node, found those of robot/plant only, which a '
        'node of that name alone receives']


@pytest.mark.parametrize('name', ['/**', '/robot/**', '/*', 'attitude_node', '/a/attitude_node'])
def test_parameters_that_the_node_receives_give_no_warning(tmp_path, name):
    assert load(tmp_path, parameters('').replace('/**', name)).warnings == []


def test_a_file_of_another_node_is_an_error_that_names_both(tmp_path):
    with pytest.raises(InputError, match=r'inertia.ixx: expected .*; expected parameters of /\*\* '
                                         'or attitude_node, found those of camera only'):
        load(tmp_path, 'camera:\n  ros__parameters: {gain: 1}')


@pytest.mark.parametrize('name', ['cubesat', 'gimbal', 'iss', 'robot_stack', 'top',
                                  'tumbler'])
def test_the_scenes_of_the_package_load(name):
    symmetry = 'symmetric top' if name == 'top' else 'asymmetric top'
    assert scene.load(CONFIG / f'{name}.yaml').body.symmetry == symmetry


def test_the_scene_to_copy_has_what_a_robot_needs():
    found = scene.load(CONFIG / 'robot_stack.yaml')
    assert found.euler_sequence == 'xyz'
    assert all(found.values[name] > 0.0 for name in (
        'torque_timeout', 'stale_after', 'imu.gyro_noise_density', 'imu.gyro_random_walk',
        'imu.attitude_noise', 'imu.delay', 'odometry.attitude_variance',
        'odometry.rate_variance'))
    assert found.warnings == []


def test_a_scene_is_printed_with_units(tmp_path):
    body = 'RigidBody(asymmetric top, principal moments (1, 2, 2.5) kg m^2)'
    start = 'State(time 0 ns, attitude xyzw (0, 0, 0, 1), angular velocity (0, 0, 0) rad/s)'
    text = f"{body}, {start}, solver 'auto')"
    assert repr(load(tmp_path, parameters(''))) == f'Scene(scene.yaml: {text}'
    assert repr(Scene.from_values(INERTIA)) == f'Scene(no file: {text}'


@pytest.mark.parametrize(('change', 'message'), [
    ({'inertia.ixx': '1.0'}, r"inertia.ixx: expected a number \(kg m\^2\), found '1.0'; remove "
                             'the quotes'),
    ({'inertia': [1.0, 2.0]}, r'inertia: expected a group of ixx, iyy, .*iyz, found \[1.0, 2.0\]'),
    ({'inertia.ixx': -1.0}, r'inertia.ixx: expected a finite number greater than 0 .*found -1.0'),
    ({'inertia.ixy': float('nan')}, 'inertia.ixy: expected a finite number .*found nan'),
    ({'inertia.izz': 4.0}, 'moments 1, 2, 4 kg m.*sum of the other two'),
    ({'inertia.ixz_': 3.0}, 'inertia.ixz_: unknown key; did you mean inertia.ixz?'),
    ({'inertia.mass': 3.0}, 'inertia.mass: unknown key; expected a member of inertia: ixx, iyy, '),
    ({'initial_attitude.w': 0.0}, 'attitude quaternion .*expected a non-zero'),
    ({'start_time': 0.5}, r'start_time: expected an integer \(ns\), found 0.5'),
    ({'solver': 'rk4'}, "max_step: solver 'rk4' requires a step length, .*found none"),
    ({'tolerance': 0.0}, 'tolerance: expected 1e-15 to 1, found 0.0'),
    ({'interpolation': 'spline'}, 'interpolation: expected one of hold, linear, cubic'),
    ({'euler_sequence': 'ZZX'}, "Euler sequence: .*found 'ZZX'"),
    ({'publish_rate': 0}, r'publish_rate: expected 0.001 to 2000 \(Hz\), found 0.0'),
    ({'body_frame': 'a\n'}, r"body_frame: expected text without control .*, found 'a\\n'"),
    ({'checkpoint': '\0'}, r"checkpoint: expected text without control characters, found '\\x00'"),
    ({'damping.dxx': -1e-3}, 'damping.dxx: expected a finite number not less than 0'),
    ({'damping.dxx': 1.0, 'damping.dyy': 1.0, 'damping.dxy': 2.0},
     'damping.dxx .* damping.dyz: expected a tensor without negative eigenvalues, .* -1 N m s'),
    ({'solver': 'strang', 'max_step': 0.1, 'initial_rotor_momentum.x': 1.0},
     "solver 'strang' .* rotors"),
    ({'wheels': 1}, 'wheels: expected true or false, found 1'),
    ({'torque_topics': []}, 'torque_topics: expected at least one topic, found an empty list'),
    ({'torque_topics': ['a', 'b', 'a']}, "torque_topics: expected each topic once, found 'a' "
                                         'twice'),
    ({'torque_topics': ['a', 3]}, r'torque_topics: expected names of topics \(.*\), found 3'),
    ({'frame_prefix': 'one/', 'space_frame': 'one/base_link'}, 'expected different names'),
    ({'fields': ['a.b']}, "fields: expected names of letters, digits and _, found 'a.b'"),
    ({'fields': ['orbit']}, 'fields: expected a name with which no other .* begins, found .orbit'),
    ({'fields': ['pivot'], 'pivto.moment.z': 1.0},
     'pivto.moment.z: unknown key; did you mean pivot.moment.z?'),
    ({'fields': ['pivot'], 'pivot.mass': 1.0},
     'pivot.mass: unknown key; expected a member of pivot: moment.x, '),
    ({'fields': ['magnet'], 'pivot.moment.z': 1.0},
     "pivot.moment.z: expected 'pivot' among the names in fields, found magnet"),
    ({'fields': ['pivot'], 'pivot.field.z': -9.81},
     'pivot.moment: expected pivot.moment.x, .y or .z other than 0, found zeros'),
    ({'fields': ['pivot'], 'pivot.moment.z': 0.2}, 'pivot.field: expected .* found zeros'),
    ({'orbit.mean_motion': 1e-3, 'orbit.position.z': 1.0},
     'orbit: position and normal: expected directions at right angles'),
    ({'orbit.mean_motion': 1e-3, 'orbit.position.x': 0.0},
     'orbit: position: expected a direction, found zeros'),
    ({'orbit.mean_motion': 1e-3, 'checkpoint': 'state.json'},
     'start_time: expected the time of orbit.position, ns, because a checkpoint does not keep it'),
    ({'max_future': 2.0}, r'max_future: expected less than history \(1.0 s\), found 2.0 s')])
def test_invalid_values_are_rejected_with_name_and_value(change, message):
    with pytest.raises(InputError, match=message):
        Scene.from_values({**INERTIA, **change})


@pytest.mark.parametrize(('given', 'warning'), [
    ({'initial_angular_velocity.x': 90.0}, 'initial_angular_velocity: 90 rad/s is 14.3 turns '
     'per second; if the numbers are degrees per second, multiply them by pi / 180 = 0.0174533'),
    ({'initial_attitude.x': 30.0, 'initial_attitude.y': 40.0}, 'initial_attitude: expected a '
     'quaternion x y z w of norm 1, found norm 50; it is normalised; are the numbers angles?'),
    ({'inertia.izz': 3.03}, 'inertia: the largest principal moment exceeds the sum of the other '
     'two by 1 %, which no body can have; are the numbers rounded?')])
def test_a_value_that_is_probably_a_mistake_gives_a_warning(given, warning):
    assert Scene.from_values({**INERTIA, **given}).warnings == [warning]
    assert Scene.from_values({
        **INERTIA, 'initial_angular_velocity.z': 90.0, 'plausible_speed': 90.0,
        # Three digits, as people write.
        'initial_attitude.x': 0.707, 'initial_attitude.w': 0.707}).warnings == []


@pytest.mark.parametrize(('text', 'message'), [
    ('', r'the file: expected keys and values .*, found nothing'),
    ('a: [', 'expected YAML'),
    ('inertia: {ixx: 1.0}', r'inertia: expected /\*\*: and ros__parameters: above the '
     'parameters of a node, found ixx: 1.0'),
    ('/a/attitude_node:\n  ros__parameters: {}\n/b/attitude_node:\n  ros__parameters: {}',
     'expected .* for one attitude_node, found .* for a/attitude_node, b/attitude_node'),
    ('/**: {ros__parameters: {inertia: &a {ixx: 1.0}, other: *a}}',
     'expected YAML without aliases'),
    (parameters('    <<: {izz: 3.0}\n'), r'expected YAML without .* merge keys \(<<\), which ROS '
     'parameter files do not have, found one in line 4'),
    ('/**:\n  ? [1]\n  : 2', r'\*\*: expected names as keys, found a list as a key in line 2'),
    ('/**: 3', r"\*\*: expected keys and values .*, found '3'"),
    ('/**: {ros__parameters: 3}', 'ros__parameters: expected keys and values')])
def test_a_file_that_is_not_a_scene_is_rejected_by_name(tmp_path, text, message):
    with pytest.raises(InputError, match=f'scene.yaml: {message}'):
        load(tmp_path, text)


# Files that several nodes share

#: Names of parameters in common stacks.
FOREIGN = (
    'rate', 'update_rate', 'controller.kp', 'publish_frequency', 'model', 'steps', 'base_frame',
    'world_frame', 'max_speed', 'xy_goal_tolerance', 'initial_altitude', 'stop_time',
    'use_tf_static', 'node', 'body.inertia.ixx')
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


def test_keys_of_other_nodes_are_ignored_and_noted():
    for name in FOREIGN:
        found = Scene.from_values({**INERTIA, name: 3})
        assert found.values == Scene.from_values(INERTIA).values
        assert found.ignored == (name,)
        assert found.notes == [f'parameters that are not those of a scene are ignored: {name}']
    given = {**INERTIA, 'use_sim_time': True, 'qos_overrides./torque.subscription.depth': 5}
    assert Scene.from_values(given).notes == []


@pytest.mark.parametrize(('name', 'meant'), [
    ('torque_timout', 'torque_timeout'), ('Inertia.ixx', 'inertia.ixx'),
    ('inital_attitude.x', 'initial_attitude.x'), ('inertia_ixx', 'inertia.ixx'),
    ('inertai.ixx', 'inertia.ixx'), ('histroy', 'history'), ('publishRate', 'publish_rate'),
    ('publish-rate', 'publish_rate'), ('solvers', 'solver'), ('use_sim_tme', 'use_sim_time'),
    ('feilds', 'fields')])
def test_a_misspelt_key_is_an_error_that_names_the_key(name, meant):
    with pytest.raises(InputError) as caught:
        Scene.from_values({**INERTIA, name: 3})
    assert str(caught.value) == f'{name}: unknown key; did you mean {meant}?'


@pytest.mark.parametrize('section', ['/**', '/attitude_node'])
def test_a_misspelt_key_is_an_error_in_every_section(tmp_path, section):
    with pytest.raises(InputError, match='max_futur: unknown key; did you mean max_future'):
        load(tmp_path, f'{SHARED}{section}:\n  ros__parameters: {{max_futur: 0.1}}\n')


@pytest.mark.slow
def test_a_command_notes_keys_of_other_nodes_once(tmp_path, capsys):
    path, recording = tmp_path / 'shared.yaml', tmp_path / 'torques.csv'
    path.write_text(SHARED)
    recording.write_text('0.0,0.1,0.0,0.0\n0.1,0.0,0.0,0.0\n')
    assert main.attitude_replay([str(recording), '--scene', str(path)]) == 0
    assert capsys.readouterr().err == (
        f'attitude_replay: note: {path}: parameters that are not those of a scene are '
        'ignored: rate, plugins, controller.kp, controller.gains, frame_id\n')
    path.write_text(SHARED.replace('frame_id', 'body_frames'))
    assert main.attitude_replay([str(recording), '--scene', str(path)]) == 2
    assert capsys.readouterr().err == (
        f'attitude_replay: error: {path}: body_frames: unknown key; did you mean body_frame?\n')
