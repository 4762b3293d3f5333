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

"""attitude_regress --open-loop: a node that gets recorded inputs publishes what it published."""

from contextlib import suppress
import json
import math
import os
import sys

from conftest import EPOCH_NS, running, SECOND
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rigid_body_ros import messages, recording
from rigid_body_ros.commands import main
from rigid_body_ros.recording.all_messages import AllMessages
from std_msgs.msg import String

pytestmark = pytest.mark.ros
UPDATE = '--update', '--overwrite'
COUNT, STEP_NS = 60, SECOND // 100
STAMPS_NS = EPOCH_NS + STEP_NS * np.arange(COUNT)
GAIN = 0.9
#: The beginning of a node that answers each message on one topic with one on another.
NODE = """
import sys
from geometry_msgs.msg import Vector3Stamped, WrenchStamped
from nav_msgs.msg import Odometry
import rclpy
from rclpy.parameter import Parameter
rclpy.init()
clock = sys.argv[1].endswith(' clock')
node = rclpy.create_node('own', parameter_overrides=[Parameter('use_sim_time', value=clock)])
def on(message, function, topic, kind):
    publisher = node.create_publisher(kind, topic, 10)
    def respond(given):
        answer = kind()
        answer.header = given.header
        function(given, answer)
        publisher.publish(answer)
    given = '/odometry' if message is Odometry else '/torque'
    node.create_subscription(message, given, respond, 10)
"""
SPIN = """
import contextlib
with contextlib.suppress(KeyboardInterrupt):
    rclpy.spin(node)
"""
#: An estimator with a memory, whose gain is an argument.
ESTIMATOR = f"""{NODE}
momentum = [0.0] * 3
def estimate(given, answer):
    torque = given.wrench.torque
    for k, value in enumerate((torque.x, torque.y, torque.z)):
        momentum[k] = float(sys.argv[2]) * momentum[k] + value
    answer.vector.x, answer.vector.y, answer.vector.z = momentum
on(WrenchStamped, estimate, '/momentum', Vector3Stamped)
{SPIN}"""
#: A controller: quaternion feedback with the gain of an argument.
CONTROLLER = f"""{NODE}
def control(given, answer):
    attitude, rate = given.pose.pose.orientation, given.twist.twist.angular
    for axis in 'xyz':
        setattr(answer.wrench.torque, axis, -float(sys.argv[2]) * getattr(attitude, axis)
                - 0.3 * getattr(rate, axis))
on(Odometry, control, '/control', WrenchStamped)
{SPIN}"""
#: A node whose timer counts: it publishes every 4 ms of the time on /clock.
TIMER = f"""{NODE}
node.create_subscription(WrenchStamped, '/torque', lambda message: None, 10)
publisher, count = node.create_publisher(Vector3Stamped, '/momentum', 10), [0]
def tick():
    count[0] += 1
    answer = Vector3Stamped()
    answer.header.stamp = node.get_clock().now().to_msg()
    answer.vector.x = float(count[0])
    publisher.publish(answer)
node.create_timer(0.004, tick)
{SPIN}"""
#: Nodes that answer each torque: at random, with another type than recorded, and until they die.
RANDOM, OTHER, DIES = (f"""{NODE}
import os, random
def draw(given, answer):
    answer.vector.x = random.random()
def die(given, answer):
    given.header.stamp.nanosec < 500_000_000 or os._exit(3)
on(WrenchStamped, {function}, '/momentum', {kind})
{SPIN}""" for function, kind in (
    ('draw', 'Vector3Stamped'), ('lambda *_: None', 'WrenchStamped'), ('die', 'Vector3Stamped')))
#: A node that publishes without end.
FLOOD = f"""{NODE}
publisher = node.create_publisher(Vector3Stamped, '/momentum', 10)
node.create_subscription(WrenchStamped, '/torque', lambda message: None, 10)
node.create_timer(float(sys.argv[2]), lambda: [
    publisher.publish(Vector3Stamped()) for _ in range(1000)])
{SPIN}"""
#: An argument that no other command on this machine uses.
MARK = f'98764.{os.getpid()}'


def command(code, argument=GAIN, mark=MARK):
    return [sys.executable, '-c', code, mark, str(argument)]


def torques():
    return np.random.default_rng(1).normal(size=(COUNT, 6))


def momenta(gain=GAIN):
    values = [np.zeros(3)]
    for torque in torques()[:, 3:]:
        values.append(gain * values[-1] + torque)
    return np.array(values[1:])


def write(path, answers=None):
    """Write a recording of both nodes, whose outputs are logged a little after their inputs."""
    attitudes = np.random.default_rng(2).normal(size=(COUNT, messages.ODOMETRY.doubles))
    answers = momenta() if answers is None else answers
    control = np.zeros((COUNT, 6))
    with recording.Writer(path) as writer:
        for topic, kind, delay_ns, rows in (
                ('/torque', messages.WRENCH, 0, torques()),
                ('/momentum', messages.VECTOR3, 1_200_000, answers),
                ('/odometry', messages.ODOMETRY, 300, attitudes),
                ('/control', messages.WRENCH, 1_300_000, control)):
            writer.add_topic(topic, kind)
            for stamp_ns, values in zip(STAMPS_NS.tolist(), rows):
                writer.write(topic, stamp_ns + delay_ns, kind.encode(stamp_ns, 'body', values))
    return path


