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
The folder of an ensemble: which runs it has, their rows as Parquet, and their motions.

Runs are computed and written in blocks, each to a file of its own, so that an interrupted ensemble
goes on where it stopped. A row depends on the number of its run only, and the rows are put
together in that order: `runs.parquet` has the same bytes whatever the blocks were.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import json
from pathlib import Path
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
import pyarrow as arrow
from pyarrow import parquet
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, quoted, reason
from rigid_body_ros.ensemble.motions import Motions
from rigid_body_ros.ensemble.runs import MOTION
from rigid_body_ros.runtime import files

#: Number of blocks that the missing runs are divided into, so that all workers have some; but a
#: block has at most so many runs, so that an interrupt does not lose many.
BLOCKS, LONGEST = 32, 2048
#: Rows in a row group of `runs.parquet`.
GROUP = 2 ** 16
#: Columns of which many rows are equal; a dictionary of the others takes time and space.
_REPEATED = ['status', 'message']
#: Names of blocks, and of the parts of them that a dead process left; no other file is removed.
_BLOCK = re.compile(r'(\d{9})-(\d{9,10})\.parquet')
_PART = re.compile(r'\.\d{9}-\d{9,10}\.parquet\.[0-9a-f]{16}\.\d+\.part')
#: Where the reason of a failure ends and the numbers of its run begin.
_CAUSE = re.compile(r',? found |[ :]*[-+]?\d')


