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

Runs are computed and written in blocks, with one file per block, so that an interrupted ensemble
can continue where it stopped. A row depends only on its run number, and the rows are joined in the
order of the run numbers. The content of `runs.parquet` is therefore exactly the same for any
division of the runs into blocks.

The file `summary.json` marks a complete folder, and is therefore written last. When a user asks
for more runs, the earlier results are removed before anything else changes, beginning with
`summary.json`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
import io
import json
from pathlib import Path
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
import pyarrow as arrow
from pyarrow import parquet
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, listed, quoted, reason
from rigid_body_ros.ensemble import lock
from rigid_body_ros.ensemble.blocks import Blocks
from rigid_body_ros.ensemble.causes import causes
from rigid_body_ros.ensemble.motions import Motions, remove_parts
from rigid_body_ros.ensemble.runs import MOTION, Span
from rigid_body_ros.runtime import files, protection

#: If possible, the missing runs are divided into at least `BLOCKS` blocks, so that there is enough
#: work for every worker. No block contains more than `LONGEST` runs, so that little work is lost
#: when the command is interrupted.
BLOCKS, LONGEST = 32, 2048
#: Number of rows in each row group of `runs.parquet`.
GROUP = 2 ** 16
#: Columns with many repeated values. A Parquet dictionary makes these columns smaller. In other
#: columns, a dictionary would only cost time and space.
_REPEATED = ['status', 'message']
_IDENTITY, _SUMMARY, _PICTURE, _TABLE = ('identity.json', 'summary.json', 'bands.png',
                                         'runs.parquet')
