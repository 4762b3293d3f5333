"""The steps between two torque changes, and what they are set to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rigid_body_ros import taylor
from rigid_body_ros._jit import njit
from rigid_body_ros.body import State
from rigid_body_ros.so3 import Floats

SOLVERS = ('auto', 'taylor')
TOLERANCES = (1e-15, 1.0)
#: rad/s; the series converges in a step of a nanosecond up to here.
FASTEST = 1e9
#: Later than any time that can be asked for.
NEVER_NS = 2 ** 63 - 1
#: Seconds that fit int64 nanoseconds at any epoch.
LONGEST = 1e9

#: A body at rest has no natural step.
_LONGEST_NS = 10 ** 18
#: Steps, some 50 ms of work, after which a kernel returns, so that signals are heard.
BUDGET = 20_000


class Options:
    """The options of `propagate` and `Propagator`, checked, in the units of the kernels."""

    def __init__(self, solver: str, tolerance: float, max_step: float | None,
                 torque_timeout: float) -> None:
        if solver not in SOLVERS:
            raise ValueError(f'solver: expected one of {", ".join(SOLVERS)}, found {solver!r}')
        if not TOLERANCES[0] <= tolerance <= TOLERANCES[1]:
            raise ValueError('tolerance: expected an attitude error per radian turned from '
                             f'{TOLERANCES[0]:g} to {TOLERANCES[1]:g}, found {tolerance}')
        if max_step is not None and not max_step > 0.0:
            raise ValueError(f'max_step: expected seconds greater than zero, found {max_step}')
        self.tolerance = float(tolerance)
        longest = _LONGEST_NS if max_step is None else min(max_step * 1e9, _LONGEST_NS)
        self.max_step_ns = max(1, int(longest))
        self.timeout_ns = duration_ns(torque_timeout, 'torque_timeout')
        self.reason = 'as asked' if solver == 'taylor' else \
            f'auto: one series for torque and coast, to {tolerance:g} rad per radian turned'


def duration_ns(seconds: float, name: str) -> int:
    """Return a duration as integer nanoseconds, or raise ValueError with its name."""
    if not 0.0 <= seconds <= LONGEST:
        raise ValueError(f'{name}: expected seconds from 0 to {LONGEST:g}, found {seconds}')
    return round(seconds * 1e9)


def check_speed(state: Floats, time_ns: int) -> None:
    """Raise ValueError where a nanosecond, the shortest step, does not resolve the motion."""
    if not taylor.speed(state) <= FASTEST:  # nor NaN
        raise ValueError(f'at {time_ns} ns the body turns faster than {FASTEST:g} rad/s: expected '
                         'a torque and an inertia in N m and kg m^2 that do not lead there')


def pack(state: State) -> Floats:
    """Return a state as the kernels want it, shape (14,)."""
    return np.concatenate([state.angular_velocity, state.attitude, state._carry])


def unpack(time_ns: int, packed: Floats) -> State:
    """Return the state of the kernels, shape (14,), at a time."""
    return State(time_ns, packed[3:7], packed[:3], packed[7:])


@njit
def run(state: Floats, grid_ns: int, done: int, segment: int, times_ns: NDArray[np.int64],
        motion: Floats, bounds: NDArray[np.int64], joins: NDArray[np.bool_], matrices: Floats,
        polynomials: Floats, in_space: NDArray[np.bool_], origins: NDArray[np.int64],
        spans: Floats, tolerance: float, max_step_ns: int, series: Floats,
        budget: int) -> tuple[int, int, int]:
    """
    Go through segments in turn and fill w, q at sorted times.

    `state` is on the grid of a segment, at grid_ns; `done` times are filled already. Where the
    next segment joins (a coast goes on) nothing is committed at its bound. Returns grid_ns,
    done and segment: where it got until all was done or the budget of steps was used up.
    """
    out = np.empty(taylor.STATE)
    while segment < len(bounds) - 1 and done < len(times_ns):
        asked = times_ns[done] < bounds[segment + 1]
        if asked or not joins[segment + 1]:
            time_ns = times_ns[done] if asked else bounds[segment + 1]
            grid_ns, budget, reached = move(
                state, grid_ns, time_ns, matrices, polynomials[segment], in_space[segment],
                origins[segment], spans[segment], tolerance, max_step_ns, series, out, budget)
            if not reached:
                break
            if asked:
                motion[done] = out[:7]
            else:
                state[:] = out
                grid_ns = time_ns
        if asked:
            done += 1
        else:
            segment += 1
    return grid_ns, done, segment


@njit
def move(state: Floats, grid_ns: int, time_ns: int, matrices: Floats, polynomial: Floats,
         in_space: bool, origin_ns: int, span: float, tolerance: float, max_step_ns: int,
         series: Floats, out: Floats, budget: int) -> tuple[int, int, bool]:
    """
    Take `state` on to the last grid point before a time, and `out` from there to the time.

    Returns the time of the grid point, what is left of the budget of steps, and whether the
    time was reached: if not, `out` is not filled, and the next call goes on from there.
    """
    acceleration = taylor.acceleration_bound(polynomial, in_space, matrices)
    torque = polynomial.copy()
    while True:
        seconds = taylor.step_seconds(state, acceleration)
        step_ns = max(1, int(min(seconds * 1e9, max_step_ns)))
        if budget <= 0:
            return grid_ns, budget, False
        if step_ns > time_ns - grid_ns:
            break
        _local_torque(polynomial, (grid_ns - origin_ns) * 1e-9 / span, step_ns * 1e-9 / span,
                      torque)
        taylor.step(state, step_ns * 1e-9, matrices, torque, in_space, acceleration, tolerance,
                    series)
        grid_ns += step_ns
        budget -= 1
    out[:] = state
    if time_ns > grid_ns:
        rest_ns = time_ns - grid_ns
        _local_torque(polynomial, (grid_ns - origin_ns) * 1e-9 / span, rest_ns * 1e-9 / span,
                      torque)
        taylor.step(out, rest_ns * 1e-9, matrices, torque, in_space, acceleration, tolerance,
                    series)
    return grid_ns, budget - 1, True


@njit
def _local_torque(polynomial: Floats, offset: float, ratio: float, out: Floats) -> None:
    # From p(s) to p(offset + ratio s), by repeated synthetic division (a Taylor shift).
    degree = polynomial.shape[0] - 1
    out[:] = polynomial
    for i in range(degree):
        for k in range(degree - 1, i - 1, -1):
            out[k] += offset * out[k + 1]
    scale = 1.0
    for k in range(1, degree + 1):
        scale *= ratio
        out[k] *= scale
