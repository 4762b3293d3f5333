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


"""A closed loop in lockstep is one chain of states, with the same bits however it is started."""

from contextlib import contextmanager, ExitStack
import json
import signal
import subprocess
import sys
import time

from conftest import at_night, ROOT, SECOND
from geometry_msgs.msg import WrenchStamped
from live import finished, options, stamps_of, TUMBLER, tumbler
from live_session import ACCEPTED, ATTITUDE, COMMITTED, LiveSession
from nav_msgs.msg import Odometry
import numpy as np
from pid_controller import Pid, STEP
import pytest
from rigid_body_ros import messages, Propagator, State
from rigid_body_ros.live import closed_loop
from rigid_body_ros.live.closed_loop import DuplicateFilter, RepublishPolicy
from rigid_body_ros.live.inputs import Torque
from rigid_body_ros.live.torque_queue import UNKNOWN_SENDER

pytestmark = pytest.mark.ros
STEP_NS, END_NS = round(STEP * 1e9), 4 * SECOND
LOCKSTEP = options(f'mode:=lockstep step:={STEP}')
#: s; period of the heartbeats of Fast DDS, after which late messages are delivered.
HEARTBEAT = 3.0
#: End of a run that does not end by itself.
FOREVER = 10 ** 18


@contextmanager
def controller(tmp_path, domain, *arguments, until=END_NS):
    """Run the controller in a separate process."""
    environment = LiveSession(TUMBLER, domain).environment
    process = subprocess.Popen([sys.executable, ROOT / 'test' / 'pid_controller.py',
                                tmp_path / 'memory.json', '--until', str(until), *arguments],
                               env=environment)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def session(domain, *arguments):
    """Return a session without a publisher of torques, which would be a second controller."""
    return LiveSession(TUMBLER, domain, *LOCKSTEP, *arguments)


def expected():
    """Close the loop without ROS; return its stamps and states, attitude and rates."""
    problem, law, states = tumbler([0], [[0.0, 0.0, 0.0]]), Pid(), []
    propagator = Propagator(problem.body, problem.start)
    for stamp_ns in range(0, END_NS, STEP_NS):
        state = propagator.at(stamp_ns)
        states.append([*state.attitude, *state.angular_velocity])
        propagator.apply(stamp_ns, law.torque(state.attitude[:3].tolist(),
                                              state.angular_velocity.tolist()))
    return [*range(0, END_NS, STEP_NS)], states


def ended(tmp_path, live, process):
    """Wait for the end of the controller, and compare the run with the loop without ROS."""
    live.wait_until(lambda: process.poll() is not None, 'the controller to end')
    assert process.returncode == 0
    run = finished(tmp_path, live)
    stamps, states = expected()
    assert run.accepted.stamps_ns.tolist() == stamps  # one torque for each stamp, in order
    assert json.loads((tmp_path / 'memory.json').read_text())[1] == stamps
    np.testing.assert_array_equal(run.committed, states)


@pytest.mark.nightly
@pytest.mark.parametrize('first_step', ['0', '0.6', str(HEARTBEAT)])
@pytest.mark.parametrize('attempt', [1, 2])
@pytest.mark.parametrize('is_node_first', [True, False])
def test_either_may_start_first(tmp_path, domain, first_step, attempt, is_node_first):
    with ExitStack() as stack:
        live = stack.enter_context(session(domain)) if is_node_first else None
        if live:
            live.disconnect()
            live.spin(0.3 * attempt)
        process = stack.enter_context(controller(tmp_path, domain, '--first-step', first_step))
        if not live:
            time.sleep(0.5 * attempt)
            live = stack.enter_context(session(domain))
            live.disconnect()
        ended(tmp_path, live, process)


def test_a_controller_that_is_killed_may_be_restarted(tmp_path, domain):
    with session(domain) as live:
        live.disconnect()
        with controller(tmp_path, domain, '--hang-at', str(2 * SECOND)) as process:
            live.wait_until(lambda: 2 * SECOND in stamps_of(live, ATTITUDE),
                            'the state that gets no torque')
            live.wait_until(lambda: 'no torque for' in live.diagnosis('torques')[2], 'a warning')
            assert live.diagnosis('torques')[1] == 1
            process.kill()  # DDS keeps its endpoints for a while
        with controller(tmp_path, domain) as process:
            ended(tmp_path, live, process)


@pytest.mark.nightly
def test_the_node_may_be_restarted(tmp_path, domain):
    with controller(tmp_path, domain, until=FOREVER) as process:
        stamps = []
        for _ in range(2):
            with session(domain) as live:
                live.disconnect()
                live.wait_until(lambda live=live: len(live.torques) > 200, 'a loop')
                live.process.send_signal(signal.SIGKILL)
                live.process.wait()
                live.spin(0.3)
                stamps.append(stamps_of(live, ACCEPTED))
        assert process.poll() is None
    for run in stamps:
        assert run == [*range(0, len(run) * STEP_NS, STEP_NS)]


