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

"""A measured trade in words, and as data for a file."""

from __future__ import annotations

from importlib import metadata
import platform
from typing import Any

from rigid_body_ros.tradeoff.readings import Reading, READING_ORDERS
from rigid_body_ros.tradeoff.trade import Run, Tradeoff

_WIDTH = 18
_FLOOR = ('largest difference between runs of the series with other steps and in principal axes,',
          'and from the closed form if there is no torque: an error common to all does not show')
_DIGITS = 'a change of the last digit of inertia, torque or start moves the attitude by {} rad'
_HEADER = ('', 'solver', 'setting', 'final rad', 'largest rad', 'rad/s', 'momentum', 'energy',
           's per s', 'x real time')
_ROW = '{:1} {:14} {:>17} {:>10} {:>11} {:>9} {:>9} {:>9} {:>9} {:>11}'


def summary(result: Tradeoff) -> str:
    """Return what was measured, in lines for a person to read."""
    rows = [('motion', _motion(result)),
            ('errors', 'against the series at rounding level in shorter steps; attitude final and '
                       'largest'),
            ('drift', 'of momentum and energy: ' + _drift(result)),
            ('cost', f'wall time per simulated second, {len(result.stretch.times_ns)} outputs '
                     'included; medians of repeats in turns'),
            ('first call', f'kernels loaded or compiled in {result.load_seconds:.3g} s'),
            ('', '')]
    table = [_ROW.format(*_HEADER), *(_line(run, result.stretch.seconds) for run in result.runs),
             '* nothing is both cheaper and nearer', '']
    facts = [('rounding floor', f'{result.floor:.1e} rad, {_FLOOR[0]}'), ('', _FLOOR[1]),
             ('last digits', _digits(result)),
             *(('between samples', text) for text in _readings(result)),
             ('what dominates', _dominant(result))]
    return '\n'.join([*map(_pair, rows), *table, *map(_pair, facts), *_advice(result)])


def figures(result: Tradeoff) -> dict[str, Any]:
    """Return everything that was measured, with the unit in each name, for a JSON file."""
    choice, span = result.choice, result.stretch.seconds
    return {
        'machine': platform.platform(), 'processor': platform.processor() or platform.machine(),
        'versions': {'python': platform.python_version(),
                     **{name: metadata.version(name) for name in ('numpy', 'numba')}},
        'stretch_s': span, 'stretch_angle_rad': result.angle, 'whole_s': result.whole.seconds,
        'samples': len(result.stretch.log), 'outputs': len(result.stretch.times_ns),
        'interpolation': result.stretch.log.interpolation,
        'torque_free': result.stretch.torque_free,
        'load_or_compile_s': result.load_seconds, 'rounding_floor_rad': result.floor,
        'rounding_floor_is': ' '.join(_FLOOR), 'last_digit_effect_rad': result.last_digits,
        'target_rad': result.target, 'dominant': result.dominant,
        'readings': [{'interpolation': reading.interpolation,
                      'thinned_by_two_rad': reading.thinned,
                      'estimated_error_rad': reading.estimate} for reading in result.readings],
        'runs': [_figures(run, span) for run in result.runs],
        'recommended': None if choice is None else {
            **_figures(choice.run, span), 'parameters': [*choice.run.setting.parameters],
            'whole_attitude_error_rad': choice.error, 'measured_on_whole': choice.measured},
    }


def curves(result: Tradeoff) -> dict[str, tuple[list[float], list[float]]]:
    """Return largest attitude errors, rad, and seconds per simulated second, by solver."""
    found: dict[str, tuple[list[float], list[float]]] = {}
    for run in result.runs:
        if not run.failure:
            errors, costs = found.setdefault(run.setting.solver, ([], []))
            errors.append(run.error.attitude)
            costs.append(run.seconds / result.stretch.seconds)
    return found


