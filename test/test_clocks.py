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

"""Clocks that are silent, stop, or jump ahead or back, and stamps from other clocks."""

from conftest import at_night, SECOND
from live import decoded, finished, options, same_bits, Session, stamps_of, TUMBLER
from live_session import ACCEPTED, ATTITUDE, COMMITTED, RELIABLE
import numpy as np
import pytest
from rclpy.parameter import Parameter
from rclpy.time import Time
from rigid_body_ros import messages, scene
from rigid_body_ros.node import AttitudeNode, clocks
from rigid_body_ros.node.clocks import ArrivalStamps, WatchedClock
from rigid_body_ros.node.diagnostics import OFFSETS

pytestmark = pytest.mark.ros
# A rate so high that the timer fires at every tick of the clock.
SIMULATED = (*RELIABLE, *options('use_sim_time:=true publish_rate:=2000.0'))


def settle(live, now_ns):
    """Publish a time until the node has published a state at this time."""
    live.hold_clock(now_ns, lambda: stamps_of(live, ATTITUDE)[-1:] == [now_ns],
                    'an attitude at the time of the clock')


def wobble(now_ns):
    return [0.01 * np.sin(now_ns * 1e-9), 0.02, 0.01]


def test_a_clock_that_is_not_yet_valid_and_one_that_stands(tmp_path, domain):
    with Session(TUMBLER, domain, *SIMULATED) as live:
        live.publish(5 * SECOND, '', [1.0, 0.0, 0.0])
        for _ in range(50):
            live.set_clock(0)  # means that there is no time yet
            live.spin(0.01)
        assert not any(live.received.values())
        live.start_clock(5 * SECOND)
        live.run_clock(5 * SECOND, 6 * SECOND, wobble)
        settle(live, 6 * SECOND)
        count = len(live.received[ATTITUDE])
        live.wait_until(lambda: 'it stands at 6000000000 ns' in live.diagnosis(
            'torques')[2], 'a warning')
        assert live.diagnosis('torques')[1] == 1
        assert len(live.received[ATTITUDE]) == count
        live.publish(6 * SECOND + 1, 'base_link', [0.0, 0.0, 0.05])  # is still accepted
        live.run_clock(6 * SECOND, 7 * SECOND, wobble)
        settle(live, 7 * SECOND)
        live.wait_until(lambda: 'not advanced' not in live.diagnosis('torques')[2],
                        'the end of the warning')
        run = finished(tmp_path, live)
    assert decoded(live, COMMITTED)[0].stamp_ns == 5 * SECOND
    assert len(live.torques) == 23
    assert 6 * SECOND + 1 in run.stamps_ns


