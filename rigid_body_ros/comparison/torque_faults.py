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
Find faults in the torques or in the model of the body that may explain the residual torque.

The residual torque is convenient for this search because it depends linearly on each fault, does
not depend on the start of the motion, and does not grow with time. Even for a long motion, the
part of the residual torque that a fault leaves unexplained can be compared directly with the
noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations, product
import math
from typing import NamedTuple

import numpy as np
from rigid_body_ros.common.arrays import Floats, symmetric, written
from rigid_body_ros.comparison.channels import Channel
from rigid_body_ros.comparison.sensor_faults import axes_text, slope
from rigid_body_ros.inference.noise import ALARM
from rigid_body_ros.inference.residual_torque import measured_rates, ResidualTorque
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.fields import UniformField
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.measured import Measured

#: `_BATCH` is the number of windows in a batch. The median of each batch is compared with the
#: noise. `_FEWEST` is the minimum number of windows for the search.
_BATCH, _FEWEST = 4, 12
#: Numerical error of the residual torque, relative to the total torque on the body.
_ROUNDING = 3e-4
#: Standard gravity in space axes, m/s^2.
_GRAVITY = np.array([0.0, 0.0, -9.80665])
#: To look for a change of inertia, the motion is divided into this many intervals. A change is
#: tried at each boundary between two intervals, except at the first and the last boundary.
_PIECES = 16
_UNITS = [symmetric(unit) for unit in np.eye(6)]
#: A basis of the inertia changes that preserve the trace of the tensor. Each column contains the
#: changes of the six entries.
_SHAPES = np.array([[1, -1, 0, 0, 0, 0], [1, 1, -2, 0, 0, 0], [0, 0, 0, 1, 0, 0],
                    [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1]], float).T


class Explanation(NamedTuple):
    """
    A possible explanation of the residual torque.

    Attributes
    ----------
    name, text : str
        The name of the fault, and a description.
    before, after : float, N m
        Median magnitude of the residual torque, before and after the part that the fault explains
        is subtracted.
    explains : bool
        Whether the torque that remains is only noise.
    unknowns : int
        Number of parameters that were fitted.

    """

    name: str
    text: str
    before: float
    after: float
    explains: bool
    unknowns: int


class _Windows:
    """The residual torque and the measured motion in each of a series of separate windows."""

    def __init__(self, problem: Problem, residual: ResidualTorque,
                 sensors: Sequence[Measured]) -> None:
        seconds = np.asarray(1e-9 * (residual.times_ns - problem.start.time_ns), float)
        _, rows = np.unique(((seconds - seconds[0]) / residual.window_s).astype(int),
                            return_index=True)
        self.problem, self.seconds = problem, seconds[rows]
        self.torques, self.logged = residual.torques[rows], residual.logged[rows]
        self.of_inertia = residual.of_inertia[rows]
        self.noise, times_ns = residual.noise, residual.times_ns[rows]
        best = max(sensors, key=lambda one: (one.angular_velocity is not None, len(one)))
        stamps_ns, rates = measured_rates(best)
        half_ns = round(0.5e9 * residual.window_s)
        sums = np.concatenate([np.zeros((1, 3)), np.cumsum(rates, axis=0)])
        first, last = (np.searchsorted(stamps_ns, times_ns + side * half_ns) for side in (-1, 1))
        self.rates = (sums[last] - sums[first]) / np.maximum(last - first, 1)[:, None]
        with_attitude = [one for one in sensors if one.attitude is not None]
        self.attitude = None
        if with_attitude:
            one = max(with_attitude, key=len)
            assert one.attitude is not None
            near = np.clip(np.searchsorted(one.stamps_ns, times_ns), 0, len(one) - 1)
            self.attitude = one.attitude[near]
        moved = self.torques + self.logged
        self.floor = _ROUNDING * float(np.median(np.linalg.norm(moved, axis=1))) + 1e-300

    def is_noise(self, left: Floats) -> bool:
        """
        Return whether noise alone can explain the torques that are left.

        The test uses the median torque of each batch of windows.
        """
        from scipy.special import chdtrc
        spread = Channel('', '', self.seconds, left).spread
        scale = np.maximum(np.minimum(spread, self.noise), self.floor)
        count = len(left) // _BATCH
        means = np.median(left[:count * _BATCH].reshape(count, _BATCH, 3), axis=1)
        # The median of four normal variables has 0.298 times the variance of a single variable.
        statistic = np.sum(np.square(means / scale), axis=0) / 0.298
        return float(chdtrc(count, statistic).min()) >= ALARM

    def fitted(self, columns: Floats) -> tuple[Floats, Floats]:
        """
        Fit a linear combination of k torques to the residual torque.

        The argument `columns` has shape (n, 3, k). Return the k coefficients, and the part of the
        residual torque that is left, shape (n, 3).
        """
        weights = np.ones(len(columns))
        scale = 1.0 / np.maximum(self.noise, self.floor)
        for _ in range(8):
            weighted = (weights[:, None] * scale)[..., None] * columns
            values = weights[:, None] * scale * self.torques
            found = np.linalg.lstsq(weighted.reshape(-1, columns.shape[2]), values.ravel(),
                                    rcond=1e-6)[0]
            left = self.torques - columns @ found
            sizes = np.linalg.norm(left * scale, axis=1)
            weights = 1.0 / np.sqrt(np.maximum(
                sizes / max(3.0 * float(np.median(sizes)), 1e-300), 1.0))
        return np.asarray(found), left


