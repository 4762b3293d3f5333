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

"""The result of an identification."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rigid_body_ros.common.arrays import as_json, Floats, symmetric
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.inference.coordinates import second_moments
from rigid_body_ros.inference.errors import Misfit, Residuals, unexplained
from rigid_body_ros.inference.evidence import Direction
from rigid_body_ros.inference.noise import NORMAL_95, with_bound
from rigid_body_ros.inference.residual_torque import residual_torque, ResidualTorque, with_attitude
from rigid_body_ros.inference.verdict import REJECTED, Verdict
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.fields import Field
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.report.text import lines, rounded, scaled
from rigid_body_ros.runtime.limits import read_json

#: The text lists at most `_PAIRS` pairs of estimates whose correlation exceeds `_CORRELATED`.
_CORRELATED, _PAIRS = 0.95, 6
#: The names of the moments of inertia.
_MOMENTS = tuple(f'inertia.i{axis}{axis}' for axis in 'xyz')
#: Errors whose autocorrelation exceeds this limit are reported as not white.
_COLOURED = 0.2


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


def without_effect(estimates: Iterable[Estimate]) -> list[str]:
    """Return a reason against the model for each torque gain whose 95 % interval contains 0."""
    return [f'{one.name}: the interval contains 0: the logged torque has no visible effect'
            + (f' about {one.name[-1]}' if '.' in one.name else '')
            for one in estimates if one.name.startswith('torque_gain') and one.interval_95
            and one.interval_95[0] <= 0.0 <= one.interval_95[1]]


def too_wide(estimates: Iterable[Estimate], scales: Mapping[str, float],
             accept: float | None) -> list[str]:
    """
    Return a reason against the fit for each interval that is too wide to be of use.

    An interval is too wide if its half-width exceeds `accept` times the scale of the estimate, or
    the mean moment for an inertia. The interval of a moment of inertia must not contain 0.
    """
    found = {one.name: one for one in estimates}
    mean = sum(found[name].value for name in _MOMENTS if name in found) / len(_MOMENTS)
    texts = []
    for name, one in found.items():
        half = NORMAL_95 * one.uncertainty
        scale = mean if name.startswith('inertia') else scales[name]
        if not one.identifiable:
            continue
        if accept is not None and half > accept * scale:
            texts.append(f'{name}: the interval is wider than the accepted {accept:g}')
        elif name in _MOMENTS and half >= one.value:
            texts.append(f'{name}: the interval contains 0')
    return texts


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
            one.identifiable for one in self.estimates.values())

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
        attitudes = [one for one in sensors if one.is_attitude and len(one) > 1]
        rates = [one for one in sensors if not one.is_attitude]
        return residual_torque(self.motion, with_attitude(rates[0], attitudes[0])
                               if rates and attitudes else [*rates, *sensors][0])

    @property
    def disturbance(self) -> float | None:
        """Return the rms of `residual_torque` that exceeds its noise, N m; None if unknown."""
        found = self.residual_torque
        if found is None:
            return None
        square = np.mean(np.sum(found.torques ** 2, axis=1)) - np.sum(found.noise ** 2)
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
        known = [self.estimates[name] for name in _MOMENTS if name in self.estimates]
        said = [f'I{one.name[-2:]} = {rounded(one.value, one.uncertainty)} {one.unit} within '
                f'{100.0 * NORMAL_95 * one.uncertainty / one.value:.2g} %'
                for one in known if one.identifiable]
        if len(self.starts) > 1:
            said.append(f'from {len(self.starts)} recordings')
        is_usable = known and self.verdict.level != REJECTED
        return '; '.join([*([', '.join(said)] if is_usable else []), *self.verdict.summary])

    @property
    def noise(self) -> dict[str, float]:
        """Return the standard deviation of the noise for each quantity of each topic."""
        return {one.name: one.noise for one in self.residuals if one.is_training}

    @property
    def autocorrelation(self) -> dict[str, float]:
        """Return the correlation between adjacent fit errors, which is 0 for white noise."""
        return {one.name: one.autocorrelation for one in self.residuals if one.is_training}

    def as_dict(self) -> dict[str, Any]:
        """Return the result as JSON types, with None for numbers that are not finite."""
        return {
            'estimates': {name: {
                'value': one.value, 'unit': one.unit, 'start': one.start,
                'sigma': one.sigma if one.identifiable else None,
                'systematic': one.systematic,
                'interval_95': list(one.interval_95) if one.interval_95 else None,
                'identifiable': one.identifiable} for name, one in self.estimates.items()},
            'unidentifiable': [{'direction': one.components, 'reason': one.reason}
                               for one in self.unidentifiable],
            'guess_attitude_xyzw': self.guess_attitude.tolist(),
            'covariance': {'names': [*self.estimates],
                           'units': [one.unit for one in self.estimates.values()],
                           'matrix': as_json(self.covariance)},
            'correlation': as_json(self.correlation),
            'noise': self.noise, 'autocorrelation': self.autocorrelation,
            'unexplained': {one.name: unexplained([one])[1] for one in self.residuals
                            if one.is_training},
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
            parts = [one.get('systematic', 0.0) for one in estimates.values()]
            found = Saved({name: float(one['value']) for name, one in estimates.items()},
                          {name: one['unit'] for name, one in estimates.items()},
                          np.array(parts, float), np.array(covariance['matrix'], float),
                          State(attitude=data['guess_attitude_xyzw']).attitude,
                          data['converged'], data['verdict']['level'])
            if covariance['names'] != [*estimates] or found.covariance.shape != 2 * (
                    len(estimates),):
                raise ValueError
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            other = f'one without {error}' if isinstance(error, KeyError) else 'another'
            raise InputError(f'{path}: expected a JSON file of attitude_identify, found '
                             f'{other}') from error
        return found

    def text(self, degrees: bool = False) -> str:
        """Return the verdict, a table of the estimates, and one line for each other fact."""
        verdict, facts = ([f'{name:17}{text}' for name, text in rows]
                          for rows in (self.verdict.rows(has_estimates=True), self.rows(degrees)))
        return lines([*verdict, *_aligned(self.table(degrees)), *facts])

    def __str__(self) -> str:
        return self.text()

    def table(self, degrees: bool = False) -> list[list[str]]:
        """
        Return a table with a header row and a row for each estimate.

        The numbers of an estimate are rounded to suit the uncertainty of the estimate.
        """
        every = [['parameter', 'value', 'sigma', 'systematic', '95 % interval', 'guess', 'unit'],
                 *(_cells(one, degrees) for one in self.estimates.values())]
        has_systematic = any(one.systematic for one in self.estimates.values())
        return every if has_systematic else [[*row[:3], *row[4:]] for row in every]

    def rows(self, degrees: bool = False) -> Iterator[tuple[str, str]]:
        """Generate all facts except the verdict and the estimates, each as a name and a text."""
        for direction in self.unidentifiable:
            yield 'not determined', f'{", ".join(direction.components)}: {direction.reason}'
        for first, second, value in _correlated(self):
            yield 'correlated', f'{first} and {second}: {value:.4f}'
        for one in self.residuals:
            if one.is_training and len(self.starts) > 1:
                yield f'recording {one.recording + 1}', \
                    f'{one.topic}: {unexplained([one])[0]} unexplained (rms)'
        for name, level in self.noise.items():
            factor, unit = scaled('rad' if 'attitude' in name.split()[1] else 'rad/s', degrees)
            colour = _colour(self.autocorrelation[name])
            yield 'noise', f'{name}: {factor * level:.4g} {unit}, {colour}'
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


def _aligned(every: Sequence[Sequence[str]]) -> Iterator[str]:
    """Generate the rows of a table as lines of text with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*every)]
    for row in every:
        name, *middle = (f'{cell:>{width}}' if column else f'{cell:{width}}'
                         for column, (cell, width) in enumerate(zip(row[:-1], widths)))
        yield '  '.join([name, *middle, row[-1]])


