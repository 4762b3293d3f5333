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

"""Run a controller and a node in a closed loop, and record the loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
import signal
import time

from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.regress.controller import ControllerProcess
from rigid_body_ros.regress.loop import Loop
from rigid_body_ros.regress.node_process import NodeProcess, Start, Status
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.runtime.terminal import report

#: Time between two checks for signals and for the end of the controller, s.
_PERIOD = 0.05
#: How long the last torque of a controller may take to arrive after the controller has ended, s.
_IN_TRANSIT = 1.0


@dataclass(frozen=True)
class Span:
    """
    The duration of a closed loop.

    Attributes
    ----------
    last_ns : int
        The time from the start to the last torque of any log, ns.
    by_log : dict
        For each log, the time from the start to the last torque, ns, keyed by the name of the log.
        If `by_log` is empty, every log with torques must reach `last_ns`.

    """

    last_ns: int
    by_log: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of(cls, loop: Loop) -> Span:
        """Return the span of a loop."""
        return cls(max(loop.spans_ns.values()), loop.spans_ns)

    def is_over(self, elapsed_ns: Mapping[str, int]) -> bool:
        """
        Return whether a loop has run for this span.

        `elapsed_ns` contains the time from the start to the latest torque of each log, ns.
        """
        expected = self.by_log or dict.fromkeys(elapsed_ns, self.last_ns)
        return bool(elapsed_ns) and all(elapsed_ns.get(name, -1) >= last_ns
                                        for name, last_ns in expected.items())


@dataclass(frozen=True)
class Session:
    """
    A controller's command, and a function that creates the node that the controller works with.

    Attributes
    ----------
    command : list of str
        The controller's command and its arguments.
    start : callable
        The function that creates the node. It is called in a separate process, and returns a
        context manager that yields the node.
    timeout : float, s
        The longest wall time that a loop may take.
    wheels : tuple of str
        The names of the wheels in the scene.

    """

    command: list[str]
    start: Start
    timeout: float
    wheels: tuple[str, ...] = ()

    def record(self, path: str | Path, span: Span, may_end: bool = False) -> None:
        """
        Run the closed loop once, and write the loop to a recording.

        Parameters
        ----------
        path : str or Path
            The recording to write.
        span : Span
            How long to run the loop.
        may_end : bool
            Whether to accept a shorter loop if the controller ends early without an error.

        Raises
        ------
        InputError
            The command cannot be started, ends before the loop is over, sends no torques, takes
            too long, or starts another node that publishes odometry.

        """
        with NodeProcess(self.start, span.by_log) as node, \
                ControllerProcess(self.command) as controller:
            try:
                self._run(node, controller, span, may_end)
            except InputError:
                for line in controller.output:
                    report(f'    {line}')
                raise
            controller.end()  # without the node, the controller might wait for messages forever
            node.write(path, span.last_ns)

    def _run(self, node: NodeProcess, controller: ControllerProcess, span: Span,
             may_end: bool) -> None:
        until, ending = time.monotonic() + self.timeout, None
        while not span.is_over(node.status.elapsed_ns):
            node.watch(_PERIOD)
            interrupts.check()
            if node.status.has_rival:
                raise InputError(f'{self._name}: expected a controller alone, found that it '
                                 'starts a node that publishes odometry, too')
            if ending is None and (ending := controller.status) is not None:
                until = min(until, time.monotonic() + _IN_TRANSIT)
            if time.monotonic() > until:
                break
        else:
            return
        if ending is None:
            raise InputError(f'{self._name}: expected the loop to end within --timeout '
                             f'{self.timeout:g} s, found that {_got(node.status)}')
        if ending or not (may_end and node.status.elapsed_ns):
            raise InputError(f'{self._name}: expected a controller that runs to the end of the '
                             f'loop, found that it {_described(ending)}; {_got(node.status)}')

    @property
    def _name(self) -> str:
        return Path(self.command[0]).name


def _got(status: Status) -> str:
    if not status.elapsed_ns:
        missing = f': nothing publishes {listed(status.unpublished)}' if status.unpublished else ''
        return f'the node has accepted no torque{missing}'
    seconds = min(status.elapsed_ns.values()) * 1e-9
    return f'its torques reach {seconds:.9g} s of the loop'


def _described(ending: int) -> str:
    if ending < 0:
        return f'was ended by {signal.Signals(-ending).name}'
    return f'ended with exit status {ending}'
