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

"""The motion as the node works it out: never longer at a time than others can wait."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
import time

from rigid_body_ros.body import State
from rigid_body_ros.node.epoch import Epoch, Torque
from rigid_body_ros.node.health import APPLIED, Health, REPLACED, SLOW, UNKNOWN
from rigid_body_ros.node.inputs import LATE, NO_STATE, OVERLOAD, RefusedError
from rigid_body_ros.node.outputs import LOG_DEPTH, Outputs
from rigid_body_ros.scene import Scene

#: s; how long callbacks work before others get their turn.
_BUDGET = 0.02
#: s; how long the states of an epoch that ends may take.
_LAST_WORDS = 0.2
#: Torques that may wait for the motion to get there.
_MOST_WAITING = 100_000


class Motion:
    """
    Takes torques, logs them, and answers for the state.

    What does not fit into a callback's time waits, and `work` goes on with it; the order of
    things, and so every number, stays the same.

    Parameters
    ----------
    scene : Scene
    outputs : Outputs
    health : Health
    answer : callable, optional
        Told the state `step` after each torque, as soon as the torque is taken.
    step_ns : int

    """

    def __init__(self, scene: Scene, outputs: Outputs, health: Health,
                 answer: Callable[[State], None] | None = None, step_ns: int = 0) -> None:
        self._scene, self._outputs, self._health = scene, outputs, health
        self._answer, self._step_ns = answer, step_ns
        self.epoch: Epoch | None = None
        #: Whether the log has torques of an epoch before.
        self._is_logged = False
        #: Torques that wait; of the first, once it is applied, the states that it made final.
        self._inbox: deque[Torque] = deque()
        self._final: list[State] | None = None

    @property
    def waiting(self) -> int:
        """How many torques wait."""
        return len(self._inbox)

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
        self.end()
        if self._is_logged:
            self._outputs.begin_log()
        self._is_logged = bool(torques)
        self.epoch = Epoch(self._scene, start, torques)
        for torque in torques:
            self._outputs.accept(torque)
        self._outputs.commit(start)

    def end(self) -> None:
        """End the epoch, if there is one."""
        if self._final is not None:  # applied, but the answer takes too long
            self._log(self._inbox.popleft())
        for _ in self._inbox:
            self._health.refuse(RefusedError(
                OVERLOAD, 'the epoch ended before the motion got to a torque'))
        self._inbox.clear()
        if self.epoch is not None:
            self.finish(time.monotonic() + _LAST_WORDS)
        self.epoch = None

    def take(self, torque: Torque) -> None:
        """
        Take a torque, now or when its turn comes.

        Raises
        ------
        RefusedError
            Too many wait already.

        """
        if len(self._inbox) >= _MOST_WAITING:
            raise RefusedError(OVERLOAD, f'{_MOST_WAITING} torques wait for the motion, which is '
                               'too fast to be worked out in time')
        self._inbox.append(torque)
        if len(self._inbox) == 1:  # or there is other work, which has had its time
            self.work()

    def work(self) -> bool:
        """Go on with what waits, for a while; return whether all is done."""
        until = time.monotonic() + _BUDGET
        try:
            while self._inbox:
                self._proceed(self._inbox[0], until)
                self._inbox.popleft()
        except TimeoutError as error:
            self._too_slow(error)
        return not self._inbox

    def publish(self, time_ns: int) -> None:
        """Publish the state at a time, if it can be known in time."""
        try:
            state = self.state(time_ns, time.monotonic() + _BUDGET)
        except TimeoutError as error:
            self._too_slow(error)
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

    def finish(self, until: float) -> bool:
        """Commit what was held back for late torques; return whether there was time for it."""
        try:
            while due := self.epoch.due(2 ** 63):
                for stamp_ns in due[:LOG_DEPTH]:  # no more at once than the queue holds
                    for state in self._final_states(stamp_ns, until):
                        self._outputs.commit(state)
                self._outputs.deliver(until)
        except TimeoutError as error:
            self._health.event(SLOW, f'{len(due)} states could not be worked out before the end '
                               f'of their epoch: {error}')
            return False
        return True

    def _proceed(self, torque: Torque, until: float) -> None:
        # Apply, answer, log: whoever waits for the answer comes first.
        if self._final is None:
            final = self._final_states(torque.stamp_ns - self.epoch.history_ns, until)
            if not self._apply(torque):
                return
            self._final = final
        if self._answer is not None:
            state = self.state(torque.stamp_ns + self._step_ns, until)
            if state is not None:
                self._answer(state)
        self._log(torque)

    def _log(self, torque: Torque) -> None:
        self._outputs.accept(torque)
        self._is_logged = True
        for state in self._final:
            self._outputs.commit(state)
        self._final = None

    def _apply(self, torque: Torque) -> bool:
        repeated = self.epoch.holds(torque.stamp_ns)
        try:
            taken = self.epoch.take(torque)
        except ValueError as error:  # the motion before it is beyond what can be worked out
            self._health.refuse(RefusedError(NO_STATE, str(error)))
            return False
        if not taken:
            self._health.refuse(RefusedError(
                LATE, f'a torque is older than the newest stamp, {self.epoch.newest_ns} ns, by '
                f'{(self.epoch.newest_ns - torque.stamp_ns) * 1e-9:.9g} s, expected less than '
                f'history ({self.epoch.history_ns * 1e-9:g} s)'))
            return False
        self._health.count(APPLIED)
        if repeated:
            self._health.count(REPLACED)
        return True

    def _final_states(self, horizon_ns: int, until: float) -> list[State]:
        """Return the states up to a time that were not final before, and now are."""
        states = [self.state(stamp_ns, until) for stamp_ns in self.epoch.due(horizon_ns)]
        self.epoch.settle(horizon_ns)
        return [state for state in states if state is not None]

    def _too_slow(self, error: TimeoutError) -> None:
        self._health.event(SLOW, f'no longer in real time: {error}; the body turns too fast to be '
                           'worked out, or late torques take too much back')
