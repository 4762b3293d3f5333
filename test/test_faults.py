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

"""Faults of other nodes are counted and logged, do not affect the motion, and a replay agrees."""

import re
import signal

from conftest import SECOND
from geometry_msgs.msg import QuaternionStamped, WrenchStamped
from live import decoded, finished, Session, TUMBLER
from live_session import ATTITUDE, COMMITTED, LiveSession, RELIABLE
import numpy as np
import pytest
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rigid_body_ros import messages, State

pytestmark = pytest.mark.ros
OK, WARN, ERROR = range(3)


def statuses(live):
    return [status for array in live.diagnostics for status in array.status]


def level_of(status):
    return int.from_bytes(status.level, 'little')


def checked(tmp_path, live):
    """End a session that replays with the same bits; return its run and what it logged."""
    run = finished(tmp_path, live)
    assert not [status for status in statuses(live)
                if status.message == 'OK' and level_of(status) != OK]
    assert all(np.isfinite(message.values).all() for topic, kind in (
        (ATTITUDE, messages.QUATERNION), (COMMITTED, messages.ODOMETRY))
        for message in decoded(live, topic, kind))
    return run, live.words()


def torques_of(live):
    """Return diagnostics of the torques that are published after this call."""
    asked_ns = live.now_ns()
    live.wait_until(lambda: live.diagnostics and asked_ns < Time.from_msg(
        live.diagnostics[-1].header.stamp).nanoseconds, 'a diagnosis')
    return live.diagnosis('torques')


def test_every_rejection_is_counted_under_its_cause(tmp_path, domain):
    with Session(TUMBLER, domain, *RELIABLE, '-p', 'stale_after:=0.0') as live:
        now_ns = live.now_ns()
        faults = {
            'malformed': [b'\0\1\0\0', b'\0\1\0\0' + bytes(40),
                          messages.wrench(now_ns, '', [1, 2, 3])[:-8]],
            'unknown frame': [messages.wrench(now_ns, 'map', [1, 0, 0])] * 2,
            'not finite': [messages.wrench(now_ns, '', [value, 0, 0])
                           for value in (np.nan, np.inf, -np.inf)],
            'too large': [messages.wrench(now_ns, '', [0, 1e30, 0])],
            'future': [messages.wrench(now_ns + 3600 * SECOND, '', [0, 1, 0])] * 4,
            'late': [messages.wrench(now_ns - 5 * SECOND, '', [0, 1, 0]),
                     messages.wrench(now_ns - 10 ** 6 * SECOND, '', [0, 1, 0])]}
        live.publish(now_ns, 'base_link', [0.01, 0.0, 0.0])
        for data in (data for group in faults.values() for data in group):
            live.publish_bytes(data)
        live.wait_for_torques(1 + sum(map(len, faults.values())))
        values, _, _ = torques_of(live)
        said = statuses(live)
        live.publish(live.now_ns(), 'world', [0.0, 0.01, 0.0])
        live.wait_for_torques(values['received'] + 1)
        _, later, _ = torques_of(live)
        run, words = checked(tmp_path, live)
    counted = {name.removeprefix('rejected: '): count for name, count in values.items()
               if name.startswith('rejected')}
    assert counted == {cause: len(faults.get(cause, ())) for cause in counted}
    assert values['received'] == 1 + sum(counted.values())
    assert values['applied'] == 1
    assert any(level_of(status) == ERROR and 'rejected: not finite' in status.message
               for status in said)
    assert later == OK
    assert len(run.accepted.stamps_ns) == 2
    for cause in faults:
        assert words.count(f' so far): {cause}: ') == 1  # logged once in five seconds
    for part in ('too large: expected a torque of at most 4.49e+07 N m', "found 'map'",
                 'not finite: expected a finite torque, found [nan, 0.0, 0.0', 's ahead of',
                 's older than the newest torque'):
        assert part in words, words


def test_duplicates_and_bursts_are_taken(tmp_path, domain):
    with Session(TUMBLER, domain, *RELIABLE) as live:
        begin_ns = live.now_ns()
        burst = [begin_ns + k * 10 ** 5 for k in range(900)]
        for stamp_ns in burst:
            live.publish(stamp_ns, '', [1e-3 * np.sin(stamp_ns * 1e-8), 0.01, 0.0])
        for stamp_ns in burst[::100]:
            live.publish(stamp_ns, '', [0.0, 0.0, 0.02])
        live.wait_until(lambda: len(live.torques) == 909, 'all torques')
        live.spin(1.5)
        live.publish(live.now_ns(), '', [0.0, 0.0, 0.0])  # makes the earlier torques final
        live.wait_until(lambda: len(live.received[COMMITTED]) == 901, 'all states')
        values, _, _ = torques_of(live)
        said = ' '.join(status.message for status in statuses(live))
        run, _ = checked(tmp_path, live)
    assert values['replaced (same stamp)'] == 9
    assert 'replaced (same stamp)' in said
    assert values['applied'] == 910
    assert len(run.stamps_ns) == 902


def test_a_publisher_dies_and_returns_and_two_are_named(tmp_path, domain):
    with Session(TUMBLER, domain, *RELIABLE, '-p', 'stale_after:=0.0') as live:
        live.publish(live.now_ns(), '', [0.01, 0.0, 0.0])
        live.wait_for_torques(1)
        live.disconnect()
        live.wait_until(lambda: '/torque: no publisher' in torques_of(live)[2], 'its absence')
        first = live.node.create_publisher(WrenchStamped, 'torque', 10)
        live.wait_until(lambda: torques_of(live)[1] == OK, 'its return')
        second = live.node.create_publisher(WrenchStamped, 'torque', 10)
        live.wait_until(lambda: torques_of(live)[1] == WARN, 'a warning')
        text = torques_of(live)[2]
        for number, publisher in enumerate((first, second, first, second)):
            publisher.publish(messages.wrench(live.now_ns(), '', [0.0, 0.01 * number, 0.0]))
            live.spin(0.05)
        live.wait_for_torques(5)
        run, words = checked(tmp_path, live)
    assert '/torque: 2 publishers: /live_session, /live_session' in text
    assert text in words
    assert len(run.accepted.stamps_ns) == 5


