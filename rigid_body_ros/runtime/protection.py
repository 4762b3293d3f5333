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
Keep the outputs of a command from replacing its inputs or each other.

Files are protected whichever way they are named: by relative paths, symbolic links or hard links.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
import os
from pathlib import Path
from types import MappingProxyType

from rigid_body_ros.common.errors import InputError

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

    A file is protected whichever way the output names it: by a relative path, a symbolic link or
    a hard link.

    Parameters
    ----------
    role : str
        What to call the paths in error messages, such as 'scene'.
    paths : str or Path or None
        The files and folders to protect; None is ignored.

    """
    found = {identity: f'{role} {path}' for path in paths if path is not None
             for identity in _path_and_inode(path)}
    token = _protected.set({**found, **_protected.get()})
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
    known = _protected.get()
    for identity in _path_and_inode(path):
        if identity in known:
            raise InputError(f'{path}: would overwrite the {known[identity]}; '
                             'choose another name')
    for folder in filter(os.path.isdir, Path(real_path(path)).parents):
        for identity in _path_and_inode(folder):
            if identity in known:
                raise InputError(f'{path}: would be written into the folder of the '
                                 f'{known[identity]}; choose another folder')


def real_path(path: str | Path) -> str:
    """Resolve the symbolic links in a path; raise InputError if the path contains a null byte."""
    try:
        return os.path.realpath(path)
    except ValueError as error:
        raise InputError(f'{path}: expected a path, found one with a null byte') from error


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
        found = os.stat(path)
        yield found.st_dev, found.st_ino
