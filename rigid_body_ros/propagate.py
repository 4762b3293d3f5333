"""
The time loop: from a start state and a torque log to the motion.

A *segment* runs from one torque change to the next; consecutive samples of zero torque make one
segment, a *coast*. Inside a segment steps end on a grid that begins with the segment and depends
only on the state there and the torque. The motion at any other time is one more step from the
last grid point before it, and nothing later is built on that. So what a caller asks for, and in
which order, changes no number, and `propagate` and `Propagator` agree bit for bit.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rigid_body_ros import euler, so3, taylor
from rigid_body_ros._jit import njit
from rigid_body_ros.body import RigidBody, State
from rigid_body_ros.so3 import Floats
from rigid_body_ros.torque import FRAMES, TorqueLog

SOLVERS = ('auto', 'taylor')
TOLERANCES = (1e-15, 1.0)

_CHUNK = 65536
#: A body at rest has no natural step; 31 years keeps the sum of int64 nanoseconds in range.
_LONGEST_NS = 10 ** 18
_NEVER_NS = np.iinfo(np.int64).max
_NO_TORQUE = np.zeros((1, 3))


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
        A time lies before the start or is no integer, or an option is out of its range.

    """
    options = _Options(solver, tolerance, max_step, torque_timeout)
    times = np.asarray(at)
    if times.ndim != 1 or (times.size and not np.issubdtype(times.dtype, np.integer)):
        raise ValueError('at: expected integer nanoseconds of shape (m,), '
                         f'found {times.dtype} of shape {times.shape}')
    times = times.astype(np.int64)
    if times.size and times.min() < start.time_ns:
        raise ValueError(f'at: expected times from the start, {start.time_ns} ns, on, '
                         f'found {times.min()} ns')
    order = np.argsort(times, kind='stable')
    in_order = np.empty((times.size, 7))
    _run_log(body, start, log or TorqueLog([], []), options, times[order], in_order)
    motion = np.empty_like(in_order)
    motion[order] = in_order
    end = int(times.max()) if times.size else start.time_ns
    return Trajectory(body, times, motion[:, 3:], motion[:, :3],
                      (Model('taylor', start.time_ns, end, options.reason),))


