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
Write output files and folders safely.

An output gets its final name only when it is complete. It never replaces an input or another
output, whichever way they are named: by relative paths, symbolic links or hard links. A command
replaces an existing file only if you pass --overwrite.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, ExitStack, suppress
from contextvars import ContextVar
import errno
import itertools
import os
from pathlib import Path
import secrets
import shutil
import stat
from types import MappingProxyType
import weakref

from rigid_body_ros.common.errors import InputError

#: The value that takes the place of the suffix if an output is a folder.
FOLDER = ''
#: Suffixes that name a file format. Any other suffix, as in `run.1`, is part of the name.
_FORMATS = frozenset([
    '.avi', '.bag', '.bmp', '.bz2', '.csv', '.dat', '.db', '.db3', '.eps', '.gif', '.gz', '.h5',
    '.hdf5', '.html', '.jpeg', '.jpg', '.json', '.log', '.lz4', '.mat', '.mcap', '.md', '.mp4',
    '.npy', '.npz', '.parquet', '.pdf', '.pickle', '.pkl', '.png', '.py', '.rst', '.sqlite',
    '.sqlite3', '.svg', '.tar', '.tif', '.tiff', '.toml', '.tsv', '.txt', '.ulg', '.urdf', '.webp',
    '.xlsx', '.xml', '.xz', '.yaml', '.yml', '.zarr', '.zip', '.zst', '.zstd',
])
#: The error numbers with which file systems report that they cannot flush a folder.
_CANNOT_FLUSH = (errno.EINVAL, errno.EACCES, errno.ENOTSUP)
_may_overwrite: ContextVar[bool] = ContextVar('_may_overwrite', default=True)
#: Suffixes of the files that SQLite keeps next to a database.
_JOURNALS = ('-wal', '-shm', '-journal')
#: An identifier of a file or folder: either the real path, or the device and inode.
_Identity = str | tuple[int, int]
#: The files and folders that no output may replace, and what to call them in error messages.
_protected: ContextVar[Mapping[_Identity, str]] = ContextVar(
    '_protected', default=MappingProxyType({}))


@contextmanager
def protected(role: str, *paths: str | Path | None) -> Iterator[None]:
    """
    Within the context, reject any output that would replace these files or be in these folders.

    Parameters
    ----------
    role : str
        What to call the paths in error messages, such as 'scene'.
    paths : str or Path or None
        The files and folders to protect; None is ignored.

    """
    roles = {identity: f'{role} {path}' for path in paths if path is not None
             for identity in _path_and_inode(path)}
    token = _protected.set({**roles, **_protected.get()})
    try:
        yield
    finally:
        _protected.reset(token)


@contextmanager
def reading(*recordings: str | Path | None, scene: str | Path | None = None) -> Iterator[None]:
    """
    Protect the inputs of a command.

    Parameters
    ----------
    recordings : str or Path or None
        Recordings. If you name one file of a bag, the whole bag is protected.
    scene : str or Path, optional
        The scene file.

    """
    paths = [member for path in recordings if path is not None
             for member in _paths_of_recording(os.fspath(path))]
    with protected('input', *paths), protected('scene', scene):
        yield


def check_apart(path: str | Path) -> None:
    """
    Check that an output would not replace a protected file or be in a protected folder.

    Raises
    ------
    InputError
        The output would replace a protected file, or be in a protected folder.

    """
    roles = _protected.get()
    for identity in _path_and_inode(path):
        if identity in roles:
            raise InputError(f'{path}: would overwrite the {roles[identity]}; '
                             'choose another name')
    for folder in filter(os.path.isdir, Path(real_path(path)).parents):
        for identity in _path_and_inode(folder):
            if identity in roles:
                raise InputError(f'{path}: would be written into the folder of the '
                                 f'{roles[identity]}; choose another folder')


def real_path(path: str | Path) -> str:
    """Resolve the symbolic links in a path; raise InputError if the path contains a null byte."""
    try:
        return os.path.realpath(path)
    except ValueError as error:
        raise InputError(f'{path}: expected a path, found one with a null byte') from error