class Folder:
    """
    The folder of an ensemble, new or to be continued.

    Parameters
    ----------
    path : str or Path
        Created if it does not exist.
    identity : mapping
        What the runs depend on, as JSON, by a name for error messages.
    units : mapping
        The unit of each column of numbers.
    runs : int
        Number of runs, at least that of the folder.
    times : array, shape (m,), s, optional
        Times since the start of the states that are kept; none by default.

    Raises
    ------
    InputError
        The folder is something else, belongs to another ensemble or to one with more runs, or
        cannot be written.

    """

    def __init__(self, path: str | Path, identity: Mapping[str, Any], units: Mapping[str, str],
                 runs: int, times: Floats | None = None) -> None:
        self.path, self.runs, self.times = Path(path), runs, times
        self._schema = arrow.schema([
            ('run', arrow.int64()), ('status', arrow.string()), ('message', arrow.string()),
            *(arrow.field(name, arrow.float64(), metadata={'unit': unit})
              for name, unit in units.items())])
        self._blocks = self.path / 'blocks'
        self._check(identity)
        with files.reported(path):
            self._blocks.mkdir(parents=True, exist_ok=True)
        self.write('identity.json', {'runs': runs, **identity})
        self._motions = None
        if times is not None:
            self._motions = Motions(self.path / 'motion.zarr', times, runs)
            with files.reported(path):
                self._remove_blocks_without(self._motions)

    @property
    def table(self) -> Path:
        """Return the file of all rows."""
        return self.path / 'runs.parquet'

    def missing(self) -> list[tuple[int, int]]:
        """Return the first run of each block that has to be computed, and the one after it."""
        present = self._present()
        begins, ends = [0, *(stop for _, stop in present)], [first for first, _ in present]
        gaps = [*zip(begins, [*ends, self.runs])]
        runs = sum(end - begin for begin, end in gaps)
        longest = min(max(runs // BLOCKS, 1), LONGEST)
        if self._motions:
            longest = self._motions.block(longest)
        return [(first, min(first + longest, end)) for begin, end in gaps
                for first in range(begin, end, longest)]

    def add(self, first: int, stop: int, rows: Mapping[str, NDArray[Any]]) -> None:
        """
        Write the rows of a block, and its motions before them.

        Parameters
        ----------
        first, stop : int
            The first run, and the one after the last.
        rows : mapping
            Arrays of equal length by column; NaN stands for a number that is missing. If the
            folder has times, 'motion', shape (n, m, 7), as well.

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
        with files.atomic_output(self._block(first, stop), '.parquet') as path:
            parquet.write_table(table, path, use_dictionary=_REPEATED)

    def write(self, name: str, data: Mapping[str, Any]) -> None:
        """Write a JSON file into the folder; raise InputError if that fails."""
        with files.atomic_output(self.path / name, '.json') as path:
            path.write_text(f'{json.dumps(data, indent=1)}\n', encoding='utf-8')

    def complete(self) -> None:
        """Put the blocks together to `runs.parquet`; raise InputError if that fails."""
        with files.atomic_output(self.table, '.parquet') as path, \
                parquet.ParquetWriter(path, self._schema, use_dictionary=_REPEATED) as writer:
            for group in self._groups():
                writer.write_table(group, GROUP)
        kept = {self._block(*span) for span in self._present()}
        for path in self._blocks.iterdir():
            if path not in kept and (_BLOCK.fullmatch(path.name) or _PART.fullmatch(path.name)):
                path.unlink()
        if self._motions:
            self._motions.remove_parts()

    def motions(self) -> Iterator[tuple[int, Floats]]:
        """
        Generate the motions of all runs, in chunks that fit into memory.

        Yields
        ------
        first : int
            The first run of the chunk.
        motions : array, shape (n, m, 7)
            Attitude, x y z w, body to space, and angular velocity, rad/s, body axes, at `times`;
            NaN for failed runs.

        Raises
        ------
        InputError
            They cannot be read.

        """
        if self._motions:
            yield from self._motions.chunks()

    def numbers(self, name: str, stop: int) -> Floats:
        """Return a column of the first runs of `runs.parquet`, NaN for failed ones."""
        wanted = min(stop, self.runs)
        groups = range(-(-wanted // GROUP))
        column = parquet.ParquetFile(self.table).read_row_groups([*groups], columns=[name])
        return _floats(column.column(name))[:wanted]

    def chunks(self, name: str) -> Iterator[Floats]:
        """Generate a column of `runs.parquet`, NaN for failed runs."""
        for batch in parquet.ParquetFile(self.table).iter_batches(columns=[name]):
            yield _floats(batch.column(name))

    def failures(self) -> dict[str, int]:
        """Return how many runs failed for each reason, by the text before its numbers."""
        counts: dict[str, int] = {}
        for batch in parquet.ParquetFile(self.table).iter_batches(columns=['message']):
            for message in filter(None, batch.column(0).to_pylist()):
                cause = _CAUSE.split(message, maxsplit=1)[0]
                counts[cause] = counts.get(cause, 0) + 1
        return counts

    def _check(self, identity: Mapping[str, Any]) -> None:
        """Raise InputError if the folder is not that of this ensemble."""
        files.check_apart(self.path)
        if not self.path.exists():
            return
        record = self.path / 'identity.json'
        if not record.exists():
            if not self.path.is_dir() or any(self.path.iterdir()):
                raise InputError(f'{self.path}: expected a new folder or that of an ensemble, '
                                 'found something else; choose another folder')
            return
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

    def _present(self) -> list[tuple[int, int]]:
        """Return the first run of each block that is complete, and the one after it, in order."""
        names = (_BLOCK.fullmatch(path.name) for path in self._blocks.iterdir())
        spans = sorted((int(name[1]), int(name[2])) for name in names if name)
        present, end = [], 0
        for first, stop in spans:
            if end <= first < stop <= self.runs:
                present.append((first, stop))
                end = stop
        return present

    def _remove_blocks_without(self, motions: Motions) -> None:
        """Remove blocks whose motions have been lost, so that they are computed again."""
        present = self._present()
        for span in {*present} - {*motions.present(present)}:
            self._block(*span).unlink()

    def _groups(self) -> Iterator[arrow.Table]:
        """Generate all rows, in tables of as many rows as a row group has."""
        waiting = self._schema.empty_table()
        for span in self._present():
            waiting = arrow.concat_tables([waiting, self._read(*span)])
            while waiting.num_rows >= GROUP:
                yield waiting.slice(0, GROUP).combine_chunks()
                waiting = waiting.slice(GROUP)
        if waiting.num_rows:
            yield waiting.combine_chunks()

    def _block(self, first: int, stop: int) -> Path:
        return self._blocks / f'{first:09d}-{stop:09d}.parquet'

    def _read(self, first: int, stop: int) -> arrow.Table:
        path = self._block(first, stop)
        try:
            table = parquet.ParquetFile(path).read().cast(self._schema)
        except (OSError, ValueError, arrow.ArrowException) as error:
            raise InputError(f'{path}: cannot read the runs: {reason(error)}; remove the file to '
                             'compute them again') from error
        if table.num_rows != stop - first:
            raise InputError(f'{path}: expected {stop - first} runs, found {table.num_rows}; '
                             'remove the file to compute them again')
        return table


def _floats(column: arrow.Array) -> Floats:
    return np.asarray(column.to_numpy(zero_copy_only=False), float)
