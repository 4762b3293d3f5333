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
and grow only slowly with the number of windows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.inference.certainty import triangle
from rigid_body_ros.inference.coordinates import Physics
from rigid_body_ros.inference.setup import Setup
from rigid_body_ros.inference.windows import Window
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.states import Poses
from rigid_body_ros.recording.measured import Measured

#: Standard deviation of the weak prior that keeps undetermined coordinates close to the guess.
_PRIOR = 3.0
#: Largest finite-difference step of a state component. A step is made even smaller if it would
#: otherwise change a prediction by more than this amount.
_STEP = 1e-7
#: Derivatives at the solution are second-order differences, whose steps are longer than those of
#: other derivatives by this factor.
_FINAL = 100.0
#: Each time the solver rejects a step, the next state correction is multiplied by this factor.
_SHORTER = 0.25


@dataclass(frozen=True, eq=False)
class Weights:
    """
    The weights of the samples in each channel.

    Attributes
    ----------
    sigma : list of list of float
        Standard deviation of each channel of each recording, rad or rad/s.
    roots : list of list of array, shape (n,)
        Square root of the weight of each sample.
    spreads : list of list of array, shape (3,)
        For each axis, the effective noise divided by `sigma`. Errors that persist over many
        samples make the effective noise larger.

    """

    sigma: list[list[float]]
    roots: list[list[Floats]]
    spreads: list[list[Floats]]


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
            6 if window.has_state and (setup.fits_start or not window.is_first) else 0)
            for window in windows]
        self.guess = parameters.coordinates(parameters.guess)
        self.evaluations = 0
        #: Finite-difference steps for the shared parameters and for each state.
        self.steps = parameters.steps, np.full((len(windows), 6), _STEP)
        #: `_base` is the problem linearized at the last point that the solver accepted. `_trial`
        #: is the problem linearized at the last point that the solver tried.
        self._base: _Linearization | None = None
        self._trial: _Linearization | None = None
        self._rejected = 0
        #: Caches of `derivatives`: the parameters of the last call, with the derivatives of a
        #: window before they are weighted, and with the parameters after small steps.
        self._slopes: dict[int, tuple[Physics, list[Floats]]] = {}
        self._moved: tuple[Physics, list[list[Physics]]] | None = None

    def weighted(self, weights: Weights) -> LeastSquares:
        """Return a copy of this problem with the given weights."""
        other = LeastSquares(self.setup, self.windows, self.reference, weights)
        other.steps, other._slopes = self.steps, self._slopes
        return other

    @property
    def size(self) -> int:
        """Return the number of unknowns: shared parameters and unknown components of states."""
        return self.parameters.size + sum(len(unknown) for unknown in self.unknowns)

    def states(self) -> Poses:
        """Return the states at the last point that the solver accepted."""
        assert self._base is not None
        return self._changed(slice(None), self._base.changes)

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
            here = self.parameters.physics(point)
            there = [self.parameters.physics(point + step * unit)
                     for step, unit in zip(self.steps[0], np.eye(shared))]
            largest = np.ones((len(changes), 6 + shared))
            triangles = [self._triangle(k, here, there, change, largest[k])
                         for k, change in enumerate(changes)]
            self._adapt(largest)
        except ValueError:  # the body is impossible, or the motion is too fast: reject the step
            return _Linearization(point, changes, [], np.append(prior, np.inf), np.eye(shared))
        known = np.array([self.parameters.surprise(one) for one in (here, *there)])
        residuals = [prior, known[0]]
        jacobian = [np.eye(shared) / _PRIOR, (known[1:] - known[0]).T / self.steps[0]]
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

    def _changed(self, k: int | slice, changes: Floats) -> Poses:
        """
        Apply each row of `changes`, shape (c, 6), to reference state `k`.

        If `k` is a slice, each row of `changes` is instead applied to one of the reference states
        in the slice.
        """
        return Poses(so3.multiply(self.reference.attitude[k], so3.exp(changes[:, :3])),
                     self.reference.angular_velocity[k] + self.setup.rate * changes[:, 3:])

    def _triangle(self, k: int, physics: Physics, moved_physics: Sequence[Physics],
                  change: Floats, largest: Floats) -> Floats:
        """
        Return the triangular factor of a window.

        The columns correspond to the unknowns of the state, then the shared parameters, and
        finally the errors. The method also fills the array `largest` with the largest derivative
        of any prediction with respect to each unknown.
        """
        window, unknown, steps = self.windows[k], self.unknowns[k], self.steps[0]
        own = len(unknown)
        step = np.append(self.steps[1][k, unknown], steps)
        moves = np.zeros((1 + len(step), 6))
        moves[1 + np.arange(own), unknown] = step[:own]
        predicted = window.predict([physics] * (1 + own) + [*moved_physics],
                                   self._changed(k, change + moves))
        slope = slopes(window, [one[0] for one in predicted], [
            (one[1:] - one[0]) / step[:, None, None] for one in predicted])
        found = np.max([np.abs(one).max(axis=(1, 2), initial=0.0) for one in slope], axis=0)
        largest[np.append(unknown, 6 + np.arange(len(steps)))] = found
        columns = np.zeros((len(step) + 1, 3 * window.size + own))
        columns[:-1, own:] = self._rows(k, slope)
        columns[-1:, own:] = self._rows(
            k, errors_of(window.channels, [one[:1] for one in predicted]))
        columns[np.arange(own), np.arange(own)] = 1.0 / _PRIOR
        columns[-1, :own] = change[unknown] / _PRIOR
        return triangle(columns)

    def _adapt(self, largest: Floats) -> None:
        """
        Choose finite-difference steps that change the predictions only a little.

        In unstable motion, this requires smaller steps.
        """
        shared = self.parameters.steps / np.maximum(largest[:, 6:].max(axis=0), 1.0)
        shifts = self.parameters.shifts
        shared[shifts] = self.parameters.steps[shifts]
        self.steps = shared, _STEP / np.maximum(largest[:, :6], 1.0)

    def _rows(self, k: int, errors: list[Floats]) -> Floats:
        """
        Multiply the errors or slopes of all channels by their weights, and join them into c rows.

        The array of each channel has shape (c, n, 3).
        """
        window = self.windows[k]
        sigma = self.weights.sigma[window.experiment]
        roots = self.weights.roots[window.experiment]
        spreads = self.weights.spreads[window.experiment]
        return np.concatenate([(error * (root[rows, None] / (one * spread))
                                ).reshape(len(error), -1) for error, one, spread, root, rows
                               in zip(errors, sigma, spreads, roots, window.rows)], axis=1)

    def residuals(self, physics: Physics) -> list[list[Floats]]:
        """
        Return the errors of each channel for the reference states of all windows.

        The errors of samples that lie outside all windows are NaN.
        """
        result = [[np.full((len(root), 3), np.nan) for root in roots]
                  for roots in self.weights.roots]
        for k, window in enumerate(self.windows):
            predicted = window.predict([physics], self.reference.rows([k]))
            errors = errors_of(window.channels, predicted)
            for one, rows, error in zip(result[window.experiment], window.rows, errors):
                one[rows] = error[0]
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
        priors = self.parameters.own_priors
        known = np.zeros((len(priors), width))
        for row, (name, prior) in zip(known, priors.items()):
            i = self.parameters.names.index(name)
            row[i] = self.parameters.scales[i] / prior.sigma
        blocks, column = [known], shared
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
        window = self.windows[k]
        predicted = window.predict([physics], self.reference.rows([k]))
        return self._rows(k, errors_of(window.channels, predicted))[0]

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
        if k in self._slopes and self._slopes[k][0] is physics:
            return self._scaled_slopes(k, self._slopes[k][1])
        window, unknown = self.windows[k], self.unknowns[k]
        own = len(unknown)
        steps = _FINAL * self.steps[0]
        steps[self.parameters.shifts] /= _FINAL
        step = np.append(_FINAL * self.steps[1][k, unknown], steps)
        moves = np.zeros((2, len(step), 6))
        moves[:, np.arange(own), unknown] = np.outer((1, 2), step[:own])
        moved = [[physics] * own + each for each in self._near(physics, steps)]
        predicted = window.predict([physics, *moved[0], *moved[1]], self._changed(
            k, np.concatenate([np.zeros((1, 6)), *moves])))
        # Use one-sided differences, because a step in the other direction could lead to an
        # impossible body.
        found = slopes(window, [one[0] for one in predicted], [
            (4.0 * one[1:1 + len(step)] - one[1 + len(step):] - 3.0 * one[0])
            / (2.0 * step[:, None, None]) for one in predicted])
        if keeps:
            self._slopes[k] = physics, found
        return self._scaled_slopes(k, found)

    def _scaled_slopes(self, k: int, found: list[Floats]) -> Floats:
        rows, own = self._rows(k, found), len(self.unknowns[k])
        rows[own:] = self.parameters.from_plain(rows[own:])
        return rows

    def _near(self, physics: Physics, steps: Floats) -> list[list[Physics]]:
        """Return the parameters after one and after two steps of each shared parameter."""
        if self._moved is None or self._moved[0] is not physics:
            self._moved = physics, [[self.parameters.near(physics, times * unit * steps)
                                     for unit in np.eye(len(steps))] for times in (1, 2)]
        return self._moved[1]


def errors_of(channels: Sequence[Measured], predicted: Sequence[Floats]) -> list[Floats]:
    """
    Return the predicted minus the measured values of each channel, shape (c, n, 3).

    For attitudes, the difference is a rotation vector.
    """
    return [-so3.log(so3.multiply(so3.conjugate(here), channel.values))
            if channel.is_attitude else here - channel.values
            for channel, here in zip(channels, predicted)]


def slopes(window: Window, predicted: list[Floats], changes: list[Floats]) -> list[Floats]:
    """
    Return the changes of the predictions in each channel, shape (c, n, 3).

    For attitudes, a change is a rotation vector.
    """
    return [2.0 * so3.multiply(so3.conjugate(here), change)[..., :3] if channel.is_attitude
            else change for channel, here, change in zip(window.channels, predicted, changes)]
