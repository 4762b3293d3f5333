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
Handle SIGINT and SIGTERM between two steps of the work of a command.

An exception raised by a signal handler can be lost: Python drops it in weak reference callbacks
and finalizers, and numpy drops it in callbacks from C. The exception can also arrive in the middle
of a cleanup. So the handlers only record the signal, and long-running work calls `check`. Work
that does not call `check` within a second is interrupted.
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
#: If the work does not call `check` for this long after a signal, s, a handler raises
#: KeyboardInterrupt.
_PATIENCE = 1.0
#: Period, s, with which the handler raises KeyboardInterrupt again, in case the exception was
#: lost. The period is longer than a cleanup takes.
_AGAIN = 5.0

#: Contains the number of the first signal; empty until a signal arrives.
_received: list[int] = []
#: Set if threads may still be computing when the command ends.
_abandoned = Event()


@contextmanager
def deferred(until_exit: bool) -> Iterator[None]:
    """
    Record SIGINT and SIGTERM within a context.

    After a signal, `check` and the end of the context raise KeyboardInterrupt. If the work reaches
    neither of these two points within a second, a signal handler raises the exception.

    Parameters
    ----------
    until_exit : bool
        Whether the process exits after the context. If so, signals after the context are ignored.

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
        exception is raised again only if `check` is called again, so that it does not interrupt
        the cleanup.

    """
    if _received:
        _set_alarm(0.0)
        raise KeyboardInterrupt(_received[0])


def abandon_threads() -> None:
    """Tell `end` not to wait for threads: nothing can stop a thread in compiled code."""
    _abandoned.set()


def end(status: int) -> int:
    """Return an exit status; if threads were abandoned, end the process with that status."""
    if _abandoned.is_set():
        os._exit(status)  # a normal exit would free memory that the threads still use
    return status


@contextmanager
def blocked_in_children() -> Iterator[None]:
    """
    Within the context, start processes with SIGINT blocked.

    A terminal sends SIGINT to all processes, but only the process of the command has to react.
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
