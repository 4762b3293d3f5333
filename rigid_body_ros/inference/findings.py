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
Test the errors of a fit to find out what is wrong with its model.

Each test raises a false alarm with probability 1e-4, and about forty tests apply to a model. More
than 99 out of 100 correct models therefore get the verdict 'explained'.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from rigid_body_ros.inference.coordinates import Parameters
from rigid_body_ros.inference.errors import of_training, Residuals
from rigid_body_ros.inference.evidence import (
    explained,
    foresight,
    linear,
    Linearized,
    noises,
    solved,
    Suspect,
    weighted,
    widened,
    with_noise,
)
from rigid_body_ros.inference.fit import LeastSquares, Solution
from rigid_body_ros.inference.growth import COARSEST, grown, is_linear, lasts, polished, rough
from rigid_body_ros.inference.hypotheses import faults_of_outliers, undone
from rigid_body_ros.inference.noise import ALARM, FEWEST, Noise, SMALLEST, tail
from rigid_body_ros.inference.reasons import (
    at_rest,
    halves,
    left_by,
    MISFIT,
    probability,
    Reason,
    scattered,
    tests_of,
    with_persistence,
)
from rigid_body_ros.inference.setup import Setup
from rigid_body_ros.mechanics import so3
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.scene.quantities import components_of

#: Minimum number of windows in the search for a sudden change in the inertia. The search tests,
#: for each window, whether the inertia changes at the beginning of the window.
_PIECES = 16
#: Errors smaller than this limit count as rounding errors. The unit is rad for attitudes and rad/s
#: for angular velocities. If the typical rate is above 1 rad/s, the limit for angular velocities
#: is multiplied by this rate.
_TINY = 1e-9
#: A suspect explains much if the chi-square would fall by more than this fraction of the number of
#: errors: what is missing is then as large as the noise.
LARGE = 0.5
#: The noise of a recorded motion is not well known, so a suspect must lower the chi-square by more
#: than this fraction of the number of errors.
_VISIBLE = 0.3
#: A change in the inertia is suspected only if the fractions of outliers before and after the
#: change differ by at least this much, and not in this fraction of the samples at either end.
_APART, _EDGE = 0.4, 0.1
INERTIA_CHANGE = 'inertia_change'
#: Number of suspects that are fitted because they would explain much if the errors did not last.
_SHARP = 2


@dataclass(frozen=True, eq=False)
class Findings:
    """
    What the errors of a fit reveal about the model.

    Attributes
    ----------
    solution : Solution
        The fit, with weights derived from the noise, or from the errors if these last.
    sharp : Solution
        The same fit, with weights derived from the noise alone.
    reasons : list of Reason
        The reasons against the model.
    suspects : list of Suspect
        What explains a significant part of the errors according to score tests, best first.
    drift : dict of str to float
        For each component, the difference between the estimates from the first and second halves
        of the recordings, or 0 if it is smaller than its standard deviation.
    apart : float
        How many times more the estimates from the two halves differ, all components together, than
        their standard deviations explain (Birge 1932). At least 1.
    noises : list of list of Noise
        The noise of each channel of each recording. Empty if all errors are rounding errors, or
        if a fault or a body at rest explains everything.
    predictable_s : float or None, s
        How long after the start the motion can be predicted in every recording. None if every
        motion can be predicted up to its last sample, or if there is no validation.
    scatter : dict of str to float
        For each component, the standard deviation that follows from the scatter between the
        recordings. Empty if the model explains them, or if there are fewer than three.

    """

    solution: Solution
    sharp: Solution
    reasons: list[Reason]
    suspects: list[Suspect]
    drift: dict[str, float]
    noises: list[list[Noise]]
    apart: float = 1.0
    predictable_s: float | None = None
    scatter: Mapping[str, float] = field(default_factory=dict)

    def with_validation(self, every: Sequence[Sequence[Measured]],
                        ahead: Sequence[Residuals]) -> Findings:
        """Return these findings together with the findings from the validation errors."""
        if not ahead or not self.noises:
            return self
        seconds, reasons = zip(*_validation(self, every, ahead))
        return replace(self, predictable_s=min(seconds) if min(seconds) < np.inf else None,
                       reasons=[*self.reasons, *(one for one in reasons if one)])