@pytest.fixture
def path(tmp_path):
    return write(tmp_path / 'recording.mcap')


def arguments(path, *options, node=None):
    return [*map(str, (path, '--open-loop', *options)), '--', *(node or command(ESTIMATOR))]


def run(path, *options, node=None):
    return main.attitude_regress(arguments(path, *options, node=node))


@pytest.fixture
def refused(refusal):
    """Return a function that returns the line of an error."""
    return lambda *words, **node: refusal('attitude_regress', *arguments(*words, **node))


def first_of(found, expected, field):
    """Return how the result names the first difference between vectors."""
    number, axis = np.argwhere(found != expected)[0]
    values = (f'{which} {float(values[number, axis])!r}'
              for which, values in (('expected', expected), ('found', found)))
    return f' at {STAMPS_NS[number]} ns, message {number}, {field}.{"xyz"[axis]}: ' \
        f'{", ".join(values)}'


def result_of(tmp_path):
    return json.loads((tmp_path / 'result.json').read_text())


@pytest.mark.slow
def test_an_estimator_publishes_what_it_published(path, tmp_path, capsys, refused):
    # A type that is not installed matters only to its node.
    recorded, other = AllMessages(path), tmp_path / 'other.mcap'
    recorded.topics['/odometry'].schema.name = 'absent_msgs/msg/Odometry'
    recorded.write(other, {})
    assert AllMessages(other).topics['/odometry'].type_name == 'absent_msgs/msg/Odometry'
    assert run(other, '--json', tmp_path / 'result.json', '--report', tmp_path / 'page.html') == 0
    assert result_of(tmp_path) == {
        'equal': True, 'inputs': {'/torque': COUNT},
        'outputs': {'/momentum': {'messages': COUNT, 'same': COUNT}},
        'first_difference': None, 'reproducible': None}
    assert capsys.readouterr().out.splitlines()[:3] == [
        'result        the outputs are the same', f'fed           {COUNT} messages on /torque',
        f'compared      {COUNT} of {COUNT} messages on /momentum are the same']
    assert 'The outputs are the same' in (tmp_path / 'page.html').read_text()
    assert not running(MARK)
    assert '/odometry: expected absent_msgs/msg/Odometry as in the recording' \
        in refused(other, node=command(CONTROLLER))


@pytest.mark.slow
def test_one_unit_in_the_last_place_is_found_at_its_stamp_and_field(tmp_path, capsys):
    number, answers = 41, momenta()
    found = answers[number, 1]
    answers[number, 1] = np.nextafter(found, 9.0)
    path = write(tmp_path / 'recording.mcap', answers)
    assert run(path, '--json', tmp_path / 'result.json') == 1
    assert result_of(tmp_path)['first_difference'] == {
        'topic': '/momentum', 'stamp_ns': int(STAMPS_NS[number]), 'number': number,
        'field': 'vector.y', 'expected': repr(float(answers[number, 1])),
        'found': repr(float(found))}
    assert result_of(tmp_path)['outputs'] == {'/momentum': {'messages': COUNT, 'same': COUNT - 1}}
    assert result_of(tmp_path)['reproducible']
    output, error = capsys.readouterr()
    assert f'first         /momentum at {STAMPS_NS[number]} ns, message {number}, vector.y: ' \
        in output
    assert 'second run    is the same as the first' in output
    assert error == 'attitude_regress: the outputs differ from the recording\n'


@pytest.mark.nightly
@pytest.mark.parametrize(('field', 'status'), [
    ('vector.y=1e-12', 0), ('/momentum:vector=1e-12', 0), ('vector.x=1,header=1', 1), ('vec=1', 1),
    ('/torque:vector.y=1', 1), ('vector.y=0', 1)])
def test_a_tolerance_is_that_of_its_field(tmp_path, field, status):
    answers = momenta()
    answers[7, 1] = np.nextafter(answers[7, 1], 9.0)
    assert run(write(tmp_path / 'recording.mcap', answers), '--tolerance', field) == status


