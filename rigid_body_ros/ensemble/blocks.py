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
Store the rows of an ensemble in block files, each with the rows of consecutive runs.

The file name of a block contains the range of run numbers and one or two digests. The first digest
covers the identity of the ensemble, the run numbers, and every byte of the file. If motions are
kept, a second digest covers the motions of these runs. A file that is damaged or that belongs to
another ensemble is recognized because its digests do not match.
"""

from __future__ import annotations

from collections.abc import Iterator
import hashlib
from pathlib import Path
import re

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.ensemble.motions import Motions
from rigid_body_ros.ensemble.runs import Span
from rigid_body_ros.runtime import files

#: The names of block files, as written by this and earlier versions of the package. Files with any
#: other name are never removed.
_BLOCK = re.compile(r'(\d{9})-(\d{9,10})(-[0-9a-f]{16}){0,2}\.parquet')


class Blocks:
    """
    The blocks of an ensemble in a folder.

    Parameters
    ----------
    path : Path
        The folder.
    identity : str
        A text that contains all inputs that the runs depend on.
    motions : Motions or None
        The motions of the runs; None if motions are not kept.

    """

    def __init__(self, path: Path, identity: str, motions: Motions | None) -> None:
        self._path, self._identity, self._motions = path, identity, motions
        self._files: dict[Span, Path] = {}

    @property
    def spans(self) -> list[Span]:
        """Return the spans of the valid blocks, which do not overlap, in ascending order."""
        return sorted(self._files)

    def find(self, runs: int) -> list[str]:
        """
        Look for the valid blocks of the first `runs` runs.

        Return the run numbers of each invalid block as text.
        """
        self._files, misfits, end = {}, [], 0
        for (first, stop), path in sorted(self._candidates()):
            if not (first < stop <= runs and self._fits((first, stop), path)):
                misfits.append(f'{first} to {stop - 1}')
            elif first >= end:
                self._files[first, stop], end = path, stop
        return misfits

    def write(self, span: Span, data: bytes, motions: Floats | None) -> None:
        """Write a block; raise InputError if the file cannot be written."""
        path = self._path / self._name(span, data, motions)
        with files.atomic_output(path, '.parquet') as temporary:
            temporary.write_bytes(data)
        self._files[span] = path

    def read(self, span: Span) -> bytes:
        """
        Read a block, and return the content of its file.

        Raises
        ------
        InputError
            The file cannot be read, or has changed since the last call of `find` or `write`.

        """
        path = self._files[span]
        with files.reported(path, 'read'):
            data = path.read_bytes()
        if self._digest(span, data) not in path.name:
            raise InputError(f'{path}: expected the runs that were written, found others; the '
                             'same command computes them again')
        return data

    def remove_others(self) -> None:
        """Remove all blocks that are invalid or that overlap a valid block."""
        kept = {*self._files.values()}
        for _, path in self._candidates():
            if path not in kept:
                path.unlink()

    def _candidates(self) -> Iterator[tuple[Span, Path]]:
        for path in self._path.iterdir():
            name = _BLOCK.fullmatch(path.name)
            if name and path.is_file():
                yield (int(name[1]), int(name[2])), path

    def _fits(self, span: Span, path: Path) -> bool:
        motions = self._motions.read(*span) if self._motions else None
        if self._motions and motions is None:
            return False
        with files.reported(path, 'read'):
            return path.name == self._name(span, path.read_bytes(), motions)

    def _name(self, span: Span, data: bytes, motions: Floats | None) -> str:
        digests = [self._digest(span, data)]
        if motions is not None:
            digests.append(self._digest(span, motions.tobytes()))
        return f'{span[0]:09d}-{span[1]:09d}-{"-".join(digests)}.parquet'

    def _digest(self, span: Span, data: bytes) -> str:
        found = hashlib.sha256(f'{self._identity}\n{span}\n'.encode())
        found.update(data)
        return found.hexdigest()[:16]