def judged(setup: Setup, names_suspects: bool = True) -> Findings:
    """
    Fit the model, and examine the errors.

    If one fault of the recording explains why even short windows do not fit, the model is not
    examined any further. If `names_suspects` is false, because samples are lost, no fault and no
    parameter is suspected.
    """
    few = rough(setup)
    is_wrong = not at_rest(few) and (
        lasts(few) or few.length_ns < setup.shortest_ns or not is_linear(few))
    fault = undone(few) if is_wrong and names_suspects else None
    if fault is None:
        solution = grown(setup, few)
        found = examined(polished(solution, *COARSEST) if setup.most else polished(solution))
        if still := at_rest(found.solution):
            return replace(found, reasons=[Reason(still, True)], suspects=[], noises=[])
        return found if names_suspects else replace(found, suspects=[])
    solution = polished(few, *COARSEST)
    return Findings(solution, solution, [Reason(fault.text, True)], [fault], {}, [])


def examined(solution: Solution) -> Findings:
    """Examine the errors of a fit and return the findings."""
    setup = solution.problem.setup
    if _is_rounding(solution):
        return Findings(solution, solution, [], [], {}, [])
    names, known = setup.candidates(), setup.parameters.names
    problem = widened(solution, names)
    found, before = noises(problem), solution
    solution = weighted(solution, found) if setup.most else with_noise(solution, found)
    problem = problem.weighted(solution.weights) if solution.physics is before.physics else \
        widened(solution, names)
    suspects = [*faults_of_outliers(solution),
                *_parameters(linear(problem), problem.parameters, known, names)]
    if not setup.is_computed:
        suspects = [one for one in suspects if one.chi2_drop > _VISIBLE * solution.count]
    # If nothing is fitted, what explains much of the other errors also explains the outliers.
    elif known or all(one.chi2_drop <= LARGE * solution.count for one in suspects):
        suspects += _largest([*_changes(solution), *_breaks(solution)])
    reasons, drift, _ = halves(solution)
    reasons += tests_of(solution, found)
    result = Findings(solution, solution, reasons, _significant(suspects), drift, found)
    return _doubted(result, problem, names) if known and (reasons or result.suspects) else result


def _significant(suspects: Iterable[Suspect]) -> list[Suspect]:
    return sorted((one for one in suspects if one.p < ALARM), key=lambda one: -one.chi2_drop)


def _doubted(findings: Findings, problem: LeastSquares, names: Sequence[str]) -> Findings:
    """
    Examine the errors again, as those of a model that is a little wrong.

    Such errors are as uncertain as their own correlation makes them, and what may be wrong has a
    plausible size. Only halves of a recording that differ even then reject the model.
    """
    solution = with_persistence(findings.solution, findings.noises)
    known = solution.problem.setup.parameters.names
    blunt, sharp = (_significant(_parameters(linear(each), problem.parameters, known, names,
                                             is_plausible=True))
                    for each in (problem.weighted(solution.weights), problem))
    found = {one.name for one in blunt}
    suspects = _significant([*faults_of_outliers(solution), *blunt, *_largest(
        [*_changes(solution), *_breaks(solution)])])
    contradictions, drift, apart = halves(solution)
    reasons = [*(Reason(text, part > MISFIT) for text, part in left_by(solution)),
               *contradictions,
               *(one for one in findings.reasons if not one.is_contradiction)]
    texts, scatter = scattered(solution)
    return replace(findings, solution=solution, drift=drift, apart=apart, scatter=scatter,
                   reasons=[*reasons, *map(Reason, texts)],
                   # A suspect may also be what makes the errors last.
                   suspects=[*suspects, *(one for one in sharp[:_SHARP] if one.name not in found)])


def start_suspect(solution: Solution) -> Suspect | None:
    """Return the start as a suspect, unless the fitted start is the given one within the noise."""
    problem, setup = solution.problem, solution.problem.setup
    given, states, unknown = setup.start(0), problem.reference, problem.unknowns[0]
    turned = so3.difference(states.attitude[0], given.attitude)
    faster = given.angular_velocity - states.angular_velocity[0]
    change = np.append(turned, faster / setup.rate)[unknown]
    if np.abs(change).max() < SMALLEST:
        return None
    slopes = problem.derivatives(0, solution.physics)[:len(unknown)]
    drop = float(np.sum((change @ slopes) ** 2))
    p = tail(drop, len(unknown))
    attitude = f'{np.linalg.norm(turned):.2g} rad and ' if len(unknown) > 3 else ''
    text = 'the start of the scene is not that of the motion: it is off by ' \
           f'{attitude}{np.linalg.norm(faster):.2g} rad/s'
    return Suspect('start', drop, p, text=text) if p < ALARM else None


def _is_rounding(solution: Solution) -> bool:
    """Return whether all errors are too small to come from a sensor."""
    rate = max(1.0, solution.problem.setup.rate)
    return all(one.noise <= _TINY * (1.0 if one.is_attitude else rate)
               for one in of_training(solution))


