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

"""The result of a measured trade-off, with its text, its JSON data and its report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import metadata
import math
import platform
from typing import Any

import numpy as np
from rigid_body_ros.report.charts import Curves, Panel
from rigid_body_ros.report.report import Report
from rigid_body_ros.report.text import lines
from rigid_body_ros.tradeoff.choices import Choice, Measurement, OnWhole
from rigid_body_ros.tradeoff.problem import Case, CLEARLY, InterpolationError, Reference

_WIDTH = 18
#: Descriptions of the rounding floor. The first one is for motions without rotors, damping and
#: fields, the second one for all other motions.
_FLOORS = (
    ('largest difference between runs that round differently: the series with other steps,',
     'in principal axes and, without torque, the closed form; it does not show an error '
     'common to all'),
    ('largest difference between runs that round differently: the series with other steps;',
     'it does not show an error common to all'))
_DIGITS = 'a change of the last digit of inertia, torque or start moves the attitude by {:.1e} rad'
_LIMITS = {'rounding': 'rounding: a tighter setting does not help',
           'last digits': 'the last digits of inertia, torque and start: a tighter setting does '
                          'not help',
           'solver': 'the solver: a tighter setting is more accurate'}
_HEADER = ('', 'solver', 'setting', 'final rad', 'largest rad', 'rad/s', 'momentum', 'energy',
           's per s', 'x real time')
_ROW = '{:1} {:14} {:>17} {:>10} {:>11} {:>9} {:>9} {:>9} {:>9} {:>11}'


@dataclass(frozen=True, eq=False)
class Tradeoff:
    """
    All measurements, and the recommended setting for each target.

    Attributes
    ----------
    stretch, whole : Case
    angle : float
        Angle through which the body turns over the stretch, rad.
    measurements : tuple of Measurement
        The measurements on the stretch.
    reference : Reference
        The reference of the stretch.
    interpolation_errors : tuple of InterpolationError
        The interpolation errors, estimated on the stretch.
    interpolation_differences : dict
        How much the final attitude changes, rad, with each of the other interpolations. The keys
        are the names of the interpolations; see `final_differences`.
    choices : dict
        The recommended setting for each target (rad), or None if no setting meets the target.
    error_on_whole : OnWhole
        A function that returns the attitude error of a measurement on the whole log; see
        `recommend`.

    """

    stretch: Case
    whole: Case
    angle: float
    measurements: tuple[Measurement, ...]
    reference: Reference
    interpolation_errors: tuple[InterpolationError, ...]
    interpolation_differences: Mapping[str, float | None]
    choices: Mapping[float, Choice | None]
    error_on_whole: OnWhole

    @property
    def interpolation_error(self) -> InterpolationError | None:
        """
        Return the error of the scene's interpolation.

        Return None if the error could not be estimated.
        """
        return next((error for error in self.interpolation_errors
                     if error.interpolation == self.stretch.interpolation), None)

    @property
    def better_interpolation(self) -> InterpolationError | None:
        """
        Return the best interpolation if it is clearly better than the scene's interpolation.

        Otherwise, return None.
        """
        own = self.interpolation_error
        best = min(self.interpolation_errors, key=lambda error: error.estimate, default=None)
        return best if own and best and best.estimate < CLEARLY * own.estimate else None

    def dominant(self, target: float, held: bool = False) -> str:
        """
        Return the largest source of error for the recommended setting.

        If no setting is recommended, the setting with the smallest error is used instead. If
        `held` is true, the torque is assumed to be constant between samples, so that interpolation
        causes no error.
        """
        floor, own = self.reference.floor, self.interpolation_error
        choice = self.choices[target]
        errors = [run.error.attitude for run in self.measurements if not run.failure]
        solver = choice.measurement.error.attitude if choice else min(errors, default=math.inf)
        shares = {'rounding': floor, 'solver': solver, 'last digits': self.reference.last_digits,
                  'interpolation': own.estimate if own and not held else 0.0}
        # A solver error that is close to the floor is really a rounding error.
        if solver <= 2.0 * floor:
            shares['solver'] = 0.0
        return max(shares, key=lambda name: shares[name])

    def text(self, all_rows: bool = False) -> str:
        """
        Format the recommended settings, the table and the limits of accuracy as text.

        Parameters
        ----------
        all_rows : bool
            Whether to list all settings in the table, rather than only the Pareto-optimal ones.

        """
        recommended = [text for target in self.choices for text in _recommended(self, target)]
        return lines([*recommended, *_table(self, all_rows), '', *map(_pair, _facts(self))])

    __str__ = text

    def rows(self) -> Iterator[tuple[str, str]]:
        """Generate the result for each target, followed by the limits of accuracy."""
        for target, choice in self.choices.items():
            setting = f'{", ".join(choice.measurement.setting.parameters)}: ' if choice else ''
            yield 'target', f'{target:.3g} rad'
            yield 'recommended', setting + _expected(self, target)
            yield from _limits(self, target)
        yield from _facts(self)

    def as_dict(self) -> dict[str, Any]:
        """Return all results as JSON types, with units in the keys."""
        span = self.stretch.seconds
        targets = [_target_data(self, target) for target in self.choices]
        return {
            'machine': platform.platform(),
            'processor': platform.processor() or platform.machine(),
            'versions': {'python': platform.python_version(), 'numpy': metadata.version('numpy')},
            'stretch_s': span, 'stretch_angle_rad': self.angle, 'whole_s': self.whole.seconds,
            'samples': self.stretch.samples, 'outputs': len(self.stretch.times_ns),
            'interpolation': self.stretch.interpolation,
            'torque_free': self.stretch.torque_free,
            'rounding_floor_rad': self.reference.floor,
            'rounding_floor_is': ' '.join(_FLOORS[self.stretch.has_terms]),
            'last_digit_effect_rad': self.reference.last_digits,
            **targets[0], 'targets': targets,
            'readings': [{'interpolation': error.interpolation,
                          'thinned_by_two_rad': error.thinned,
                          'estimated_error_rad': error.estimate}
                         for error in self.interpolation_errors],
            'interpolation_differences_rad': dict(self.interpolation_differences),
            'runs': [run.as_dict(span) for run in self.measurements]}

    def curves(self) -> dict[str, tuple[list[float], list[float]]]:
        """
        Return the points on the curve of each solver, in the order of the solver's settings.

        Errors below the rounding floor are not significant, so they are replaced by the floor.

        Returns
        -------
        dict
            For each solver, a list of its largest attitude errors, rad, and a list of its costs, s
            per simulated second.

        """
        curves: dict[str, tuple[list[float], list[float]]] = {}
        for run in self.measurements:
            if not run.failure:
                errors, costs = curves.setdefault(run.setting.solver, ([], []))
                errors.append(max(run.error.attitude, self.reference.floor))
                costs.append(run.seconds / self.stretch.seconds)
        return curves

    def reference_errors(self) -> dict[str, float]:
        """
        Return the errors, rad, that a plot marks with lines, ascending and keyed by label.

        Errors below the rounding error of 1 have no meaning, so they are replaced by it.
        """
        least = math.ulp(1.0)
        errors = {'rounding floor': self.reference.floor,
                  'last-digit effect': self.reference.last_digits}
        if own := self.interpolation_error:
            errors[f'{own.interpolation} interpolation'] = own.estimate
        lines = [(f'{name} {max(error, least):.0e} rad', error) for name, error in errors.items()]
        lines += [(f'target {target:g} rad', target) for target in self.choices]
        return {label: max(error, least)
                for label, error in sorted(lines, key=lambda line: line[1])}


def _recommended(result: Tradeoff, target: float) -> Iterator[str]:
    """Generate the lines of the text about a target; the lines of its setting can be copied."""
    choice = result.choices[target]
    yield _pair(('target', f'{target:.3g} rad'))
    yield _pair(('recommended', f'{_expected(result, target)}{":" if choice else ""}'))
    yield from (f'    {line}' for line in choice.measurement.setting.parameters) if choice else ()
    yield from (*map(_pair, _limits(result, target)), '')


def _expected(result: Tradeoff, target: float) -> str:
    choice = result.choices[target]
    if not choice:
        return f'none: no setting is certain to meet it, {_why(result, target)}'
    how = 'measured on the whole motion' if choice.measured else \
        'scaled from the measured beginning to the whole motion by the square of the time'
    speed = result.stretch.seconds / choice.measurement.seconds
    return f'{choice.error:.1e} rad ({how}), {speed:.3g} times real time'


def _why(result: Tradeoff, target: float) -> str:
    """
    Explain why no setting is sure to meet a target.

    The explanation names the part of the motion to which it applies.
    """
    reference, of_whole = result.reference, result.error_on_whole.reference
    part = '' if result.stretch is result.whole else \
        f' in the first {result.stretch.seconds:.9g} s'
    if reference.guaranteed_error <= target and of_whole and of_whole is not reference:
        reference, part = of_whole, ' on the whole motion'
    if reference.guaranteed_error <= target:
        return _smallest(result, target, part)
    if reference.floor >= reference.last_digits:
        return f'the rounding floor is {reference.floor:.1e} rad{part}'
    return _DIGITS.format(reference.last_digits) + part


def _smallest(result: Tradeoff, target: float, part: str) -> str:
    """Describe the smallest error of all settings, on the stretch or on the whole motion."""
    least = min(run.error.attitude for run in result.measurements if not run.failure)
    least += result.reference.guaranteed_error
    measured = result.error_on_whole.least
    if least > target:
        return f'the smallest error is {least:.1e} rad{part}'
    if measured is not None:
        return f'the smallest error is {measured:.1e} rad on the whole motion'
    scaled = least * (result.whole.seconds / result.stretch.seconds) ** 2
    return f'the smallest error is {least:.1e} rad{part}, and {scaled:.1e} rad scaled to the ' \
           'whole motion by the square of the time'


def _limits(result: Tradeoff, target: float) -> Iterator[tuple[str, str]]:
    """
    Generate rows that tell what limits the accuracy.

    There is one row, or two rows if the interpolation is 'hold'.
    """
    dominant, own = result.dominant(target), result.interpolation_error
    if dominant != 'interpolation' or not own:
        yield 'limited by', _LIMITS[dominant]
        return
    better = result.better_interpolation
    remedy = f'use {better.interpolation} (about {better.estimate:.1e} rad)' \
        if better else 'only more closely spaced samples help'
    varies = f'the {own.interpolation} interpolation between torque samples (about ' \
             f'{own.estimate:.1e} rad): {remedy}'
    if own.interpolation != 'hold':
        yield 'limited by', varies
        return
    yield 'limited by', 'if the actuator holds the torque between its samples, ' \
                        f'{_LIMITS[result.dominant(target, held=True)]};'
    yield '', f'if the torque varies between them, {varies}'


def _table(result: Tradeoff, all_rows: bool) -> list[str]:
    optimal = [run for run in result.measurements if run.pareto_optimal]
    shown = result.measurements if all_rows else sorted(optimal, key=lambda run: run.seconds)
    hidden = len(result.measurements) - len(shown)
    note = f'; --all prints the other {hidden} settings' if hidden else ''
    rows = [_line(run, result.stretch.seconds) for run in shown]
    return [_ROW.format(*_HEADER), *rows,
            f'* Pareto-optimal: no setting is both faster and more accurate{note}']


def _facts(result: Tradeoff) -> list[tuple[str, str]]:
    reference, (floor, rest) = result.reference, _FLOORS[result.stretch.has_terms]
    drift = 'largest change since the start, relative' if result.stretch.conserves else \
        'largest difference from the reference, relative to its largest value'
    return [('motion', _motion(result)),
            ('errors', 'difference from the Taylor series at its tightest tolerance with shorter '
                       'steps'),
            ('drift', f'momentum and energy: {drift}'),
            ('cost', f'wall time per simulated second with {len(result.stretch.times_ns)} '
                     'outputs; fastest of several runs'),
            ('rounding floor', f'{reference.floor:.1e} rad, {floor}'), ('', rest),
            ('last digits', _DIGITS.format(reference.last_digits)),
            *_interpolation(result)]


def _interpolation(result: Tradeoff) -> list[tuple[str, str]]:
    rows = []
    if others := [f'{name} would spin the body too fast' if angle is None else
                  f'{name} would end {angle:.2g} rad away'
                  for name, angle in result.interpolation_differences.items()]:
        rows.append(('interpolation', f'{result.stretch.interpolation} ({", ".join(others)})'))
    if result.interpolation_errors:
        estimates = ', '.join(f'{error.interpolation} {error.estimate:.1e} rad'
                              for error in result.interpolation_errors)
        rows += [('  error', f'{estimates}, estimated by leaving out samples;'),
                 ('', 'hold has no error if the torque really is constant between samples')]
    return rows


def _target_data(result: Tradeoff, target: float) -> dict[str, Any]:
    choice = result.choices[target]
    return {
        'target_rad': target, 'dominant': result.dominant(target),
        'recommended': None if choice is None else {
            **choice.measurement.as_dict(result.stretch.seconds),
            'parameters': [*choice.measurement.setting.parameters],
            'whole_attitude_error_rad': choice.error, 'measured_on_whole': choice.measured}}


def _pair(row: tuple[str, str]) -> str:
    return f'{row[0]:{_WIDTH}}{row[1]}'.rstrip()


def _motion(result: Tradeoff) -> str:
    stretch, whole = result.stretch, result.whole
    torques = 'without torque' if stretch.torque_free else \
        f'{stretch.samples} torque samples ({stretch.interpolation})'
    if stretch.problem.fields:
        torques = f'under fields, {torques.replace("torque", "logged torque")}' \
            if stretch.torque_free else f'under fields and {torques}'
    part = '' if stretch is whole else f', the beginning of a motion of {whole.seconds:.9g} s'
    return f'{stretch.seconds:.9g} s, {result.angle:.3g} rad, {torques}{part}'


def _line(run: Measurement, span: float) -> str:
    solver, size = run.setting.solver, run.setting.size
    if run.failure:
        return f'  {solver:14} {size:>17}   failed: {run.failure}'
    return _ROW.format('*' if run.pareto_optimal else '', solver, size,
                       *(f'{error:.1e}' for error in run.error), f'{run.seconds / span:.2e}',
                       f'{span / run.seconds:.3g}')


def report_of(result: Tradeoff, title: str) -> Report:
    """
    Return the report of a trade-off.

    Parameters
    ----------
    result : Tradeoff
        The result of `measure`.
    title : str
        The title: the names of the recording and of its topic, or the name of the scene.

    """
    settings = [(target, choice and choice.measurement.setting)
                for target, choice in result.choices.items()]
    cheapest = '; '.join(f'for errors up to {target:.3g} rad: ' + (
        f'{setting.solver}, {setting.size}' if setting else 'none is certain')
        for target, setting in settings)
    copied = ['\n'.join([f'# for attitude errors up to {target:.3g} rad', *setting.parameters])
              for target, setting in settings if setting]
    return Report(title, f'cheapest setting {cheapest}', [*result.rows()],
                  [_work_precision(result)], copied=copied)


def _work_precision(result: Tradeoff) -> Panel:
    curves, texts = [], []
    for solver, (errors, costs) in result.curves().items():
        cost = np.array(costs)[:, None]
        curves.append(Curves(np.array(errors), cost, cost, [solver]))
        texts.append([*_texts(result, solver)])
    optimal = sorted((max(run.error.attitude, result.reference.floor), run.seconds)
                     for run in result.measurements if run.pareto_optimal)
    errors, seconds = np.array(optimal).T
    cost = seconds[:, None] / result.stretch.seconds
    curves.append(Curves(errors, cost, cost, ['Pareto-optimal'], style='front'))
    return Panel('wall time per simulated second', 's/s', curves, 'largest attitude error (rad)',
                 'loglog', result.reference_errors(), texts)


def _texts(result: Tradeoff, solver: str) -> Iterator[str]:
    span = result.stretch.seconds
    for run in result.measurements:
        if run.setting.solver == solver and not run.failure:
            optimal = '; Pareto-optimal' if run.pareto_optimal else ''
            yield f'{run.setting.size}, attitude error {run.error.attitude:.1e} rad, ' \
                  f'{run.seconds / span:.2e} s per simulated second, {span / run.seconds:.3g} ' \
                  f'times real time{optimal}'
