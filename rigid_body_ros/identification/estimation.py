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
"""Identify the parameters of a body from measured motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import so3
from rigid_body_ros.body import RigidBody
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.identification.experiment import (
    Channel,
    channels_of,
    Experiment,
    typical_rate,
)
from rigid_body_ros.identification.identifiability import Certainty, certainty, Direction
from rigid_body_ros.identification.parameters import (
    checked_names,
    Parameters,
    Physics,
    START,
    UNITS,
)
from rigid_body_ros.identification.solve import Setup, Solution, solve
from rigid_body_ros.identification.windows import windows_of
from rigid_body_ros.propagation import Options
from rigid_body_ros.state import State

#: Half the width of a 95 % interval, in standard deviations.
_NORMAL_95 = 1.959963984540054
#: A sample of the validation is left out if its error is this many times the median.
_OUTLIER = 8.0


@dataclass(frozen=True)
class Estimate:
    """
    An estimated number.

    Attributes
    ----------
    name, unit : str
    value, start : float
        The estimate, and the guess.
    sigma : float
        Standard deviation; infinite if the data does not determine the number.
    identifiable : bool

    """

    name: str
    unit: str
    value: float
    start: float
    sigma: float
    identifiable: bool

    @property
    def interval_95(self) -> tuple[float, float] | None:
        """Return the limits of the 95 % interval, None if there is none."""
        half = _NORMAL_95 * self.sigma
        return (self.value - half, self.value + half) if self.identifiable else None


@dataclass(frozen=True)
class Misfit:
    """
    How a model and measurements differ.

    Attributes
    ----------
    samples, outliers : int
        The outliers are not in the other numbers.
    attitude_rms, rate_rms : float or None
        rad and rad/s; None if not measured.
    chi2_per_dof : float or None
        Sum of squares of the errors, divided by their variances and their number less that of the
        unknowns. It is 1 if the noise was estimated from the same errors.

    """

    samples: int
    outliers: int
    attitude_rms: float | None
    rate_rms: float | None
    chi2_per_dof: float | None

    def as_dict(self) -> dict[str, Any]:
        """Return the fields with the names of the JSON."""
        return {'samples': self.samples, 'outliers': self.outliers,
                'attitude_rms_rad': self.attitude_rms, 'rate_rms_rad_s': self.rate_rms,
                'chi2_per_dof': self.chi2_per_dof}


@dataclass(frozen=True, eq=False)
class Identification:
    """
    Estimated parameters of a body.

    Attributes
    ----------
    body : RigidBody
        With the estimated inertia and damping.
    starts : list of State
        The initial state of each recording.
    estimates : dict of str to Estimate
        By component name.
    correlation : array, shape (n, n)
        Of the estimates, NaN for those that are not identifiable.
    unidentifiable : list of Direction
        Combinations of parameters that the data does not determine.
    noise : dict of str to float
        By topic and quantity, the standard deviation that was given or estimated.
    autocorrelation : dict of str to float
        The same of the errors of neighbouring samples; close to 0 if the errors are white.
    training : Misfit
    validation : Misfit or None
    window_s : float
        Length of the windows of the fit; each begins with a state of its own.
    evaluations : int
    converged : bool

    """

    body: RigidBody
    starts: list[State]
    estimates: dict[str, Estimate]
    correlation: Floats
    unidentifiable: list[Direction]
    noise: dict[str, float]
    autocorrelation: dict[str, float]
    training: Misfit
    validation: Misfit | None
    window_s: float
    evaluations: int
    converged: bool

    def as_dict(self) -> dict[str, Any]:
        """Return the result as JSON data; numbers that are not finite are None."""
        return {
            'estimates': {name: {
                'value': one.value, 'start': one.start,
                'sigma': one.sigma if one.identifiable else None,
                'interval_95': list(one.interval_95) if one.interval_95 else None,
                'identifiable': one.identifiable} for name, one in self.estimates.items()},
            'unidentifiable': [{'direction': one.components, 'reason': one.reason}
                               for one in self.unidentifiable],
            'correlation': [[None if math.isnan(value) else value for value in row]
                            for row in self.correlation.tolist()],
            'noise': self.noise, 'autocorrelation': self.autocorrelation,
            'window_s': self.window_s,
            'training': self.training.as_dict(),
            'validation': self.validation.as_dict() if self.validation else None,
            'evaluations': self.evaluations, 'converged': self.converged}


def identify(body: RigidBody, experiments: Experiment | Sequence[Experiment], *,
             estimate: Sequence[str] = ('inertia', START), attitude_noise: float | None = None,
             rate_noise: float | None = None, validate: float = 0.0,
             torque_timeout: float = Options.torque_timeout) -> Identification:
    """
    Estimate parameters of a body from what was measured.

    The estimates are those of maximum likelihood for independent normal errors. Samples with much
    larger errors than the others are outliers, which do not count.

    Parameters
    ----------
    body : RigidBody
        The guess of inertia and damping, which may be three times off.
    experiments : Experiment or sequence of Experiment
        Recordings of the same body.
    estimate : sequence of str
        What to fit: 'inertia' (six entries) or 'inertia_diagonal' (three), 'start' (the initial
        angular velocity, and the initial attitude if attitudes are measured), 'torque_gain',
        'torque_bias', 'clock_offset', 'mount', 'gyro_bias', 'damping', 'rotor_momentum'.
    attitude_noise, rate_noise : float, optional, rad and rad/s
        Standard deviation of each component of a measurement; estimated for each topic if None.
    validate : float
        Fraction of each recording, at its end, that is not fitted but predicted.
    torque_timeout : float, s
        As for `propagate`.

    Returns
    -------
    Identification

    Raises
    ------
    InputError
        A name is unknown, a noise is not positive, or a topic has too few finite samples.

    """
    names = checked_names(estimate)
    for name, noise in (('attitude_noise', attitude_noise), ('rate_noise', rate_noise)):
        if noise is not None and not (math.isfinite(noise) and noise > 0.0):
            raise InputError(f'{name}: expected a number greater than zero, found {noise}')
    if not 0.0 <= validate < 1.0:
        raise InputError(f'validate: expected a fraction from 0 to less than 1, found {validate}')
    experiments = [experiments] if isinstance(experiments, Experiment) else [*experiments]
    if not experiments:
        raise InputError('experiments: expected at least one recording, found none')
    every = [channels_of(experiment) for experiment in experiments]
    training = [_training(channels, validate) for channels in every]
    setup = _setup(body, experiments, training, names, attitude_noise, rate_noise, torque_timeout)
    solution = solve(setup)
    validation = _validation(setup, solution, every) if validate else None
    return _result(setup, solution, validation)


def _training(channels: list[Channel], validate: float) -> list[Channel]:
    first = min(int(channel.stamps[0]) for channel in channels)
    last = max(int(channel.stamps[-1]) for channel in channels)
    end_ns = first + round((1.0 - validate) * (last - first))
    fitted = [channel.rows(channel.stamps <= end_ns) for channel in channels]
    for channel in fitted:
        if len(channel.stamps) < 2:
            raise InputError(f'{channel.topic}: expected samples before the part for validation, '
                             f'found {len(channel.stamps)}')
    return fitted


def _setup(body: RigidBody, experiments: list[Experiment], channels: list[list[Channel]],
           names: tuple[str, ...], attitude_noise: float | None, rate_noise: float | None,
           torque_timeout: float) -> Setup:
    rate = max(typical_rate(one) for one in channels)
    torques = [np.sqrt(np.mean(np.sum(log.torques ** 2, axis=1)))
               for experiment in experiments for log in experiment.logs if len(log)]
    span_s = max(float(one.stamps[-1] - one.stamps[0]) for every in channels for one in every)
    parameters = Parameters(names, Physics(body.inertia, body.damping), rate,
                            float(max(torques, default=0.0)), max(span_s * 1e-9, 1e-9))
    return Setup(experiments, channels, parameters, rate, START in names, attitude_noise,
                 rate_noise, torque_timeout)


def _result(setup: Setup, solution: Solution, validation: Misfit | None) -> Identification:
    physics, parameters = solution.physics, setup.parameters
    names, values, guesses = [*parameters.names], [parameters.values(physics)], \
        [parameters.values(parameters.guess)]
    scales, turns = [parameters.scales], [np.eye(parameters.size)]
    momentum = setup.experiments[0].start.rotor_momentum
    if 'rotor_momentum' in parameters.groups:
        first = names.index('initial_rotor_momentum.x')
        for vector in (values[0], guesses[0]):
            vector[first:first + 3] += momentum
    starts = []
    for number in range(len(setup.experiments)):
        start, own = _start(setup, solution, number)
        starts.append(start)
        if own is None:
            continue
        suffix = f'[{number + 1}]' if number else ''
        names += [f'{name}{suffix}' for name in own.names]
        values.append(own.values)
        guesses.append(own.guesses)
        scales.append(own.scales)
        turns.append(own.turn)
    scale = np.concatenate(scales)
    value, guess = np.concatenate(values), np.concatenate(guesses)
    turn = _block_diagonal(turns)
    known = certainty(solution.problem.information(physics) @ np.linalg.inv(turn), names,
                      value / scale)
    sigma = np.where(known.identifiable, np.sqrt(np.diag(known.covariance)) * scale, np.inf)
    estimates = {name: Estimate(name, UNITS[name.split('.')[0]], float(value[i]), float(guess[i]),
                                float(sigma[i]), bool(known.identifiable[i]))
                 for i, name in enumerate(names)}
    return Identification(physics.body, starts, estimates, _correlation(known), known.directions,
                          *_noise(setup, solution), _misfit(setup, solution), validation,
                          solution.length_ns * 1e-9, solution.evaluations, solution.converged)


@dataclass(frozen=True, eq=False)
class _Start:
    """An estimated start: components as in `_result`."""

    names: list[str]
    values: Floats
    guesses: Floats
    scales: Floats
    turn: Floats


def _start(setup: Setup, solution: Solution, number: int) -> tuple[State, _Start | None]:
    """Return the initial state of a recording, and its components if it was fitted."""
    given = setup.experiments[number].start
    momentum = given.rotor_momentum + solution.physics.rotor_momentum
    k = next(k for k, window in enumerate(solution.problem.windows)
             if window.experiment == number)
    if not solution.problem.windows[k].is_first or not setup.fits_start:
        return replace(given, rotor_momentum=momentum), None
    attitude, velocity = (solution.problem.reference.attitude[k],
                          solution.problem.reference.velocity[k])
    start = State(given.time_ns, attitude, velocity, momentum)
    names = [f'initial_angular_velocity.{axis}' for axis in 'xyz']
    values, guesses, scales, turn = (velocity, given.angular_velocity, np.full(3, setup.rate),
                                     np.eye(3))
    if setup.fits_attitude:
        turned = so3.log(so3.multiply(so3.conjugate(given.attitude), attitude))
        names = [*(f'initial_attitude.{axis}' for axis in 'xyz'), *names]
        values, guesses = np.append(turned, values), np.append(np.zeros(3), guesses)
        scales = np.append(np.ones(3), scales)
        turn = _block_diagonal([_change_of_vector(turned), turn])
    return start, _Start(names, values, guesses, scales, turn)


def _change_of_vector(vector: Floats) -> Floats:
    """Return how a rotation vector changes with a small rotation in body axes."""
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = float(np.linalg.norm(vector))
    if angle < 1e-3:
        return np.eye(3) + 0.5 * cross + cross @ cross / 12.0
    factor = 1.0 / angle ** 2 - 0.5 / (angle * np.tan(0.5 * angle))
    return np.eye(3) + 0.5 * cross + factor * cross @ cross


def _block_diagonal(blocks: Sequence[Floats]) -> Floats:
    size = sum(len(block) for block in blocks)
    result, first = np.zeros((size, size)), 0
    for block in blocks:
        result[first:first + len(block), first:first + len(block)] = block
        first += len(block)
    return result


def _correlation(known: Certainty) -> Floats:
    sigma = np.sqrt(np.diag(known.covariance))
    with np.errstate(invalid='ignore', divide='ignore'):
        result = known.covariance / np.outer(sigma, sigma)
    result[~known.identifiable] = result[:, ~known.identifiable] = np.nan
    return result


def _noise(setup: Setup, solution: Solution) -> tuple[dict[str, float], dict[str, float]]:
    """Return noise and autocorrelation of each channel of each recording, by a name for it."""
    noise, autocorrelation = {}, {}
    for number, channels in enumerate(setup.channels):
        for channel, level, error, inlier in zip(
                channels, solution.weights.sigma[number], solution.errors[number],
                solution.inliers[number]):
            quantity = 'attitude' if channel.is_attitude else 'angular_velocity'
            suffix = f'[{number + 1}]' if number else ''
            name = f'{channel.topic} {quantity}{suffix}'
            noise[name] = float(level)
            autocorrelation[name] = _autocorrelation(error, inlier)
    return noise, autocorrelation


def _autocorrelation(error: Floats, inlier: NDArray[np.bool_]) -> float:
    """Return the correlation of the errors of neighbouring samples."""
    kept = error[inlier & np.isfinite(error[:, 0])]
    total = float(np.sum(kept * kept))
    return float(np.sum(kept[1:] * kept[:-1])) / total if total else 0.0


def _misfit(setup: Setup, solution: Solution) -> Misfit:
    errors = [(channel, error[inlier & np.isfinite(error[:, 0])], level,
               int(np.sum(~inlier & np.isfinite(error[:, 0]))))
              for channels, every, inliers, levels in zip(
                  setup.channels, solution.errors, solution.inliers, solution.weights.sigma)
              for channel, error, inlier, level in zip(channels, every, inliers, levels)]
    return _summary(errors, solution.problem.size)


def _summary(errors: Sequence[tuple[Channel, Floats, float, int]], unknowns: int) -> Misfit:
    """Return the misfit of channels with errors, noise and number of outliers."""
    def rms(is_attitude: bool) -> float | None:
        squares = [error.ravel() ** 2 for channel, error, _, _ in errors
                   if channel.is_attitude == is_attitude]
        values = np.concatenate([np.empty(0), *squares])
        return float(np.sqrt(values.mean())) if values.size else None
    count = sum(error.size for _, error, _, _ in errors) - unknowns
    chi2 = sum(float(np.sum((error / level) ** 2)) for _, error, level, _ in errors)
    outliers = sum(one for *_, one in errors)
    return Misfit(sum(len(error) for _, error, _, _ in errors) + outliers, outliers, rms(True),
                  rms(False), chi2 / count if count > 0 else None)


def _validation(setup: Setup, solution: Solution, every: list[list[Channel]]) -> Misfit:
    """Return how the prediction from the end of the training fits the rest."""
    physics, problem, found = solution.physics, solution.problem, []
    offset_ns = round(physics.clock_offset * 1e9)
    for number, (experiment, channels) in enumerate(zip(setup.experiments, every)):
        fitted = setup.channels[number]
        k = [k for k, one in enumerate(problem.windows) if one.experiment == number][-1]
        last = problem.windows[k]
        rest = [channel.rows(slice(len(one.stamps), None))
                for channel, one in zip(channels, fitted)]
        whole, = windows_of(number, experiment, channels, 2 ** 62, offset_ns, 0,
                            setup.torque_timeout)
        ahead = replace(whole, anchor_ns=last.anchor_ns, rotors=last.rotors, channels=rest)
        predicted = ahead.predict(physics, problem.reference.attitude[k],
                                  problem.reference.velocity[k])
        for channel, here, level in zip(rest, predicted, solution.weights.sigma[number]):
            error = -so3.log(so3.multiply(so3.conjugate(here), channel.values)) \
                if channel.is_attitude else here - channel.values
            size = np.linalg.norm(error, axis=1)
            inlier = size <= _OUTLIER * max(np.median(size), level) if len(size) else size > 0
            found.append((channel, error[inlier], level, int(np.sum(~inlier))))
    return _summary(found, 0)
