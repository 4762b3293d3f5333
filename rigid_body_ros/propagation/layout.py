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
The records of the time loop, and the arrays that carry them from Python into the kernel and back.

To pass a named tuple from Python to a kernel takes several microseconds; an array takes a fraction
of one. So options, states and progress are passed in three arrays, which this module packs and
unpacks. Inside the kernels records cost nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import (
    body_layout,
    euler_equations,
    four,
    linear_terms,
    state_layout,
    taylor,
    vector,
)
from rigid_body_ros.kernels.jit import inlined, internal, optional

#: Offsets in the array of progress.
GRID_NS, BEGIN_NS, SAMPLE, TIMED_OUT, DONE = range(5)
#: Size of the array of states.
_STATES = 3 * state_layout.SIZE
#: Value of SAMPLE that makes the kernel find the sample in force at the beginning of the segment.
IN_FORCE = -2
#: Offsets in the array of options.
_SOLVER, _FIXED_STEP, _CLOSED_FORM_BEYOND, _TOLERANCE, _MAX_STEP_NS, _TIMEOUT_NS, _ANGLE = range(7)


class Body(NamedTuple):
    """The constants of a body."""

    coefficients: vector.Coefficients
    #: DIAGONAL, FULL or THIN, see `euler_equations`.
    form: int
    frame: vector.PrincipalFrame


class Method(NamedTuple):
    """The solver, its tolerance and its limits on a step."""

    #: `Solver.code`, `Solver.fixed_step` and `Solver.closed_form_beyond`.
    solver: int
    fixed_step: bool
    closed_form_beyond: float
    #: Truncation error of the attitude per radian turned.
    tolerance: float
    #: Angle of a full step of the series, rad.
    angle: float
    max_step_ns: int


class Log(NamedTuple):
    """A piece of a torque log."""

    #: int64 (n,): when each sample comes into force.
    stamps_ns: NDArray[np.int64]
    #: float64 (k, 2 degree + 1, 3), N m, from the sample `first` on; see
    #: `TorqueLog.polynomials`.
    polynomials: Floats
    #: bool (n,): whether the torque of a sample is given in space axes.
    in_space: NDArray[np.bool_]
    #: The sample that `polynomials` begins with.
    first: int
    #: The sample to stop at.
    stop: int
    #: How long after a sample the torque becomes zero, ns; 0: never.
    timeout_ns: int


class Outputs(NamedTuple):
    """The requested times, and the arrays for the results."""

    #: int64 (m,), ns: requested times, none before the beginning.
    times_ns: NDArray[np.int64]
    #: int (m,): rows of `times_ns` and of the motion in ascending order of time; (0,) if the times
    #: ascend.
    rows: NDArray[np.intp]
    #: float64 (7 m,), see `motion_layout`.
    motion: Floats
    #: bool (n + 1,): at index sample + 1, whether a coast was computed in closed form.
    closed: NDArray[np.bool_]


class Place(NamedTuple):
    """Progress of the loop."""

    #: Time of the state on the step grid, and of the beginning of the segment.
    grid_ns: int
    begin_ns: int
    #: The sample in force; -1: none yet.
    sample: int
    #: Whether that sample has timed out.
    timed_out: bool
    #: How many outputs are filled.
    done: int


class States(NamedTuple):
    """The states of the loop."""

    #: On the step grid.
    grid: vector.KernelState
    #: At the beginning of the segment.
    begin: vector.KernelState
    #: Computed last.
    latest: vector.KernelState


def pack_settings(solver: int, fixed_step: bool, closed_form_beyond: float, tolerance: float,
                  max_step_ns: int, timeout_ns: int) -> Floats:
    """
    Return options as an array. Nanoseconds rounded from seconds fit a double exactly.

    The kernels add the angle of a full step.
    """
    settings = np.zeros(7)
    settings[_SOLVER], settings[_FIXED_STEP] = solver, fixed_step
    settings[_CLOSED_FORM_BEYOND], settings[_TOLERANCE] = closed_form_beyond, tolerance
    settings[_MAX_STEP_NS], settings[_TIMEOUT_NS] = max_step_ns, timeout_ns
    return settings


