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
Check a motion against the conservation laws, or against the work done on the body.

This module also estimates how far a motion moves if the last digits of the input data change. The
estimate holds for any solver.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.actuator import time_constants
from rigid_body_ros.mechanics.fields import GravityGradient, UniformField
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import stamps_of, TorqueLog
from rigid_body_ros.propagation import Problem, Trajectory
from rigid_body_ros.propagation.sensitivity import last_digit_effect

#: The energy balance covers at most _MOST_INTERVALS intervals. In each of them, the body turns by
#: at most _INTERVAL_ANGLE, rad.
_MOST_INTERVALS = 200_000
_INTERVAL_ANGLE = 0.05
#: The effect of the last digits is estimated over at most _SAMPLES samples and over a rotation of
#: at most _ANGLE, rad. The motions are compared at _TIMES points in time. The estimate takes about
#: 10 ms.
_SAMPLES, _ANGLE, _TIMES = 16_384, 4096.0, 64
#: Gauss-Legendre quadrature on [0, 1].
_GAUSS_POINTS = 0.5 + 0.1 * np.sqrt(15.0) * np.array([-1.0, 0.0, 1.0])
_GAUSS_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


class Check(NamedTuple):
    """The finding of a check, as text, and the part of the motion that was checked."""

    finding: str
    #: The check covers this many seconds from the start of the motion. `total` is the length of
    #: the motion, s.
    covered: float
    total: float

    def __str__(self) -> str:
        if self.covered >= self.total:
            return f'{self.finding}, checked over all {self.total:.9g} s'
        return (f'{self.finding}, checked over the first {self.covered:.9g} s of '
                f'{self.total:.9g} s')


class LastDigits(NamedTuple):
    """How far a motion moves if its inputs' last digits change, rad; see `last_digit_effect`."""

    effect: float
    #: Rounding error to expect in the part of the motion that the estimate covers, rad.
    rounding: float
    #: The estimate covers this many seconds from the start of the motion. `total` is the length
    #: of the motion, s.
    covered: float
    total: float

    def __str__(self) -> str:
        part = '' if self.covered >= self.total else \
            f' in the first {self.covered:.9g} s of {self.total:.9g} s'
        return (f'a change of the last digit of inertia, torque or start moves the '
                f'attitude by {self.effect:.1e} rad{part}: no solver guarantees a smaller error')


def last_digits(problem: Problem, trajectory: Trajectory) -> LastDigits | None:
    """
    Estimate how far the beginning of a motion moves if the last digits of its inputs change.

    The estimate is computed with the solver `auto`. It is None if the motion has zero length, or
    if the body spins too fast for an estimate.
    """
    begin_ns, end_ns = problem.start.time_ns, int(trajectory.times_ns[-1])
    speed = float(np.linalg.norm(trajectory.angular_velocity, axis=1).max())
    covered_ns = min(end_ns, problem.next_change_ns - 1) - begin_ns
    problem = problem.with_first_body()
    stamps_ns = stamps_of(problem.sources)
    following = stamps_ns[stamps_ns > begin_ns][_SAMPLES - 1:_SAMPLES]
    if following.size:
        covered_ns = min(covered_ns, int(following[0]) - begin_ns)
    if speed * covered_ns * 1e-9 > _ANGLE:
        covered_ns = int(_ANGLE / speed * 1e9)
    times_ns = np.unique(np.linspace(0, covered_ns, _TIMES + 1)[1:].astype(np.int64))
    try:
        effect = last_digit_effect(problem.between(problem.start, begin_ns + covered_ns),
                                   at=begin_ns + times_ns)
    except ValueError:  # the body spins too fast
        return None
    if not covered_ns:
        return None
    seconds = covered_ns * 1e-9
    return LastDigits(effect, 1e-15 * (10.0 + speed * seconds), seconds,
                      (end_ns - begin_ns) * 1e-9)


