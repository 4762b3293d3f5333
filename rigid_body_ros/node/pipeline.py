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

"""Apply queued torques and compute states, in slices short enough for other callbacks."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import replace
import time

from rigid_body_ros.node.diagnostics import APPLIED, Diagnostics, MISSED, NOT_COMPUTABLE, REPLACED
from rigid_body_ros.node.drain import Sender
from rigid_body_ros.node.epoch import Epoch, Torque
from rigid_body_ros.node.inputs import (
    EarlyError,
    ENDED,
    FUTURE,
    LATE,
    NO_STATE,
    OVERLOAD,
    QueuedMessage,
    RejectedError,
)
from rigid_body_ros.node.outputs import LOG_DEPTH, Outputs
from rigid_body_ros.scene import Scene
from rigid_body_ros.state import State

#: s; length of a slice of work, after which all other callbacks run.
_BUDGET = 0.02
#: s; how long computing the last states of an epoch may take.
_END_BUDGET = 0.2
#: Torques that may wait in the queue.
_MAX_QUEUE = 100_000
#: In real time, new torques are rejected if more than this number wait and the first has waited
#: for longer than this, s. So the motion catches up.
_BACKLOG, _MAX_WAIT = 5000, 2.0


class Pipeline:
    """
    Queue torques, apply and log them, and compute the states.

    `enqueue` only appends a message to the queue. `process` reads and applies waiting messages for
    one slice of time; call it again until it returns True. Neither order nor results depend on how
    the work is divided.

    Parameters
    ----------
    scene : Scene
    outputs : Outputs
    diagnostics : Diagnostics
    read : callable
        Returns the torque of a QueuedMessage, or None for a torque without effect. Raises
        RejectedError, or EarlyError for a message to read again later.
    respond : callable, optional
        Lockstep: receives each torque and the state `step` later, as soon as the torque is
        applied. The state is None if the torque is rejected or the state cannot be computed.
    is_due : callable
        Lockstep: returns whether an applied torque gets its response now. Otherwise it waits for
        torques of other sources.
    step_ns : int
        Lockstep: `step`, ns.

    """

    def __init__(self, scene: Scene, outputs: Outputs, diagnostics: Diagnostics,
                 read: Callable[[QueuedMessage], Torque | None],
                 respond: Callable[[Torque, State | None], None] | None = None,
                 is_due: Callable[[Torque], bool] = lambda torque: True,
                 step_ns: int = 0) -> None:
        self._scene, self._outputs, self._diagnostics = scene, outputs, diagnostics
        self._read, self._respond, self._step_ns = read, respond, step_ns
        self._is_due = is_due
        self.epoch: Epoch | None = None
        #: Whether the log has torques of an earlier epoch.
        self._is_logged = False
        self._queue: deque[QueuedMessage] = deque()
        #: Messages that wait for the clock, by the cause for which they would be rejected now.
        #: Later messages overtake them.
        self._early: dict[str, deque[QueuedMessage]] = {FUTURE: deque(), LATE: deque()}
        #: The torque of the first message of the queue, once read, and whether it is applied.
        self._torque: Torque | None = None
        self._is_applied = False
        #: Time, ns, of the state to publish as soon as it is known; 0 if there is none.
        self._deferred_ns = 0
        #: Whether torques wait in the queue until this is false again.
        self.is_paused = False
        #: Called if there is work that no message starts.
        self.wake: Callable[[], None] = lambda: None
        #: Final states that are not logged yet.
        self._final: list[State] = []

    @property
    def waiting(self) -> int:
        """Return the number of torques that wait to be applied or for the clock."""
        return len(self._queue) + sum(map(len, self._early.values()))

    def waiting_by_source(self) -> Counter[int]:
        """Return `waiting` for each source."""
        return Counter(message.source for queue in (self._queue, *self._early.values())
                       for message in queue)

    @property
    def waiting_time(self) -> float:
        """How long the first torque of the queue has waited, s."""
        return time.monotonic() - self._queue[0].since if self._queue else 0.0

    def initial(self, time_ns: int) -> State:
        """Return the initial state of the scene, stamped with a time."""
        return replace(self._scene.start, time_ns=time_ns)

    def torques_since(self, time_ns: int) -> list[Torque]:
        """
        Return the torques that act at a time, and all later ones.

        Raises
        ------
        RejectedError
            The time is older than the newest torque by `history` or more.

        """
        if self.epoch is None or self.epoch.newest_ns is None:
            return []
        self.check_age(time_ns)
        return self.epoch.torques_since(time_ns)

    def with_rotor_momentum(self, start: State, time_ns: int, default: State) -> State:
        """
        Return a start state with the rotor momentum at a time of the present epoch.

        If there is no epoch, or no motor on the rotors, the momentum is that of a default state.
        """
        if self.epoch is not None and self._scene.wheels and time_ns > self.epoch.start.time_ns:
            default = self.last_state(time_ns) or default
        return replace(start, rotor_momentum=default.rotor_momentum)

    def begin(self, start: State, torques: Sequence[Torque] = (), is_ahead: bool = False) -> None:
        """
        Begin an epoch and its log; `torques` are earlier ones that still act.

        Torques that wait for the clock, and come from after it jumped, are kept: those ahead of
        the clock if it jumped ahead, otherwise those that are too old for the present epoch.
        """
        if self.epoch is not None:  # otherwise the queued torques belong to the new one
            self.end(kept=FUTURE if is_ahead else LATE)
        if self._is_logged:
            self._outputs.begin_log(start)
        self._is_logged = bool(torques)
        self.epoch = Epoch(self._scene, start, torques)
        for torque in torques:
            self._outputs.log_torque(torque)
        self._outputs.log_state(start)

    def end(self, until: float | None = None, kept: str = LATE) -> None:
        """
        End the epoch, if there is one, and reject all torques that still wait.

        Those that wait for the clock are kept for the next epoch if their cause is `kept`. The
        states of the epoch are committed by `until`, s, monotonic clock, or within 0.2 s.
        """
        if self._is_applied:  # the first torque is applied, but its response takes too long
            self._log(self._torque)
            self._queue.popleft()
        unmet = {FUTURE: 'the clock reached the stamp of this torque',
                 LATE: 'the clock was set back to the stamp of this torque'}
        for queue, event in ((self._queue, 'this torque was applied'), *(
                (self._early[cause], unmet[cause]) for cause in unmet if cause != kept)):
            for message in queue:
                self._diagnostics.reject(
                    RejectedError(ENDED, f'the epoch ended before {event}'), message.source)
            queue.clear()
        self._torque, self._deferred_ns = None, 0
        if self.epoch is not None:
            self._finish(time.monotonic() + _END_BUDGET if until is None else until)
        self.epoch = None

    def enqueue(self, data: bytes, sender: Sender, time_ns: int, source: int) -> None:
        """
        Append a message of a source that arrives at a time to the queue.

        Raises
        ------
        RejectedError
            Too many torques wait, or, in real time, they have waited too long.

        """
        now, queue = time.monotonic(), self._queue
        waited = now - queue[0].since if queue else 0.0
        is_late = waited > _MAX_WAIT and len(queue) > _BACKLOG and self._respond is None
        if is_late or len(queue) >= _MAX_QUEUE:
            raise RejectedError(OVERLOAD, f'{len(queue)} torques wait, the first for '
                                f'{waited:.3g} s; new ones are rejected until the node catches up')
        queue.append(QueuedMessage(data, sender, time_ns, now, source))

    def hold_early_torques(self) -> None:
        """Before the epoch ends, move torques that wait for the clock out of the queue."""
        messages = list(self._queue)
        self._queue.clear()
        for place, message in enumerate(messages):
            is_read = place == 0 and self._torque is not None
            cause = None if is_read else self._early_cause(message)
            (self._queue if cause is None else self._early[cause]).append(message)

    def process(self) -> bool:
        """Apply waiting torques for one slice of time; return whether no work is left."""
        if self.is_paused:
            return True
        until = time.monotonic() + _BUDGET
        self._requeue_early()
        try:
            while self._queue and time.monotonic() < until:
                if self._torque is None:
                    self._torque = self._read_or_reject(self._queue[0])
                if self._torque is not None:
                    self._process_torque(self._torque, until)
                self._torque = None
                self._queue.popleft()
            if self._deferred_ns and not self._queue:
                self.publish(self._deferred_ns)
        except TimeoutError as error:
            self._miss_deadline(error)
        return not (self.waiting or self._deferred_ns)

    def publish(self, time_ns: int) -> None:
        """
        Publish the state at a time, immediately if one slice of work is enough to compute it.

        Otherwise, or while torques wait in the queue, `process` publishes the state at the last
        requested time: if simulated time stands still, there is no further request.
        """
        self._deferred_ns = time_ns if self._queue else 0
        if self._deferred_ns:
            return
        try:
            state = self.state(time_ns, time.monotonic() + _BUDGET)
        except TimeoutError as error:
            self._miss_deadline(error)
            self._deferred_ns = time_ns
            self.wake()
            return
        if state is not None:
            self._outputs.publish(state)

    def state(self, time_ns: int, until: float) -> State | None:
        """
        Return the state at a time, or report that it cannot be computed and return None.

        Raises
        ------
        TimeoutError
            The state is not computed by `until`, s, monotonic clock.

        """
        try:
            return self.epoch.at(time_ns, until - time.monotonic())
        except ValueError as error:
            self._diagnostics.event(NOT_COMPUTABLE,
                                    f'cannot compute the state at {time_ns} ns: {error}')
            return None

    def last_state(self, time_ns: int) -> State | None:
        """Return the state at a time, or None if it takes too long or cannot be computed."""
        try:
            return self.state(time_ns, time.monotonic() + _END_BUDGET)
        except TimeoutError as error:
            self._miss_deadline(error)
            return None

    def _read_or_reject(self, message: QueuedMessage) -> Torque | None:
        try:
            return self._read(message)
        except EarlyError as early:
            self._early[early.cause].append(message)
        except RejectedError as rejected:
            self._diagnostics.reject(rejected, message.source)
        return None

    def _requeue_early(self) -> None:
        """Queue torques that no longer wait for the clock, in the order of arrival."""
        for early in self._early.values():
            place = int(self._torque is not None)
            while early and self._early_cause(early[0]) is None:
                message = early.popleft()
                while place < len(self._queue) and self._queue[place].since < message.since:
                    place += 1
                self._queue.insert(place, message)
                place += 1

    def _early_cause(self, message: QueuedMessage) -> str | None:
        """Return why a torque is early and may wait for the clock, or None if it is not early."""
        try:
            self._read(message)
        except EarlyError as early:
            return early.cause
        except RejectedError:
            pass  # counted when its turn comes
        return None

    def _process_torque(self, torque: Torque, until: float) -> None:
        # Apply, respond, log: the response comes first, because a controller waits for it.
        if not self._is_applied:
            self._finalize(torque.stamp_ns - self.epoch.history_ns, until)
            self._is_applied = self._apply(torque)
            if not self._is_applied:
                if self._respond is not None:
                    self._respond(torque, None)
                return
        if self._respond is not None and self._is_due(torque):
            self._respond(torque, self.state(torque.stamp_ns + self._step_ns, until))
        self._log(torque)

    def _log(self, torque: Torque) -> None:
        self._outputs.log_torque(torque)
        self._is_logged, self._is_applied = True, False
        self._log_final()

    def _finish(self, until: float) -> None:
        """Commit the states that late torques could still change."""
        try:
            while stamps := self.epoch.uncommitted()[:LOG_DEPTH]:  # what the queue holds
                self._finalize(stamps[-1], until)
                self._log_final()
                self._outputs.deliver(until)
        except TimeoutError as error:
            self._log_final()
            self._diagnostics.event(
                MISSED, f'{len(self.epoch.uncommitted())} states are missing on ~/committed, '
                f'because computing them at the end of the epoch took too long: {error}', ENDED)

    def check_age(self, stamp_ns: int) -> None:
        """Raise RejectedError if a stamp is too old for the epoch."""
        newest_ns, history_ns = self.epoch.newest_ns, self.epoch.history_ns
        if newest_ns is not None and newest_ns - stamp_ns >= history_ns:
            raise RejectedError(
                LATE, f'{(newest_ns - stamp_ns) * 1e-9:.9g} s older than the newest torque '
                f'({newest_ns} ns), expected less than history ({history_ns * 1e-9:g} s)')

    def _apply(self, torque: Torque) -> bool:
        is_replacement = self.epoch.has_torque_at(torque.stamp_ns, torque.source)
        try:
            self.check_age(torque.stamp_ns)
            self.epoch.apply(torque)
        except RejectedError as rejected:
            self._diagnostics.reject(rejected, torque.source)
            return False
        except ValueError as error:  # the motion before it is too fast to compute
            self._diagnostics.reject(RejectedError(NO_STATE, str(error)), torque.source)
            return False
        self._diagnostics.count(APPLIED, torque.source)
        if is_replacement:
            self._diagnostics.count(REPLACED, torque.source)
        return True

    def _finalize(self, horizon_ns: int, until: float) -> None:
        """Compute the states up to a time, which no torque can change any more."""
        for stamp_ns in self.epoch.uncommitted(horizon_ns):
            state = self.state(stamp_ns, until)
            self.epoch.mark_committed(stamp_ns)
            if state is not None:
                self._final.append(state)
            if time.monotonic() > until:  # the next call continues from here
                raise TimeoutError(f'the committed states are computed up to {stamp_ns} ns')

    def _log_final(self) -> None:
        for state in self._final:
            self._outputs.log_state(state)
        self._final.clear()

    def _miss_deadline(self, error: TimeoutError) -> None:
        if self._respond is None:  # in lockstep the controller waits
            self._diagnostics.event(MISSED, 'cannot keep up: the body spins too fast, or late '
                                    f'torques force too much recomputation; {error}')