#: Names of unfinished files that may be removed. They are temporary versions of the files above
#: and of blocks.
_PART = re.compile(r'\.(identity\.json|summary\.json|bands\.png|runs\.parquet|\d{9}-[-0-9a-f]+'
                   r'\.parquet)\.[0-9a-f]{16}\.\d+\.part')


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
        Another process is writing to the folder, or `Folder` raises this error.
    KeyboardInterrupt
        A signal was received while the folder was open. The message says how to continue.

    """
    protection.check_apart(path)
    # Check that the folder belongs to an ensemble before creating a lock file there.
    if not (Path(path) / lock.NAME).exists():
        _check_kind(Path(path))
    try:
        with lock.locked(Path(path), note) as is_locked:
            if is_locked:
                _remove_parts(Path(path))
            folder = Folder(path, *ensemble)
            if folder.misfits:
                note(f'{path}: ignored blocks that are damaged or from elsewhere, of the runs '
                     f'{listed(folder.misfits)}; what is missing is computed again')
            yield folder
    except KeyboardInterrupt as interrupt:
        interrupt.args += (f'; run the same command again to continue in {path}',)
        raise


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
    misfits : list of str
        For each block that is damaged or belongs to another ensemble, the block's range of run
        numbers as text.

    Raises
    ------
    InputError
        The folder contains unrelated files, the runs of another ensemble, or more than `runs`
        runs; or it cannot be written.

    """

    def __init__(self, path: str | Path, identity: Mapping[str, Any], units: Mapping[str, str],
                 runs: int, times: Floats | None = None) -> None:
        self.path, self.runs, self.times = Path(path), runs, times
        self.table, self.picture = self.path / _TABLE, self.path / _PICTURE
        self._schema = arrow.schema([
            ('run', arrow.int64()), ('status', arrow.string()), ('message', arrow.string()),
            *(arrow.field(name, arrow.float64(), metadata={'unit': unit})
              for name, unit in units.items())])
        if self._check(identity) != runs:
            with files.reported(path):
                self.path.mkdir(parents=True, exist_ok=True)
            self._remove_results()
            self._write(_IDENTITY, {'runs': runs, **identity})
        self._motions = None
        if times is not None:
            self._motions = Motions(self.path / 'motion.zarr', times, runs)
        self._blocks = Blocks(self.path / 'blocks', json.dumps(identity, sort_keys=True),
                              self._motions)
        with files.reported(path):
            (self.path / 'blocks').mkdir(exist_ok=True)
            self.misfits = self._blocks.find(runs)
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
        present = self._blocks.spans
        begins, ends = [0, *(stop for _, stop in present)], [first for first, _ in present]
        gaps = [*zip(begins, [*ends, self.runs])]
        runs = sum(end - begin for begin, end in gaps)
        longest = min(max(runs // BLOCKS, 1), longest or LONGEST)
        if self._motions:
            longest = self._motions.block(longest)
        return [(first, min(first + longest, end)) for begin, end in gaps
                for first in range(begin, end, longest)]

    def add(self, first: int, stop: int, rows: Mapping[str, NDArray[Any]]) -> None:
        """
        Add a block to the folder: write its motions first, and then its rows.

        Parameters
        ----------
        first, stop : int
            The first run, and the run after the last one.
        rows : mapping
            An array of shape (n,) for each column, with NaN in place of missing numbers. If the
            folder keeps states, `rows` must also contain 'motion', an array of shape (n, m, 7).

        Raises
        ------
        InputError
            The file cannot be written.

        """
        if self._motions:
            self._motions.write(first, rows[MOTION])
        table = arrow.Table.from_arrays(
            [arrow.array(rows[field.name], field.type, from_pandas=True)
             for field in self._schema], schema=self._schema)
        buffer = io.BytesIO()
        parquet.write_table(table, buffer, use_dictionary=_REPEATED)
        self._blocks.write((first, stop), buffer.getvalue(), rows.get(MOTION))

    def complete(self) -> None:
        """
        Join the blocks into `runs.parquet`.

        Raises
        ------
        InputError
            The file cannot be written, a block has been changed, or a run is missing or occurs
            twice.

        """
        with files.atomic_output(self.table, '.parquet') as path:
            with parquet.ParquetWriter(path, self._schema, use_dictionary=_REPEATED) as writer:
                for group in self._groups():
                    writer.write_table(group, GROUP)
            self._check_runs(path)
        with files.reported(self.path):
            self._blocks.remove_others()

    def finish(self, summary: Mapping[str, Any]) -> None:
        """
        Write `summary.json`, which marks the folder as complete.

        Raise InputError if the file cannot be written.
        """
        self._write(_SUMMARY, summary)

    def motions(self) -> Iterator[Floats]:
        """
        Generate the motions of all runs in order, in chunks that fit into memory.

        Yields
        ------
        array, shape (n, m, 7)
            States at `times`. Each contains the attitude, x y z w, from body to space axes, and
            the angular velocity, rad/s, in body axes. All states of a failed run are NaN.

        Raises
        ------
        InputError
            The motions cannot be read.

        """
        if self._motions:
            yield from self._motions.chunks()

    def numbers(self, name: str, stop: int) -> Floats:
        """
        Return a numeric column of `runs.parquet` for all runs before `stop`.

        The numbers of failed runs are NaN.
        """
        wanted = min(stop, self.runs)
        groups = range(-(-wanted // GROUP))
        column = parquet.ParquetFile(self.table).read_row_groups([*groups], columns=[name])
        return np.asarray(column.column(name).to_numpy(), float)[:wanted]

    def failures(self) -> dict[str, int]:
        """Return, for each cause of failure, the number of runs that failed for this cause."""
        batches = parquet.ParquetFile(self.table).iter_batches(columns=['message'])
        return causes(message for batch in batches
                      for message in filter(None, batch.column(0).to_pylist()))

    def _check(self, identity: Mapping[str, Any]) -> int:
        """
        Return the number of runs in the folder.

        Raise InputError if the runs in the folder were computed from other inputs.
        """
        _check_kind(self.path)
        record = self.path / _IDENTITY
        if not record.exists():
            return 0
        try:
            known = json.loads(record.read_text(encoding='utf-8'))
            runs = int(known['runs'])
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise InputError(f'{record}: cannot read the ensemble: {reason(error)}') from error
        for name, value in identity.items():
            if known.get(name) != value:
                raise InputError(f'{self.path}: expected the {name} of its runs, '
                                 f'{quoted(known.get(name))}, found {quoted(value)}; choose '
                                 'another folder')
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

    def _check_runs(self, path: Path) -> None:
        """Raise InputError unless a file has exactly one row for each run."""
        end = 0
        for batch in parquet.ParquetFile(path).iter_batches(columns=['run']):
            numbers = batch.column(0).to_numpy()
            if not np.array_equal(numbers, np.arange(end, end + len(numbers))):
                break
            end += len(numbers)
        else:
            if end == self.runs:
                return
        raise InputError(f'{self.path}: expected each of {self.runs} runs once, found run {end} '
                         'missing or twice; the same command computes what is missing')

    def _groups(self) -> Iterator[arrow.Table]:
        """Generate all rows of the ensemble, in tables of one Parquet row group each."""
        waiting = self._schema.empty_table()
        for span in self._blocks.spans:
            waiting = arrow.concat_tables([waiting, self._read(span)])
            while waiting.num_rows >= GROUP:
                yield waiting.slice(0, GROUP).combine_chunks()
                waiting = waiting.slice(GROUP)
        if waiting.num_rows:
            yield waiting.combine_chunks()

    def _read(self, span: Span) -> arrow.Table:
        return parquet.ParquetFile(io.BytesIO(self._blocks.read(span))).read().cast(self._schema)


def _check_kind(path: Path) -> None:
    """Raise InputError unless a path is new, or is the folder of an ensemble."""
    if not path.exists() or (path / _IDENTITY).exists():
        return
    if not path.is_dir() or any(entry.name != lock.NAME and not _PART.fullmatch(entry.name)
                                for entry in path.iterdir()):
        raise InputError(f'{path}: expected a new folder or that of an ensemble, found something '
                         'else; choose another folder')


def _remove_parts(path: Path) -> None:
    """Remove unfinished files left behind by a process that was killed."""
    with files.reported(path):
        for folder in (path, path / 'blocks'):
            for part in folder.glob('.*.part'):
                if _PART.fullmatch(part.name):
                    part.unlink()
        remove_parts(path / 'motion.zarr')
