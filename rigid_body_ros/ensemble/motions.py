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
Store the motions of an ensemble in a Zarr group.

The group uses version 2 of the format, which both zarr 2 and zarr 3 can read, and contains the
metadata that xarray expects. Each chunk contains a fixed range of runs, so the bytes of a chunk do
not depend on how the runs were divided into blocks. When a block covers only some of the runs in a
chunk, the whole chunk is rewritten.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from pathlib import Path

import numpy as np
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.common.errors import InputError, reason
from rigid_body_ros.runtime import files

#: The names of the components of a state, and their units.
COMPONENTS = {**{f'attitude.{axis}': '' for axis in 'xyzw'},
              **{f'angular_velocity.{axis}': 'rad/s' for axis in 'xyz'}}
#: The maximum number of runs in a chunk, and the maximum number of states in a chunk, in a block
#: and in a run. A state takes 56 bytes.
_RUNS, _CHUNK, _BLOCK, _MOST = 1024, 2 ** 16, 2 ** 19, 2 ** 21


def times_of(start_ns: int, end_ns: int, rate: float) -> Ints:
    """
    Return the times at which `attitude_replay --rate` would compute states, including the end.

    Parameters
    ----------
    start_ns, end_ns : int, ns
        The start and the end of the runs.
    rate : float, Hz
        The number of states per second, greater than 0.

    Returns
    -------
    array of int64, shape (m,), ns

    Raises
    ------
    InputError
        The states of a single run would take too much memory.

    """
    step_ns = 1e9 / rate
    intervals = (end_ns - start_ns) / step_ns
    if not intervals < _MOST - 1:
        raise InputError(f'--times: expected at most {_MOST} states in a run, found {rate:g} Hz '
                         f'over {(end_ns - start_ns) * 1e-9:.9g} s')
    offsets = np.round(np.arange(int(intervals) + 2) * step_ns).astype(np.int64)
    return np.unique(np.append(offsets[offsets < end_ns - start_ns], end_ns - start_ns)) + start_ns


class Motions:
    """
    The motions of an ensemble in a Zarr group, which is created if it does not exist.

    Parameters
    ----------
    path : Path
        The Zarr group.
    times : array, shape (m,), s
        Times since the start, which are also an attribute.
    runs : int
        Number of runs. It must not be smaller than the number of runs in the group.

    Raises
    ------
    InputError
        The group cannot be read or written.

    """

    def __init__(self, path: Path, times: Floats, runs: int) -> None:
        self.times, self._path, self._runs = times, path, runs
        self._shape = (min(max(_CHUNK // times.size, 1), _RUNS), min(times.size, _CHUNK))
        import zarr  # slow to import, and needed only for --times
        with self._reported('open'):
            # The consolidated metadata is written last. Without this metadata, the group is
            # incomplete.
            if not (path / '.zmetadata').exists():
                self._create()
            # Write a chunk even if all of its runs have failed.
            with zarr.config.set({'array.write_empty_chunks': True}):
                self._array = zarr.open_array(path / 'motion', mode='r+')
            self._array.resize((runs, times.size, len(COMPONENTS)))
            zarr.consolidate_metadata(path, zarr_format=2)

    def block(self, runs: int) -> int:
        """
        Return the number of runs to write in one block, at most `runs`.

        If possible, a block consists of whole chunks.
        """
        runs = min(runs, max(_BLOCK // self.times.size, 1))
        return runs - runs % self._shape[0] or runs

    def write(self, first: int, motions: Floats) -> None:
        """
        Write the motions of consecutive runs, shape (n, m, 7), and flush them to disk.

        Raises
        ------
        InputError
            The motions cannot be written.

        """
        with self._reported('write'):
            self._array[first:first + len(motions)] = motions
            for row, column in self._chunks(first, first + len(motions)):
                files.flush(self._file(row, column))
            files.flush(self._path / 'motion')

    def read(self, first: int, stop: int) -> Floats | None:
        """
        Return the motions of consecutive runs, or None if a chunk is missing or damaged.

        Damaged chunks are removed, so that they can be written again.

        Raises
        ------
        InputError
            The motions cannot be read.

        """
        if not all(self._file(*chunk).exists() for chunk in self._chunks(first, stop)):
            return None
        with self._reported('read'):
            try:
                return np.asarray(self._array[first:stop])
            except (RuntimeError, ValueError):
                for row, column in self._chunks(first, stop):
                    self._remove_damaged(row, column)
        return None

    def chunks(self) -> Iterator[Floats]:
        """Generate the motions of all runs in order, as arrays of shape (n, m, 7)."""
        for first in range(0, self._runs, self._shape[0]):
            with self._reported('read'):
                motions = self._array[first:min(first + self._shape[0], self._runs)]
            yield motions

    def _create(self) -> None:
        import numcodecs
        import zarr
        group = zarr.open_group(self._path, mode='a', zarr_format=2)
        for name, values, more in (('time', self.times, {
                                       'units': 's', 'long_name': 'time since the start'}),
                                   ('component', np.array([*COMPONENTS]),
                                    {'unit': [*COMPONENTS.values()]})):
            # Do not set a fill value: xarray would treat all values equal to the fill value as
            # missing.
            group.create_array(name, data=values, compressors=None, overwrite=True,
                               fill_value=None, attributes={'_ARRAY_DIMENSIONS': [name], **more})
        group.create_array(
            'motion', shape=(0, self.times.size, len(COMPONENTS)), overwrite=True,
            chunks=(*self._shape, len(COMPONENTS)), dtype='<f8', fill_value=np.nan,
            # Do not use Blosc, because the order of the bytes that Blosc writes depends on its
            # threads.
            filters=[numcodecs.Shuffle(8)], compressors=numcodecs.Zstd(1),
            attributes={'_ARRAY_DIMENSIONS': ['run', 'time', 'component'], 'long_name':
                        'attitude, body to space, and angular velocity, body axes'})

    def _remove_damaged(self, row: int, column: int) -> None:
        """Remove a chunk if it cannot be read."""
        try:
            self._array.blocks[row, column]
        except (RuntimeError, ValueError):
            self._file(row, column).unlink()

    def _chunks(self, first: int, stop: int) -> Iterator[tuple[int, int]]:
        """Generate the row and column of each chunk that contains any of these runs."""
        runs, times = self._shape
        return product(range(first // runs, -(-stop // runs)),
                       range(-(-self.times.size // times)))

    def _file(self, row: int, column: int) -> Path:
        return self._path / 'motion' / f'{row}.{column}.0'

    @contextmanager
    def _reported(self, verb: str) -> Iterator[None]:
        try:
            yield
        except (OSError, RuntimeError, TypeError, ValueError, KeyError) as error:
            raise InputError(f'{self._path}: cannot {verb} the motions: {reason(error)}; if they '
                             'are damaged, remove them to compute them again') from error
