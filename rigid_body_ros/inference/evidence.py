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
Linearize a fit at its solution, to find out how much the fit would improve with more parameters.

The derivatives with respect to all parameters, whether estimated or not, form a linear
least-squares problem with only a few rows. For each parameter that was not estimated, a *score
test* (Rao 1948) computes how much the sum of the squared errors would drop if the parameter were
estimated too. If the parameter has no effect, this drop follows a chi-square distribution. The
same derivatives tell which combinations of parameters the data does not determine, and for how
long the fitted motion can be predicted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import as_json, Floats
from rigid_body_ros.inference.coordinates import LONGEST_DELAY
from rigid_body_ros.inference.errors import ahead_of, Residuals
from rigid_body_ros.inference.fit import LeastSquares, Solution, triangle, Weight
from rigid_body_ros.inference.growth import polished, states_at
from rigid_body_ros.inference.noise import LEAST, Noise, noise_of, tail
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.scene.quantities import field_of, MOMENT

#: What remains of a column after its projection onto other columns is subtracted counts as a
#: rounding error if the norm of the remainder is at most this fraction of the column's norm.
_ROUNDING = 1e-5
#: A slope that is smaller than this fraction of the largest one is a rounding error.
_NO_SLOPE = 1e-7
#: If the largest of the noise spreads exceeds the smallest by more than this factor, the fit is
#: repeated with weights that are computed from the spreads.
_UNEQUAL = 1.05
#: Maximum number of samples per channel in a window. This limits the memory that is needed.
_LONGEST = 12_000
#: Limits for the standard deviation of a predicted attitude, rad. Above `LOST`, the prediction is
#: useless. Above `_LINEAR`, the linearization is inaccurate.
LOST, _LINEAR = 0.1, 0.02
#: Approximate number of samples used to estimate the noise of a channel.
_ENOUGH = 20_000
#: Derivatives whose relative size is below these limits are rounding errors. `_ZERO` is the limit
#: for derivatives with respect to a single parameter, and `_TINY` is the limit for derivatives
#: with respect to a combination of parameters.
_ZERO, _TINY = 1e-9, 1e-6
#: The data does not determine a combination of parameters if the standard deviation along this
#: combination, relative to the scales of the parameters, exceeds this number.
_WIDEST = 0.5
#: Limits for the components of a `Direction`. A component above `_COUNTS` matters, a component
#: above `_LISTED` is listed in the result, and a component below `_EXACT` is a rounding error, as
#: is the distance of a parameter from its bound, as a fraction of the bound.
_COUNTS, _LISTED, _EXACT = 0.3, 0.05, 1e-3
#: Relative changes of the moments of inertia count as equal if they differ by less than this
#: fraction.
_SAME = 0.1
_RATIOS = ('neither a torque nor a rotor acts, so only the ratios of the moments of inertia enter '
           'the motion')


@dataclass(frozen=True, eq=False)
class Linearized:
    """
    A linear least-squares problem: minimize the sum of squares of `errors + matrix @ change`.

    Attributes
    ----------
    names : list of str
        The name of the component for each column of the matrix.
    blocks : list of array, shape (m, n + 1)
        One block per window: the triangular factor of the window's derivatives and errors,
        without the rows and columns for the state of the window. The last column contains the
        errors. All values are divided by the standard deviations of the errors.
    is_late : list of bool
        Whether each window lies in the second half of its recording.

    """

    names: list[str]
    blocks: list[Floats]
    is_late: list[bool]

    def columns(self, names: Sequence[str]) -> list[int]:
        """Return the column indices of the given components."""
        return [self.names.index(name) for name in names]

    def stacked(self) -> tuple[Floats, Floats]:
        """Return `matrix` and `errors` for all windows together."""
        rows = np.concatenate(self.blocks)
        return rows[:, :-1], rows[:, -1]

    def split(self, columns: Sequence[int], later: Sequence[bool]) -> Floats:
        """Return columns of the matrix, set to zero in the windows whose `later` is False."""
        return np.concatenate([block[:, columns] * late for block, late
                               in zip(self.blocks, later)])


