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

"""What is compressed by zstd, or copied, into memory or a temporary folder, within bounds."""

from __future__ import annotations

from contextlib import ExitStack
import os
from pathlib import Path
import shutil
import tempfile
from typing import BinaryIO

from rigid_body_ros.common.errors import InputError, reason
from rigid_body_ros.runtime.reading import open_file
import zstandard

#: Bytes that a chunk may hold, or the messages of a block; rosbag2 and mcap write about 1 MB.
LARGEST = 2 ** 30
#: Bytes that one byte can stand for: zstd needs 4 for a block of 128 KiB.
_DENSEST = 2 ** 15
#: How much larger than its compressed file a recording above LARGEST may be.
_RATIO = 1000
_BLOCK = 2 ** 20


def unpack(data: bytes, most: int, unpacker: zstandard.ZstdDecompressor) -> bytes:
    """
    Return what a frame of zstd holds.

    Raises
    ------
    ValueError
        It holds more than `most` bytes.
    ZstdError
        It is not such a frame.

    """
    room = min(most, _DENSEST * len(data))  # a header may claim any size
    if zstandard.frame_content_size(data) > room:
        raise ValueError(f'expected at most {room} bytes, found more')
    return unpacker.decompress(data, max_output_size=room)


def temporary(stack: ExitStack) -> Path:
    """Return a new temporary folder, which the stack removes; raise InputError if none can be."""
    try:
        return Path(stack.enter_context(tempfile.TemporaryDirectory(prefix='rigid_body_ros.')))
    except OSError as error:
        raise InputError(f'cannot create a temporary folder: {reason(error)}; TMPDIR names '
                         'where') from error


def unpack_file(path: Path, folder: Path) -> Path:
    """
    Unpack a file compressed by zstd into a temporary folder, and return where it is.

    Raises
    ------
    InputError
        The file cannot be read, is not compressed by zstd, or is too large when unpacked.

    """
    target = folder / path.stem
    with open_file(path, 'recording') as packed:
        most = max(LARGEST, _RATIO * os.fstat(packed.fileno()).st_size)
        try:
            _copy(path, zstandard.ZstdDecompressor().stream_reader(
                packed, read_across_frames=True), target, most)
        except zstandard.ZstdError as error:
            raise InputError(f'{path}: expected a file compressed by zstd, found none '
                             f'({reason(error)})') from error
    return target


def copy_file(path: Path, folder: Path) -> Path:
    """
    Copy a file into a temporary folder, and return where it is.

    Raises
    ------
    InputError
        The file cannot be read, or the folder has no room for it.

    """
    target = folder / path.name
    with open_file(path, 'recording') as stream:
        _copy(path, stream, target, os.fstat(stream.fileno()).st_size)
    return target


def _copy(path: Path, stream: BinaryIO | zstandard.ZstdDecompressionReader, target: Path,
          most: int) -> None:
    written = 0
    try:
        with open(target, 'wb') as copy:
            while block := stream.read(_BLOCK):
                written += len(block)
                if written > most:
                    raise InputError(f'{path}: expected at most {most} bytes in it, found more; '
                                     'if that is meant, unpack it first (zstd -d)')
                free = shutil.disk_usage(target.parent).free
                if written > 9 * free:  # a tenth of what was free is left to others
                    raise InputError(f'{path}: expected room for it in {target.parent.parent}, '
                                     f'found {free} bytes after {written}; TMPDIR names another '
                                     'folder')
                copy.write(block)
    except OSError as error:
        raise InputError(f'{path}: cannot copy it to {target.parent.parent}: {reason(error)}; '
                         'TMPDIR names another folder') from error
