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

"""The run of a node without ROS: what it accepts, when it commits, and what it logs."""

from collections import Counter
from dataclasses import replace
import math
import time
from unittest.mock import Mock

from conftest import CONFIG, SECOND
import numpy as np
import pytest
from rigid_body_ros import propagate, scene, State, TorqueLog
from rigid_body_ros.live import events, torque_queue
from rigid_body_ros.live.inputs import Torque
from rigid_body_ros.live.run import Run
from rigid_body_ros.live.torque_queue import Queued, TorqueQueue
from rigid_body_ros.propagation.sources import BODY, COMMANDS, WHEELS

TUMBLER = scene.load(CONFIG / 'tumbler.yaml')
START = replace(TUMBLER.start, time_ns=100 * SECOND)
NAN = math.nan
#: The wheel rw_z is faster than its limit, so a command that would speed it up acts as zero.
WHEELED = {'wheel_names': ['rw_x', 'rw_z'], 'rw_x.axis.x': 1.0, 'rw_x.inertia': 1e-4,
           'rw_x.max_torque': 0.004, 'rw_z.axis.z': 1.0, 'rw_z.inertia': 1e-4,
           'rw_z.initial_speed': 60.0, 'rw_z.max_speed': 50.0}


@pytest.fixture(autouse=True)
def _busy_machines_have_time(monkeypatch):
    monkeypatch.setattr('rigid_body_ros.live.run._END_BUDGET', 60.0)


class Session:
    """A run that has begun, with what it logs, in order, and what it counts."""

    def __init__(self, **values):
        self.scene = scene.Scene.from_values({**TUMBLER.values, **values})
        self.logged, self.counts, self.events = [], Counter(), Counter()
        self.run = Run(self.scene, self, self)
        self.run.begin(replace(self.scene.start, time_ns=START.time_ns))

    def send(self, *torque, **others):
        """Apply and log a torque, as `at`; return whether it is accepted."""
        torque = at(*torque, **others)
        is_accepted = self.run.apply(torque, torque.stamp_ns)
        if is_accepted:
            self.run.commit(math.inf)
        return is_accepted

    @property
    def states(self):
        """Return the committed states."""
        return [one for kind, one in self.logged if kind == 'state']

    def count(self, name, source, number=1):
        self.counts[name, source] += number

    def reject(self, rejected, source):
        self.counts[rejected.cause, source] += 1

    def event(self, name, text, kind=''):
        self.events[name] += 1

    def begin_log(self, start):
        self.logged.append(('begin', start))

    def log_torque(self, torque):
        self.logged.append(('torque', torque))

    def log_state(self, state):
        self.logged.append(('state', state))

    def deliver(self, until):
        return True


def ns(seconds):
    """Convert a time, s after the start, to ns."""
    return START.time_ns + round(seconds * SECOND)


def at(seconds, values=(0.01, 0.0, 0.0), source=0, frame='body'):
    """Return a torque with a stamp, s after the start."""
    return Torque(ns(seconds), np.array(values), frame, source)


def shuffled(count):
    """Return times, s, and torques in the order of arrival, all late by less than 0.9 s."""
    random = np.random.default_rng(7)
    times = np.sort(random.random(count)) * 0.05 * count
    order = np.argsort(times + 0.9 * random.random(count))
    return [(times[k], 0.02 * random.normal(size=3)) for k in order]


def check_motion(states, *logs):
    """Check that states equal a propagation of logs (lists of torques), bit for bit."""
    motion = propagate(TUMBLER.body, states[0], [
        TorqueLog([one.stamp_ns for one in log], [one.values for one in log],
                  [one.frame for one in log]) for log in logs], at=[one.time_ns for one in states])
    np.testing.assert_array_equal([one.attitude for one in states], motion.attitude)
    np.testing.assert_array_equal([one.angular_velocity for one in states],
                                  motion.angular_velocity)


def test_a_state_is_committed_once_when_no_torque_can_change_it_any_more():
    live, sent = Session(), [at(*one) for one in shuffled(100)]
    for number, torque in enumerate(sent):
        before = len(live.logged)
        assert live.run.apply(torque, torque.stamp_ns)
        assert live.logged[before:] == [('torque', torque)]
        live.run.commit(math.inf)
        newest_ns = max(one.stamp_ns for one in sent[:number + 1])
        final = [one.stamp_ns for one in sent[:number] if one.stamp_ns <= newest_ns - SECOND]
        assert [one.time_ns for one in live.states] == [START.time_ns, *sorted(final)]
        assert live.run.committed is live.states[-1]
    assert len(live.states) < 100
    live.run.end()
    assert live.run.epoch is None
    assert [one.time_ns for one in live.states] \
        == [START.time_ns, *sorted(one.stamp_ns for one in sent)]
    check_motion(live.states, sent)
    assert live.counts == {(events.APPLIED, 0): 100}
    assert not live.events


