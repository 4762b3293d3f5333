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
Multiple shooting: one least-squares problem for the parameters and the states of all windows.

The residuals in a window depend on the state at the beginning of the window, and on parameters
that all windows share. A QR decomposition of the derivatives separates the state from the
parameters. The first rows of the triangular factor tell how the state must change for a given
change in the parameters. The remaining rows depend only on the parameters, as in the variable
projection of Golub and Pereyra (1973). The solver uses only these remaining rows, and there are
few of them. The memory and work of the solver therefore do not grow with the number of samples,
and grow only slowly with the number of windows. The solution holds the errors that are left, their
noise, and the weights that follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import kernels
from rigid_body_ros.inference.coordinates import Physics
from rigid_body_ros.inference.noise import NORMAL
from rigid_body_ros.inference.setup import Setup
from rigid_body_ros.inference.windows import Window
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.states import Poses
from rigid_body_ros.recording.measured import Measured

#: Standard deviation of the weak prior that keeps undetermined coordinates close to the guess.
_PRIOR = 3.0
#: Each time the solver rejects a step, the next state correction is multiplied by this factor.
_SHORTER = 0.25
#: A sample is an outlier if its error exceeds this many standard deviations.
_OUTLIER = 5.0
#: If fewer samples than this fraction are within that limit, the limit says nothing, because
#: nearly all samples cannot be outliers.
_RARE = 0.1
#: Smallest standard deviation that the search for outliers assumes, rad or rad/s. Rounding errors
#: are smaller than this and therefore never count as outliers.
_NO_OUTLIER = 1e-8
#: Scale of the Cauchy loss, in standard deviations.
_CAUCHY = 2.4
#: Standard deviations below this number come from rounding errors. The unit is rad for attitudes;
#: standard deviations of angular velocities are relative to the rate.
ROUNDING = 1e-11


class Weight(NamedTuple):
    """
    The weights of the samples of a channel.

    Attributes
    ----------
    sigma : float
        Standard deviation, rad or rad/s.
    root : array, shape (n,)
        Square root of the weight of each sample.
    spread : array, shape (3,)
        For each axis, the effective noise divided by `sigma`. Errors that persist over many
        samples make the effective noise larger.

    """

    sigma: float
    root: Floats
    spread: Floats


#: The weight of each channel of each recording.
Weights = list[list[Weight]]


@dataclass(frozen=True, eq=False)
class _Linearization:
    """
    The problem, linearized at a point.

    Attributes
    ----------
    point : array, shape (n,)
        Coordinates of the shared parameters.
    changes : array, shape (k, 6)
        Scaled differences between the states and the reference states.
    triangles : list of array
        For each window, the triangular factor of its rows.
    residuals, jacobian : array, shape (m,) and (m, n)

    """

    point: Floats
    changes: Floats
    triangles: list[Floats]
    residuals: Floats
    jacobian: Floats


