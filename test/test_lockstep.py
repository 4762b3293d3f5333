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

"""Lockstep: every torque gets a response, and a closed loop always has the same numbers."""

from collections import Counter
import itertools
import subprocess

from conftest import program, SECOND
from diagnostic_msgs.msg import DiagnosticStatus
from live import decoded, EVERYTHING, finished, options, Session, TUMBLER, tumbler
from live_session import ATTITUDE, COMMITTED, LiveSession
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.parameter import Parameter
from rclpy.time import Time
from rigid_body_ros import messages, scene, State
from rigid_body_ros.live.run import Run
from rigid_body_ros.mechanics import so3
from rigid_body_ros.node import AttitudeNode
from rigid_body_ros.node.outputs import Publishers
from rigid_body_ros.propagation.segment import OutOfTimeError
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

pytestmark = pytest.mark.ros
LOCKSTEP = options('mode:=lockstep step:=0.02')
STEP_NS = SECOND // 50
#: A slew of 170 degrees about an axis that is not a principal axis.
SLEW = so3.exp(np.radians(170.0) * np.array([2.0, -1.0, 2.0]) / 3.0)
SLEW_SECONDS = 30.0


def lossy(send, count):
    """Return a callback that passes messages on, except for one in 200, which it counts."""
    def relay(data):
        count['seen'] += 1
        if count['seen'] % 200 == 100:
            count['lost'] += 1
        else:
            send(data)
    return relay


def closed_loop(tmp_path, domain, attitude, is_lossy=False):
    """Let the controller turn the body; return the committed states and the accepted torques."""
    start = ' '.join(f'initial_attitude.{name}:={value!r}'
                     for name, value in zip('xyzw', attitude.tolist()))
    with LiveSession(TUMBLER, domain, *options(f'mode:=lockstep step:=0.04 {start}')) as live:
        counts, remaps = (Counter(), Counter()), ()
        if is_lossy:
            states = live.node.create_publisher(Odometry, 'relayed_odometry', 10)
            live.node.create_subscription(Odometry, 'odometry', lossy(states.publish, counts[0]),
                                          10, raw=True)
            live.listen('relayed_torque', lossy(live.publish_bytes, counts[1]))
            remaps = ('-r', 'odometry:=relayed_odometry', '-r', 'torque:=relayed_torque')
        process = subprocess.Popen([*program('attitude_controller'), '--ros-args', '-p',
                                    f'stop_after:={SLEW_SECONDS}', *remaps], env=live.environment)
        live.wait_until(lambda: process.poll() is not None, 'the controller to end')
        assert process.returncode == 0
        assert not is_lossy or min(count['lost'] for count in counts) >= 3
        return finished(tmp_path, live)


@pytest.mark.nightly
def test_a_closed_loop_settles_and_gives_the_same_bits_though_messages_are_lost(tmp_path, domain):
    first = closed_loop(tmp_path, domain, SLEW)
    second = closed_loop(tmp_path, domain, SLEW, is_lossy=True)
    negative = closed_loop(tmp_path, domain, -SLEW)
    assert len(first.stamps_ns) == SLEW_SECONDS * 25
    np.testing.assert_array_equal(first.committed, second.committed)
    # q and -q are the same attitude, so the controller turns both the same way.
    np.testing.assert_array_equal(first.committed * [-1, -1, -1, -1, 1, 1, 1],
                                  negative.committed)
    attitude, rates = np.split(first.committed, [4], axis=1)
    to_go = so3.angle_between(attitude, np.array([0.0, 0.0, 0.0, 1.0]))
    assert to_go[-1] < 1e-4
    assert np.linalg.norm(rates[-1]) < 1e-4
    # The controller takes the short way: the remaining angle hardly grows at the beginning.
    assert to_go.max() < np.radians(180.0)


def responses(live):
    return [(message.stamp_ns, message.values.tolist()) for message in decoded(live, ATTITUDE)]


def ask(live, stamp_ns, torque):
    """Publish a torque and return the first response to it."""
    before = len(live.received[ATTITUDE])
    live.publish(stamp_ns, 'base_link', torque)
    live.wait_until(lambda: responses(live)[before:]
                    and responses(live)[-1][0] == stamp_ns + STEP_NS, 'a response')
    return responses(live)[-1]


