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

"""What both modes share: the run, and the queue of torques that is processed in short slices."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
import time

from rclpy.node import Node
from rclpy.subscription import Subscription
from rigid_body_ros.live.checkpoint import Checkpoint
from rigid_body_ros.live.events import LATE, RejectedError
from rigid_body_ros.live.inputs import Inputs, Torque
from rigid_body_ros.live.run import Run
from rigid_body_ros.live.torque_queue import Queued, TorqueQueue
from rigid_body_ros.node.diagnostics import Diagnostics
from rigid_body_ros.node.outputs import Publishers
from rigid_body_ros.node.parameters import NodeParameters
from rigid_body_ros.scene.parameters import LOCKSTEP

#: Length of a slice of work, s. After each slice, all other callbacks run.
BUDGET = 0.02


class Mode:
    """
    Apply and log the torques of a queue, in short slices, between which other callbacks run.

    Each mode is a subclass that decides which torques are accepted, and when a state is published.

    Parameters
    ----------
    node : Node
    parameters : NodeParameters
    inputs : Inputs
    outputs : Publishers
    diagnostics : Diagnostics
    checkpoint : Checkpoint, optional
        If the checkpoint contains a state, the run continues from that state.

    """

    def __init__(self, node: Node, parameters: NodeParameters, inputs: Inputs, outputs: Publishers,
                 diagnostics: Diagnostics, checkpoint: Checkpoint | None) -> None:
        scene = parameters.scene
        self._node, self._parameters, self._outputs = node, parameters, outputs
        self._diagnostics, self._checkpoint = diagnostics, checkpoint
        self._inputs, self._scene = inputs, scene
        self._given_start_ns = scene.start.time_ns
        self.run = Run(scene, outputs, diagnostics)
        self._queue = TorqueQueue(diagnostics, is_patient=self._scene.mode == LOCKSTEP)
        #: The subscriptions to torques by source, to count their publishers.
        self._torques: Mapping[int, Subscription] = {}
        #: The torque that is being processed; whether it has been applied; and whether the
        #: response has been published.
        self._current: tuple[Torque, Queued] | None = None
        self._is_applied = self._is_answered = False
        self._wake: Callable[[], None] = lambda: None

    def connect(self, torques: Mapping[int, Subscription], wake: Callable[[], None]) -> None:
        """Set the subscriptions to torques, by source, and a function that starts work at once."""
        self._torques, self._wake = torques, wake

    @property
    def waiting(self) -> Counter[int]:
        """Return the number of torques of each source that wait to be applied or for the clock."""
        waiting = self._queue.by_source()
        if self._current and not self._is_applied:
            waiting[self._current[1].source] += 1
        return waiting

    def catch_up(self) -> None:
        """Publish overdue outputs; called while many messages arrive and delay all timers."""

    def process(self) -> bool:
        """Apply waiting torques for one slice of time; return whether all work is done."""
        until = time.monotonic() + BUDGET
        try:
            while (self._current or self._queue) and time.monotonic() < until:
                self._current = self._current or self._next()
                if self._current:
                    self._finish(*self._current, until)
                    self._current = None
        except TimeoutError as error:
            self._miss_deadline(error)
        return not (self._current or len(self._queue))

    def end(self, until: float | None = None, kept: str = LATE) -> None:
        """
        End the epoch, if there is one, and reject all torques that still wait.

        Early torques held for the cause `kept` remain for the next epoch. The states of the epoch
        are committed by the time `until`, s, monotonic clock; if None, within 0.2 s.
        """
        if self._current and self._is_applied:  # the response takes too long to compute
            self.run.log(self._current[0])
        elif self._current:
            self._queue.put(self._current[1])  # to be rejected
        self._current, self._is_applied, self._is_answered = None, False, False
        self._queue.end(kept)
        self.run.end(until)

    def _next(self) -> tuple[Torque, Queued] | None:
        """Remove and return the first torque of the queue, or None if it is not applied now."""
        queued = self._queue.pop()
        try:
            torque = self._read(queued)
        except RejectedError as rejected:
            self._diagnostics.reject(rejected, queued.source)
            return None
        return (torque, queued) if torque else None

    def _finish(self, torque: Torque, queued: Queued, until: float) -> None:
        # The response comes first, because a controller waits for it; everything else can wait.
        if not self._is_applied:
            self._is_applied = self.run.apply(torque, queued.arrived_ns or torque.stamp_ns)
            if not self._is_applied:
                self._refuse(torque)
                return
        if not self._is_answered:
            self._respond(torque, until)
            self._is_answered = True
        self.run.commit(until)
        self._is_applied = self._is_answered = False
        self.run.log(torque)

    def _read(self, queued: Queued) -> Torque | None:
        """Decode a torque: return it, return None to skip it, or raise RejectedError."""
        raise NotImplementedError

    def _respond(self, torque: Torque, until: float) -> None:
        """Respond to an applied torque."""

    def _refuse(self, torque: Torque) -> None:
        """Respond to a torque that cannot be applied."""

    def _miss_deadline(self, error: TimeoutError) -> None:
        """Report that a computation did not finish within its slice of work."""

    def _warn_away(self, seconds: float) -> None:
        """Warn that the node was down for a time, s, before this start."""
        self._node.get_logger().warning(
            f'the node continues from the checkpoint {self._checkpoint}, after it was down for '
            f'{seconds:.3g} s: no torque acts in between')
