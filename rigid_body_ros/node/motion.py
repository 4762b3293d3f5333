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

"""The motion as the node computes it: never for longer at a time than others can wait."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
import time

from rigid_body_ros.body import State
from rigid_body_ros.node.arrivals import Sender
from rigid_body_ros.node.epoch import Epoch, Torque
from rigid_body_ros.node.health import APPLIED, Health, REPLACED, SLOW, UNKNOWN
from rigid_body_ros.node.inputs import (
    Arrival,
    EarlyError,
    FUTURE,
    LATE,
    NO_STATE,
    OVERLOAD,
    RefusedError,
)
from rigid_body_ros.node.outputs import LOG_DEPTH, Outputs
from rigid_body_ros.scene import Scene

#: s; a slice of work, after which every other callback gets its turn.
_BUDGET = 0.02
#: s; how long the states of an epoch that ends may take.
_LAST_WORDS = 0.2
#: Torques that may wait for the motion to get there.
_MOST_WAITING = 100_000
#: In real time more than a few may wait for this long only, s: the motion has to catch up.
_FEW, _LONGEST_WAIT = 5000, 2.0


class Motion:
    """
    Takes torques, logs them, and answers for the state.

    `take` only puts a message in line. `work` reads and applies those that wait, for one slice of
    time; call it again until it returns True. The order of things, and so every number, stays the
    same.

    Parameters
    ----------
    scene : Scene
    outputs : Outputs
    health : Health
    read : callable
        Returns the torque of an Arrival, None if it is one that has no effect, or raises
        RefusedError; EarlyError if it is to be read again later.
    answer : callable, optional
        Lockstep: receives each torque and the state `step` after it, as soon as the torque is
        applied; None if it is not applied, or there is no state.
    step_ns : int

    """

    def __init__(self, scene: Scene, outputs: Outputs, health: Health,
                 read: Callable[[Arrival], Torque | None],
                 answer: Callable[[Torque, State | None], None] | None = None,
                 step_ns: int = 0) -> None:
        self._scene, self._outputs, self._health = scene, outputs, health
        self._read, self._answer, self._step_ns = read, answer, step_ns
        self.epoch: Epoch | None = None
        #: Whether the log has torques of an epoch before.
        self._is_logged = False
        self._inbox: deque[Arrival] = deque()
        #: Those that wait for the clock, by what they are otherwise refused for; others pass them.
        self._early: dict[str, deque[Arrival]] = {FUTURE: deque(), LATE: deque()}
        #: The torque of the first of them, once it is read, and whether it is applied.
        self._torque: Torque | None = None
        self._is_applied = False
        #: Time, ns, of the state to publish as soon as it is known; 0 if there is none.
        self._owed_ns = 0
        #: Is called when there is work that no message announces.
        self.wake: Callable[[], None] = lambda: None
        #: States that are final, to be committed.
        self._settled: list[State] = []

    @property
    def waiting(self) -> int:
        """How many torques wait, for the motion or for the clock."""
        return len(self._inbox) + sum(map(len, self._early.values()))

    @property
    def waiting_time(self) -> float:
        """How long, s, the first of them has waited."""
        return time.monotonic() - self._inbox[0].since if self._inbox else 0.0

    def initial(self, time_ns: int) -> State:
        """Return the initial state, at a time."""
        return replace(self._scene.start, time_ns=time_ns)

    def in_force(self, time_ns: int) -> list[Torque]:
        """
        Return the torque that is in force at a time, and all later ones.

        Raises
        ------
        RefusedError
            The time is older than the newest torque by `history` or more.

        """
        if self.epoch is None or self.epoch.newest_ns is None:
            return []
        if self.epoch.newest_ns - time_ns >= self.epoch.history_ns:
            raise RefusedError(LATE, f'{time_ns} ns is older than the newest torque, '
                               f'{self.epoch.newest_ns} ns, by history '
                               f'({self.epoch.history_ns * 1e-9:g} s) or more')
        return self.epoch.since(time_ns)

    def begin(self, start: State, torques: Sequence[Torque] = ()) -> None:
        """Begin an epoch, and its log, with torques that are in force still."""
        if self.epoch is not None:  # or those that wait are for this one
            self.end()
        if self._is_logged:
            self._outputs.begin_log()
        self._is_logged = bool(torques)
        self.epoch = Epoch(self._scene, start, torques)
        for torque in torques:
            self._outputs.accept(torque)
        self._outputs.commit(start)

    def end(self, until: float | None = None) -> None:
        """
        End the epoch, if there is one; torques that still wait are rejected.

        But those that are too old for it may be for the next one.

        Its states are committed by `until`, a time of the monotonic clock, or soon.
        """
        if self._is_applied:  # but the answer takes too long
            self._log(self._torque)
            self._inbox.popleft()
        for line, cause, what in ((self._inbox, OVERLOAD, 'motion'),
                                  (self._early[FUTURE], FUTURE, 'clock')):
            for _ in line:
                self._health.refuse(RefusedError(
                    cause, f'the epoch ended before the {what} got to a torque'))
            line.clear()
        self._torque, self._owed_ns = None, 0
        if self.epoch is not None:
            self._finish(time.monotonic() + _LAST_WORDS if until is None else until)
        self.epoch = None

    def take(self, data: bytes, sender: Sender, time_ns: int) -> None:
        """
        Put a message in line that arrives at a time.

        Raises
        ------
        RefusedError
            Too many wait already, or in real time for too long.

        """
        now, inbox = time.monotonic(), self._inbox
        waited = now - inbox[0].since if inbox else 0.0
        is_late = waited > _LONGEST_WAIT and len(inbox) > _FEW and self._answer is None
        if is_late or len(inbox) >= _MOST_WAITING:
            raise RefusedError(OVERLOAD, f'{len(inbox)} torques wait for the motion, the first '
                               f'for {waited:.3g} s')
        inbox.append(Arrival(data, sender, time_ns, now))

    def sort_out(self) -> None:
        """Find those in line that wait for the clock, before the clock ends the epoch."""
        arrivals = list(self._inbox)
        self._inbox.clear()
        for place, arrival in enumerate(arrivals):
            is_read = place == 0 and self._torque is not None
            cause = None if is_read else self._early_cause(arrival)
            (self._inbox if cause is None else self._early[cause]).append(arrival)

    def work(self) -> bool:
        """Take torques that wait, for a slice of time; return whether none is left."""
        until = time.monotonic() + _BUDGET
        self._readmit()
        try:
            while self._inbox and time.monotonic() < until:
                if self._torque is None:
                    self._torque = self._readable(self._inbox[0])
                if self._torque is not None:
                    self._proceed(self._torque, until)
                self._torque = None
                self._inbox.popleft()
            if self._owed_ns and not self._inbox:
                self.publish(self._owed_ns)
        except TimeoutError as error:
            self._too_slow(error)
        return not (self.waiting or self._owed_ns)

    def publish(self, time_ns: int) -> None:
        """
        Publish the state at a time, now if a slice of work is enough to compute it.

        While torques wait for the motion, or if it takes longer, the state is not known yet. Then
        `work` publishes the one at the last time asked for: simulated time may stand still, so
        that nobody asks again.
        """
        self._owed_ns = time_ns if self._inbox else 0
        if self._owed_ns:
            return
        try:
            state = self.state(time_ns, time.monotonic() + _BUDGET)
        except TimeoutError as error:
            self._too_slow(error)
            self._owed_ns = time_ns
            self.wake()
            return
        if state is not None:
            self._outputs.publish(state)

    def state(self, time_ns: int, until: float) -> State | None:
        """
        Return the state at a time, or None (and say why) where there is no finite one.

        Raises
        ------
        TimeoutError
            It is not known yet by `until`, a time of the monotonic clock.

        """
        try:
            return self.epoch.at(time_ns, until - time.monotonic())
        except ValueError as error:
            self._health.event(UNKNOWN, f'no state at {time_ns} ns: {error}')
            return None

    def last(self, time_ns: int) -> State | None:
        """Return the state at a time, or None if it takes too long or there is none."""
        try:
            return self.state(time_ns, time.monotonic() + _LAST_WORDS)
        except TimeoutError as error:
            self._too_slow(error)
            return None

    def _readable(self, arrival: Arrival) -> Torque | None:
        try:
            return self._read(arrival)
        except EarlyError as early:
            self._early[early.cause].append(arrival)
        except RefusedError as refused:
            self._health.refuse(refused)
        return None

    def _readmit(self) -> None:
        """Put torques that waited for the clock long enough before those that came later."""
        place = int(self._torque is not None)
        for line in self._early.values():
            while line and self._early_cause(line[0]) is None:
                self._inbox.insert(place, line.popleft())
                place += 1

    def _early_cause(self, arrival: Arrival) -> str | None:
        """Return what a torque that waits for the clock is refused for otherwise, or None."""
        try:
            self._read(arrival)
        except EarlyError as early:
            return early.cause
        except RefusedError:
            pass  # counted in its turn
        return None

    def _proceed(self, torque: Torque, until: float) -> None:
        # Apply, answer, log: whoever waits for the answer comes first.
        if not self._is_applied:
            self._settle(torque.stamp_ns - self.epoch.history_ns, until)
            self._is_applied = self._apply(torque)
            if not self._is_applied:
                if self._answer is not None:
                    self._answer(torque, None)
                return
        if self._answer is not None:
            self._answer(torque, self.state(torque.stamp_ns + self._step_ns, until))
        self._log(torque)

    def _log(self, torque: Torque) -> None:
        self._outputs.accept(torque)
        self._is_logged, self._is_applied = True, False
        self._commit()

    def _finish(self, until: float) -> None:
        """Commit the states that were held back for late torques."""
        try:
            while due := self.epoch.due(2 ** 63)[:LOG_DEPTH]:  # what the queue holds
                self._settle(due[-1], until)
                self._commit()
                self._outputs.deliver(until)
        except TimeoutError as error:
            self._commit()
            self._health.event(SLOW, f'{len(self.epoch.due(2 ** 63))} states could not be '
                               f'computed before the end of their epoch: {error}')

    def check_age(self, stamp_ns: int) -> None:
        """Raise RefusedError if a torque is too old for the epoch."""
        newest_ns, history_ns = self.epoch.newest_ns, self.epoch.history_ns
        if newest_ns is not None and newest_ns - stamp_ns >= history_ns:
            raise RefusedError(
                LATE, f'a torque is older than the newest stamp, {newest_ns} ns, by '
                f'{(newest_ns - stamp_ns) * 1e-9:.9g} s, expected less than history '
                f'({history_ns * 1e-9:g} s)')

    def _apply(self, torque: Torque) -> bool:
        repeated = self.epoch.holds(torque.stamp_ns)
        try:
            self.check_age(torque.stamp_ns)
            self.epoch.take(torque)
        except RefusedError as refused:
            self._health.refuse(refused)
            return False
        except ValueError as error:  # the motion before it is beyond what can be worked out
            self._health.refuse(RefusedError(NO_STATE, str(error)))
            return False
        self._health.count(APPLIED)
        if repeated:
            self._health.count(REPLACED)
        return True

    def _settle(self, horizon_ns: int, until: float) -> None:
        """Compute the states up to a time, which no torque changes any more."""
        for stamp_ns in self.epoch.due(horizon_ns):
            state = self.state(stamp_ns, until)
            self.epoch.settle(stamp_ns)
            if state is not None:
                self._settled.append(state)
            if time.monotonic() > until:  # the next call goes on from here
                raise TimeoutError(f'the states are final up to {stamp_ns} ns')

    def _commit(self) -> None:
        for state in self._settled:
            self._outputs.commit(state)
        self._settled.clear()

    def _too_slow(self, error: TimeoutError) -> None:
        if self._answer is None:  # in lockstep the others wait
            self._health.event(SLOW, f'no longer in real time: {error}; the body spins too fast, '
                               'or late torques force too much recomputation')