@contextmanager
def overwriting(allowed: bool) -> Iterator[None]:
    """Set whether outputs in this context may replace existing files; by default, they may."""
    token = _may_overwrite.set(allowed)
    try:
        yield
    finally:
        _may_overwrite.reset(token)


def may_overwrite() -> bool:
    """Return whether an output may replace an existing file."""
    return _may_overwrite.get()


def check_new(path: str | Path) -> None:
    """
    Check that an output does not exist yet, unless it may be overwritten.

    Raises
    ------
    InputError
        The output exists, and must not be overwritten.

    """
    if not may_overwrite() and os.path.exists(path):
        raise _exists(path)


def format_of(path: str | Path) -> str:
    """Return the suffix of a name if that suffix stands for a file format, otherwise ''."""
    suffix = Path(path).suffix.lower()
    return suffix if suffix in _FORMATS else ''


def check(*outputs: tuple[str | Path, str]) -> None:
    """
    Check that outputs can be written and are distinct files, before any work is done.

    Parameters
    ----------
    outputs : tuples of path and suffix
        For each output, the arguments of `Part`.

    Raises
    ------
    InputError
        An output exists and must not be overwritten, cannot be written, would replace a protected
        file, or is named twice.

    """
    with ExitStack() as earlier:
        for path, suffix in outputs:
            with reported(path):
                Part(path, suffix).discard()
            earlier.enter_context(protected('output', path))


@contextmanager
def atomic_output(path: str | Path, suffix: str) -> Iterator[Path]:
    """
    Yield a temporary path to write to, and give the output its final name at the end.

    If an exception is raised, an existing file with the final name remains unchanged.

    Raises
    ------
    InputError
        The file exists and must not be overwritten, cannot be written, or would replace a
        protected file.

    """
    with reported(path):
        part = Part(path, suffix)
        try:
            yield part.path
            part.complete()
        finally:
            part.discard()


@contextmanager
def reported(path: str | Path, verb: str = 'write') -> Iterator[None]:
    """Turn an OSError within the context into an InputError that names the file."""
    try:
        yield
    except OSError as error:
        raise InputError(f'{path}: cannot {verb}: {error.strerror or error}') from error


