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

"""The node `attitude_monitor`: its outputs, and what it reports about its inputs."""

from collections import Counter
import json
import subprocess
import time

from conftest import at_night, SECOND
from geometry_msgs.msg import Vector3Stamped
from monitor_session import (
    BEGIN_NS,
    campaign,
    find,
    is_over,
    NAMES,
    PATIENCE,
    Session,
    shifted,
    stream,
    TOPICS,
    WITH_CLOCK,
)
import numpy as np
import pytest
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rigid_body_ros import messages, recording
from rigid_body_ros.commands import main
from rigid_body_ros.inference.monitor import Monitor, settings_of
from rigid_body_ros.node.attitude_monitor import AttitudeMonitor
from rigid_body_ros.recording import Writer
from rigid_body_ros.recording.quantities import of_messages
from sensor_msgs.msg import Imu

pytestmark = pytest.mark.ros


def compared(folder, found):
    """Return the result of attitude_compare for a recording of the same messages."""
    with Writer(folder / 'flight.mcap') as writer:
        for topic, (_, kind) in TOPICS.items():
            writer.add_topic(topic, kind)
        for stamp_ns, topic, data in found:
            writer.write(topic, stamp_ns, data)
    assert not main.attitude_compare([
        str(folder / 'flight.mcap'), '--scene', str(folder / 'scene.yaml'), '--measured', '/mocap',
        '--measured', '/gyro', '--horizon', '2', '--json', str(folder / 'found.json')])
    horizon, = json.loads((folder / 'found.json').read_text())['horizons']
    return horizon['monitor']


def expected(session, found):
    """Return the result of a monitor without ROS for the same messages, sorted by stamp."""
    monitor = Monitor(session.scene.problem(), settings_of(session.scene.values),
                      session.scene.actuators or ())
    for stamp_ns, topic, data in found:
        kind = TOPICS[topic][1]
        values = kind.decode(data).values[None]
        if topic == '/torque':
            monitor.apply([stamp_ns], values[:, 3:])
        else:
            recorded = recording.Messages(topic, np.array([stamp_ns]), np.zeros(1, int), [''],
                                          values)
            samples = of_messages(recorded, kind)
            monitor.measure(topic, [stamp_ns], samples.attitude, samples.rates)
    return [*monitor.judgements()]


@pytest.mark.parametrize('actuator', [None, *at_night(
    {'topics': ['/torque'], 'delay': 0.03, 'time_constant': 0.02, 'limit': {'x': 0.02}})])
