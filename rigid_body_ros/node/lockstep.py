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

"""
Lockstep mode, in which the node answers each torque with the state one step later.

If several torque topics have publishers, the node does not respond to a stamp until it has
received a torque with this stamp on every one of these topics. Therefore, the order in which the
torques arrive does not change the response.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
import math
import time
from typing import Any

from builtin_interfaces.msg import Time
from rigid_body_ros import messages
from rigid_body_ros.common.errors import listed
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.live.closed_loop import DuplicateFilter, RepublishPolicy
from rigid_body_ros.live.events import APPLIED, DIFFERS, FUTURE, RejectedError, REPLACED, STALE
from rigid_body_ros.live.inputs import Torque
from rigid_body_ros.live.run import Snapshot
from rigid_body_ros.live.torque_queue import Queued
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.node.clocks import ClockPublisher, message_of, WatchedClock
from rigid_body_ros.node.intake import full_name, RELIABLE
from rigid_body_ros.node.mode import BUDGET, Mode
from rigid_body_ros.node.process import timer
from rigid_body_ros.node.sources import BODY
from std_srvs.srv import SetBool

#: How often to commit states and to check whether the state should be republished, and how long to
#: leave other callbacks between two slices of work, in seconds.
_CHECK_PERIOD, _WORK_PERIOD = 0.1, 0.001
#: How long to wait for the next torque before returning to the executor, in seconds. A simple
#: controller responds within 0.4 ms.
_SOON = 6e-4
#: Once the node has waited in vain this many times in a row, it waits only at every torque whose
#: number is a multiple of this.
_TRIES = 100
#: Diagnostics warn if no torque arrives for more than this many seconds, or if computing a
#: response takes more than this many seconds.
_WARN_AFTER = 1.0


class Lockstep(Mode):
    """
    Respond to torques with the state one `step` later.

    The mode responds to a stamp as soon as all torques with this stamp have arrived.
    """

    # A lost torque would stop the loop.
    qos, is_polled = RELIABLE, False
    several_publishers = 'only the first torque for each state is used'

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._clock = ClockPublisher(self._node, 'publish_clock') if self._scene.publish_clock \
            else None
        self._time = WatchedClock(self._node.get_clock(),
                                  self._node.get_parameter('use_sim_time').value)
        self._step_ns = max(1, duration_ns(self._scene.step, 'step'))
        self._duplicates = DuplicateFilter(duration_ns(self._scene.history, 'history'))
        #: `_unmet` is the number of torques since the last that arrived while the node waited.
        self._republishing, self._unmet = RepublishPolicy(), 0
        self._start = self._saved or self.run.initial(self._given_start_ns)
        #: The latest state, and the time at which this state began to wait for a torque, in
        #: seconds on the monotonic clock.
        self._latest, self._since = Snapshot(self._start, self._start), time.monotonic()
        #: The stamp in ns of the state that was waiting for a torque when the node was last reset.
        #: None if there was no reset, or if the new motion has reached this stamp.
        self._stale_ns: int | None = None
        if self._saved or self._given_start_ns:
            self._begin(self._start)
        if self._checkpoint and self._saved:
            self._warn_away(self._checkpoint.age)

    def activate(self) -> None:
        """Publish the state repeatedly until torques arrive, and offer a service for pausing."""
        self._since = time.monotonic()
        timer(self._node, _CHECK_PERIOD, self._check)
        #: A timer that runs only while torques are waiting. Its callback does one slice of work.
        self._worker = timer(self._node, _WORK_PERIOD, self._work)
        self._node.create_service(SetBool, '~/pause', self._on_pause)

    def process(self) -> bool:
        """Apply waiting torques for one slice of work. Return True if no work is left."""
        return self.is_paused or super().process()

    def work(self) -> None:
        """Work on the waiting torques, and on those that follow soon."""
        if not self._worker.is_canceled():
            return  # the running timer continues the work
        self._work()
        # Wait here for the next torque of a fast controller, because returning to the executor and
        # being woken again takes half of the time of a step. Do not wait for a controller that is
        # slow, or in the same executor.
        self._unmet += 1
        now, waits = time.monotonic(), self._unmet <= _TRIES or not self._unmet % _TRIES
        soon, last = now + waits * _SOON, now + BUDGET
        while now < min(soon, last) and self._worker.is_canceled() and not self.is_paused:
            self.intake.poll()
            if has_arrived := bool(self._queue):
                self._work()
                self._unmet = 0
            now = time.monotonic()
            soon = now + _SOON if has_arrived else soon

    def _work(self) -> None:
        if self.process():
            self._worker.cancel()
        elif self._worker.is_canceled():  # resetting a running timer would postpone it
            self._worker.reset()

    def set_state(self, state: State) -> str:
        """
        Begin a new epoch with the given state, and return a text that describes the epoch.

        If the stamp of the state is zero, the epoch begins at the stamp of the next torque. The
        rotors keep their momentum.

        Raises
        ------
        RejectedError
            The state is older than the newest torque by `history` or more.

        """
        torques = self.run.torques_since(state.time_ns) if state.time_ns else []
        state = self.run.with_rotor_momentum(
            state, state.time_ns or self._latest.state.time_ns, self._start)
        if state.time_ns:
            self._begin(state, torques)
        else:
            self.end()
            self._start = state
        self._duplicates.clear()
        self._publish_start()
        begin = f'{state.time_ns} ns' if state.time_ns else 'the stamp of the next torque'
        return f'initial_state received: a new epoch begins at {begin}'

    def reset(self) -> str:
        """Go back to the initial state, as if no torque had arrived, and return a message."""
        self.end()
        self._start = self.run.initial(self._given_start_ns)
        if self._given_start_ns:
            self._begin(self._start)
        self._duplicates.clear()
        # A torque that responds to the latest state may still be in transit. Remember the stamp,
        # so that this torque is rejected.
        self._stale_ns = self._latest.state.time_ns
        self._publish_start()
        return 'reset to the initial state; waiting for the first torque'

    def now_ns(self) -> int:
        """
        Return the time of the loop, ns.

        This time is the stamp of the torques to which the latest state is the response.
        """
        return max(0, self._latest.state.time_ns - self._step_ns)

    def problems(self) -> dict[int, list[str]]:
        """Return current problems by source. Problems of the loop belong to the first source."""
        if self._clock is not None and self._clock.has_rival:
            self._clock.destroy()
            self._clock = None
        problems = self.intake.problems()
        self._time.read()
        problems[self.intake.first] += self._time.problems() + self._stalls()
        silence = time.monotonic() - self._since
        if not (self.is_paused or self.waiting.total()) and silence > _WARN_AFTER:
            for source in self._awaited():
                problems[source].append(self._silence(self.intake.topic(source), silence))
        return problems

    def _silence(self, topic: str, seconds: float) -> str:
        names = listed(sorted({*map(full_name, self._node.get_publishers_info_by_topic(topic))}))
        text = (f'{topic}: no torque for {seconds:.0f} s: the controller has not responded to the '
                f'state at {self._latest.state.time_ns} ns; publishers: {names}')
        if self._clock is None or self.run.epoch is not None:
            return text
        return (f'{text}; the clock stands at {self._latest.state.time_ns * 1e-9:g} s, and a '
                'timer on /clock cannot start a lockstep loop: use mode: clock')

    def _stalls(self) -> list[str]:
        waited = self._queue.waiting_time if not self._current else \
            time.monotonic() - self._current[1].since
        if self.is_paused:
            return ['paused: torques wait']
        if waited > _WARN_AFTER:
            return [f'computing the response to a torque has taken {waited:.0f} s so far']
        return []

    def _awaited(self) -> list[int]:
        """
        Return the sources with a publisher that have sent no torque for the latest state yet.

        If none is missing, return all sources except the inertia.
        """
        sources = self.intake.drains
        return self._missing(self._latest.state.time_ns, sources) or [
            source for source in sources if source != BODY]

    def stamp(self) -> Time:
        """Return the current time, or the last published time if this node publishes /clock."""
        if self._clock is None:
            return self._node.get_clock().now().to_msg()
        return message_of(self._latest.state.time_ns)

    def pause(self, is_paused: bool) -> str:
        """Pause the loop, or resume it, and return a description."""
        text = super().pause(is_paused)
        self.work()
        return 'paused: torques wait' if is_paused else text

    def _begin(self, start: State, torques: Sequence[Torque] = ()) -> None:
        self._start = start
        self._begin_epoch(start, torques)

    def _read(self, queued: Queued) -> Torque | None:
        torque, sender = self.intake.inputs.torque(queued.data, queued.source), queued.sender
        self._check_stamp(torque.stamp_ns)
        if self._duplicates.is_duplicate(torque, sender) and not (
                self._duplicates.is_waiting(torque) and self._is_due(torque)):
            self._skip_duplicate(torque)
            return None
        if self.run.epoch is None:
            self._begin(replace(self._start, time_ns=torque.stamp_ns))
        self._duplicates.accepted(torque, sender)
        return torque

    def _is_due(self, torque: Torque) -> bool:
        # The response may have been waiting for a torque of a publisher that has ended since then.
        # In this case, a repeated torque triggers the response.
        return not self._missing(torque.stamp_ns, self.intake.drains.keys() - {torque.source})

    def _missing(self, stamp_ns: int, sources: Iterable[int]) -> list[int]:
        """Return the sources that have a publisher, but have not sent a torque with this stamp."""
        epoch = self.run.epoch
        return [source for source in sources
                if source != BODY and self.intake.publisher_count(source)
                and not (epoch and epoch.has_torque_at(stamp_ns, source))]

    def _check_stamp(self, stamp_ns: int) -> None:
        latest_ns = messages.LAST_NS - self._step_ns
        if stamp_ns > latest_ns:
            raise RejectedError(FUTURE, f'stamped {stamp_ns} ns, expected at most {latest_ns} ns, '
                                'because the response is stamped one step later')
        if stamp_ns == self._stale_ns:
            raise RejectedError(STALE, f'the torque at {stamp_ns} ns responds to a state from '
                                'before the reset')

    def _skip_duplicate(self, torque: Torque) -> None:
        """
        Count a torque that repeats an earlier one with the same stamp.

        Raises
        ------
        RejectedError
            The torque differs from the first torque with this stamp.

        """
        if not self._duplicates.is_same(torque):
            raise RejectedError(DIFFERS, 'a different torque was accepted before for the state '
                                f'at {torque.stamp_ns} ns; {self.several_publishers}')
        self._diagnostics.count(APPLIED, torque.source)
        self._diagnostics.count(REPLACED, torque.source)

    def _respond(self, torque: Torque, until: float) -> None:
        if torque.source == BODY or not self._is_due(torque):
            return
        snapshot = self.run.snapshot(torque.stamp_ns + self._step_ns, until)
        if snapshot is None:
            self._refuse(torque)
            return
        is_newest = snapshot.state.time_ns >= self._latest.state.time_ns
        self._publish(snapshot, snapshot if is_newest else self._latest)
        self._duplicates.responded(torque)

    def _refuse(self, torque: Torque) -> None:
        self._duplicates.discard(torque)

    def _publish_start(self) -> None:
        # If there is an epoch, take its snapshot, which also contains the torques on the body and
        # on the wheels.
        start = Snapshot(self._start, self._start)
        if self.run.epoch is not None:
            start = self.run.snapshot(self._start.time_ns, math.inf) or start
        self._publish(start, start)

    def _publish(self, snapshot: Snapshot, latest: Snapshot) -> None:
        self._latest, self._since = latest, time.monotonic()
        if snapshot.state.time_ns == self._stale_ns:  # the new motion has reached this stamp
            self._stale_ns = None
        self._send(snapshot, is_repeated=False)

    def _check(self) -> None:
        # Do not commit states after each torque, because the controller waits for the next one.
        self.settle()
        if self._republishing.is_due(*self._connected()) and not self.waiting.total():
            self._send(self._latest, is_repeated=True)

    def _send(self, snapshot: Snapshot, is_repeated: bool) -> None:
        time_ns = snapshot.state.time_ns
        if self._clock is not None:
            self._clock.publish(time_ns)
        self._outputs.publish(snapshot)
        self._republishing.published(is_repeated)
        if self._republishing.has_controller or self.run.epoch is not None:
            self._duplicates.published(time_ns)

    def _connected(self) -> tuple[int, int]:
        publishers = sum(self.intake.publisher_count(source) for source in self.intake.drains
                         if source != BODY)
        return publishers, self._outputs.subscription_count
