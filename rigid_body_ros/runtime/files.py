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

"""Outputs: each gets its name when it is complete, and never replaces a file that is read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, ExitStack, suppress
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

#: In place of the suffix of a file: the output is a folder.
FOLDER = ''
#: Suffixes that promise a format. Any other, as in `run.1`, is part of a name.
_FORMATS = frozenset([
    '.avi', '.bag', '.bmp', '.bz2', '.csv', '.dat', '.db', '.db3', '.eps', '.gif', '.gz', '.h5',
    '.hdf5', '.html', '.jpeg', '.jpg', '.json', '.log', '.lz4', '.mat', '.mcap', '.md', '.mp4',
    '.npy', '.npz', '.parquet', '.pdf', '.pickle', '.pkl', '.png', '.py', '.rst', '.sqlite',
    '.sqlite3', '.svg', '.tar', '.tif', '.tiff', '.toml', '.tsv', '.txt', '.ulg', '.urdf', '.webp',
    '.xlsx', '.xml', '.xz', '.yaml', '.yml', '.zarr', '.zip', '.zst', '.zstd',
])
#: What SQLite keeps beside a file.
_JOURNALS = ('-wal', '-shm', '-journal')
#: Errors of file systems that cannot flush a folder.
_CANNOT_FLUSH = (errno.EINVAL, errno.EACCES, errno.ENOTSUP)

#: A file or folder under any name: its real path, and its device and inode.
_Identity = str | tuple[int, int]
#: What no output may replace, and what it is called in errors.
_protected: ContextVar[Mapping[_Identity, str]] = ContextVar(
    '_protected', default=MappingProxyType({}))


@contextmanager
def protected(role: str, *paths: str | Path | None) -> Iterator[None]:
    """
    Refuse, within the context, every output that would replace a file or lie in a folder.

    A path stands for all names of its file: relative paths, symbolic and hard links.

    Parameters
    ----------
    role : str
        What the paths are called in errors, such as 'scene'.
    paths : str or Path or None
        Files and folders; None is ignored.

    """
    found = {identity: f'{role} {path}' for path in paths if path is not None
             for identity in _identities(path)}
    token = _protected.set({**found, **_protected.get()})
    try:
        yield
    finally:
        _protected.reset(token)


def reading(*recordings: str | Path | None) -> AbstractContextManager[None]:
    """Protect recordings: files, and bags with all files inside, even if one of them is given."""
    return protected('input', *(part for path in recordings if path is not None
                                for part in _parts(os.fspath(path))))


def check_apart(path: str | Path) -> None:
    """
    Check that an output neither replaces a protected file nor lies in a protected folder.

    Raises
    ------
    InputError
        It does.

    """
    known = _protected.get()
    for identity in _identities(path):
        if identity in known:
            raise InputError(f'{path}: would overwrite the {known[identity]}; '
                             'choose another name')
    for folder in filter(os.path.isdir, Path(os.path.realpath(path)).parents):
        for identity in _identities(folder):
            if identity in known:
                raise InputError(f'{path}: would be written into the folder of the '
                                 f'{known[identity]}; choose another folder')


def format_of(path: str | Path) -> str:
    """Return the suffix by which a name promises a file format, or '' if it promises none."""
    suffix = Path(path).suffix.lower()
    return suffix if suffix in _FORMATS else ''


def check(*outputs: tuple[str | Path, str]) -> None:
    """
    Check, before any work, that outputs can be written and are different files.

    Parameters
    ----------
    outputs : tuples of path and suffix
        As for `Part`.

    Raises
    ------
    InputError
        One of them cannot be written, would replace a protected file, or is named twice.

    """
    with ExitStack() as earlier:
        for path, suffix in outputs:
            with reported(path):
                Part(path, suffix).discard()
            earlier.enter_context(protected('output', path))


@contextmanager
def whole(path: str | Path, suffix: str) -> Iterator[Path]:
    """
    Yield where to write a file; it gets its name at the end, unless an exception is raised.

    Raises
    ------
    InputError
        The file cannot be written, or would replace a protected one. An existing file of that
        name is unchanged.

    """
    with reported(path):
        part = Part(path, suffix)
        try:
            yield part.path
            part.complete()
        finally:
            part.discard()


@contextmanager
def reported(path: str | Path) -> Iterator[None]:
    """Raise an InputError that names the output for an OSError within the context."""
    try:
        yield
    except OSError as error:
        raise InputError(f'{path}: cannot write: {error.strerror or error}') from error


class Part:
    """
    An output under a temporary name beside its own.

    Every output is written through this class. The temporary name is new and cannot be predicted,
    so that it replaces nothing. If Python ends before the output is complete, it is removed.

    Parameters
    ----------
    path : str or Path
        Where the output goes. If this is a symbolic link, its target is replaced.
    suffix : str
        The suffix of the format, such as '.mcap', or FOLDER.

    Attributes
    ----------
    path : Path
        The temporary file or folder.
    target : Path
        The file or folder that the output becomes.

    Raises
    ------
    InputError
        The name is taken by something that must not be replaced, or promises another format.
    OSError
        The output cannot be written.

    """

    def __init__(self, path: str | Path, suffix: str) -> None:
        self._name, self._suffix = path, suffix
        self.target = Path(os.path.realpath(path))
        replaced = self._checked()
        short = os.fsdecode(os.fsencode(self.target.name)[:100])  # a name has at most 255 bytes
        self.path = self.target.with_name(
            f'.{short}.{secrets.token_hex(8)}.{os.getpid()}.part')
        #: Remove what is left under the temporary name. Registered before anything exists, and
        #: called at the latest when Python ends: a signal may come between any two lines.
        self.discard = weakref.finalize(self, _remove, self.path)
        try:
            self._create()
        except OSError:
            self.discard.detach()  # what is there is not ours
            raise
        if replaced:
            self.path.chmod(replaced.st_mode & 0o777)

    def complete(self) -> None:
        """
        Give the output its name; after a crash there is the old file or the new one.

        Raises
        ------
        InputError
            The name was taken meanwhile by something that must not be replaced.
        OSError
            The output cannot be written.

        """
        if self._suffix == FOLDER:
            for entry in self.path.iterdir():
                _flush(entry)
        _flush(self.path)
        self._checked()
        os.replace(self.path, self.target)
        _flush(self.target.parent)

    def keep(self, file: Path, suffix: str) -> Path:
        """
        Move an incomplete file to a free name beside the target, and return that name.

        Raises
        ------
        OSError
            It cannot be moved.

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

    def _create(self) -> None:
        if self._suffix == FOLDER:
            self.path.mkdir()
        else:
            open(self.path, 'xb').close()

    def _checked(self) -> os.stat_result | None:
        """Return the status of the file that is replaced, if there is one."""
        found = None
        paths = self._name, self.target  # which differ if a link was changed meanwhile
        for path in paths:
            check_apart(path)
        for path in paths:
            self._check_name(path)
            try:
                found = os.stat(path)
            except FileNotFoundError:
                continue
            self._check_replaced(found)
        return found

    def _check_name(self, path: str | Path) -> None:
        found = format_of(path)
        if found and found != self._suffix:
            expected = self._suffix or '.mcap, or one without a suffix for a folder'
            raise InputError(f'{self._name}: expected a name that ends in {expected}, '
                             f'found {found}')

    def _check_replaced(self, found: os.stat_result) -> None:
        if self._suffix == FOLDER:
            raise InputError(f'{self._name}: expected a name that ends in .mcap, or a new name '
                             'for a folder; found one that is taken')
        if not stat.S_ISREG(found.st_mode):
            kind = 'a folder' if stat.S_ISDIR(found.st_mode) else 'a device, pipe or socket'
            raise InputError(f'{self._name}: expected a file to write, found {kind}')
        if not (found.st_mode & 0o222 and os.access(self.target, os.W_OK)):
            raise InputError(f'{self._name}: expected a file to write, found one that is '
                             'read-only')


def _parts(path: str) -> Iterator[str]:
    """Generate what belongs to a recording: the files in a folder, or the bag around a file."""
    yield path
    if os.path.isdir(path):
        with suppress(OSError):  # whoever reads the folder reports it
            yield from (entry.path for entry in os.scandir(path))
        return
    yield from (f'{path}{journal}' for journal in _JOURNALS)
    for folder in (os.path.dirname(path) or '.', os.path.dirname(os.path.realpath(path))):
        if os.path.isfile(os.path.join(folder, 'metadata.yaml')):
            yield folder


def _identities(path: str | Path) -> Iterator[_Identity]:
    yield os.path.realpath(path)
    with suppress(OSError):
        found = os.stat(path)
        yield found.st_dev, found.st_ino


def _flush(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    try:
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    except OSError as error:
        if error.errno not in _CANNOT_FLUSH:
            raise


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()
