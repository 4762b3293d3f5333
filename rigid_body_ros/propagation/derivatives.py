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

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import ENTRIES, Floats
from rigid_body_ros.engine import kernels, layout, Rows, tangents, Terms
from rigid_body_ros.engine.binding import LANES
from rigid_body_ros.propagation.inputs import MotionInputs
from rigid_body_ros.propagation.integration import Integration
from rigid_body_ros.propagation.options import checked_times


class Derivatives(NamedTuple):
    """
    The derivatives of a motion with respect to parameters of its problem.

    Attributes
    ----------
    names : tuple of str
        The components of the parameters, such as 'inertia.ixx', as `attitude_identify` names them.
    attitude : array, shape (m, 3, p), rad per unit of the parameter
        The derivatives of the attitude at m times, each as a rotation vector in body axes.
    angular_velocity : array, shape (m, 3, p), rad/s per unit of the parameter
        The derivatives of the angular velocity in body axes.

    """

    names: tuple[str, ...]
    attitude: Floats
    angular_velocity: Floats


class _Component(NamedTuple):
    """A component of a parameter: what it changes, and which entries of that."""

    name: str
    part: str
    places: tuple[int, ...]


def _axes(name: str, part: str, first: int = 0) -> list[_Component]:
    return [_Component(f'{name}.{axis}', part, (first + k,)) for k, axis in enumerate('xyz')]


#: What parameters change: the start and constants, as rows of `tangents.Tangents`, and the torque,
#: as a multiple of the torque along each body axis.
_START, _CONSTANTS, _GAINS = 'start', 'constants', 'gains'
_SIZES = {_START: tangents.SIZE, _CONSTANTS: tangents.CONSTANTS, _GAINS: 3}
_PARAMETERS = {
    'inertia': [_Component(f'inertia.i{entry}', _CONSTANTS, (tangents.INERTIA + k,))
                for k, entry in enumerate(ENTRIES)],
    'torque_gain': [_Component('torque_gain', _GAINS, (0, 1, 2))],
    'torque_gains': _axes('torque_gains', _GAINS),
    'torque_bias': _axes('torque_bias', _CONSTANTS, tangents.TORQUE),
    'damping': [_Component(f'damping.d{entry}', _CONSTANTS, (
        tangents.DAMPING + 3 * row + column, tangents.DAMPING + 3 * column + row))
        for entry, (row, column) in ENTRIES.items()],
    'rotor_momentum': _axes('initial_rotor_momentum', _CONSTANTS, tangents.MOMENTUM),
    'start': [*_axes('initial_attitude', _START, tangents.ROTATION),
              *_axes('initial_angular_velocity', _START, tangents.RATE)],
}


def derivatives(problem: MotionInputs, names: Sequence[str], at: ArrayLike) -> Derivatives:
    """
    Return the derivatives of a motion with respect to parameters; see `Problem.derivatives`.

    Raises
    ------
    ValueError
        A name is unknown or given twice, no name is given, the problem has what has no derivatives
        yet, a time is before the start, or the body turns too fast.

    """
    # Tangents with gains come last, because others have no derivatives of the torques.
    components = sorted(_components(names), key=lambda component: component.part == _GAINS)
    _check(problem, names)
    times_ns, ascends, _ = checked_times(at, problem.start.time_ns)
    order = slice(None) if ascends else np.argsort(times_ns, kind='stable')
    seeds = {part: np.zeros((len(components), size)) for part, size in _SIZES.items()}
    for k, component in enumerate(components):
        seeds[component.part][k, component.places] = 1.0
    found = np.empty((len(times_ns), tangents.SIZE, len(components)))
    found[order] = _computed(problem, seeds, times_ns[order])
    return Derivatives(tuple(component.name for component in components),
                       found[:, tangents.ROTATION:], found[:, :tangents.ROTATION])


def _components(names: Sequence[str]) -> list[_Component]:
    for name in names:
        if name not in _PARAMETERS:
            raise ValueError(f'derivatives: expected names among {", ".join(_PARAMETERS)}, found '
                             f'{name!r}')
        if list(names).count(name) > 1:
            raise ValueError(f'derivatives: expected each name once, found {name!r} twice')
    if not names:
        raise ValueError('derivatives: expected at least one name, found none')
    return [component for name in names for component in _PARAMETERS[name]]