def explanations(problem: Problem, residual: ResidualTorque,
                 sensors: Sequence[Measured]) -> list[Explanation]:
    """
    Return possible explanations of the residual torque.

    The list is empty if the residual torque is only noise or has fewer than 12 windows.

    Parameters
    ----------
    problem : Problem
        The model.
    residual : ResidualTorque
        The residual torque. It is computed from the sensor with the most angular velocities or, if
        no sensor measures angular velocities, from the sensor with the most attitudes.
    sensors : sequence of Measured
        All measurements, converted to the clock and the axes of the motion.

    """
    windows = _Windows(problem, residual, sensors)
    if len(windows.seconds) < _FEWEST or windows.is_noise(windows.torques):
        return []
    before = _median(windows.torques)
    return [Explanation(name, text, before, _median(left), windows.is_noise(left), unknowns)
            for name, text, left, unknowns in _tried(windows)]


def _median(torques: Floats) -> float:
    return float(np.median(np.linalg.norm(torques, axis=1)))


def _tried(windows: _Windows) -> Iterator[tuple[str, str, Floats, int]]:
    """
    Generate the faults that may explain the residual torque.

    Yields
    ------
    tuple
        The name and description of a fault, the torques that it leaves unexplained, shape (n, 3),
        and the number of parameters that were fitted.

    """
    logged = windows.logged
    if logged.any():
        needed = logged + windows.torques
        turn = _best_axes(logged, needed)
        if not np.array_equal(turn, np.eye(3)):
            yield 'torque_axes', 'the logged torque has swapped or reversed axes: ' \
                f'{axes_text(turn)}', needed - logged @ turn.T, 0
        scale = slope(logged.ravel(), needed.ravel())
        yield 'torque_scale', f'the torque is {scale:.4g} times the logged one', \
            needed - scale * logged, 1
    for name, words, columns in _linear(windows):
        found, left = windows.fitted(columns)
        yield name, f'{words.format(written(found))}; attitude_identify --estimate ' \
            f'inertia,start,{name} fits it', left, len(found)
    yield from _of_inertia(windows)


def _linear(windows: _Windows) -> Iterator[tuple[str, str, Floats]]:
    """
    Generate the faults whose parameters can be fitted linearly.

    Yields
    ------
    tuple
        The name and description of a fault, and the torques per unit of each of its k parameters,
        shape (n, 3, k).

    """
    rates, count = windows.rates, len(windows.rates)
    if windows.logged.any():
        yield 'torque_gains', 'the gains of the torque: 1 + {} about x, y and z', \
            windows.logged[:, :, None] * np.eye(3)
    yield 'torque_bias', 'a constant torque of {} N m, body axes', \
        np.tile(np.eye(3), (count, 1, 1))
    has_weight = any(isinstance(one, UniformField) for one in windows.problem.fields)
    if windows.attitude is not None and not has_weight:
        down = so3.rotate(so3.conjugate(windows.attitude), _GRAVITY)
        yield 'weight', 'a weight about a pivot, with a moment of {} kg m', _crossed(down)
    yield 'rotor_momentum', 'a momentum of rotors of {} N m s', _crossed(rates)
    yield 'damping', 'damping: dxx dyy dzz dxy dxz dyz = {} N m s/rad', \
        -np.stack([rates @ unit for unit in _UNITS], axis=2)


def _crossed(vectors: Floats) -> Floats:
    """Return the matrices, shape (n, 3, 3), that map m to the cross products m x vector."""
    return np.stack([np.cross(unit, vectors) for unit in np.eye(3)], axis=2)


def _of_inertia(windows: _Windows) -> Iterator[tuple[str, str, Floats, int]]:
    problem, columns = windows.problem, -windows.of_inertia
    known = windows.logged.any() or any(isinstance(one, UniformField) for one in problem.fields)
    turn = np.eye(6) if known else _SHAPES  # without a known torque, only ratios can be found
    # Report the change and not the tensor itself, because the tensor of this problem does not
    # include the axial inertia of named wheels.
    words = 'ixx iyy izz ixy ixz iyz = {} kg m^2'
    found, left = windows.fitted(columns @ turn)
    if _is_possible(problem.body, turn @ found):
        yield 'inertia', f'the inertia is wrong: add {words.format(written(turn @ found))}; ' \
            'attitude_identify fits it', left, len(found)
    best = None
    for time in np.linspace(windows.seconds[0], windows.seconds[-1], _PIECES + 1)[2:-2]:
        late = (windows.seconds > time)[:, None, None]
        found, left = windows.fitted(columns @ turn * late)
        size = float(np.sum(np.minimum(np.abs(left) / windows.noise, 5.0) ** 2))
        if best is None or size < best[0]:
            best = size, time, found, left
    assert best is not None
    if _is_possible(problem.body, turn @ best[2]):
        yield 'inertia_change', f'the inertia changes about {best[1]:.4g} s after the start, by ' \
            f'{words.format(written(turn @ best[2]))}', best[3], len(best[2]) + 1


def _is_possible(body: RigidBody, change: Floats) -> bool:
    try:
        RigidBody(body.inertia + symmetric(change))
    except ValueError:
        return False
    return True


def _best_axes(logged: Floats, needed: Floats) -> Floats:
    """Return the signed permutation of axes that best maps the logged to the needed torques."""
    best, least = np.eye(3), math.inf
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.diag(signs) @ np.eye(3)[list(order)]
            left = float(np.median(np.linalg.norm(needed - logged @ turn.T, axis=1)))
            if left < least * (1.0 - 1e-9):
                best, least = turn, left
    return best