def test_a_late_torque_changes_every_later_state():
    live, sent = Session(history=5.0), []
    for number, seconds in enumerate((1.0, 2.0, 3.0, 1.5, 0.5, 2.5)):
        sent.append(at(seconds, (0.01, 0.02 * number, -0.01)))
        assert live.send(seconds, sent[-1].values)
        check_motion([live.run.epoch.start, live.run.last_state(ns(4.0))], sent)


def test_the_log_does_not_depend_on_how_the_work_is_divided():
    whole, divided, batched = Session(), Session(), Session()
    timeouts = commits = 0
    for one in shuffled(100):
        assert whole.send(*one)
        torque, is_committed = at(*one), False
        assert divided.run.apply(torque, torque.stamp_ns)
        while not is_committed:
            try:
                divided.run.commit(time.monotonic())
                is_committed = True
            except TimeoutError:
                timeouts += 1
        batched.run.apply(torque, torque.stamp_ns)
        if batched.run.must_commit:
            batched.run.commit(math.inf)
            commits += 1
    batched.run.commit(math.inf)
    assert timeouts > 50
    assert 0 < commits < 10
    assert [kind for kind, _ in divided.logged] == [kind for kind, _ in whole.logged]
    for session in (divided, batched):
        assert session.counts == whole.counts
        assert len(session.states) == len(whole.states)
        for one, other in zip(session.states, whole.states):
            assert one.time_ns == other.time_ns
            np.testing.assert_array_equal(one.attitude, other.attitude)


@pytest.mark.parametrize(('history', 'oldest_ns'), [(1.0, SECOND - 1), (1e-10, 0)])
def test_a_torque_that_is_too_old_is_rejected(history, oldest_ns):
    live = Session(history=history, max_future=0.0)
    live.run.check_age(0)  # before the first torque, no age is checked
    assert live.send(2.0)
    assert not live.send(2.0 - (oldest_ns + 1) * 1e-9)
    assert live.send(2.0 - oldest_ns * 1e-9)
    assert live.counts[events.LATE, 0] == 1
    assert live.counts[events.APPLIED, 0] == 2
    with pytest.raises(events.RejectedError, match='older than the newest torque'):
        live.run.torques_since(ns(2.0) - oldest_ns - 1)


def test_a_motion_that_is_too_fast_is_reported_and_torques_after_it_are_rejected():
    live = Session()
    assert live.send(1.0, (1e18, 0.0, 0.0))
    assert live.send(3.0)
    assert live.send(5.0)  # makes the state at 3 s final
    assert not live.send(7.0)
    assert live.events == {events.NOT_COMPUTABLE: 1}
    assert live.counts == {(events.APPLIED, 0): 3, (events.NO_STATE, 0): 1}
    assert [one.time_ns for one in live.states] == [ns(0.0), ns(1.0)]
    assert live.run.last_state(ns(3.0)) is None
    assert live.run.snapshot(ns(3.0), math.inf) is None


def test_an_epoch_that_has_no_time_to_end_says_what_is_missing():
    live = Session()
    for one in shuffled(20):
        live.send(*one)
    committed = len(live.states)
    live.run.end(until=time.monotonic())
    assert live.events == {events.MISSED: 1}
    assert committed <= len(live.states) < 21
    assert live.run.epoch is None


def test_torques_of_an_earlier_epoch_go_on_in_the_next():
    live = Session(torque_topics=['a', 'b'])
    sent = [at(0.2), at(0.5, (0.0, 0.02, 0.0), frame='space'), at(0.4, (0.0, 0.0, 0.01), 1),
            at(1.0, (0.0, 0.0, -0.02), 1)]
    for torque in sent:
        assert live.send((torque.stamp_ns - START.time_ns) / SECOND, *torque[1:2], torque.source,
                         torque.frame)
    carried = live.run.torques_since(ns(0.7))
    assert [(one.stamp_ns, one.source) for one in carried] == [
        (ns(0.4), 1), (ns(0.5), 0), (ns(1.0), 1)]
    live.run.end()
    live.logged.clear()
    begin = State(ns(0.7), (0.5, 0.5, -0.5, 0.5), (0.3, 0.2, -0.1))
    live.run.begin(begin, carried)
    assert [kind for kind, _ in live.logged] == ['begin', 'torque', 'torque', 'torque', 'state']
    assert live.run.age(0, ns(1.7)) == 1.0  # counted from the start of the epoch
    # The first torque with the stamp of a carried-over one is no mistake of its publisher.
    for _ in range(2):
        assert live.send(1.0, (0.0, 0.0, -0.03), 1)
    assert live.counts[events.REPLACED, 1] == 1
    live.run.end()
    check_motion(live.states, sent[1:2], [sent[2], at(1.0, (0.0, 0.0, -0.03), 1)])