class Propagator:
    """
    The motion under a torque that grows sample by sample.

    A torque fixes the state at its stamp under the torque before it; the state between stamps
    is a prediction that nothing later is built on. A torque that comes late, by less than
    `history`, is put in its place and the later ones are applied again; of equal stamps the
    last to come counts. So the states at the stamps are those of `propagate` with the whole log,
    bit for bit, whatever the order of arrival.

    Parameters
    ----------
    body : RigidBody
    start : State
    solver, tolerance, max_step, torque_timeout
        As for `propagate`.
    history : float, s
        How much older than the newest stamp a torque may be. States further back are forgotten.

    Raises
    ------
    ValueError
        An option is out of its range.

    """

    def __init__(self, body: RigidBody, start: State, *, solver: str = 'auto',
                 tolerance: float = 1e-15, max_step: float | None = None,
                 torque_timeout: float = 0.0, history: float = 1.0) -> None:
        self._options = _Options(solver, tolerance, max_step, torque_timeout)
        if not 0.0 <= history < np.inf:
            raise ValueError(f'history: expected seconds from 0 on, found {history}')
        self._history_ns = max(1, round(history * 1e9))
        self._body = body
        first = _Change(start.time_ns, start.time_ns, _NO_TORQUE, False)
        first.segment = self._segment(start.time_ns, _pack(start), first.torque, False)
        self._changes = [first]
        #: Stamp of the torque in force at the start, if one came.
        self._before_start: int | None = None

    @property
    def earliest_ns(self) -> int:
        """The earliest time that `at` still answers for."""
        return self._changes[0].time_ns

    def apply(self, time_ns: int, torque: ArrayLike, frame: str = 'body') -> bool:
        """
        Hold a torque from a stamp on, up to the next stamp.

        Parameters
        ----------
        time_ns : int
        torque : array, shape (3,), N m
        frame : str
            'body' or 'space'.

        Returns
        -------
        bool
            False if the torque was dropped: it is older than the newest stamp by `history` or
            more.

        Raises
        ------
        ValueError
            The torque is not finite, or the frame is unknown.

        """
        values = np.array(torque, float).reshape(1, -1)
        if values.shape != (1, 3) or not np.all(np.isfinite(values)):
            raise ValueError(f'torque at {time_ns} ns: expected 3 finite numbers, '
                             f'found {values[0].tolist()}')
        if frame not in FRAMES:
            raise ValueError(f"frame: expected 'body' or 'space', found {frame!r}")
        if self._changes[-1].time_ns - time_ns >= self._history_ns:
            return False
        if time_ns <= self._changes[0].time_ns:
            self._apply_before_start(time_ns, values, frame == 'space')
        else:
            self._insert(_Change(time_ns, time_ns, values, frame == 'space'))
        return True

    def at(self, time_ns: int) -> State:
        """
        Return the state at a time under the torques known so far.

        Raises
        ------
        ValueError
            The time lies before the start, or further back than is remembered.

        """
        index = bisect.bisect_right(self._changes, time_ns, key=_time_ns) - 1
        if index < 0:
            raise ValueError(f'expected a time from {self.earliest_ns} ns on, found {time_ns} ns')
        self._resolve(index)
        return _unpack(time_ns, self._active(self._changes[index], time_ns).state_at(time_ns))

    def _apply_before_start(self, time_ns: int, torque: Floats, in_space: bool) -> None:
        # Nothing is forgotten before a stamp is `history` past the start, and a stamp as old as
        # the start is dropped from then on: so the first change is still the start.
        if self._before_start is not None and time_ns < self._before_start:
            return
        self._before_start = time_ns
        start = self._changes[0]
        assert start.segment is not None
        state = start.segment.state_at(start.time_ns)
        timeout = self._options.timeout_ns
        if timeout and time_ns + timeout <= start.time_ns:
            torque, in_space = _NO_TORQUE, False
        self._changes[0] = _Change(start.time_ns, time_ns, torque, in_space)
        self._changes[0].segment = self._segment(start.time_ns, state, torque, in_space)
        self._forget_from(1)

    def _insert(self, change: _Change) -> None:
        index = bisect.bisect_left(self._changes, change.time_ns, key=_time_ns)
        found = index < len(self._changes) and self._changes[index].time_ns == change.time_ns
        self._changes[index:index + found] = [change]
        self._forget_from(index)
        horizon = self._changes[-1].time_ns - self._history_ns
        oldest = bisect.bisect_right(self._changes, horizon, key=_time_ns) - 1
        if oldest > 0:
            self._resolve(oldest)
            del self._changes[:oldest]

    def _forget_from(self, index: int) -> None:
        # From the end: everything before a change without a segment may still have one.
        for change in reversed(self._changes[index:]):
            change.segment = change.silence = None

    def _resolve(self, index: int) -> None:
        """Give every change up to this one its segment."""
        first = index
        while self._changes[first].segment is None:
            first -= 1
        for before, change in zip(self._changes[first:index], self._changes[first + 1:index + 1]):
            active = self._active(before, change.time_ns)
            if active.coasts and not change.torque.any():
                change.segment = active
            else:
                state = active.state_at(change.time_ns)
                change.segment = self._segment(change.time_ns, state, change.torque,
                                               change.in_space)

    def _active(self, change: _Change, time_ns: int) -> _Segment:
        """Return the segment that holds at a time from a change on, before the next change."""
        assert change.segment is not None
        due = change.stamp_ns + self._options.timeout_ns
        if not self._options.timeout_ns or change.segment.coasts or time_ns < due:
            return change.segment
        if change.silence is None:
            state = change.segment.state_at(due)
            change.silence = self._segment(due, state, _NO_TORQUE, False)
        return change.silence

    def _segment(self, start_ns: int, state: Floats, torque: Floats, in_space: bool) -> _Segment:
        return _Segment(self._body, self._options, self._history_ns, start_ns, state, torque,
                        in_space)


@dataclass
class _Change:
    """A torque from a time on; the stamp is earlier than the time only for the start."""

    time_ns: int
    stamp_ns: int
    torque: Floats
    in_space: bool
    segment: _Segment | None = None
    #: The coast that follows when the torque times out.
    silence: _Segment | None = None


def _time_ns(change: _Change) -> int:
    return change.time_ns


class _Segment:
    """The motion from a start on under one held torque, with the grid points reached so far."""

    def __init__(self, body: RigidBody, options: _Options, history_ns: int, start_ns: int,
                 state: Floats, torque: Floats, in_space: bool) -> None:
        self.coasts = not torque.any()
        self._history_ns = history_ns
        self._grid_ns = [start_ns]
        self._states = [state]
        self._arguments = (body._matrices, torque, in_space, start_ns, 1.0,
                           options.tolerance, options.max_step_ns)

    def state_at(self, time_ns: int) -> Floats:
        nearest = bisect.bisect_right(self._grid_ns, time_ns) - 1
        state, out = self._states[nearest].copy(), np.empty(taylor.STATE)
        grid_ns = _move(state, self._grid_ns[nearest], time_ns, *self._arguments,
                        taylor.workspace(), out)
        if grid_ns > self._grid_ns[-1]:
            self._grid_ns.append(grid_ns)
            self._states.append(state)
            self._thin(grid_ns - self._history_ns)
        return out

    def _thin(self, horizon_ns: int) -> None:
        # A late torque asks at most `history` back; the start stays for whoever asks further.
        while len(self._grid_ns) > 2 and self._grid_ns[2] <= horizon_ns:
            del self._grid_ns[1], self._states[1]