class LeastSquares:
    """
    The least-squares problem for a set of windows.

    Parameters
    ----------
    setup : Setup
    windows : sequence of Window
    states : Poses
        A guess of the state of each window.
    weights : Weights

    """

    def __init__(self, setup: Setup, windows: Sequence[Window], states: Poses,
                 weights: Weights) -> None:
        self.setup, self.windows, self.reference, self.weights = setup, windows, states, weights
        self.parameters = parameters = setup.parameters
        fits_attitude = setup.fits_attitude
        #: Indices of the unknown components of each state. Components 0 to 2 are the rotation
        #: vector of the attitude; components 3 to 5 are the angular velocity.
        self.unknowns = [np.arange(
            0 if fits_attitude[window.experiment] else 3,
            6 if setup.is_computed and (setup.fits_start or not window.is_first) else 0)
            for window in windows]
        self.guess = parameters.coordinates(parameters.guess)
        self.evaluations = 0
        #: `_base` is the problem linearized at the last point that the solver accepted. `_trial`
        #: is the problem linearized at the last point that the solver tried.
        self._base: _Linearization | None = None
        self._trial: _Linearization | None = None
        self._rejected = 0
        #: A cache of `derivatives`: the parameters of the last call, with the derivatives of a
        #: window before they are weighted.
        self._slopes: dict[int, tuple[Physics, list[Floats]]] = {}

    def weighted(self, weights: Weights) -> LeastSquares:
        """Return a copy of this problem with the given weights."""
        other = LeastSquares(self.setup, self.windows, self.reference, weights)
        other._slopes = self._slopes
        return other

    @property
    def size(self) -> int:
        """Return the number of unknowns: shared parameters and unknown components of states."""
        return self.parameters.size + sum(len(unknown) for unknown in self.unknowns)

    def states(self) -> Poses:
        """Return the states at the last point that the solver accepted."""
        assert self._base is not None
        return Poses(*map(np.array, zip(*(
            self._state(k, change) for k, change in enumerate(self._base.changes)))))

    def settle(self, tolerance: float, most: int) -> bool:
        """
        Fit the window states of a problem that has no shared parameters.

        Return whether the fit converged.

        Parameters
        ----------
        tolerance : float
            The fit has converged when a Gauss-Newton step reduces the sum of squares by at most
            this fraction.
        most : int
            Maximum number of steps.

        """
        point: Floats = np.empty(0)
        self.jac(point)
        for _ in range(most):
            assert self._base is not None
            before = float(np.sum(self._base.residuals ** 2))
            trial = self._linearized(point)
            after = float(np.sum(trial.residuals ** 2))
            if after <= before:
                self._base, self._rejected = trial, 0
                if before - after <= tolerance * before:
                    return True
            else:
                self._rejected += 1
        return False

    def fun(self, point: Floats) -> Floats:
        """Return the residuals for the given shared parameters, with the states eliminated."""
        if self._trial is None or not np.array_equal(self._trial.point, point):
            self._trial = self._linearized(point)
            self._rejected += 1
        return self._trial.residuals

    def jac(self, point: Floats) -> Floats:
        """Return the derivatives of `fun` at a point that the solver accepted."""
        self.fun(point)
        self._base, self._rejected = self._trial, 0
        assert self._base is not None
        return self._base.jacobian

    def _linearized(self, point: Floats) -> _Linearization:
        self.evaluations += 1
        shared, changes = self.parameters.size, self._changes(point)
        prior = (point - self.guess) / _PRIOR
        try:
            physics, slopes = self.parameters.physics(point), self.parameters.slopes(point)
            triangles = [self._triangle(k, physics, slopes, change)
                         for k, change in enumerate(changes)]
        except ValueError:  # the body is impossible, or the motion is too fast: reject the step
            return _Linearization(point, changes, [], np.append(prior, np.inf), np.eye(shared))
        residuals = [prior, self.parameters.surprise(physics)]
        jacobian = [np.eye(shared) / _PRIOR, self.parameters.known @ slopes.T]
        for factor, unknown in zip(triangles, self.unknowns):
            own = len(unknown)
            residuals.append(factor[:, -1])
            jacobian.append(np.concatenate([np.zeros((own, shared)), factor[own:, own:-1]]))
        return _Linearization(point, changes, triangles, np.concatenate(residuals),
                              np.concatenate(jacobian))

    def _changes(self, point: Floats) -> Floats:
        """
        Return the scaled changes of all states, shape (k, 6).

        The changes are computed from the linearization at the last point that the solver accepted.
        """
        base = self._base
        if base is None:
            return np.zeros((len(self.windows), 6))
        step, changes = point - base.point, base.changes.copy()
        for factor, unknown, change in zip(base.triangles, self.unknowns, changes):
            own = len(unknown)
            if own:
                wanted = (_SHORTER ** self._rejected * factor[:own, -1]
                          + factor[:own, own:-1] @ step)
                change[unknown] -= np.linalg.solve(factor[:own, :own], wanted)
        return changes

    def _state(self, k: int, change: Floats) -> Poses:
        """Apply a scaled change, shape (6,), to reference state `k`."""
        return Poses(so3.multiply(self.reference.attitude[k], so3.exp(change[:3])),
                     self.reference.angular_velocity[k] + self.setup.rate * change[3:])

    def _triangle(self, k: int, physics: Physics, slopes: Floats, change: Floats) -> Floats:
        """
        Return the triangular factor of a window.

        The columns correspond to the unknowns of the state, then the shared parameters, and
        finally the errors. The array `slopes` has the derivatives of the values of the parameters
        with respect to their coordinates.
        """
        window, unknown = self.windows[k], self.unknowns[k]
        own = len(unknown)
        predicted, by_value = window.linearize(physics, self._state(k, change),
                                               self.parameters.groups)
        rows = self._rows(k, by_value)
        columns = np.zeros((own + len(slopes) + 1, own + rows.shape[1]))
        columns[:own, own:] = self._of_state(rows, change)[unknown]
        columns[own:-1, own:] = slopes @ rows[6:]
        columns[-1, own:] = self._errors(k, predicted)
        columns[np.arange(own), np.arange(own)] = 1.0 / _PRIOR
        columns[-1, :own] = change[unknown] / _PRIOR
        return triangle(columns)

    def _of_state(self, rows: Floats, change: Floats) -> Floats:
        """Convert derivatives with respect to a state to those with respect to its change."""
        return np.concatenate([so3.right_jacobian(change[:3]).T @ rows[:3],
                               self.setup.rate * rows[3:6]])

    def _errors(self, k: int, predicted: Sequence[Floats]) -> Floats:
        """Return the errors of predictions, divided by their standard deviations."""
        return self._rows(k, [error[None] for error in errors_of(
            self.windows[k].channels, predicted)])[0]

    def _rows(self, k: int, errors: list[Floats]) -> Floats:
        """
        Multiply the errors or slopes of all channels by their weights, and join them into c rows.

        The array of each channel has shape (c, n, 3).
        """
        window = self.windows[k]
        return np.concatenate([
            (error * (root[rows, None] / (sigma * spread))).reshape(len(error), -1)
            for error, (sigma, root, spread), rows
            in zip(errors, self.weights[window.experiment], window.rows)], axis=1)

    def residuals(self, physics: Physics) -> list[list[Floats]]:
        """
        Return the errors of each channel for the reference states of all windows.

        The errors of samples that lie outside all windows are NaN.
        """
        result = [[np.full((len(channel), 3), np.nan) for channel in channels]
                  for channels in self.setup.channels]
        for k, window in enumerate(self.windows):
            errors = errors_of(window.channels, window.predict(physics, self.reference.rows(k)))
            for whole, rows, error in zip(result[window.experiment], window.rows, errors):
                whole[rows] = error
        return result

    def information(self, physics: Physics, kept: Sequence[int] | None = None) -> Floats:
        """
        Return F such that F^T F is the information matrix of the unknowns divided by their scales.

        Returns
        -------
        array, shape (m, n)
            The first columns correspond to the shared parameters. The others correspond to the
            states of the windows `kept`, by default the initial state of each recording whose
            start is fitted. The states of all other windows are eliminated.

        """
        if kept is None:
            kept = [k for k, window in enumerate(self.windows)
                    if window.is_first and len(self.unknowns[k])]
        shared = self.parameters.size
        width = shared + sum(len(self.unknowns[k]) for k in kept)
        priors = self.parameters.known * self.parameters.scales
        blocks, column = [np.pad(priors, ((0, 0), (0, width - shared)))], shared
        for k in range(len(self.windows)):
            factor = triangle(self.derivatives(k, physics))
            own = len(self.unknowns[k])
            block = np.zeros((len(factor), width))
            block[:, :shared] = factor[:, own:]
            if k in kept:
                block[:, column:column + own] = factor[:, :own]
                column += own
            else:
                block = block[own:]
            blocks.append(block)
        return triangle(np.concatenate(blocks).T.copy())

    def scaled_errors(self, k: int, physics: Physics) -> Floats:
        """Return the errors in a window, divided by their standard deviations, shape (m,)."""
        return self._errors(k, self.windows[k].predict(physics, self.reference.rows(k)))

    def derivatives(self, k: int, physics: Physics, keeps: bool = False) -> Floats:
        """
        Return the derivatives of the errors that `scaled_errors` returns for a window.

        If `keeps` is true, they are kept for the next call, also of a `weighted` copy.

        Returns
        -------
        array, shape (c, m)
            The first rows are the derivatives with respect to the unknown components of the state.
            The others are the derivatives with respect to the shared parameters divided by their
            scales.

        """
        latest, slopes = self._slopes.get(k, (None, []))
        if latest is not physics:
            _, slopes = self.windows[k].linearize(physics, self.reference.rows(k),
                                                  self.parameters.groups)
        if keeps:
            self._slopes[k] = physics, slopes
        rows = self._rows(k, slopes)
        return np.concatenate([self._of_state(rows, np.zeros(6))[self.unknowns[k]],
                               self.parameters.scales[:, None] * rows[6:]])


