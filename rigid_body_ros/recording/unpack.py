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

"""Decompress zstd data and copy files to a temporary folder, with limits on their size."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import ExitStack
from functools import partial
import os
from pathlib import Path
import shutil
import tempfile

from rigid_body_ros.common.errors import InputError, reason
from rigid_body_ros.recording.bulk import BadMessageError, Raw
from rigid_body_ros.runtime.limits import open_file
import zstandard

#: Largest accepted size, in bytes, of a chunk or of all messages in a block together. The chunks
#: that rosbag2 and mcap write are only about 1 MB long.
LARGEST = 2 ** 30
#: The largest compression ratio that zstd can reach: a block of 128 KiB takes at least 4 bytes.
_DENSEST = 2 ** 15
#: The largest compression ratio accepted for a file that decompresses to more than LARGEST bytes.
_RATIO = 1000
_BLOCK = 2 ** 20


def unpack(data: bytes, most: int, unpacker: zstandard.ZstdDecompressor) -> bytes:
    """
    Decompress a zstd frame.

    Raises
    ------
    ValueError
        The decompressed content has more than `most` bytes.
    ZstdError
        The data is not a zstd frame.

    """
    room = min(most, _DENSEST * len(data))  # a damaged header can claim any size
    if zstandard.frame_content_size(data) > room:
        raise ValueError(f'expected at most {room} bytes, found more')
    return unpacker.decompress(data, max_output_size=room)


def unpack_each(raw: Raw) -> Raw:
    """Decompress messages one by one; raise BadMessageError at the first invalid message."""
    decompressed, room, unpacker = [], LARGEST, zstandard.ZstdDecompressor()
    for row in range(len(raw.starts)):
        try:
            decompressed.append(unpack(raw.message(row), room, unpacker))
        except (zstandard.ZstdError, ValueError) as error:
            raise BadMessageError(row, f'cannot decompress: {reason(error)}') from error
        room -= len(decompressed[-1])
    return Raw.from_bytes(decompressed, raw.log_ns, raw.publish_ns)


def temporary(stack: ExitStack) -> Path:
    """
    Create a temporary folder, which is removed when `stack` is closed.

    Raise InputError if the folder cannot be created.
    """
    try:
        return Path(stack.enter_context(tempfile.TemporaryDirectory(prefix='rigid_body_ros.')))
    except OSError as error:
        raise InputError(f'cannot create a temporary folder: {reason(error)}; set TMPDIR to a '
                         'folder with free space') from error


def unpack_file(path: Path, folder: Path) -> Path:
    """
    Decompress a zstd file into a temporary folder, and return the path of the new file.

    Raises
    ------
    InputError
        The file cannot be read, is not compressed with zstd, or its content is too large.

    """
    target = folder / path.stem
    with open_file(path, 'recording') as packed:
        most = max(LARGEST, _RATIO * os.fstat(packed.fileno()).st_size)
        try:
            stream = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
            _copy(path, iter(partial(stream.read, _BLOCK), b''), target, most)
        except zstandard.ZstdError as error:
            raise InputError(f'{path}: expected a file compressed with zstd '
                             f'({reason(error)})') from error
    return target


def copy_file(path: Path, folder: Path) -> Path:
    """
    Copy a file into a temporary folder, and return the path of the copy.

    If another process appends to the file in the meantime, the new data is not copied.

    Raises
    ------
    InputError
        The file cannot be read, or the folder has too little free space.

    """
    target = folder / path.name
    with open_file(path, 'recording') as stream:
        size = os.fstat(stream.fileno()).st_size
        blocks = (stream.read(min(_BLOCK, size - start)) for start in range(0, size, _BLOCK))
        _copy(path, blocks, target, size)
    return target


def _copy(path: Path, blocks: Iterable[bytes], target: Path, most: int) -> None:
    written, place = 0, target.parent.parent
    try:
        with open(target, 'wb') as copy:
            for block in blocks:
                written += len(block)
                if written > most:
                    raise InputError(f'{path}: expected at most {most} bytes after decompression, '
                                     'found more; if you trust the file, decompress it with '
                                     'zstd -d')
                free = shutil.disk_usage(target.parent).free
                if written > 9 * free:  # leave a tenth of the free space unused
                    raise InputError(f'{path}: expected space for a copy in {place}, found {free} '
                                     f'bytes free after {written} were written; set TMPDIR to '
                                     'another folder')
                copy.write(block)
    except OSError as error:
        raise InputError(f'{path}: cannot write a copy to {place}: {reason(error)}; set '
                         'TMPDIR to another folder') from error
