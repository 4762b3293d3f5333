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
Prevent an output from replacing an input of a command, or another output.

A file is protected under all its names: relative paths, symbolic links and hard links.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, ExitStack, suppress
from contextvars import ContextVar
import os
from pathlib import Path
from types import MappingProxyType

from rigid_body_ros.common.errors import InputError

#: Suffixes of the files that SQLite keeps next to a database.
_JOURNALS = ('-wal', '-shm', '-journal')
#: What identifies a file or folder under any name: its real path, or its device and inode.
_Identity = str | tuple[int, int]
#: Files and folders that no output may replace, with their descriptions for error messages.
_protected: ContextVar[Mapping[_Identity, str]] = ContextVar(
    '_protected', default=MappingProxyType({}))


@contextmanager
def protected(role: str, *paths: str | Path | None) -> Iterator[None]:
    """
    Within the context, reject any output that would replace these files or be in these folders.

    A path protects its file under every name: relative paths, symbolic links and hard links.

    Parameters
    ----------
    role : str
        Description of the paths in error messages, such as 'scene'.
    paths : str or Path or None
        Files and folders; None is ignored.

    """
    found = {identity: f'{role} {path}' for path in paths if path is not None
             for identity in _path_and_inode(path)}
    token = _protected.set({**found, **_protected.get()})
    try:
        yield
    finally:
        _protected.reset(token)


@contextmanager
def reading(*recordings: str | Path | None, **others: str | Path | None) -> Iterator[None]:
    """
    Protect the inputs of a command.

    Parameters
    ----------
    recordings : str or Path or None
        Recordings. If a path names one file of a bag, the whole bag is protected.
    others : str or Path or None
        Other files; error messages describe each file by the name of its argument.

    """
    with ExitStack() as stack:
        stack.enter_context(protected('input', *(
            member for path in recordings if path is not None
            for member in _paths_of_recording(os.fspath(path)))))
        for role, path in others.items():
            stack.enter_context(protected(role, path))
        yield


def check_apart(path: str | Path) -> None:
    """
    Check that an output does not replace a protected file and is not in a protected folder.

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
    """Return a path without symbolic links; raise InputError if it has a null byte."""
    try:
        return os.path.realpath(path)
    except ValueError as error:
        raise InputError(f'{path}: expected a path, found one with a null byte') from error


def _paths_of_recording(path: str) -> Iterator[str]:
    """Generate the paths of a folder and its files, or of a file, its journals and its bag."""
    yield path
    if os.path.isdir(path):
        with suppress(OSError):  # the error is reported when the folder is read
            yield from (entry.path for entry in os.scandir(path))
        return
    yield from (f'{path}{journal}' for journal in _JOURNALS)
    for folder in (os.path.dirname(path) or '.', os.path.dirname(real_path(path))):
        if os.path.isfile(os.path.join(folder, 'metadata.yaml')):
            yield folder


def _path_and_inode(path: str | Path) -> Iterator[_Identity]:
    """Generate the real path of a file and, if the file exists, its device and inode."""
    yield real_path(path)
    with suppress(OSError):
        found = os.stat(path)
        yield found.st_dev, found.st_ino
