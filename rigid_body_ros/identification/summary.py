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

import numpy as np
from rigid_body_ros.identification.residuals import Misfit
from rigid_body_ros.identification.result import Estimate, Identification
from rigid_body_ros.identification.verdict import APPROXIMATE, EXPLAINED, REJECTED, Verdict
from rigid_body_ros.report.text import lines

_MEANINGS = {
    EXPLAINED: 'nothing speaks against the model',
    APPROXIMATE: 'the model lacks something; the intervals are wider by what that may change',
    REJECTED: 'the model does not explain the measurements; do not use the estimates'}
#: Correlations from which on a pair of estimates is listed, and the largest number of pairs.
_CORRELATED, _PAIRS = 0.95, 6
#: Autocorrelation from which on errors are not white.
_COLOURED = 0.2


def summary(fit: Identification) -> str:
    """Return a table of the estimates, and one line for each other fact."""
    verdict = [f'{name:17}{text}' for name, text in verdict_rows(fit.verdict)]
    return lines([*verdict, *_table(fit), *(f'{name:17}{text}' for name, text in rows(fit))])


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


def _table(fit: Identification) -> Iterator[str]:
    width = max([len(name) for name in fit.estimates] + [9])
    yield f'{"parameter":{width}}  {"value":>13}  {"sigma":>9}  {"95 % interval":>27}  ' \
          f'{"guess":>11}  unit'
    for name, one in fit.estimates.items():
        yield f'{name:{width}}  {one.value:13.7g}  {_spread(one)}  {one.start:11.5g}  {one.unit}'


def _spread(one: Estimate) -> str:
    if one.interval_95 is None:
        return f'{"unknown":>9}  {"not determined by the data":>27}'
    low, high = one.interval_95
    return f'{one.sigma:9.2g}  {f"{low:.6g} to {high:.6g}":>27}'


def rows(fit: Identification) -> Iterator[tuple[str, str]]:
    """Generate the facts other than the estimates: names and texts."""
    for direction in fit.unidentifiable:
        yield 'not determined', f'{", ".join(direction.components)}: {direction.reason}'
    for first, second, value in _correlated(fit):
        yield 'correlated', f'{first} and {second}: {value:.4f}'
    for name, level in fit.noise.items():
        unit = 'rad' if 'attitude' in name.split()[1] else 'rad/s'
        yield 'noise', f'{name}: {level:.4g} {unit}, {_colour(fit.autocorrelation[name])}'
    yield from _misfit('training', fit.training)
    if fit.validation:
        yield from _misfit('validation', fit.validation)
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


def _misfit(name: str, one: Misfit) -> Iterator[tuple[str, str]]:
    parts = [f'{one.samples} samples, {one.outliers} outliers']
    if one.attitude_rms is not None:
        parts.append(f'attitude rms {one.attitude_rms:.4g} rad')
    if one.rate_rms is not None:
        parts.append(f'rate rms {one.rate_rms:.4g} rad/s')
    if one.chi2_per_dof is not None:
        parts.append(f'chi-square per degree of freedom {one.chi2_per_dof:.3f}')
    yield name, ', '.join(parts)
