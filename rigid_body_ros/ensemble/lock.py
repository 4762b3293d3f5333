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

"""Lock a folder, so that only one process at a time writes to it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timezone
import errno
import os
from pathlib import Path
import socket
import sys

from rigid_body_ros.common.errors import InputError
from rigid_body_ros.runtime import files

#: The name of the file that is locked. This file is never removed. After a removal, two processes
#: could each lock a different file with this name.
NAME = 'ensemble.lock'


@contextmanager
def locked(folder: Path, note: Callable[[str], None]) -> Iterator[bool]:
    """
    Lock a folder until the context ends.

    If the process dies, the operating system releases the lock. If the file system does not
    support locks, the folder is used without a lock. Changes that another command makes are then
    detected only when the blocks are joined.

    Parameters
    ----------
    folder : Path
        The folder; it is created if it does not exist.
    note : function
        A function that shows a line of text to the user.

    Yields
    ------
    bool
        Whether the folder is locked. False if the file system does not support locks.

    Raises
    ------
    InputError
        Another process has locked the folder, or the lock file cannot be written.

    """
    with files.reported(folder):
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder / NAME, os.O_RDWR | os.O_CREAT | getattr(os, 'O_NOFOLLOW', 0),
                         0o666)
    try:
        is_locked = _lock(handle, folder, note)
        if is_locked:
            with files.reported(folder / NAME):
                os.ftruncate(handle, 0)
                os.write(handle, _description().encode())
        yield is_locked
    finally:
        os.close(handle)


def _lock(handle: int, folder: Path, note: Callable[[str], None]) -> bool:
    try:
        if sys.platform == 'win32':
            raise OSError(errno.ENOTSUP, 'no locks on this system')
        from fcntl import flock, LOCK_EX, LOCK_NB
        flock(handle, LOCK_EX | LOCK_NB)
    except BlockingIOError:
        who, _, since = os.read(handle, 200).decode(errors='replace').strip().partition('\n')
        known = f', {who},' if who else ''  # the other process may not have described itself yet
        raise InputError(f'{folder}: another attitude_ensemble{known} writes to it '
                         f'{since}'.rstrip()) from None
    except OSError as error:
        note(f'{folder}: cannot lock it ({error.strerror}); start no other command that writes '
             'to it')
        return False
    return True


def _description() -> str:
    since = datetime.now(timezone.utc).isoformat(' ', 'seconds')
    return f'process {os.getpid()} on host {socket.gethostname()}\nsince {since}\n'