@pytest.mark.parametrize(('action', 'again_ns'), [
    ('reset', 3600 * SECOND), ('rebase', 50 * SECOND), *at_night(
        ('rebase', 3600 * SECOND), ('ignore', 3600 * SECOND), ('ignore', 50 * SECOND),
        ('reset', 50 * SECOND), ('rebase', 203 * SECOND // 2), ('ignore', 203 * SECOND // 2))])
def test_a_clock_that_jumps(tmp_path, domain, action, again_ns):
    begin_ns, end_ns = 100 * SECOND, 102 * SECOND
    with Session(TUMBLER, domain, *SIMULATED, *options(
            f'torque_timeout:=0.5 on_time_jump:={action}')) as live:
        live.start_clock(begin_ns)
        live.run_clock(begin_ns, end_ns, wobble)
        settle(live, end_ns)
        before = decoded(live, ATTITUDE)[-1].values.tolist()
        if again_ns > end_ns:
            live.publish(again_ns, '', wobble(again_ns))  # arrives before the new clock time
        live.wait_until(lambda: end_ns in stamps_of(live, ACCEPTED),
                        'the last torque before the jump')
        live.run_clock(again_ns, again_ns + SECOND, wobble)
        live.dump_parameters(tmp_path / 'live.yaml')
        # Simulated time runs faster than real time, so a pause of the node may also look like a
        # jump ahead.
        live.wait_until(lambda: live.diagnosis('motion')[0]['clock jumps'], 'a diagnosis')
        live.wait_for_torques(21 + (again_ns > end_ns) + 11)
        torques, _, _ = live.diagnosis('torques')
        assert live.stop() == 0
        epochs = len(live.received[ACCEPTED]) - len(live.torques)  # one marker per epoch
        run = same_bits(tmp_path, live)
    assert np.all(np.diff(run.stamps_ns) > 0)
    assert torques['received'] == torques['applied'] + sum(
        count for name, count in torques.items() if name.startswith('rejected'))
    assert not torques['rejected: epoch ended']
    if action == 'ignore':
        assert (epochs, run.stamps_ns[0] < end_ns) == (1, True)
        # A torque older than the newest by `history` is late; other torques are inserted in order.
        assert bool(torques['rejected: late']) == (again_ns < end_ns - SECOND)
        return
    # A new epoch, and a new log. The carried-over torque and the first new one share a stamp.
    assert (epochs, torques['replaced (same stamp)']) == (2, int(again_ns > end_ns))
    assert again_ns <= run.stamps_ns[0] < again_ns + SECOND
    assert len(run.stamps_ns) > 10
    assert run.committed[0, :4].tolist() == (
        before if action == 'rebase' else scene.load(TUMBLER).start.attitude.tolist())


def test_a_torque_may_overtake_the_clock_it_is_stamped_by(tmp_path, domain):
    with Session(TUMBLER, domain, *SIMULATED, *options(
            'on_time_jump:=ignore history:=60.0')) as live:
        settle(live, 5 * SECOND)
        early = [5 * SECOND + k * SECOND // 100 for k in range(1, 201)]
        for stamp_ns in early:
            live.publish(stamp_ns, '', wobble(stamp_ns))
        settle(live, early[-1])
        live.wait_until(lambda: len(live.torques) == 200, 'the early torques')
        run = finished(tmp_path, live)
    assert set(run.stamps_ns) == {5 * SECOND, *early}


def test_a_given_start_time_holds_in_every_round_of_a_bag(tmp_path, domain):
    start_ns = 100 * SECOND + 12345
    with Session(TUMBLER, domain, *SIMULATED, '-p', f'start_time:={start_ns}') as live:
        rounds = []
        live.start_clock(99 * SECOND)
        for _ in range(2):
            live.run_clock(100 * SECOND, 102 * SECOND, wobble)
            settle(live, 102 * SECOND)
            rounds.append({message.stamp_ns: message.values.tolist()
                           for message in decoded(live, COMMITTED)})
            live.received[COMMITTED].clear()
        assert live.stop() == 0
    common = [stamp_ns for stamp_ns in rounds[0] if stamp_ns in rounds[1]]
    assert len(common) > 5
    assert all(rounds[0][stamp_ns] == rounds[1][stamp_ns] for stamp_ns in common)


def test_torques_may_be_timed_by_their_arrival(tmp_path, domain):
    with Session(TUMBLER, domain, *RELIABLE, '-p', 'time_source:=arrival') as live:
        begin_ns = live.now_ns()
        for number in range(20):
            live.spin(0.02)
            # Negative stamps are not valid, but nobody needs them.
            live.publish((number - 3) * SECOND, 'base_link', [0.01, 0.0, 1e-3 * number])
        live.wait_for_torques(20)
        run = finished(tmp_path, live)
        end_ns = live.now_ns()
    assert len(run.accepted.stamps_ns) == 20
    assert np.all((run.accepted.stamps_ns > begin_ns) & (run.accepted.stamps_ns < end_ns))


@pytest.mark.parametrize('source', ['header', *at_night('arrival')])
def test_torques_between_two_ticks_of_the_clock_all_have_effect(tmp_path, domain, source):
    tick_ns, count = SECOND // 10, 20
    with Session(TUMBLER, domain, *SIMULATED, '-p', f'time_source:={source}') as live:
        live.start_clock(5 * SECOND)
        for tick in range(5):
            live.set_clock(5 * SECOND + tick * tick_ns)
            for number in range(count):
                live.spin(0.1 / count)
                stamp_ns = 5 * SECOND if source == 'arrival' else 0
                live.publish(stamp_ns, '', [1e-3, 1e-4 * tick, 1e-5 * number])
        live.wait_for_torques(5 * count)
        settle(live, 6 * SECOND)
        run = finished(tmp_path, live)
    assert len(run.accepted.stamps_ns) == 5 * count
    assert np.all(np.diff(run.accepted.stamps_ns) > 0)


def test_time_goes_on_between_two_ticks_as_fast_as_before(monkeypatch):
    wall_ns = [0]
    monkeypatch.setattr(clocks.time, 'monotonic_ns', lambda: wall_ns[0])
    stamps, tick_ns = ArrivalStamps(), SECOND // 10
    for tick in range(3):  # at half the speed of real time
        wall_ns[0] = 2 * tick * tick_ns
        stamps.tick(5 * SECOND + tick * tick_ns)
    now_ns = 5 * SECOND + 2 * tick_ns
    found = []
    for part in (0.0, 0.25, 0.25, 0.5, 1.0, 3.0):
        wall_ns[0] = round((4 + 2 * part) * tick_ns)
        found.append(stamps.stamp() - now_ns)
    assert found == [0, tick_ns // 4, tick_ns // 4 + 1, tick_ns // 2, tick_ns, tick_ns + 1]
    stamps.tick(now_ns + 100 * SECOND)  # a jump is not a tick
    wall_ns[0] += tick_ns // 1000
    assert stamps.stamp() - now_ns - 100 * SECOND <= tick_ns
    stamps.tick(SECOND)  # the clock is set back
    assert stamps.stamp() == SECOND


@pytest.mark.parametrize('is_simulated', [True, False])
def test_a_message_that_waited_gets_the_stamp_of_its_arrival(monkeypatch, is_simulated):
    wall_ns, tick_ns = [0], SECOND // 10
    monkeypatch.setattr(clocks.time, 'monotonic_ns', lambda: wall_ns[0])
    stamps = ArrivalStamps(is_simulated)
    for tick in range(3):
        wall_ns[0] = tick * tick_ns
        stamps.tick(5 * SECOND + tick * tick_ns)
    now_ns = 5 * SECOND + 2 * tick_ns
    # Simulated time is known for one tick before the last one.
    found = [stamps.stamp(age_ns) - now_ns for age_ns in (3 * tick_ns, tick_ns // 2, 0, 0)]
    assert found == [-tick_ns if is_simulated else -3 * tick_ns, -tick_ns // 2, 0, 1]


class Fake:
    """A clock and a steady clock that the test sets, s."""

    def __init__(self, monkeypatch):
        self.time = self.steady = 0.0
        monkeypatch.setattr(clocks.time, 'monotonic_ns', lambda: round(self.steady * SECOND))

    def now(self):
        return Time(nanoseconds=round(self.time * SECOND))

    def jumps(self, readings, is_simulated, *limits):
        """Return the jump that is detected at each reading (clock, steady clock)."""
        detector, found = WatchedClock(self, is_simulated, *(
            round(limit * SECOND) for limit in limits)), []
        for self.time, self.steady in readings:
            found.append(detector.read().jump_ns / SECOND)
        return found


@pytest.mark.parametrize(('is_simulated', 'readings', 'jumps'), [
    # Before the first message, then a steady run, then a stall of two seconds.
    (True, [(0, 0), (100, 1), (100.01, 1.01), (102, 3), (107, 4)], [0, 0, 0, 0, 0]),
    (True, [(100, 1), (100.01, 1.01), (101.2, 1.02), (101.1, 1.03)], [0, 0, 1.19, -0.1]),
    # The clock stood still for a minute, and the node read it every second.
    (True, [(100, 1), *((100, k) for k in range(2, 60)), (160, 60)], [0] * 59 + [60]),
    # After a stall, the waiting messages arrive at once.
    (True, [(100, 1), (100.01, 1.01), (100.02, 3), (106, 3.001), (108, 3.1)], [0] * 5),
    # The publisher stalls, while the node reads the clock.
    (True, [(100, 1), (100.01, 1.01), *((100.01, 1.01 + k / 10) for k in range(10)), (106, 2)],
     [0] * 13),
    (False, [(100, 1), (100.01, 1.01), (102, 3), (162, 63)], [0, 0, 0, 0]),
    (False, [(100, 1), (102, 1.5), (101.5, 1.51), (100, 1.52)], [0, 2, 0, -1.5])])
def test_a_jump_is_more_than_a_pause_of_the_node(monkeypatch, is_simulated, readings, jumps):
    found = Fake(monkeypatch).jumps(readings, is_simulated, 1.0)
    np.testing.assert_allclose(found, jumps, atol=1e-6)


def test_a_small_step_of_a_wall_clock_is_a_jump_if_no_step_is_allowed(monkeypatch):
    readings = [(100, 1), (100.1, 1.1), (100.197, 1.2), (160.197, 61.2), (160.3, 61.3)]
    found = Fake(monkeypatch).jumps(readings, False, 1e-3, 1e-3)
    np.testing.assert_allclose(found, [0, 0, 0.097, 0, 0.103], atol=1e-6)


def test_torques_that_wait_for_the_clock_keep_their_order(context):
    node = AttitudeNode(context=context, parameter_overrides=[
        Parameter('use_sim_time', value=True), Parameter('on_time_jump', value='ignore'),
        *(Parameter(f'inertia.{name}', value=1.0) for name in ('ixx', 'iyy', 'izz'))])
    clock, mode = node.get_clock(), node._component._mode
    clock.set_ros_time_override(Time(seconds=5))
    for seconds in (5.0, 5.2, 5.9, 6.1):  # the last two exceed max_future
        mode.enqueue(messages.WRENCH.encode(round(seconds * SECOND), '', [0.0] * 6), None, 0)
    clock.set_ros_time_override(Time(seconds=7))
    mode.work()
    # If they were processed in another order, the first would be older than the last by more than
    # `history`.
    assert [torque.stamp_ns / SECOND for torque in mode.run.epoch.torques_since(0)] \
        == [5.0, 5.2, 5.9, 6.1]
    node.destroy_node()


def send_until(live, offset_ns, condition, what):
    """Publish torques stamped ahead of the clock, or without a stamp, until a condition holds."""
    def holds():
        for _ in range(5):
            live.publish(offset_ns and live.now_ns() + offset_ns, '', [1e-3, 0.0, 0.0])
            live.spin(0.01)
        return condition()
    live.wait_until(holds, what)


def offsets(live):
    """Return the offset of the stamps in the latest diagnosis, median and largest, s."""
    status = live.diagnostics[-1].status[0]
    return [float(pair.value) for pair in status.values if pair.key in OFFSETS]


def test_senders_whose_clocks_are_off_are_named_until_they_are_right(domain):
    with Session(TUMBLER, domain, *RELIABLE, *options('history:=60.0 max_past:=20.0')) as live:
        live.publish(live.now_ns() - 30 * SECOND, '', [1e-3, 0.0, 0.0])
        live.publish(live.now_ns() - 10 * SECOND, '', [1e-3, 0.0, 0.0])
        live.wait_for_torques(2)
        assert len(live.torques) == 1
        # A busy machine delivers a message late, so only `offsets` compares the figure.
        for seconds, text in ((-5.0, 's behind the clock (median)'),
                              (0.3, 's ahead of the clock (median)')):

            def is_named(seconds=seconds, text=text):
                _, level, message = live.diagnosis('torques')
                return level == 1 and text in message and np.allclose(offsets(live), seconds,
                                                                      atol=0.09)
            send_until(live, round(seconds * SECOND), is_named, 'a warning')
            send_until(live, -1000, lambda: live.diagnosis('torques')[2] == 'OK', 'its end')
        words = live.end()
    assert 'expected at most max_past (20 s)' in words
    assert 's behind the clock (median)' in words


def test_stamps_of_another_clock_are_rejected_and_those_that_nobody_fills_are_named(domain):
    with Session(TUMBLER, domain, *RELIABLE) as live:
        live.publish(live.now_ns() - 86400 * SECOND, 'base_link', [0.01, 0.0, 0.0])
        live.publish(12 * SECOND, 'base_link', [0.01, 0.0, 0.0])
        live.wait_for_torques(2)
        assert not live.torques
        send_until(live, 0, lambda: 'stamp 0, act on arrival: ' in live.diagnosis('torques')[2],
                   'a note')
        live.wait_until(lambda: live.diagnosis('torques')[2].startswith(
            'OK; stamp 0, act on arrival: '), 'the end of the errors')
        assert live.diagnosis('torques')[1] == 0  # it is allowed
        send_until(live, -1000, lambda: live.diagnosis('torques')[2] == 'OK', 'its end')
        words = live.end()
    assert 'torque rejected (1 so far): late: stamped 86400' in words
    assert 'play it with --clock and set use_sim_time, or set time_source:=arrival' in words