def test_equal_stamps_replace_each_other_within_a_source_only():
    live = Session(torque_topics=['a', 'b'], wheels=True, inertia_topic=True)
    body = live.scene.body.entries
    given = [((0.01, 0.0, 0.0), 0), ((0.0, 0.01, 0.0), 1), ((0.0, 0.0, 1e-3), WHEELS),
             (1.1 * body, BODY)]
    for values, source in given:
        assert not live.run.epoch.has_torque_at(ns(0.5), source)
        assert live.send(0.5, values, source)
        assert live.run.epoch.has_torque_at(ns(0.5), source)
        assert not live.run.epoch.has_torque_at(ns(0.6), source)
        assert live.counts[events.REPLACED, source] == 0
    for values, source in given:
        assert live.send(0.5, values, source)
        assert live.counts[events.REPLACED, source] == 1
    found = {one.source: one.values.tolist() for one in live.run.torques_since(ns(0.5))}
    assert found == {source: list(values) for values, source in given}
    live.run.end()
    assert [one.time_ns for one in live.states] == [ns(0.0), ns(0.5)]


def test_commands_of_wheels_are_counted_one_by_one():
    live = Session(**WHEELED)
    assert live.run.epoch.newest_of(0) is None
    assert live.send(0.0)
    assert live.run.epoch.newest_of(COMMANDS) is None
    for seconds, efforts in ((0.0, (0.003, 0.001)), (0.5, (NAN, 0.002)), (0.7, (0.009, -0.001)),
                             (0.7, (0.003, NAN)), (0.7, (NAN, -0.002))):
        assert live.run.epoch.has_torque_at(ns(seconds), COMMANDS) == (
            live.counts[events.APPLIED, COMMANDS] > 2)
        assert live.send(seconds, efforts, COMMANDS)
    assert live.counts == {(events.APPLIED, 0): 1, (events.APPLIED, COMMANDS): 5,
                           (events.REPLACED, COMMANDS): 2, (events.CLIPPED, COMMANDS): 1}
    newest = live.run.epoch.newest_of(COMMANDS)
    assert (newest.stamp_ns, newest.values.tolist()) == (ns(0.7), [0.003, -0.002])
    # rw_z is too fast from the start, so its command acts only once it slows the wheel down.
    live.run.end()
    assert live.counts[events.TOO_FAST, COMMANDS] == 1


def test_a_new_state_keeps_the_momentum_of_rotors_and_the_speeds_of_wheels():
    given = State(ns(1.0), (0.5, 0.5, -0.5, 0.5), (0.3, 0.2, -0.1))
    wheels, rotors, none = Session(**WHEELED), Session(wheels=True), Session()
    wheels.send(0.0, (0.003, -0.001), COMMANDS)
    rotors.send(0.0, (0.0, 0.0, 0.01), WHEELS)
    for live in (wheels, rotors, none):
        now, start = live.run.last_state(ns(1.0)), live.run.epoch.start
        found = live.run.with_rotor_momentum(given, ns(1.0), start)
        np.testing.assert_array_equal(found.wheel_speeds, now.wheel_speeds)
        np.testing.assert_array_equal(found.rotor_momentum, now.rotor_momentum)
        np.testing.assert_array_equal(found.attitude, given.attitude)
        at_start = live.run.with_rotor_momentum(given, ns(0.0), start)
        np.testing.assert_array_equal(at_start.wheel_speeds, start.wheel_speeds)
        np.testing.assert_array_equal(at_start.rotor_momentum, start.rotor_momentum)
    # 0.003 N m speeds up a wheel of 1e-4 kg m^2 by 30 rad/s in a second.
    assert wheels.run.last_state(ns(1.0)).wheel_speeds[0] > 20.0
    np.testing.assert_allclose(rotors.run.last_state(ns(1.0)).rotor_momentum, [0.0, 0.0, 0.01])


def test_a_source_is_silent_while_its_torque_acts_and_none_comes():
    live = Session(torque_topics=['a', 'b'], stale_after=0.5)
    assert live.run.age(0, ns(1.0)) is None
    live.send(1.0)
    live.send(1.0, (0.0, 0.0, 0.0), 1)  # no warning for a torque of zero
    assert live.run.age(0, ns(1.5)) == 0.5
    assert live.run.age(0, ns(0.5)) == 0.0
    assert not live.run.silent(ns(1.5))
    silent, = live.run.silent(ns(1.6))
    assert (silent.stamp_ns, silent.source) == (ns(1.0), 0)
    assert not Session(stale_after=0.0).run.silent(ns(9.0))
    live.send(2.0)
    assert not live.run.silent(ns(2.1))


