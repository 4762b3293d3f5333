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

"""Put the page of an identification together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from rigid_body_ros.identification.experiment import Experiment
from rigid_body_ros.identification.result import Estimate, Identification
from rigid_body_ros.identification.summary import rows, verdict_rows
from rigid_body_ros.identification.verdict import Verdict
from rigid_body_ros.report.charts import Panel
from rigid_body_ros.report.page import Page, table
from rigid_body_ros.report.panels import signed_error_panel, torque_panels
from rigid_body_ros.scene import Scene

_HEADER = 'parameter', 'value', 'sigma', '95 % interval', 'guess', 'unit'


def page(fit: Identification, first: Experiment, name: str, scene: Scene,
         command: str) -> Page:
    """
    Return the page of an identification.

    Parameters
    ----------
    fit : Identification
        Outliers are not drawn.
    first : Experiment
        The first recording, whose errors and torques are drawn.
    name : str
        Its name.
    scene : Scene
        The scene with the guess.
    command : str
        The command line.

    """
    estimates = table(_HEADER, [_cells(one) for one in fit.estimates.values()])
    story = [('recording', name), *verdict_rows(fit.verdict), *rows(fit)]
    return Page(f'{name}: estimated parameters', story,
                [*_panels(fit, first)], warnings=[*_banner(fit.verdict), *scene.warnings],
                table=estimates, scene=scene, command=command)


def _banner(verdict: Verdict) -> Iterator[str]:
    """Generate what stands on top of the page: the verdict, unless all is explained."""
    if not verdict.is_consistent:
        yield next(verdict_rows(verdict))[1]


def _cells(one: Estimate) -> list[str]:
    spread = [f'{one.sigma:.2g}', '{:.6g} to {:.6g}'.format(*one.interval_95)] \
        if one.interval_95 else ['unknown', 'not determined by the data']
    return [one.name, f'{one.value:.7g}', *spread, f'{one.start:.5g}', one.unit]


def _panels(fit: Identification, first: Experiment) -> Iterator[Panel]:
    quantities = fit.first_errors()
    if not quantities:
        return
    times_ns = [np.concatenate([part.kept_ns for part in parts]) for parts in quantities]
    start_ns = min(int(each.min()) for each in times_ns)
    for parts, each_ns in zip(quantities, times_ns):
        label, unit = ('attitude', 'rad') if parts[0].is_attitude else ('rate', 'rad/s')
        panel = signed_error_panel(f'{parts[0].topic}: {label} error, axes of the sensor', unit,
                                   each_ns, np.concatenate([part.kept for part in parts]),
                                   parts[0].noise, start_ns)
        lines = [('start of the validation', 1e-9 * float(part.stamps_ns[0] - start_ns))
                 for part in parts if not part.is_training]
        yield replace(panel, lines=dict(lines))
    yield from torque_panels(first.logs, start_ns, max(int(each.max()) for each in times_ns))
