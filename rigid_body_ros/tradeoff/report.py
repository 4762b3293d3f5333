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

"""Report a measured trade-off."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rigid_body_ros.report.charts import Curves, Panel
from rigid_body_ros.report.report import Report
from rigid_body_ros.tradeoff.choices import Choice
from rigid_body_ros.tradeoff.result import Tradeoff, value


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
    copied = [_parameters(target, choice) for target, choice in result.choices.items() if choice]
    return Report(title, _headline(result), [*result.rows()], [_work_precision(result)],
                  copied=copied)


def _headline(result: Tradeoff) -> str:
    """Return a headline that gives the cheapest setting for each target."""
    found = [f'for errors up to {target:.3g} rad: '
             + (f'{choice.measurement.setting.solver}, {value(choice.measurement.setting)}'
                if choice else 'none is certain') for target, choice in result.choices.items()]
    return f'cheapest setting {"; ".join(found)}'


def _parameters(target: float, choice: Choice) -> str:
    return '\n'.join([f'# for attitude errors up to {target:.3g} rad',
                      *choice.measurement.setting.parameters])


def _work_precision(result: Tradeoff) -> Panel:
    curves, texts = [], []
    for solver, (errors, costs) in result.curves().items():
        cost = np.array(costs)[:, None]
        curves.append(Curves(np.array(errors), cost, cost, [solver]))
        texts.append([*_texts(result, solver)])
    optimal = sorted((max(one.error.attitude, result.reference.floor), one.seconds)
                     for one in result.measurements if one.pareto_optimal)
    errors, seconds = np.array(optimal).T
    cost = seconds[:, None] / result.stretch.seconds
    curves.append(Curves(errors, cost, cost, ['Pareto-optimal'], style='front'))
    return Panel('wall time per simulated second', 's/s', curves, 'largest attitude error (rad)',
                 'loglog', result.reference_errors(), texts)


def _texts(result: Tradeoff, solver: str) -> Iterator[str]:
    span = result.stretch.seconds
    for one in result.measurements:
        if one.setting.solver == solver and not one.failure:
            optimal = '; Pareto-optimal' if one.pareto_optimal else ''
            yield f'{value(one.setting)}, attitude error {one.error.attitude:.1e} rad, ' \
                  f'{one.seconds / span:.2e} s per simulated second, {span / one.seconds:.3g} ' \
                  f'times real time{optimal}'