def explained(others: Floats, base: Floats, errors: Floats) -> tuple[float, int, float]:
    """
    Return how much additional parameters would lower the sum of the squared errors.

    The other results are the number of independent parameters, and the probability of a drop at
    least this large if they have no effect.

    Parameters
    ----------
    others, base : array, shape (m, k) and (m, n)
        `base` has a column for each parameter that was fitted, and `others` has a column for each
        additional parameter.
    errors : array, shape (m,)
        The errors, in standard deviations.

    """
    left, basis = np.column_stack([others, errors]), _basis(base)
    left = left - basis @ (basis.T @ left)
    norms = np.linalg.norm(others, axis=0)
    kept = np.linalg.norm(left[:, :-1], axis=0) > _ROUNDING * np.maximum(norms, 1e-300)
    if not kept.any():
        return 0.0, 0, 1.0
    basis = _basis(left[:, :-1][:, kept])
    drop = float(np.sum((basis.T @ left[:, -1]) ** 2))
    return drop, basis.shape[1], tail(drop, basis.shape[1])


def solved(matrix: Floats, errors: Floats) -> tuple[Floats, Floats]:
    """
    Solve a `Linearized` problem.

    Return the solution `change` and the standard deviation of each of its entries.
    """
    norms = np.linalg.norm(matrix, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0)
    left, singular, right = np.linalg.svd(matrix / norms, full_matrices=False)
    kept = singular > _ROUNDING * singular.max(initial=0.0)
    inverse = right[kept].T / singular[kept]
    deviations = np.linalg.norm(inverse, axis=1)
    deviations[(np.abs(right[~kept]) > 1e-3).any(axis=0)] = np.inf
    return -(inverse @ (left[:, kept].T @ errors)) / norms, deviations / norms


def _basis(columns: Floats) -> Floats:
    norms = np.linalg.norm(columns, axis=0)
    left, singular, _ = np.linalg.svd(columns / np.where(norms > 0.0, norms, 1.0),
                                      full_matrices=False)
    return left[:, singular > _ROUNDING * singular.max(initial=0.0)]


