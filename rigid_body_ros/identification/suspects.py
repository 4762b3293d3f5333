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

"""Parameters that were not estimated, tried one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import as_json
from rigid_body_ros.identification.names import (
    moments_of,
    of_sensors,
    split_topic,
    START,
    WEIGHT,
)
from rigid_body_ros.identification.parameters import Parameters, Physics, SHORT_LAG
from rigid_body_ros.identification.problem import LeastSquares
from rigid_body_ros.identification.sensors import mount_of, topics_of
from rigid_body_ros.identification.setup import Setup
from rigid_body_ros.identification.solve import fitted, Solution
from rigid_body_ros.scene.fields import MOMENT

#: Evaluations of a fit with a suspect, and its tolerance.
_MOST, _TOLERANCE = 15, 1e-6


@dataclass(frozen=True)
class Suspect:
    """
    A parameter that was not estimated, and would explain errors.

    Attributes
    ----------
    name : str
        The parameter, or `inertia_change`.
    chi2_drop : float
        Drop of the sum of squares of the training if it is also estimated.
    p : float
        Probability of such a drop without an effect.
    value : list of float
        Its components, in their units; of a change, its time since the start, s.
    validation_chi2_per_dof : float or None
        With the suspect; None without a validation.
    command : str
        The options to type.

    """

    name: str
    chi2_drop: float
    p: float
    value: list[float]
    validation_chi2_per_dof: float | None
    command: str

    def as_dict(self) -> dict[str, Any]:
        """Return the fields with the names of the JSON."""
        return {'name': self.name, 'chi2_drop': self.chi2_drop,
                'validation_chi2_per_dof': self.validation_chi2_per_dof, 'p': self.p,
                'value': as_json(np.array(self.value)), 'command': self.command}


def candidates(setup: Setup) -> list[str]:
    """Return the names of parameters that were not estimated, but could be."""
    given = setup.parameters.groups
    names = [name for name in _of_body(setup) if name not in given]
    channels = [channel for every in setup.channels for channel in every]
    for kind in of_sensors():
        topics = topics_of(kind, channels)
        if len(topics) == 1 and kind not in given:
            names.append(kind)
        elif len(topics) > 1:
            names += [f'{kind}@{topic}' for topic in topics if f'{kind}@{topic}' not in given]
    return names


def _of_body(setup: Setup) -> list[str]:
    groups, problems = setup.parameters.groups, setup.problems
    names = ['damping', 'rotor_momentum', *setup.parameters.magnitudes.strengths]
    if 'inertia' not in groups:
        names.insert(0, 'inertia')
    if all(setup.fits_attitude) and f'{WEIGHT}.{MOMENT}' not in names:
        names.append(WEIGHT)
    names.append('torque_bias')
    if any(log.torques.any() for problem in problems for log in problem.logs):
        names += ['torque_delay', 'torque_lag', 'torque_gains']
        if not {'inertia', 'inertia_diagonal', 'torque_gain', 'torque_gains'} & {*groups}:
            names.append('torque_gain')
    return names


def extended(setup: Setup, physics: Physics, names: Sequence[str]) -> Parameters:
    """Return the parameters of a fit and others, for which a fit is the guess."""
    groups = [name for name in setup.parameters.groups
              if not (name == 'inertia_diagonal' and 'inertia' in names)]
    given = moments_of(names, setup.problems[0].fields)
    own = {name: mount_of(name, physics, setup.channels[0]) for name in names
           if split_topic(name)[0] == 'mount'}
    guess = replace(physics, values={**given, **own, **physics.values})
    return Parameters([*groups, *names], guess, setup.parameters.magnitudes,
                      setup.parameters.priors)


def with_suspect(solution: Solution, name: str) -> Solution:
    """Return the fit that also estimates a suspect."""
    setup = solution.problem.setup
    groups = setup.parameters.groups
    physics = solution.physics
    if name == 'torque_lag':
        physics = replace(physics, values={**physics.values, name: np.array([SHORT_LAG])})
    if name == 'torque_gains' and 'torque_gain' in groups:
        physics = replace(physics, values={
            **{key: value for key, value in physics.values.items() if key != 'torque_gain'},
            name: np.full(3, physics.number('torque_gain'))})
        setup = replace(setup, parameters=Parameters(
            [group for group in groups if group != 'torque_gain'], physics,
            setup.parameters.magnitudes))  # the prior of the gain is not part of the trial
    wider = replace(setup, parameters=extended(setup, physics, [name]))
    old = solution.problem
    problem = LeastSquares(wider, old.windows, old.reference, solution.weights)
    start = replace(solution, problem=problem, physics=wider.parameters.guess)
    return fitted(start, solution.length_ns, _TOLERANCE, _MOST, is_last=True)


def sum_of_squares(solution: Solution) -> float:
    """Return the sum of squares of the errors that were fitted, in standard deviations."""
    problem = solution.problem
    return sum(float(np.sum(problem.scaled_errors(k, solution.physics) ** 2))
               for k in range(len(problem.windows)))


def value_of(solution: Solution, name: str) -> list[float]:
    """Return the components of a suspect."""
    parameters = solution.problem.setup.parameters
    values = parameters.values(solution.physics)
    return [float(values[i]) for i in parameters.columns([name])]


def command_with(setup: Setup, name: str) -> str:
    """Return the option that also estimates a suspect."""
    kind, topic = split_topic(name)
    names = [*setup.parameters.groups, *([START] if setup.fits_start else [])]
    replaced = {'inertia': 'inertia_diagonal', 'torque_gains': 'torque_gain'}.get(name)
    names = [each for each in names if each != replaced]
    if topic and kind in names:  # each sensor gets its own
        names.remove(kind)
        channels = [channel for every in setup.channels for channel in every]
        names += [f'{kind}@{other}' for other in topics_of(kind, channels) if other != topic]
    return f'--estimate {",".join([*names, name])}'
