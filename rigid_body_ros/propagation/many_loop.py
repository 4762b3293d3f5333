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
from rigid_body_ros.kernels.jit import COMPILES, njit, optional
from rigid_body_ros.kernels.lanes import LANES
from rigid_body_ros.propagation import groups, layout, loop
from rigid_body_ros.propagation.groups import Group
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
        How many runs are done. The next one has used up the budget, and another call continues
        from there.

    """
    closed = np.empty(len(stamps_ns) + 1, np.bool_)
    log = Log(stamps_ns, polynomials[0], in_space, first, stop, layout.unpack_timeout(settings))
    group = Group(np.empty(LANES, np.intp), states, progress, constants, gains, polynomials,
                  np.empty(LANES, np.intp), groups.workspace())
    for k in range(0, len(which), LANES):
        last = min(k + LANES, len(which)) - 1
        for lane in range(LANES):
            group.rows[lane] = which[min(k + lane, last)]
            group.slots[lane] = group.rows[lane] % len(polynomials)
        until, going = layout.IN_FORCE, True
        while going and until < stop:
            steps = 0
            if COMPILES and terms is None and last > k:  # the compiler leaves it out otherwise
                steps = groups.advance(group, times_ns, rows, log, settings)
                if steps >= groups.BUDGET:
                    return k
            # They finish the segment in which they were together one by one.
            sample = max(until, progress[which[k], layout.SAMPLE])
            until, going = min(stop, sample + (1 if steps > 0 else _PIECE)), False
            for j in range(k, last + 1):
                i = which[j]
                if not too_fast[i]:
                    begin, torques = first, polynomials[i % len(polynomials)]
                    if gains[i] != 1.0:
                        begin = max(first, progress[i, layout.SAMPLE])
                        torques = gains[i] * torques[begin - first:until + 1 - first]
                    result = loop.run(states[i], progress[i], times_ns, rows, motions[i], closed,
                                      stamps_ns, torques, in_space, begin, until, constants[i],
                                      settings, budget, _terms_of(terms, i))
                    if result == loop.UNFINISHED:
                        return j
                    too_fast[i] = result == loop.TOO_FAST
                    going |= not too_fast[i] and progress[i, layout.DONE] < len(times_ns)
    return len(which)


@optional
def _terms_of(terms: Floats, run: int) -> Floats:
    return terms[run % len(terms)]
