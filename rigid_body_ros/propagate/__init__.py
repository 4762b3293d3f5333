"""
The time loop: from a start state and a torque log to the motion.

A *segment* runs from one torque change to the next; consecutive samples of zero torque make one
segment, a *coast*. Inside a segment steps end on a grid that begins with the segment and depends
only on the state there and the torque. The motion at any other time is one more step from the
last grid point before it, and nothing later is built on that. So what a caller asks for, and in
which order, changes no number, and `propagate` and `Propagator` agree bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rigid_body_ros import euler, so3, taylor
from rigid_body_ros.body import RigidBody, State
from rigid_body_ros.propagate.loop import (
    BUDGET,
    LONGEST,
    NEVER_NS,
    SOLVERS,
    TOLERANCES,
    Options,
    check_speed,
    pack,
    run,
)
from rigid_body_ros.propagate.propagator import Propagator
from rigid_body_ros.so3 import Floats
from rigid_body_ros.torque import TorqueLog

__all__ = ['LONGEST', 'SOLVERS', 'TOLERANCES', 'Model', 'Propagator', 'Trajectory', 'propagate',
           'warm_up']

#: Segments whose torques are worked out at a time.
_CHUNK = 65536


class Model(NamedTuple):
    """What answered for a span of time, and why."""

    solver: str
    start_ns: int
    end_ns: int
    reason: str


@dataclass(frozen=True, eq=False)
class Trajectory:
    """
    The motion at the times that were asked for.

    Attributes
    ----------
    body : RigidBody
    times_ns : array of int64, shape (m,)
    attitude : array, shape (m, 4)
        x y z w, body to space; the continuous lift from the start, never flipped.
    angular_velocity : array, shape (m, 3), rad/s, body axes
    models : tuple of Model

    """

    body: RigidBody
    times_ns: NDArray[np.int64]
    attitude: Floats
    angular_velocity: Floats
    models: tuple[Model, ...]

    def euler_angles(self, sequence: str = 'ZXZ', continuous: bool = False) -> Floats:
        """Return Euler angles, rad, shape (m, 3); see `euler.from_quaternion`, `euler.unwrap`."""
        angles = euler.from_quaternion(self.attitude, sequence)
        return euler.unwrap(angles, sequence) if continuous else angles

    def degenerate(self, sequence: str = 'ZXZ') -> NDArray[np.bool_]:
        """Return where two of the Euler angles are not determined apart, shape (m,)."""
        return euler.degenerate(euler.from_quaternion(self.attitude, sequence), sequence)

    @cached_property
    def angular_momentum_space(self) -> Floats:
        """Angular momentum in space axes, N m s, shape (m, 3)."""
        return so3.rotate(self.attitude, self.body.angular_momentum(self.angular_velocity))

    @cached_property
    def kinetic_energy(self) -> Floats:
        """Kinetic energy, J, shape (m,)."""
        return self.body.kinetic_energy(self.angular_velocity)


def propagate(body: RigidBody, start: State, log: TorqueLog | None = None, *, at: ArrayLike,
              solver: str = 'auto', tolerance: float = 1e-15, max_step: float | None = None,
              torque_timeout: float = 0.0) -> Trajectory:
    """
    Integrate Euler's equations under a torque log.

    Parameters
    ----------
    body : RigidBody
    start : State
    log : TorqueLog, optional
        None means torque-free. Before its first sample the torque is zero.
    at : array of int, shape (m,), ns
        Times to return, in any order, none before the start.
    solver : str
        'taylor', or 'auto' for the least model that the scene needs.
    tolerance : float
        Attitude error per radian turned, 1e-15 to 1.
    max_step : float, optional, s
        Upper limit of a step.
    torque_timeout : float, s
        If positive, the torque is zero from this long after a sample to the next one.

    Returns
    -------
    Trajectory

    Raises
    ------
    ValueError
        A time lies before the start or is no integer, an option is out of its range, or the
        torques bring the body beyond 1e9 rad/s.

    """
    options = Options(solver, tolerance, max_step, torque_timeout)
    times = np.asarray(at)
    if times.ndim != 1 or (times.size and not np.issubdtype(times.dtype, np.integer)):
        raise ValueError('at: expected integer nanoseconds of shape (m,), '
                         f'found {times.dtype} of shape {times.shape}')
    times = times.astype(np.int64)
    for time_ns in (times.min(), times.max()) if times.size else ():
        if not start.time_ns <= time_ns < NEVER_NS:
            raise ValueError(f'at: expected times from the start, {start.time_ns} ns, on, '
                             f'found {time_ns} ns')
    order = np.argsort(times, kind='stable')
    in_order = np.empty((times.size, 7))
    _run_log(body, start, log or TorqueLog([], []), options, times[order], in_order)
    for row in np.flatnonzero(~np.isfinite(in_order).all(axis=1))[:1]:
        check_speed(np.full(3, np.inf), int(times[order][row]))
    motion = np.empty_like(in_order)
    motion[order] = in_order
    end = int(times.max()) if times.size else start.time_ns
    return Trajectory(body, times, motion[:, 3:], motion[:, :3],
                      (Model('taylor', start.time_ns, end, options.reason),))


def _run_log(body: RigidBody, start: State, log: TorqueLog, options: Options,
             times_ns: NDArray[np.int64], motion: Floats) -> None:
    """Fill w, q (m, 7) at sorted times."""
    starts, samples = _from_start(*log.segments(options.timeout_ns), start.time_ns)
    state, grid_ns, done, coasting = pack(start), start.time_ns, 0, False
    series = taylor.workspace()
    for first in range(0, len(starts), _CHUNK):
        count = min(_CHUNK, len(starts) - first)
        # One segment more than is run: whether a coast goes on shows in the next one.
        bounds = np.append(starts[first:first + count + 1], NEVER_NS)[:count + 1]
        rules = log.rules(samples[first:first + count + 1])
        coasts = np.logical_not(np.any(rules.polynomials, axis=(1, 2)))
        joins = np.append(coasts & np.append(coasting, coasts[:-1]), True)
        segment = 0
        while segment < count and done < len(times_ns):
            grid_ns, done, segment = run(
                state, grid_ns, done, segment, times_ns, motion, bounds, joins, body._matrices,
                *rules, options.tolerance, options.max_step_ns, series, BUDGET)
            check_speed(state, grid_ns)
        coasting = bool(coasts[count - 1])


def _from_start(starts: NDArray[np.int64], samples: NDArray[np.intp],
                start_ns: int) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Cut the list of segments so that it begins with the start state."""
    first = np.searchsorted(starts, start_ns, side='right') - 1
    if first < 0:
        return np.append(start_ns, starts), np.append(-1, samples)
    return np.append(start_ns, starts[first + 1:]), samples[first:]


def warm_up() -> None:
    """Compile every kernel, or load what an earlier process compiled."""
    body, start = RigidBody(np.eye(3)), State()
    propagate(body, start, TorqueLog([0], [[1.0, 0.0, 0.0]]), at=[1])
    Propagator(body, start).at(1)
