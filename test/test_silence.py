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
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped, WrenchStamped
from live import decoded, Session, TUMBLER
from live_session import ACCEPTED, ATTITUDE, DIAGNOSTICS, LiveSession, RELIABLE
import numpy as np
import pytest
from rclpy.time import Time
from rigid_body_ros import messages
from test_faults import torques_of

pytestmark = pytest.mark.ros
OK, WARN, ERROR = 0, 1, 2
HELD = [0.05, 0.0, 0.0]
LINE = re.compile(r'WARN.*/torque: no torque for [.0-9]* s: the last one, \[0.05, 0.0, 0.0\] N m '
                  r'in body axes, still acts \(stale_after: 0.4 s\)')


def stamp_ns(array):
    return Time.from_msg(array.header.stamp).nanoseconds


def first_warning(live, begin_ns):
    """Return the stamp, ns, of the first warning of a silence after a time, or None."""
    return next((stamp_ns(array) for array in live.diagnostics if stamp_ns(array) > begin_ns
                 and '/torque: no torque for' in array.status[0].message), None)


def test_a_connected_publisher_that_falls_silent_is_reported_until_its_next_torque(domain):
    with Session(TUMBLER, domain, *RELIABLE, '-p', 'stale_after:=0.4') as live:
        for number in range(1, 3):
            begin_ns = live.now_ns()
            live.publish(begin_ns, '', HELD)
            live.wait_until(lambda since=begin_ns: first_warning(live, since), 'a warning')
            assert first_warning(live, begin_ns) - begin_ns > 0.4 * SECOND
            live.wait_until(lambda: re.search('no torque for [1-9]', live.diagnosis('torques')[2]),
                            'a longer silence')
            assert live.diagnosis('torques')[1] == WARN
            age, = (float(pair.value) for pair in live.diagnostics[-1].status[0].values
                    if pair.key == 'age of the newest torque (s)')
            assert age >= 1.0
            assert live.words().count('still acts') == len(LINE.findall(live.words())) == number
            live.publish(live.now_ns(), '', [0.0, 0.0, 0.0])  # no warning, because no torque acts
            live.wait_until(lambda: torques_of(live)[1:] == (OK, 'OK'), 'the end of the warning')
        live.spin(0.5)
        assert torques_of(live)[1:] == (OK, 'OK')
    # Diagnostics come once a second, and also when a source falls silent or sends again.
    assert np.diff([*map(stamp_ns, live.diagnostics)]).min() < 0.9 * SECOND


def test_an_ordinary_reset_is_no_error(domain):
    with Session(TUMBLER, domain, '-p', 'mode:=lockstep', '-p', 'step:=0.005') as live:
        live.publish(SECOND, '', HELD)
        live.wait_until(lambda: live.received[ATTITUDE] and decoded(
            live, ATTITUDE, messages.QUATERNION)[-1].stamp_ns > SECOND, 'the response')
        assert live.reset().success
        # As a controller would respond to a state from before the reset.
        live.publish(SECOND + 5_000_000, '', HELD)
        live.wait_until(lambda: live.diagnosis('torques')[0]['rejected: before the reset'] == 1,
                        'its rejection')
        found = {int.from_bytes(array.status[0].level, 'little') for array in live.diagnostics}
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
        found = []
        live.node.create_subscription(DiagnosticArray, DIAGNOSTICS,
                                      lambda data, info: found.append(info), 10)
        live.wait_until(lambda: found, 'a message')
        if 'publisher_gid' not in found[0]:
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
