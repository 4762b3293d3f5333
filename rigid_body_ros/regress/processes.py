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
Run a node in a process, and the command of a controller in a session of processes.

The processes share a private ROS domain, in which no other processes send or receive messages.
A process can be killed even if threads of the ROS middleware deadlock.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from multiprocessing.connection import Connection
import os
from pathlib import Path
import signal
import socket
import subprocess
import tempfile
import time
from typing import NamedTuple, Protocol

from rigid_body_ros.common.errors import InputError, printable, reason
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.runtime.pool import Child

#: Time between two checks for a message from the parent process, or for the end of a command, s.
_PERIOD = 0.02
#: How long to wait for the node to end, s.
_PATIENCE = 20.0
#: The message that the node's process sends after it has written the log.
_WRITTEN = 'written'
#: How long to wait after SIGINT, the signal of Ctrl-C, before sending SIGKILL, s.
_GRACE = 3.0
#: Maximum number of output lines to show, and maximum number of characters per line.
_LINES, _WIDTH = 20, 200
#: The domains to try. Their ports are below the range that Linux uses for outgoing connections.
#: The search begins with the highest number, because users tend to choose low numbers.
_DOMAINS = range(100, 0, -1)
#: The first port of domain 0, and the number of ports per domain. ROS nodes use the lowest free
#: ports of their domain.
_FIRST_PORT, _PORTS = 7400, 250
#: The environment variable that keeps all packets on this machine. The name of this variable in
#: ROS 2 Humble differs from its name in later releases.
_LOCAL = {'ROS_LOCALHOST_ONLY': '1'} if os.environ.get('ROS_DISTRO') == 'humble' else \
    {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
#: Environment variables that would connect the nodes to other machines.
_ELSEWHERE = 'ROS_STATIC_PEERS', 'ROS_DISCOVERY_SERVER'


class Node(Protocol):
    """The interface of a node that runs in lockstep and keeps a log."""

    @property
    def elapsed_ns(self) -> dict[str, int]:
        """Return, for each log with torques, the time from the start to the newest torque, ns."""

    @property
    def unpublished(self) -> list[str]:
        """Return the torque topics that have no publisher."""

    @property
    def has_rival(self) -> bool:
        """Return whether another node also publishes on the topic of the states."""

    def spin(self, seconds: float) -> None:
        """Run the node for this many seconds."""

    def finish(self) -> None:
        """Commit the last states before the log is written."""

    def write(self, path: str | Path, last_ns: int) -> None:
        """Write the log to a recording, up to the time `last_ns` after the start."""


class Status(NamedTuple):
    """The progress of a node, as reported by the methods of `Node`."""

    elapsed_ns: dict[str, int]
    unpublished: list[str]
    has_rival: bool


#: A function that creates a node. The function is called in the node's process, and returns a
#: context manager that yields the node. The argument of the function contains the names of some
#: logs, or is empty if the names are not known. The node does not start until the topics of these
#: logs have publishers.
Start = Callable[[Collection[str]], AbstractContextManager[Node]]


class NodeProcess(Child, AbstractContextManager['NodeProcess']):
    """
    A process that runs a node.

    Use this class as a context manager, which ends the process on exit.

    Parameters
    ----------
    start : callable
        The function that creates the node. It is called with `logs` in the node's process.
    logs : collection of str
        The names of the logs whose topics must have publishers before the node starts.

    Attributes
    ----------
    status : Status
        The latest report of the node.

    """

    def __init__(self, start: Start, logs: Collection[str] = ()) -> None:
        self.status = Status({}, [], False)
        super().__init__(_serve, start, [*logs])

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        self.connection.close()
        if kind:
            self.process.kill()
        self.wait(_PATIENCE)

    def watch(self, seconds: float) -> None:
        """
        Receive reports from the node; wait at most `seconds` for the first report.

        Raises
        ------
        InputError
            The node cannot run.

        """
        while isinstance(message := self._received(seconds), Status):
            self.status, seconds = message, 0.0

    def write(self, path: str | Path, last_ns: int) -> None:
        """
        Tell the node to write its log, up to the time `last_ns` after the start, and to end.

        Raises
        ------
        InputError
            The node cannot write the log, or does not end.

        """
        with suppress(OSError):  # if the process has ended, its last message gives the reason
            self.connection.send((path, last_ns))
        while isinstance(message := self._received(_PATIENCE), Status):
            self.status = message  # the node sent this report before it received our request
        if message != _WRITTEN:
            raise InputError(f'expected the node to end within {_PATIENCE:g} s, found that it '
                             'hangs')

    def _received(self, seconds: float) -> Status | str | None:
        """Return the next message, or None if no message arrives within `seconds`."""
        try:
            message = self.connection.recv() if self.connection.poll(seconds) else None
        except (EOFError, OSError):
            self.process.join()
            raise InputError('expected a node that runs to the end of the loop, found that its '
                             f'process ended with status {self.process.exitcode}') from None
        if isinstance(message, InputError):
            raise message
        return message


def _serve(connection: Connection, start: Start, logs: Collection[str]) -> None:
    """Run a node, and report its status until the parent process asks for the log or exits."""
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
            # Do not signal the first process if it has ended: its ID may be in use again.
            if process != self._process.pid or self._process.poll() is None:
                with suppress(ProcessLookupError):
                    os.kill(process, number)


def _members(session: int) -> list[int]:
    """Return the IDs of the running processes in a session; an empty list without /proc."""
    members = []
    for stat in Path('/proc').glob('[0-9]*/stat'):
        with suppress(OSError):  # the process has ended in the meantime
            text = stat.read_text(errors='replace')
            state, _, _, number, *_ = text.rpartition(')')[2].split()
            if int(number) == session and state not in 'ZX':
                members.append(int(stat.parent.name))
    return members


@contextmanager
def private_domain() -> Iterator[int]:
    """
    Reserve a free ROS domain, and set up the environment so that new nodes use it.

    Raises
    ------
    InputError
        No domain is free.

    """
    number, lock = _reserved()
    before = dict(os.environ)
    try:
        os.environ.update({'ROS_DOMAIN_ID': str(number), **_LOCAL})
        for name in _ELSEWHERE:
            os.environ.pop(name, None)
        yield number
    finally:
        os.environ.clear()
        os.environ.update(before)
        lock.close()


def _reserved() -> tuple[int, socket.socket]:
    """Find an unused domain; return it, and a socket that keeps others from reserving it."""
    ours = os.environ.get('ROS_DOMAIN_ID')
    for number in _DOMAINS:
        if str(number) == ours:
            continue
        lock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with suppress(OSError):
            # The last port of a domain serves as its lock. The system frees this port when our
            # process ends.
            lock.bind(('127.0.0.1', _FIRST_PORT + _PORTS * (number + 1) - 1))
            if not _used(number):
                return number, lock
        lock.close()
    raise InputError(f'expected a free ROS domain from {_DOMAINS[-1]} to {_DOMAINS[0]}, found '
                     'nodes in all of them')


def _used(number: int) -> bool:
    """Return whether any process on this machine uses a port of a domain, except its lock port."""
    first = _FIRST_PORT + _PORTS * number
    for name in ('udp', 'udp6'):
        with suppress(OSError):  # these tables exist only on Linux
            for line in Path('/proc/net', name).read_text().splitlines()[1:]:
                if first <= int(line.split()[1].rpartition(':')[2], 16) < first + _PORTS - 1:
                    return True
    return False
