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

"""attitude_replay of scenes with several torque topics, wheels and damping."""

import json
from pathlib import Path
import re

from conftest import SECOND
import numpy as np
from pages import array, data_of
import pytest
from rigid_body_ros import messages, recording, scene, State, TorqueLog
from rigid_body_ros.commands import main
from rigid_body_ros.mechanics import so3
from rigid_body_ros.recording.gaps import computing_time
from rigid_body_ros.replay import replay
from rigid_body_ros.replay.check import drift

MS = 10 ** 6
STARTED = 1_700_000_000 * SECOND
#: Stamps of the two torques, of the torque on the wheels and of their momentum.
TIMES = {'/control': STARTED + 20 * MS * np.arange(100),
         '/disturbance': STARTED + 7 * MS + 33 * MS * np.arange(60),
         '/wheel_torque': STARTED + 50 * MS * np.arange(40),
         '/wheel_momentum': STARTED - 5 * MS + 100 * MS * np.arange(21)}
FRAMES = {'/disturbance': 'world'}
TWO = 'torque_topics: [control, disturbance]'
WHEELS = 'wheels: true'
DAMPING = 'damping: {dxx: 0.01, dyy: 0.02, dzz: 0.03, dxy: 0.001}'
FIELDS = 'fields: [pivot]'
PIVOT = [FIELDS, 'pivot: {moment: {x: 0.003, z: -0.02}, field: {z: -9.81}}']
ORBIT = 'orbit: {mean_motion: 0.4, position: {x: 0.0, y: 0.6, z: 0.8}, normal: {x: 1.0, z: 0.0}}'
ROTORS = 'initial_rotor_momentum: {x: 0.01, y: -0.02, z: 0.03}'


def values(topic):
    """Return the recorded vectors of a topic."""
    seed = list(TIMES).index(topic)
    return 0.01 * np.random.default_rng(seed).normal(size=(len(TIMES[topic]), 3))


def log(topic, interpolation='hold'):
    return TorqueLog(TIMES[topic], values(topic), 'space' if topic in FRAMES else 'body',
                     interpolation)


def write(path, topics, empty=(), **names):
    """Write topics to a recording, some of them empty, and some under another name."""
    with recording.Writer(path) as writer:
        for topic in topics:
            name = names.get(topic[1:], topic)
            momentum = topic == '/wheel_momentum'
            kind = messages.VECTOR3 if momentum else messages.WRENCH
            writer.add_topic(name, kind)
            for stamp_ns, vector in [] if topic in empty else zip(TIMES[topic], values(topic)):
                numbers = vector if momentum else [9.0, 9.0, 9.0, *vector]
                data = kind.encode(int(stamp_ns), FRAMES.get(topic, 'base_link'), numbers)
                writer.write(name, int(stamp_ns), data)
    return str(path)


@pytest.fixture
def recorded(tmp_path):
    return write(tmp_path / 'recorded.mcap', list(TIMES))


def expected(path, logs, wheels=None):
    """Return the motion that the library computes."""
    loaded = scene.load(path)
    begin = State(STARTED, loaded.start.attitude, loaded.start.angular_velocity,
                  loaded.start.rotor_momentum)
    stamps = [one.times_ns for one in (*logs, wheels) if one]
    return loaded.problem(begin).replaced(log=logs, wheels=wheels).propagate(
        at=np.unique(np.hstack(stamps)))


def check_written(path, motion):
    for topic, kind, frame, found in (
            ('/attitude', messages.QUATERNION, 'world', motion.attitude),
            ('/angular_velocity', messages.VECTOR3, 'base_link', motion.angular_velocity),
            ('/rotor_momentum', messages.VECTOR3, 'base_link', motion.rotor_momentum)):
        read = recording.read(path, topic, kind)
        np.testing.assert_array_equal(read.stamps_ns, motion.times_ns)
        np.testing.assert_array_equal(read.values, found)
        assert set(read.frame_ids) == {frame}


@pytest.mark.parametrize(('lines', 'interpolation', 'given'), [
    ((TWO, WHEELS, DAMPING, ROTORS), 'hold', []), ((TWO, WHEELS), 'linear', []),
    ((TWO, WHEELS, ROTORS, *PIVOT, ORBIT), 'linear', []),
    ((TWO, WHEELS, DAMPING), 'hold', ['--topic', '/disturbance', '--topic', '/control',
                                      '--wheel-torque', '/wheel_torque'])],
    ids=['all', 'wheels', 'fields', 'given topics replace those of the scene'])
