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

"""What the node reports and publishes if controllers fall silent, or send too many torques."""

import re

from conftest import SECOND
from geometry_msgs.msg import QuaternionStamped, WrenchStamped
from live import decoded, TUMBLER
from live_session import ACCEPTED, ATTITUDE, LiveSession, RELIABLE
import pytest
from rclpy.time import Time
from rigid_body_ros import messages
from test_faults import torques_of
from test_torque_topics import SOURCES, Sources

pytestmark = pytest.mark.ros
OK, WARN, ERROR = 0, 1, 2
HELD = [0.05, 0.0, 0.0]
LINE = re.compile(r'WARN.*/torque: no torque for 1[.0-9]* s: the last one, \[0.05, 0.0, 0.0\] N m '
                  r'in body axes, still acts \(stale_after: 1 s\)')


def stamp_ns(array):
    return Time.from_msg(array.header.stamp).nanoseconds


def first_warning(live, begin_ns):
    """Return the stamp, ns, of the first warning of a silence after a time, or None."""
    return next((stamp_ns(array) for array in live.diagnostics if stamp_ns(array) > begin_ns
                 and '/torque: no torque for' in array.status[0].message), None)


def test_a_connected_publisher_that_falls_silent_is_reported_until_its_next_torque(domain):
    delays = []
    with LiveSession(TUMBLER, domain, *RELIABLE) as live:
        for number in range(1, 4):
            begin_ns = live.now_ns()
            live.publish(begin_ns, '', HELD)
            live.wait_until(lambda since=begin_ns: first_warning(live, since), 'a warning')
            delays.append((first_warning(live, begin_ns) - begin_ns) * 1e-9)
            live.wait_until(lambda: re.search('no torque for [3-9]', live.diagnosis('torques')[2]),
                            'a longer silence')
            assert live.diagnosis('torques')[1] == WARN
            assert live.words().count('still acts') == len(LINE.findall(live.words())) == number
            live.publish(live.now_ns(), '', [0.0, 0.0, 0.0])  # no warning, because no torque acts
            live.wait_until(lambda: torques_of(live)[1:] == (OK, 'OK'), 'the end of the warning')
        live.spin(1.5)
        assert torques_of(live)[1:] == (OK, 'OK')
        assert live.stop() == 0
    assert min(delays) > 1.0
    assert sorted(delays)[1] < 1.5  # a busy machine may delay one


@pytest.mark.nightly
def test_a_slow_source_can_raise_the_limit_or_switch_it_off(domain):
    for limit in ('30.0', '0.0'):
        with LiveSession(TUMBLER, domain, '-p', f'stale_after:={limit}') as live:
            live.publish(live.now_ns(), '', HELD)
            live.wait_until(lambda: live.torques, 'the torque')
            live.spin(2.2)
            assert torques_of(live)[1:] == (OK, 'OK')
            status = live.diagnostics[-1].status[0]
            age, = (float(pair.value) for pair in status.values
                    if pair.key == 'age of the newest torque (s)')
            assert 2.0 < age < 20.0
            assert 'still acts' not in live.end()


def test_each_status_is_about_its_own_source(domain):
    with Sources(TUMBLER, domain, *SOURCES, '-p', 'torque_timeout:=1.5') as live:
        live.publish_on('disturbance', live.now_ns(), HELD)
        live.wait_until(lambda: live.accepted('disturbance'), 'the torque')
        live.wait_until(lambda: 'torque_timeout (1.5 s) has passed'
                        in live.diagnosis('torques_1')[2], 'the timeout')
        assert live.diagnosis('torques')[1:] == (OK, 'OK')
        assert live.diagnosis('wheel torques')[1:] == (OK, 'OK')
        live.node.destroy_publisher(live.publishers['wheel_torque'])
        live.wait_until(lambda: live.diagnosis('wheel torques')[2]
                        == '/wheel_torque: no publisher', 'a warning')
        assert live.diagnosis('torques')[1:] == (OK, 'OK')
        assert live.stop() == 0


def test_an_ordinary_reset_is_no_error(domain):
    with LiveSession(TUMBLER, domain, '-p', 'mode:=lockstep', '-p', 'step:=0.005') as live:
        live.publish(SECOND, '', HELD)
        live.wait_until(lambda: live.received[ATTITUDE] and decoded(
            live, ATTITUDE, messages.QUATERNION)[-1].stamp_ns > SECOND, 'the response')
        assert live.reset().success
        # As a controller would respond to a state from before the reset.
        live.publish(SECOND + 5_000_000, '', HELD)
        live.wait_until(lambda: live.diagnosis('torques')[0]['rejected: before the reset'] == 1,
                        'its rejection')
        found = {int.from_bytes(array.status[0].level, 'little') for array in live.diagnostics}
        assert live.stop() == 0
    assert ERROR not in found
    assert WARN in found


@pytest.mark.nightly
def test_outputs_go_on_while_torques_wait(domain):
    count, sent_at = 6000, {ACCEPTED: [], ATTITUDE: []}
    with LiveSession(TUMBLER, domain, *RELIABLE, '-p',
                     'qos_overrides./torque.subscription.depth:=100000') as live:
        for topic, kind in ((ACCEPTED, WrenchStamped), (ATTITUDE, QuaternionStamped)):
            live.node.create_subscription(kind, topic, lambda data, info, topic=topic: (
                sent_at[topic].append(info['source_timestamp'])), 100_000, raw=True)
        live.wait_until(lambda: sent_at[ATTITUDE], 'an output')
        begin_ns = live.now_ns()
        for number in range(count):  # work for some seconds, sent at once
            live.publish(begin_ns + number * 10_000, '', [1e-3, 0.0, 0.0])
        end_ns = live.now_ns()
        live.wait_until(lambda: len(sent_at[ACCEPTED]) == count, 'all torques')
        live.spin(0.5)
        assert live.stop() == 0
    # The time from sending all torques until the last is applied, by the clock of the node.
    last_ns = sent_at[ACCEPTED][-1]
    outputs = sum(end_ns < time_ns < last_ns for time_ns in sent_at[ATTITUDE])
    assert outputs >= 2.0 * (last_ns - end_ns) / SECOND


def test_a_controller_that_is_started_again_is_one_publisher(domain):
    with LiveSession(TUMBLER, domain, *RELIABLE) as live:
        if not publisher_is_known(live):
            pytest.skip('this middleware does not say who has sent a message')
        publishers = [live.node.create_publisher(WrenchStamped, 'torque', 10) for _ in range(2)]
        live.disconnect()
        for publisher in publishers:  # the first falls silent, but stays connected
            live.wait_until(publisher.get_subscription_count, 'the node')
            publisher.publish(messages.wrench(live.now_ns(), '', [1e-6, 0.0, 0.0]))
            live.wait_for_torques(1 + publishers.index(publisher))
        live.wait_until(lambda: 'publishers' not in torques_of(live)[2], 'one publisher')
        publishers[0].publish(messages.wrench(live.now_ns(), '', [1e-6, 0.0, 0.0]))
        live.wait_until(lambda: '/torque: 2 publishers' in torques_of(live)[2], 'two publishers')
        assert live.stop() == 0


def publisher_is_known(live):
    """Return whether the middleware reports the publisher of a message."""
    found = []
    live.node.create_subscription(WrenchStamped, 'probe', lambda data, info: found.append(info), 1)
    publisher = live.node.create_publisher(WrenchStamped, 'probe', 1)

    def has_arrived():
        publisher.publish(WrenchStamped())
        return found
    live.wait_until(has_arrived, 'a message')
    return 'publisher_gid' in found[0]
