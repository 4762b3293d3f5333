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

"""The loop over many runs, which does not return to Python between runs."""

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
from rigid_body_ros.kernels.jit import inlined, internal, njit, optional, WRITTEN
from rigid_body_ros.kernels.layout import METHOD, PROGRESS, Rows, Terms

#: Number of rows after which runs that could not step together try again.
_PIECE = 64


class Runs(NamedTuple):
    """All runs. Each array has an element or a row for each run."""

    #: See `loop.run`. A run that has failed is skipped. A run fails if its body becomes too
    #: fast.
    progress: Annotated[NDArray[Any], 'r', PROGRESS, WRITTEN]
    motions: Annotated[Floats, 'r 7m', WRITTEN]
    constants: Annotated[Floats, f'r {body_layout.SIZE}']
    #: Factors of the torque. All factors are 1 if the torque is not held.
    gains: Annotated[Floats, 'r']


class RunsWorkspace(NamedTuple):
    """The arrays that `run_each` needs besides its results."""

    #: See `rows`, `going`, `limits_ns` and `work` of `Group`.
    lanes: Annotated[Ints, 'L', WRITTEN]
    going: Annotated[NDArray[np.bool_], 'L', WRITTEN]
    limits_ns: Annotated[Ints, 'L', WRITTEN]
    table: Annotated[Floats, f'{group_of_runs.ROWS} L', WRITTEN]
    #: See `loop.run`.
    closed: Annotated[NDArray[np.bool_], 'n+1', WRITTEN]
    #: The torques multiplied by the factor of a run.
    torques: Annotated[Floats, 'n 2d+1 3', WRITTEN]


class ManyTerms(NamedTuple):
    """What acts on the bodies of all runs besides the torques of the rows; see `Terms`."""

    #: Run i uses the element i % j.
    momentum: Annotated[Floats, 'j n|1 2 3']
    motors: Annotated[Floats, 'n d+1 3'] | None
    space: Annotated[Floats, 'n d+1 3'] | None
    fields: None = None


class ManyFieldTerms(NamedTuple):
    """`ManyTerms` with fields; see `FieldTerms`."""

    momentum: Annotated[Floats, 'j n|1 2 3']
    motors: Annotated[Floats, 'n d+1 3']
    space: Annotated[Floats, 'n d+1 3']
    #: Run i uses the element i % f.
    fields: Annotated[NDArray[Any], 'f', FIELDS]


class ManyRows(NamedTuple):
    """What acts on the bodies of all runs; see `Rows`."""

    times_ns: Annotated[Ints, 'n']
    #: Run i uses the element i % k.
    torques: Annotated[Floats, 'k n 2d+1 3']
    in_space: Annotated[NDArray[np.bool_], 'n']
    spans: Annotated[Floats, 'n|0']
    terms: ManyTerms | ManyFieldTerms | None = None


def workspace(lanes: int, rows: ManyRows) -> RunsWorkspace:
    """Return unfilled arrays for the rows of all runs; with one lane there are no groups."""
    return RunsWorkspace(
        np.empty(lanes, np.intp), np.empty(lanes, np.bool_), np.empty(lanes, np.int64),
        group_of_runs.workspace(lanes), np.empty(len(rows.times_ns) + 1, np.bool_),
        np.empty(rows.torques.shape[1:]))


@njit
def run_each(which: Annotated[Ints, 'w'], runs: Runs, times_ns: Annotated[Ints, 'm'],
             order: Annotated[Ints, 'm|0'], rows: ManyRows,
             methods: Annotated[NDArray[Any], '1', METHOD], work: RunsWorkspace) -> int:
    """
    Run the loop for many runs, some of them in lanes.

    Parameters
    ----------
    which : array of int, shape (k,)
        The runs to compute, as indices into the arrays of `runs`.
    runs : Runs
        All runs.
    times_ns, order, methods
        See `loop.run`. All runs have the same times and the same method.
    rows : ManyRows
        The rows of all runs.
    work : RunsWorkspace
        Arrays that the kernel overwrites.

    Returns
    -------
    int
        The number of runs that are done, counted up to the first run that is not done. If this
        number is less than the number of runs in `which`, the budget is used up, and another call
        continues.

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
            if rows.terms is None and count > 1:  # if there are terms, this is not compiled
                together = groups.advance(
                    group, count, which[ahead:], times_ns, order,
                    Rows(rows.times_ns, rows.torques[0], rows.in_space, rows.spans),
                    method)
                ahead += together.taken
                if together.steps >= BUDGET:
                    return k
            # One by one, the runs finish the segment in which they stepped together.
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
    # Fill the lanes with the next runs that are not done. Return the position of the first of
    # these runs (the length of `which` if there is none), their count, and the position after the
    # last.
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
    # Store some rows of torques times a factor in the array of results, and return these rows.
    count = min(stop, len(torques)) - first
    for row in range(count):
        for k in range(torques.shape[1]):
            for axis in range(3):
                results[row, k, axis] = gain * torques[first + row, k, axis]
    return results[:count]


@inlined
def _is_left(progress: Any, outputs: int, stop: int) -> bool:
    # Return whether a run has outputs to fill before it reaches a row.
    return progress.done < outputs and progress.row < stop and progress.stop != layout.FAILED


@optional
def _of_run(terms: ManyTerms | ManyFieldTerms, run: int) -> Terms:
    return Terms(terms.momentum[run % len(terms.momentum)], terms.motors, terms.space,
                 _fields_of_run(terms.fields, run), None, None)


@optional
def _fields_of_run(fields: NDArray[Any], run: int) -> NDArray[Any]:
    run %= len(fields)
    return fields[run:run + 1]
