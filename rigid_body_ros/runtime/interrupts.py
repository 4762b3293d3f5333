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
Signals to a command, heard between two pieces of its work.

What a handler raises can be lost: Python drops it in callbacks of weak references and where an
object ends, numpy and the compiler where they call back from C. And it can come in the middle of
cleaning up. So handlers only take note, and work that takes long looks at the notes.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import signal
import sys
from types import FrameType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
#: s. Where nobody looks for so long, the exception comes wherever the program is ...
_PATIENCE = 1.0
#: ... and again after this long, if it was lost there; cleaning up takes less.
_AGAIN = 5.0

#: The number of the signal that came first.
_heard: list[int] = []


@contextmanager
def listening(to_the_end: bool) -> Iterator[None]:
    """
    Take note of SIGINT and SIGTERM; at the latest at the end raise KeyboardInterrupt, see `heed`.

    Parameters
    ----------
    to_the_end : bool
        Of the process: from then on signals are ignored.

    """
    before = {number: signal.signal(number, _note) for number in _SIGNALS}
    if sys.platform != 'win32':
        before[signal.SIGALRM] = signal.getsignal(signal.SIGALRM)
    hook, sys.unraisablehook = sys.unraisablehook, _not_raised
    try:
        yield
        heed()
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if to_the_end else handler)
        if _heard:
            _remind(0.0)
        sys.unraisablehook = hook
        _heard.clear()


def heed() -> None:
    """
    Look whether a signal was heard.

    Raises
    ------
    KeyboardInterrupt
        One was; its argument is the number. From here on none disturbs what is cleaned up.

    """
    if _heard:
        _remind(0.0)
        raise KeyboardInterrupt(_heard[0])


@contextmanager
def kept_from_children() -> Iterator[None]:
    """Let processes that are started now not hear SIGINT, which all of a terminal get."""
    if sys.platform == 'win32':
        yield
        return
    from multiprocessing import resource_tracker
    resource_tracker.ensure_running()  # its own start ends what is blocked
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _note(number: int, frame: FrameType | None) -> None:
    if not _heard:
        _heard.append(number)
        if sys.platform != 'win32':
            signal.signal(signal.SIGALRM, _insist)
        _remind(_PATIENCE)


def _insist(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt(*_heard)


def _remind(seconds: float) -> None:
    if sys.platform != 'win32':
        signal.setitimer(signal.ITIMER_REAL, seconds, _AGAIN if seconds else 0.0)


def _not_raised(lost: Any) -> None:
    if isinstance(lost.exc_value, KeyboardInterrupt):
        _remind(_PATIENCE)
    else:
        sys.__unraisablehook__(lost)