class Part:
    """
    An output that is still being written, under a temporary name in its final folder.

    Every output is written through this class. The temporary name is random and unused, so that
    the temporary file does not replace any other file. If Python exits before the output is
    complete, the output is removed.

    Parameters
    ----------
    path : str or Path
        The final name. If this is a symbolic link, the output replaces the file that the link
        points to.
    suffix : str
        The suffix that stands for the format, such as '.mcap', or FOLDER.

    Attributes
    ----------
    path : Path
        The temporary file or folder.
    target : Path
        The file or folder that the output will become.

    Raises
    ------
    InputError
        The name belongs to a file that must not be replaced, or has the suffix of another format.
    OSError
        The output cannot be written.

    """

    def __init__(self, path: str | Path, suffix: str) -> None:
        self._name, self._suffix = path, suffix
        self.target = Path(real_path(path))
        replaced = self._check_target()
        short = os.fsdecode(os.fsencode(self.target.name)[:100])  # names are limited to 255 bytes
        self.path = self.target.with_name(
            f'.{short}.{secrets.token_hex(8)}.{os.getpid()}.part')
        #: Removes the temporary file or folder, no later than at exit. This finalizer has to be
        #: registered before the file is created, because a signal may arrive between any two
        #: lines.
        self.discard = weakref.finalize(self, _remove, self.path)
        try:
            if suffix == FOLDER:
                self.path.mkdir()
            else:
                open(self.path, 'xb').close()
        except OSError:
            self.discard.detach()  # `discard` must not remove an existing file
            raise
        if replaced:
            self.path.chmod(replaced.st_mode & 0o777)

    def complete(self) -> None:
        """
        Rename the output to its final name; a crash leaves either the old file or the new one.

        Without --overwrite, this method does not replace a file that another process has created
        at the last moment. A folder can only replace an empty folder.

        Raises
        ------
        InputError
            A file that must not be replaced has taken the final name since the output was opened.
        OSError
            The output cannot be written.

        """
        if self._suffix == FOLDER:
            for entry in self.path.iterdir():
                flush(entry)
        flush(self.path)
        self._check_target()
        reserved = self._suffix != FOLDER and not may_overwrite()
        if reserved:
            try:
                self._reserve_target()
            except FileExistsError:  # another process created it after the check
                raise _exists(self._name) from None
        try:
            os.replace(self.path, self.target)
        except OSError:
            if reserved:  # the reserved file is empty if there are no hard links
                self.target.unlink(missing_ok=True)
            raise
        self.discard()  # if both names are links to one file, `os.replace` keeps both
        flush(self.target.parent)

    def keep(self, file: Path, suffix: str) -> Path:
        """
        Move an incomplete file to an unused path next to the target, and return the new path.

        Raises
        ------
        OSError
            The file cannot be moved.

        """
        stem = self.target.name.removesuffix(self._suffix)
        for number in itertools.count(1):
            count = f'.{number}' if number > 1 else ''
            name = self.target.with_name(f'{stem}.partial{count}{suffix}')
            with suppress(FileExistsError):
                open(name, 'xb').close()
                break
        os.replace(file, name)
        return name

    def _reserve_target(self) -> None:
        """Create a file with the final name; raise FileExistsError if the name is taken."""
        try:
            os.link(self.path, self.target)
        except FileExistsError:
            raise
        except OSError:  # no hard links, as on FAT; this empty file is soon replaced
            open(self.target, 'xb').close()

    def _check_target(self) -> os.stat_result | None:
        """Return the status of the file that will be replaced; None if no file has that name."""
        status = None
        paths = self._name, self.target  # these differ if a link has been changed in the meantime
        for path in paths:
            check_apart(path)
        for path in paths:
            self._check_name(path)
            with suppress(FileNotFoundError):
                status = os.stat(path)
                self._check_replaced(status)
        return status

    def _check_name(self, path: str | Path) -> None:
        suffix = format_of(path)
        if suffix and suffix != self._suffix:
            expected = self._suffix or '.mcap, or a folder name without a suffix'
            raise InputError(f'{self._name}: expected a name ending in {expected}, found {suffix}')

    def _check_replaced(self, status: os.stat_result) -> None:
        if self._suffix == FOLDER:
            raise InputError(f'{self._name}: output exists; choose a new folder, or a name ending '
                             'in .mcap')
        if not stat.S_ISREG(status.st_mode):
            kind = 'a folder' if stat.S_ISDIR(status.st_mode) else 'a device, pipe or socket'
            raise InputError(f'{self._name}: expected a regular file, found {kind}')
        if not (status.st_mode & 0o222 and os.access(self.target, os.W_OK)):
            raise InputError(f'{self._name}: expected a writable file, found a read-only one')
        if not may_overwrite():
            raise _exists(self._name)


def flush(path: Path) -> None:
    """Flush a file, or the entries of a folder, to disk."""
    try:
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    except OSError as error:
        if error.errno not in _CANNOT_FLUSH:
            raise


def _exists(path: str | Path) -> InputError:
    return InputError(f'{path}: output exists; choose another name, or add --overwrite')


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def _paths_of_recording(path: str) -> Iterator[str]:
    """
    Generate the paths to protect for a recording.

    For a folder, these paths are the folder and its files. For a file, they are the file, the
    journals next to the file, and the folder of the bag that contains the file.
    """
    yield path
    if os.path.isdir(path):
        with suppress(OSError):  # any error is reported when the folder is read
            yield from (entry.path for entry in os.scandir(path))
        return
    yield from (f'{path}{journal}' for journal in _JOURNALS)
    for folder in (os.path.dirname(path) or '.', os.path.dirname(real_path(path))):
        if os.path.isfile(os.path.join(folder, 'metadata.yaml')):
            yield folder


def _path_and_inode(path: str | Path) -> Iterator[_Identity]:
    """Yield the real path of a file and, if the file exists, its device and inode."""
    yield real_path(path)
    with suppress(OSError):
        status = os.stat(path)
        yield status.st_dev, status.st_ino
