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

"""Recordings and tables with common faults: the right value, or a line that names the fault."""

from collections import namedtuple
import itertools
import json
import re
from types import SimpleNamespace

from conftest import SECOND
from measurements import (
    messages_of,
    Quaternion,
    seconds,
    table,
    TFMessage,
    torque_messages,
    transform,
    write,
)
import numpy as np
import pytest
from rigid_body_ros import Measured, messages, propagate, recording, RigidBody, State, TorqueLog
from rigid_body_ros.commands import main
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.mechanics import so3
from rigid_body_ros.recording.account import Account, SLASH
from rigid_body_ros.recording.measurements import read_measured
from rigid_body_ros.scene import load
from scipy.spatial.transform import Rotation

COUNT, STEP_NS, START_NS = 301, 10_000_000, 1_700_000_000 * SECOND
ROWS = np.arange(COUNT)
STAMPS = START_NS + STEP_NS * ROWS
TORQUES = np.column_stack([0.02 * np.sin(0.05 * ROWS), 0.01 * np.cos(0.03 * ROWS),
                           np.full(COUNT, 0.005)])
TRUTH = propagate(RigidBody([[0.045, 0.002, 0.0], [0.002, 0.120, 0.0], [0.0, 0.0, 0.140]]),
                  State(START_NS, angular_velocity=[0.0, 0.6, 0.0]), TorqueLog(STAMPS, TORQUES),
                  at=STAMPS)
RANDOM = np.random.default_rng(3)
ATTITUDE = so3.multiply(TRUTH.attitude, so3.exp(1e-3 * RANDOM.normal(size=(COUNT, 3))))
RATES = TRUTH.angular_velocity + 2e-3 * RANDOM.normal(size=(COUNT, 3))
PARAMETERS = '/**:\n  ros__parameters:\n    initial_angular_velocity: {y: 0.6}\n'
SCENE = PARAMETERS + '    inertia: {ixx: 0.045, iyy: 0.120, izz: 0.140, ixy: 0.002}\n'
#: The same body with a sensor in the axes of another link.
LINKS = PARAMETERS + """    link: base_link
    robot_description: '<robot name="a"><link name="base_link"><inertial><mass value="1"/>
      <inertia ixx="0.045" iyy="0.120" izz="0.140" ixy="0.002" ixz="0" iyz="0"/></inertial></link>
      <link name="imu_link"/><joint name="m" type="fixed"><parent link="base_link"/>
      <child link="imu_link"/><origin xyz="0.1 0 0" rpy="0.1 0.2 0.3"/></joint></robot>'
"""
#: The errors in a JSON file, and the noise of the measurements, rad and rad/s.
NOISE = {'attitude_error_rad': 1e-3, 'rate_error_rad_s': 2e-3}
ATTITUDES, GYRO = NOISE
BOTH = ATTITUDES, GYRO
#: The errors that measurements of a type have.
CHANNELS = {'Imu': BOTH, 'Odometry': BOTH, 'PoseStamped': (ATTITUDES,), 'tum': (ATTITUDES,),
            'csv': (GYRO,), 'Vector3Stamped': (GYRO,)}
ADVICE = ' (--time-source log uses the times of the recording)'
Result = namedtuple('Result', 'status shown error found')


def logged(messages, change=lambda message: None):
    """Return messages with the times at which a recorder without faults logs them."""
    sent = [message for _, message in messages]
    for message in sent:
        change(message)
    return list(zip((START_NS + 300_000 + STEP_NS * np.arange(len(sent))).tolist(), sent))


def sensor(kind, stamps=STAMPS, attitude=ATTITUDE, rates=RATES, covariance=None, frame=None,
           child=None, change=lambda message: None):
    """Return messages; `frame` may be a list with the frame_id of each message."""
    sent = logged(messages_of(kind, Measured('', stamps, attitude, rates), covariance), change)
    for number, (_, message) in enumerate(sent):
        if frame is not None:
            message.header.frame_id = frame if isinstance(frame, str) else frame[number]
        if child is not None:
            message.child_frame_id = child
    return sent


def torque(stamps=STAMPS, torques=TORQUES, change=lambda message: None):
    return logged(torque_messages(SimpleNamespace(torque_times=stamps, torques=torques)), change)


@pytest.fixture
def run(capsys, tmp_path):
    """Return a function that runs a command; it returns status, outputs and JSON file."""
    def call(command, path, *arguments, scene=SCENE):
        scene_file, out = tmp_path / 'scene.yaml', tmp_path / 'out.json'
        scene_file.write_text(scene)
        options = [] if command == 'replay' else ['--json', out, '--overwrite', '--horizon', 1]
        status = getattr(main, f'attitude_{command}')([*map(str, (
            path, '--scene', scene_file, *arguments, *options))])
        return Result(status, *capsys.readouterr(),
                      json.loads(out.read_text()) if status != 2 and options else None)
    return call


def is_clean(result, *names):
    """Check that a command reports nothing, and that the errors are the noise."""
    assert (result.status, result.error) == (0, '')
    is_noise(result.found, *names)


