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
Fit the model in windows of increasing length, and estimate the noise and the outliers.

The first fit uses short windows and guesses the state of each window from the measurements. A bad
guess does no harm in a short window, because errors have no time to grow. The following fits use
longer and longer windows, each starting from the result of the previous fit. If possible, the last
fit covers the whole recording with a single window. Sometimes such a fit is not good, for example
because the motion magnifies errors too much. The last fit then uses the longest windows that still
give a good fit.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import chain, pairwise

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.inference.coordinates import LONGEST_DELAY, Physics
from rigid_body_ros.inference.fit import (
    errors_of,
    LeastSquares,
    median_size,
    ROUNDING,
    Solution,
    solution_of,
    Weight,
)
from rigid_body_ros.inference.guess import local_state
from rigid_body_ros.inference.noise import rms
from rigid_body_ros.inference.setup import Setup
from rigid_body_ros.inference.windows import corrected, Window
from rigid_body_ros.mechanics.states import Poses

#: The first fit may have ended in the wrong minimum if adjacent errors have a correlation above
#: this limit.
_LASTING = 0.5
#: Errors that differ by this factor are much larger, or much smaller.
_MUCH = 2.0
#: Maximum number of windows, and of evaluations, in the first fit, which only needs to find
#: approximate parameters, and in a fit that only compares hypotheses.
_FIRST, _SCREENED = (8, 30), (4, 10)
#: Factors by which the windows may grow, in the order in which they are tried. If the first fit
#: may have ended in the wrong minimum, its windows shrink by the first factor.
_GROWTH = (8, 4, 2)
#: Derivatives are useful only if the prediction errors are below this number. The unit is rad for
#: attitudes; errors of angular velocities are relative to the rate.
_LINEAR = 0.3
#: Maximum number of evaluations in a fit with longer windows. A fit that needs more evaluations is
#: too nonlinear to give reliable intervals.
_FAST = 6
#: A fit with longer windows is good if the errors grow by a factor of at most `_WORSE` in all
#: windows together, and by a factor of at most `_MUCH` in each single window.
_WORSE = 1.1
#: Arguments of `polished` for fits that must not take long: the number of fits, their tolerance,
#: and their maximum number of evaluations.
COARSE, COARSEST = (2, 1e-6, 20), (1, 1e-3, 10)
#: A new window that begins at most this long before an old window, ns, starts from the state of
#: the old window. The times may differ slightly because a fit changes the clock offsets.
_SAME_NS = 1_000_000


def grown(setup: Setup, few: Solution | None = None) -> Solution:
    """Fit with longer and longer windows, starting from `rough`, and return the last good fit."""
    few = few or rough(setup)
    solution = _first(setup, setup.windows(few.length_ns, few.physics), few.physics)
    solution = fitted(solution, few.length_ns, 1e-2, 12)
    if better := _restarted(solution):
        solution = fitted(better, few.length_ns, 1e-2, 12, windows=better.problem.windows)
    while solution.length_ns < setup.longest_ns:
        longer = _longer(solution)
        if longer is None:
            break
        solution = longer
    return solution


def solved_whole(setup: Setup) -> Solution:
    """
    Fit each recording in one window, even if the model does not fit it well.

    If the start is fitted, the fit begins with longer and longer windows.
    """
    guess = _guess(setup)
    solution = grown(setup) if setup.fits_start else _first(
        setup, setup.windows(setup.span_ns, guess), guess)
    if solution.length_ns < setup.span_ns or not setup.fits_start:
        solution = fitted(solution, setup.span_ns, *COARSE[1:])
    return polished(solution, *COARSE)