def test_two_torques_and_wheels_give_the_motion_of_the_library(recorded, scene_with, tmp_path,
                                                               lines, interpolation, given):
    path, output = scene_with(*lines), tmp_path / 'motion.mcap'
    arguments = [recorded, '--scene', path, '--interpolation', interpolation, *given]
    assert main.attitude_replay([*arguments, '-o', str(output)]) == 0
    topics = ['/disturbance', '/control'] if given else ['/control', '/disturbance']
    check_written(output, expected(path, [log(topic, interpolation) for topic in topics],
                                   log('/wheel_torque', interpolation)))
    assert main.attitude_replay([*arguments, '--verify', str(output)]) == 0


@pytest.mark.parametrize('late_ns', [0, 100 * MS // 4])
def test_the_rotors_follow_their_measured_momentum(recorded, scene_with, tmp_path, late_ns):
    stamps, momenta = TIMES['/wheel_momentum'], values('/wheel_momentum')
    path, output = scene_with(WHEELS), tmp_path / 'motion.mcap'
    if late_ns:  # the start lies between two samples
        path = scene_with(WHEELS, f'start_time: {stamps[3] + late_ns}')
    assert main.attitude_replay([recorded, '--scene', path, '-o', str(output), '--topic',
                                '/control', '--wheel-momentum', '/wheel_momentum']) == 0
    read = recording.read(output, '/rotor_momentum', messages.VECTOR3)
    seconds = (read.stamps_ns - stamps[0]) * 1e-9
    for axis in range(3):
        measured = np.interp(seconds, (stamps - stamps[0]) * 1e-9, momenta[:, axis])
        np.testing.assert_allclose(read.values[:, axis], measured, rtol=0.0, atol=1e-16)
    if not late_ns:  # the motion begins at the earliest sample with the momentum of this sample
        assert read.stamps_ns[0] == stamps[0]
        np.testing.assert_array_equal(read.values[0], momenta[0])


def test_wheels_need_no_torque_on_the_body(tmp_path, scene_with):
    path = write(tmp_path / 'wheels.mcap', ['/wheel_torque'])
    result = replay(path, scene.load(scene_with(WHEELS)))
    np.testing.assert_array_equal(
        result.trajectory.attitude,
        expected(tmp_path / 'scene.yaml', [], log('/wheel_torque')).attitude)
    text = result.text()
    assert 'rotors        torque on /wheel_torque\n' in text
    assert '  rotors      ' in text


@pytest.mark.parametrize(('topics', 'lines', 'interpolation', 'law', 'bound'), [
    (['/control', '/wheel_torque'], [WHEELS], 'hold', 'work and energy', 1e-9),
    (['/control'], ['damping: {dxx: 2.0, dyy: 3.0, dzz: 4.0}'], 'linear', 'work and energy', 1e-7),
    (['/disturbance', '/wheel_torque'], [WHEELS, ROTORS], 'hold', 'integral of the torque', 1e-14),
    (['/disturbance'], [], 'linear', 'integral of the torque', 1e-14),
    (['/wheel_torque'], [WHEELS, ROTORS], 'hold', 'drift of the space angular momentum', 1e-14),
    (['/control', '/disturbance', '/wheel_torque'], [TWO, WHEELS, DAMPING, ROTORS, *PIVOT, ORBIT],
     'linear', 'work and energy', 1e-9)])
def test_the_check_is_the_conservation_law_of_the_scene(tmp_path, scene_with, topics, lines,
                                                        interpolation, law, bound):
    path = write(tmp_path / 'recorded.mcap', topics)
    result = replay(path, scene.load(scene_with(*lines)), interpolation=interpolation)
    assert law in result.check.finding
    number, = re.findall(r'\d\.\de[+-]\d+', result.check.finding)
    assert float(number) < bound


@pytest.mark.slow
@pytest.mark.parametrize(('lines', 'laws'), [
    (PIVOT, ['drift of the energy', 'of the momentum about the field']),
    ([FIELDS.replace('[pivot]', '[pivot, buoy]'), *PIVOT[1:],
      'buoy: {moment: {x: 0.01}, field: {z: 3.0}}'],
     ['drift of the energy', 'of the momentum about the field']),
    ([FIELDS.replace('[pivot]', '[pivot, buoy]'), *PIVOT[1:],
      'buoy: {moment: {x: 0.01}, field: {x: 3.0}}'], ['drift of the energy']),
    ([ORBIT, ROTORS, 'start_time: 1000000000'], ["drift of Jacobi's integral"]),
    ([*PIVOT, 'damping: {dxx: 0.001}'], ['work and energy'])])
def test_fields_alone_conserve_their_integrals(tmp_path, scene_with, lines, laws, capsys):
    path, output = tmp_path / 'still.csv', tmp_path / 'motion.mcap'
    np.savetxt(path, [[1.0 + 0.1 * k, 0.0, 0.0, 0.0] for k in range(101)], delimiter=',',
               header='time,tx,ty,tz', comments='')
    config = scene_with(*lines)
    result = replay(path, scene.load(config))
    numbers = re.findall(r'\d\.\de[+-]\d+', result.check.finding)
    assert len(numbers) == len(laws)
    assert all(law in result.check.finding for law in laws)
    assert max(map(float, numbers)) < (1e-9 if laws == ['work and energy'] else 1e-14)
    assert main.attitude_replay([str(path), '--scene', config, '-o', str(output)]) == 0
    printed = capsys.readouterr().out
    assert result.check.finding in printed
    assert ('fields        pivot: moment (0.003, 0, -0.02) in body axes, field (0, 0, -9.81) in '
            'space axes\n' in printed) == ('pivot' in ''.join(lines))
    assert ('fields        gravity gradient: mean motion 0.4 rad/s' in printed) == (ORBIT in lines)
    assert main.attitude_replay([str(path), '--scene', config, '--verify', str(output)]) == 0


@pytest.mark.slow
def test_a_page_shows_the_torque_of_fields(tmp_path, scene_with):
    path, config = write(tmp_path / 'one.mcap', ['/control']), scene_with(*PIVOT, ORBIT, ROTORS)
    page = tmp_path / 'page.html'
    assert main.attitude_replay([path, '--scene', config, '--report', str(page)]) == 0
    motion = expected(config, [log('/control')])
    problem = scene.load(config).problem(State(STARTED))
    torque = sum(one.torque(problem.body, motion.times_ns, motion.attitude)
                 for one in problem.fields)
    assert np.ptp(torque) > 0.1
    data = data_of(page.read_text(encoding='utf-8'))
    panels = {panel['label']: panel for panel in data['panels']}
    shown, = panels['torque of the fields, body axes']['curves']
    np.testing.assert_allclose(array(shown['low'], '<f4').reshape(3, -1), torque.T, atol=1e-7)
    assert {'torque, body axes', 'rotor momentum, body axes'} < {*panels}
    # The torque of the animated body includes everything that acts.
    np.testing.assert_allclose(array(data['body']['torque'], '<f4').reshape(-1, 3),
                               torque + values('/control'), atol=1e-7)
    assert 'pivot.moment.z: -0.02' in page.read_text(encoding='utf-8')


def test_a_check_of_fields_finds_a_motion_without_them(tmp_path, scene_with):
    without = scene.load(scene_with()).problem().propagate(at=np.arange(0, 10 * SECOND, SECOND))
    for lines in (PIVOT, [ORBIT]):
        finding = drift(scene.load(scene_with(*lines)).problem(), without).finding
        assert float(re.findall(r'\d\.\de[+-]\d+', finding)[0]) > 0.1


def test_the_last_digits_of_all_inputs_count(recorded, scene_with):
    result = replay(recorded, scene.load(scene_with(TWO, WHEELS, DAMPING, ROTORS)))
    assert 0.0 < result.last_digits.effect < 1e-13


def test_a_source_without_messages_has_no_torque(tmp_path, scene_with):
    path = write(tmp_path / 'silent.mcap', ['/control', '/disturbance'], empty=['/disturbance'])
    motion = replay(path, scene.load(scene_with(TWO))).trajectory
    alone = expected(tmp_path / 'scene.yaml', [log('/control'), TorqueLog([], [])])
    np.testing.assert_array_equal(motion.attitude, alone.attitude)


def test_a_plain_scene_takes_the_topic_that_it_names(tmp_path, scene_with):
    path = write(tmp_path / 'two.mcap', ['/control', '/disturbance'], control='/torque')
    result = replay(path, scene.load(scene_with()))
    assert result.topic == '/torque'
    np.testing.assert_array_equal(result.problem.logs[0].torques, values('/control'))


@pytest.mark.parametrize(('lines', 'options', 'message'), [
    ([TWO], ['--topic', '/control', '--topic', '/control'], "found '/control' twice"),
    (['torque_topics: [control, thrusters]'], [],
     'expected the torque_topics of the scene, found no topic thrusters among /control'),
    ([TWO], ['--wheel-torque', '/wheel_torque'],
     '--wheel-torque: expected a scene with wheels: true, found wheels: false'),
    ([TWO, WHEELS], ['--wheel-torque', '/wheel_torque', '--wheel-momentum', '/wheel_momentum'],
     'expected one of --wheel-torque and --wheel-momentum, found both'),
    (['torque_topics: [control, /control]'], [],
     "recorded.mcap: torque_topics: expected each topic once, found '/control' twice"),
    ([TWO, WHEELS], ['--wheel-torque', ''], '--wheel-torque: expected a topic, found an empty'),
    ([TWO, WHEELS], ['--wheel-torque', '/control', '--topic', '/control'],
     "expected each topic once, found '/control' twice"),
    ([TWO, WHEELS], ['--wheel-torque', '/disturbance', '--topic', '/control'],
     "/disturbance: message 1: frame_id: expected 'base_link' or '' (body axes), found 'world'"),
    ([TWO, WHEELS], ['--wheel-momentum', '/wheel_torque'],
     '/wheel_torque: expected geometry_msgs/msg/Vector3Stamped, found'),
    ([TWO, WHEELS, ROTORS], ['--wheel-momentum', '/wheel_momentum'],
     'initial_rotor_momentum: expected [0.0'),
    ([TWO, WHEELS, 'torque_timeout: 0.09'], ['--wheel-momentum', '/wheel_momentum'],
     'expected samples at most torque_timeout (0.09 s) apart, found a gap of 0.1 s'),
    ([WHEELS, 'solver: exact'], ['--topic', '/control'], "solver 'exact' handles neither rotors")])
def test_a_mistake_is_reported_in_one_line(recorded, scene_with, tmp_path, refusal, lines, options,
                                           message):
    assert message in refusal('attitude_replay', recorded, '--scene', scene_with(*lines), '-o',
                              tmp_path / 'motion.mcap', *options)
    assert {one.name for one in tmp_path.iterdir()} == {'scene.yaml', 'recorded.mcap'}


@pytest.mark.parametrize(('frame_id', 'numbers', 'message'), [
    ('world', (0.0, 0.0, 1.0), "message 1: frame_id: expected 'base_link' or '' (body axes)"),
    ('', (0.0, float('nan'), 1.0), 'message 1 at'),
    ('', None, 'expected the momentum of the rotors, found no messages')])
def test_a_momentum_that_cannot_be_used_is_named(tmp_path, scene_with, refusal, frame_id, numbers,
                                                 message):
    path = tmp_path / 'momentum.mcap'
    with recording.Writer(path) as writer:
        writer.add_topic('/h', messages.VECTOR3)
        if numbers:
            writer.write('/h', SECOND, messages.VECTOR3.encode(SECOND, frame_id, numbers))
    assert f'momentum.mcap: /h: {message}' in refusal(
        'attitude_replay', path, '--scene', scene_with(WHEELS), '--wheel-momentum', '/h')


def test_damage_is_reported_if_no_torque_could_be_read(recorded, scene_with, tmp_path, refusal):
    damaged = tmp_path / 'damaged.mcap'
    data = bytearray(Path(recorded).read_bytes())
    data[len(data) // 2] ^= 255
    damaged.write_bytes(data)
    line = refusal('attitude_replay', damaged, '--scene', scene_with(TWO, WHEELS))
    assert '/control, /disturbance, /wheel_torque: expected torques, found no messages (' in line
    assert 'damaged chunk at byte' in line


@pytest.mark.slow
def test_a_replay_with_the_recommended_setting_meets_the_target(recorded, scene_with, tmp_path,
                                                                short_trades):
    lines = TWO, WHEELS, DAMPING, ROTORS
    assert main.attitude_tradeoff([
        '--scene', scene_with(*lines), '--recording', recorded, '--wheel-torque', '/wheel_torque',
        '--target', '1e-7', '--json', str(tmp_path / 'o.json')]) == 0
    found = json.loads((tmp_path / 'o.json').read_text())
    assert found['samples'] == 200
    default, recommended = (
        replay(recorded, scene.load(scene_with(*lines, *more)),
               wheel_torque='/wheel_torque').trajectory
        for more in ((), found['recommended']['parameters']))
    error = so3.angle_between(recommended.attitude, default.attitude).max()
    assert 0.0 < error <= found['recommended']['whole_attitude_error_rad'] <= 1e-7


def test_the_steps_under_a_field_count_for_the_computing_time():
    # A pendulum that starts at rest, with a torque of zero; it swings at about 2 rad/s.
    values = {'inertia.ixx': 0.05, 'inertia.iyy': 0.05, 'inertia.izz': 0.05}
    weight = {'fields': ['pivot'], 'pivot.moment.z': -0.02, 'pivot.field.z': -9.81}
    still = TorqueLog([0], [[0.0, 0.0, 0.0]])
    without, under = (computing_time(still, (0, 3600 * SECOND), 0.0,
                                     scene.Scene.from_values({**values, **more}))
                      for more in ({}, weight))
    assert without == 0.0
    steps = under / computing_time(still, (0, SECOND), 1.0, scene.Scene.from_values(
        {**values, 'damping.dxx': 1e-12}))
    assert 2 * 3600 < steps < 8 * 3600