def test_incompatible_qos_is_reported_by_name(domain):
    with Session(TUMBLER, domain, *RELIABLE) as live:
        live.disconnect()
        live.node.create_publisher(WrenchStamped, 'torque', QoSProfile(
            depth=10, reliability=ReliabilityPolicy.BEST_EFFORT),
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False))
        live.node.create_subscription(
            QuaternionStamped, 'attitude', lambda message: None,
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False))
        live.wait_until(lambda: torques_of(live)[2].count('is not connected') == 2, 'a diagnosis')
        _, level, text = torques_of(live)
        words = live.end()
    assert level == WARN
    assert '/torque: /live_session is not connected: Best effort publisher and reliable ' in text
    assert '/attitude: /live_session is not connected: Volatile publisher and transient' in text
    assert words.count('is not connected') == 2


@pytest.mark.nightly
def test_lost_torques_are_counted(tmp_path, domain):
    with LiveSession(TUMBLER, domain) as live:
        live.disconnect()
        publisher = live.node.create_publisher(WrenchStamped, 'torque', QoSProfile(
            depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT))
        live.wait_until(publisher.get_subscription_count, 'the node')
        lost = 0
        for _ in range(10):  # DDS takes a node that stops for too long for dead
            live.process.send_signal(signal.SIGSTOP)
            for _ in range(20_000):  # more than all buffers can hold
                publisher.publish(messages.wrench(live.now_ns(), '', [1e-3, 0.0, 0.0]))
            live.process.send_signal(signal.SIGCONT)
            live.spin(1.0)
            publisher.publish(messages.wrench(live.now_ns(), '', [1e-3, 0.0, 0.0]))
            lost = torques_of(live)[0]['lost']
            if lost:
                break
        _, words = checked(tmp_path, live)
    assert lost > 1000
    assert 'torques lost so far: ' in words


@pytest.mark.nightly
def test_a_body_beyond_all_bounds_does_not_end_the_node(domain):
    with LiveSession(TUMBLER, domain, *RELIABLE, '-p', 'solver:=rk4', '-p', 'max_step:=0.05',
                     '-p', 'history:=0.6') as live:
        live.set_state(State(0, (0, 0, 0, 1), (2e9, 0.0, 0.0)))
        live.publish(live.now_ns(), '', [3e7, 0.0, 2e7])
        for _ in range(10):
            live.spin(0.25)
            live.publish(live.now_ns(), '', [0.0, 1e-3, 0.0])
        live.spin(0.5)
        values, _, _ = torques_of(live)
        states, _, _ = live.diagnosis('motion')
        assert live.reset().success
        live.publish(live.now_ns(), '', [0.0, 1e-3, 0.0])
        count = len(live.received[ATTITUDE])
        live.wait_until(lambda: len(live.received[ATTITUDE]) > count + 10, 'the motion again')
        words = live.end()
    assert live.process.returncode == 0
    assert 'initial_state rejected: too large: expected at most 1e+09 rad/s' in words
    assert values['rejected: state not computable'] > 0
    assert states['initial states rejected'] == 1
    assert any('initial states rejected' in status.message and level_of(status) == ERROR
               for status in statuses(live))
    assert values['received'] == values['applied'] + sum(
        number for name, number in values.items() if name.startswith('rejected'))


def test_a_motion_that_is_too_fast_does_not_block_services(domain):
    with LiveSession(TUMBLER, domain, *RELIABLE) as live:
        live.publish(live.now_ns(), '', [1e6, 0.0, 0.0])
        live.wait_until(lambda: live.diagnosis('motion')[0]['deadlines missed'], 'a diagnosis')
        _, level, text = live.diagnosis('motion')
        # It publishes the newest states that it has computed, under their own stamps.
        begun = len(live.received[ATTITUDE])
        live.wait_until(lambda: len(live.received[ATTITUDE]) > begun + 3, 'states that are late')
        late = decoded(live, ATTITUDE, messages.QUATERNION)[begun:]
        # The node still responds to parameter and service calls, and accepts torques.
        assert live.parameters('solver')
        assert live.reset().success
        live.publish(live.now_ns(), '', [0.0, 0.0, 0.0])
        count = len(live.received[ATTITUDE])
        live.wait_until(lambda: len(live.received[ATTITUDE]) > count + 10, 'the motion again')
        # A motion that is too fast does not block the shutdown either.
        missed = live.diagnosis('motion')[0]['deadlines missed']
        live.publish(live.now_ns(), '', [1e6, 0.0, 0.0])
        live.wait_until(lambda: live.diagnosis('motion')[0]['deadlines missed'] > missed, 'misses')
        words = live.end()
    assert level == ERROR
    assert 'Traceback' not in words
    assert np.all(np.diff([message.stamp_ns for message in late]) > 0)
    assert re.match(r'deadlines missed: [1-9]', text)
    # On a busy machine, the node cannot tell which of the two is the cause.
    assert re.search('cannot keep up: (the body spins too fast|other processes keep).*; the '
                     'states are .* s late, [0-9]+ torques wait, and computing took [0-9]+% of '
                     'the last [0-9.e+]+ s', words)
    assert live.process.returncode == 0