def rough(setup: Setup) -> Solution:
    """
    Fit the parameters to a few of the shortest windows.

    If the remaining errors persist over many samples, the fit may have ended in the wrong minimum.
    In that case, another guess comes from a fit to even shorter windows, in which errors have less
    time to grow. Without parameters, the shorter windows remain if their errors are smaller.
    """
    guess = _guess(setup)
    few = _from_few(setup, setup.shortest_ns, guess)
    if has_lasting_errors(few) and setup.is_computed:
        closer = _from_few(setup, setup.shortest_ns // _GROWTH[0], guess)
        if not setup.parameters.size:
            is_much_less = log_misfit(closer) < log_misfit(few) - np.log(_MUCH)
            return closer if is_much_less else few
        few = min(few, _from_few(setup, setup.shortest_ns, closer.physics), key=log_misfit)
    return few


def screened(setup: Setup) -> Solution:
    """Fit very few of the shortest windows, to compare the errors of different setups."""
    return _from_few(setup, setup.shortest_ns, _guess(setup), _SCREENED)


def _guess(setup: Setup) -> Physics:
    return setup.parameters.physics(setup.parameters.coordinates(setup.parameters.guess))


def _from_few(setup: Setup, length_ns: int, guess: Physics,
              most: tuple[int, int] = _FIRST) -> Solution:
    """Fit a few windows, starting from states that are guessed from the measurements."""
    few = setup.windows(length_ns, guess, few=most[0])
    return fitted(_first(setup, few, guess), length_ns, 1e-2, most[1], windows=few)


def has_lasting_errors(solution: Solution) -> bool:
    """Return whether the errors of adjacent samples are strongly correlated in any channel."""
    for error in chain(*solution.errors):
        limit = 3.0 * median_size(error)  # so that outliers do not dominate
        clipped = np.clip(error, -limit, limit)
        if np.nansum(clipped[1:] * clipped[:-1]) > _LASTING * np.nansum(clipped ** 2):
            return True
    return False


def is_linear(solution: Solution) -> bool:
    """Return whether the errors are small enough for the linear tests of parameters."""
    return max(_relative(solution)) <= _LINEAR


def log_misfit(solution: Solution) -> float:
    """Return the sum of the logarithms of the errors of all channels, relative to their values."""
    return float(np.sum(np.log(np.maximum(_relative(solution), ROUNDING))))


def _relative(solution: Solution) -> list[float]:
    """Return the error of each channel on its worst axis, relative to the values."""
    return [max(map(median_size, error.T)) / max(rms(channel.values), 1e-12)
            for every, channels in zip(solution.errors, solution.problem.setup.channels)
            for error, channel in zip(every, channels)]


def _longer(solution: Solution) -> Solution | None:
    """Return a good fit with longer windows, or None if there is no such fit."""
    setup = solution.problem.setup
    for factor in _GROWTH:
        length_ns = min(factor * solution.length_ns, setup.longest_ns)
        windows = setup.windows(length_ns, solution.physics)
        problem = LeastSquares(setup, windows, states_at(solution, windows), solution.weights)
        if factor == _GROWTH[-1] or _predicts(problem, solution.physics):
            longer = fitted(solution, length_ns, 1e-3, _FAST)
            if _fits(longer, solution):
                return longer
    return None


def polished(solution: Solution, rounds: int = 8, tolerance: float = 1e-7,
             most: int = 50) -> Solution:
    """
    Return the maximum-likelihood fit to all samples that are not outliers.

    The fit is repeated up to `rounds` times, until noise and outliers stay the same.
    """
    previous = replace(solution, weights=[
        [weight._replace(root=inliers.astype(float)) for weight, inliers in zip(*every)]
        for every in zip(solution.weights, solution.inliers)])
    for _ in range(rounds):
        solution = fitted(previous, previous.length_ns, tolerance, most, is_last=True)
        same = all(map(np.array_equal, chain(*solution.inliers), chain(*previous.inliers)))
        new, old = ([weight.sigma for weight in chain(*fit.weights)]
                    for fit in (solution, previous))
        if same and np.allclose(new, old, rtol=1e-3):
            break
        previous = solution
    return solution


def _first(setup: Setup, windows: list[Window], physics: Physics) -> Solution:
    """
    Return a solution from which the first fit can start.

    The parameters are given, and the states of the windows are guessed from the measurements.
    """
    sensors = [corrected(channels, physics, problem.start.time_ns)
               for problem, channels in zip(setup.problems, setup.channels)]
    pairs = []
    for window in windows:
        start = setup.problems[window.experiment].start
        if window.is_first and not setup.fits_start:
            pairs.append((start.attitude, start.angular_velocity))
            continue
        both = (local_state(sensors[window.experiment], window.anchor_ns, setup.rate, start),
                (start.attitude, start.angular_velocity))
        best = np.argmin(_medians(window, physics, *both)) if window.is_first else 0
        pairs.append(both[int(best)])
    states = _joined(pairs)
    ones = [[Weight(1.0, np.ones(len(channel)), np.ones(3)) for channel in channels]
            for channels in setup.channels]
    return solution_of(LeastSquares(setup, windows, states, ones), physics, setup.shortest_ns, 0)


def _joined(states: Iterable[tuple[Floats, Floats]]) -> Poses:
    """Return pairs of an attitude and an angular velocity as arrays."""
    return Poses(*(np.array(values) for values in zip(*states)))


def _medians(window: Window, physics: Physics, *states: tuple[Floats, Floats]) -> Floats:
    """Return the sum of the median errors of all channels in a window, for each given state."""
    errors = [errors_of(window.channels, window.predict(physics, Poses(*state)))
              for state in states]
    return np.sum([[np.median(np.linalg.norm(error, axis=1)) for error in every if len(error)]
                   for every in errors], axis=1)


def _restarted(solution: Solution) -> Solution | None:
    """
    Start windows where the window before ends, if that predicts their measurements much better.

    A window may have been fitted to bad samples at its beginning. Return None if this helps no
    window.
    """
    old, physics, is_better = solution.problem, solution.physics, False
    states = [*zip(old.reference.attitude, old.reference.angular_velocity)]
    for k, (before, window) in enumerate(pairwise(old.windows), 1):
        if window.is_first or not old.setup.is_computed:
            continue
        near = before.state_at(physics, Poses(*states[k - 1]), window.anchor_ns)
        own, other = _medians(window, physics, states[k], near)
        if _MUCH * other < own:
            states[k], is_better = near, True
    if not is_better:
        return None
    problem = LeastSquares(old.setup, old.windows, _joined(states), old.weights)
    return solution_of(problem, physics, solution.length_ns, solution.evaluations)


def fitted(previous: Solution, length_ns: int, tolerance: float, most: int,
           is_last: bool = False, windows: Sequence[Window] | None = None) -> Solution:
    """Fit with windows of a given length, starting from the previous fit."""
    from scipy.optimize import least_squares
    setup = _with_fitted_rates(previous)
    windows = windows or setup.windows(length_ns, previous.physics)
    problem = LeastSquares(setup, windows, states_at(previous, windows), previous.weights)
    physics = previous.physics
    if setup.parameters.size:
        # The other coordinates need no bounds.
        bounds = np.array([LONGEST_DELAY if name == 'torque_delay' else np.inf
                           for name in setup.parameters.names])
        result = least_squares(problem.fun, setup.parameters.coordinates(physics), problem.jac,
                               (-bounds, bounds), x_scale='jac', ftol=tolerance, xtol=1e-12,
                               gtol=1e-14, max_nfev=most)
        physics, converged = setup.parameters.physics(result.x), result.status > 0
    else:
        converged = problem.settle(tolerance, most)
    moved = LeastSquares(setup, windows, problem.states(), previous.weights)
    return solution_of(moved, physics, length_ns, previous.evaluations + problem.evaluations,
                       converged, is_last)


def _with_fitted_rates(solution: Solution) -> Setup:
    """
    Return the setup of a solution, with the fitted initial angular velocities for the wheels.

    If no sensor measures an initial angular velocity, it is first guessed from a few noisy
    attitudes. The error of the guess makes the wheel momentum wrong in all later windows.
    """
    setup, problem = solution.problem.setup, solution.problem
    axial = [*setup.axial]
    for window, rate in zip(problem.windows, problem.reference.angular_velocity):
        wheels = axial[window.experiment]
        if window.is_first and wheels:
            axial[window.experiment] = replace(wheels, rate=rate)
    return replace(setup, axial=axial) if any(axial) else setup


def states_at(solution: Solution, windows: Sequence[Window]) -> Poses:
    """Return the states of a solution at the beginning of each given window."""
    old, pairs = solution.problem, []
    begins = [(window.experiment, window.anchor_ns) for window in old.windows]
    for window in windows:
        k = max(bisect_right(begins, (window.experiment, window.anchor_ns + _SAME_NS)) - 1,
                bisect_left(begins, (window.experiment,)))
        pairs.append(old.windows[k].state_at(solution.physics, old.reference.rows(k),
                                             window.anchor_ns))
    return _joined(pairs)


def _predicts(problem: LeastSquares, physics: Physics) -> bool:
    """Return whether the initial errors of a fit are small enough for useful derivatives."""
    setup, errors = problem.setup, problem.residuals(physics)
    return all(
        np.quantile(np.linalg.norm(error[rows], axis=1), 0.9)
        <= _LINEAR * (1.0 if channel.is_attitude else setup.rate)
        for window in problem.windows for channel, rows, error in zip(
            window.channels, window.rows, errors[window.experiment]) if len(channel))


def _fits(longer: Solution, shorter: Solution) -> bool:
    """
    Return whether a fit with longer windows is good.

    A good fit has converged, and its errors are not much larger than those of the fit with shorter
    windows. `_WORSE` limits how much the errors of all windows together may grow, and `_MUCH`
    limits how much the errors in a single window may grow.
    """
    usual = [[median_size(error) for error in every] for every in shorter.errors]
    pairs = [(error, _WORSE * middle) for every, middles in zip(longer.errors, usual)
             for error, middle in zip(every, middles)]
    for window in longer.problem.windows:
        pairs += [(error[rows], _MUCH * middle) for error, rows, middle in zip(
            longer.errors[window.experiment], window.rows, usual[window.experiment])]
    return longer.converged and all(median_size(error) <= most + 1e3 * ROUNDING
                                    for error, most in pairs)
