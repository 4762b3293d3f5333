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
Run a node in a separate process.

A process can be killed even if threads of the middleware deadlock.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import AbstractContextManager, suppress
import multiprocessing
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Protocol

from rigid_body_ros.common.errors import InputError
from rigid_body_ros.runtime import interrupts

#: s; time between two checks for a message from the parent process.
_PERIOD = 0.02
#: s; how long the node may take to end.
_PATIENCE = 20.0
#: The message that the process of the node sends after it has written the log.
_WRITTEN = 'written'


class Node(Protocol):
    """A node in lockstep that keeps a log."""

    @property
    def elapsed_ns(self) -> dict[str, int]:
        """Return the time, ns, from the start to the newest torque, for each log with torques."""

    @property
    def unpublished(self) -> list[str]:
        """Return the torque topics to which no node publishes."""

    @property
    def has_rival(self) -> bool:
        """Return whether another node also publishes the states."""

    def spin(self, seconds: float) -> None:
        """Run the node for `seconds`."""

    def finish(self) -> None:
        """Commit the last states."""

    def write(self, path: str | Path, last_ns: int) -> None:
        """Write the log to a recording, up to `last_ns` after the start."""


class Status(NamedTuple):
    """The report of a `Node`."""

    elapsed_ns: dict[str, int]
    unpublished: list[str]
    has_rival: bool


#: A function that is called in the process of the node, and returns a context manager that yields
#: the node. Its argument contains the names of logs; it is empty if the names are unknown. Before
#: it starts, the node waits until the topics of these logs have publishers.
Start = Callable[[Collection[str]], AbstractContextManager[Node]]


class NodeProcess:
    """
    The process of a node; a context manager.

    Parameters
    ----------
    start : callable
        A function that is called with `logs` in the process of the node.
    logs : collection of str
        The names of the logs whose topics must have publishers before the node starts.

    Attributes
    ----------
    status : Status
        The latest report of the node.

    """

    def __init__(self, start: Start, logs: Collection[str] = ()) -> None:
        self.status = Status({}, [], False)
        # Use spawn: a fork would copy the locks of other threads, but not the threads themselves.
        context = multiprocessing.get_context('spawn')
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, start, [*logs]),
                                        daemon=True)
        with interrupts.blocked_in_children():
            self._process.start()
        theirs.close()  # otherwise, this process would not notice the end of the other process

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._connection.close()
        if kind:
            self._process.kill()
        self._process.join(_PATIENCE)
        self._process.kill()  # the process may hang
        self._process.join()

    def watch(self, seconds: float) -> None:
        """
        Receive reports of the node; wait at most `seconds` for the first report.

        Raises
        ------
        InputError
            The node cannot run.

        """
        while isinstance(found := self._received(seconds), Status):
            self.status, seconds = found, 0.0

    def write(self, path: str | Path, last_ns: int) -> None:
        """
        Let the node write the log up to `last_ns` after the start, and end the node.

        Raises
        ------
        InputError
            The node cannot write the log, or does not end.

        """
        with suppress(OSError):  # the process has ended; its last message contains the reason
            self._connection.send((path, last_ns))
        while isinstance(found := self._received(_PATIENCE), Status):
            self.status = found  # the node sent this report before it received the request
        if found != _WRITTEN:
            raise InputError(f'expected the node to end within {_PATIENCE:g} s, found that it '
                             'hangs')

    def _received(self, seconds: float) -> Status | str | None:
        """Return the next message, or None if no message arrives within `seconds`."""
        try:
            found = self._connection.recv() if self._connection.poll(seconds) else None
        except (EOFError, OSError):
            self._process.join()
            raise InputError('expected a node that runs to the end of the loop, found that its '
                             f'process ended with status {self._process.exitcode}') from None
        if isinstance(found, InputError):
            raise found
        return found


def _serve(connection: Connection, start: Start, logs: Collection[str]) -> None:
    """Run a node and report its status until the parent process asks for the log or exits."""
    with suppress(KeyboardInterrupt, EOFError, OSError), interrupts.deferred(until_exit=True):
        try:
            with start(logs) as node:
                reported = None
                while not connection.poll():
                    node.spin(_PERIOD)
                    interrupts.check()
                    status = Status(node.elapsed_ns, node.unpublished, node.has_rival)
                    if status != reported:
                        connection.send(status)
                        reported = status
                path, last_ns = connection.recv()
                node.finish()
                node.write(path, last_ns)
            connection.send(_WRITTEN)
        except InputError as error:
            connection.send(error)
