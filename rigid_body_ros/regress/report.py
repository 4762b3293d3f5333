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

"""Report two closed loops and their differences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from rigid_body_ros import recording
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.mechanics import so3
from rigid_body_ros.regress.loop import COMMANDS, EMPTY, INERTIA, Loop, Pair, Signal
from rigid_body_ros.regress.regression import Regression
from rigid_body_ros.report import moving_body
from rigid_body_ros.report.charts import Curves, Panel, QUATERNION, RATES, SIGNED, TORQUES
from rigid_body_ros.report.report import Report
from rigid_body_ros.scene import Scene

_WHEELS = 'accepted_wheel_torque'


def report_of(regression: Regression, name: str, scene: Scene) -> Report:
    """
    Return the report of a regression.

    Parameters
    ----------
    regression : Regression
        The two loops and their differences.
    name : str
        The name of the reference.
    scene : Scene
        The scene of both loops.

    """
    shown = [('moving body', 'the loop, not the reference')]
    return Report(f'{name}: closed loop', regression.verdict, [*regression.rows()[1:], *shown],
                  [*_panels(regression)], _body(regression, scene))


def _panels(regression: Regression) -> Iterator[Panel]:
    reference, loop = regression.reference, regression.loop
    start_ns, first_ns = reference.start.time_ns, regression.differences.first_ns
    lines = {} if first_ns is None else {'first difference': (first_ns - start_ns) * 1e-9}
    states = (reference.states, loop.states)
    turned = Pair.of(*states)
    errors = so3.difference(turned.reference[:, :4], turned.loop[:, :4])
    yield _panel('quaternion', '', states, QUATERNION, slice(4), start_ns, lines)
    yield _difference('attitude, body axes', 'rad', turned, errors, start_ns, lines)
    label = 'angular velocity, body axes'
    yield _panel(label, 'rad/s', states, RATES, slice(4, 7), start_ns, lines)
    yield _difference(label, 'rad/s', turned, (turned.loop - turned.reference)[:, 4:], start_ns,
                      lines)
    for name in sorted({*reference.torques, *loop.torques} - {INERTIA}):
        torques = (reference.torques.get(name, EMPTY), loop.torques.get(name, EMPTY))
        label, pair = name.removeprefix('accepted_').replace('_', ' '), Pair.of(*torques)
        names = loop.wheels if name == COMMANDS else TORQUES
        yield _panel(label, 'N m', torques, names, slice(len(names)), start_ns, lines)
        yield _difference(label, 'N m', pair, pair.loop - pair.reference, start_ns, lines,
                          loop.wheels if name == COMMANDS else SIGNED)


def _panel(label: str, unit: str, loops: Sequence[Signal], names: Sequence[str], columns: slice,
           start_ns: int, lines: Mapping[str, float]) -> Panel:
    """Return a panel in which the curves of the loop are drawn over those of the reference."""
    curves = [Curves.thinned(samples.times_ns, samples.values[:, columns],
                             [f'{name}{of}' for name in names], start_ns, drawn)
              for samples, of, drawn in zip(loops, (' of the reference', ''), ('broad', 'line'))
              if len(samples)]
    curves = [replace(curve, step=unit == 'N m') for curve in curves]
    return Panel(label, unit, curves, lines=lines)


def _difference(label: str, unit: str, pair: Pair, errors: Floats, start_ns: int,
                lines: Mapping[str, float], names: Sequence[str] = SIGNED) -> Panel:
    """Return a panel that shows the loop minus the reference at the stamps that both have."""
    return Panel(f'difference: {label}', unit,
                 [Curves.thinned(pair.times_ns, errors, names, start_ns)] if len(errors) else [],
                 lines=lines)


def _body(regression: Regression, scene: Scene) -> dict[str, Any]:
    """Return an animation of the loop, whose motion is recomputed from the torques."""
    loop = regression.loop
    reading = recording.Reading(topics=_topics(loop))
    problem = recording.read_epochs(regression.path, scene, reading)[-1].problem
    return moving_body.of_motion(problem, loop.states.times_ns)


def _topics(loop: Loop) -> recording.Topics:
    """Return the topics of the node's log that contains a loop."""
    def full(name: str) -> str | None:
        return f'{loop.node}/{name}' if name in loop.torques else None
    others = _WHEELS, INERTIA, COMMANDS
    torques = sorted((name for name in loop.torques if name not in others),
                     key=lambda name: (len(name), name))
    return recording.Topics(tuple(f'{loop.node}/{name}' for name in torques),
                            full(_WHEELS), inertia=full(INERTIA),
                            wheel_command=full(COMMANDS))