@pytest.mark.slow
def test_an_update_writes_the_outputs_of_now_and_keeps_the_rest(path, capsys):
    recorded = AllMessages(path)
    assert run(path, *UPDATE, node=command(CONTROLLER, 0.5)) == 0
    updated = AllMessages(path)
    assert [*updated.topics] == [*recorded.topics]
    for topic in {*recorded.topics} - {'/control'}:
        assert updated.topics[topic].data == recorded.topics[topic].data
        assert updated.topics[topic].log_ns.tolist() == recorded.topics[topic].log_ns.tolist()
    values = recording.read(path, '/odometry', messages.ODOMETRY).values
    before, after = (-gain * values[:, 3:6] - 0.3 * values[:, 46:49]
                     for gain in (0.5, math.nextafter(0.5, 1.0)))
    control = recording.read(path, '/control', messages.WRENCH).values
    np.testing.assert_array_equal(control[:, 3:], before)
    assert updated.topics['/control'].log_ns.tolist() == (STAMPS_NS + 300).tolist()
    capsys.readouterr()
    assert run(path, node=command(CONTROLLER, math.nextafter(0.5, 1.0))) == 1
    assert first_of(after, before, 'wrench.torque') in capsys.readouterr().out


@pytest.mark.slow
def test_a_timer_follows_the_clock(path, refused):
    timer = command(TIMER, mark=f'{MARK} clock')
    assert run(path, *UPDATE, '--step', '0.002', node=timer) == 0
    values = recording.read(path, '/momentum', messages.VECTOR3).values
    assert len(values) == pytest.approx((COUNT - 1) * 10 / 4, abs=2)
    assert values[:, 0].tolist() == [*range(1, len(values) + 1)]
    assert '--step: expected a node that subscribes to /clock' in refused(path, '--step', 0.002)


@pytest.mark.slow
def test_a_node_that_is_not_reproducible_is_called_so(path, capsys):
    before = path.read_bytes()
    assert run(path, *UPDATE, node=command(RANDOM)) == 1
    assert 'the node is not reproducible: two runs differ from' in capsys.readouterr().err
    assert path.read_bytes() == before


@pytest.mark.slow
@pytest.mark.parametrize(('node', 'options', 'line'), [
    (['no-such-command'], [], 'no-such-command: cannot be started: No such file or directory'),
    (command(DIES), [], 'expected a node that runs to the end of the recording, found that it '
     'ended with exit status 3; its inputs reach 0.37 s of the recording'),
    (['sleep', MARK], ['--timeout', '12'], 'sleep: expected the recording to end within --timeout '
     '12 s, found that no node subscribes to one recorded topic and publishes another: nothing '
     'publishes /control, /momentum, /odometry, /torque'),
    (command(FLOOD, 0.01), [], '/momentum: expected about as many messages as in the recording, '
     'found more than 1000 before'),
    (command(OTHER), [], '/momentum: expected geometry_msgs/msg/Vector3Stamped as in the '
     'recording, found that /own uses geometry_msgs/msg/WrenchStamped')])
def test_a_node_that_fails_is_one_line(path, refused, node, options, line):
    assert line in refused(path, *options, node=node)
    assert not running(MARK)


@pytest.mark.parametrize(('options', 'line'), [
    (['--update'], "expected the command of a node after '--', found none"),
    (['--scene', 'b', '--', 'c'], '--scene: expected no --open-loop, found it'),
    (['--tolerance', '1', '--', 'c'],
     '--tolerance: expected FIELD=VALUE,... with --open-loop, found 1'),
    (['--duration', '1', '--', 'c'], '--duration: expected no --open-loop, found it'),
    (['--tolerance', 'a', '--', 'c'], "expected a number from 0 to 3.15, found 'a'"),
    (['--tolerance', 'a=-1', '--', 'c'], "expected FIELD=VALUE,..., found 'a=-1'"),
    (['--step', '0', '--', 'c'], 'expected a number from 1e-09'),
    (['--', 'c'], 'a.mcap: cannot read the recording: No such file or directory')])
def test_mistakes(tmp_path, monkeypatch, capsys, options, line):
    monkeypatch.chdir(tmp_path)
    with suppress(SystemExit):
        assert main.attitude_regress(['a.mcap', '--open-loop', *options]) == 2
    assert line in capsys.readouterr().err.splitlines()[-1]
    assert not [*tmp_path.iterdir()]


def test_what_cannot_be_fed_or_replaced_is_one_line(path, tmp_path, refused):
    table, cut, before = tmp_path / 'table.csv', tmp_path / 'cut.mcap', path.read_bytes()
    table.write_text('0,1,2,3\n')
    cut.write_bytes(before[:-9])
    assert 'expected an MCAP file' in refused(table)
    assert 'expected a complete recording, found: ' in refused(cut)
    assert f'{path}: output exists; ' in refused(path, '--update')
    assert path.read_bytes() == before


def test_fields_are_those_of_arrays_too():
    from rigid_body_ros.node.open_loop import fields_of
    data = serialize_message(String(data='text'))
    assert deserialize_message(data, String).data == 'text'
    assert fields_of('/a', 'std_msgs/msg/String', data) == {'data': 'text'}
    odometry = messages.ODOMETRY.encode(5 * SECOND, 'map', np.arange(messages.ODOMETRY.doubles))
    fields = fields_of('/a', 'nav_msgs/msg/Odometry', odometry)
    assert fields['header.stamp.sec'] == 5
    assert fields['pose.pose.orientation.w'] == 6.0
    assert type(fields['pose.covariance[35]']) is float