def test_a_torque_acts_from_its_delay_on_until_it_times_out():
    live = Session(**{'torque_topics': ['a', 'b'], 'actuator.topics': ['a'],
                      'actuator.delay': 0.25, 'torque_timeout': 1.0})
    live.send(1.0)
    live.send(1.0, (0.0, 0.01, 0.0), 1)
    expected = {1.0: [1], 1.2: [1], 1.25: [0, 1], 1.999: [0, 1], 2.0: [0], 2.249: [0], 2.25: []}
    found = {seconds: sorted(one.source for one in live.run.epoch.acting_at(ns(seconds)))
             for seconds in expected}
    assert found == expected
    assert live.run.epoch.newest_of(0).stamp_ns == ns(1.0)
    # The published data say so as well.
    for seconds in expected:
        torque = live.run.snapshot(ns(seconds), math.inf).torque
        np.testing.assert_allclose(torque, [0.01 * (0 in expected[seconds]),
                                            0.01 * (1 in expected[seconds]), 0.0], rtol=0,
                                            atol=1e-17)


def test_what_the_imu_measures_is_older_by_its_delay():
    live = Session(**{'imu.delay': 0.25})
    live.send(0.5)
    for seconds, sensed in ((0.0, 0.0), (0.2, 0.0), (0.75, 0.5), (1.0, 0.75)):
        snapshot = live.run.snapshot(ns(seconds), math.inf)
        assert (snapshot.state.time_ns, snapshot.sensed.time_ns) == (ns(seconds), ns(sensed))
        np.testing.assert_array_equal(snapshot.sensed.angular_velocity,
                                      live.run.last_state(ns(sensed)).angular_velocity)
        assert not snapshot.torque.any()  # only a scene with actuators has one
    assert Session().run.snapshot(ns(1.0), math.inf).sensed.time_ns == ns(1.0)


def received(source, since=0.0):
    return Queued(source, b'', None, 0, since)


@pytest.fixture
def waiting():
    """Return a queue with two torques, and two that wait for the clock."""
    queue = TorqueQueue(Mock(), is_patient=False)
    assert not queue
    queue.put(received(0))
    queue.hold(received(1), events.FUTURE)
    queue.put(received(2))
    queue.hold(received(3), events.LATE)
    return queue


def test_torques_that_waited_for_the_clock_are_tried_again_first(waiting):
    assert (len(waiting), [*waiting.by_source()]) == (4, [0, 2, 1, 3])
    assert waiting.pop().source == 0
    waiting.retry()
    assert [waiting.pop().source for _ in range(3)] == [1, 3, 2]
    assert (bool(waiting), len(waiting)) == (False, 0)


@pytest.mark.slow
@pytest.mark.parametrize(('count', 'waited', 'is_patient', 'is_full'), [
    (5000, 9.0, False, False), (5001, 2.0, False, False), (5001, 2.1, False, True),
    (5001, 9.0, True, False), (99_999, 0.0, False, False), (99_999, 9.0, True, False),
    (100_000, 0.0, False, True), (100_000, 0.0, True, True)])
def test_too_many_torques_or_a_backlog_in_real_time_is_an_overload(monkeypatch, count, waited,
                                                                   is_patient, is_full):
    monkeypatch.setattr(torque_queue.time, 'monotonic', lambda: 100.0 + waited)
    queue = TorqueQueue(Mock(), is_patient)
    assert queue.waiting_time == 0.0
    for _ in range(count):
        queue.put(received(0, 100.0))
    assert queue.waiting_time == pytest.approx(waited)
    if not is_full:
        queue.check_room()
        return
    with pytest.raises(events.RejectedError, match=f'{count} torques wait') as error:
        queue.check_room()
    assert error.value.cause == events.OVERLOAD


@pytest.mark.parametrize(('kept', 'rejected', 'left'), [
    (events.LATE, [0, 2, 1], 3), (events.FUTURE, [0, 2, 3], 1)])
def test_the_end_of_an_epoch_rejects_what_waits_except_for_one_cause(waiting, kept, rejected,
                                                                     left):
    waiting.end(kept)
    causes, sources = zip(*(call.args for call in waiting._events.reject.call_args_list))
    assert [*sources] == rejected
    assert {rejection.cause for rejection in causes} == {events.ENDED}
    waiting.retry()
    assert waiting.pop().source == left
    assert not len(waiting)