def is_noise(found, *names):
    """Check that the errors are the noise, and that nothing else is compared."""
    for name, sigma in NOISE.items():
        expected = pytest.approx([sigma] * 3, rel=0.1) if name in names else None
        assert (found[name] or {}).get('axes_rms') == expected


def back(step_s, first=151):
    """Return stamps of a clock that is set back."""
    return np.where(first > ROWS, STAMPS, STAMPS - round(step_s * SECOND))


same = '{} of .* samples have the same stamp as a later one, .* is sample {}'.format
#: The rows, their stamps, how many are replaced, how often the clock goes back, and the warning.
CLOCKS = {
    'two publishers': (np.repeat(ROWS[::2], 2), np.repeat(STAMPS[::2], 2), 151, 0, same(151, 1)),
    'every third': (ROWS, STAMPS - STEP_NS * (ROWS % 3 == 2), 100, 0, same(100, 2)),
    'whole seconds': (ROWS, STAMPS // SECOND * SECOND, 297, 0, same(297, 1)),
    '1 s': (ROWS, back(1.0), 100, 1, 'go back by 1 s at sample 152: .*' + same(100, 52)),
    '25 ms': (ROWS, back(0.025), 0, 1, 'go back by 0.025 s at sample 152: was the clock set'),
    'twice': (ROWS, np.minimum(back(1.0, 101), back(1.5, 201)), 150, 2,
              'go back by 1 s at sample 102, and 1 more times: was the clock set'),
    'a loop': (np.append(ROWS, ROWS), np.append(STAMPS, STAMPS), 301, 1,
               'go back by 3.01 s at sample 302: .*' + same(301, 1)),
    'beyond the start': (ROWS, back(10.0), 0, 1, 'go back by 10 s at sample 152: was the clock'),
}
#: Orders of arrival and the stamps, with how many are late or replaced: these are no faults.
LATE = np.argsort(ROWS + 4.5 * np.isin(ROWS, [50, 120, 200]))
BURST = np.concatenate([ROWS[:100], ROWS[108:130], ROWS[100:108], ROWS[130:]])
HARMLESS = {
    'late': (LATE, STAMPS[LATE], 0, '301 of 301 samples are used: 3 late and sorted'),
    'burst': (BURST, STAMPS[BURST], 0, '301 of 301 samples are used: 8 late and sorted'),
    'one repeated': (ROWS, np.where(ROWS == 99, STAMPS - STEP_NS, STAMPS), 1,
                     '300 of 301 samples are used: 1 replaced by a later one of that stamp'),
    'hundredths': (ROWS, STAMPS // STEP_NS * STEP_NS, 0, '')}


# A stamp that returns after the whole recording is found within a block only.
@pytest.mark.parametrize(('clock', 'size'), [
    (clock, size) for clock in (*CLOCKS, *HARMLESS) for size in (1, 50, 1000)
    if size == 1000 or clock != 'a loop'])
def test_stamps_are_accounted_for_wherever_blocks_end(clock, size):
    account, (rows, stamps, replaced, *steps, text) = Account(), {**CLOCKS, **HARMLESS}[clock]
    for row in range(0, len(rows), size):
        account.add(stamps[row:row + size])
    assert (account.samples, account.replaced, len(account.steps)) == (
        len(rows), replaced, sum(steps))
    if clock in CLOCKS:
        fault, = account.faults
        assert re.search(text, fault)
        assert ADVICE in fault
        assert account.counted.startswith(f'{len(rows) - replaced} of {len(rows)} samples are')
        assert ('at which the clock goes back' in account.counted) == bool(sum(steps))
    else:
        assert (account.faults, account.counted) == ([], text)


def measured(folder, kind, rows, stamps):
    """Write measurements in a format; return the recording of torques and the topic."""
    if kind == 'csv':
        path = table(folder / 'it.csv', 'time,wx,wy,wz', seconds(stamps), RATES[rows])
    elif kind == 'tum':
        path = table(folder / 'it.tum', '# a trajectory', seconds(stamps),
                     np.zeros((len(rows), 3)), ATTITUDE[rows], separator=' ')
    else:
        return write(folder / 'it.mcap', torque=torque(), it=sensor(
            kind, stamps, ATTITUDE[rows], RATES[rows])), '/it'
    return write(folder / 'it.mcap', torque=torque()), path


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['Imu', 'PoseStamped', 'Odometry', 'csv', 'tum'])
def test_stamps_that_cannot_be_right_are_a_warning_and_no_cause(run, tmp_path, kind):
    path, topic = measured(tmp_path, kind, ROWS, back(1.0))
    name = getattr(topic, 'name', topic)
    status, _, error, found = run('compare', path, '--measured', topic)
    fault, = found['accounts'][name]['faults']
    assert (status, error) == (0, f'attitude_compare: warning: {path}: {name}: {fault}\n')
    assert (ADVICE in fault) == (topic == '/it')
    assert found['accounts'][name] == {'samples': COUNT, 'rejected': 0, 'replaced': 100,
                                       'steps_back': 1, 'faults': [fault], 'notes': []}
    assert found['likely_causes'] == []


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['Imu', 'tum'])
def test_samples_that_arrive_late_are_sorted_without_a_warning(run, tmp_path, kind):
    path, topic = measured(tmp_path, kind, LATE, STAMPS[LATE])
    result = run('compare', path, '--measured', topic)
    is_clean(result, *CHANNELS[kind])
    assert f': {HARMLESS["late"][-1]}\n' in result.shown
    assert result.found['likely_causes'] == []


@pytest.mark.parametrize('kind', ['messages', 'csv'])
@pytest.mark.parametrize('clock', ['1 s', 'late'])
def test_a_replay_accounts_for_stamps(run, tmp_path, kind, clock):
    rows, stamps, *_ = {**CLOCKS, **HARMLESS}[clock]
    if kind == 'csv':
        path = table(tmp_path / 'it.csv', 'time,tx,ty,tz', seconds(stamps), TORQUES[rows])
    else:
        path = write(tmp_path / 'it.mcap', torque=torque(stamps, TORQUES[rows]))
    account = Account('' if kind == 'csv' else ADVICE)
    account.add(stamps)
    status, shown, error, _ = run('replay', path)
    assert (status, error) == (0, '')
    assert re.findall('^account +(.*)$', shown, re.M) == [account.counted]
    assert re.findall(r'^warning +(the stamps .*)$', shown, re.M) == account.faults


@pytest.mark.slow
def test_stamps_of_several_torques_are_accounted_for_by_topic(run, tmp_path):
    path = write(tmp_path / 'it.mcap', torque=torque(), imu=sensor('Imu'), other=torque(back(1.0)))
    result = run('compare', path, '--topic', '/torque', '--topic', '/other')
    account = result.found['accounts']['torques']
    fault, = account['faults']
    assert (account['samples'], account['replaced'], account['steps_back']) == (2 * COUNT, 100, 1)
    assert re.match(f'/other: .*{CLOCKS["1 s"][-1]}', fault)
    assert f'{path}: torques: {fault}' in result.error


def test_a_single_stamp_is_an_error(run, tmp_path):
    path, _ = measured(tmp_path, 'Imu', ROWS, np.full(COUNT, START_NS))
    assert run('compare', path).error.endswith('at least 4 different stamps, found 1\n')


IDENTITY, ZEROS = [0.0, 0.0, 0.0, 1.0], np.zeros((COUNT, 3))
NO_ATTITUDE = 'the attitude is not used: it is {} in all messages, although their angular ' \
    'velocity turns the body by 1.83 rad'
NO_RATES = 'the angular velocity is not used: it is zero in all messages, although their ' \
    'attitude turns by 1.84 rad'


def unfilled(folder, filler, kind='Imu'):
    rates, attitude = (ZEROS, ATTITUDE) if filler == 'gyro' else (
        RATES, np.tile(filler, (COUNT, 1)))
    covariance = None if np.any(attitude) else [-1.0, *8 * [0.0]]
    sent = sensor(kind, attitude=attitude, rates=rates, covariance=covariance)
    return write(folder / 'it.mcap', torque=torque(), it=sent)


@pytest.mark.parametrize(('kind', 'filler', 'note'), [
    ('Imu', IDENTITY, NO_ATTITUDE.format(IDENTITY)),
    ('Odometry', [0.5, 0.5, -0.5, 0.5], NO_ATTITUDE.format([0.5, 0.5, -0.5, 0.5])),
    ('Imu', [0.0] * 4, ''),
    # It has no covariance that says so.
    ('Odometry', [0.0] * 4, 'the attitude is not used: expected finite values, of a possible '
     f'size, found none in {COUNT} messages'),
    ('Odometry', 'gyro', NO_RATES)])
def test_what_was_never_filled_is_left_out(run, tmp_path, kind, filler, note):
    path = unfilled(tmp_path, filler, kind)
    status, _, error, found = run('compare', path, '--measured', '/it')
    assert (status, found['likely_causes']) == (0, [])
    assert error == (f'attitude_compare: note: {path}: /it: {note}\n' if note else '')
    is_noise(found, ATTITUDES if filler == 'gyro' else GYRO)


@pytest.mark.parametrize(('filler', 'name', 'note'), [
    (IDENTITY, 'attitude', NO_ATTITUDE.format(IDENTITY)), ('gyro', 'rates', NO_RATES)])
def test_what_was_never_filled_cannot_be_chosen(run, tmp_path, filler, name, note):
    path = unfilled(tmp_path, filler)
    other, = {'attitude', 'rates'} - {name}
    for chosen in ([name], [other, name]):
        topics = [text for each in chosen for text in ('--measured', f'/it:{each}')]
        assert run('compare', path, *topics)[::2] == (2, (
            f'attitude_compare: error: {path}: /it:{name}: expected samples of this quantity, '
            f'found none; {note}\n'))
    is_noise(run('compare', path, '--measured', f'/it:{other}').found,
             GYRO if other == 'rates' else ATTITUDES)


def test_a_body_at_rest_is_measured(run, tmp_path):
    sent = sensor('Imu', attitude=np.tile(IDENTITY, (COUNT, 1)), rates=ZEROS)
    path = write(tmp_path / 'it.mcap', torque=torque(torques=ZEROS), it=sent)
    status, _, error, found = run('compare', path, scene=SCENE.replace('0.6', '0.0'))
    assert (status, error, [found[name]['max'] for name in BOTH]) == (0, '', [0.0, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize(('has_second', 'parts', 'names'), [
    (True, [''], BOTH), (False, [':rates'], (GYRO,)), (True, [':attitude'], (ATTITUDES,)),
    (True, [':rates', ':attitude'], BOTH)])
def test_a_part_of_a_topic_is_chosen_of_any_recording(run, tmp_path, has_second, parts, names):
    topics = {'imu': sensor('Imu')}
    path = write(tmp_path / 'it.mcap', torque=torque(), **({} if has_second else topics))
    second = f'{write(tmp_path / "second.mcap", **topics)}:' if has_second else ''
    chosen = [text for part in parts for text in ('--measured', f'{second}/imu{part}')]
    result = run('compare', path, *chosen)
    is_clean(result, *names)
    assert result.found['measured'] == [f'{"second.mcap:" * has_second}/imu{part}'
                                        for part in parts]


SPACE = "the angular velocity is in the axes of '{}' (space): converted to body axes"
LINK = "the measurements are in the axes of '{}': converted to body axes"
IN_TURNS = ['world' if row % 3 else '/base_link' for row in ROWS]
SENSOR, IN_SPACE = Rotation.from_euler('xyz', [0.1, 0.2, 0.3]), so3.rotate(ATTITUDE, RATES)
TURNED = {'attitude': (Rotation.from_quat(ATTITUDE) * SENSOR).as_quat(),
          'rates': SENSOR.inv().apply(RATES)}


@pytest.mark.slow
@pytest.mark.parametrize(('kind', 'frame', 'child', 'note'), [
    ('Imu', '/world', None, SPACE.format('/world')),
    *(('Odometry', parent, child, SPACE.format(child)) for parent, child in (
        ('world', 'world'), ('/odom', 'odom'), ('odom', '/odom'))),
    ('Imu', IN_TURNS, None, SPACE.format('world')),
    *((kind, *frames, LINK.format('/imu_link')) for kind, *frames in (
        ('Vector3Stamped', '/imu_link', None), ('Odometry', 'world', '/imu_link'))),
    ('Imu', 'imu_link', None, LINK.format('imu_link')),
    ('Odometry', '/world', '/base_link', ''), ('Vector3Stamped', '/base_link', None, '')])
def test_measurements_are_converted_from_the_axes_that_messages_name(run, tmp_path, kind, frame,
                                                                     child, note):
    values = TURNED if 'link' in note else {'rates': IN_SPACE} if note else {}
    if frame is IN_TURNS:
        values = {'rates': np.where(ROWS[:, None] % 3, IN_SPACE, RATES)}
    path = write(tmp_path / 'it.mcap', torque=torque(), it=sensor(
        kind, frame=frame, child=child, **values))
    status, _, error, found = run('compare', path, '--measured', '/it',
                                  scene=LINKS if 'link' in note else SCENE)
    other = [line for line in error.splitlines() if "found 'odom'" not in line.replace('/', '')]
    names = [*frame] if frame is IN_TURNS else [frame, child or '']
    notes = [note] * bool(note) + [SLASH] * any(name.startswith('/') for name in names)
    assert (status, other) == (0, [f'attitude_compare: note: {path}: /it: {text}'
                                   for text in notes])
    is_noise(found, *CHANNELS[kind])


@pytest.mark.parametrize('frame', ['world', 'imu_link'])
def test_covariances_of_rates_are_converted_with_the_rates(tmp_path, frame):
    given = np.diag([1.0, 2.0, 3.0])
    messages = logged(messages_of('Imu', Measured('', STAMPS, ATTITUDE, RATES), None, given,
                                  frame))
    turn = Rotation.from_quat(ATTITUDE).inv() if frame == 'world' else SENSOR
    expected = turn.as_matrix() @ given @ turn.inv().as_matrix()
    (tmp_path / 'scene.yaml').write_text(LINKS)
    found = read_measured(write(tmp_path / 'it.mcap', it=messages), '/it',
                          links=load(tmp_path / 'scene.yaml').links)
    np.testing.assert_allclose(found.rate_covariance - expected, 0.0, rtol=0, atol=1e-14)


@pytest.mark.parametrize(('kind', 'attitude'), [
    ('Vector3Stamped', ATTITUDE), ('Imu', np.tile(IDENTITY, (COUNT, 1))),
    ('Imu', np.zeros((COUNT, 4)))])
def test_rates_in_space_axes_without_an_attitude_are_an_error(run, tmp_path, kind, attitude):
    path = write(tmp_path / 'it.mcap', torque=torque(), it=sensor(
        kind, attitude=attitude, rates=IN_SPACE, frame='world'))
    assert run('compare', path, '--measured', '/it')[::2] == (2, (
        f'attitude_compare: error: {path}: /it: message 1: frame_id: expected an angular velocity '
        "in body axes, found 'world' (space axes)\n"))


@pytest.mark.parametrize(('norm', 'worst'), [
    (12345.0, '301 of 301 quaternions do not have norm 1; the worst has norm 12345:'),
    (1.02, 'norm 1.02:'), (1.002, ''), (32767.0, r'norm 3276\d\.\d:'),
    (np.where(ROWS == 7, 3.0, 1.0)[:, None], '')])
def test_quaternions_without_norm_1_are_a_warning_unless_few(run, tmp_path, norm, worst):
    values = norm * ATTITUDE
    path = write(tmp_path / 'it.mcap', torque=torque(), it=sensor(
        'PoseStamped', attitude=np.round(values) if np.max(norm) == 32767.0 else values))
    status, _, error, found = run('compare', path)
    assert (status, error.count('\n')) == (0, bool(worst))
    assert re.search(worst, error)
    is_noise(found, ATTITUDES)


@pytest.mark.slow
@pytest.mark.parametrize(('kind', 'fault'), [
    ('Odometry', {'sec': -2 ** 31}), ('Vector3Stamped', {'nanosec': 2 * SECOND})])
def test_stamps_that_are_not_times_are_no_obstacle_to_other_times(run, tmp_path, kind, fault):
    def change(message):
        vars(message.header.stamp).update(fault)
    path = write(tmp_path / 'it.mcap', torque=torque(change=change), it=sensor(
        kind, change=change))
    for command, topic in (('replay', '/torque'), ('compare', '/it')):
        error = run(command, path, *(['--measured', '/it'] * (topic == '/it'))).error
        assert f'{path}: {topic}: message 1: ' in error
        assert 'invalid stamp: ' in error
    is_clean(run('compare', path, '--measured', '/it', '--time-source', 'log'), *CHANNELS[kind])
    assert 'warning' not in run('replay', path, '--time-source', 'log').shown


@pytest.mark.slow
@pytest.mark.parametrize(('rows', 'warning'), [
    ([300], ''), (ROWS[7::20], '15 of 301 samples are rejected: expected finite')])
def test_torques_that_are_not_finite_are_skipped_and_counted(run, tmp_path, rows, warning):
    torques = TORQUES.copy()
    torques[rows, 1] = np.nan
    path = write(tmp_path / 'it.mcap', torque=torque(torques=torques), it=sensor('Imu'))
    status, shown, error, _ = run('replay', path)
    assert (status, error) == (0, '')
    used = f'{COUNT - len(rows)} of 301 samples are used: {len(rows)} rejected\n'
    assert f'account       {used}' in shown
    assert (f'warning       {warning}' in shown) == bool(warning)
    assert run('compare', path).found['accounts']['torques']['rejected'] == len(rows)


def test_torques_that_are_never_finite_are_an_error(run, tmp_path):
    path = write(tmp_path / 'it.mcap', torque=torque(torques=np.nan * TORQUES))
    assert run('replay', path).error == (f'attitude_replay: error: {path}: /torque: expected a '
                                         'finite torque, found none among 301 messages\n')


MAP = Rotation.from_euler('z', np.linspace(0.1, 0.25, COUNT)[:, None])
ODOM = MAP.inv() * Rotation.from_quat(ATTITUDE)
FIXED = MAP[0].inv() * Rotation.from_quat(ATTITUDE)
BODY, EVERY = ('odom', 'base_link', ODOM), [('map', 'odom', MAP), ('odom', 'base_link', ODOM)]
FROM_MAP = SCENE + '    space_frame: map\n'


def transforms(*links, rows=ROWS):
    """Return a message for each row, with a transform for each parent, child and rotations."""
    return [(int(STAMPS[row]) + 300_000, TFMessage([
        transform(STAMPS[row], Quaternion(*rotations[row].as_quat().tolist()), parent, child)
        for parent, child, rotations in links])) for row in rows]


STATIC, ON_FIXED = transforms(EVERY[0], rows=[0]), transforms(('odom', 'base_link', FIXED))
CHAINS = {
    'one message': ('/tf', {'tf': transforms(*EVERY)}),
    'slow': ('/tf', {'tf': transforms(BODY) + transforms(EVERY[0], rows=ROWS[::20])}),
    'reversed': ('/tf', {'tf': transforms(EVERY[0], ('base_link', 'odom', ODOM.inv()))}),
    'fixed': ('/tf', {'tf': ON_FIXED, 'tf_static': STATIC}),
    'namespace': ('/robot/tf', {'robot/tf': ON_FIXED, 'robot/tf_static': STATIC}),
    'direct': ('/tf', {'tf': transforms(EVERY[0], ('odom', 'base_link', ODOM.inv()), (
        'map', 'base_link', Rotation.from_quat(ATTITUDE)))}),
}


@pytest.mark.slow
@pytest.mark.parametrize(('chain', 'has_frames'), [*zip(CHAINS, itertools.cycle([False, True]))])
def test_transforms_are_composed_along_a_chain(run, tmp_path, chain, has_frames):
    topic, topics = CHAINS[chain]
    path = write(tmp_path / 'it.mcap', torque=torque(), **topics)
    options = ('--frames', 'map', 'base_link') if has_frames else ()
    result = run('compare', path, '--measured', topic, *options,
                 scene=SCENE if has_frames else FROM_MAP)
    is_clean(result, ATTITUDES)
    assert result.found['accounts'][topic]['samples'] == COUNT


@pytest.mark.parametrize(('topics', 'message'), [
    ({'tf': ON_FIXED}, "directly or in a chain, found 'odom' to 'base_link'; choose"),
    ({'tf': ON_FIXED, 'robot/tf_static': STATIC}, "found 'odom' to 'base_link'; choose"),
    ({'tf': transforms(('/map', '/base_link', MAP))}, "found '/map' to '/base_link'; choose"),
    ({'tf': transforms(('a', 'b', MAP)), 'tf_static': transforms(*EVERY, rows=[0])},
     "expected a transform that changes between 'map' and 'base_link', found fixed ones only")])
def test_a_chain_with_a_missing_link_lists_the_others(run, tmp_path, topics, message):
    path = write(tmp_path / 'it.mcap', torque=torque(), **topics)
    status, _, error, _ = run('compare', path, '--measured', '/tf', scene=FROM_MAP)
    assert status == 2
    assert error.startswith(f'attitude_compare: error: {path}: /tf: expected ')
    assert message in error


@pytest.mark.parametrize('data', [b'', b'\0', b'\0\1\0\0'])
def test_a_message_of_fixed_transforms_that_is_cut_off_is_one_line(tmp_path, data):
    path, kind = tmp_path / 'it.mcap', messages.TRANSFORM
    with recording.Writer(path) as writer:
        writer.add_topic('/tf', kind)
        writer.add_topic('/tf_static', kind)
        writer.write('/tf', SECOND, kind.encode(SECOND, 'odom', [0.0] * 6 + [1.0], 'base_link'))
        writer.write('/tf_static', SECOND, data)
    with pytest.raises(InputError, match='/tf_static: message 1: expected a .*TFMessage in CDR'):
        read_measured(path, '/tf', frames=('map', 'base_link'))


UNIT = '; a heading such as "time_ms" names the unit\n'
TIMES = seconds(STAMPS)
WXYZ, DEGREES = ATTITUDE[:, [3, 0, 1, 2]], np.degrees(RATES)


BOOT_NS = STAMPS - START_NS + 100 * SECOND
SINCE_1970 = 'because {} is then a time since 1970'
TOO_FAST = 'because samples {} s apart could not follow the motion'


@pytest.mark.slow
@pytest.mark.parametrize(('times', 'note'), [
    (STAMPS, 'ns is assumed, ' + SINCE_1970.format(START_NS)),
    (STAMPS // 10 ** 3, 'us is assumed, ' + SINCE_1970.format(START_NS // 10 ** 3)),
    (STAMPS // 10 ** 6, 'ms is assumed, ' + SINCE_1970.format(START_NS // 10 ** 6)),
    ([f'{time}.000' for time in STAMPS // 10 ** 6], 'ms is assumed, ' + SINCE_1970.format(
        f'{START_NS // 10 ** 6}.000')),
    (seconds(STAMPS), ''), (seconds(BOOT_NS), ''),
    (BOOT_NS, 'ns is assumed, ' + TOO_FAST.format('1e+07')),
    (BOOT_NS // 10 ** 3, 'us is assumed, ' + TOO_FAST.format('10000')),
    (BOOT_NS // 10 ** 6, 'ms is assumed, ' + TOO_FAST.format('10'))])
def test_the_unit_of_times_is_recognized_and_noted(run, tmp_path, times, note):
    path = table(tmp_path / 'it.csv', 'time,tx,ty,tz,wx,wy,wz', times, TORQUES, RATES)
    status, _, error, found = run('compare', path, '--measured', path)
    assert (status, error) == (0, ''.join(
        f'attitude_compare: note: {path}: {name}: the times have no unit: {note}{UNIT}'
        for name in ('it.csv', 'torques') if note))
    is_noise(found, GYRO)


@pytest.mark.parametrize(('heading', 'unit_ns'), [
    ('time (s)', SECOND), ('time_ms', 10 ** 6), ('t [us]', 1000), ('time', SECOND)])
def test_a_unit_in_the_heading_wins_and_a_slow_body_is_sampled_each_second(tmp_path, heading,
                                                                           unit_ns):
    slow = RATES * (1.0 if heading != 'time' else 1e-3)
    found = read_measured(table(tmp_path / 'it.csv', f'{heading},wx,wy,wz', 10 * ROWS if
                                heading != 'time' else ROWS, slow))
    assert found.stamps_ns.tolist() == (ROWS * unit_ns * (10 if heading != 'time' else 1)).tolist()
    assert found.account.notes == []


def test_a_unit_that_cannot_be_is_named_and_so_is_an_assumed_one(run, tmp_path):
    path = table(tmp_path / 'it.csv', 'time (s),tx,ty,tz', STAMPS, TORQUES)
    assert f'expected a time from 0 to 2147483647 s, found {str(START_NS)!r}; name another unit' \
        in run('replay', path).error
    table(path, 'time,tx,ty,tz', ROWS * 10, TORQUES)
    shown = run('replay', path, '--until', '1').shown
    assert 'no unit: s is assumed, so samples are 10 s apart' in shown


def test_a_matrix_is_not_a_trajectory(tmp_path):
    (tmp_path / 'it.txt').write_text('\n'.join([' '.join(12 * ['0.5'])] * 9))
    with pytest.raises(InputError, match='found 12 columns, as in a pose matrix of 3 x 4'):
        read_measured(tmp_path / 'it.txt')


JOINED = ('__time,/torque/wrench/torque/x,/torque/wrench/torque/y,/torque/wrench/torque/z,'
          '/imu/angular_velocity/x,/imu/angular_velocity/y,/imu/angular_velocity/z,'
          '/att/quaternion/x,/att/quaternion/y,/att/quaternion/z,/att/quaternion/w')


@pytest.mark.slow
@pytest.mark.parametrize('is_apart', [False, True])
@pytest.mark.parametrize('blank', ['', 'nan', 'NaN', ' '])
def test_a_joined_table_has_empty_cells_and_several_rates(run, tmp_path, blank, is_apart):
    lines = [JOINED]
    for row, time in enumerate(TIMES):
        samples = [','.join(map(repr, values[row].tolist()) if row % step == 0 else
                            values.shape[1] * [blank])
                   for values, step in ((TORQUES, 1), (RATES, 2), (ATTITUDE, 3))]
        blanks = [','.join(count * [blank]) for count in (3, 3, 4)]
        parts = [[*blanks[:k], sample, *blanks[k + 1:]] for k, sample in enumerate(samples)]
        lines += [','.join([time, *part]) for part in (parts if is_apart else [samples])]
    path = tmp_path / 'it.csv'
    path.write_text('\n'.join(lines))
    result = run('compare', path, '--measured', path)
    is_clean(result, *BOTH)
    assert {name: account['samples'] for name, account in result.found['accounts'].items()} == {
        'it.csv:attitude': 101, 'it.csv:rates': 151, 'torques': COUNT}
    _, shown, _, _ = run('replay', path)
    assert shown.startswith('torques       301 on /torque, over 3 s\n')
    assert 'account' not in shown


@pytest.mark.slow
@pytest.mark.parametrize(('separator', 'point'), [(';', ','), (';', '.'), ('\t', '.'),
                                                  ('\t', ','), (',', '.')])
@pytest.mark.parametrize('quote', ['', '"'])
def test_columns_are_separated_as_tables_of_any_country_are(run, tmp_path, separator, point,
                                                            quote):
    paths = []
    for name, heading, values in (('torque.csv', 'time tx ty tz', TORQUES),
                                  ('gyro.csv', 'time wx wy wz', RATES)):
        columns = [TIMES, *([repr(cell) for cell in column] for column in values.T.tolist())]
        paths.append(table(tmp_path / name, heading.replace(' ', separator), *(
            [f'{quote}{cell.replace(".", point)}{quote}' for cell in column]
            for column in columns), separator=separator))
    is_clean(run('compare', paths[0], '--measured', paths[1]), GYRO)


def axes(name, unit='', names='xyz'):
    return ','.join(name.format(axis) + unit for axis in names)


@pytest.mark.parametrize(('heading', 'values'), [
    ('"Time (s)",' + axes('"Gyroscope {} (rad/s)"') + ',"Absolute (rad/s)"',
     np.column_stack([RATES, np.linalg.norm(RATES, axis=1)])),
    *((f'time,{axes("gyro_{}", unit)}', DEGREES) for unit in (
        ' (°/s)', '_dps', ' (dps)', ' [deg/s]')),
    *((f'timestamp,{axes(name)}', RATES) for name in (
        'ang_vel_{}', 'angular_velocity.{}', 'rotationRate.{}', 'gyroRotation{}(rad/s)',
        'omega_{}', '{} (rad/s)')),
    (f'#timestamp [s],{axes("w_RS_S_{} [rad s^-1]")}', RATES),
    *((f'time,{axes(name, names="0123")}', WXYZ) for name in (
        'q{}', 'q[{}]', 'vehicle_attitude/q.0{}')),
    *((f'time,{axes(name, names="xyzw")}', ATTITUDE) for name in (
        'q{}', 'orientation.{}', 'field.orientation.{}', 'pose.orientation.{}'))])
def test_headings_of_other_programs_are_known(tmp_path, heading, values):
    path = tmp_path / 'it.csv'
    for bom, end in (('', '\n'), ('\ufeff', '\r\n')):
        text = table(path, heading, TIMES, values).read_text()
        path.write_bytes((bom + text.replace('\n', end)).encode())
        found = read_measured(path)
        assert found.stamps_ns.tolist() == STAMPS.tolist()
        assert found.account.notes == []
        if values is WXYZ or values is ATTITUDE:
            np.testing.assert_allclose(found.attitude, ATTITUDE, rtol=0, atol=1e-15)
        else:
            np.testing.assert_allclose(found.angular_velocity, RATES, rtol=1e-14)


XYZ = 'xyz[0],xyz[1],xyz[2]'


@pytest.mark.parametrize(('name', 'is_gyro'), [
    ('Gyroscope', True), ('2_gyro', True), ('log_vehicle_angular_velocity_0', True),
    ('it', False), ('Accelerometer', False), ('log_vehicle_acceleration_0', False),
    ('vehicle_angular_acceleration_setpoint_0', False), ('gyro_and_torque', False)])
@pytest.mark.parametrize('heading', ['time,x,y,z', f'time,{XYZ}'])
def test_bare_axes_are_rates_only_in_a_file_of_that_name(tmp_path, name, is_gyro, heading):
    path = table(tmp_path / f'{name}.csv', heading, TIMES, RATES)
    if is_gyro:
        np.testing.assert_array_equal(read_measured(path).angular_velocity, RATES)
    else:
        with pytest.raises(InputError, match='line 1: no column for q.*; choose with --columns'):
            read_measured(path)


def test_names_of_files_tell_what_their_axes_are(run, tmp_path):
    gyro = table(tmp_path / 'Gyroscope.csv', 'time,seconds_elapsed,z,y,x', STAMPS,
                 seconds(STAMPS - START_NS), RATES[:, ::-1])
    np.testing.assert_array_equal(read_measured(gyro).angular_velocity, RATES)
    boot_us = BOOT_NS // 1000
    stamps = boot_us, boot_us - 40
    path = table(tmp_path / 'vehicle_torque_setpoint_0.csv', f'timestamp,timestamp_sample,{XYZ}',
                 *stamps, TORQUES)
    gyro = table(tmp_path / 'vehicle_angular_velocity_0.csv', 'timestamp,timestamp_sample,'
                 f'{XYZ},xyz_derivative[0],xyz_derivative[1],xyz_derivative[2]', *stamps, RATES,
                 np.zeros((COUNT, 3)))
    attitude = table(tmp_path / 'vehicle_attitude_0.csv', 'timestamp,timestamp_sample,q[0],q[1],'
                     'q[2],q[3],delta_q_reset[0],quat_reset_counter', *stamps, WXYZ,
                     np.zeros((COUNT, 2)))
    status, _, error, found = run('compare', path, '--measured', gyro, '--measured', attitude)
    assert (status, error.count('us is assumed'), error.count('\n')) == (0, 3, 3)
    is_noise(found, *BOTH)


@pytest.mark.parametrize(('columns', 'factor'), [
    ('time=1,wx=4,wy=3,wz=2', 1.0), ('time_s=A,wx (rad/s)=D,wy=C,wz=B', 1.0),
    ('time=A,wx (deg/s)=4,wy (deg/s)=C,wz (deg/s)=2', np.radians(1.0))])
def test_columns_are_chosen_by_number_or_name(run, tmp_path, columns, factor):
    torques = table(tmp_path / 'torque.csv', 'A,B,C,D', TIMES, 1000.0 * TORQUES)
    gyro = table(tmp_path / 'gyro.csv', 'A,B,C,D', TIMES, RATES[:, ::-1] / factor)
    is_clean(run('compare', torques, '--measured', gyro, '--columns',
                 f'tx (mN m)=2,ty (mN m)=C,tz (mN m)=4,{columns}'), GYRO)


KNOWN = '--columns: expected time (s, ms, us, ns), and qx qy qz qw or wx wy wz (rad/s, deg/s)'


@pytest.mark.parametrize(('columns', 'message'), [
    ('time=5,wx=4,wy=3,wz=2',
     "--columns: time: expected a number from 1 to 4, or one of A, B, C, D, found '5'"),
    ('time=0,wx=4,wy=3,wz=2', "or one of A, B, C, D, found '0'"),
    ('time=E,wx=4,wy=3,wz=2', "or one of A, B, C, D, found 'E'"),
    ('time=1,wx=4,wy=3', 'line 1: no column for wz; '), ('wx=4,wy=3,wz=2', 'no column for time; '),
    ('time=1,wx (rpm)=4,wy=3,wz=2', KNOWN), ('time=1,wx=4,wy=3,wz=2,speed=2', KNOWN)])
def test_a_wrong_choice_of_columns_is_a_line_that_names_it(run, tmp_path, columns, message):
    torques = table(tmp_path / 'torque.csv', 'time,tx,ty,tz', TIMES, TORQUES)
    gyro = table(tmp_path / 'gyro.csv', 'A,B,C,D', TIMES, RATES)
    status, _, error, _ = run('compare', torques, '--measured', gyro, '--columns', columns)
    assert (status, error.count('\n')) == (2, 1)
    assert message in error


@pytest.mark.parametrize('columns', ['time=1,wx=2,wx=3', 'time', 'time=', '=1', ''])
def test_a_choice_of_columns_has_each_name_once(run, tmp_path, capsys, columns):
    with pytest.raises(SystemExit) as raised:
        run('replay', tmp_path / 'it.csv', '--columns', columns)
    assert raised.value.code == 2
    assert f'expected NAME=COLUMN,..., each once, found {columns!r}' in capsys.readouterr().err
