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

"""Compare the closed loop of a controller with a reference, or create a new reference."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rigid_body_ros.regress.loop import Differences, differences, Loop, read
from rigid_body_ros.regress.session import Session, Span
from rigid_body_ros.report.text import lines

_CAUSES = 'wall time, random numbers or the order in which its threads run'


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
    found : Differences
        The differences between `reference` and `loop`.
    again : Differences or None
        The differences between two runs of the controller; None if the controller ran only once.
    tolerance : float or None, rad
        The largest angle by which attitudes may differ. None if all bits must be equal.

    """

    reference: Loop
    loop: Loop
    path: Path
    found: Differences
    again: Differences | None
    tolerance: float | None

    @property
    def is_same(self) -> bool:
        """
        Return whether the loop agrees with the reference.

        If `tolerance` is None, all bits must agree; otherwise, see `Differences.within`.
        """
        return self.found.within(self.tolerance)

    @property
    def verdict(self) -> str:
        """Summarize the result in one sentence."""
        if self.again is not None and not self.again.equal:
            same = 'within the tolerance, but ' if self.is_same else ''
            return f'{same}the controller is not reproducible: two runs differ from ' \
                   f'{self.again.first_ns} ns on; does it use {_CAUSES}?'
        if self.found.equal:
            return 'the loop has the same bits'
        if self.is_same:
            return f'the loop is the same within {self.tolerance:g} rad'
        return 'the loop differs from the reference'

    def rows(self) -> list[tuple[str, str]]:
        """Return the result as rows to print, each with a name and a text."""
        found = [('result', self.verdict), *self.found.rows()]
        if self.again is not None and self.again.equal:
            found.append(('second run', 'has the same bits as the first'))
        return found

    def text(self) -> str:
        """Return the result as text, with one fact per line."""
        return lines(f'{name:14}{text}' for name, text in self.rows())

    __str__ = text

    def as_dict(self) -> dict[str, Any]:
        """Return the content of the file that the option --json writes, as JSON types."""
        return {'equal': self.is_same, **self.found.as_dict()}


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
    loop = _recorded(session, first, span)
    found, again = differences(reference, loop), None
    if not found.within(tolerance):
        again = differences(loop, _recorded(session, folder / 'second.mcap', span))
    return Regression(reference, loop, first, found, again, tolerance)


def update(session: Session, span: Span, folder: Path,
           tolerance: float | None = None) -> Regression:
    """
    Run a controller twice, and compare the runs. The first run can serve as a new reference.

    The arguments and errors are the same as for `compare`, except that `span` replaces the path of
    the reference and sets the duration of the loop. The loop ends before this duration if the
    controller ends early without an error.
    """
    first = folder / 'first.mcap'
    reference = _recorded(session, first, span, may_end=True)
    loop = _recorded(session, folder / 'second.mcap', Span.of(reference))
    found = differences(reference, loop)
    return Regression(reference, loop, first, found, found, tolerance)


def _recorded(session: Session, path: Path, span: Span, may_end: bool = False) -> Loop:
    session.record(path, span, may_end)
    return read(path, session.wheels)