@pytest.mark.parametrize('start_ns', [SECOND, *at_night(0)])
def test_a_reset_of_a_running_loop_takes_time_back(tmp_path, domain, start_ns):
    with session(domain, '-p', f'start_time:={start_ns}') as live:
        live.disconnect()
        with controller(tmp_path, domain, until=FOREVER):
            for number in range(2):
                count = len(live.torques)
                live.wait_until(lambda count=count: len(live.torques) > count + 100,
                                'the loop to go on')
                assert live.reset().success, number
            live.wait_until(lambda: len(live.received[COMMITTED]) > 100, 'committed states')
            live.spin(1.0)
        run = finished(tmp_path, live)
    markers = {*live.received[ACCEPTED]} - {*live.torques}
    assert markers == {messages.epoch_marker(run.problem.start)}  # the same start each time
    stamps = run.accepted.stamps_ns
    begins = np.flatnonzero(np.diff(stamps, prepend=2 ** 62) <= 0)
    runs = [part.tolist() for part in np.split(stamps, begins[1:])]
    runs = [part for part in runs if len(part) > 1]
    assert len(runs) == 3
    for part in runs:
        assert part == [*range(start_ns, start_ns + len(part) * STEP_NS, STEP_NS)]


@pytest.mark.nightly
def test_a_second_controller_is_named_and_starts_no_second_chain(tmp_path, domain):
    with session(domain) as live:
        live.disconnect()
        second = live.node.create_publisher(WrenchStamped, 'torque', 10)
        law = Pid()

        def on_state(data):
            state = messages.ODOMETRY.decode(data)
            second.publish(messages.wrench(state.stamp_ns, '', law.torque(
                (state.values[messages.ORIENTATION][:3] + 0.1).tolist(),
                state.values[messages.ANGULAR_VELOCITY].tolist())))
        live.node.create_subscription(Odometry, 'odometry', on_state, 10, raw=True)
        with controller(tmp_path, domain, until=FOREVER):
            live.wait_until(lambda: len(live.torques) > 1000, 'the loop')
            live.wait_until(lambda: '2 publishers: /live_session, /pid_controller; only the first '
                            'torque for each state is used' in live.diagnosis('torques')[2],
                            'a warning')
        live.spin(1.5)
        counts, _, _ = live.diagnosis('torques')
        run = finished(tmp_path, live)
    assert np.all(np.diff(run.accepted.stamps_ns) == STEP_NS)
    assert counts['rejected: duplicate, differs (same stamp)'] > 100


def test_a_long_response_misses_no_deadline_and_what_waits_ends_with_the_epoch(domain):
    with session(domain) as live:
        live.set_state(State(0, (0, 0, 0, 1), (1e5, 2e5, 3e5)))
        live.wait_until(lambda: live.received[ATTITUDE], 'the state')
        for seconds in (1, 1000, 1001):  # the response to the second takes long
            live.publish(seconds * SECOND, '', [0.0, 0.0, 1e-3])
        live.wait_until(lambda: live.diagnosis('torques')[0]['received'] == 3, 'the torques')
        live.wait_until(lambda: 'computing the response' in live.diagnosis('torques')[2],
                        'a warning')
        assert live.diagnosis('motion')[0]['deadlines missed'] == 0
        assert live.reset().success
        live.wait_until(lambda: live.diagnosis('torques')[0]['rejected: epoch ended'] == 1,
                        'the rejection')
        words = live.end()
    assert 'epoch ended: the epoch ended before this torque was applied' in words
    assert 'cannot keep up' not in words


def test_a_controller_slower_than_any_timeout_gets_one_response_for_each_state():
    duplicates, controller, accepted = DuplicateFilter(history_ns=10 ** 18), [0, 0], []
    duplicates.published(0)
    duplicates.published(0)  # again, while the controller works on the first
    for number in range(50):
        stamp_ns = controller.pop(0)
        torque = Torque(stamp_ns, np.array([1.0, 0.0, 1e-3 * number]), 'body')
        if duplicates.is_duplicate(torque, b'controller'):
            continue
        accepted.append(stamp_ns)
        duplicates.accepted(torque, b'controller')
        duplicates.responded(torque)
        for _ in range(1 + number % 3):  # the next state, with repetitions
            duplicates.published(stamp_ns + 1)
            controller.append(stamp_ns + 1)
    assert accepted == [*range(len(accepted))]
    assert len(accepted) > 20


