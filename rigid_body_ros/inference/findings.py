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
Judge a fit: run the tests of `reasons` and the searches of `hypotheses`, and collect the results.

Each test raises a false alarm with probability 1e-4, and about forty tests apply to a model. More
than 99 out of 100 correct models therefore get the verdict 'explained'.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from rigid_body_ros.inference.errors import of_training, Residuals
from rigid_body_ros.inference.evidence import (
    explained,
    foresight,
    linear,
    noises_of,
    solved,
    Suspect,
    widened,
    with_noise,
)
from rigid_body_ros.inference.fit import LeastSquares, Solution
from rigid_body_ros.inference.growth import (
    COARSEST,
    grown,
    has_lasting_errors,
    is_linear,
    polished,
    rough,
)
from rigid_body_ros.inference.hypotheses import fault_of_all_samples, faults_of_outliers
from rigid_body_ros.inference.noise import ALARM, FEWEST, Noise, SMALLEST, tail
from rigid_body_ros.inference.reasons import (
    at_rest,
    halves,
    left_by,
    MOST_UNEXPLAINED,
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
        from scipy.special import ndtr
        if not ahead or not self.noises:
            return self
        seconds, reasons = np.inf, [*self.reasons]
        for number, (channels, levels) in enumerate(zip(every, self.noises)):
            own = [part for part in ahead if part.recording == number]
            statistic, count, predictable_s = foresight(self.solution, number, channels, own,
                                                        levels)
            seconds, overlap = min(seconds, predictable_s), max(noise.overlap for noise in levels)
            p = float(ndtr((count - statistic) / np.sqrt(2.0 * max(count, 1) * overlap)))
            if p < ALARM:
                ratio = np.sqrt(statistic / max(count, 1))
                reasons.append(Reason(f'errors of the validation are {ratio:.2g} times what noise '
                                      f'and uncertainty explain ({probability(p)})'))
        return replace(self, reasons=reasons,
                       predictable_s=seconds if seconds < np.inf else None)


def judged(setup: Setup, names_suspects: bool = True) -> Findings:
    """
    Fit the model, and examine the errors.

    If one fault of the recording explains why even short windows do not fit, the model is not
    examined any further. If `names_suspects` is false, because samples are lost, no fault and no
    parameter is suspected.
    """
    few = rough(setup)
    is_wrong = not at_rest(few) and (
        has_lasting_errors(few) or few.length_ns < setup.shortest_ns or not is_linear(few))
    fault = fault_of_all_samples(few) if is_wrong and names_suspects else None
    if fault is None:
        solution = grown(setup, few)
        findings = examined(polished(solution, *COARSEST) if setup.most else polished(solution))
        if still := at_rest(findings.solution):
            return replace(findings, reasons=[Reason(still, True)], suspects=[], noises=[])
        return findings if names_suspects else replace(findings, suspects=[])
    solution = polished(few, *COARSEST)
    return Findings(solution, solution, [Reason(fault.text, True)], [fault], {}, [])


def examined(solution: Solution) -> Findings:
    """Examine the errors of a fit and return the findings."""
    setup = solution.problem.setup
    rate = max(1.0, setup.rate)
    if all(part.noise <= _TINY * (1.0 if part.is_attitude else rate)
           for part in of_training(solution)):
        return Findings(solution, solution, [], [], {}, [])
    names, fitted = setup.candidates(), setup.parameters.names
    problem = widened(solution, names)
    noises, before = noises_of(problem), solution
    solution = with_noise(solution, noises)
    problem = problem.weighted(solution.weights) if solution.physics is before.physics else \
        widened(solution, names)
    suspects = [*faults_of_outliers(solution), *_parameters(problem, fitted, names)]
    if not setup.is_computed:
        suspects = [suspect for suspect in suspects
                    if suspect.chi2_drop > _VISIBLE * solution.count]
    # If nothing is fitted, what explains much of the other errors also explains the outliers.
    elif fitted or all(suspect.chi2_drop <= LARGE * solution.count for suspect in suspects):
        suspects += _change(solution)
    reasons, drift, _ = halves(solution)
    reasons += tests_of(solution, noises)
    result = Findings(solution, solution, reasons, _significant(suspects), drift, noises)
    return _doubted(result, problem, names) if fitted and (reasons or result.suspects) else result


def _significant(suspects: Iterable[Suspect]) -> list[Suspect]:
    return sorted((suspect for suspect in suspects if suspect.p < ALARM),
                  key=lambda suspect: -suspect.chi2_drop)


def _doubted(findings: Findings, problem: LeastSquares, names: Sequence[str]) -> Findings:
    """
    Examine the errors again, as those of a model that is a little wrong.

    Such errors are as uncertain as their own correlation makes them, and what may be wrong has a
    plausible size. Only halves of a recording that differ even then reject the model.
    """
    solution = with_persistence(findings.solution, findings.noises)
    fitted = solution.problem.setup.parameters.names
    blunt, sharp = (_significant(_parameters(weighted_problem, fitted, names, is_plausible=True))
                    for weighted_problem in (problem.weighted(solution.weights), problem))
    suspects = _significant([*faults_of_outliers(solution), *blunt, *_change(solution)])
    # A suspect may also be what makes the errors last.
    named = {suspect.name for suspect in blunt}
    suspects += [suspect for suspect in sharp[:_SHARP] if suspect.name not in named]
    contradictions, drift, apart = halves(solution)
    reasons = [*(Reason(text, part > MOST_UNEXPLAINED) for text, part in left_by(solution)),
               *contradictions,
               *(reason for reason in findings.reasons if not reason.is_contradiction)]
    texts, scatter = scattered(solution)
    return replace(findings, solution=solution, drift=drift, apart=apart, scatter=scatter,
                   reasons=[*reasons, *map(Reason, texts)], suspects=suspects)


def start_suspect(solution: Solution) -> Suspect | None:
    """Return the start as a suspect, unless the fitted start is the given one within the noise."""
    problem, setup = solution.problem, solution.problem.setup
    start, states, unknown = setup.start(0), problem.reference, problem.unknowns[0]
    turned = so3.difference(states.attitude[0], start.attitude)
    faster = start.angular_velocity - states.angular_velocity[0]
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


def _parameters(problem: LeastSquares, fitted: Sequence[str], names: Sequence[str],
                is_plausible: bool = False) -> Iterator[Suspect]:
    """Generate a suspect for each parameter that was not estimated."""
    fit, parameters = linear(problem), problem.parameters
    matrix, errors = fit.stacked()
    if is_plausible:
        rows = np.diag(parameters.scales / parameters.plausible)[
            [name not in fitted for name in fit.names]]
        matrix = np.concatenate([matrix, rows])
        errors = np.append(errors, np.zeros(len(rows)))
    base = matrix[:, fit.columns(fitted)]
    guesses = parameters.values(parameters.guess)
    for name in names:
        columns = fit.columns([component for component in components_of(name)
                               if component not in fitted])
        drop, _, p = explained(matrix[:, columns], base, errors)
        if drop:
            change = solved(np.column_stack([matrix[:, columns], base]), errors)[0][:len(columns)]
            value = (guesses[columns] + change * parameters.scales[columns]).tolist()
            # No actuator acts before its command.
            if name not in ('torque_delay', 'torque_lag') or value[0] >= 0.0:
                yield Suspect(name, drop, p, value)


def _change(solution: Solution) -> list[Suspect]:
    """Return a list with the most likely change in the inertia, or an empty list."""
    changes = [*_at_windows(solution), *_at_outliers(solution)]
    drop, p, seconds = max(changes, default=(0.0, 1.0, None), key=lambda change: change[0])
    return [] if seconds is None else [
        Suspect(INERTIA_CHANGE, drop, p, [seconds],
                f'the inertia changes about {seconds:.4g} s after the start')]


def _at_windows(solution: Solution) -> Iterator[tuple[float, float, float]]:
    """
    Generate changes in the inertia at the start of each window but the first.

    A change is how much the chi-square falls, the probability of this, and the time in seconds.
    """
    names = [name for name in solution.problem.parameters.names if name.startswith('inertia')]
    if not names:
        return
    problem = widened(solution, pieces=_PIECES)
    fit = linear(problem)
    inertia, (base, errors) = fit.columns(names), fit.stacked()
    for k, window in enumerate(problem.windows):
        if window.is_first:
            continue
        later = [other.experiment == window.experiment and i >= k
                 for i, other in enumerate(problem.windows)]
        drop, _, p = explained(fit.split(inertia, later), base, errors)
        # Only the best of many trial times is kept, so apply the Bonferroni correction.
        yield drop, p * len(problem.windows), 1e-9 * (window.anchor_ns - window.origin_ns)


def _at_outliers(solution: Solution) -> Iterator[tuple[float, float, float]]:
    """
    Generate changes in the inertia, as `_at_windows`, at the time when outliers begin or end.

    If the inertia changes a lot, the fit follows the motion either before or after the change, and
    all samples in the other part are outliers.
    """
    for part in of_training(solution):
        bad = np.cumsum(~part.inliers)
        count = np.arange(1, len(bad) + 1)
        after = (bad[-1:] - bad) / np.maximum(len(bad) - count, 1)
        edge = max(FEWEST, round(_EDGE * len(bad)))
        apart = np.abs(bad / count - after)[edge:-edge]
        if not apart.size or apart.max() < _APART:
            continue
        stamp_ns = part.stamps_ns[edge + int(np.argmax(apart))]
        start_ns = solution.problem.setup.problems[part.recording].start.time_ns
        yield *part.chi_square(~part.inliers), 1e-9 * float(stamp_ns - start_ns)
