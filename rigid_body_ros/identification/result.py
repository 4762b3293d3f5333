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

"""The result of an identification, with its text, its JSON data and its report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import as_json, Floats, symmetric
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.inference.coordinates import second_moments
from rigid_body_ros.inference.errors import correlations, Misfit, Residuals, unexplained
from rigid_body_ros.inference.evidence import Direction
from rigid_body_ros.inference.noise import NORMAL_95, with_bound
from rigid_body_ros.inference.residual_torque import (
    residual_panels,
    residual_torque,
    ResidualTorque,
    with_attitude,
)
from rigid_body_ros.inference.verdict import REJECTED, Verdict
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.fields import Field
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.report import moving_body
from rigid_body_ros.report.charts import Curves, Panel, SIGNED
from rigid_body_ros.report.panels import Drawn, in_degrees, quantity_panels, torque_panels
from rigid_body_ros.report.report import matrix, Report, table
from rigid_body_ros.report.text import aligned, lines, rounded, scaled
from rigid_body_ros.runtime.limits import read_json

#: The text lists at most `_PAIRS` pairs of estimates whose correlation exceeds `_CORRELATED`.
_CORRELATED, _PAIRS = 0.95, 6
#: The names of the moments of inertia.
MOMENTS = tuple(f'inertia.i{axis}{axis}' for axis in 'xyz')
#: Errors whose autocorrelation exceeds this limit are reported as not white.
_COLOURED = 0.2
#: Largest lag in the plot of an autocorrelation, s, and minimum number of lags in that plot.
_LAG, _FEWEST = 2.0, 20


@dataclass(frozen=True)
class Estimate:
    """
    The estimate of one number.

    Attributes
    ----------
    name, unit : str
    value, start : float
        The estimate, and the initial guess.
    sigma : float
        Standard deviation of the estimate. Infinite if the data does not determine the number.
    identifiable : bool
        Whether the data determines the number.
    systematic : float
        Largest error that effects missing from the model may cause in the estimate, or 0 if the
        model explains the measurements.

    """

    name: str
    unit: str
    value: float
    start: float
    sigma: float
    identifiable: bool
    systematic: float = 0.0

    @property
    def interval_95(self) -> tuple[float, float] | None:
        """Return the limits of the 95 % interval, or None if the number is not determined."""
        half = NORMAL_95 * self.uncertainty
        return (self.value - half, self.value + half) if self.identifiable else None

    @property
    def uncertainty(self) -> float:
        """
        Return the standard uncertainty of the estimate, including systematic errors.

        This is the standard deviation of a normal variable that has the same 95 % interval.
        """
        return float(with_bound(self.sigma, self.systematic))

    def as_dict(self) -> dict[str, Any]:
        """Return the estimate as JSON types, with None for what the data does not determine."""
        return {'value': self.value, 'unit': self.unit, 'start': self.start,
                'sigma': self.sigma if self.identifiable else None,
                'systematic': self.systematic,
                'interval_95': list(self.interval_95) if self.interval_95 else None,
                'identifiable': self.identifiable}


class Saved(NamedTuple):
    """The parts of an `Identification` that `Identification.load` reads from a JSON file."""

    #: The estimates by component name, the unit of each, and the systematic part of each interval.
    values: dict[str, float]
    units: dict[str, str]
    systematic: Floats
    covariance: Floats
    guess_attitude: Floats
    converged: bool
    #: The level of the verdict.
    level: str


@dataclass(frozen=True, eq=False)
class Identification:
    """
    The parameters of a body, as estimated by `identify`.

    Attributes
    ----------
    body : RigidBody
        The body with the estimated inertia and damping.
    fields : list of Field
        The fields of the first recording with their estimated moments, followed by the weight if
        it was estimated.
    starts : list of State
        The initial state of each recording, estimated if 'start' was fitted.
    estimates : dict of str to Estimate
        The estimates, keyed by component name.
    covariance : array, shape (n, n)
        Covariance of the estimates in their own units. NaN for estimates that are not
        identifiable.
    guess_attitude : array, shape (4,)
        The initial attitude given for the first recording, as a quaternion x, y, z, w. The
        estimate `initial_attitude` is the rotation vector, in body axes, that leads from this
        attitude to the estimated one.
    unidentifiable : list of Direction
        Combinations of parameters that the data does not determine.
    residuals : list of Residuals
        The errors of the samples that the fit used and of those held back for validation.
    training : Misfit
        How well the model fits the samples that the fit used.
    validation : Misfit or None
        How well the model predicts the samples held back for validation.
    window_s : float, s
        Length of the windows into which the fit divides each recording. The state at the beginning
        of each window is fitted separately.
    evaluations : int
        Number of function evaluations, counted over all fits.
    converged : bool
        Whether the fit converged.
    verdict : Verdict
        Whether the model explains the measurements.
    has_torque : bool
        Whether any logged torque is nonzero.
    predictable_s : float or None, s
        Time since the start at which the standard deviation of the predicted attitude first
        exceeds 0.1 rad in any recording. None if this never happens, or if there is no validation.
    motion : Problem
        The motion of the first recording according to all estimates.
    aligned : list of Measured
        The measurements of the first recording without outliers, converted to the torque clock and
        to body axes. Each element contains one quantity of one topic.

    """

    body: RigidBody
    fields: list[Field]
    starts: list[State]
    estimates: dict[str, Estimate]
    covariance: Floats
    guess_attitude: Floats
    unidentifiable: list[Direction]
    residuals: list[Residuals]
    training: Misfit
    validation: Misfit | None
    window_s: float
    evaluations: int
    converged: bool
    verdict: Verdict
    has_torque: bool
    predictable_s: float | None
    motion: Problem
    aligned: list[Measured]

    @property
    def is_complete(self) -> bool:
        """Return whether the fit converged and the data determines every estimate."""
        return self.converged and not self.unidentifiable and all(
            estimate.identifiable for estimate in self.estimates.values())

    @property
    def correlation(self) -> Floats:
        """Return the correlation matrix of the estimates, with NaN for unidentifiable ones."""
        sigma = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid='ignore'):  # the division is 0 / 0 if all errors are zero
            return self.covariance / np.outer(sigma, sigma)

    @property
    def holds_for_exact_torque(self) -> bool:
        """Return whether the estimated inertia is correct only if the logged torque is exact."""
        return self.has_torque and 'inertia.ixx' in self.estimates and not any(
            name.startswith('torque_gain') for name in self.estimates)

    @property
    def is_flat(self) -> bool:
        """Return whether the body could be a flat plate or a thin rod, given the uncertainty."""
        names = [name for name in self.estimates if name.startswith('inertia.')]
        if not names:
            return False
        smallest, vectors = np.linalg.eigh(second_moments(self.body.inertia))
        rows = [[*self.estimates].index(name) for name in names]
        slopes = np.array([0.5 * np.trace(unit) - vectors[:, 0] @ unit @ vectors[:, 0]
                           for unit in map(symmetric, np.eye(6)[:len(names)])])
        variance = slopes @ self.covariance[np.ix_(rows, rows)] @ slopes
        return bool(smallest[0] <= np.sqrt(variance))

    @cached_property
    def residual_torque(self) -> ResidualTorque | None:
        """Return the torque that the first recording leaves unexplained, or None if too short."""
        sensors = sorted(self.aligned, key=len, reverse=True)
        attitudes = [sensor for sensor in sensors if sensor.is_attitude and len(sensor) > 1]
        rates = [sensor for sensor in sensors if not sensor.is_attitude]
        return residual_torque(self.motion, with_attitude(rates[0], attitudes[0])
                               if rates and attitudes else [*rates, *sensors][0])

    @property
    def disturbance(self) -> float | None:
        """Return the rms of `residual_torque` that exceeds its noise, N m; None if unknown."""
        torque = self.residual_torque
        if torque is None:
            return None
        square = np.mean(np.sum(torque.torques ** 2, axis=1)) - np.sum(torque.noise ** 2)
        return float(np.sqrt(max(square, 0.0)))

    def errors_of(self, recording: int) -> list[list[Residuals]]:
        """Return the errors of each quantity in a recording, validation samples last."""
        quantities: dict[str, list[Residuals]] = {}
        for errors in self.residuals:
            if errors.recording == recording and errors.inliers.any():
                quantities.setdefault(errors.name, []).append(errors)
        return [*quantities.values()]

    @property
    def headline(self) -> str:
        """Return the verdict and the estimated moments of inertia in one sentence."""
        moments = [self.estimates[name] for name in MOMENTS if name in self.estimates]
        said = [f'I{moment.name[-2:]} = {rounded(moment.value, moment.uncertainty)} {moment.unit} '
                f'within {100.0 * NORMAL_95 * moment.uncertainty / moment.value:.2g} %'
                for moment in moments if moment.identifiable]
        if len(self.starts) > 1:
            said.append(f'from {len(self.starts)} recordings')
        is_usable = moments and self.verdict.level != REJECTED
        return '; '.join([*([', '.join(said)] if is_usable else []), *self.verdict.summary])

    @property
    def noise(self) -> dict[str, float]:
        """Return the standard deviation of the noise for each quantity of each topic."""
        return {part.name: part.noise for part in self.residuals if part.is_training}

    @property
    def autocorrelation(self) -> dict[str, float]:
        """Return the correlation between adjacent fit errors, which is 0 for white noise."""
        return {part.name: part.autocorrelation for part in self.residuals if part.is_training}

    def as_dict(self) -> dict[str, Any]:
        """Return the result as JSON types, with None for numbers that are not finite."""
        return {
            'estimates': {name: estimate.as_dict() for name, estimate in self.estimates.items()},
            'unidentifiable': [{'direction': direction.components, 'reason': direction.reason}
                               for direction in self.unidentifiable],
            'guess_attitude_xyzw': self.guess_attitude.tolist(),
            'covariance': {'names': [*self.estimates],
                           'units': [estimate.unit for estimate in self.estimates.values()],
                           'matrix': as_json(self.covariance)},
            'correlation': as_json(self.correlation),
            'noise': self.noise, 'autocorrelation': self.autocorrelation,
            'unexplained': {part.name: unexplained([part])[1] for part in self.residuals
                            if part.is_training},
            'window_s': self.window_s, 'predictable_s': self.predictable_s,
            'training': self.training.as_dict(),
            'validation': self.validation.as_dict() if self.validation else None,
            'verdict': self.verdict.as_dict(), 'disturbance_torque_N_m': self.disturbance,
            'evaluations': self.evaluations, 'converged': self.converged}

    @staticmethod
    def load(path: str | Path) -> Saved:
        """Read a file of what `as_dict` returned; raise InputError if it is another file."""
        data = read_json(path, 'estimates')
        try:
            estimates, covariance = data['estimates'], data['covariance']
            parts = [estimate.get('systematic', 0.0) for estimate in estimates.values()]
            saved = Saved({name: float(part['value']) for name, part in estimates.items()},
                          {name: part['unit'] for name, part in estimates.items()},
                          np.array(parts, float), np.array(covariance['matrix'], float),
                          State(attitude=data['guess_attitude_xyzw']).attitude,
                          data['converged'], data['verdict']['level'])
            if covariance['names'] != [*estimates] or saved.covariance.shape != 2 * (
                    len(estimates),):
                raise ValueError
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            other = f'one without {error}' if isinstance(error, KeyError) else 'another'
            raise InputError(f'{path}: expected a JSON file of attitude_identify, found '
                             f'{other}') from error
        return saved

    def text(self, degrees: bool = False) -> str:
        """Return the verdict, a table of the estimates, and one line for each other fact."""
        verdict, facts = ([f'{name:17}{text}' for name, text in rows]
                          for rows in (self.verdict.rows(has_estimates=True), self.rows(degrees)))
        return lines([*verdict, *aligned(self.table(degrees)), *facts])

    __str__ = text

    def table(self, degrees: bool = False) -> list[list[str]]:
        """
        Return a table with a header row and a row for each estimate.

        The numbers of an estimate are rounded to suit the uncertainty of the estimate.
        """
        rows = [['parameter', 'value', 'sigma', 'systematic', '95 % interval', 'guess', 'unit'],
                *(_cells(estimate, degrees) for estimate in self.estimates.values())]
        has_systematic = any(estimate.systematic for estimate in self.estimates.values())
        return rows if has_systematic else [[*row[:3], *row[4:]] for row in rows]

    def rows(self, degrees: bool = False) -> Iterator[tuple[str, str]]:
        """Generate all facts except the verdict and the estimates, each as a name and a text."""
        for direction in self.unidentifiable:
            yield 'not determined', f'{", ".join(direction.components)}: {direction.reason}'
        for first, second, value in _correlated(self):
            yield 'correlated', f'{first} and {second}: {value:.4f}'
        training = [part for part in self.residuals if part.is_training]
        for part in training if len(self.starts) > 1 else []:
            yield f'recording {part.recording + 1}', \
                f'{part.topic}: {unexplained([part])[0]} unexplained (rms)'
        for part in training:
            factor, unit = scaled('rad' if part.is_attitude else 'rad/s', degrees)
            colour = 'white' if abs(part.autocorrelation) < _COLOURED else 'not white'
            yield 'noise', f'{part.name}: {factor * part.noise:.4g} {unit}, errors {colour} ' \
                           f'(autocorrelation {part.autocorrelation:.2f})'
        yield from _misfit('training', self.training, degrees)
        if self.validation:
            yield from _misfit('validation', self.validation, degrees)
        if self.predictable_s is not None:
            yield 'predictable', f'for {self.predictable_s:.4g} s from the start; later errors ' \
                                 'say nothing about the model'
        if not self.verdict.is_consistent and self.disturbance:
            yield 'disturbance', f'a torque of {self.disturbance:.2g} N m (rms) would explain ' \
                                 'what is left'
        if self.is_flat:
            yield 'warning', 'the fitted body is a flat plate or a thin rod within its ' \
                             'uncertainty: the intervals reach beyond possible bodies'
        if self.holds_for_exact_torque:
            yield 'note', 'the intervals hold for an exactly known torque: an error of its gain ' \
                          'changes the inertia by the same factor (--estimate torque_gain, ' \
                          'with --prior torque_gain=SIGMA)'
        state = 'converged' if self.converged else 'did not converge'
        yield 'fit', f'{state} after {self.evaluations} evaluations, in windows of ' \
                     f'{self.window_s:.4g} s'


def _cells(estimate: Estimate, degrees: bool) -> list[str]:
    name, interval, (factor, unit) = (estimate.name, estimate.interval_95,
                                      scaled(estimate.unit, degrees))
    value, guess = factor * estimate.value, f'{factor * estimate.start:.5g}'
    if interval is None:
        return [name, rounded(value, math.inf), 'unknown', '', 'not determined by the data',
                guess, unit]
    spread, sigma, systematic = (factor * size for size in (
        estimate.uncertainty, estimate.sigma, estimate.systematic))
    limits = ' to '.join(rounded(factor * limit, spread) for limit in interval)
    return [name, rounded(value, spread), rounded(sigma, sigma), rounded(systematic, systematic),
            limits, guess, unit]


def _correlated(fit: Identification) -> list[tuple[str, str, float]]:
    names, matrix = [*fit.estimates], np.triu(np.nan_to_num(fit.correlation), 1)
    pairs = np.argwhere(np.abs(matrix) > _CORRELATED).tolist()
    pairs.sort(key=lambda pair: -abs(matrix[pair[0], pair[1]]))
    return [(names[i], names[j], float(matrix[i, j])) for i, j in pairs[:_PAIRS]]


def _misfit(name: str, misfit: Misfit, degrees: bool) -> Iterator[tuple[str, str]]:
    parts = [f'{misfit.samples} samples, {misfit.outliers} outliers']
    for quantity, rms, unit in (('attitude', misfit.attitude_rms, 'rad'),
                                ('rate', misfit.rate_rms, 'rad/s')):
        if rms is not None:
            factor, unit = scaled(unit, degrees)
            parts.append(f'{quantity} rms {factor * rms:.4g} {unit}')
    if misfit.chi2_per_dof is not None:
        parts.append(f'chi-square per degree of freedom {misfit.chi2_per_dof:.3f}')
    yield name, ', '.join(parts)


def report_of(fit: Identification, first: Problem, name: str, degrees: bool = False) -> Report:
    """
    Return the report of an identification.

    Parameters
    ----------
    fit : Identification
        The result, with at least one sample.
    first : Problem
        The problem of the first recording, whose motion, errors and torques the report shows.
    name : str
        Name of the first recording.
    degrees : bool
        Whether to show angles in degrees.

    """
    story = [('recording', name), *fit.verdict.rows(has_estimates=True), *fit.rows(degrees),
             ('moving body', 'the motion with all estimates')]
    training_ns = np.concatenate([part.stamps_ns for part in fit.residuals
                                  if part.is_training and not part.recording])
    if 1e-9 * np.ptp(training_ns) > 1.5 * fit.window_s:
        story.append(('computed curves', f'begin again every {fit.window_s:.3g} s in the part '
                                         'that was fitted, with the state that fits best'))
    panels, (header, *estimated) = [*_panels(fit, first)], fit.table(degrees)
    attitudes = next(((sensor.stamps_ns, sensor.values) for sensor in fit.aligned
                      if sensor.is_attitude), None)
    body = moving_body.of_motion(fit.motion, _stamps_ns(fit), attitudes)
    return Report(f'{name}: estimated parameters', fit.headline, story,
                  [*map(in_degrees, panels)] if degrees else panels, body,
                  table=table(header, estimated), matrix=matrix(
                      'correlation of the estimates (orange: positive, blue: negative)',
                      [*fit.estimates], fit.correlation) if fit.estimates else '')


def _panels(fit: Identification, first: Problem) -> Iterator[Panel]:
    quantities = fit.errors_of(0)
    if not quantities:
        return
    start_ns = int(_stamps_ns(fit)[0])
    for parts in quantities:
        lines = _lines(fit, parts, start_ns)
        yield from (replace(panel, lines=lines) for panel in _of_channel(parts, start_ns))
    end_ns = max(int(part.stamps_ns[-1]) for parts in quantities for part in parts)
    yield from torque_panels(first.acting_logs, start_ns, end_ns, fit.motion.options.timeout_ns)
    if fit.residual_torque:
        yield from residual_panels(fit.residual_torque, fit.aligned, start_ns)
    for parts in quantities:
        yield from _correlations(parts[0])
    for number in range(1, len(fit.starts)):
        for parts in fit.errors_of(number):
            yield from _of_channel(parts, int(_stamps_ns(fit, number)[0]))


def _stamps_ns(fit: Identification, recording: int = 0) -> NDArray[np.int64]:
    """Return the stamps of all samples of a recording."""
    return np.unique(np.concatenate([
        part.stamps_ns for part in fit.residuals if part.recording == recording]))


def _of_channel(parts: Sequence[Residuals], start_ns: int) -> Iterator[Panel]:
    """Return one panel with the measured and computed values, and one with the errors."""
    stamps_ns, inliers, measured, computed, errors = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ('stamps_ns', 'inliers', 'measured', 'computed', 'errors'))
    first = parts[0]
    where = f'recording {first.recording + 1}, {first.topic}' if first.recording else first.topic
    return quantity_panels(where, 'axes of the sensor', Drawn(stamps_ns, inliers), measured,
                           computed, ('computed minus measured', errors),
                           ('±2 sigma assumed by the fit', 2.0 * first.noise), start_ns)


def _lines(fit: Identification, parts: Sequence[Residuals], start_ns: int) -> dict[str, float]:
    """
    Return the times to mark in the plots, s, keyed by their labels.

    One is the time at which the validation begins. The other is the time at which the motion
    becomes unpredictable.
    """
    ahead = [part for part in parts if not part.is_training]
    lines = {}
    if ahead:
        lines['start of the validation'] = 1e-9 * float(ahead[0].stamps_ns[0] - start_ns)
    if ahead and fit.predictable_s is not None:
        lines['predictable up to here'] = fit.predictable_s + 1e-9 * (
            fit.motion.start.time_ns - start_ns)
    return lines


def _correlations(errors: Residuals) -> Iterator[Panel]:
    """Generate a panel with the autocorrelation of a channel's fit errors."""
    if len(errors.stamps_ns) < 4 * _FEWEST or not errors.is_training:
        return
    spacing = 1e-9 * float(np.median(np.diff(errors.stamps_ns)))
    last = max(_FEWEST, round(_LAG / spacing))
    values = correlations(errors.errors, errors.inliers)[1:last + 1]
    lags = np.arange(1, len(values) + 1) * spacing
    limit: Floats = np.full((2, 1), NORMAL_95 / np.sqrt(errors.inliers.sum()))
    quantity = 'attitude' if errors.is_attitude else 'rate'
    yield Panel(f'{errors.topic}: autocorrelation of the {quantity} errors of the fit', '', [
        Curves(np.asarray(lags, np.float64), values, values, SIGNED),
        Curves(np.asarray(lags[[0, -1]], np.float64), -limit, limit,
               ['95 % limits of white noise'], style='limits')],
        'lag (s)')