def _cells(one: Estimate, degrees: bool) -> list[str]:
    factor, unit = scaled(one.unit, degrees)
    value, guess = factor * one.value, f'{factor * one.start:.5g}'
    if one.interval_95 is None:
        return [one.name, rounded(value, math.inf), 'unknown', '', 'not determined by the data',
                guess, unit]
    known = factor * one.uncertainty
    low, high = (rounded(factor * limit, known) for limit in one.interval_95)
    return [one.name, rounded(value, known), rounded(factor * one.sigma, factor * one.sigma),
            rounded(factor * one.systematic, factor * one.systematic), f'{low} to {high}', guess,
            unit]


def _colour(autocorrelation: float) -> str:
    white = abs(autocorrelation) < _COLOURED
    return f'errors {"white" if white else "not white"} (autocorrelation {autocorrelation:.2f})'


def _correlated(fit: Identification) -> list[tuple[str, str, float]]:
    names, matrix = [*fit.estimates], np.triu(np.nan_to_num(fit.correlation), 1)
    pairs = np.argwhere(np.abs(matrix) > _CORRELATED).tolist()
    pairs.sort(key=lambda pair: -abs(matrix[pair[0], pair[1]]))
    return [(names[i], names[j], float(matrix[i, j])) for i, j in pairs[:_PAIRS]]


def _misfit(name: str, one: Misfit, degrees: bool) -> Iterator[tuple[str, str]]:
    parts = [f'{one.samples} samples, {one.outliers} outliers']
    for quantity, rms, unit in (('attitude', one.attitude_rms, 'rad'),
                                ('rate', one.rate_rms, 'rad/s')):
        if rms is not None:
            factor, unit = scaled(unit, degrees)
            parts.append(f'{quantity} rms {factor * rms:.4g} {unit}')
    if one.chi2_per_dof is not None:
        parts.append(f'chi-square per degree of freedom {one.chi2_per_dof:.3f}')
    yield name, ', '.join(parts)
