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

"""Identify the parameters of a body from measurements of its motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
import math
from typing import NamedTuple

import numpy as np
from rigid_body_ros.common.arrays import entries, Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.identification.result import Estimate, Identification, MOMENTS
from rigid_body_ros.inference import errors
from rigid_body_ros.inference.coordinates import checked_names, checked_priors, GRAVITY
from rigid_body_ros.inference.evidence import certainty
from rigid_body_ros.inference.findings import Findings, judged
from rigid_body_ros.inference.fit import Solution
from rigid_body_ros.inference.noise import NORMAL_95
from rigid_body_ros.inference.setup import channels_of, setup_of
from rigid_body_ros.inference.verdict import tried, with_intervals
from rigid_body_ros.inference.windows import acted
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.efforts import EffortLog
from rigid_body_ros.mechanics.fields import Field
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import Logs, TorqueLog
from rigid_body_ros.mechanics.wheels import Wheel
from rigid_body_ros.propagation import Options, Problem
from rigid_body_ros.recording.account import Account
from rigid_body_ros.recording.measured import faults_of, Measured
from rigid_body_ros.recording.observed import Measurements
from rigid_body_ros.scene.quantities import quantity_of, START, WEIGHT


@dataclass(frozen=True, eq=False)
class Experiment:
    """
    One recording: the torques that acted on the body, and the measurements.

    Attributes
    ----------
    start : State
        The initial state, or a guess of the initial state if 'start' is fitted. Measurements taken
        before the start are ignored.
    log : TorqueLog, sequence of TorqueLog or None
        The torques, as for `propagate`.
    measured : sequence of Measured
        The measurements of the sensors.
    wheels : TorqueLog or sequence of Wheel, optional
        The torque on the rotors, or the named wheels, as for `propagate`. All recordings must have
        the same wheels.
    fields : sequence of Field
        The fields, as for `propagate`. All recordings must have the same fields.
    efforts : EffortLog, optional
        Commands for the named wheels. The motion is first computed with the guess, to find out
        what the motors give while a wheel is at its largest speed.
    torques : Account, optional
        What became of the recorded torques.

    """

    start: State
    log: Logs
    measured: Sequence[Measured]
    wheels: TorqueLog | Sequence[Wheel] | None = None
    fields: Sequence[Field] = ()
    efforts: EffortLog | None = None
    torques: Account | None = None

    def observed(self, body: RigidBody, torque_timeout: float) -> tuple[Problem, Measurements]:
        """Return the problem of a body, and the measurements."""
        problem = Problem(body, self.start, self.log, wheels=self.wheels, fields=self.fields,
                          efforts=self.efforts, torque_timeout=torque_timeout)
        return problem, Measurements([*self.measured], torques=self.torques)


#: A recording of a body.
Observed = Experiment | tuple[Problem, Measurements]


def identify(body: RigidBody, experiments: Observed | Sequence[Observed], *,
             estimate: Sequence[str] = ('inertia', START), attitude_noise: float | None = None,
             rate_noise: float | None = None, validate: float = 0.0,
             priors: Mapping[str, float | str] | None = None,
             gravity: Sequence[float] = GRAVITY, accept: float | None = None,
             torque_timeout: float = Options.torque_timeout) -> Identification:
    """
    Estimate parameters of a body from measurements.

    The estimates are maximum-likelihood estimates for independent, normally distributed errors.
    Samples whose errors are much larger than the rest are treated as outliers and ignored.

    Parameters
    ----------
    body : RigidBody
        Initial guess of the inertia and the damping. The inertia may be off by a factor of three.
    experiments : Experiment, or (Problem, Measurements), or a sequence of these
        Recordings of the same body. The body of a problem is replaced by `body`.
    estimate : sequence of str
        The parameters to fit. For the body and the torques, these are 'inertia' (all six entries)
        or 'inertia_diagonal' (the three diagonal entries), 'torque_gain' or 'torque_gains' (one
        gain per axis), 'torque_bias', 'torque_delay', 'torque_lag', 'weight' (moment of the weight
        about a pivot), 'damping', 'rotor_momentum', and 'NAME.moment' for a uniform field called
        NAME. 'start' fits the initial angular velocity and, if attitudes are measured, the initial
        attitude. For the sensors, the parameters are 'clock_offset', 'clock_drift', 'mount',
        'gyro_bias' and 'gyro_scale'. Append '@TOPIC' to fit a sensor parameter for only one
        sensor.
    attitude_noise, rate_noise : float, optional, rad and rad/s
        Standard deviation of each component of a measurement. If None, the fit estimates the
        standard deviation of each topic.
    validate : float
        Fraction of each recording, taken from its end, to hold back for validation. The fit
        ignores these samples, and the model is then used to predict them.
    priors : dict of str to float or str, optional
        Standard deviations of the guesses, keyed by the name of a parameter or component. A number
        has the unit of the component. A string such as '5%' is relative to the guess. The prior of
        a parameter that is not estimated is its plausible size as a suspect.
    gravity : sequence of 3 float, m/s^2, space axes
        Acceleration of gravity, used for the parameter 'weight'.
    accept : float, optional
        Largest half-width of an interval to accept. For an entry of the inertia, it is relative to
        the mean moment of inertia, and for any other parameter to the scale of the parameter. If
        an interval is wider, the fit is rejected.
    torque_timeout : float, s
        Longest time for which a torque sample of an `Experiment` acts, as for `propagate`.

    Returns
    -------
    Identification

    Raises
    ------
    InputError
        A name is unknown or refers to a field or topic that does not exist; a noise or prior is
        not positive; a topic has too few finite samples; or the recordings have different wheels.

    """
    names = checked_names(estimate)
    for name, noise in (('attitude_noise', attitude_noise), ('rate_noise', rate_noise)):
        if noise is not None and not (math.isfinite(noise) and noise > 0.0):
            raise InputError(f'{name}: expected a number greater than zero, found {noise}')
    if not 0.0 <= validate < 1.0:
        raise InputError(f'validate: expected a fraction from 0 to less than 1, found {validate}')
    if WEIGHT in names and not np.any(gravity):
        raise InputError(f'gravity: expected a field other than zero for {WEIGHT}, found zeros')
    recordings = [experiments] if isinstance(experiments, (Experiment, tuple)) \
        else [*experiments]
    if not recordings:
        raise InputError('experiments: expected at least one recording, found none')
    observed = [recording.observed(body, torque_timeout) if isinstance(recording, Experiment)
                else recording for recording in recordings]
    every = [channels_of(measurements.sensors, problem.start.time_ns)
             for problem, measurements in observed]
    training = [_training(channels, validate) for channels in every]
    setup = setup_of([problem.replaced(body=body) for problem, _ in observed], training, names,
                     attitude_noise, rate_noise, gravity)
    checked = checked_priors(priors or {}, setup.extended(
        setup.given, setup.candidates()).parameters)
    is_whole = not any(faults_of(measurements.torques, measurements.sensors)
                       for _, measurements in observed)
    findings = judged(replace(setup, parameters=setup.parameters.with_priors(checked)), is_whole)
    return _result(findings, every if validate else [], accept, is_whole)


def _training(channels: list[Measured], validate: float) -> list[Measured]:
    first = min(int(channel.stamps_ns[0]) for channel in channels)
    last = max(int(channel.stamps_ns[-1]) for channel in channels)
    end_ns = first + round((1.0 - validate) * (last - first))
    fitted = [channel.rows(channel.stamps_ns <= end_ns) for channel in channels]
    for channel in fitted:
        if len(channel) < 2:
            raise InputError(f'{channel.topic}: expected samples before the part for validation, '
                             f'found {len(channel)}')
    return fitted


def _result(findings: Findings, every: Sequence[Sequence[Measured]],
            accept: float | None, is_whole: bool) -> Identification:
    """
    Assemble the result of a fit.

    The argument `every` holds all samples, or is empty if there is no validation. Unless the
    recordings are whole, no suspects are named.
    """
    solution = findings.solution
    setup, physics = solution.problem.setup, solution.physics
    numbers = _numbers(solution)
    covariance, is_known, directions = certainty(
        solution.problem.information(physics) @ np.linalg.inv(numbers.turn),
        numbers.names, numbers.values / numbers.scales)
    sigma = np.sqrt(np.diag(covariance)) * numbers.scales
    # How far the recordings, or their halves, are apart counts if it is more than sigma explains.
    wider = np.maximum([findings.scatter.get(name, 0.0) for name in numbers.names]
                       / np.where(sigma > 0.0, sigma, np.inf), findings.apart)
    sigma = np.where(is_known, wider * sigma, np.inf)
    scale = wider * numbers.scales
    covariance = 0.5 * (covariance + covariance.T) * np.outer(scale, scale)
    covariance[~is_known] = covariance[:, ~is_known] = np.nan
    ahead = errors.of_validation(solution, every) if every else []
    fitted = errors.of_training(solution)
    findings = findings.with_validation(every, ahead)
    attempts = tried(findings, every) if is_whole else []
    others = [dict(zip(*_numbers(fit)[:2])) for _, fit in attempts]
    moved = [{name: abs(other.get(name, math.nan) - before)
              for name, before in zip(numbers.names, numbers.values)} for other in others]
    verdict, systematic = with_intervals(findings, [suspect for suspect, _ in attempts], moved)
    estimates = [Estimate(name, quantity_of(name).unit, float(numbers.values[i]),
                          float(numbers.guesses[i]), float(sigma[i]), bool(is_known[i]),
                          systematic.get(name, 0.0)) for i, name in enumerate(numbers.names)]
    verdict = verdict.with_reasons(_without_effect(estimates)).with_reasons(
        too_wide(estimates, dict(zip(numbers.names, numbers.scales)), accept), True)
    residuals, first = [*fitted, *ahead], setup.problems[0]
    aligned = errors.measured_inliers([part for part in residuals if not part.recording], physics,
                                      first.start.time_ns)
    last_ns = max(int(sensor.stamps_ns[-1]) for sensor in aligned)
    return Identification(
        setup.body(physics), physics.acting(first.fields),
        [_start(solution, number)[0] for number in range(len(setup.problems))],
        {estimate.name: estimate for estimate in estimates}, covariance, first.start.attitude,
        directions, residuals, errors.Misfit.of(fitted, solution.problem.size),
        errors.Misfit.of(ahead, 0) if ahead else None, solution.length_ns * 1e-9,
        solution.evaluations, solution.converged, verdict,
        any(log.torques.any() for problem in setup.problems for log in problem.logs),
        findings.predictable_s, _first_motion(solution, last_ns), aligned)


def _without_effect(estimates: Sequence[Estimate]) -> list[str]:
    """Return a reason against the model for each torque gain whose 95 % interval contains 0."""
    gains = [estimate for estimate in estimates if estimate.name.startswith('torque_gain')]
    return [f'{gain.name}: the interval contains 0: the logged torque has no visible effect'
            + (f' about {gain.name[-1]}' if '.' in gain.name else '')
            for gain in gains if gain.interval_95
            and gain.interval_95[0] <= 0.0 <= gain.interval_95[1]]


def too_wide(estimates: Sequence[Estimate], scales: Mapping[str, float],
             accept: float | None) -> list[str]:
    """
    Return a reason against the fit for each interval that is too wide to be of use.

    An interval is too wide if its half-width exceeds `accept` times the scale of the estimate, or
    the mean moment for an inertia. The interval of a moment of inertia must not contain 0.
    """
    mean = sum(estimate.value for estimate in estimates if estimate.name in MOMENTS) / len(MOMENTS)
    texts = []
    for estimate in estimates:
        name, half = estimate.name, NORMAL_95 * estimate.uncertainty
        scale = mean if name.startswith('inertia') else scales[name]
        if not estimate.identifiable:
            continue
        if accept is not None and half > accept * scale:
            texts.append(f'{name}: the interval is wider than the accepted {accept:g}')
        elif name in MOMENTS and half >= estimate.value:
            texts.append(f'{name}: the interval contains 0')
    return texts


def _first_motion(solution: Solution, end_ns: int) -> Problem:
    """
    Return the estimated motion of the first recording.

    If a torque bias was estimated, the motion includes this bias at least until `end_ns`.
    """
    problem, physics = solution.problem.setup.problems[0], solution.physics
    start = _start(solution, 0)[0]
    momentum = problem.start.rotor_momentum + physics.value('rotor_momentum') \
        + solution.problem.setup.axial_tensor @ start.angular_velocity
    start = State(start.time_ns, start.attitude, start.angular_velocity, momentum)
    motion = acted(problem, physics).replaced(body=physics.body, start=start,
                                              fields=physics.acting(problem.fields) or None)
    bias = physics.value('torque_bias')
    return motion.biased(bias, end_ns) if bias.any() else motion


def _numbers(solution: Solution) -> _Numbers:
    """Return the components of the shared parameters, then those of the fitted initial states."""
    from scipy.linalg import block_diag  # slow to import
    setup, parameters = solution.problem.setup, solution.problem.setup.parameters
    shared = _Numbers([*parameters.names], parameters.values(solution.physics),
                      parameters.values(setup.given), parameters.scales,
                      np.eye(parameters.size))
    for groups, others in ((['inertia', 'inertia_diagonal'], entries(setup.axial_tensor)),
                           (['rotor_momentum'], setup.start(0).rotor_momentum)):
        columns = parameters.columns(groups)
        shared.values[columns] += others[:len(columns)]
        shared.guesses[columns] += others[:len(columns)]
    starts = [_start(solution, number)[1] for number in range(len(setup.problems))]
    names, *arrays, turns = zip(shared, *filter(None, starts))
    values, guesses, scales = map(np.concatenate, arrays)
    return _Numbers([*chain(*names)], values, guesses, scales, block_diag(*turns))


class _Numbers(NamedTuple):
    """
    Components of the estimated parameters, with their values, guesses and scales.

    Attributes
    ----------
    names : list of str
    values, guesses, scales : array, shape (n,)
    turn : array, shape (n, n)
        Derivatives of the scaled values with respect to the unknowns of the fit.

    """

    names: list[str]
    values: Floats
    guesses: Floats
    scales: Floats
    turn: Floats


def _start(solution: Solution, number: int) -> tuple[State, _Numbers | None]:
    """
    Return the initial state of a recording, and the components of this state.

    The components are None if the initial state was not fitted.
    """
    from scipy.linalg import block_diag
    setup = solution.problem.setup
    guess = setup.start(number)
    momentum = guess.rotor_momentum + solution.physics.value('rotor_momentum')
    k = next(k for k, window in enumerate(solution.problem.windows)
             if window.experiment == number)
    if not solution.problem.windows[k].is_first or not setup.fits_start:
        return replace(guess, rotor_momentum=momentum), None
    attitude, velocity = (solution.problem.reference.attitude[k],
                          solution.problem.reference.angular_velocity[k])
    start = State(guess.time_ns, attitude, velocity, momentum, guess.wheel_speeds)
    ends = [f'.{axis}[{number + 1}]' if number else f'.{axis}' for axis in 'xyz']
    names = [f'initial_angular_velocity{end}' for end in ends]
    values, guesses, scales, turn = (velocity, guess.angular_velocity, np.full(3, setup.rate),
                                     np.eye(3))
    if setup.fits_attitude[number]:
        turned = so3.difference(guess.attitude, attitude)
        names = [*(f'initial_attitude{end}' for end in ends), *names]
        values, guesses = np.append(turned, values), np.append(np.zeros(3), guesses)
        scales = np.append(np.ones(3), scales)
        turn = block_diag(np.linalg.inv(so3.right_jacobian(turned)), turn)
    return start, _Numbers(names, values, guesses, scales, turn)
