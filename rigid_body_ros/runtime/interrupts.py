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
Handle SIGINT and SIGTERM between two steps of a command's work.

An exception raised by a signal handler can be lost: Python drops it in weak reference callbacks
and finalizers, and numpy drops it when it calls back from C. It can also arrive in the middle of a
cleanup. So the handlers only record the signal, and long-running work checks for it. Work that
does not check is interrupted after a second.
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
#: s; if the work does not check for a signal for this long, KeyboardInterrupt is raised.
_PATIENCE = 1.0
#: s; it is raised again after this time, in case it was lost; a cleanup takes less time.
_AGAIN = 5.0

#: The number of the first signal.
_received: list[int] = []
#: Set if threads may still compute when the command ends.
_abandoned = Event()


@contextmanager
def deferred(until_exit: bool) -> Iterator[None]:
    """
    Record SIGINT and SIGTERM; `check` or the end of the context raises KeyboardInterrupt.

    Parameters
    ----------
    until_exit : bool
        Whether the process exits after the context. If so, later signals are ignored.

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
        A signal was received; its number is the argument. It is raised only once, so that it does
        not interrupt the cleanup that follows.

    """
    if _received:
        _set_alarm(0.0)
        raise KeyboardInterrupt(_received[0])


def abandon_threads() -> None:
    """Make `end` not wait for threads: nothing stops a thread in compiled code."""
    _abandoned.set()


def end(status: int) -> int:
    """Return an exit status, or end the process with it if there are abandoned threads."""
    if _abandoned.is_set():
        os._exit(status)  # in them, Python would free what the compiled code uses
    return status


@contextmanager
def blocked_in_children() -> Iterator[None]:
    """Block SIGINT in processes started within the context; a terminal sends it to all of them."""
    if sys.platform == 'win32':
        yield
        return
    from multiprocessing import resource_tracker
    resource_tracker.ensure_running()  # starting it resets the signal mask
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