def test_the_response_to_each_torque_is_the_state_one_step_later(domain):
    start_ns = 5 * SECOND
    with Session(TUMBLER, domain, *LOCKSTEP) as live:
        first = ask(live, start_ns, [0.01, 0.0, 0.0])
        second = ask(live, start_ns + STEP_NS, [0.0, 0.02, 0.0])
        count = len(responses(live))
        again = ask(live, start_ns + STEP_NS, [0.0, 0.02, 0.0])
        live.spin(0.2)
        assert len(responses(live)) == count + 1  # no repetition after the first torque
    at = [start_ns + STEP_NS, start_ns + 2 * STEP_NS]
    expected = tumbler([start_ns, at[0]], [[0.01, 0.0, 0.0], [0.0, 0.02, 0.0]]).propagate(
        at=at).attitude.tolist()
    assert [first, second] == [*zip(at, expected)]
    assert again == second


def test_a_pause_delays_the_responses_and_changes_no_bit(tmp_path, domain):
    with Session(TUMBLER, domain, *LOCKSTEP) as live:
        before = ask(live, SECOND, [0.01, 0.0, 0.0])
        for data, message in ((True, 'paused: torques wait'), (False, 'resumed')):
            response = live.call(SetBool, 'pause', data=data)
            assert (response.success, response.message) == (True, message)
            if data:
                live.publish(SECOND + STEP_NS, 'base_link', [0.0, 0.02, 0.0])
                live.wait_until(lambda: live.diagnosis('torques')[0]['waiting'] == 1, 'a torque')
                assert 'paused' in live.diagnosis('torques')[2]
                assert responses(live)[-1] == before
        live.wait_until(lambda: responses(live)[-1][0] == SECOND + 2 * STEP_NS, 'a response')
        assert live.call(SetBool, 'pause', data=True).success
        live.publish(2 * SECOND, 'base_link', [1.0, 0.0, 0.0])  # waits for ever
        live.diagnostics.clear()
        live.wait_until(lambda: live.diagnosis('torques')[0]['waiting'] == 1, 'a torque')
        run = finished(tmp_path, live)
    assert run.accepted.stamps_ns.tolist() == [SECOND, SECOND + STEP_NS]


def test_the_result_of_an_initial_state_is_published(domain):
    with Session(TUMBLER, domain, *LOCKSTEP) as live:
        results = []
        live.node.create_subscription(DiagnosticStatus, '/attitude_node/initial_state_result',
                                      results.append, EVERYTHING)
        ask(live, 10 * SECOND, [0.01, 0.0, 0.0])
        for time_ns, rate in ((10 * SECOND + 7, 0.1), (SECOND, 0.1), (0, 0.1), (5, 2e9)):
            live.set_state(State(time_ns, (0, 0, 0, 1), (rate, 0.0, 0.0)))
        live.wait_until(lambda: len(results) == 4, 'four results')
    levels = [DiagnosticStatus.OK, DiagnosticStatus.ERROR] * 2
    assert [result.level for result in results] == levels
    assert [result.values[0].value for result in results] == [
        '10000000007', '1000000000', '0', '5']
    assert {result.values[0].key for result in results} == {'stamp'}
    first, second, third, fourth = (result.message for result in results)
    assert first == 'initial_state received: a new epoch begins at 10000000007 ns'
    assert second.startswith('late: ')
    assert third == 'initial_state received: a new epoch begins at the stamp of the next torque'
    assert fourth == 'too large: expected at most 1e+09 rad/s, found [2000000000.0, 0.0, 0.0]'