def test_a_right_model_is_explained_with_the_bits_of_the_offline_twin(tmp_path, domain, actuator):
    found = stream(60)
    random = np.random.default_rng(6)
    order = sorted(found, key=lambda message: message[0] + int(random.integers(0, SECOND // 4)))
    others = {'actuator': actuator} if actuator else {}
    with Session(tmp_path / 'scene.yaml', domain, **others) as session:
        session.play(order)
        twin = expected(session, found)
        session.wait(session.has_judged, len(twin))
        rejected = {name: session.values(name)['rejected: late'] for name in NAMES}
        assert not any(rejected.values()), rejected
        for name in ('attitude', 'rate'):
            published = [messages.VECTOR3.decode(data)
                         for data in session.errors[f'{name}_error']]
            assert [one.stamp_ns for one in published] == [one.error.end_ns for one in twin]
            np.testing.assert_array_equal([one.values for one in published],
                                          [getattr(one.error, name) for one in twin])
        twin = compared(tmp_path, found)[:len(twin)]
        assert [one['rate_error_rad_s'] for one in twin] == [
            one.values.tolist() for one in published]
        if not actuator:
            session.wait(lambda: session.status('model').message.startswith('the model explains'))
            assert session.status('model').level == b'\x00'
        assert session.stop() == 0


def test_an_imu_as_people_send_it_is_judged_or_named(tmp_path, domain):
    imu, found = messages.IMU, []
    for number, (stamp_ns, topic, data) in enumerate(stream(20)):
        found.append((stamp_ns, topic, data))
        if topic == '/gyro':
            values = np.zeros(imu.doubles)
            values[3], values[13:16] = 1.0, messages.VECTOR3.decode(data).values
            found.append((stamp_ns, '/imu', imu.encode(stamp_ns, '/base_link', values)))
            found += [found[-1]] * (number % 20 == 0)  # the same stamp twice
    measured = {'measured': ['/mocap', '/gyro', '/imu'], 'window': 2.0,
                'attitude_noise': campaign.ATTITUDE_NOISE, 'rate_noise': campaign.RATE_NOISE}
    with Session(tmp_path / 'scene.yaml', domain, monitor=measured) as session:
        session.names = *NAMES, 'measured /imu'
        session.publishers['/imu'] = session.node.create_publisher(Imu, '/imu', 10_000)
        session.wait(lambda: session.publishers['/imu'].get_subscription_count() == 1)
        session.play(found)
        session.wait(session.has_judged, 8)
        session.wait(lambda: '/imu: the attitude is not used' in session.status('model').message)
        session.wait(lambda: 'samples have the same stamp as a later one'
                     in session.status('measured /imu').message)
        assert session.values('measured /imu')['rejected: unknown frame'] == 0
        assert b'\x02' not in session.levels()
        assert session.stop() == 0


@pytest.mark.nightly
def test_a_wrong_torque_is_found_and_the_check_goes_on_without_a_sensor(tmp_path, domain):
    wrong = stream(60, **campaign.ERRORS['torque of 1 mN m about x'])
    with Session(tmp_path / 'scene.yaml', domain) as session:
        first = [message for message in wrong if message[0] < BEGIN_NS + 30 * SECOND]
        session.play(first)
        session.wait(lambda: session.status('model').level == b'\x02')
        assert 'sigma' in session.status('model').message
        session.wait(lambda: 'first suspect: torque_bias' in session.status('model').message)
        values = {pair.key: pair.value for pair in session.status('model').values}
        assert values['first suspect'].startswith('torque_bias (')
        # The mocap sends only invalid messages: its status says so, and the check continues.
        session.play([(stamp_ns, topic, messages.QUATERNION.encode(
            stamp_ns, 'nowhere', (0.0, 0.0, 0.0, 1.0)) if topic == '/mocap' else data)
            for stamp_ns, topic, data in wrong[len(first):]])
        session.wait(session.is_silent, 'measured /mocap')
        assert len(session.errors['rate_error']) > len(session.errors['attitude_error'])
        # Kill and restart the monitor.
        session.process.kill()
        session.process.wait()
        session.start()
        session.connect()
        session.wait(lambda: session.status('model').message.startswith('no window yet'))
        assert session.stop() == 0


@pytest.mark.nightly
def test_what_falls_silent_is_named_and_is_no_error_of_the_model(tmp_path, domain):
    found = stream(60)
    with Session(tmp_path / 'scene.yaml', domain) as session:
        begin_ns = BEGIN_NS
        for topic, name in zip(TOPICS, NAMES):
            # Eight seconds with the topic, eight without it.
            middle_ns, end_ns = begin_ns + 8 * SECOND, begin_ns + 16 * SECOND
            session.play([message for message in found if begin_ns <= message[0] < end_ns
                          and (message[1] != topic or message[0] < middle_ns)])
            session.wait(session.is_silent, name)
            begin_ns = end_ns
        assert session.values('model')['windows skipped: no torque for longer than stale_after']
        session.play([message for message in found if message[0] >= begin_ns])
        session.wait(lambda: session.status('model').level == b'\x00')
        assert b'\x02' not in session.levels()
        # Publish only the time from here on.
        session.set_clock(found[-1][0] + 20 * SECOND)
        session.wait(lambda: session.status('model').message.startswith('no measurements since'))
        assert session.stop() == 0


@pytest.mark.nightly
def test_lost_torques_are_no_error_of_the_model(tmp_path, domain):
    found = stream(30)
    with Session(tmp_path / 'scene.yaml', domain,
                 **{'qos_overrides./torque.subscription.depth': 5}) as session:
        session.play(found[:find(found, 9)])
        _, topic, data = next(message for message in found[find(found, 9):]
                              if message[1] == '/torque')
        lost = session.values('torques')['lost']
        while session.values('torques')['lost'] == lost:
            for _ in range(200):
                session.publishers[topic].publish(data)
            session.received += 200
            session.wait(lambda: session.count() >= session.received)
        session.play(found[find(found, 9):])
        session.wait(lambda: session.values('model').get('windows skipped: torques lost'))
        assert b'\x02' not in session.levels()
        assert session.stop() == 0


@pytest.mark.nightly
def test_after_a_jump_of_simulated_time_the_check_begins_again(tmp_path, domain):
    found = stream(20)
    with Session(tmp_path / 'scene.yaml', domain, on_time_jump='reset') as session:
        session.play(found)
        for number, begin_ns in enumerate((BEGIN_NS, BEGIN_NS + 1000 * SECOND), 1):
            (_, topic, late), count = found[-1], len(session.errors['rate_error'])
            found = shifted(found, begin_ns - found[0][0])
            session.set_clock(begin_ns)
            session.wait(session.has_jumped, number)
            session.publishers[topic].publish(late)  # as if it was still in transit
            session.received += 1
            session.play(found)
            session.wait(session.has_judged, count + 6)
        counts = Counter()
        for name in NAMES:
            counts.update(session.values(name))
        assert counts['rejected: before the reset'] == 2
        assert not counts['rejected: late'] + counts['rejected: future']
        assert b'\x02' not in session.levels()
        assert session.stop() == 0


@pytest.mark.nightly
def test_steps_of_the_wall_clock_are_no_error_of_the_model(tmp_path, domain):
    path, steps, shift_ns, windows = tmp_path / 'shift', [-30.0, 100.0, -0.25], 0, 3
    path.write_text('0')
    with Session(tmp_path / 'scene.yaml', domain, WITH_CLOCK.format(str(path)),
                 on_time_jump='reset', use_sim_time=False) as session:
        for stamp_ns, topic, data in shifted(stream(120), time.time_ns() - BEGIN_NS):
            session.wait(is_over, time.time_ns, stamp_ns)
            (_, _, data), = shifted([(stamp_ns, topic, data)], shift_ns)
            session.publishers[topic].publish(data)
            if session.has_judged(windows):
                if not steps:
                    break
                shift_ns += round(steps.pop(0) * SECOND)
                windows += 3
                (tmp_path / 'next').write_text(str(shift_ns))
                (tmp_path / 'next').replace(path)
        assert not steps
        session.wait(session.has_jumped, 3)
        assert b'\x02' not in session.levels()
        assert session.stop() == 0


@pytest.mark.nightly
def test_restarts_of_the_sources_and_of_the_monitor_are_no_error_of_the_model(tmp_path, domain):
    found = stream(60)
    with Session(tmp_path / 'scene.yaml', domain) as session:
        session.play(found[:find(found, 15)])
        for publisher in session.publishers.values():
            session.node.destroy_publisher(publisher)
        session.publish()
        session.connect()
        session.play(found[find(found, 18):find(found, 33)])
        session.process.kill()
        session.process.wait()
        session.start()
        session.connect()
        count = len(session.errors['rate_error'])
        # As if the monitor discovers the publisher of torques last.
        session.play([message for message in found[find(found, 33.5):]
                      if message[1] != '/torque' or message[0] > BEGIN_NS + 37 * SECOND])
        session.wait(session.has_judged, count + 8)
        assert b'\x02' not in session.levels()
        assert session.stop() == 0


def test_a_message_without_a_stamp_has_the_time_at_which_the_middleware_received_it(context):
    values = {**{f'inertia.{name}': 1.0 for name in ('ixx', 'iyy', 'izz')},
              'monitor.measured': ['/gyro'], 'monitor.attitude_noise': 1e-3,
              'monitor.rate_noise': 1e-3,
              'qos_overrides./gyro.subscription.reliability': 'reliable'}
    monitor = AttitudeMonitor(context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in values.items()])
    publisher = monitor.create_publisher(Vector3Stamped, '/gyro', 10)
    inputs, until, stamps, times = monitor._inputs, time.monotonic() + PATIENCE, [], []
    while not publisher.get_subscription_count():
        assert time.monotonic() < until
        inputs.problems()
        inputs.intake.listen()
    # No executor waits for these topics: the monitor polls them all at once.
    polled = {subscription.topic_name for subscription in inputs.intake.subscriptions}
    assert polled == {'/torque', '/gyro'}
    assert not polled & {subscription.topic_name for subscription in monitor.subscriptions}
    inputs.now_ns()
    for _ in range(3):
        times.append(time.time_ns())
        publisher.publish(messages.VECTOR3.encode(0, 'base_link', np.zeros(3)))
        assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
    times.append(time.time_ns())
    measure = inputs.monitor.measure
    inputs.monitor.measure = lambda topic, stamps_ns, *found: (
        stamps.extend(stamps_ns) or measure(topic, stamps_ns, *found))
    inputs.take()
    assert len(stamps) == 3
    assert all(first <= stamp <= last
               for first, stamp, last in zip(times, stamps, times[1:]))
    monitor.destroy_node()


def test_torques_of_another_type_are_received(tmp_path, domain):
    with Session(tmp_path / 'scene.yaml', domain) as session:
        session.node.destroy_publisher(session.publishers['/torque'])
        other = session.node.create_publisher(Vector3Stamped, '/torque', 10)
        session.wait(lambda: other.get_subscription_count() == 1)
        applied = session.values('torques')['applied']
        other.publish(messages.VECTOR3.encode(BEGIN_NS, 'base_link', np.full(3, 1e-3)))
        session.wait(lambda: session.values('torques')['applied'] == applied + 1)
        assert session.stop() == 0


@pytest.mark.parametrize(('line', 'words'), [
    ('monitor.rate_noise:=0.0', 'monitor.rate_noise: expected the standard deviation'),
    ('inertia_topic:=true', 'inertia_topic: expected false'),
    ('monitor.measured:=["a b"]', 'monitor.measured: expected names of topics'),
    ('monitor.measured:=["/imu", "/imu"]', 'monitor.measured: expected each topic once')])
def test_a_scene_that_cannot_be_checked_is_an_error_of_one_line(tmp_path, domain, line, words):
    session = Session(tmp_path / 'scene.yaml', domain)
    result = subprocess.run([*session._command, '-p', line], env=session._environment, check=False,
                            capture_output=True, text=True, timeout=PATIENCE)
    assert result.returncode == 2
    assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1