def errors_of(channels: Sequence[Measured], predicted: Sequence[Floats]) -> list[Floats]:
    """
    Return the predicted minus the measured values of each channel, shape (n, 3).

    For attitudes, the difference is a rotation vector.
    """
    return [-so3.difference(here, channel.values)
            if channel.is_attitude else here - channel.values
            for channel, here in zip(channels, predicted)]


def triangle(columns: Floats) -> Floats:
    """
    Return the triangular factor of the QR decomposition of a matrix.

    Parameters
    ----------
    columns : array, shape (n, m)
        The transpose of the matrix. This array is overwritten.

    Returns
    -------
    array, shape (n, n)
        An upper triangular matrix. Some rows are zero if m is less than n.

    """
    result = np.zeros((len(columns), len(columns)))
    kernels.fill_triangle(columns, result)
    return result


@dataclass(frozen=True, eq=False)
class Solution:
    """
    The result of a fit with windows of a given length.

    Attributes
    ----------
    length_ns : int
    problem : LeastSquares
        The problem that was solved. Its reference states are those of the solution.
    physics : Physics
        The fitted parameters.
    errors : list of list of array, shape (n, 3)
        Predicted minus measured values of each channel of each recording, rad or rad/s.
    weights : Weights
        The weights for the next fit, computed from these errors.
    inliers : list of list of array of bool, shape (n,)
        Which samples of each channel of each recording are not outliers.
    evaluations : int
        Number of function evaluations in this fit and all fits before it.
    converged : bool

    """

    length_ns: int
    problem: LeastSquares
    physics: Physics
    errors: list[list[Floats]]
    weights: Weights
    inliers: list[list[NDArray[np.bool_]]]
    evaluations: int
    converged: bool

    def with_spreads(self, spreads: list[list[Floats]]) -> Solution:
        """Return the solution with other spreads in its weights."""
        weights = [[weight._replace(spread=spread) for weight, spread in zip(*pair)]
                   for pair in zip(self.weights, spreads)]
        return replace(self, weights=weights, problem=self.problem.weighted(weights))

    @property
    def count(self) -> int:
        """Return the number of errors, without those of outliers."""
        return sum(3 * int(np.sum(kept & np.isfinite(errors[:, 0])))
                   for inliers, every in zip(self.inliers, self.errors)
                   for kept, errors in zip(inliers, every))


