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

"""Run i of an ensemble: what is drawn, applied and propagated, and what is read back from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from rigid_body_ros import so3
from rigid_body_ros.body import RigidBody
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, reason
from rigid_body_ros.ensemble.dispersions import (
    ATTITUDE,
    Dispersion,
    draws,
    INERTIA,
    NOISE,
    stream,
    UNITS,
)
from rigid_body_ros.propagation import propagate, Trajectory
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.scene import Scene
from rigid_body_ros.state import State
from rigid_body_ros.torque import TorqueLog

#: The entries of a symmetric tensor, in the order of the columns.
_ENTRIES = {'xx': (0, 0), 'yy': (1, 1), 'zz': (2, 2), 'xy': (0, 1), 'xz': (0, 2), 'yz': (1, 2)}
_START = {**{f'inertia.i{entry}': 'kg m^2' for entry in _ENTRIES},
          **{f'initial_attitude.{axis}': '' for axis in 'xyzw'},
          **{f'initial_angular_velocity.{axis}': 'rad/s' for axis in 'xyz'}}
ANGLE = 'angle_from_nominal'
_END = {**{f'attitude.{axis}': '' for axis in 'xyzw'},
        **{f'angular_velocity.{axis}': 'rad/s' for axis in 'xyz'}, ANGLE: 'rad'}


@dataclass(frozen=True, eq=False)
class Applied:
    """
    What acts in a run.

    Attributes
    ----------
    body : RigidBody
    start : State
    logs : tuple of TorqueLog
        The recorded torques times the gain, plus noise, later by the clock offset.
    bias : TorqueLog, optional
        The constant torque that adds to them.
    wheels : TorqueLog, optional
    torque_gain : float
    clock_offset_ns : int

    """

    body: RigidBody
    start: State
    logs: tuple[TorqueLog, ...]
    bias: TorqueLog | None
    wheels: TorqueLog | None
    torque_gain: float = 1.0
    clock_offset_ns: int = 0

    def values(self) -> dict[str, float]:
        """Return the values of all columns that describe the run, and of `UNITS`."""
        bias = np.zeros(3) if self.bias is None else self.bias.torques[0]
        return {**_entries('inertia.i', self.body.inertia),
                **_entries('damping.d', self.body.damping),
                **_components('initial_attitude', self.start.attitude),
                **_components('initial_angular_velocity', self.start.angular_velocity),
                **_components('initial_rotor_momentum', self.start.rotor_momentum),
                **_components('torque_bias', bias), 'torque_gain': self.torque_gain,
                'clock_offset': self.clock_offset_ns / 1e9}


@dataclass(frozen=True, eq=False)
class Ensemble:
    """
    Runs with dispersed parameters; run i is a function of these attributes and of i.

    Attributes
    ----------
    scene : Scene
    start : State
        The nominal initial state, with its time.
    logs : tuple of TorqueLog
        The recorded torques, which add up.
    wheels : TorqueLog or None
        Torque on the rotors.
    end_ns : int, ns
        End of every run.
    dispersions : tuple of Dispersion
    seed : int

    Raises
    ------
    InputError
        A dispersion has no effect: it is relative to zero, or disperses torques of which there
        are none.

    """

    scene: Scene
    start: State
    logs: tuple[TorqueLog, ...]
    wheels: TorqueLog | None
    end_ns: int
    dispersions: tuple[Dispersion, ...]
    seed: int

    def __post_init__(self) -> None:
        nominal = self.nominal.values()
        for one in self.dispersions:
            if one.relative and nominal[one.key] == 0.0:
                raise InputError(f'{one.key}: relative: expected a nominal value other than 0')
            if one.key in ('torque_gain', 'clock_offset', NOISE) and not self.logs:
                raise InputError(f'{one.key}: expected a recording of torques, found none')

    @cached_property
    def nominal(self) -> Applied:
        """Return what acts without any dispersion."""
        return Applied(self.scene.body, self.start, self.logs, None, self.wheels)

    @cached_property
    def nominal_attitude(self) -> Floats:
        """Return the final attitude without any dispersion."""
        return self.motion(self.nominal).attitude[0]

    @cached_property
    def columns(self) -> dict[str, str]:
        """Return the unit of each column of numbers: values applied, then the final state."""
        keys = {one.key for one in self.dispersions}
        more = {key: unit for key, unit in UNITS.items() if key in keys and key not in _START}
        return {**_START, **more, **_END}

    def applied(self, run: int) -> Applied:
        """
        Draw what acts in a run.

        Raises
        ------
        ValueError
            It is not possible, such as an inertia whose largest moment is too large.

        """
        drawn = draws(self.dispersions, self.seed, run)
        values = self._values(drawn)
        inertia = _relative(self.scene.body, drawn[INERTIA]) if INERTIA in drawn \
            else _tensor('inertia.i', values)
        attitude = self.start.attitude
        if ATTITUDE in drawn:
            attitude = so3.multiply(attitude, so3.exp(drawn[ATTITUDE]))
        start = State(self.start.time_ns, attitude, _vector('initial_angular_velocity', values),
                      _vector('initial_rotor_momentum', values))
        gain, offset_ns = values['torque_gain'], round(values['clock_offset'] * 1e9)
        return Applied(RigidBody(inertia, _tensor('damping.d', values)), start,
                       self._torques(run, gain, offset_ns), self._bias(values),
                       self.wheels and _later(self.wheels, offset_ns), gain, offset_ns)

    def motion(self, applied: Applied) -> Trajectory:
        """Return the final state of a run, with the errors of `propagate`."""
        bias = (applied.bias,) if applied.bias else ()
        return propagate(applied.body, applied.start, (*applied.logs, *bias), at=[self.end_ns],
                         wheels=applied.wheels, **self.scene.options)

    def row(self, run: int) -> dict[str, Any]:
        """Return a run as a row by column; that of a run that fails has no numbers."""
        try:
            applied = self.applied(run)
            motion = self.motion(applied)
        except ValueError as error:
            return {'run': run, 'status': 'failed', 'message': reason(error)}
        angle = float(so3.angle_between(motion.attitude[0], self.nominal_attitude))
        found = {**applied.values(), **_components('attitude', motion.attitude[0]),
                 **_components('angular_velocity', motion.angular_velocity[0]), ANGLE: angle}
        return {'run': run, 'status': 'ok', 'message': '',
                **{name: found[name] for name in self.columns}}

    def rows(self, first: int, stop: int) -> list[dict[str, Any]]:
        """Return some runs as rows; raise KeyboardInterrupt if a signal was received."""
        rows = []
        for run in range(first, stop):
            interrupts.check()
            rows.append(self.row(run))
        return rows

    def _values(self, drawn: Mapping[str, Floats]) -> dict[str, float]:
        """Return the nominal values, changed as drawn."""
        values = self.nominal.values()
        for one in self.dispersions:
            if one.key in values:
                draw = float(drawn[one.key][0])
                if one.relative:
                    values[one.key] *= 1.0 + draw
                else:
                    values[one.key] = draw + (one.kind == 'normal') * values[one.key]
        return values

    def _torques(self, run: int, gain: float, offset_ns: int) -> tuple[TorqueLog, ...]:
        logs = self.logs
        if gain != 1.0:
            logs = tuple(log.with_torques(gain * log.torques) for log in logs)
        for one in self.dispersions:
            if one.key == NOISE:
                random, sigma = stream(self.seed, run, NOISE), one.bounds[0]
                logs = tuple(log.with_torques(
                    log.torques + sigma * random.standard_normal(log.torques.shape))
                    for log in logs)
        return tuple(_later(log, offset_ns) for log in logs)

    def _bias(self, values: Mapping[str, float]) -> TorqueLog | None:
        torque = _vector('torque_bias', values)
        if not torque.any():
            return None
        times = np.array([self.start.time_ns])
        if self.scene.timeout_ns:  # a bias does not time out
            times = np.arange(self.start.time_ns, self.end_ns + 1,
                              max(1, self.scene.timeout_ns // 2))
        return TorqueLog(times, np.broadcast_to(torque, (len(times), 3)))


def _later(log: TorqueLog, offset_ns: int) -> TorqueLog:
    return TorqueLog(log.times_ns + offset_ns, log.torques, log.in_space, log.interpolation) \
        if offset_ns else log


def _relative(body: RigidBody, drawn: Floats) -> Floats:
    """
    Return a tensor with the same principal axes and other moments, which some body has.

    What is multiplied are the second moments of the mass along the axes, by the exponentials of
    the numbers drawn. They stay positive, so the moments satisfy the triangle inequality.
    """
    moments = body.principal_moments
    second = np.maximum(0.5 * moments.sum() - moments, 0.0) * np.exp(drawn)
    axes = body.principal_axes
    # Summed in a fixed order: in BLAS the order depends on the processor.
    return (axes[:, None] * axes * (second.sum() - second)).sum(axis=-1)


def _entries(prefix: str, tensor: Floats) -> dict[str, float]:
    return {prefix + entry: float(tensor[place]) for entry, place in _ENTRIES.items()}


def _tensor(prefix: str, values: Mapping[str, float]) -> Floats:
    tensor = np.empty((3, 3))
    for entry, (row, column) in _ENTRIES.items():
        tensor[row, column] = tensor[column, row] = values[prefix + entry]
    return tensor


def _components(prefix: str, vector: Floats) -> dict[str, float]:
    return {f'{prefix}.{axis}': float(value) for axis, value in zip('xyzw', vector)}


def _vector(prefix: str, values: Mapping[str, float]) -> Floats:
    return np.array([values[f'{prefix}.{axis}'] for axis in 'xyz'])
