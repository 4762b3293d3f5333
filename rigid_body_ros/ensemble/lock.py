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

"""Open the folder of an ensemble, and lock it, so that only one process at a time writes to it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timezone
import errno
import os
from pathlib import Path
import re
import socket
import sys
from typing import Any

from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.ensemble.folder import Folder, IDENTITY
from rigid_body_ros.runtime import files, protection

#: The name of the file that is locked. This file is never removed. After a removal, two processes
#: could each lock a different file with this name.
NAME = 'ensemble.lock'
#: Names of unfinished files that may be removed: temporary versions of the results and of blocks,
#: and chunk files that Zarr did not finish writing.
_PART = re.compile(r'\.(identity\.json|summary\.json|bands\.png|runs\.parquet|\d{9}-[-0-9a-f]+'
                   r'\.parquet)\.[0-9a-f]{16}\.\d+\.part|[0-9.]+\.[0-9a-f]{32}\.partial')
_UNFINISHED = '.*.part', 'blocks/.*.part', 'motion.zarr/**/*.partial'


@contextmanager
def opened(path: str | Path, *ensemble: Any, note: Callable[[str], None]) -> Iterator[Folder]:
    """
    Open the folder of an ensemble, and lock it for this process until the context ends.

    Parameters
    ----------
    path : str or Path
        The folder; it is created if it does not exist.
    ensemble
        The other arguments of `Folder`.
    note : function
        A function that shows a line of text to the user.

    Raises
    ------
    InputError
        Another process is writing to the folder, the folder contains unrelated files, or `Folder`
        raises this error.
    KeyboardInterrupt
        A signal was received while the folder was open. The message says how to continue.

    """
    protection.check_apart(path)
    # Check that the folder belongs to an ensemble before creating a lock file there.
    if not (Path(path) / NAME).exists():
        _check_kind(Path(path))
    try:
        with _locked(Path(path), note):
            _check_kind(Path(path))
            folder = Folder(path, *ensemble)
            if folder.misfits:
                note(f'{path}: ignored blocks that are damaged or from elsewhere, of the runs '
                     f'{listed(folder.misfits)}; what is missing is computed again')
            yield folder
    except KeyboardInterrupt as interrupt:
        interrupt.args += (f'; run the same command again to continue in {path}',)
        raise


@contextmanager
def _locked(folder: Path, note: Callable[[str], None]) -> Iterator[None]:
    """
    Lock a folder until the context ends, and remove unfinished files from it.

    If the process dies, the operating system releases the lock. If the file system does not
    support locks, the folder is used without a lock, and unfinished files remain. Changes that
    another command makes are then detected only when the blocks are joined.

    Parameters
    ----------
    folder : Path
        The folder; it is created if it does not exist.
    note : function
        A function that shows a line of text to the user.

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
        if _lock(handle, folder, note):
            with files.reported(folder / NAME):
                os.ftruncate(handle, 0)
                since = datetime.now(timezone.utc).isoformat(' ', 'seconds')
                os.write(handle, f'process {os.getpid()} on host {socket.gethostname()}\n'
                                 f'since {since}\n'.encode())
            _remove_parts(folder)
        yield
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


def _check_kind(path: Path) -> None:
    """Raise InputError unless a path is new, or is the folder of an ensemble."""
    if not path.exists() or (path / IDENTITY).exists():
        return
    if not path.is_dir() or any(entry.name != NAME and not _PART.fullmatch(entry.name)
                                for entry in path.iterdir()):
        raise InputError(f'{path}: expected a new folder or that of an ensemble, found something '
                         'else; choose another folder')


def _remove_parts(path: Path) -> None:
    """Remove unfinished files left behind by a process that was killed."""
    with files.reported(path):
        for pattern in _UNFINISHED:
            for part in path.glob(pattern):
                if _PART.fullmatch(part.name):
                    part.unlink()