def _parameters(given: Linearized, parameters: Parameters, known: Sequence[str],
                names: Sequence[str], is_plausible: bool = False) -> Iterator[Suspect]:
    """Generate a suspect for each parameter that was not estimated."""
    matrix, errors = given.stacked()
    if is_plausible:
        rows = np.diag(parameters.scales / parameters.plausible)[
            [name not in known for name in given.names]]
        matrix = np.concatenate([matrix, rows])
        errors = np.append(errors, np.zeros(len(rows)))
    base = matrix[:, given.columns(known)]
    guesses = parameters.values(parameters.guess)
    for name in names:
        unknown = [component for component in components_of(name) if component not in known]
        columns = given.columns(unknown)
        drop, _, p = explained(matrix[:, columns], base, errors)
        if drop:
            change = solved(np.column_stack([matrix[:, columns], base]), errors)[0][:len(columns)]
            value = (guesses[columns] + change * parameters.scales[columns]).tolist()
            # No actuator acts before its command.
            if name not in ('torque_delay', 'torque_lag') or value[0] >= 0.0:
                yield Suspect(name, drop, p, value)


def _largest(suspects: Sequence[Suspect]) -> list[Suspect]:
    """Return a list with only the best suspect, or an empty list if there is none."""
    return [max(suspects, key=lambda one: one.chi2_drop)] if suspects else []


def _changes(solution: Solution) -> Iterator[Suspect]:
    """Generate suspects for a change in the inertia at the start of each window but the first."""
    names = [name for name in solution.problem.parameters.names if name.startswith('inertia')]
    if not names:
        return
    problem = widened(solution, pieces=_PIECES)
    given = linear(problem)
    inertia, (base, errors) = given.columns(names), given.stacked()
    for k, window in enumerate(problem.windows):
        if window.is_first:
            continue
        later = [other.experiment == window.experiment and i >= k
                 for i, other in enumerate(problem.windows)]
        drop, _, p = explained(given.split(inertia, later), base, errors)
        # Only the best of many trial times is kept, so apply the Bonferroni correction.
        yield _change(drop, p * len(problem.windows),
                      1e-9 * (window.anchor_ns - window.origin_ns))


def _breaks(solution: Solution) -> Iterator[Suspect]:
    """
    Generate suspects for a change in the inertia at the time when outliers begin or end.

    If the inertia changes a lot, the fit follows the motion either before or after the change, and
    all samples in the other part are outliers.
    """
    for one in of_training(solution):
        bad = np.cumsum(~one.inliers)
        count = np.arange(1, len(bad) + 1)
        after = (bad[-1:] - bad) / np.maximum(len(bad) - count, 1)
        edge = max(FEWEST, round(_EDGE * len(bad)))
        apart = np.abs(bad / count - after)[edge:-edge]
        if not apart.size or apart.max() < _APART:
            continue
        stamp_ns = one.stamps_ns[edge + int(np.argmax(apart))]
        start_ns = solution.problem.setup.problems[one.recording].start.time_ns
        left = one.errors[~one.inliers] / one.noise
        drop = float(np.sum(left ** 2))
        yield _change(drop, tail(drop, left.size), 1e-9 * float(stamp_ns - start_ns))


def _change(drop: float, p: float, seconds: float) -> Suspect:
    """Return a change in the inertia at a time since the start, s."""
    return Suspect(INERTIA_CHANGE, drop, p, [seconds],
                   f'the inertia changes about {seconds:.4g} s after the start')


def _validation(findings: Findings, every: Sequence[Sequence[Measured]],
                ahead: Sequence[Residuals]) -> Iterator[tuple[float, Reason | None]]:
    """
    Generate two values for each recording: how long its motion is predictable, s, and a reason.

    The reason speaks against the model if the validation errors of the recording are too large.
    Otherwise, the reason is None.
    """
    from scipy.special import ndtr
    for number, channels in enumerate(every):
        own = [one for one in ahead if one.recording == number]
        statistic, count, predictable_s = foresight(findings.solution, number, channels, own,
                                                    findings.noises[number])
        overlap = max((noise.overlap for noise in findings.noises[number]), default=1.0)
        p = float(ndtr((count - statistic) / np.sqrt(2.0 * max(count, 1) * overlap)))
        ratio = np.sqrt(statistic / max(count, 1))
        reason = Reason(f'errors of the validation are {ratio:.2g} times what noise and '
                        f'uncertainty explain ({probability(p)})')
        yield predictable_s, reason if p < ALARM else None
