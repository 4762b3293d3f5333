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

"""Compute how a motion changes with its start and with the parameters of its problem."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import ENTRIES, Floats, symmetric
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.engine import (
    kernels,
    layout,
    MOST_FIELDS,
    motion_layout,
    Rows,
    tangents,
    Terms,
)
from rigid_body_ros.engine.binding import LANES
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.changes import MOMENTUM
from rigid_body_ros.mechanics.fields import UniformField
from rigid_body_ros.mechanics.states import Poses
from rigid_body_ros.propagation import forcing
from rigid_body_ros.propagation.inputs import MotionInputs
from rigid_body_ros.propagation.integration import Integration
from rigid_body_ros.propagation.options import checked_times
from rigid_body_ros.propagation.timeline import no_lags, terms_of
from rigid_body_ros.propagation.trajectory import Derivatives


class _Component(NamedTuple):
    """A component of a parameter: what it changes, and how much each entry of that."""

    name: str
    part: str
    weights: dict[int, float]


def _axes(name: str, part: str, first: int = 0) -> list[_Component]:
    return [_Component(f'{name}.{axis}', part, {first + k: 1.0}) for k, axis in enumerate('xyz')]


#: What parameters change: the start and constants, as rows of `tangents.Tangents`, and the torques
#: of the logs.
_START, _CONSTANTS, _TORQUES = 'start', 'constants', 'torques'
_SIZES = {_START: tangents.SIZE, _CONSTANTS: tangents.CONSTANTS, _TORQUES: forcing.SIZE}
_PARAMETERS = {
    'inertia': [_Component(f'inertia.i{entry}', _CONSTANTS, {tangents.INERTIA + k: 1.0})
                for k, entry in enumerate(ENTRIES)],
    'torque_gain': [_Component('torque_gain', _TORQUES, dict.fromkeys(range(3), 1.0))],
    'torque_gains': _axes('torque_gains', _TORQUES, forcing.GAINS),
    'torque_bias': _axes('torque_bias', _CONSTANTS, tangents.TORQUE),
    'torque_delay': [_Component('torque_delay', _TORQUES, {forcing.DELAY: 1.0})],
    'torque_lag': [_Component('torque_lag', _TORQUES, {forcing.LAG: 1.0})],
    'damping': [_Component(f'damping.d{entry}', _CONSTANTS, dict.fromkeys((
        tangents.DAMPING + 3 * row + column, tangents.DAMPING + 3 * column + row), 1.0))
        for entry, (row, column) in ENTRIES.items()],
    'rotor_momentum': _axes('initial_rotor_momentum', _CONSTANTS, tangents.MOMENTUM),
    'start': [*_axes('initial_attitude', _START, tangents.ROTATION),
              *_axes('initial_angular_velocity', _START, tangents.RATE)],
}
#: The places of the entries of a tensor among its six entries.
_FULL = symmetric(np.arange(6)).astype(int)
#: The names of the components of the start.
START_NAMES = tuple(component.name for component in _PARAMETERS['start'])
_NO_BIAS = np.zeros(3)
_NO_BIAS.flags.writeable = False


def derivatives(problem: MotionInputs, names: Sequence[str], at: ArrayLike) -> Derivatives:
    """
    Return the derivatives of a motion with respect to parameters; see `Problem.derivatives`.

    Raises
    ------
    ValueError
        A name is unknown or given twice, no name is given, the problem has what has no derivatives
        yet, a time is before the start, or the body turns too fast.

    """
    if not names:
        raise ValueError('derivatives: expected at least one name, found none')
    return with_derivatives(problem, names, at)[1]


def with_derivatives(problem: MotionInputs, names: Sequence[str], at: ArrayLike,
                     bias: Floats = _NO_BIAS) -> tuple[Poses, Derivatives]:
    """
    Return a motion and its derivatives.

    `bias`, N m, shape (3,), is a torque in body axes that begins with the motion, and that gains,
    delay and lag do not change.
    """
    # Tangents with torques come last, because others have no derivatives of the torques.
    components = sorted(_components(problem, names), key=lambda each: each.part == _TORQUES)
    if problem.is_coupled:
        raise ValueError('derivatives: expected a problem without wheels with friction or a '
                         'largest speed, which have no derivatives yet')
    times_ns, places = np.unique(checked_times(at, problem.start.time_ns)[0], return_inverse=True)
    seeds = {part: np.zeros((len(components), size)) for part, size in _SIZES.items()}
    for k, component in enumerate(components):
        seeds[component.part][k, [*component.weights]] = [*component.weights.values()]
    parts = _Tangents(problem, seeds, bias).advance(times_ns)
    attitude, rates, by_names = (np.concatenate(each)[places] for each in zip(*parts))
    return Poses(attitude, rates), Derivatives(
        tuple(component.name for component in components),
        by_names[:, tangents.ROTATION:], by_names[:, :tangents.ROTATION])


def _components(problem: MotionInputs, names: Sequence[str]) -> list[_Component]:
    components = {**_PARAMETERS, **_moments(problem)}
    for name in names:
        if name not in components:
            raise ValueError(f'derivatives: expected names among {", ".join(components)}, found '
                             f'{name!r}')
        if list(names).count(name) > 1:
            raise ValueError(f'derivatives: expected each name once, found {name!r} twice')
    return [component for name in names for component in components[name]]


def _moments(problem: MotionInputs) -> dict[str, list[_Component]]:
    """Return the components of the moments of the named uniform fields; see `fields.packed`."""
    uniform = [field for field in problem.fields if isinstance(field, UniformField)]
    # With many fields, each acts by its components along three fields.
    weights = np.eye(len(uniform)) if len(uniform) <= MOST_FIELDS else \
        np.array([field.field for field in uniform])
    return {f'{field.name}.moment': [
        _Component(f'{field.name}.moment.{axis}', _CONSTANTS, {
            tangents.MOMENTS + 3 * i + k: float(weight) for i, weight in enumerate(row)})
        for k, axis in enumerate('xyz')] for field, row in zip(uniform, weights) if field.name}


class _Tangents:
    """
    The tangents of a motion, computed piece by piece.

    Parameters
    ----------
    problem : MotionInputs
    seeds : dict of str to array, shape (p, ...)
        What each of p tangents changes, for each part of `_SIZES`.
    bias : array, shape (3,), N m
        See `with_derivatives`.

    """

    def __init__(self, problem: MotionInputs, seeds: dict[str, Floats], bias: Floats) -> None:
        # Only the series has tangents.
        self._motion = motion = Integration(problem.solved_by())
        self._bias, self._seeds = bias, seeds
        start, constants = seeds[_START], seeds[_CONSTANTS]
        carrier = motion._carrier
        if problem.changes and problem.changes.in_force(problem.start.time_ns) >= 0:
            self._forget_body()
        if problem.named_wheels:  # they turn with the body when the motion starts
            axial = problem.body_at(problem.start.time_ns).inertia - carrier.inertia
            constants[:, tangents.MOMENTUM:tangents.DAMPING] += np.sum(
                start[:, None, tangents.RATE:tangents.ROTATION] * axial, axis=2)
        #: The tangents at the latest time, before and after a jump of the torque at this time.
        self._arrived = _in_lanes(start)
        if (delayed := seeds[_TORQUES][:, forcing.DELAY:].any(axis=1)).any():
            start[delayed, tangents.RATE:tangents.ROTATION] += _quotient(
                carrier, _impulse(problem) + bias)  # the bias is not delayed
        self._latest = _in_lanes(start)

    def advance(self, times_ns: NDArray[np.int64]) -> Iterator[tuple[Floats, Floats, Floats]]:
        """Generate attitudes, angular velocities and tangents at ascending times."""
        motion, changes = self._motion, self._motion.problem.changes
        while True:
            next_ns = changes.next_ns(motion._end_ns) if changes else NEVER_NS
            count = int(times_ns.searchsorted(next_ns))
            if count == len(times_ns):
                yield self._piece(times_ns)
                return
            yield tuple(each[:count] for each in self._piece(  # type: ignore[misc]
                np.append(times_ns[:count], next_ns)))
            times_ns = times_ns[count:]
            motion._end_ns = next_ns
            self._change(next_ns)

    def _change(self, time_ns: int) -> None:
        """Continue with the body that replaces the body at a given time."""
        motion, changes = self._motion, self._motion.problem.changes
        assert changes
        before, rates = motion._carrier, motion._progress['latest'][0, :3].copy()
        motion._change(changes.bodies[changes.in_force(time_ns)])
        latest, arrived = _rates(self._latest), _rates(self._arrived)
        jump = before.angular_momentum(latest - arrived)
        if changes.keep == MOMENTUM:
            seeds = self._seeds[_CONSTANTS][:, tangents.INERTIA:tangents.MOMENTUM]
            change = _in_lanes(np.sum(seeds[:, _FULL] * rates, axis=2)).reshape(-1, 3, LANES)
            arrived[:] = _quotient(motion._carrier, before.angular_momentum(arrived)
                                   + change.swapaxes(1, 2))
        latest[:] = arrived + _quotient(motion._carrier, jump)
        self._forget_body()

    def _forget_body(self) -> None:
        """Forget the derivatives of constants of the first body."""
        self._seeds[_CONSTANTS][:, tangents.INERTIA:tangents.MOMENTUM] = 0.0
        self._seeds[_CONSTANTS][:, tangents.DAMPING:tangents.TORQUE] = 0.0

    def _piece(self, times_ns: NDArray[np.int64]) -> tuple[Floats, Floats, Floats]:
        """Return attitudes, angular velocities and tangents while the body is the same."""
        motion, seeds = self._motion, self._seeds
        timeline, progress = motion._timeline, motion._progress
        constants = _in_lanes(seeds[_CONSTANTS])
        has_constants = np.asarray(constants.reshape(-1, tangents.CONSTANTS * LANES).any(axis=1))
        requested = np.zeros((len(times_ns), *self._latest.shape))
        states = motion_layout.allocate(len(times_ns))
        for first, end, rows in timeline.chunks(progress['row'], len(timeline.times_ns)):
            rows = _with_terms(rows)
            acting = self._forcing(rows)
            work = np.empty((tangents.WORKSPACE + tangents.OF_VECTOR * len(acting.links), LANES))
            progress['row'] -= first
            progress['stop'] = end - first
            while result := kernels.run_tangents(
                    progress, tangents.RequestedTangents(times_ns, requested, states),
                    _packed(rows), motion._carrier._constants, motion.problem.options.method,
                    self._latest, tangents.Seeds(constants, has_constants, acting), work):
                if result == layout.TOO_FAST:
                    raise motion.problem.options.too_fast(int(progress['grid_ns'][0]))
                progress['budget'] = layout.BUDGET
            progress['row'] += first
        requested[times_ns == motion._end_ns] = self._arrived
        self._arrived = requested[-1:]
        groups = requested.reshape(len(times_ns), len(has_constants), tangents.SIZE, LANES)
        columns = groups.swapaxes(1, 2).reshape(len(times_ns), tangents.SIZE,
                                                has_constants.size * LANES)
        return (motion_layout.attitude(states), motion_layout.angular_velocity(states),
                columns[..., :len(seeds[_START])])

    def _forcing(self, rows: Rows) -> tangents.Forcing:
        """Return the derivatives of the torques of rows, from the first group that has any."""
        seeds = self._seeds[_TORQUES]
        if not seeds.any():
            none = np.empty((0, LANES))
            return tangents.Forcing(none, none, np.empty((0, 3)))
        seeds = seeds[seeds.any(axis=1).argmax() // LANES * LANES:]
        vectors, impulses, links = forcing.forcing(
            rows, self._motion._others.lagging, self._bias, seeds)
        return tangents.Forcing(_in_lanes(vectors), _in_lanes(impulses), links)


def _impulse(problem: MotionInputs) -> Floats:
    """Return by how much the torque of the logs is larger before the start than after it, N m."""
    start_ns, total = problem.start.time_ns, np.zeros(3)
    actuators = problem.actuators or [None] * len(problem.logs)
    for log, actuator in zip(problem.acting_logs, actuators):
        changes_ns, _ = log.segments(problem.options.timeout_ns)
        if (actuator and actuator.expiry_ns) or start_ns not in changes_ns:
            continue  # the torque does not jump
        torques, in_space = log.at(np.array([start_ns - 1, start_ns]),
                                   problem.options.timeout_ns)
        to_body = so3.conjugate(problem.start.attitude)
        before, after = np.where(in_space[:, None], so3.rotate(to_body, torques), torques)
        total += before - after
    return total


def _quotient(body: RigidBody, momenta: Floats) -> Floats:
    """Return J^-1 times vectors, shape (..., 3), without BLAS, which depends on the processor."""
    return body.angular_acceleration(np.zeros(3), momenta)


def _rates(lanes: Floats) -> Floats:
    """Return a view of the derivatives of the rates in tangents, shape (g, LANES, 3)."""
    return lanes.reshape(-1, tangents.SIZE, LANES)[
        :, tangents.RATE:tangents.ROTATION].swapaxes(1, 2)


def _in_lanes(values: Floats) -> Floats:
    """Return an array of shape (components, ...) as groups of lanes, shape (groups n, LANES)."""
    if not values.size:
        return np.empty((0, LANES))
    padded = np.zeros((-(-len(values) // LANES), LANES, values[0].size))
    padded.reshape(-1, values[0].size)[:len(values)] = values.reshape(len(values), -1)
    return np.ascontiguousarray(padded.swapaxes(1, 2)).reshape(-1, LANES)


def _with_terms(rows: Rows) -> Rows:
    """Return the rows with torques on rotors and in space axes, and with lags."""
    none = np.zeros((len(rows.times_ns), rows.torques.shape[1] // 2 + 1, 3))
    terms = rows.terms or Terms(np.zeros((1, 2, 3)))
    return rows._replace(terms=terms._replace(
        motors=none if terms.motors is None else terms.motors,
        space=none if terms.space is None else terms.space,
        lags=terms.lags or no_lags(len(none))))


def _packed(rows: Rows) -> Rows:
    """Return the rows as the kernel takes them: with fields and lags, or with neither."""
    terms = rows.terms
    assert terms is not None
    assert terms.motors is not None
    assert terms.space is not None
    lags = terms.lags
    if terms.fields is None and lags is not None and not len(lags.time_constants):
        return rows._replace(terms=terms._replace(lags=None))
    return rows._replace(terms=terms_of(
        terms.momentum, terms.motors, terms.space, terms.fields, lags, None))
