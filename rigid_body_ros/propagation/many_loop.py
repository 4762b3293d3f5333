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

"""The loop over many runs, without Python between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels.jit import COMPILES, inlined, internal, njit, optional
from rigid_body_ros.kernels.lanes import LANES
from rigid_body_ros.propagation import groups, layout, loop
from rigid_body_ros.propagation.group import BUDGET, Group, workspace
from rigid_body_ros.propagation.groups import Advanced
from rigid_body_ros.propagation.layout import Log

#: Samples after which runs that could not step together are tried again.
_PIECE = 64


@njit
def run_each(which: NDArray[np.intp], states: Floats, progress: NDArray[np.int64],
             times_ns: NDArray[np.int64], rows: NDArray[np.intp], motions: Floats,
             stamps_ns: NDArray[np.int64], polynomials: Floats, in_space: NDArray[np.bool_],
             first: int, stop: int, constants: Floats, settings: Floats, budget: int,
             terms: Floats | None, gains: Floats, too_fast: NDArray[np.bool_]) -> int:
    """
    Run the loop for many runs, some of them in lanes.

    Parameters
    ----------
    which : array of int, shape (k,)
        The runs, rows of the arrays that follow.
    states, progress, motions, constants : array, shape (n, ...)
        A row for each run, see `loop.run`.
    times_ns, rows, stamps_ns, in_space, first, stop, settings, budget
        As for `loop.run`, of all runs.
    polynomials, terms : array, shape (k, ...)
        As for `loop.run`; of run i the row i % k. The terms may be None.
    gains : array, shape (n,)
        Factors of the torque; all 1 for a torque that is not held.
    too_fast : array of bool, shape (n,)
        Set where the body becomes too fast; such runs are skipped.

    Returns
    -------
    int
        How many runs are done, counted up to the first that is not. If that is fewer than given,
        the budget is used up, and another call continues.

    """
    closed = np.empty(len(stamps_ns) + 1, np.bool_)
    log = Log(stamps_ns, polynomials[0], in_space, first, stop, layout.unpack_timeout(settings))
    group = Group(np.empty(LANES, np.intp), states, progress, motions, constants, gains,
                  polynomials, workspace())
    outputs, k = len(times_ns), 0
    while True:
        k, count, ahead = _gather(group, which, k, outputs, stop, too_fast)
        if count == 0:
            return k
        until, going = layout.IN_FORCE, True
        while going:
            together = Advanced(0, 0, progress[group.rows[0], layout.SAMPLE])
            if COMPILES and terms is None and count > 1:  # the compiler leaves it out otherwise
                together = groups.advance(group, count, which[ahead:], times_ns, rows, log,
                                          settings)
                ahead += together.taken
                if together.steps >= BUDGET:
                    return k
            # They finish the segment in which they were together one by one.
            until = max(until, together.until) + (_PIECE if together.steps == 0 else 0)
            until, going = min(stop, until), False
            for lane in range(count):
                i = group.rows[lane]
                if not too_fast[i] and _is_left(progress[i], outputs, until):
                    begin, torques = first, polynomials[i % len(polynomials)]
                    if gains[i] != 1.0:
                        begin = max(first, progress[i, layout.SAMPLE])
                        torques = gains[i] * torques[begin - first:until + 1 - first]
                    result = loop.run(states[i], progress[i], times_ns, rows, motions[i], closed,
                                      stamps_ns, torques, in_space, begin, until, constants[i],
                                      settings, budget, _terms_of(terms, i))
                    if result == loop.UNFINISHED:
                        return k
                    too_fast[i] = result == loop.TOO_FAST
                going |= not too_fast[i] and _is_left(progress[i], outputs, stop)


@internal
def _gather(group: Group, which: NDArray[np.intp], k: int, outputs: int, stop: int,
            too_fast: NDArray[np.bool_]) -> tuple[int, int, int]:
    # Fill the lanes with the next runs that are left. Return the position of the first of them, or
    # the number of runs, how many they are, and the position after the last.
    begin, count = len(which), 0
    while k < len(which) and count < LANES:
        i = which[k]
        if not too_fast[i] and _is_left(group.progress[i], outputs, stop):
            begin = min(begin, k)
            group.rows[count:] = i
            count += 1
        k += 1
    return begin, count, k


@inlined
def _is_left(progress: NDArray[np.int64], outputs: int, stop: int) -> bool:
    # Return whether a run has outputs to fill before it reaches a sample.
    return progress[layout.DONE] < outputs and progress[layout.SAMPLE] < stop


@optional
def _terms_of(terms: Floats, run: int) -> Floats:
    return terms[run % len(terms)]
