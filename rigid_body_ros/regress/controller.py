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

"""Run a controller's command in a process session of its own, and end that session's processes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
import os
from pathlib import Path
import signal
import subprocess
import tempfile
import time

from rigid_body_ros.common.errors import InputError, printable, reason

#: How long to wait after SIGINT, the signal of Ctrl-C, before sending SIGKILL, s.
_GRACE = 3.0
_PERIOD = 0.02
#: Maximum number of output lines to show, and maximum number of characters per line.
_LINES, _WIDTH = 20, 200


class ControllerProcess(AbstractContextManager['ControllerProcess']):
    """
    A command that runs in a new process session.

    Use this class as a context manager, which ends the command on exit.

    Parameters
    ----------
    words : sequence of str
        The command and its arguments.

    Raises
    ------
    InputError
        The command cannot be started.

    """

    def __init__(self, words: Sequence[str]) -> None:
        self.words = words
        # Use a file, not a pipe. Nobody reads the output during the run, so a full pipe would
        # block the command.
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 (`__exit__` closes it)
        try:
            self._process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=self._output,
                                             stderr=subprocess.STDOUT, start_new_session=True)
        except (OSError, ValueError) as error:
            self._output.close()
            raise InputError(f'{words[0]}: cannot be started: {reason(error)}') from error

    def __exit__(self, *error: object) -> None:
        self.end()
        self._output.close()

    @property
    def status(self) -> int | None:
        """Return the exit code: None while the command runs, negative if a signal has ended it."""
        return self._process.poll()

    @property
    def output(self) -> list[str]:
        """Return the last lines that the command printed."""
        # Use pread, because read would move the file position at which the command writes.
        descriptor = self._output.fileno()
        size = os.fstat(descriptor).st_size
        wanted = _LINES * _WIDTH
        text = os.pread(descriptor, wanted, max(0, size - wanted)).decode(errors='replace')
        return [printable(line[:_WIDTH]) for line in text.splitlines()[-_LINES:]]

    def end(self) -> None:
        """End all processes of the session: send SIGINT and, if that fails, SIGKILL after 3 s."""
        until = time.monotonic() + _GRACE
        self._send(signal.SIGINT)
        while self._alive() and time.monotonic() < until:
            time.sleep(_PERIOD)
        while self._alive():
            self._send(signal.SIGKILL)
            time.sleep(_PERIOD)

    def _alive(self) -> bool:
        return self._process.poll() is None or bool(_members(self._process.pid))

    def _send(self, number: int) -> None:
        for process in {self._process.pid, *_members(self._process.pid)}:
            try:
                # Do not signal the first process if it has ended: its ID may be in use again.
                if process != self._process.pid or self._process.poll() is None:
                    os.kill(process, number)
            except ProcessLookupError:
                continue


def _members(session: int) -> list[int]:
    """Return the IDs of the running processes in a session; an empty list without /proc."""
    found = []
    for stat in Path('/proc').glob('[0-9]*/stat'):
        try:
            text = stat.read_text(errors='replace')
        except OSError:
            continue  # the process has ended in the meantime
        state, _, _, number, *_ = text.rpartition(')')[2].split()
        if int(number) == session and state not in 'ZX':
            found.append(int(stat.parent.name))
    return found