def drift(problem: Problem, trajectory: Trajectory) -> Check:
    """
    Return how much a motion violates the conservation laws.

    The motion must have at least one output.

    Without an external torque, the angular momentum in space axes is constant. With torques in
    space axes, the angular momentum changes by the integral of the torques. With fields alone, the
    integrals of motion in `_integrals` are constant. In the remaining cases, the work done on the
    body is compared with the change of its energy:

    - with torques in body axes, or torques from an actuator;
    - with damping;
    - with fields and torques together, or with an orbit and a uniform field together;
    - with wheels that have friction or a largest speed, and torques or fields together.

    If the body changes, the motion is only checked up to the first change. The work is only
    compared up to the first time at which a wheel reaches its largest speed.
    """
    seconds = float(trajectory.times_ns[-1] - problem.start.time_ns) * 1e-9
    change_ns = problem.next_change_ns
    if change_ns <= trajectory.times_ns[-1]:
        times_ns = trajectory.times_ns[trajectory.times_ns < change_ns]
        problem = problem.with_first_body()
        part = problem.propagate(at=np.append(times_ns, change_ns - 1))
        return drift(problem, part)._replace(total=seconds)
    is_coupled = problem.is_coupled
    if not is_coupled:
        problem = problem.carried()
    acting, is_damped = [log for log in problem.logs if log.torques.any()], problem.body.is_damped
    if problem.fields:
        if not (problem.has_torque or is_damped or is_coupled):
            integrals = _integrals(problem, trajectory)
            if integrals:
                return Check(f'relative drift of {integrals}', seconds, seconds)
        return _balance(problem, trajectory, seconds)
    if not acting and not is_damped:
        momentum = trajectory.angular_momentum_space
        size = max(_norm(momentum[:1]), _norm(trajectory.rotor_momentum))
        lost = _norm(momentum - momentum[0])
        return Check(
            f'relative drift of the space angular momentum {lost / size if size else lost:.1e}',
            seconds, seconds)
    in_space = all(log.in_space[log.torques.any(axis=1)].all() for log in acting)
    if in_space and not (is_damped or problem.actuators or is_coupled):
        return Check('space angular momentum and the integral of the torque differ by '
                     f'{_momentum_balance(problem, trajectory):.1e} of the largest '
                     'momentum', seconds, seconds)
    return _balance(problem, trajectory, seconds)


def _balance(problem: Problem, trajectory: Trajectory, seconds: float) -> Check:
    if trajectory.at_limit:  # then the efforts jump at times that the quadrature does not know
        first_ns = max(trajectory.at_limit[0].begin_ns - 1, problem.start.time_ns)
        times_ns = trajectory.times_ns[trajectory.times_ns < first_ns]
        trajectory = problem.propagate(at=np.append(times_ns, first_ns))
    imbalance, covered = energy_balance(problem, trajectory)
    return Check(f'work and energy differ by {imbalance:.1e} of the largest energy', covered,
                 seconds)


def _integrals(problem: Problem, trajectory: Trajectory) -> str:
    """
    Return a text with the relative changes of the constants of motion for a body in fields alone.

    In uniform fields, the total energy (kinetic plus potential) is constant. If all fields are
    parallel, the angular momentum about their common direction is constant, too, as in Lagrange's
    top. In orbit, Jacobi's integral is constant: the energy minus the product of the mean motion
    and the angular momentum about the orbit normal. In orbit with uniform fields, nothing is
    conserved, and the text is empty.
    """
    start, body, fields = problem.start, problem.body, problem.fields
    times_ns = np.append(start.time_ns, trajectory.times_ns)
    attitude = np.vstack([start.attitude, trajectory.attitude])
    rates = np.vstack([start.angular_velocity, trajectory.angular_velocity])
    momentum = so3.rotate(attitude, body.angular_momentum(rates) + start.rotor_momentum)
    energies = [body.kinetic_energy(rates), *(
        field.potential_energy(body, times_ns, attitude) for field in fields)]
    uniform = [field for field in fields if isinstance(field, UniformField)]
    for field in fields:
        if isinstance(field, GravityGradient):
            energies.append(-field.mean_motion * (momentum @ np.asarray(field.normal)))
            return '' if uniform else f"Jacobi's integral {_change(energies):.1e}"
    text = f'the energy {_change(energies):.1e}'
    directions = np.array([field.field for field in uniform])
    if np.linalg.matrix_rank(directions / np.linalg.norm(directions, axis=1)[:, None]) > 1:
        return text
    along = momentum @ (directions[0] / np.linalg.norm(directions[0]))
    largest = _norm(momentum)
    about = float(np.abs(along - along[0]).max()) / (largest or 1.0)
    return f'{text}, of the momentum about the field {about:.1e}'


def _change(terms: Sequence[Floats]) -> float:
    """Return how far the sum of `terms` moves from its start, relative to the largest term."""
    total, largest = np.sum(terms, axis=0), float(np.abs(terms).max())
    return float(np.abs(total - total[0]).max()) / (largest or 1.0)


def _momentum_balance(problem: Problem, trajectory: Trajectory) -> float:
    """Return the relative error of the angular momentum for torques in space axes."""
    start, body = problem.start, problem.body
    momentum = start_momentum = so3.rotate(
        start.attitude, body.angular_momentum(start.angular_velocity) + start.rotor_momentum)
    for log in problem.logs:  # integrate the torque as if it acted on the rotors
        driven = TorqueLog(log.times_ns, log.torques, interpolation=log.interpolation)
        rotors = problem.solved_by().replaced(start=State(start.time_ns), log=(), wheels=driven)
        momentum = momentum + rotors.rotor_momentum(trajectory.times_ns)
    scale = max(_norm(momentum), _norm(start_momentum[None]), _norm(trajectory.rotor_momentum))
    lost = _norm(trajectory.angular_momentum_space - momentum)
    return lost / scale if scale else lost


