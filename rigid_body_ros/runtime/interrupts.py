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
Handle SIGINT and SIGTERM at points where a command can safely stop.

If a signal handler raises an exception, that exception can get lost: Python drops it in weak
reference callbacks and finalizers, and numpy drops it in callbacks from C. The exception can also
interrupt a cleanup. For these reasons, our handlers only record the signal, and long-running work
has to call `check` regularly. Work that does not call `check` within a second is interrupted.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
import signal
import sys
from threading import Event
from types import FrameType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
#: How long to wait for a call to `check` after a signal, s, before a handler raises
#: KeyboardInterrupt.
_PATIENCE = 1.0
#: How long to wait before the handler raises KeyboardInterrupt again, s, in case the exception got
#: lost. A cleanup takes less time.
_AGAIN = 5.0

#: The number of the first signal; empty until a signal arrives.
_received: list[int] = []
#: Set if threads may still be computing when the command ends.
_abandoned = Event()


@contextmanager
def deferred(until_exit: bool) -> Iterator[None]:
    """
    Record SIGINT and SIGTERM within a context.

    After a signal, KeyboardInterrupt is raised by the next call to `check` or at the end of the
    context. If neither happens within a second, the exception is raised by a signal handler.

    Parameters
    ----------
    until_exit : bool
        Whether the process exits after the context. If it does, later signals are ignored.

    """
    before = {number: signal.signal(number, _record) for number in _SIGNALS}
    if sys.platform != 'win32':
        before[signal.SIGALRM] = signal.getsignal(signal.SIGALRM)
    hook, sys.unraisablehook = sys.unraisablehook, _raise_again
    try:
        yield
        check()
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if until_exit else handler)
        if _received:
            _set_alarm(0.0)
        sys.unraisablehook = hook
        _received.clear()


def check() -> None:
    """
    Raise KeyboardInterrupt if a signal was received.

    Raises
    ------
    KeyboardInterrupt
        A signal was received. The argument of the exception is the number of the signal. The
        exception is raised again only if you call `check` again. A cleanup that does not call
        `check` is therefore not interrupted.

    """
    if _received:
        _set_alarm(0.0)
        raise KeyboardInterrupt(_received[0])


def abandon_threads() -> None:
    """Tell `end` not to wait for threads; a thread in compiled code cannot be stopped."""
    _abandoned.set()


def end(status: int) -> int:
    """Return the exit status or, if threads were abandoned, end the process with this status."""
    if _abandoned.is_set():
        os._exit(status)  # a normal exit would free memory that threads still use
    return status


@contextmanager
def blocked_in_children() -> Iterator[None]:
    """
    Block SIGINT in processes that are started within the context.

    A terminal sends SIGINT to all processes, but only the main process of the command has to
    react.
    """
    if sys.platform == 'win32':
        yield
        return
    from multiprocessing import resource_tracker
    resource_tracker.ensure_running()  # starting the tracker resets the signal mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _record(number: int, frame: FrameType | None) -> None:
    if not _received:
        _received.append(number)
        if sys.platform != 'win32':
            signal.signal(signal.SIGALRM, _raise)
        _set_alarm(_PATIENCE)


def _raise(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt(*_received)


def _set_alarm(seconds: float) -> None:
    if sys.platform != 'win32':
        signal.setitimer(signal.ITIMER_REAL, seconds, _AGAIN if seconds else 0.0)


def _raise_again(lost: Any) -> None:
    if isinstance(lost.exc_value, KeyboardInterrupt):
        _set_alarm(_PATIENCE)
    else:
        sys.__unraisablehook__(lost)
