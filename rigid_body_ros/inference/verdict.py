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

"""
Decide whether a model explains the measurements, is only approximate, or is rejected.

The fit is repeated with parameters that it did not estimate before, the suspects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
from rigid_body_ros.common.errors import listed
from rigid_body_ros.inference.coordinates import Parameters, Prior, SHORT_LAG
from rigid_body_ros.inference.errors import Misfit, of_validation
from rigid_body_ros.inference.evidence import Suspect
from rigid_body_ros.inference.findings import Findings, INERTIA_CHANGE, LARGE
from rigid_body_ros.inference.fit import LeastSquares, Solution, Weights
from rigid_body_ros.inference.growth import COARSE, fitted
from rigid_body_ros.inference.noise import ALARM, tail
from rigid_body_ros.inference.reasons import persistence, probability
from rigid_body_ros.inference.setup import Setup
from rigid_body_ros.inference.windows import topics_of
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.scene.quantities import QUANTITIES, split_topic, START

EXPLAINED, APPROXIMATE, REJECTED = 'explained', 'approximate', 'rejected'
_MEANINGS = {
    EXPLAINED: 'no test rejects the model',
    APPROXIMATE: 'the model is a little wrong',
    REJECTED: 'the model does not explain the measurements'}
#: What the verdict means for estimates.
_CONSEQUENCES = {
    EXPLAINED: '', APPROXIMATE: '; the intervals cover the effect',
    REJECTED: '; do not use the estimates'}
#: Maximum number of suspects to fit, and maximum number of suspects to list.
_TRIED, _LISTED = 5, 3
#: Limits for a suspect's drop in chi-square. A suspect explains about as much as the best suspect
#: if its drop is at least `_ALIKE` times the drop of the best suspect. A suspect adds to the
#: systematic part of the intervals if its drop is at least `_COUNTS` times the largest drop.
_ALIKE, _COUNTS = 0.98, 0.1
#: Errors are white if so many samples, or fewer, tell as much as one.
_WHITE = 2.0


@dataclass(frozen=True)
class Verdict:
    """
    The verdict on whether a model explains the measurements.

    Attributes
    ----------
    level : str
        'explained', 'approximate' or 'rejected'.
    reasons : list of str
        The reasons against the model.
    suspects : list of Suspect
        Parameters that would explain more of the errors, best first.

    """

    level: str
    reasons: list[str]
    suspects: list[Suspect]

    @property
    def is_consistent(self) -> bool:
        """Return whether there is no reason against the model."""
        return self.level == EXPLAINED

    def with_reasons(self, texts: Sequence[str], rejects: bool = False) -> Verdict:
        """Return the verdict with more reasons; a model with reasons is at most approximate."""
        level = REJECTED if texts and rejects else \
            APPROXIMATE if texts and self.is_consistent else self.level
        return replace(self, level=level, reasons=[*self.reasons, *texts])

    @property
    def summary(self) -> list[str]:
        """Return the level with its meaning and the first reason, as parts of a sentence."""
        return [f'{self.level}: {_MEANINGS[self.level]}', *self.reasons[:1]]

    def as_dict(self) -> dict[str, Any]:
        """Return the verdict under the names used in the JSON file."""
        return {'level': self.level, 'consistent': self.is_consistent, 'reasons': self.reasons,
                'suspects': [suspect.as_dict() for suspect in self.suspects]}

    def rows(self, has_estimates: bool = False) -> Iterator[tuple[str, str]]:
        """Generate the verdict, the reasons and the suspects, each as a name and a text."""
        consequence = _CONSEQUENCES[self.level] if has_estimates else ''
        yield 'verdict', f'{self.level}: {_MEANINGS[self.level]}{consequence}'
        for reason in self.reasons:
            yield 'reason', reason
        for suspect in self.suspects:
            yield 'suspect', suspect.described()


def tried(findings: Findings, every: Sequence[Sequence[Measured]]
          ) -> list[tuple[Suspect, Solution]]:
    """
    Fit the most likely suspects, and return each of them with its fit.

    Parameters
    ----------
    findings : Findings
        The reasons against the model.
    every : sequence of sequence of Measured
        The channels of each recording, including the validation samples. Empty if there is no
        validation.

    """
    solution, result = findings.solution, []
    setup = solution.problem.setup
    chances = {suspect.name: suspect.p for suspect in findings.suspects if not suspect.text}
    names = [*chances][:_TRIED]
    is_bad_fit = findings.reasons and findings.noises and not any(
        suspect.text and suspect.name != INERTIA_CHANGE for suspect in findings.suspects)
    if is_bad_fit and 'inertia' in setup.candidates() and 'inertia' not in names:
        names.append('inertia')  # always try it: the guess may be too poor for a score test
    if not names:
        return []
    before = sum_of_squares(solution, solution.weights)
    for name in names:
        try:
            fit = with_suspect(findings.sharp, name)
        except ValueError:  # the motion of this fit cannot be computed
            continue
        drop = max(before - sum_of_squares(fit, solution.weights), 0.0)
        parameters = fit.problem.parameters
        value = parameters.values(fit.physics)[parameters.columns([name])].tolist()
        p = tail(drop, len(value))
        # Check again: the score test is linear and may have predicted too much. A suspect that
        # makes the errors white is named, even if they last too long for a test without it.
        if p < ALARM or max(chain(*persistence(fit))) < _WHITE:
            validation = Misfit.of(of_validation(fit, every), 0).chi2_per_dof if every else None
            result.append((Suspect(name, drop, min(p, chances.get(name, p)), value, '',
                                   command_with(setup, name), validation), fit))
    return result


def with_intervals(findings: Findings, attempts: Sequence[Suspect],
                   moved: Sequence[Mapping[str, float]]) -> tuple[Verdict, dict[str, float]]:
    """
    Return the verdict and, for each estimate, the systematic part of its interval.

    Parameters
    ----------
    findings : Findings
        The reasons against the model.
    attempts : sequence of Suspect
        The suspects that were fitted.
    moved : sequence of dict of str to float
        For each suspect, how much each estimate changes if the suspect is fitted as well.

    """
    suspects = _ranked(findings, attempts)[:_LISTED]
    best = max((suspect.chi2_drop for suspect in attempts), default=0.0)
    counted = [move for suspect, move in zip(attempts, moved)
               if suspect.chi2_drop >= _COUNTS * best]
    # Either a suspect is the cause, or it is not: half the square of the change is the variance.
    # A bound, as for `with_bound`, has this variance if its square is larger by one half.
    parts = [(1.0, findings.drift), *((1.5, move) for move in counted)]
    systematic = {name: float(np.sqrt(np.nansum([factor * part.get(name, 0.0) ** 2
                                                 for factor, part in parts])))
                  for name in dict.fromkeys(chain(*(part for _, part in parts)))}
    is_rejected = not attempts and any(reason.is_contradiction for reason in findings.reasons)
    verdict = _judged(findings, suspects, is_rejected)
    return verdict, {} if verdict.is_consistent else systematic


def _ranked(findings: Findings, attempts: Sequence[Suspect]) -> list[Suspect]:
    """
    Rank the suspects, best first.

    If there is a validation, suspects are ranked by the chi-square of the validation. Otherwise,
    suspects are ranked by the drop in the chi-square of the fit. A change in the inertia is always
    ranked by this drop, because no fit includes such a change.
    """
    ranked = sorted(attempts, key=lambda suspect: (suspect.validation_chi2_per_dof or 0.0,
                                                   -suspect.chi2_drop))
    command = partial(command_with, findings.solution.problem.setup)
    for suspect in findings.suspects:
        if suspect.text:
            place = next((i for i, other in enumerate(ranked)
                          if other.chi2_drop < suspect.chi2_drop), len(ranked))
            ranked.insert(place, _advised(suspect, command))
    return ranked


def scored(findings: Findings, command: Callable[[str], str]) -> Verdict:
    """
    Return the verdict on a model from the scores alone, without a fit of the suspects.

    Parameters
    ----------
    findings : Findings
        The reasons against the model.
    command : callable
        Returns the command-line option, or the advice, for a parameter.

    """
    best = max((suspect.chi2_drop for suspect in findings.suspects), default=0.0)
    # Of the best suspects, which explain about as much, the simplest comes first.
    alike = [suspect for suspect in findings.suspects if suspect.chi2_drop >= _ALIKE * best]
    ranked = [*sorted(alike, key=lambda suspect: len(suspect.value)),
              *(suspect for suspect in findings.suspects if suspect not in alike)]
    return _judged(findings, [_advised(suspect, command) for suspect in ranked[:_LISTED]],
                   best > LARGE * findings.solution.count)


def _judged(findings: Findings, suspects: list[Suspect], is_rejected: bool) -> Verdict:
    """Return the verdict that follows from the findings."""
    if not findings.reasons and not suspects:
        return Verdict(EXPLAINED, [], [])
    texts = [reason.text for reason in findings.reasons]
    if suspects and suspects[0].text not in texts:
        texts.append(_words(suspects))
    rejects = is_rejected or any(reason.rejects for reason in findings.reasons)
    return Verdict(REJECTED if rejects else APPROXIMATE, texts, suspects)


def _advised(suspect: Suspect, command: Callable[[str], str]) -> Suspect:
    """Return a suspect with the option that adds its parameter, or with advice."""
    advice = 'correct the recording'
    if suspect.name == INERTIA_CHANGE:
        advice = 'fit the parts before and after it one by one'
    elif split_topic(suspect.name)[0] in (*QUANTITIES, START):
        advice = command(suspect.name)
    return replace(suspect, command=advice)


def _words(suspects: Sequence[Suspect]) -> str:
    best, *others = suspects
    alike = [other.name for other in others if other.chi2_drop >= _ALIKE * best.chi2_drop
             and other.name != INERTIA_CHANGE]
    text = f'{best.name} would explain more ({probability(best.p)})'
    return f'{text}, and {listed(alike)} about as much' if alike else text


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
    wider = setup.extended(physics, [name])
    parameters = wider.parameters
    sizes = zip(parameters.names, parameters.values(parameters.guess), parameters.plausible)
    own = {component: Prior(float(value), float(size)) for component, value, size in sizes
           if component not in setup.parameters.names}
    wider = replace(wider, parameters=parameters.with_priors({**parameters.priors, **own}))
    old = solution.problem
    problem = LeastSquares(wider, old.windows, old.reference, solution.weights)
    start = replace(solution, problem=problem, physics=wider.parameters.guess)
    return fitted(start, solution.length_ns, *COARSE[1:], is_last=True)


def sum_of_squares(solution: Solution, weights: Weights) -> float:
    """Return the sum of squares of errors and priors, each in its standard deviations."""
    problem = solution.problem.weighted(weights)
    errors = [problem.scaled_errors(k, solution.physics) for k in range(len(problem.windows))]
    return float(sum(np.sum(parts ** 2) for parts in (
        problem.parameters.surprise(solution.physics), *errors)))


def command_with(setup: Setup, name: str) -> str:
    """Return the command-line option that adds a suspect to the fit."""
    kind, topic = split_topic(name)
    names = [*setup.parameters.groups, *([START] if setup.fits_start else [])]
    replaced = {'inertia': 'inertia_diagonal', 'torque_gains': 'torque_gain'}.get(name)
    names = [other for other in names if other != replaced]
    if topic and kind in names:  # each sensor gets a separate value
        names.remove(kind)
        channels = [channel for every in setup.channels for channel in every]
        names += [f'{kind}@{other}' for other in topics_of(kind, channels) if other != topic]
    return f'--estimate {",".join([*names, name])}'
