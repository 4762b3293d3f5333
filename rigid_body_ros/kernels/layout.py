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
The records of the time loop.

Python passes a record such as PROGRESS to the kernels as a structured array with one element. Such
an array is as fast to pass as any other array, whereas a named tuple takes several microseconds.
Inside the kernels, the numbers are in named tuples such as `Place`, which the kernels keep in
registers.
"""

from __future__ import annotations

import struct
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.kernels import (
    body_layout,
    euler_equations,
    four,
    state_layout,
    vector,
)
from rigid_body_ros.kernels.fields import FIELDS
from rigid_body_ros.kernels.jit import inlined, internal, record, WRITTEN

#: Cost of a full step or of a state in closed form, in units of work. Everything else,
#: such as a short step, costs 1.
STEP_COST = 16
#: After this many units of work, which take at most about 0.1 s, a kernel returns so that Python
#: can handle signals.
BUDGET = 20_000 * STEP_COST
#: Results of `loop.run`. FINISHED: all outputs are filled, or the row at which to stop is reached.
#: UNFINISHED: the budget is used up, and another call continues. TOO_FAST: the body turns faster
#: than FASTEST.
FINISHED, UNFINISHED, TOO_FAST = range(3)
#: Up to this speed, rad/s, the series converges in a step of a nanosecond.
FASTEST = 1e9
#: The argument `order` of `loop.run` if the times ascend.
IN_ORDER = np.empty(0, np.intp)
#: The codes of the solvers.
AUTO, TAYLOR, EXACT, RK4, STRANG, EXPLICIT_EULER = range(6)
#: The solver and its limits on a step; see `Method`.
METHOD = record([
    ('solver', np.int64), ('fixed_step', np.bool_), ('closed_form_beyond', np.float64),
    ('tolerance', np.float64), ('angle', np.float64), ('max_step_ns', np.int64)])
#: The progress of a motion (see `GridStates` and `Place`), the row at which to stop, and the units
#: of work after which to return.
PROGRESS = record([
    ('grid', np.float64, state_layout.WITH_WHEELS),
    ('begin', np.float64, state_layout.WITH_WHEELS),
    ('latest', np.float64, state_layout.WITH_WHEELS), ('grid_ns', np.int64),
    ('begin_ns', np.int64), ('row', np.int64), ('done', np.int64), ('stop', np.int64),
    ('budget', np.int64)])
#: The integers of PROGRESS.
_COUNTS = struct.Struct('6q')
#: Value of `stop` that marks a failed run among many runs. A run fails if its body becomes too
#: fast or its inputs are invalid.
FAILED = -2


class Body(NamedTuple):
    """The constants of a body."""

    coefficients: vector.Coefficients
    frame: vector.PrincipalFrame


class Method(NamedTuple):
    """The solver, its tolerance and its limits on a step."""

    #: `Solver.code`, `Solver.fixed_step` and `Solver.closed_form_beyond`.
    solver: int
    fixed_step: bool
    closed_form_beyond: float
    #: Bound on the truncation error of the attitude per radian turned.
    tolerance: float
    #: Angle of a full step of the series, rad.
    angle: float
    max_step_ns: int


class Terms(NamedTuple):
    """What acts on a body besides the torques of the rows."""

    #: Momentum of the rotors and its low-order part, N m s; a single row if it is constant.
    momentum: Annotated[Floats, 'n|1 2 3']
    #: Coefficients of the torque on the rotors, N m, of degree d; None without such a torque.
    motors: Annotated[Floats, 'n d+1 3'] | None
    #: Coefficients of a torque in space axes that acts in addition to a torque in body axes; None
    #: without such a torque.
    space: Annotated[Floats, 'n d+1 3'] | None
    #: None in `Terms`; see `FieldTerms`, `LagTerms` and `FrictionTerms`.
    fields: None = None
    lags: None = None
    friction: None = None


class FieldTerms(NamedTuple):
    """`Terms` with fields. No kind of torque is None, so that kernels are compiled only once."""

    momentum: Annotated[Floats, 'n|1 2 3']
    motors: Annotated[Floats, 'n d+1 3']
    space: Annotated[Floats, 'n d+1 3']
    #: The torques that depend on the attitude.
    fields: Annotated[NDArray[Any], '1', FIELDS]
    lags: None = None
    friction: None = None


class Lags(NamedTuple):
    """Torques that follow their commands with a lag; see `lags`."""

    #: Torques minus commands at the time of each row, N m, one for each time constant, in body
    #: axes and in space axes. The rows contain the commands; the excess decays.
    excess: Annotated[Floats, 'n l 2 3']
    #: The time constants, s.
    time_constants: Annotated[Floats, 'l']


class LagTerms(NamedTuple):
    """`FieldTerms` with torques that lag; fields may be absent."""

    momentum: Annotated[Floats, 'n|1 2 3']
    motors: Annotated[Floats, 'n d+1 3']
    space: Annotated[Floats, 'n d+1 3']
    fields: Annotated[NDArray[Any], '1', FIELDS]
    lags: Lags
    friction: None = None


class Friction(NamedTuple):
    """Wheels with friction, see `friction`; their number is padded to a multiple of four."""

    #: The torque of the motor of each wheel in each row, N m.
    efforts: Annotated[Floats, 'n 4g']
    #: The constants of the wheels; see `friction.SIZE`.
    wheels: Annotated[Floats, '24g']
    #: The axial momenta at the requested times, N m s.
    momenta: Annotated[Floats, 'm 4g', WRITTEN]


class FrictionTerms(NamedTuple):
    """`LagTerms` with friction; fields and lags may be absent, and `motors` contains zeros."""

    momentum: Annotated[Floats, 'n|1 2 3']
    motors: Annotated[Floats, 'n d+1 3']
    space: Annotated[Floats, 'n d+1 3']
    fields: Annotated[NDArray[Any], '1', FIELDS]
    lags: Lags
    friction: Friction


AnyTerms = Terms | FieldTerms | LagTerms | FrictionTerms


class Rows(NamedTuple):
    """What acts on a body: each row acts from its time to the time of the next row."""

    #: When each row begins, ns, strictly ascending. Before the first row no torque acts.
    times_ns: Annotated[Ints, 'n']
    #: Torques on the body, N m, as polynomials of degree d; see `TorqueLog.polynomials`. The
    #: torque on the rotors is already subtracted from a torque in body axes.
    torques: Annotated[Floats, 'n 2d+1 3']
    #: Whether the torque of each row is in space axes.
    in_space: Annotated[NDArray[np.bool_], 'n']
    #: The time in which the variable of the polynomials grows from 0 to 1, s. Empty if the
    #: polynomials are constant.
    spans: Annotated[Floats, 'n|0']
    #: What acts besides the torques of the rows. None if there are no rotors, no damping, no
    #: fields, no lags and no torques in two frames.
    terms: AnyTerms | None = None


class Sums(NamedTuple):
    """The sums of torques at the rows, and the momentum of the rotors; see `Rows`."""

    times_ns: Annotated[Ints, 'n', WRITTEN]
    in_space: Annotated[NDArray[np.bool_], 'n', WRITTEN]
    torques: Annotated[Floats, 'n 2d+1 3', WRITTEN]
    space: Annotated[Floats, 'n d+1 3', WRITTEN]
    motors: Annotated[Floats, 'n d+1 3', WRITTEN]
    momentum: Annotated[Floats, 'n 2 3', WRITTEN]


class Samples(NamedTuple):
    """The samples of all sources, one source after the other."""

    #: Torques, N m, as polynomials of degree d, as in `Rows`.
    coefficients: Annotated[Floats, 'p 2d+1 3']
    stamps_ns: Annotated[Ints, 'p']
    in_space: Annotated[NDArray[np.bool_], 'p']
    #: The index at which each source begins, and the number of samples.
    offsets: Annotated[Ints, 's+1']


class Requested(NamedTuple):
    """The requested times, and the arrays for the results."""

    #: int64 (m,): the requested times, ns, none before the start of the motion.
    times_ns: NDArray[np.int64]
    #: int (m,): the indices into `times_ns` and the motion, in ascending order of time; shape (0,)
    #: if the times ascend.
    order: NDArray[np.intp]
    #: float64 (7 m,): the motion; see `motion_layout`.
    motion: Floats
    #: bool (n + 1,): at index row + 1, whether the coast in this row was computed in closed form.
    closed: NDArray[np.bool_]


class Place(NamedTuple):
    """Progress of the loop."""

    #: Time of the state on the step grid, and of the beginning of the segment.
    grid_ns: int
    begin_ns: int
    #: The row in force; -1 before the first row.
    row: int
    #: The number of outputs that are filled.
    done: int


class GridStates(NamedTuple):
    """The states of the loop."""

    #: The state on the step grid.
    grid: vector.KernelState
    #: The state at the beginning of the segment.
    begin: vector.KernelState
    #: The state that was computed last.
    latest: vector.KernelState


def begun(grid: Floats, grid_ns: int, begin: Floats, begin_ns: int, row: int,
          stop: int) -> NDArray[Any]:
    """
    Return the progress of a motion that continues from a step grid.

    Parameters
    ----------
    grid, begin : array, shape (state_layout.WITH_WHEELS,)
        The states on the grid and at the beginning of the segment.
    grid_ns, begin_ns : int
        The times of these states.
    row, stop : int
        The row in force, and the row at which to stop.

    Returns
    -------
    array of PROGRESS, shape (1,)

    """
    # Pack the bytes, because assigning the fields one by one would take three times as long.
    states, latest = grid.tobytes() + begin.tobytes(), grid.tobytes()
    return np.frombuffer(bytearray(states + latest + _COUNTS.pack(
        grid_ns, begin_ns, row, 0, stop, BUDGET)), PROGRESS)


@internal
def load_method(methods: NDArray[Any]) -> Method:
    """Return the method in an array of METHOD."""
    found = methods[0]
    return Method(found.solver, found.fixed_step, found.closed_form_beyond, found.tolerance,
                  found.angle, found.max_step_ns)


@internal
def load_body(constants: Floats) -> Body:
    """Return a body from its constants, see `body_layout`."""
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
    """Return the states; `latest` is the state on the grid until the loop computes another."""
    grid = state_layout.load(progress[0].grid, 0)
    return GridStates(grid, state_layout.load(progress[0].begin, 0), grid)


@internal
def store_states(reached: GridStates, progress: NDArray[Any]) -> None:
    """Write the states back."""
    state_layout.store(reached.grid, progress[0].grid, 0)
    state_layout.store(reached.begin, progress[0].begin, 0)
    state_layout.store(reached.latest, progress[0].latest, 0)


@inlined
def load_place(progress: NDArray[Any]) -> Place:
    """Return the progress of the loop."""
    found = progress[0]
    return Place(found.grid_ns, found.begin_ns, found.row, found.done)


@internal
def store_place(place: Place, progress: NDArray[Any]) -> None:
    """Write the progress of the loop back to the record."""
    progress[0].grid_ns, progress[0].begin_ns = place.grid_ns, place.begin_ns
    progress[0].row, progress[0].done = place.row, place.done
