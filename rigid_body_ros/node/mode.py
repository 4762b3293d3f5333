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

"""The common part of all modes: the run, and a torque queue processed in short slices."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import time

from rigid_body_ros.live.checkpoint import Checkpoint
from rigid_body_ros.live.events import LATE, RejectedError
from rigid_body_ros.live.inputs import Torque
from rigid_body_ros.live.run import Run
from rigid_body_ros.live.torque_queue import Queued, Sender, TorqueQueue
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.node.diagnostics import Diagnostics
from rigid_body_ros.node.intake import BEST_EFFORT, Intake, PollingNode
from rigid_body_ros.node.outputs import Publishers
from rigid_body_ros.node.parameters import NodeParameters
from rigid_body_ros.node.sources import sources_of
from rigid_body_ros.propagation.segment import OutOfTimeError
from rigid_body_ros.scene.parameters import LOCKSTEP
from std_srvs.srv import SetBool

#: Length of a slice of work, in seconds. After each slice, the other callbacks get to run.
BUDGET = 0.02


class Mode:
    """
    Apply and log queued torques in short slices of work, so that other callbacks run in between.

    Real time and lockstep are subclasses, which decide which torques to accept, and when to
    publish a state.

    Parameters
    ----------
    node : Node
    parameters : NodeParameters
    outputs : Publishers
    diagnostics : Diagnostics
    checkpoint : Checkpoint, optional
        The checkpoint of the node. If it contains a state, the run continues from that state.

    """

    #: The QoS of the torques, and whether `take` polls them.
    qos, is_polled = BEST_EFFORT, True

    def __init__(self, node: PollingNode, parameters: NodeParameters, outputs: Publishers,
                 diagnostics: Diagnostics, checkpoint: Checkpoint | None) -> None:
        scene = parameters.scene
        self._node, self._parameters, self._outputs = node, parameters, outputs
        self._diagnostics, self._checkpoint = diagnostics, checkpoint
        self._scene = scene
        self.intake = Intake(node, scene, sources_of(scene), diagnostics, self.qos, self.is_polled,
                             self.enqueue, self.work)
        self._given_start_ns = scene.start.time_ns
        self._saved = checkpoint.start if checkpoint else None
        self.run = Run(scene, outputs, diagnostics)
        self._queue = TorqueQueue(diagnostics, is_patient=self._scene.mode == LOCKSTEP)
        #: The torque that is being processed, followed by whether this torque has been applied,
        #: and whether the response to this torque has been published.
        self._current: tuple[Torque, Queued] | None = None
        self._is_applied = self._is_answered = False
        #: Whether the motion is paused, so that torques wait.
        self.is_paused = False

    def enqueue(self, data: bytes, sender: Sender, source: int, received_ns: int = 0) -> None:
        """
        Queue a torque message from a source, which the middleware received at `received_ns`.

        Raises
        ------
        RejectedError
            The clock has no time yet, or too many torques are waiting.

        """
        self._queue.check_room()
        self._queue.put(Queued(source, data, sender, self._arrived_ns(received_ns),
                               time.monotonic()))

    def _arrived_ns(self, received_ns: int) -> int:
        """
        Return the node's time at which a torque arrived, ns, or 0 in lockstep.

        Raises
        ------
        RejectedError
            The clock has no time yet.

        """
        return 0

    def take(self) -> None:
        """Take the torques that have arrived, if the mode polls its subscriptions."""

    def pause(self, is_paused: bool) -> str:
        """Pause or resume the motion, and return a description. Not in real time."""
        self.is_paused = is_paused
        return 'resumed'

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success, response.message = True, self.pause(request.data)
        return response

    def deactivate(self) -> None:
        """Stop publishing. The owner of the node destroys the timers and services."""

    def set_rate(self, rate: float) -> None:
        """Change the publishing rate, Hz. Not in lockstep, in which the torques set the pace."""

    def work(self) -> None:
        """Work on the waiting torques. An executor calls this method after each torque."""
        raise NotImplementedError

    @property
    def waiting(self) -> Counter[int]:
        """Return how many torques of each source are waiting for their turn or for the clock."""
        waiting = self._queue.by_source()
        if self._current and not self._is_applied:
            waiting[self._current[1].source] += 1
        return waiting

    def process(self) -> bool:
        """Apply waiting torques for one slice of work. Return True if no work is left."""
        until = time.monotonic() + BUDGET
        try:
            while (self._current or self._queue) and time.monotonic() < until:
                self._current = self._current or self._next()
                if self._current:
                    self._finish(*self._current, until)
                    self._current = None
        except OutOfTimeError as error:
            self._miss_deadline(error)
        return not (self._current or len(self._queue))

    def settle(self) -> None:
        """Commit the states that are final, and publish the log. Nobody waits for either."""
        try:
            self.run.commit(time.monotonic() + BUDGET)
        except OutOfTimeError as error:
            self._miss_deadline(error)
        self._outputs.flush()

    def end(self, until: float | None = None, kept: str = LATE) -> None:
        """
        End the epoch, if there is one, and reject all torques that are still waiting.

        Early torques that are held for the cause `kept` are not rejected, but stay in the queue
        for the next epoch. The deadline for committing the states of the epoch is `until`, in
        seconds on the monotonic clock. If `until` is None, the deadline is 0.2 s from now.
        """
        if self._current and not self._is_applied:
            self._queue.put(self._current[1])  # to be rejected
        self._current, self._is_applied, self._is_answered = None, False, False
        self._queue.end(kept)
        self.run.end(until)

    def _begin_epoch(self, start: State, torques: Sequence[Torque], kept: str = LATE) -> None:
        """Begin an epoch with torques of the previous one, which `end` ends; see there."""
        if self.run.epoch is not None:  # otherwise the queued torques belong to the new epoch
            self.end(kept=kept)
        self.run.begin(start, torques)
        self._parameters.set_start(start)

    def _next(self) -> tuple[Torque, Queued] | None:
        """Take the first torque from the queue, or return None if it cannot be applied now."""
        queued = self._queue.pop()
        try:
            torque = self._read(queued)
        except RejectedError as rejected:
            self._diagnostics.reject(rejected, queued.source)
            return None
        return (torque, queued) if torque else None

    def _finish(self, torque: Torque, queued: Queued, until: float) -> None:
        # Publish the response first, because a controller is waiting for it. All other work can
        # wait.
        if not self._is_applied:
            self._is_applied = self.run.apply(torque, queued.arrived_ns or torque.stamp_ns)
            if not self._is_applied:
                self._refuse(torque)
                return
        if not self._is_answered:
            self._respond(torque, until)
            self._is_answered = True
        if self.run.must_commit:
            self.run.commit(until)
        self._is_applied = self._is_answered = False

    def _read(self, queued: Queued) -> Torque | None:
        """
        Decode and return a torque, or return None if the torque should be skipped.

        Raises
        ------
        RejectedError
            The torque is not acceptable.

        """
        raise NotImplementedError

    def _respond(self, torque: Torque, until: float) -> None:
        """Respond to an applied torque."""

    def _refuse(self, torque: Torque) -> None:
        """Respond to a torque that cannot be applied."""

    def _miss_deadline(self, error: OutOfTimeError) -> None:
        """Report that a computation did not finish within one slice of work."""

    def _warn_away(self, seconds: float) -> None:
        """Warn that the node was down for a number of seconds before it was started again."""
        self._node.get_logger().warning(
            f'the node continues from the checkpoint {self._checkpoint}, after it was down for '
            f'{seconds:.3g} s: no torque acts in between')
