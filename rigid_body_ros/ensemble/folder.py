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
Store an ensemble in a folder: one row per run in Parquet files and, optionally, the motions.

Runs are computed and written in blocks of consecutive runs, with one file per block, so that an
interrupted ensemble can continue where it stopped. A row depends only on its run number, and the
rows are joined in the order of the run numbers. The content of `runs.parquet` is therefore exactly
the same for any division of the runs into blocks.

The file name of a block contains the range of run numbers and one or two digests. The first digest
covers the identity of the ensemble, the run numbers, and every byte of the file. If motions are
kept, a second digest covers the motions of these runs. A file that is damaged or that belongs to
another ensemble is recognized because its digests do not match.

A folder is locked, so that only one process at a time writes to it.

The file `summary.json` marks a complete folder, and is therefore written last. When a user asks
for more runs, the earlier results are removed before anything else changes, beginning with
`summary.json`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime, timezone
import errno
import hashlib
import io
import json
import os
from pathlib import Path
import re
import socket
import sys
from typing import Any

import numpy as np
import pyarrow as arrow
from pyarrow import parquet
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, listed, quoted, reason
from rigid_body_ros.ensemble.motions import Motions
from rigid_body_ros.ensemble.runs import Columns, MOTION, Span
from rigid_body_ros.runtime import files

#: If possible, the missing runs are divided into at least `BLOCKS` blocks, so that there is enough
#: work for every worker. No block contains more than `LONGEST` runs, so that little work is lost
#: when the command is interrupted.
BLOCKS, LONGEST = 32, 2048
#: Number of rows in each row group of `runs.parquet`.
GROUP = 2 ** 16
#: Columns with many repeated values. A Parquet dictionary makes these columns smaller. In other
#: columns, a dictionary would only cost time and space.
_REPEATED = ['status', 'message']
IDENTITY, _SUMMARY, _PICTURE, _TABLE = ('identity.json', 'summary.json', 'bands.png',
                                        'runs.parquet')
#: The names of block files, as written by this and earlier versions of the package. Files with any
#: other name are never removed.
_BLOCK = re.compile(r'(\d{9})-(\d{9,10})(-[0-9a-f]{16}){0,2}\.parquet')

#: The name of the file that is locked. This file is never removed. After a removal, two processes
#: could each lock a different file with this name.
LOCK = 'ensemble.lock'
#: Names of unfinished files that may be removed: temporary versions of the results and of blocks,
#: and chunk files that Zarr did not finish writing.
_PART = re.compile(r'\.(identity\.json|summary\.json|bands\.png|runs\.parquet|\d{9}-[-0-9a-f]+'
                   r'\.parquet)\.[0-9a-f]{16}\.\d+\.part|[0-9.]+\.[0-9a-f]{32}\.partial')
_UNFINISHED = '.*.part', 'blocks/.*.part', 'motion.zarr/**/*.partial'