def _check(problem: MotionInputs, names: Sequence[str]) -> None:
    """Raise ValueError if the problem has what has no derivatives yet."""
    has_gains = any(name.startswith('torque_gain') for name in names)
    wheels = problem.named_wheels
    for text, has in (
            ('fields', problem.fields), ('bodies that change', problem.changes),
            ('wheels with friction or a largest speed', problem.has_friction or (
                wheels and wheels.is_limited)),
            ('torques that lag', problem.lagging()),
            ('gains of actuators', has_gains and problem.actuators),
            ('gains of torques in space axes', has_gains and any(
                log.in_space.any() for log in problem.logs))):
        if has:
            raise ValueError(f'derivatives: expected a problem without {text}, which have no '
                             'derivatives yet')


def _computed(problem: MotionInputs, seeds: dict[str, Floats],
              times_ns: NDArray[np.int64]) -> Floats:
    """Return the tangents at ascending times, shape (m, tangents.SIZE, components)."""
    integration = Integration(problem.solved_by())  # only the series has tangents
    timeline, progress = integration._timeline, integration._progress
    carrier = integration._carrier
    if problem.named_wheels:  # they turn with the body when the motion starts
        axial = problem.body_at(problem.start.time_ns).inertia - carrier.inertia
        seeds[_CONSTANTS][:, tangents.MOMENTUM:tangents.DAMPING] += seeds[_START][
            :, tangents.RATE:tangents.ROTATION] @ axial
    latest, constants = _in_lanes(seeds[_START]), _in_lanes(seeds[_CONSTANTS])
    has_constants = np.asarray(constants.reshape(-1, tangents.CONSTANTS * LANES).any(axis=1))
    requested = np.zeros((len(times_ns), *latest.shape))
    work = np.empty((tangents.WORKSPACE, LANES))
    for first, end, rows in timeline.chunks(progress['row'], len(timeline.times_ns)):
        rows = _with_terms(rows)
        torques = _torques(rows, seeds[_GAINS])
        progress['row'] -= first
        progress['stop'] = end - first
        while result := kernels.run_tangents(
                progress, times_ns, rows, carrier._constants,
                integration.problem.options.method, latest, constants, has_constants, torques,
                requested, work):
            if result == layout.TOO_FAST:
                raise problem.options.too_fast(int(progress['grid_ns'][0]))
            progress['budget'] = layout.BUDGET
        progress['row'] += first
    groups = requested.reshape(len(times_ns), len(has_constants), tangents.SIZE, LANES)
    found = groups.swapaxes(1, 2).reshape(len(times_ns), tangents.SIZE, has_constants.size * LANES)
    return found[..., :len(seeds[_START])]


def _in_lanes(values: Floats) -> Floats:
    """Return an array of shape (components, n) as groups of lanes, shape (groups n, LANES)."""
    count, size = values.shape
    padded = np.zeros((-(-count // LANES), LANES, size))
    padded.reshape(-1, size)[:count] = values
    return np.ascontiguousarray(padded.swapaxes(1, 2)).reshape(-1, LANES)


def _with_terms(rows: Rows) -> Rows:
    """Return the rows with torques on rotors and in space axes, as the kernel takes them."""
    none = np.zeros((len(rows.times_ns), rows.torques.shape[1] // 2 + 1, 3))
    momentum, motors, space, *_ = rows.terms or Terms(np.zeros((1, 2, 3)))
    return rows._replace(terms=Terms(momentum, none if motors is None else motors,
                                     none if space is None else space))


def _torques(rows: Rows, gains: Floats) -> Floats:
    """Return the derivatives of the torques of rows, as `tangents.Tangents` takes them."""
    assert rows.terms is not None
    assert rows.terms.motors is not None
    if not gains.any():
        return np.empty((0, LANES))
    on_body = rows.torques[:, :rows.torques.shape[1] // 2 + 1] + rows.terms.motors
    gains = gains[gains.any(axis=1).argmax() // LANES * LANES:]
    return _in_lanes((gains[:, None, None] * on_body).reshape(len(gains), -1))
