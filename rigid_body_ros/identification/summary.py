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

"""Summarize an identification as text."""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np
from rigid_body_ros.identification.residuals import Misfit
from rigid_body_ros.identification.result import Estimate, Identification
from rigid_body_ros.identification.verdict import APPROXIMATE, EXPLAINED, REJECTED, Verdict
from rigid_body_ros.report.text import lines, rounded, scaled

_MEANINGS = {
    EXPLAINED: 'nothing speaks against the model',
    APPROXIMATE: 'the model lacks something; the intervals are wider by what that may change',
    REJECTED: 'the model does not explain the measurements; do not use the estimates'}
#: Correlations from which on a pair of estimates is listed, and the largest number of pairs.
_CORRELATED, _PAIRS = 0.95, 6
#: Autocorrelation from which on errors are not white.
_COLOURED = 0.2


def summary(fit: Identification, degrees: bool = False) -> str:
    """Return a table of the estimates, and one line for each other fact."""
    verdict = [f'{name:17}{text}' for name, text in verdict_rows(fit.verdict)]
    return lines([*verdict, *_table(fit, degrees),
                  *(f'{name:17}{text}' for name, text in rows(fit, degrees))])


def verdict_rows(verdict: Verdict) -> Iterator[tuple[str, str]]:
    """Generate whether the model explains the measurements, why not, and what would."""
    yield 'verdict', f'{verdict.level}: {_MEANINGS[verdict.level]}'
    for reason in verdict.reasons:
        yield 'reason', reason
    for one in verdict.suspects:
        values = ', '.join(f'{value:.4g}' for value in one.value)
        ahead = '' if one.validation_chi2_per_dof is None else \
            f', chi-square of the validation {one.validation_chi2_per_dof:.3g}'
        yield 'suspect', f'{one.name} ({values}): chi-square falls by {one.chi2_drop:.4g}' \
                         f'{ahead}; {one.command}'


def _table(fit: Identification, degrees: bool) -> Iterator[str]:
    every = estimates(fit, degrees)
    widths = [max(map(len, column)) for column in zip(*every)]
    for row in every:
        name, *middle = (f'{cell:>{width}}' if column else f'{cell:{width}}'
                         for column, (cell, width) in enumerate(zip(row[:-1], widths)))
        yield '  '.join([name, *middle, row[-1]])


def estimates(fit: Identification, degrees: bool) -> list[list[str]]:
    """Return titles, and the texts of each estimate; values are rounded to their sigma."""
    every = [['parameter', 'value', 'sigma', 'systematic', '95 % interval', 'guess', 'unit'],
             *(_cells(one, degrees) for one in fit.estimates.values())]
    has_systematic = any(one.systematic for one in fit.estimates.values())
    return every if has_systematic else [[*row[:3], *row[4:]] for row in every]


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


def rows(fit: Identification, degrees: bool = False) -> Iterator[tuple[str, str]]:
    """Generate the facts other than the estimates: names and texts."""
    for direction in fit.unidentifiable:
        yield 'not determined', f'{", ".join(direction.components)}: {direction.reason}'
    for first, second, value in _correlated(fit):
        yield 'correlated', f'{first} and {second}: {value:.4f}'
    for name, level in fit.noise.items():
        factor, unit = scaled('rad' if 'attitude' in name.split()[1] else 'rad/s', degrees)
        yield 'noise', f'{name}: {factor * level:.4g} {unit}, {_colour(fit.autocorrelation[name])}'
    yield from _misfit('training', fit.training, degrees)
    if fit.validation:
        yield from _misfit('validation', fit.validation, degrees)
    if fit.predictable_s is not None:
        yield 'predictable', f'for {fit.predictable_s:.4g} s from the start; later errors say ' \
                             'nothing about the model'
    if fit.is_flat:
        yield 'warning', 'the fitted body is a flat plate or a thin rod within its uncertainty: ' \
                         'the intervals reach beyond possible bodies'
    if fit.holds_for_exact_torque:
        yield 'note', 'the intervals hold for an exactly known torque: an error of its gain is ' \
                      'one of the inertia (--estimate torque_gain, with --prior torque_gain=SIGMA)'
    state = 'converged' if fit.converged else 'did not converge'
    yield 'fit', f'{state} after {fit.evaluations} evaluations, in windows of ' \
                 f'{fit.window_s:.4g} s'


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