def _figures(run: Run, span: float) -> dict[str, Any]:
    def number(value: float) -> float | None:
        return None if run.failure else value  # NaN is no JSON
    error = run.error
    return {'solver': run.setting.solver, 'tolerance': run.setting.tolerance,
            'max_step_s': run.setting.max_step,
            'attitude_error_final_rad': number(error.attitude_final),
            'attitude_error_largest_rad': number(error.attitude),
            'angular_velocity_error_largest_rad_per_s': number(error.angular_velocity),
            'momentum_drift_relative': number(error.momentum),
            'energy_drift_relative': number(error.energy),
            'first_call_s': number(run.first_seconds), 'warm_call_s': number(run.seconds),
            'cost_s_per_simulated_s': number(run.seconds / span),
            'times_real_time': number(span / run.seconds),
            'on_pareto_front': run.on_front, 'failure': run.failure or None}


def _pair(row: tuple[str, str]) -> str:
    return f'{row[0]:{_WIDTH}}{row[1]}'.rstrip()


def _motion(result: Tradeoff) -> str:
    stretch, whole = result.stretch, result.whole
    torques = 'without torque' if stretch.torque_free else \
        f'{len(stretch.log)} samples of torque ({stretch.log.interpolation})'
    part = '' if stretch is whole else f', a stretch from the start of {whole.seconds:.9g} s'
    return f'{stretch.seconds:.9g} s, {result.angle:.3g} rad, {torques}{part}'


def _drift(result: Tradeoff) -> str:
    if result.stretch.torque_free:
        return 'largest change since the start, of itself'
    return "largest difference from the reference's, of its largest"


def _line(run: Run, span: float) -> str:
    setting = run.setting
    value = f'step {setting.max_step:.6g} s' if setting.max_step else \
        f'tolerance {setting.tolerance:.0e}' if setting.tolerance else '-'
    if run.failure:
        return f'  {setting.solver:14} {value:>17}   failed: {run.failure}'
    return _ROW.format('*' if run.on_front else '', setting.solver, value,
                       *(f'{error:.1e}' for error in run.error), f'{run.seconds / span:.2e}',
                       f'{span / run.seconds:.3g}')


def _readings(result: Tradeoff) -> list[str]:
    if not result.readings:
        return []
    ours = result.reading
    texts = [f'{reading.interpolation} {reading.thinned:.1e}' for reading in result.readings]
    lines = ['every other sample left out moves the attitude by, rad: ' + ', '.join(texts)]
    if ours:
        lines.append(f'{ours.interpolation} is off by about {ours.estimate:.1e} rad'
                     + (', unless the torque was really held' if ours.interpolation == 'hold'
                        else '') + _better(result, ours))
    return lines


def _better(result: Tradeoff, ours: Reading) -> str:
    best = min(result.readings, key=lambda reading: reading.estimate)
    if best.estimate > 0.1 * ours.estimate or \
            READING_ORDERS[best.interpolation] <= READING_ORDERS[ours.interpolation]:
        return ''
    return f'; {best.interpolation} by about {best.estimate:.1e} rad'


def _dominant(result: Tradeoff) -> str:
    return {'rounding': 'rounding: a tighter setting gains nothing',
            'last digits': 'the last digits of inertia, torque and start: a tighter setting gains '
                           'nothing',
            'solver': 'the solver: a tighter setting is nearer',
            'reading': 'how the log is read between its samples: a tighter setting gains '
                       'nothing, closer samples or another interpolation do'}[result.dominant]


def _digits(result: Tradeoff) -> str:
    return _DIGITS.format(f'{result.last_digits:.1e}')


def _advice(result: Tradeoff) -> list[str]:
    choice, target = result.choice, f'target {result.target:.3g} rad'
    if choice is None:
        why = f'the rounding floor is {result.floor:.1e} rad' \
            if result.floor >= result.last_digits else _digits(result)
        return ['', f'No setting meets the {target} for certain: {why} on the stretch, and more '
                    'on a longer log.']
    how = 'measured on the whole log' if choice.measured else \
        'scaled by the square of the time from the stretch to the whole log'
    return ['', f'Cheapest for the {target} ({choice.error:.1e} rad, {how}):',
            *(f'    {line}' for line in choice.run.setting.parameters)]