def widened(solution: Solution, names: Sequence[str] = (), pieces: int = 1) -> LeastSquares:
    """
    Return the problem of a fit with additional parameters and at least `pieces` windows.

    Parameters
    ----------
    solution : Solution
        The fit.
    names : sequence of str
        The names of the additional parameters.
    pieces : int
        Minimum number of windows, counted over all recordings.

    """
    old = solution.problem
    samples = max(len(channel) for channels in old.setup.channels for channel in channels)
    parts = -(-max(pieces, -(-samples // _LONGEST)) // len(old.windows))
    # The fitted motion jumps wherever a window of the solution begins. A window of the new problem
    # must therefore begin at each of these times, too.
    windows = old.setup.windows(solution.length_ns, solution.physics, parts)
    setup = old.setup.extended(solution.physics, names)
    return LeastSquares(setup, windows, states_at(solution, windows), solution.weights)


def linear(problem: LeastSquares) -> Linearized:
    """Linearize a problem, with all of its windows, at the guess of the parameters."""
    blocks, is_late = [], []
    middles = [(int(channels[0].stamps_ns[0]) + int(channels[0].stamps_ns[-1])) // 2
               for channels in problem.setup.channels]
    for k, window in enumerate(problem.windows):
        own = len(problem.unknowns[k])
        blocks.append(triangle(_rows(problem, k))[own:, own:])
        stamps_ns = np.concatenate([channel.stamps_ns for channel in window.channels])
        is_late.append(bool(np.mean(stamps_ns) > middles[window.experiment]))
    return Linearized(problem.parameters.names, blocks, is_late)


def noises_of(problem: LeastSquares) -> list[list[Noise]]:
    """
    Estimate the noise of each channel of each recording, relative to the weights of the fit.

    The estimate uses the errors that would remain if all parameters of the problem were fitted.
    """
    chosen = [*_few(problem)]
    rows = [_rows(problem, k, keeps=True) for k in chosen]
    own = [len(problem.unknowns[k]) for k in chosen]
    matrix = np.concatenate([triangle(slopes.copy())[count:, count:]
                             for slopes, count in zip(rows, own)])
    change = solved(matrix[:, :-1], matrix[:, -1])[0]
    parts: list[list[list[Floats]]] = [[[] for _ in every] for every in problem.setup.channels]
    total = sum(slopes.shape[1] for slopes in rows)
    share = total / max(total - len(change) - sum(own), 1)
    for k, slopes, count in zip(chosen, rows, own):
        left, of_state = slopes[-1] + change @ slopes[count:-1], slopes[:count].T
        if count:
            left = left - of_state @ np.linalg.lstsq(of_state, left, rcond=None)[0]
        for channel, part in split_channels(problem, k, left):
            parts[problem.windows[k].experiment][channel].append(part)
    return [[noise_of(errors, share) if errors else Noise(np.ones(3)) for errors in every]
            for every in parts]


def with_noise(solution: Solution, noises: list[list[Noise]]) -> Solution:
    """Return a fit with `weighted` weights, repeated if the noise spreads are not about equal."""
    solution = weighted(solution, noises)
    sizes = np.concatenate([weight.spread for every in solution.weights for weight in every])
    is_final = solution.problem.setup.most or sizes.max() <= _UNEQUAL * sizes.min()
    return solution if is_final else polished(solution)


def weighted(solution: Solution, noises: list[list[Noise]]) -> Solution:
    """Return a fit with weights that account for the size and persistence of the errors."""
    setup = solution.problem.setup

    def spread(channel: Measured, noise: Noise) -> Floats:
        # Use relative sizes, because the next fit estimates the factor common to all axes. If a
        # sensor is stuck, one axis may have no errors. That axis must not dominate the fit.
        relative = noise.sizes / max(float(np.sqrt(np.mean(noise.sizes ** 2))), 1e-300)
        sizes = np.ones(3) if setup.noise_of(channel.is_attitude) else np.maximum(relative, LEAST)
        return sizes * noise.lasting
    return solution.with_spreads([[spread(*pair) for pair in zip(*every)]
                                  for every in zip(setup.channels, noises)])


def foresight(solution: Solution, number: int, channels: Sequence[Measured],
              residuals: Sequence[Residuals], noises: Sequence[Noise]
              ) -> tuple[float, int, float]:
    """
    Assess how well a fit predicts the validation samples of a recording.

    Parameters
    ----------
    solution : Solution
        The fit.
    number : int
        Index of the recording.
    channels : sequence of Measured
        The channels of the recording, including the samples that were not fitted.
    residuals : sequence of Residuals
        The errors of the samples that were not fitted, for each channel.
    noises : sequence of Noise
        The noise of each channel.

    Returns
    -------
    statistic : float
        Sum of the squared errors, minus the part that the uncertainty of the fit explains. If the
        model is correct and the noise is white, the statistic has a chi-square distribution.
    count : int
        Number of errors in the sum, not counting outliers. The sum stops before the first sample
        whose predicted attitude has an uncertainty above 0.02 rad, because the linearization fails
        at larger uncertainties.
    predictable_s : float
        Time since the start, s, at which the standard deviation of the predicted attitude first
        exceeds 0.1 rad. Infinite if this never happens.

    """
    old = solution.problem
    k, ahead = ahead_of(solution, number, channels)
    weights = [*solution.weights]
    # The spreads in the weights are those of averages over many errors. Convert them to the
    # spreads of single errors.
    weights[number] = [Weight(weight.sigma, errors.inliers.astype(float),
                              weight.spread / noise.lasting)
                       for weight, errors, noise in zip(weights[number], residuals, noises)]
    problem = LeastSquares(old.setup, [ahead], old.reference.rows([k]), weights)
    # The parameters come before the state, as in the information matrix.
    slopes = np.roll(problem.derivatives(0, solution.physics), -len(problem.unknowns[0]), axis=0)
    information = old.information(solution.physics, [k])
    deviations = _deviations(information, slopes)
    sigma = np.concatenate([np.tile(errors.noise * errors.is_attitude * weight.spread,
                                    len(errors.errors))
                            for errors, weight in zip(residuals, weights[number])])
    stamps_ns, inliers = (np.concatenate([np.repeat(getattr(errors, name), 3)
                                          for errors in residuals])
                          for name in ('stamps_ns', 'inliers'))
    angles = np.where(sigma > 0.0, deviations, 0.0) * sigma  # a rate may have no deviation
    lost, vague = (stamps_ns[angles > limit] for limit in (LOST, _LINEAR))
    used = stamps_ns < vague.min() if vague.size else np.ones(stamps_ns.shape, bool)
    rows = np.concatenate([information, np.zeros((len(information), 1))], axis=1)
    scaled = problem.scaled_errors(0, solution.physics)
    rows = np.concatenate([rows, np.vstack([slopes, scaled]).T[used]])
    statistic = float(triangle(rows.T.copy())[-1, -1] ** 2)
    predictable_s = 1e-9 * float(lost.min() - ahead.origin_ns) if lost.size else np.inf
    return statistic, int(np.sum(used & inliers)), predictable_s


def _deviations(information: Floats, slopes: Floats) -> Floats:
    """Return the standard deviations of predictions, with infinity for undetermined ones."""
    _, singular, right = np.linalg.svd(information)
    kept = singular > _ROUNDING * _ROUNDING * singular.max(initial=0.0)
    deviations = np.linalg.norm((right[kept] @ slopes) / singular[kept, None], axis=0)
    # Rounding leaves a small slope in directions without an effect.
    least = _NO_SLOPE * np.abs(slopes).max(initial=0.0)
    return np.where((np.abs(right[~kept] @ slopes) > least).any(axis=0), np.inf, deviations)


def split_channels(problem: LeastSquares, k: int, errors: Floats) -> Iterator[tuple[int, Floats]]:
    """
    Generate the index of each channel in a window, with the errors of the channel.

    The errors are an array of shape (n, 3), in which the errors of outliers are NaN.
    """
    window, first = problem.windows[k], 0
    for channel, rows in enumerate(window.rows):
        root = problem.weights[window.experiment][channel].root[rows]
        if not len(root):
            continue
        part = errors[first:first + 3 * len(root)].reshape(-1, 3)
        first += 3 * len(root)
        yield channel, np.where(root[:, None] > 0.0, part, np.nan)


def _few(problem: LeastSquares) -> Iterator[int]:
    """
    Generate the indices of the first windows of each recording.

    The chosen windows of a recording contain about `_ENOUGH` samples, if there are that many.
    """
    counts = [0] * len(problem.setup.channels)
    for k, window in enumerate(problem.windows):
        if counts[window.experiment] < _ENOUGH:
            counts[window.experiment] += max(len(channel) for channel in window.channels)
            yield k


def _rows(problem: LeastSquares, k: int, keeps: bool = False) -> Floats:
    """Return the derivatives of a window's errors at the guess, with the errors as last row."""
    physics = problem.parameters.guess
    return np.concatenate([problem.derivatives(k, physics, keeps),
                           problem.scaled_errors(k, physics)[None]])


@dataclass(frozen=True)
class Direction:
    """
    A combination of parameters that the data does not determine.

    Attributes
    ----------
    components : dict of str to float
        How much each parameter changes along this combination, relative to its scale.
    reason : str
        Why the data does not determine this combination.

    """

    components: dict[str, float]
    reason: str


def certainty(factor: Floats, names: Sequence[str], values: Floats
              ) -> tuple[Floats, NDArray[np.bool_], list[Direction]]:
    """
    Compute from the information matrix how well the data determines the parameters.

    Parameters
    ----------
    factor : array, shape (m, n)
        A matrix F such that F^T F is the information matrix of the parameters divided by their
        scales.
    names : sequence of str, length n
        The names of the parameters.
    values : array, shape (n,)
        The parameters, divided by their scales. The data does not determine a parameter that is at
        its bound, and the other parameters are judged as if it were known.

    Returns
    -------
    covariance : array, shape (n, n)
        Covariance of the parameters after each has been divided by its scale.
    identifiable : array of bool, shape (n,)
        Whether the data determines each parameter.
    directions : list of Direction
        The combinations of parameters that the data does not determine.

    """
    null, rest = _split(np.where(_at_bound(names, values), 0.0, factor))
    _, singular, rows = np.linalg.svd(factor @ rest, full_matrices=False)
    vectors = rest @ rows.T
    covariance = (vectors / singular ** 2) @ vectors.T
    weak = vectors[:, singular * _WIDEST < 1.0]
    identifiable = np.sqrt(np.diag(covariance)) <= _WIDEST
    identifiable &= (np.abs(null) <= _EXACT).all(axis=1) & (np.abs(weak) <= _COUNTS).all(axis=1)
    for vector in (*null.T, *weak.T):
        identifiable[np.argmax(np.abs(vector))] = False
    directions = [_direction(names, values, vector) for vector in (*null.T, *weak.T)]
    if any(direction.reason == _RATIOS for direction in directions):
        identifiable &= ~_chosen(names, 'inertia')
    return covariance, identifiable, directions


def _at_bound(names: Sequence[str], values: Floats) -> NDArray[np.bool_]:
    """Return which parameters are at a bound. Only the torque delay has bounds."""
    return np.array([name == 'torque_delay' for name in names], bool) & (
        np.abs(values) >= (1.0 - _EXACT) * LONGEST_DELAY)


def _split(factor: Floats) -> tuple[Floats, Floats]:
    """
    Split the space of the parameters into directions without and with an effect.

    Return two matrices, one for each subspace. The columns are an orthonormal basis of the
    subspace.
    """
    norms = np.linalg.norm(factor, axis=0)
    zero = norms <= _ZERO * norms.max(initial=1e-300)
    norms = np.where(zero, 1.0, norms)
    _, singular, rows = np.linalg.svd(np.where(zero, 0.0, factor / norms))
    singular = np.append(singular, np.zeros(len(norms) - len(singular)))
    vectors = (rows[singular < _TINY] / norms).T
    basis = np.linalg.qr(vectors, mode='complete')[0]
    count = vectors.shape[1]
    return basis[:, :count], basis[:, count:]


def _direction(names: Sequence[str], values: Floats, vector: Floats) -> Direction:
    """Return a direction with the first reason that holds."""
    vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
    components = {name: round(float(part), 4) for name, part in zip(names, vector)
                  if abs(part) >= _LISTED}
    inertia = _chosen(names, 'inertia')
    ratios = vector[inertia][:3] / values[inertia][:3]  # relative changes of the moments
    scales_inertia = ratios.size > 0 and np.ptp(ratios) < _SAME * np.abs(ratios).max()
    parts, wider = ({MOMENT if field_of(name[:-2]) else name.split('.')[0]
                     for name, part in zip(names, vector) if abs(part) >= least}
                    for least in (_COUNTS, _LISTED))
    of_torque = {'torque_gain', 'torque_bias', 'damping', 'initial_rotor_momentum', MOMENT}
    reasons = (
        (vector[_at_bound(names, values)].any(),
         f'at its bound of {LONGEST_DELAY:g} s: the errors are smallest at or beyond it; check '
         'the stamps of the torques'),
        (scales_inertia and wider & of_torque,
         'only the ratio of torque to inertia enters the motion'),
        (scales_inertia and wider == {'inertia'}, _RATIOS),
        (parts == {'inertia'}, 'the motion excites these moments too little: turn the body about '
                               'all three axes, at changing rates'),
        ('gyro_bias' in parts, 'a bias of the gyro cannot be told from a slow rotation'),
        ({'mount', 'initial_attitude'} <= parts,
         'a rotation of the sensor cannot be told from one of the body'),
        ('clock_offset' in parts, 'the motion changes too little for a shift in time to show'),
        ('torque_gain' in parts, 'the torque is too small to show'),
        (True, 'these parameters change the prediction too little, or in the same way'))
    return Direction(components, next(text for holds, text in reasons if holds))


def _chosen(names: Sequence[str], prefix: str) -> NDArray[np.bool_]:
    return np.array([name.split('.')[0] == prefix for name in names], bool)


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