def solution_of(problem: LeastSquares, physics: Physics, length_ns: int, evaluations: int,
                converged: bool = False, is_last: bool = False) -> Solution:
    """
    Return the solution of a problem whose reference states and parameters are fitted.

    If `is_last` is true, outliers have no weight. Otherwise, large errors have less weight.
    """
    setup, errors = problem.setup, problem.residuals(physics)
    total = sum(int(np.isfinite(error).sum()) for every in errors for error in every)
    share = float(np.sqrt(total / max(total - problem.size, 1)))
    pairs = [[_weighed(*channel, setup, share, is_last) for channel in zip(*every)]
             for every in zip(errors, setup.channels, problem.weights)]
    weights = [[weight for weight, _ in every] for every in pairs]
    inliers = [[kept for _, kept in every] for every in pairs]
    return Solution(length_ns, problem, physics, errors, weights, inliers, evaluations, converged)


def _weighed(error: Floats, channel: Measured, old: Weight, setup: Setup, share: float,
             is_last: bool) -> tuple[Weight, NDArray[np.bool_]]:
    """
    Return the new weight of a channel, and its inliers.

    The errors of samples outside windows are NaN. These samples count as inliers.
    """
    floor = ROUNDING * (1.0 if channel.is_attitude else max(1.0, setup.rate))
    stated = setup.noise_of(channel.is_attitude)
    level, used = max(NORMAL * median_size(error) * share, floor), np.isfinite(error[:, 0])
    distances = np.nan_to_num(
        np.linalg.norm(error, axis=1) / max(level, stated or 0.0, _NO_OUTLIER))
    inliers = distances <= _OUTLIER
    if used.any() and np.mean(inliers[used]) < _RARE:
        inliers = np.ones(len(inliers), bool)
    root = 1.0 / np.sqrt(1.0 + distances ** 2 / (3.0 * _CAUCHY ** 2))
    if is_last:
        root, kept = inliers.astype(float), error[inliers & used]
        level = max(float(np.sqrt(np.mean(kept ** 2))) * share, floor) if len(kept) else floor
    return Weight(stated or level, root, old.spread), inliers


def median_size(error: Floats) -> float:
    """Return the median magnitude of errors, ignoring samples outside windows, which are NaN."""
    finite = np.abs(error[np.isfinite(error)])
    return float(np.median(finite)) if finite.size else 0.0