def test_a_torque_gets_another_response_only_if_the_first_was_lost(monkeypatch):
    now = 0.0
    sent, corrected = (Torque(5, np.array([1.0, 0.0, 0.1 * k]), 'body') for k in range(2))
    monkeypatch.setattr(closed_loop.time, 'monotonic', lambda: now)
    duplicates = DuplicateFilter(history_ns=10)
    duplicates.published(5)
    assert not duplicates.is_duplicate(sent, b'one')
    duplicates.accepted(sent, b'one')
    assert duplicates.is_waiting(sent)
    # Another controller, or an unknown sender, sends its own torque.
    assert duplicates.is_duplicate(sent, b'two')
    assert duplicates.is_duplicate(sent, UNKNOWN_SENDER)
    # The response to a repetition may be in transit; a corrected torque needs a new response.
    assert duplicates.is_duplicate(sent, b'one')
    assert not duplicates.is_duplicate(corrected, b'one')
    duplicates.responded(sent)
    assert not duplicates.is_waiting(sent)
    now = 0.09
    assert duplicates.is_duplicate(sent, b'one')
    now = 0.11
    assert not duplicates.is_duplicate(sent, b'one')
    assert not duplicates.is_duplicate(corrected, b'one')
    # After newer stamps the record is dropped; without the record, the torque is not a duplicate.
    duplicates.accepted(Torque(15, sent.values, 'body'), b'one')
    assert duplicates.is_same(sent)
    duplicates.accepted(Torque(16, sent.values, 'body'), b'one')
    assert not duplicates.is_duplicate(sent, b'one')


def test_a_state_that_was_published_twice_may_get_two_torques():
    duplicates, torque = DuplicateFilter(history_ns=10), Torque(5, np.array([1.0, 0, 0]), 'body')
    for _ in range(2):
        duplicates.published(5)
    duplicates.accepted(torque, b'one')
    duplicates.responded(torque)
    other = torque._replace(values=2.0 * torque.values)
    assert [duplicates.is_duplicate(other, b'one') for _ in range(2)] == [True, False]


def test_without_a_controller_the_state_is_published_ten_times_a_second(monkeypatch):
    now, published = 0.0, []
    monkeypatch.setattr(closed_loop.time, 'monotonic', lambda: now)
    policy = RepublishPolicy()
    for tick in range(1, 200):  # 1 / 64 s
        now = tick / 64
        if policy.is_due(0, 1 if 64 <= tick < 128 else 0):
            published.append(tick)
            policy.published(is_repeated=True)
    # No repetition for half a second after a connection, which may be that of a controller.
    assert published == [*range(32, 64, 7), *range(96, 200, 7)]
    assert not policy.has_controller


@pytest.mark.parametrize(('seconds', 'connected', 'period', 'expected'), [
    # A killed controller that stays connected gets the state when it connects, and 4 s later. The
    # subscription of the second connects first: it gets the state when its publisher connects, and
    # then after 4 s and another 8 s, because it does not respond either.
    (30.0, lambda now: (1, 1) if now < 8.375 else (1, 2) if now < 8.75 else (2, 2), 100.0,
     [0.5, 4.5, 9.25, 13.25, 21.25]),
    # An observer connects to a loop with a slow controller.
    (20.0, lambda now: (1, 1) if now < 9.125 else (1, 2), 1.5, [0.5]),
    # Each state is delivered late.
    (60.0, lambda now: (1, 1), HEARTBEAT, [0.5])], ids=['restarted', 'observer', 'late'])
def test_a_state_is_repeated_only_for_a_controller_that_lacks_it(monkeypatch, seconds, connected,
                                                                 period, expected):
    now = 0.0
    monkeypatch.setattr(closed_loop.time, 'monotonic', lambda: now)
    policy, repeated = RepublishPolicy(), []
    for now in np.arange(0.0, seconds, 0.125).tolist():
        if now % period == 0.0:
            policy.published(is_repeated=False)
        if policy.is_due(*connected(now)):
            repeated.append(now)
            policy.published(is_repeated=True)
    assert repeated == expected


def test_a_repeated_torque_gets_the_lost_response_again(domain):
    with session(domain) as live:
        live.wait_until(lambda: stamps_of(live, ATTITUDE), 'the start state')
        for number in range(1, 11):  # a busy machine may send the two more than 0.1 s apart
            stamp_ns = number * SECOND
            live.publish(stamp_ns, '', [1e-3, 0.0, 0.0])
            live.publish(stamp_ns, '', [1e-3, 0.0, 0.0])  # at once, as a second chain would
            live.wait_until(lambda due=stamp_ns + STEP_NS: stamps_of(
                live, ATTITUDE)[-1] == due, 'an answer')
            live.spin(0.5)
            if stamps_of(live, ATTITUDE).count(stamp_ns + STEP_NS) == 1:
                break
        assert stamps_of(live, ATTITUDE).count(stamp_ns + STEP_NS) == 1
        live.publish(stamp_ns, '', [1e-3, 0.0, 0.0])  # later, as if the response was lost
        live.wait_until(lambda: stamps_of(live, ATTITUDE).count(stamp_ns + STEP_NS) == 2,
                        'the answer again')
        assert live.stop() == 0
    assert stamps_of(live, ACCEPTED).count(stamp_ns) == 2