@internal
def unpack_method(settings: Floats) -> Method:
    """Return the solver, its tolerance and its limits on a step."""
    tolerance = float(settings[_TOLERANCE])
    if settings[_ANGLE] == 0.0:  # kept for the next call: the logarithm takes as long as a step
        settings[_ANGLE] = taylor.step_angle(tolerance)
    return Method(int(settings[_SOLVER]), settings[_FIXED_STEP] != 0.0,
                  float(settings[_CLOSED_FORM_BEYOND]), tolerance, float(settings[_ANGLE]),
                  int(settings[_MAX_STEP_NS]))


@inlined
def unpack_timeout(settings: Floats) -> int:
    """Return the torque timeout, ns."""
    return int(settings[_TIMEOUT_NS])


@internal
def unpack_body(constants: Floats) -> Body:
    """Return a body from its constants, see `body_layout`."""
    return Body(body_layout.coefficients(constants), unpack_form(constants),
                body_layout.principal_frame(constants))


@optional
def unpack_terms(terms: Floats) -> Floats:
    """Return the terms of `loop.run` without the axis that stands for torques in space axes."""
    if terms.ndim == 4:
        return terms[0]
    return terms


@optional
def two_frames(terms: Floats) -> bool | None:
    """Return None if there are no torques in space axes among the terms."""
    if terms.ndim == 4:
        return True
    return None


@optional
def unpack_linear(_terms: Floats, constants: Floats) -> linear_terms.Constants:
    """Return the matrices of a body in a scene that has terms."""
    return body_layout.linear_constants(constants)


@inlined
def unpack_form(constants: Floats) -> int:
    """Return the form of the inertia tensor: DIAGONAL, FULL or THIN."""
    moments = four.load(constants, body_layout.MOMENTS)
    a, b, c, d, e, f, _, _, _ = body_layout.coefficients(constants)[0]
    if (a[1] == a[2] == b[0] == b[2] == c[0] == c[1] == 0.0
            and is_zero_vector(d) and is_zero_vector(e) and is_zero_vector(f)):
        return euler_equations.DIAGONAL
    is_thin = moments[2] > euler_equations.THIN_RATIO * moments[0]
    return euler_equations.THIN if is_thin else euler_equations.FULL


@inlined
def is_zero_vector(a: vector.Vector) -> bool:
    """Return whether all components are zero."""
    return a[0] == 0.0 and a[1] == 0.0 and a[2] == 0.0


def pack_states(grid: Floats, begin: Floats | None = None) -> Floats:
    """
    Return states as an array.

    Parameters
    ----------
    grid : array, shape (state_layout.SIZE,)
        The state on the grid.
    begin : array, shape (state_layout.SIZE,), optional
        The state at the beginning of the segment. Not used with a SAMPLE of IN_FORCE: the segment
        then begins with the state on the grid.

    """
    states = np.empty(_STATES)
    states[:state_layout.SIZE] = grid
    if begin is not None:
        states[state_layout.SIZE:2 * state_layout.SIZE] = begin
    return states


def unpack_states(states: Floats) -> tuple[Floats, Floats, Floats]:
    """Return views of the state on the grid, at the segment's beginning, and computed last."""
    size = state_layout.SIZE
    return states[:size], states[size:2 * size], states[2 * size:]


@internal
def load_states(states: Floats) -> States:
    """Return the states; the latest is that on the grid until another is computed."""
    grid = state_layout.load(states, 0)
    return States(grid, state_layout.load(states, state_layout.SIZE), grid)


@internal
def store_states(reached: States, states: Floats) -> None:
    """Write the states back."""
    state_layout.store(reached.grid, states, 0)
    state_layout.store(reached.begin, states, state_layout.SIZE)
    state_layout.store(reached.latest, states, 2 * state_layout.SIZE)


def pack_place(grid_ns: int, begin_ns: int, sample: int,
               timed_out: bool = False) -> NDArray[np.int64]:
    """Return the progress of a loop that has not yet filled an output, as an array."""
    return np.array((grid_ns, begin_ns, sample, timed_out, 0), np.int64)


@inlined
def load_place(progress: NDArray[np.int64]) -> Place:
    """Return the progress of the loop from an array."""
    return Place(int(progress[GRID_NS]), int(progress[BEGIN_NS]), int(progress[SAMPLE]),
                 progress[TIMED_OUT] != 0, int(progress[DONE]))


@inlined
def store_place(place: Place, progress: NDArray[np.int64]) -> None:
    """Write the progress of the loop back to an array."""
    progress[GRID_NS], progress[BEGIN_NS] = place.grid_ns, place.begin_ns
    progress[SAMPLE], progress[TIMED_OUT] = place.sample, place.timed_out
    progress[DONE] = place.done