@pytest.mark.nightly
def test_a_zero_torque_at_time_zero_is_a_torque_and_the_last_time_has_no_response(tmp_path,
                                                                                  domain):
    with Session(TUMBLER, domain, *LOCKSTEP) as live:
        live.publish(messages.LAST_NS, '', [1e-3, 0.0, 0.0])
        for stamp_ns, torque in ((0, 1e-3), (SECOND // 10, 2e-3), (SECOND // 5, -1e-3), (0, 0.0),
                                 (SECOND // 2, 1e-3)):
            ask(live, stamp_ns, [torque, 0.0, 0.0])
        run, words = finished(tmp_path, live), live.words()
    assert len(run.stamps_ns) == 4
    assert 'rejected (1 so far): future: stamped 2147483647999999999 ns' in words


def test_a_state_without_a_stamp_holds_at_the_first_torque(tmp_path, domain):
    with Session(TUMBLER, domain, *LOCKSTEP) as live:
        live.set_state(State(0, (0, 0, 1, 0), (0.5, 0.2, 0.0)))
        # Messages on two topics may arrive in either order.
        live.wait_until(lambda: responses(live)[-1:] == [(0, [0, 0, 1, 0])], 'the new state')
        for number in range(1, 4):
            ask(live, number * SECOND // 2, [0.0, 1e-3, 0.0])
        run = finished(tmp_path, live)
    assert run.stamps_ns.tolist() == [SECOND // 2, SECOND, 3 * SECOND // 2]
    assert run.committed[0].tolist() == [0, 0, 1, 0, 0.5, 0.2, 0]


def test_the_clock_is_that_of_the_responses_until_another_node_publishes_it(domain):
    with Session(TUMBLER, domain, *LOCKSTEP, '-p', 'publish_clock:=true') as live:
        times = []
        live.node.create_subscription(Clock, '/clock', lambda clock: times.append(
            Time.from_msg(clock.clock).nanoseconds), 10)
        for k in range(3):
            ask(live, SECOND + k * STEP_NS, [0.0, 0.0, 1e-3])
        live.wait_until(lambda: times[-1] == SECOND + 3 * STEP_NS, 'the last time')
        assert [time for time in times if time] == [SECOND + (k + 1) * STEP_NS for k in range(3)]
        live.wait_until(lambda: live.diagnostics and Time.from_msg(
            live.diagnostics[-1].header.stamp).nanoseconds == times[-1], 'a diagnosis')
        clock = live.node.create_publisher(Clock, '/clock', 10)
        for count in (2, 1):  # the node stops its own clock
            live.wait_until(lambda count=count: live.node.count_publishers('/clock') == count,
                            f'{count} clocks')
        assert clock.get_subscription_count() == 1  # that of this test
        assert ask(live, 2 * SECOND, [0.0, 0.0, 1e-3])  # the node itself continues
        words = live.end()
    assert '/clock: another node publishes it, too; this node stops publishing it' in words


def test_a_second_clock_is_rejected(domain):
    with Session(TUMBLER, domain, '-p', 'use_sim_time:=true') as live, pytest.raises(
            scene.InputError, match='^publish_clock: expected no other publisher of /clock, found '
            'live_session$'):
        AttitudeNode('second', context=live.node.context, parameter_overrides=[
            Parameter(name, value=value) for name, value in (
                ('mode', 'lockstep'), ('publish_clock', True), ('use_sim_time', False))])


def test_a_commit_that_takes_several_slices_repeats_neither_response_nor_log(context, monkeypatch):
    node = AttitudeNode(context=context, parameter_overrides=[
        *(Parameter(f'inertia.{name}', value=1.0) for name in ('ixx', 'iyy', 'izz')),
        Parameter('mode', value='lockstep'), Parameter('step', value=0.02)])
    found, mode, commit, slices = [], node._component._mode, Run.commit, itertools.count()

    def commit_at_the_third_slice(run, until):
        found.append('commit')
        if next(slices) % 3 < 2:
            raise OutOfTimeError(SECOND)
        commit(run, until)
    monkeypatch.setattr(Run, 'commit', commit_at_the_third_slice)
    monkeypatch.setattr(Publishers, 'publish', lambda *_: found.append('response'))
    monkeypatch.setattr(Publishers, 'log_torque', lambda *_: found.append('log'))
    for number in range(4):
        # So far apart that every torque but the first forces the states before it to be committed.
        mode.enqueue(messages.wrench((1 + 3 * number) * SECOND, '', [0.1, 0.0, 0.0]), None, 0)
    while not mode.process():
        pass
    # The response comes before the commit, because a controller waits for it.
    assert found == ['log', 'response'] + 3 * ['log', 'response', *3 * ['commit']]
    node.destroy_node()


def test_a_state_may_be_set_before_and_between_torques(tmp_path, domain):
    given = State(7 * SECOND, (0.5, -0.5, 0.5, 0.5), (0.1, 0.2, 0.3))
    with Session(TUMBLER, domain, *LOCKSTEP) as live:
        live.set_state(given)
        live.wait_until(lambda: live.received[COMMITTED], 'the new epoch')
        for k in range(5):
            ask(live, 7 * SECOND + k * STEP_NS, [0.01, 0.0, 1e-3 * k])
        # Between two torques, so that the torque in force continues to act.
        later = State(7 * SECOND + 4 * STEP_NS + 12345, (0, 0, 0, 1), (0.0, 0.1, 0.0))
        live.set_state(later)
        live.wait_until(lambda: responses(live)[-1] == (later.time_ns, [0, 0, 0, 1]),
                        'the new state')
        for k in range(5, 9):
            ask(live, 7 * SECOND + k * STEP_NS, [0.01, 0.0, 1e-3 * k])
        run = finished(tmp_path, live)
    assert run.stamps_ns.tolist() == [later.time_ns,
                                      *(7 * SECOND + k * STEP_NS for k in range(5, 9))]
    assert run.committed[0].tolist() == [0, 0, 0, 1, 0, 0.1, 0]
