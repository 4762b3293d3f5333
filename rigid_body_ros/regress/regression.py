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
Run a controller and a node in a closed loop, and compare the loop with a reference.

A loop can also become a new reference.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
import signal
import time
from typing import Any, NamedTuple

from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.regress.loop import Differences, differences, Loop, read
from rigid_body_ros.regress.processes import ControllerProcess, NodeProcess, Start, Status
from rigid_body_ros.report.text import lines
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.runtime.terminal import report

#: Time between two checks for signals and for the end of the controller, s.
_PERIOD = 0.05
#: How long the last torque of a controller may take to arrive after the controller has ended, s.
_IN_TRANSIT = 1.0
#: Why a command may not be reproducible.
CAUSES = 'wall time, random numbers or the order in which its threads run'


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


class Words(NamedTuple):
    """What errors call a command and its work, and a function that says how far it has come."""

    command: str
    work: str
    progress: Callable[[Status], str]


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
    words : Words
        What errors call the command and its work; by default, a controller and a loop.

    """

    command: list[str]
    start: Start
    timeout: float
    wheels: tuple[str, ...] = ()
    words: Words = field(default_factory=lambda: Words('controller', 'loop', _got))

    def record(self, path: str | Path, span: Span, may_end: bool = False) -> Loop:
        """
        Run the closed loop once, write the loop to a recording, and read it.

        The arguments and errors are those of `run`.
        """
        self.run(path, span, may_end)
        return read(path, self.wheels)

    def run(self, path: str | Path, span: Span, may_end: bool = False) -> None:
        """
        Run the command and the node once, and let the node write its log.

        Parameters
        ----------
        path : str or Path
            The file to write.
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
                self._wait(node, controller, span, may_end)
            except InputError:
                for line in controller.output:
                    report(f'    {line}')
                raise
            controller.end()  # without the node, the controller might wait for messages forever
            node.write(path, span.last_ns)

    def _wait(self, node: NodeProcess, controller: ControllerProcess, span: Span,
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
            raise InputError(f'{self._name}: expected the {self.words.work} to end within '
                             f'--timeout {self.timeout:g} s, found that '
                             f'{self.words.progress(node.status)}')
        if ending or not (may_end and node.status.elapsed_ns):
            how = f'was ended by {signal.Signals(-ending).name}' if ending < 0 else \
                f'ended with exit status {ending}'
            raise InputError(f'{self._name}: expected a {self.words.command} that runs to the '
                             f'end of the {self.words.work}, found that it {how}; '
                             f'{self.words.progress(node.status)}')

    @property
    def _name(self) -> str:
        return Path(self.command[0]).name


@dataclass(frozen=True, eq=False)
class Regression:
    """
    The closed loop of a controller, compared with a reference.

    Attributes
    ----------
    reference, loop : Loop
        The reference and the first run of the controller. If a new reference is created, these are
        the first and the second run of the controller.
    path : Path
        The recording of the first run.
    differences : Differences
        The differences between `reference` and `loop`.
    again : Differences or None
        The differences between two runs of the controller; None if the controller ran only once.
    tolerance : float or None, rad
        The largest angle by which attitudes may differ. None if all bits must be equal.

    """

    reference: Loop
    loop: Loop
    path: Path
    differences: Differences
    again: Differences | None
    tolerance: float | None

    @property
    def is_same(self) -> bool:
        """
        Return whether the loop agrees with the reference.

        If `tolerance` is None, all bits must agree; otherwise, see `Differences.within`.
        """
        return self.differences.within(self.tolerance)

    @property
    def verdict(self) -> str:
        """Summarize the result in one sentence."""
        if self.again is not None and not self.again.equal:
            same = 'within the tolerance, but ' if self.is_same else ''
            return f'{same}the controller is not reproducible: two runs differ from ' \
                   f'{self.again.first_ns} ns on; does it use {CAUSES}?'
        if self.differences.equal:
            return 'the loop has the same bits'
        if self.is_same:
            return f'the loop is the same within {self.tolerance:g} rad'
        return 'the loop differs from the reference'

    def rows(self) -> list[tuple[str, str]]:
        """Return the result as rows to print, each with a name and a text."""
        rows = [('result', self.verdict), *self.differences.rows()]
        if self.again is not None and self.again.equal:
            rows.append(('second run', 'has the same bits as the first'))
        return rows

    def text(self) -> str:
        """Return the result as text, with one fact per line."""
        return lines(f'{name:14}{text}' for name, text in self.rows())

    __str__ = text

    def as_dict(self) -> dict[str, Any]:
        """Return the content of the file that the option --json writes, as JSON types."""
        return {'equal': self.is_same, **self.differences.as_dict()}


def compare(session: Session, path: str | Path, folder: Path,
            tolerance: float | None = None) -> Regression:
    """
    Run a controller for as long as a reference, and compare its loop with the reference.

    If the loops differ, the controller is run again to find out whether its loop is reproducible.

    Parameters
    ----------
    session : Session
        The controller, and the node to run it with.
    path : str or Path
        The recording of the reference.
    folder : Path
        The folder where the runs are recorded.
    tolerance : float, optional, rad
        The largest angle by which attitudes may differ. By default, all bits must be equal.

    Raises
    ------
    InputError
        The reference cannot be read, or `Session.record` raises InputError.

    """
    reference = read(path, session.wheels)
    span, first = Span.of(reference), folder / 'first.mcap'
    loop = session.record(first, span)
    changes, again = differences(reference, loop), None
    if not changes.within(tolerance):
        again = differences(loop, session.record(folder / 'second.mcap', span))
    return Regression(reference, loop, first, changes, again, tolerance)


def update(session: Session, span: Span, folder: Path,
           tolerance: float | None = None) -> Regression:
    """
    Run a controller twice, and compare the runs. The first run can serve as a new reference.

    The arguments and errors are the same as for `compare`, except that `span` replaces the path of
    the reference and sets the duration of the loop. The loop ends before this duration if the
    controller ends early without an error.
    """
    first = folder / 'first.mcap'
    reference = session.record(first, span, may_end=True)
    loop = session.record(folder / 'second.mcap', Span.of(reference))
    changes = differences(reference, loop)
    return Regression(reference, loop, first, changes, changes, tolerance)


def missing(status: Status) -> str:
    """Return the topics on which nothing publishes, as the end of an error, or ''."""
    return f': nothing publishes {listed(status.unpublished)}' if status.unpublished else ''


def _got(status: Status) -> str:
    if not status.elapsed_ns:
        return f'the node has accepted no torque{missing(status)}'
    seconds = min(status.elapsed_ns.values()) * 1e-9
    return f'its torques reach {seconds:.9g} s of the loop'
