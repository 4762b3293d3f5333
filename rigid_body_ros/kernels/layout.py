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
Data structures of the time loop.

Python passes a record such as PROGRESS to the kernels as a structured array with one element,
because such an array is as fast to pass as any other array, while a named tuple takes several
microseconds. Inside the kernels, the numbers are unpacked into named tuples such as `Place`, so
that the compiler can keep them in registers.
"""

from __future__ import annotations

import struct
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.kernels import body_layout, euler_equations, four, state_layout, vector
from rigid_body_ros.kernels.fields import FIELDS
from rigid_body_ros.kernels.jit import combined, inlined, internal, record, WRITTEN

#: Cost of a full step, or of a state computed in closed form, in units of work. Everything else,
#: such as a short step, costs 1.
STEP_COST = 16
#: Number of units of work after which a kernel returns, so that Python can handle signals. A
#: kernel takes at most about 0.1 s for this work.
BUDGET = 20_000 * STEP_COST
#: Results of `loop.run`. FINISHED: all outputs are filled, or the loop has reached the row at
#: which it was told to stop. UNFINISHED: the budget is used up; call the kernel again to continue.
#: TOO_FAST: the body turns faster than FASTEST.
FINISHED, UNFINISHED, TOO_FAST = range(3)
#: Up to this angular speed, rad/s, a step of 1 ns is short enough for the series to converge.
FASTEST = 1e9
#: Pass this as the argument `order` of `loop.run` if the requested times are in ascending order.
IN_ORDER = np.empty(0, np.intp)
#: The number of each solver, as stored in METHOD.
AUTO, TAYLOR, EXACT, RK4, STRANG, EXPLICIT_EULER = range(6)
#: Record of the solver, its tolerance and its limits on a step; see `Method`.
METHOD = record([
    ('solver', np.int64), ('fixed_step', np.bool_), ('closed_form_beyond', np.float64),
    ('tolerance', np.float64), ('angle', np.float64), ('max_step_ns', np.int64)])
#: Record of how far a motion has been computed (see `GridStates` and `Place`), the row at which
#: the loop stops, and the number of units of work after which the kernel returns.
PROGRESS = record([
    ('grid', np.float64, state_layout.WITH_WHEELS),
    ('begin', np.float64, state_layout.WITH_WHEELS),
    ('latest', np.float64, state_layout.WITH_WHEELS), ('grid_ns', np.int64),
    ('begin_ns', np.int64), ('row', np.int64), ('done', np.int64), ('stop', np.int64),
    ('budget', np.int64)])
#: The six integers at the end of PROGRESS.
_COUNTS = struct.Struct('6q')
#: When many runs are computed together, this value of `stop` marks a run that has failed. A run
#: fails if its body becomes too fast or if its inputs are invalid.
FAILED = -2


class Body(NamedTuple):
    """The constants of a body."""

    coefficients: vector.Coefficients
    frame: vector.PrincipalFrame


class Method(NamedTuple):
    """The solver, its tolerance and its limits on a step."""

    #: The values of `Solver.code`, `Solver.fixed_step` and `Solver.closed_form_beyond`.
    solver: int
    fixed_step: bool
    closed_form_beyond: float
    #: Bound on the truncation error of the attitude for each radian that the body turns.
    tolerance: float
    #: The angle by which the body turns in a full step of the series, rad.
    angle: float
    max_step_ns: int


class Lags(NamedTuple):
    """Torques that follow their commands with a lag; see `lags`."""

    #: The excess, which is the torque minus the command, at the time of each row, N m. Each time
    #: constant has one excess in body axes and one in space axes. Every excess decays with time.
    #: The commands themselves are in the rows.
    excess: Annotated[Floats, 'n l 2 3']
    #: The time constants, s.
    time_constants: Annotated[Floats, 'l']


class Friction(NamedTuple):
    """Wheels with friction or a largest speed, padded to a multiple of four; see `friction`."""

    #: The motor torque on each wheel in each row, N m.
    efforts: Annotated[Floats, 'n 4g']
    #: The constants of the wheels; see `friction.SIZE`.
    wheels: Annotated[Floats, '28g']
    #: The axial momenta of the wheels at the requested times, N m s, and the efforts that their
    #: motors apply, N m.
    momenta: Annotated[Floats, 'm 8g', WRITTEN]
    #: The times at which wheels reach or leave their largest speed; see `limits`. The first
    #: element of the first row is the number of rows that follow.
    events: Annotated[Ints, 'e 4', WRITTEN]


@combined((), ('motors',), ('space',), ('motors', 'space'), ('motors', 'space', 'fields'),
          ('motors', 'space', 'fields', 'lags'), ('motors', 'space', 'fields', 'lags', 'friction'))
class Terms(NamedTuple):
    """
    What acts on a body besides the torques of the rows.

    Kernels are compiled for few combinations. If there are fields, lags or friction, all parts
    before them are given, too: zero torques, no fields and no lags are then empty arrays or zeros.
    """

    #: The rotor momentum and its low-order part, N m s. The array has a single row if the momentum
    #: is constant.
    momentum: Annotated[Floats, 'n|1 2 3']
    #: The torque on the rotors, N m, as the coefficients of a polynomial of degree d. None if no
    #: torque acts on the rotors; all zeros if there is friction.
    motors: Annotated[Floats, 'n d+1 3'] | None = None
    #: The torque in space axes, N m, as the coefficients of a polynomial of degree d. None unless
    #: such a torque acts in addition to a torque in body axes.
    space: Annotated[Floats, 'n d+1 3'] | None = None
    #: The fields, whose torques depend on the attitude.
    fields: Annotated[NDArray[Any], '1', FIELDS] | None = None
    lags: Lags | None = None
    friction: Friction | None = None


class Rows(NamedTuple):
    """What acts on a body. Each row is in force from its own time until the next row begins."""

    #: When each row begins, ns, in strictly ascending order. No torque acts before the first row.
    times_ns: Annotated[Ints, 'n']
    #: Torques on the body, N m, as polynomials of degree d; see `TorqueLog.polynomials`. If a
    #: torque is in body axes, the torque on the rotors has already been subtracted from it.
    torques: Annotated[Floats, 'n 2d+1 3']
    #: Whether the torque of each row is in space axes.
    in_space: Annotated[NDArray[np.bool_], 'n']
    #: How long the variable of each polynomial takes to grow from 0 to 1, s. The array is empty if
    #: the polynomials are constant.
    spans: Annotated[Floats, 'n|0']
    #: What acts besides the torques of the rows. None if the scene has no rotors, damping, fields
    #: or lags, and does not combine torques in body axes with torques in space axes.
    terms: Terms | None = None


class Sums(NamedTuple):
    """The summed torques and the rotor momentum in each row; see `Rows` and `Terms`."""

    times_ns: Annotated[Ints, 'n', WRITTEN]
    in_space: Annotated[NDArray[np.bool_], 'n', WRITTEN]
    torques: Annotated[Floats, 'n 2d+1 3', WRITTEN]
    space: Annotated[Floats, 'n d+1 3', WRITTEN]
    motors: Annotated[Floats, 'n d+1 3', WRITTEN]
    momentum: Annotated[Floats, 'n 2 3', WRITTEN]


class Samples(NamedTuple):
    """The torque samples of all sources, one source after another."""

    #: Torques, N m, as polynomials of degree d; see `Rows`.
    coefficients: Annotated[Floats, 'p 2d+1 3']
    stamps_ns: Annotated[Ints, 'p']
    in_space: Annotated[NDArray[np.bool_], 'p']
    #: The index of the first sample of each source, followed by the total number of samples.
    offsets: Annotated[Ints, 's+1']


class Requested(NamedTuple):
    """The requested times, and the arrays that receive the results."""

    #: int64 (m,): the requested times, ns. None of them is before the start of the motion.
    times_ns: NDArray[np.int64]
    #: int (m,): indices that sort the requested times in ascending order. The shape is (0,) if the
    #: times are already sorted.
    order: NDArray[np.intp]
    #: float64 (7 m,): the motion; see `motion_layout`.
    motion: Floats
    #: bool (n + 1,): the element at index row + 1 tells whether the coast in that row was computed
    #: in closed form.
    closed: NDArray[np.bool_]


class Place(NamedTuple):
    """How far the loop has advanced the motion."""

    #: The time of the state on the step grid, and the time at which the segment begins, ns.
    grid_ns: int
    begin_ns: int
    #: The row in force; -1 before the first row.
    row: int
    #: The number of outputs that are filled.
    done: int


class GridStates(NamedTuple):
    """The states of the motion that the loop stores in PROGRESS."""

    #: The state at the last point of the step grid that the loop has reached.
    grid: vector.KernelState
    #: The state at the beginning of the segment.
    begin: vector.KernelState
    #: The state that was computed most recently.
    latest: vector.KernelState


def begun(grid: Floats, grid_ns: int, begin: Floats, begin_ns: int, row: int,
          stop: int) -> NDArray[Any]:
    """
    Return the progress record of a motion that continues from a grid point.

    Parameters
    ----------
    grid, begin : array, shape (state_layout.WITH_WHEELS,)
        The state at the grid point, and the state at the beginning of the segment.
    grid_ns, begin_ns : int
        The times of these two states, ns.
    row, stop : int
        The row that is in force, and the row at which to stop.

    Returns
    -------
    array of PROGRESS, shape (1,)

    """
    # Pack all fields as bytes, because assigning them one by one would take three times as long.
    states, latest = grid.tobytes() + begin.tobytes(), grid.tobytes()
    return np.frombuffer(bytearray(states + latest + _COUNTS.pack(
        grid_ns, begin_ns, row, 0, stop, BUDGET)), PROGRESS)


@internal
def load_method(methods: NDArray[Any]) -> Method:
    """Return the contents of an array of METHOD as a `Method`."""
    method = methods[0]
    return Method(method.solver, method.fixed_step, method.closed_form_beyond, method.tolerance,
                  method.angle, method.max_step_ns)


@internal
def load_body(constants: Floats) -> Body:
    """Return the body with the given constants; see `body_layout`."""
    return Body(body_layout.coefficients(constants, form_of(constants)),
                body_layout.principal_frame(constants))


@inlined
def form_of(constants: Floats) -> int:
    """Return the form of the inertia tensor: DIAGONAL, FULL or THIN."""
    moments = four.load(constants, body_layout.MOMENTS)
    a, b, c, d, e, f, _, _, _ = body_layout.coefficients(constants, euler_equations.FULL).columns
    if (a[1] == a[2] == b[0] == b[2] == c[0] == c[1] == 0.0
            and vector.is_zero(d) and vector.is_zero(e) and vector.is_zero(f)):
        return euler_equations.DIAGONAL
    is_thin = moments[2] > euler_equations.THIN_RATIO * moments[0]
    return euler_equations.THIN if is_thin else euler_equations.FULL


@internal
def load_states(progress: NDArray[Any]) -> GridStates:
    """
    Return the states that are stored in a progress record.

    Until the loop computes another state, the state `latest` is equal to the grid state.
    """
    grid = state_layout.load(progress[0].grid, 0)
    return GridStates(grid, state_layout.load(progress[0].begin, 0), grid)


@internal
def store_states(reached: GridStates, progress: NDArray[Any]) -> None:
    """Write the states of the motion back to the progress record."""
    state_layout.store(reached.grid, progress[0].grid, 0)
    state_layout.store(reached.begin, progress[0].begin, 0)
    state_layout.store(reached.latest, progress[0].latest, 0)


@inlined
def load_place(progress: NDArray[Any]) -> Place:
    """Return how far the loop has advanced the motion, as stored in the progress record."""
    stored = progress[0]
    return Place(stored.grid_ns, stored.begin_ns, stored.row, stored.done)


@internal
def store_place(place: Place, progress: NDArray[Any]) -> None:
    """Write how far the loop has advanced the motion back to the progress record."""
    progress[0].grid_ns, progress[0].begin_ns = place.grid_ns, place.begin_ns
    progress[0].row, progress[0].done = place.row, place.done