class Folder:
    """
    The folder of an ensemble. It can be new, or contain runs from an earlier use.

    Parameters
    ----------
    path : str or Path
        The folder; it is created if it does not exist.
    identity : mapping
        The inputs that the runs depend on, as JSON types. Error messages refer to them by key.
    units : mapping
        The unit of each numeric column.
    runs : int
        Number of runs. It must not be smaller than in earlier uses of the folder.
    times : array, shape (m,), s, optional
        Times since the start at which to keep the states. By default, no states are kept.

    Attributes
    ----------
    table, picture : Path
        The paths of `runs.parquet`, which contains all rows, and of the picture `bands.png`.
    motions : Motions or None
        The motions of the runs; None if no states are kept.
    misfits : list of str
        For each block that is damaged or belongs to another ensemble, the block's range of run
        numbers as text.

    Raises
    ------
    InputError
        The folder contains the runs of another ensemble, or more than `runs` runs; or it cannot be
        written.

    """

    def __init__(self, path: str | Path, identity: Mapping[str, Any], units: Mapping[str, str],
                 runs: int, times: Floats | None = None) -> None:
        self.path, self.runs = Path(path), runs
        self.table, self.picture = self.path / _TABLE, self.path / _PICTURE
        self._schema = arrow.schema([
            ('run', arrow.int64()), ('status', arrow.string()), ('message', arrow.string()),
            *(arrow.field(name, arrow.float64(), metadata={'unit': unit})
              for name, unit in units.items())])
        if self._check(identity) != runs:
            with files.reported(path):
                self.path.mkdir(parents=True, exist_ok=True)
            self._remove_results()
            self._write(IDENTITY, {'runs': runs, **identity})
        self.motions = None if times is None else Motions(self.path / 'motion.zarr', times, runs)
        self._identity, self._blocks = json.dumps(identity, sort_keys=True), dict[Span, Path]()
        with files.reported(path):
            (self.path / 'blocks').mkdir(exist_ok=True)
            self.misfits = self._find_blocks()
        if self.missing():
            self._remove_results()

    def missing(self, longest: int | None = None) -> list[Span]:
        """
        Return the spans of the blocks that still have to be computed.

        Parameters
        ----------
        longest : int, optional
            Maximum number of runs in a block.

        """
        gaps = self._gaps()
        runs = sum(end - begin for begin, end in gaps)
        longest = min(max(runs // BLOCKS, 1), longest or LONGEST)
        if self.motions:
            longest = self.motions.block(longest)
        return [(first, min(first + longest, end)) for begin, end in gaps
                for first in range(begin, end, longest)]

    def add(self, rows: Columns) -> None:
        """
        Add a block to the folder: write its motions first, and then its rows.

        Parameters
        ----------
        rows : mapping
            The rows of consecutive runs: an array of shape (n,) for each column, with NaN in place
            of missing numbers. If the folder keeps states, `rows` must also contain 'motion', an
            array of shape (n, m, 7).

        Raises
        ------
        InputError
            The file cannot be written.

        """
        span = first, _ = int(rows['run'][0]), int(rows['run'][-1]) + 1
        if self.motions:
            self.motions.write(first, rows[MOTION])
        table = arrow.Table.from_arrays(
            [arrow.array(rows[field.name], field.type, from_pandas=True)
             for field in self._schema], schema=self._schema)
        buffer = io.BytesIO()
        parquet.write_table(table, buffer, use_dictionary=_REPEATED)
        data = buffer.getvalue()
        path = self.path / 'blocks' / self._name(span, data, rows.get(MOTION))
        with files.atomic_output(path, '.parquet') as temporary:
            temporary.write_bytes(data)
        self._blocks[span] = path

    def complete(self) -> None:
        """
        Join the blocks into `runs.parquet`.

        Raises
        ------
        InputError
            The file cannot be written, a block has been changed, or a run is missing or occurs
            twice.

        """
        if gaps := self._gaps():
            raise InputError(f'{self.path}: expected each of {self.runs} runs once, found run '
                             f'{gaps[0][0]} missing or twice; the same command computes what is '
                             'missing')
        with files.atomic_output(self.table, '.parquet') as path, \
                parquet.ParquetWriter(path, self._schema, use_dictionary=_REPEATED) as writer:
            for group in self._groups():
                writer.write_table(group, GROUP)
        with files.reported(self.path):
            for path in {path for _, path in self._candidates()} - {*self._blocks.values()}:
                path.unlink()

    def finish(self, summary: Mapping[str, Any]) -> None:
        """
        Write `summary.json`, which marks the folder as complete.

        Raise InputError if the file cannot be written.
        """
        self._write(_SUMMARY, summary)

    def numbers(self, name: str, stop: int | None = None) -> Floats:
        """
        Return a numeric column of `runs.parquet` for all runs or, if given, those before `stop`.

        The numbers of failed runs are NaN.
        """
        wanted = min(stop or self.runs, self.runs)
        groups = range(-(-wanted // GROUP))
        column = parquet.ParquetFile(self.table).read_row_groups([*groups], columns=[name])
        return np.asarray(column.column(name).to_numpy(), float)[:wanted]

    def messages(self) -> Iterator[str]:
        """Generate the messages of the failed runs."""
        for batch in parquet.ParquetFile(self.table).iter_batches(columns=['message']):
            yield from filter(None, batch.column(0).to_pylist())

    def _check(self, identity: Mapping[str, Any]) -> int:
        """
        Return the number of runs in the folder.

        Raise InputError if the runs in the folder were computed from other inputs.
        """
        record = self.path / IDENTITY
        if not record.exists():
            return 0
        try:
            before = json.loads(record.read_text(encoding='utf-8'))
            runs = int(before['runs'])
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise InputError(f'{record}: cannot read the ensemble: {reason(error)}') from error
        for name in {**identity, **before}:
            found, expected = identity.get(name), before.get(name)
            if name != 'runs' and found != expected:
                raise InputError(f'{self.path}: expected the {name} of its runs, '
                                 f'{quoted(expected)}, found {quoted(found)}; choose another '
                                 'folder')
        if runs > self.runs:
            raise InputError(f'{self.path}: expected at least the {runs} runs that it was begun '
                             f'with, found {self.runs}; choose another folder')
        return runs

    def _remove_results(self) -> None:
        """Remove results that do not cover all runs, beginning with `summary.json`."""
        with files.reported(self.path):
            for name in (_SUMMARY, _PICTURE, _TABLE):
                (self.path / name).unlink(missing_ok=True)
                files.flush(self.path)

    def _write(self, name: str, data: Mapping[str, Any]) -> None:
        with files.atomic_output(self.path / name, '.json') as path:
            path.write_text(f'{json.dumps(data, indent=1)}\n', encoding='utf-8')

    def _gaps(self) -> list[Span]:
        """Return the spans between the blocks; a gap is negative if two blocks overlap."""
        spans = sorted(self._blocks)
        begins, ends = [0, *(stop for _, stop in spans)], [first for first, _ in spans]
        return [gap for gap in zip(begins, [*ends, self.runs]) if gap[0] != gap[1]]

    def _groups(self) -> Iterator[arrow.Table]:
        """Generate all rows of the ensemble, in tables of one Parquet row group each."""
        waiting = self._schema.empty_table()
        for span in sorted(self._blocks):
            waiting = arrow.concat_tables([waiting, self._read(span)])
            while waiting.num_rows >= GROUP:
                yield waiting.slice(0, GROUP).combine_chunks()
                waiting = waiting.slice(GROUP)
        if waiting.num_rows:
            yield waiting.combine_chunks()

    def _read(self, span: Span) -> arrow.Table:
        """Read a block; raise InputError if the file has changed since it was found or written."""
        path = self._blocks[span]
        with files.reported(path, 'read'):
            data = path.read_bytes()
        if self._digest(span, data) not in path.name:
            raise InputError(f'{path}: expected the runs that were written, found others; the '
                             'same command computes them again')
        return parquet.ParquetFile(io.BytesIO(data)).read().cast(self._schema)

    def _find_blocks(self) -> list[str]:
        """Look for valid blocks, and return the run numbers of each invalid block as text."""
        misfits, end = [], 0
        for (first, stop), path in sorted(self._candidates()):
            if not (first < stop <= self.runs and self._fits((first, stop), path)):
                misfits.append(f'{first} to {stop - 1}')
            elif first >= end:
                self._blocks[first, stop], end = path, stop
        return misfits

    def _candidates(self) -> Iterator[tuple[Span, Path]]:
        for path in (self.path / 'blocks').iterdir():
            name = _BLOCK.fullmatch(path.name)
            if name and path.is_file():
                yield (int(name[1]), int(name[2])), path

    def _fits(self, span: Span, path: Path) -> bool:
        motions = self.motions.read(*span) if self.motions else None
        if self.motions and motions is None:
            return False
        with files.reported(path, 'read'):
            return path.name == self._name(span, path.read_bytes(), motions)

    def _name(self, span: Span, data: bytes, motions: Floats | None) -> str:
        parts = [data] if motions is None else [data, motions.tobytes()]
        digests = '-'.join(self._digest(span, part) for part in parts)
        return f'{span[0]:09d}-{span[1]:09d}-{digests}.parquet'

    def _digest(self, span: Span, data: bytes) -> str:
        digest = hashlib.sha256(f'{self._identity}\n{span}\n'.encode())
        digest.update(data)
        return digest.hexdigest()[:16]


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
    files.check_apart(path)
    # Check that the folder belongs to an ensemble before creating a lock file there.
    if not (Path(path) / LOCK).exists():
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
        handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | getattr(os, 'O_NOFOLLOW', 0),
                         0o666)
    try:
        if _lock(handle, folder, note):
            with files.reported(folder / LOCK):
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
        other = f', {who},' if who else ''  # the other process may not have described itself yet
        raise InputError(f'{folder}: another attitude_ensemble{other} writes to it '
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
    if not path.is_dir() or any(entry.name != LOCK and not _PART.fullmatch(entry.name)
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
