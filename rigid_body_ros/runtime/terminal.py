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

"""Print text for the user, even if a standard stream is closed or its reader has exited."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
import sys
from typing import Any

from rigid_body_ros.common.errors import InputError, printable, shortened
from rigid_body_ros.runtime import interrupts

#: A function that takes items and the number of items. The function returns the same items, and
#: shows the progress while you iterate over them.
Track = Callable[[Iterable[Any], int], Iterable[Any]]


def report(text: str) -> None:
    """Print one line of limited length to standard error; do nothing if it is not writable."""
    if sys.stderr is None:
        return
    try:
        print(shortened(text), file=sys.stderr, flush=True)
    except OSError:
        sys.stderr = None  # otherwise Python flushes it again at exit


def show(text: str, end: str = '\n') -> None:
    r"""
    Print text to standard output and flush it. Nonprintable characters except \n are escaped.

    Raises
    ------
    InputError
        Standard output is not writable.
    BrokenPipeError
        The reader of standard output has exited.

    """
    encoding = sys.stdout.encoding or 'utf-8'  # a file name may contain bytes that are not text
    text = '\n'.join(map(printable, text.split('\n')))
    try:
        print(text.encode(encoding, 'backslashreplace').decode(encoding), end=end, flush=True)
    except BrokenPipeError:
        raise
    except OSError as error:
        sys.stdout = None  # otherwise Python flushes it again at exit
        raise InputError(f'cannot write to standard output: {error.strerror}') from error


def progress(label: str, unit: str = ' stamps',
             size: Callable[[Any], int] = lambda item: 1) -> Track:
    """Return a `Track` that shows the progress of an iteration if standard error is a terminal."""
    from tqdm import tqdm  # imported here, because this is slow

    def track(items: Iterable[Any], total: int) -> Iterator[Any]:
        # With disable=None, tqdm shows no bar if standard error is not a terminal.
        with tqdm(None, label, total, unit=unit, unit_scale=True, leave=False,
                  disable=True if sys.stderr is None else None) as shown:
            for item in items:
                yield item
                shown.update(size(item))
                interrupts.check()
    return track


def no_progress(items: Iterable[Any], total: int) -> Iterable[Any]:
    """Return the items unchanged: a `Track` that does not show any progress."""
    return items