class _Options:
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
        if not 0.0 <= torque_timeout < np.inf:
            raise ValueError('torque_timeout: expected seconds from 0 on, '
                             f'found {torque_timeout}')
        self.tolerance = float(tolerance)
        longest = _LONGEST_NS if max_step is None else min(max_step * 1e9, _LONGEST_NS)
        self.max_step_ns = max(1, int(longest))
        self.timeout_ns = round(torque_timeout * 1e9)
        self.reason = 'as asked' if solver == 'taylor' else \
            f'auto: one series for torque and coast, to {tolerance:g} rad per radian turned'


def _pack(state: State) -> Floats:
    return np.concatenate([state.angular_velocity, state.attitude, state._carry])


def _unpack(time_ns: int, packed: Floats) -> State:
    return State(time_ns, packed[3:7], packed[:3], packed[7:])


def _run_log(body: RigidBody, start: State, log: TorqueLog, options: _Options,
             times_ns: NDArray[np.int64], motion: Floats) -> None:
    """Fill w, q (m, 7) at sorted times."""
    starts, samples = _from_start(*log.segments(options.timeout_ns), start.time_ns)
    state, grid_ns, done, coasting = _pack(start), start.time_ns, 0, False
    series = taylor.workspace()
    for first in range(0, len(starts), _CHUNK):
        count = min(_CHUNK, len(starts) - first)
        # One segment more than is run: whether a coast goes on shows in the next one.
        bounds = np.append(starts[first:first + count + 1], _NEVER_NS)[:count + 1]
        rules = log.rules(samples[first:first + count + 1])
        coasts = np.logical_not(np.any(rules.polynomials, axis=(1, 2)))
        joins = np.append(coasts & np.append(coasting, coasts[:-1]), True)
        grid_ns, done = _run(state, grid_ns, done, times_ns, motion, bounds, joins,
                             body._matrices, *rules,
                             options.tolerance, options.max_step_ns, series)
        coasting = bool(coasts[count - 1])


def _from_start(starts: NDArray[np.int64], samples: NDArray[np.intp],
                start_ns: int) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Cut the list of segments so that it begins with the start state."""
    first = np.searchsorted(starts, start_ns, side='right') - 1
    if first < 0:
        return np.append(start_ns, starts), np.append(-1, samples)
    return np.append(start_ns, starts[first + 1:]), samples[first:]


@njit
def _run(state: Floats, grid_ns: int, done: int, times_ns: NDArray[np.int64], motion: Floats,
         bounds: NDArray[np.int64], joins: NDArray[np.bool_], matrices: Floats,
         polynomials: Floats, in_space: NDArray[np.bool_], origins: NDArray[np.int64],
         spans: Floats, tolerance: float, max_step_ns: int, series: Floats) -> tuple[int, int]:
    # Go through the segments in turn; `state` is on the grid, at grid_ns. Returns how far it got.
    out = np.empty(taylor.STATE)
    for m in range(len(bounds) - 1):
        while done < len(times_ns) and times_ns[done] < bounds[m + 1]:
            grid_ns = _move(state, grid_ns, times_ns[done], matrices, polynomials[m],
                            in_space[m], origins[m], spans[m], tolerance, max_step_ns, series,
                            out)
            motion[done] = out[:7]
            done += 1
        if done == len(times_ns):
            break
        if not joins[m + 1]:
            _move(state, grid_ns, bounds[m + 1], matrices, polynomials[m], in_space[m],
                  origins[m], spans[m], tolerance, max_step_ns, series, out)
            state[:] = out
            grid_ns = bounds[m + 1]
    return grid_ns, done


@njit
def _move(state: Floats, grid_ns: int, time_ns: int, matrices: Floats, polynomial: Floats,
          in_space: bool, origin_ns: int, span: float, tolerance: float, max_step_ns: int,
          series: Floats, out: Floats) -> int:
    # Take `state` on to the last grid point before a time, and `out` from there to the time.
    acceleration = taylor.acceleration_bound(polynomial, in_space, matrices)
    torque = polynomial.copy()
    while True:
        seconds = taylor.step_seconds(state, acceleration)
        step_ns = max(1, int(min(seconds * 1e9, max_step_ns)))
        if grid_ns + step_ns > time_ns:
            break
        _local_torque(polynomial, (grid_ns - origin_ns) * 1e-9 / span, step_ns * 1e-9 / span,
                      torque)
        taylor.step(state, step_ns * 1e-9, matrices, torque, in_space, acceleration, tolerance,
                    series)
        grid_ns += step_ns
    out[:] = state
    if time_ns > grid_ns:
        rest_ns = time_ns - grid_ns
        _local_torque(polynomial, (grid_ns - origin_ns) * 1e-9 / span, rest_ns * 1e-9 / span,
                      torque)
        taylor.step(out, rest_ns * 1e-9, matrices, torque, in_space, acceleration, tolerance,
                    series)
    return grid_ns


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


def warm_up() -> None:
    """Compile every kernel, or load what an earlier process compiled."""
    body, start = RigidBody(np.eye(3)), State()
    propagate(body, start, TorqueLog([0], [[1.0, 0.0, 0.0]]), at=[1])
    Propagator(body, start).at(1)
