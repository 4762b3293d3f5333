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

"""Repeat a fit with additional parameters, the suspects, which it did not estimate before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import as_json
from rigid_body_ros.inference.coordinates import Parameters, Physics, Prior, SHORT_LAG
from rigid_body_ros.inference.fit import LeastSquares, Weights
from rigid_body_ros.inference.growth import COARSE, fitted
from rigid_body_ros.inference.motion import Recorded
from rigid_body_ros.inference.parameters import (
    moments_of,
    of_sensors,
    SPACE,
    split_topic,
    START,
    WEIGHT,
)
from rigid_body_ros.inference.sensors import mount_of, topics_of
from rigid_body_ros.inference.setup import Setup
from rigid_body_ros.inference.solution import Solution
from rigid_body_ros.scene.fields import MOMENT


@dataclass(frozen=True)
class Suspect:
    """
    A parameter that was not estimated, or a fault, that would explain part of the errors.

    Attributes
    ----------
    name : str
        The parameter, the fault, or `inertia_change`.
    chi2_drop : float
        How much the chi-square of the fit drops if the parameter is estimated as well: predicted
        by a score test, or that of a fit. The chi-square is the sum of the squared errors, each
        divided by its variance.
    p : float
        Probability of a drop at least this large if the parameter has no effect.
    value : list of float
        The components with which the drop would be largest, in their own units. For
        `inertia_change`, this is the time of the change since the start, s.
    text : str
        A description, if the suspect is not a parameter.
    command : str
        The command-line option that adds the parameter to the fit, or advice in words.
    validation_chi2_per_dof : float or None
        Chi-square per degree of freedom of the validation if the parameter is estimated as well.
        None if there is no validation.

    """

    name: str
    chi2_drop: float
    p: float
    value: Sequence[float] = ()
    text: str = ''
    command: str = ''
    validation_chi2_per_dof: float | None = None

    def described(self) -> str:
        """Return the name, what speaks for the suspect, and the option or the advice."""
        if self.text:
            return f'{self.name}: {self.text}; {self.command}'
        values = ', '.join(f'{value:.4g}' for value in self.value)
        ahead = '' if self.validation_chi2_per_dof is None else \
            f', chi-square of the validation {self.validation_chi2_per_dof:.3g}'
        return f'{self.name} ({values}): chi-square falls by {self.chi2_drop:.4g}{ahead}; ' \
               f'{self.command}'

    def as_dict(self) -> dict[str, Any]:
        """Return the fields under the names used in the JSON file."""
        return {**asdict(self), 'value': as_json(np.array(self.value))}


def candidates(setup: Setup) -> list[str]:
    """Return the names of the parameters that could be estimated but were not."""
    given = setup.parameters.groups
    names = [SPACE] if isinstance(setup.problems[0], Recorded) and any(
        one.is_attitude for one in setup.channels[0]) else _of_body(setup)
    names = [name for name in names if name not in given]
    channels = [channel for every in setup.channels for channel in every]
    for kind in of_sensors():
        topics = topics_of(kind, channels)
        if len(topics) == 1 and kind not in given:
            names.append(kind)
        elif len(topics) > 1:
            names += [f'{kind}@{topic}' for topic in topics if f'{kind}@{topic}' not in given]
    return names


def _of_body(setup: Setup) -> list[str]:
    if isinstance(setup.problems[0], Recorded):
        return []
    groups, problems = setup.parameters.groups, setup.problems
    names = ['damping', 'rotor_momentum', *setup.parameters.magnitudes.strengths]
    if 'inertia' not in groups:
        names.insert(0, 'inertia')
    if all(setup.fits_attitude) and f'{WEIGHT}.{MOMENT}' not in names:
        names.append(WEIGHT)
    names.append('torque_bias')
    logs = [log for problem in problems for log in problem.logs]
    if any(log.torques.any() for log in logs):
        names += ['torque_delay', 'torque_gains']
        if all(log.interpolation == 'hold' for log in logs):
            names.append('torque_lag')
        if not {'inertia', 'inertia_diagonal', 'torque_gain', 'torque_gains'} & {*groups}:
            names.append('torque_gain')
    return names


def extended(setup: Setup, physics: Physics, names: Sequence[str]) -> Parameters:
    """Add `names` to the parameters of a fit, with the fitted values as the guess."""
    groups = [name for name in setup.parameters.groups
              if not (name == 'inertia_diagonal' and 'inertia' in names)]
    given = moments_of(names, setup.problems[0].fields)
    own = {name: mount_of(name, physics, setup.channels[0]) for name in names
           if split_topic(name)[0] == 'mount'}
    guess = replace(physics, values={**given, **own, **physics.values})
    return Parameters([*groups, *names], guess, setup.parameters.magnitudes,
                      setup.parameters.priors)


def with_suspect(solution: Solution, name: str) -> Solution:
    """Repeat a fit with a suspect as an additional parameter."""
    setup = solution.problem.setup
    groups = setup.parameters.groups
    physics = solution.physics
    if name == 'torque_lag':
        physics = physics.with_value(name, np.array([SHORT_LAG]))
    if name == 'torque_gains' and 'torque_gain' in groups:
        physics = physics.with_value(name, np.full(3, physics.number('torque_gain')))
        physics = physics.with_value('torque_gain', np.ones(1))
        setup = replace(setup, parameters=Parameters(
            [group for group in groups if group != 'torque_gain'], physics,
            setup.parameters.magnitudes, setup.parameters.priors))
    parameters = extended(setup, physics, [name])
    sizes = zip(parameters.names, parameters.values(parameters.guess), parameters.plausible)
    own = {one: Prior(float(value), float(size)) for one, value, size in sizes
           if one not in setup.parameters.names}
    wider = replace(setup, parameters=parameters.with_priors({**parameters.priors, **own}))
    old = solution.problem
    problem = LeastSquares(wider, old.windows, old.reference, solution.weights)
    start = replace(solution, problem=problem, physics=wider.parameters.guess)
    return fitted(start, solution.length_ns, *COARSE[1:], is_last=True)


def sum_of_squares(solution: Solution, weights: Weights) -> float:
    """Return the sum of squares of errors and priors, each in its standard deviations."""
    problem = solution.problem.weighted(weights)
    errors = [problem.scaled_errors(k, solution.physics) for k in range(len(problem.windows))]
    return float(sum(np.sum(one ** 2) for one in (
        problem.parameters.surprise(solution.physics), *errors)))


def value_of(solution: Solution, name: str) -> list[float]:
    """Return the estimated values of the components of a suspect, in their units."""
    parameters = solution.problem.setup.parameters
    return parameters.values(solution.physics)[parameters.columns([name])].tolist()


def command_with(setup: Setup, name: str) -> str:
    """Return the command-line option that adds a suspect to the fit."""
    kind, topic = split_topic(name)
    names = [*setup.parameters.groups, *([START] if setup.fits_start else [])]
    replaced = {'inertia': 'inertia_diagonal', 'torque_gains': 'torque_gain'}.get(name)
    names = [each for each in names if each != replaced]
    if topic and kind in names:  # each sensor gets a separate value
        names.remove(kind)
        channels = [channel for every in setup.channels for channel in every]
        names += [f'{kind}@{other}' for other in topics_of(kind, channels) if other != topic]
    return f'--estimate {",".join([*names, name])}'