def _norm(vectors: Floats) -> float:
    """Return the length of the longest vector."""
    return float(np.linalg.norm(vectors, axis=1).max())


def energy_balance(problem: Problem, trajectory: Trajectory) -> tuple[float, float]:
    """
    Compare the work done on the body with the change of its kinetic energy.

    The work is the integral of (tau - tau_wheel - D w) . w over time. It is computed by
    three-point Gaussian quadrature, over intervals that end wherever the torque changes and in
    which the body turns by at most 0.05 rad. The intervals are shorter where rotors, damping or
    lags change the rates faster than the body turns. The quadrature points are rounded to whole
    nanoseconds. At 1 rad/s, this rounding changes the work in an interval by a fraction of about
    1e-10.

    Returns
    -------
    imbalance : float
        |work - change of energy|, relative to the largest kinetic energy.
    seconds : float
        The length of the part of the motion that the comparison covers, s, counted from the start.
        If the whole motion would need more than `_MOST_INTERVALS` intervals, only its beginning is
        covered.

    """
    edges = _interval_edges(problem, trajectory)
    lengths = np.diff(edges)
    points = edges[:-1, None] + np.round(lengths[:, None] * _GAUSS_POINTS).astype(np.int64)
    times_ns = np.concatenate([points.ravel(), edges[[0, -1]]])
    motion = problem.propagate(at=times_ns)
    rates = motion.angular_velocity[:-2]
    total = problem.torque(times_ns[:-2], motion.attitude[:-2]) - rates @ problem.body.damping
    body, wheels = problem.body, problem.named_wheels
    if problem.wheels:
        total -= problem.wheels.at(times_ns[:-2], problem.options.timeout_ns)[0]
    if wheels:  # with friction
        body = wheels.carrier(body)
        total -= wheels.torque(wheels.slowed(motion.wheel_efforts, motion.wheel_speeds))[:-2]
    power = np.sum(total * rates, axis=1).reshape(-1, 3)
    work = np.sum(power @ _GAUSS_WEIGHTS * lengths) * 1e-9
    energy = body.kinetic_energy(motion.angular_velocity)
    change, scale = energy[-1] - energy[-2], energy.max()
    return (abs(float((work - change) / scale)) if scale else 0.0), \
        float(edges[-1] - edges[0]) * 1e-9


def _interval_edges(problem: Problem, trajectory: Trajectory) -> NDArray[np.int64]:
    # Return the times at which the torque changes, and enough times between them to keep all
    # intervals short.
    changes = np.unique(np.concatenate(
        [np.empty(0, np.int64),
         *(log.segments(problem.options.timeout_ns)[0] for log in problem.acting_sources),
         *([problem.efforts.times_ns, problem.efforts.times_ns + problem.options.timeout_ns]
           if problem.efforts else ())]))
    start_ns, end_ns = problem.start.time_ns, int(trajectory.times_ns[-1])
    inside = changes[(changes > start_ns) & (changes < end_ns)]
    edges = np.concatenate([[start_ns], inside, [end_ns]])[:_MOST_INTERVALS + 1]
    lengths = np.diff(edges)
    least, _, largest = trajectory.body.principal_moments
    wheels = problem.named_wheels
    # Rotors and damping change the angular velocity at this rate, 1/s, at most.
    linear_rate = (_norm(trajectory.rotor_momentum)
                   + float(np.linalg.norm(trajectory.body.damping))) / float(least)
    speed = _norm(trajectory.angular_velocity) + linear_rate + (
        wheels.decay_rate(wheels.carrier(problem.body)) if wheels else 0.0) + sum(
        float(field.speed(least, largest)) for field in problem.fields) + max(
            [1.0 / constant for constant in time_constants(problem.actuators)], default=0.0)
    counts = np.ceil(lengths * 1e-9 * speed / _INTERVAL_ANGLE)
    counts = counts.clip(1, _MOST_INTERVALS).astype(int)
    counts = counts[:np.searchsorted(np.cumsum(counts), _MOST_INTERVALS) + 1]
    lengths = lengths[:len(counts)]
    number = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    offsets = np.round(number / np.repeat(counts, counts) * np.repeat(lengths, counts))
    inner = np.repeat(edges[:len(counts)], counts) + offsets.astype(np.int64)
    return np.append(inner, edges[len(counts)])[:_MOST_INTERVALS + 1]
