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

"""Open the files of a recording, whatever its format."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
import os
from pathlib import Path, PurePath
from typing import Any

from rigid_body_ros.common.errors import InputError, quoted, reason
from rigid_body_ros.recording.file import File
from rigid_body_ros.recording.mcap_file import McapFile
from rigid_body_ros.recording.sqlite_file import SqliteFile
from rigid_body_ros.recording.text_files import CsvFile
from rigid_body_ros.recording.ulog_file import is_ulog, UlogFile
from rigid_body_ros.recording.unpack import temporary, unpack_file
from rigid_body_ros.runtime.files import reported
from rigid_body_ros.runtime.limits import open_file, read_yaml
import yaml
from yaml.constructor import BaseConstructor

#: The first bytes of a ROS 1 bag.
_ROS1 = b'#ROSBAG V2.0'


def open_files(name: str | Path, stack: ExitStack, columns: Mapping[str, str] | None = None
               ) -> tuple[list[File], bool, str]:
    """
    Open the files of a recording.

    Return three values: the files, whether their messages are compressed, and a text that says why
    files are missing ('' if none are missing). `columns` are those of a CSV file; see
    `headings.columns_of`.
    """
    if name == '':  # Path('') would be the current folder
        raise InputError('expected a recording, found an empty name')
    path = Path(name)
    if not os.path.isdir(path):  # Path.is_dir raises an error if the name is too long
        return [_open_file(path, stack, columns)], False, ''
    about = _metadata(path / 'metadata.yaml')
    compressed = str(about.get('compression_mode', '')).lower() == 'message'
    files: list[File] = []
    for file in _bag_files(path, about.get('relative_file_paths')):
        try:
            files.append(_open_file(file, stack))
        except InputError as error:
            if not files:
                raise
            return files, compressed, f'{error}; only the files before it were read'
    return files, compressed, ''


def _bag_files(folder: Path, names: object) -> list[Path]:
    """Return the paths of a bag's files; raise InputError if a file is not in the bag's folder."""
    where = f'{folder}/metadata.yaml: relative_file_paths'
    if not names or not isinstance(names, list):
        raise InputError(f'{where}: expected file names, found {quoted(names)}')
    home = os.path.realpath(folder)
    paths: dict[str, Path] = {}
    for name in names:
        if not isinstance(name, str) or '\0' in name or not PurePath(name).name:
            raise InputError(f'{where}: expected file names, found {quoted(name)}')
        named = PurePath(name)
        if named.name in paths:
            raise InputError(f'{where}: expected each file once, found {quoted(name)} twice')
        # Early versions of rosbag2 put the folder name in front of the file name.
        path = paths[named.name] = folder / named.name
        if named.is_absolute() or '..' in named.parts \
                or os.path.dirname(os.path.realpath(path)) != home:
            raise InputError(f'{where}: expected files in the folder of the bag, '
                             f'found {quoted(name)}')
    return [*paths.values()]


def _metadata(path: Path) -> dict[str, Any]:
    if not os.path.lexists(path):
        raise InputError(f'{path}: file not found; a bag folder must contain it')
    root = read_yaml(path, 'metadata of the recording', aliases=True)
    try:
        found = BaseConstructor().construct_document(root) if root else None
    except yaml.YAMLError as error:  # for example, because a key is not a name
        raise InputError(f'{path}: expected names as keys ({reason(error)})') from error
    about = found.get('rosbag2_bagfile_information') if isinstance(found, dict) else None
    if not isinstance(about, dict):
        raise InputError(f'{path}: expected the key rosbag2_bagfile_information, found none')
    return about


def _open_file(path: Path, stack: ExitStack,
               columns: Mapping[str, str] | None = None) -> File:
    is_compressed = path.suffix in ('.zstd', '.zst')
    unpacked = unpack_file(path, temporary(stack)) if is_compressed else path
    with reported(path, 'read the recording'), open_file(unpacked, 'recording') as stream:
        if stream.read(len(_ROS1)) == _ROS1:
            raise InputError(f'{path}: expected MCAP or rosbag2, found a ROS 1 bag; convert it '
                             'with rosbags-convert --src IN.bag --dst OUT')
    if path.suffix.lower() == '.csv':
        return CsvFile(path, columns)
    if is_ulog(path):
        return UlogFile(path)
    return SqliteFile(path, unpacked, stack) if unpacked.suffix == '.db3' else \
        McapFile(path, unpacked)
