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

"""The loop that computes many runs without returning to Python between them."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.kernels import body_layout, groups, layout, loop
from rigid_body_ros.kernels import group as group_of_runs
from rigid_body_ros.kernels.fields import FIELDS
from rigid_body_ros.kernels.group import BUDGET, Group
from rigid_body_ros.kernels.groups import Advanced
from rigid_body_ros.kernels.jit import combined, inlined, internal, njit, optional, WRITTEN
from rigid_body_ros.kernels.layout import METHOD, PROGRESS, Rows, Terms

#: If several runs cannot step together, the loop advances the runs one by one by this many rows,
#: and then lets the runs try again to step together.
_PIECE = 64


class Runs(NamedTuple):
    """The data of all runs. Every array has one element or one row for each run."""

    #: The progress of each run; see `loop.run`. The kernel skips runs that have failed. It
    #: marks a run as failed if its body becomes too fast.
    progress: Annotated[NDArray[Any], 'r', PROGRESS, WRITTEN]
    motions: Annotated[Floats, 'r 7m', WRITTEN]
    constants: Annotated[Floats, f'r {body_layout.SIZE}']
    #: The factor by which each run multiplies the torque. All factors are 1 unless the torque is
    #: held.
    gains: Annotated[Floats, 'r']


class RunsWorkspace(NamedTuple):
    """Work arrays of `run_each`."""

    #: The first four arrays are the attributes `rows`, `going`, `limits_ns` and `work` of `Group`.
    lanes: Annotated[Ints, 'L', WRITTEN]
    going: Annotated[NDArray[np.bool_], 'L', WRITTEN]
    limits_ns: Annotated[Ints, 'L', WRITTEN]
    table: Annotated[Floats, f'{group_of_runs.ROWS} L', WRITTEN]
    #: See `loop.run`.
    closed: Annotated[NDArray[np.bool_], 'n+1', WRITTEN]
    #: The torques, multiplied by the factor of the current run.
    torques: Annotated[Floats, 'n 2d+1 3', WRITTEN]


@combined((), ('motors',), ('space',), ('motors', 'space'), ('motors', 'space', 'fields'))
class ManyTerms(NamedTuple):
    """What acts on the bodies of all runs besides the torques of the rows; see `Terms`."""

    #: The rotor momentum; run i uses element i % j.
    momentum: Annotated[Floats, 'j n|1 2 3']
    motors: Annotated[Floats, 'n d+1 3'] | None = None
    space: Annotated[Floats, 'n d+1 3'] | None = None
    #: The fields; run i uses element i % f.
    fields: Annotated[NDArray[Any], 'f', FIELDS] | None = None


class ManyRows(NamedTuple):
    """What acts on the bodies of all runs; see `Rows`."""

    times_ns: Annotated[Ints, 'n']
    #: The torques; run i uses element i % k.
    torques: Annotated[Floats, 'k n 2d+1 3']
    in_space: Annotated[NDArray[np.bool_], 'n']
    spans: Annotated[Floats, 'n|0']
    terms: ManyTerms | None = None


def workspace(lanes: int, rows: ManyRows) -> RunsWorkspace:
    """
    Return uninitialized work arrays for `run_each`.

    If there is only one lane, `run_each` does not form groups.
    """
    return RunsWorkspace(
        np.empty(lanes, np.intp), np.empty(lanes, np.bool_), np.empty(lanes, np.int64),
        group_of_runs.workspace(lanes), np.empty(len(rows.times_ns) + 1, np.bool_),
        np.empty(rows.torques.shape[1:]))


@njit
def run_each(which: Annotated[Ints, 'w'], runs: Runs, times_ns: Annotated[Ints, 'm'],
             order: Annotated[Ints, 'm|0'], rows: ManyRows,
             methods: Annotated[NDArray[Any], '1', METHOD], work: RunsWorkspace) -> int:
    """
    Compute many runs, stepping several of them together in lanes where possible.

    Parameters
    ----------
    which : array of int, shape (k,)
        Which runs to compute, as indices into the arrays of `runs`.
    runs : Runs
        All runs.
    times_ns, order, methods
        See `loop.run`. All runs share the same times and the same method.
    rows : ManyRows
        The rows of all runs.
    work : RunsWorkspace
        Work arrays, which the kernel overwrites.

    Returns
    -------
    int
        The number of runs at the beginning of `which` that are done. If this number is less than
        the length of `which`, the budget is used up; call the kernel again to continue.

    """
    progress, motions, constants, gains = runs
    method = layout.load_method(methods)
    group = Group(work.lanes, progress, motions, constants, gains, rows.torques, work.table,
                  work.going, work.limits_ns)
    outputs, k = len(times_ns), 0
    while True:
        k, count, ahead = _gather(group, which, k, outputs)
        if count == 0:
            return k
        until, going, stop = -1, True, progress[group.rows[0]].stop
        while going:
            together = Advanced(0, 0, progress[group.rows[0]].row)
            if rows.terms is None and count > 1:  # not compiled for scenes with terms
                together = groups.advance(
                    group, count, which[ahead:], times_ns, order,
                    Rows(rows.times_ns, rows.torques[0], rows.in_space, rows.spans),
                    method)
                ahead += together.taken
                if together.steps >= BUDGET:
                    return k
            # One by one, the runs now finish the segment in which they stepped together.
            until = max(until, together.until) + (_PIECE if together.steps == 0 else 0)
            until, going = min(stop, until), False
            for lane in range(count):
                i = group.rows[lane]
                if _is_left(progress[i], outputs, until):
                    first, row_times_ns, in_space = 0, rows.times_ns, rows.in_space
                    torques = rows.torques[i % len(rows.torques)]
                    if gains[i] != 1.0:
                        first = max(0, progress[i].row)
                        row_times_ns, in_space = row_times_ns[first:until + 1], in_space[first:]
                        torques = _scaled(torques, first, until + 1, gains[i], work.torques)
                    progress[i].row, progress[i].stop = progress[i].row - first, until - first
                    result = loop.run(
                        progress[i:i + 1], times_ns, order, motions[i], work.closed,
                        Rows(row_times_ns, torques, in_space, rows.spans,
                             _of_run(rows.terms, i)),
                        constants[i], methods)
                    progress[i].row, progress[i].stop = progress[i].row + first, stop
                    if result == layout.UNFINISHED:
                        return k
                    if result == layout.TOO_FAST:
                        progress[i].stop = layout.FAILED
                going |= _is_left(progress[i], outputs, stop)


@internal
def _gather(group: Group, which: NDArray[np.intp], k: int, outputs: int) -> tuple[int, int, int]:
    # Fill the lanes with the next runs that are not done. Return the position in `which` of the
    # first run in the lanes (or the length of `which` if there is none), the number of runs in the
    # lanes, and the position after the last run that was examined.
    begin, count = len(which), 0
    while k < len(which) and count < len(group.rows):
        i = which[k]
        if _is_left(group.progress[i], outputs, group.progress[i].stop):
            begin = min(begin, k)
            for lane in range(count, len(group.rows)):
                group.rows[lane] = i
            count += 1
        k += 1
    return begin, count, k


@internal
def _scaled(torques: Floats, first: int, stop: int, gain: float, results: Floats) -> Floats:
    # Multiply the torques of the rows from `first` to `stop` by a factor, and return the products
    # as a view of `results`.
    count = min(stop, len(torques)) - first
    for row in range(count):
        for k in range(torques.shape[1]):
            for axis in range(3):
                results[row, k, axis] = gain * torques[first + row, k, axis]
    return results[:count]


@inlined
def _is_left(progress: Any, outputs: int, stop: int) -> bool:
    # Return whether a run still has outputs to fill before it reaches the row `stop`.
    return progress.done < outputs and progress.row < stop and progress.stop != layout.FAILED


@optional
def _of_run(terms: ManyTerms, run: int) -> Terms:
    return Terms(terms.momentum[run % len(terms.momentum)], terms.motors, terms.space,
                 _fields_of_run(terms.fields, run), None, None)


@optional
def _fields_of_run(fields: NDArray[Any], run: int) -> NDArray[Any]:
    run %= len(fields)
    return fields[run:run + 1]
