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
The motions of an ensemble as Zarr.

The format is version 2, which Zarr 2 and 3 read, and the metadata are those of xarray. A chunk has
a fixed number of runs, so its bytes depend on their numbers only. Writing a block that has some of
its runs replaces the whole chunk.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from pathlib import Path
import re

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, reason
from rigid_body_ros.runtime import files

#: The components of a state, and their units.
COMPONENTS = {**{f'attitude.{axis}': '' for axis in 'xyzw'},
              **{f'angular_velocity.{axis}': 'rad/s' for axis in 'xyz'}}
#: Largest number of runs in a chunk, of states in a chunk and in a block, and of states in a run.
#: A state takes 56 bytes.
_RUNS, _CHUNK, _BLOCK, _MOST = 1024, 2 ** 16, 2 ** 19, 2 ** 21
#: Names of chunks that Zarr did not complete.
_PART = re.compile(r'[0-9.]+\.[0-9a-f]{32}\.partial')


def times_of(start_ns: int, end_ns: int, rate: float) -> NDArray[np.int64]:
    """
    Return the times of `attitude_replay --rate`, and the end.

    Parameters
    ----------
    start_ns, end_ns : int, ns
        Start and end of the runs.
    rate : float, Hz
        Greater than 0.

    Returns
    -------
    array of int64, shape (m,), ns

    Raises
    ------
    InputError
        The states of one run would take too much memory.

    """
    step_ns = 1e9 / rate
    intervals = (end_ns - start_ns) / step_ns
    if not intervals < _MOST - 1:
        raise InputError(f'--times: expected at most {_MOST} states in a run, found {rate:g} Hz '
                         f'over {(end_ns - start_ns) * 1e-9:.9g} s')
    offsets = np.round(np.arange(int(intervals) + 2) * step_ns).astype(np.int64)
    return np.unique(np.append(offsets[offsets < end_ns - start_ns], end_ns - start_ns)) + start_ns


def remove_parts(path: Path) -> None:
    """Remove what dead processes left in a Zarr group."""
    for part in path.rglob('*.partial'):
        if _PART.fullmatch(part.name):
            part.unlink()


class Motions:
    """
    The motions of an ensemble, new or to be continued.

    Parameters
    ----------
    path : Path
        The Zarr group.
    times : array, shape (m,), s
        Since the start.
    runs : int
        Number of runs, at least that of the group.

    Raises
    ------
    InputError
        The group cannot be read or written.

    """

    def __init__(self, path: Path, times: Floats, runs: int) -> None:
        self._path, self._times, self._runs = path, times, runs
        self._shape = (min(max(_CHUNK // times.size, 1), _RUNS), min(times.size, _CHUNK))
        import zarr  # takes long, and only --times needs it
        with self._reported('open'):
            # The consolidated metadata are written last.
            if not (path / '.zmetadata').exists():
                self._create()
            with zarr.config.set({'array.write_empty_chunks': True}):  # chunks of failed runs
                self._array = zarr.open_array(path / 'motion', mode='r+')
            self._array.resize((runs, times.size, len(COMPONENTS)))
            zarr.consolidate_metadata(path, zarr_format=2)

    def block(self, runs: int) -> int:
        """Return the largest number of runs, up to the given one, to compute as a block."""
        runs = min(runs, max(_BLOCK // self._times.size, 1))
        return runs - runs % self._shape[0] or runs

    def write(self, first: int, motions: Floats) -> None:
        """
        Write the motions of consecutive runs, shape (n, m, 7), to the disk.

        Raises
        ------
        InputError
            They cannot be written.

        """
        with self._reported('write'):
            self._array[first:first + len(motions)] = motions
            for row, column in self._chunks(first, first + len(motions)):
                files.flush(self._file(row, column))
            files.flush(self._path / 'motion')

    def read(self, first: int, stop: int) -> Floats | None:
        """
        Return the motions of consecutive runs, or None if a chunk of them is missing or damaged.

        A damaged chunk is removed, so that its runs can be written again.

        Raises
        ------
        InputError
            They cannot be read.

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
        """Generate the motions of all runs in their order, shape (n, m, 7)."""
        for first in range(0, self._runs, self._shape[0]):
            with self._reported('read'):
                motions = self._array[first:min(first + self._shape[0], self._runs)]
            yield motions

    def _create(self) -> None:
        import numcodecs
        import zarr
        group = zarr.open_group(self._path, mode='a', zarr_format=2)
        for name, values, more in (('time', self._times, {'units': 's', 'long_name':
                                                          'time since the start'}),
                                   ('component', np.array([*COMPONENTS]),
                                    {'unit': [*COMPONENTS.values()]})):
            # xarray takes a number that equals the fill value for a missing one.
            group.create_array(name, data=values, compressors=None, overwrite=True,
                               fill_value=None, attributes={'_ARRAY_DIMENSIONS': [name], **more})
        group.create_array(
            'motion', shape=(0, self._times.size, len(COMPONENTS)), overwrite=True,
            chunks=(*self._shape, len(COMPONENTS)), dtype='<f8', fill_value=np.nan,
            # Without Blosc, whose threads write their results in any order.
            filters=[numcodecs.Shuffle(8)], compressors=numcodecs.Zstd(1),
            attributes={'_ARRAY_DIMENSIONS': ['run', 'time', 'component'], 'long_name':
                        'attitude, body to space, and angular velocity, body axes'})

    def _remove_damaged(self, row: int, column: int) -> None:
        """Remove a chunk that cannot be read."""
        runs, times = self._shape
        try:
            self._array[row * runs:(row + 1) * runs, column * times:(column + 1) * times]
        except (RuntimeError, ValueError):
            self._file(row, column).unlink()

    def _chunks(self, first: int, stop: int) -> Iterator[tuple[int, int]]:
        """Generate the rows and columns of the chunks of some runs."""
        runs, times = self._shape
        return product(range(first // runs, -(-stop // runs)),
                       range(-(-self._times.size // times)))

    def _file(self, row: int, column: int) -> Path:
        return self._path / 'motion' / f'{row}.{column}.0'

    @contextmanager
    def _reported(self, verb: str) -> Iterator[None]:
        try:
            yield
        except (OSError, RuntimeError, TypeError, ValueError, KeyError) as error:
            raise InputError(f'{self._path}: cannot {verb} the motions: {reason(error)}; if they '
                             'are damaged, remove them to compute them again') from error
