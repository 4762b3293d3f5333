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
Compute the 95 % band of a motion whose parameters are uncertain, without sampling.

The band follows from the covariance of the parameters and the exact derivatives of the motion. The
derivatives of a few displaced motions say for how long this linear band is correct.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.ensemble.applied import Applied, components
from rigid_body_ros.ensemble.dispersions import ATTITUDE
from rigid_body_ros.ensemble.runs import Ensemble
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation import Problem
from rigid_body_ros.report.charts import Curves, Panel, RATES, SIGNED
from rigid_body_ros.scene import Scene

#: Number of evenly spaced times at which a band is computed, and its half-width in standard
#: deviations, for 95 %.
_TIMES, _SIGMAS = 2000, 1.959963984540054
#: A band is correct until its standard deviation is wrong by more than this fraction of that of
#: the most uncertain axis, or until 5 % of the motions turn further from the nominal motion than
#: this angle, rad: rotation vectors end at half a turn.
_ERROR, _FARTHEST = 0.02, 2.5
#: An error of the standard deviation that may be rounding, rad and rad/s; a divisor that replaces
#: zero; and a gain that replaces zero, at which a torque has no relative change.
_ROUNDING, _TINY, _LEAST_GAIN = 1e-12, 1e-150, 1e-9
#: Motions are displaced along the directions that cause more than this share of the variance at
#: any time, and by this many standard deviations: two such motions together with the nominal
#: motion have the first five moments of a normal distribution.
_SHARE, _STEP = 0.01, 3.0 ** 0.5
#: The names by which `Problem.derivatives` knows groups of keys, where these are different.
_GROUPS = {ATTITUDE: 'start', 'initial_angular_velocity': 'start',
           'initial_rotor_momentum': 'rotor_momentum'}


@dataclass(frozen=True, eq=False)
class Band:
    """
    The 95 % band around a motion, for as long as it is correct.

    Attributes
    ----------
    problem : Problem
        The problem with the mean values of the uncertain parameters.
    seconds : array, shape (m,)
        Times since the start, s.
    motion : array, shape (m, 7)
        The motion of this problem: attitude, x y z w, and angular velocity, rad/s, body axes.
    spread : array, shape (n, 6, p)
        How the attitude (rotation vector in body axes, rad) and the angular velocity change with p
        independent standard normal numbers, at the first n of the times. If n < m, the changes are
        not linear after that.

    """

    problem: Problem
    seconds: Floats
    motion: Floats
    spread: Floats

    def scene_of(self, scene: Scene) -> Scene:
        """Return a scene with the mean values."""
        values = {key: float(value) for key, (value,) in Applied.nominal(
            self.problem).columns().items() if key in scene.values}
        return replace(scene, body=self.problem.body, start=self.problem.start,
                       values={**scene.values, **values})

    @property
    def radii(self) -> Floats:
        """Return the limits of 95 % of angles, rad, and changes of rate, rad/s, shape (2, n)."""
        parts = self.spread.reshape(len(self.spread), 2, 3, -1).swapaxes(0, 1)
        return radius(parts @ parts.swapaxes(2, 3))

    def rows(self, name: str) -> list[tuple[str, str]]:
        """Return the rows of a summary; `name` is the file with the uncertain parameters."""
        (angles, rates), count, seconds = self.radii, len(self.spread), self.seconds
        end = 'the end' if count == len(seconds) else f'{seconds[count - 1]:.4g} s'
        return [('uncertain', f'{name}: its mean values replace those of the scene'), *(
            ('  95 %', f'{quantity} within {radii[-1]:.3g} {unit} at {end}, at most '
                       f'{radii.max():.3g} {unit} at {seconds[radii.argmax()]:.4g} s')
            for quantity, unit, radii in (('attitude', 'deg', np.degrees(angles)),
                                          ('body rates', 'rad/s', rates))),
            ('warning', f'the uncertainty is not linear after {end}; attitude_ensemble --vary '
                        'computes it from then on')][:3 + (count < len(seconds))]

    def panels(self, panels: list[Panel]) -> list[Panel]:
        """Return panels of the motion with this band, and with panels of the half-widths."""
        spread, count = self.spread, len(self.spread)
        seconds, motion = self.seconds[:count], self.motion[:count]
        turns = so3.multiply(motion[:, None, :4], 0.5 * np.eye(3, 4)).swapaxes(1, 2)
        changes = turns @ spread[:, :3], spread[:, 3:], spread[:, :3]
        quaternion, rates, attitude = (_SIGMAS * np.linalg.norm(change, axis=2)
                                       for change in changes)
        bands = {label: [Curves(seconds, middle - width, middle + width, ['95 %', '', '', ''][
            :width.shape[1]], style='band')] for label, middle, width in (
                ('quaternion', motion[:, :4], quaternion),
                ('angular velocity, body axes', motion[:, 4:], rates))}
        return [*(replace(panel, curves=[*panel.curves, *bands.get(panel.label, ())])
                  for panel in panels),
                Panel('attitude, rotation vector in body axes: half-width of 95 %', 'rad',
                      [Curves(seconds, attitude, attitude, SIGNED)]),
                Panel('angular velocity, body axes: half-width of 95 %', 'rad/s',
                      [Curves(seconds, rates, rates, RATES)])]


def radius(covariance: Floats) -> Floats:
    """
    Return the 95 % quantiles of the lengths of normal vectors with mean 0.

    The square of a length has a gamma distribution with the same mean and variance (Welch and
    Satterthwaite); the quantile of the length is correct to 0.6 %.

    Parameters
    ----------
    covariance : array, shape (..., 3, 3)
        The covariances of the vectors.

    """
    from scipy.special import gammaincinv  # slow to import
    trace = np.trace(covariance, axis1=-2, axis2=-1)
    scale = np.maximum((covariance ** 2).sum(axis=(-2, -1)) / (trace + _TINY) ** 2, 1.0 / 3.0)
    return np.asarray(np.sqrt(2.0 * trace * scale * gammaincinv(0.5 / scale, 0.95)))


def band_of(ensemble: Ensemble) -> Band:
    """
    Return the band of the runs of an ensemble, at evenly spaced times from the start to the end.

    The linear standard deviation is compared with that to the second order, which consists of the
    mean of the first derivatives and of the second derivatives.

    Raises
    ------
    ValueError
        A parameter that varies, or the problem, has no derivatives; or the motion or a displaced
        motion cannot be computed.

    """
    start_ns, (mean, factor) = ensemble.problem.start.time_ns, ensemble.moments
    times_ns = np.linspace(0, ensemble.end_ns - start_ns, _TIMES).astype(np.int64) + start_ns
    band = _linear(ensemble, mean, times_ns)
    average, squares = band.spread.copy(), np.zeros(band.spread.shape[:2])
    axes = _main_axes(band.spread)
    for step in _STEP * (factor @ axes).T:
        above, below = (_relative(band, _linear(ensemble, numbers, times_ns))
                        for numbers in (mean + step, mean - step))
        average += (above + below - 2.0 * band.spread) / 6.0
        second = (above - below) / (2.0 * _STEP)
        # Second derivatives along two axes occur twice, also if only one of the axes dominates.
        squares += (second ** 2).sum(axis=2) - 0.5 * ((second @ axes) ** 2).sum(axis=2)
    linear = np.linalg.norm(band.spread, axis=2)
    error = np.abs(np.sqrt((average ** 2).sum(axis=2) + squares) - linear)
    error, linear = (numbers.reshape(-1, 2, 3).max(axis=2) for numbers in (error, linear))
    correct = (error <= _ERROR * linear + _ROUNDING).all(axis=1) & (band.radii[0] < _FARTHEST)
    return replace(band, spread=band.spread[:1 + np.append(correct, False)[1:].argmin()])


def _linear(ensemble: Ensemble, numbers: Floats, times_ns: Ints) -> Band:
    """Return the linear band around the motion of a run that draws `numbers`, shape (p,)."""
    _, factor = ensemble.moments
    applied = ensemble.with_numbers(np.vstack([numbers, numbers + factor.T, numbers - factor.T]))
    applied.torque_gain[applied.torque_gain == 0.0] = _LEAST_GAIN
    problem = ensemble.problem_of(applied, 0)
    motion = problem.propagate(at=times_ns)
    gain, bias = applied.torque_gain / applied.torque_gain[0], applied.torque_bias
    groups = [key.rpartition('.')[0] or key
              for key in (*ensemble.keys, *['torque_bias'] * bool(bias[0].any()))]
    slopes = problem.derivatives([*dict.fromkeys(_GROUPS.get(group, group) for group in groups)],
                                 at=times_ns)
    turned = so3.multiply(so3.conjugate(problem.start.attitude), applied.starts.attitude)
    # The derivative with respect to the gain is that of all torques, including the bias.
    columns = {**applied.columns(), **components(ATTITUDE, so3.log(turned)), 'torque_gain': gain,
               **components('torque_bias', bias - gain[:, None] * bias[0])}
    above, below = np.split(np.stack([columns[name] for name in slopes.names])[:, 1:], 2, axis=1)
    return Band(problem, (times_ns - times_ns[0]) * 1e-9, np.hstack([
        motion.attitude, motion.angular_velocity]), 0.5 * slopes.both @ (above - below))


def _main_axes(slopes: Floats) -> Floats:
    """Return the orthonormal directions that dominate, as columns, shape (p, k)."""
    parts = slopes.reshape(len(slopes), 2, 3, -1)
    parts = parts / (np.linalg.norm(parts, axis=(2, 3), keepdims=True) + _TINY)
    _, axes = np.linalg.eigh(np.einsum('mqik,mqil->kl', parts, parts))
    shares = ((parts @ axes) ** 2).sum(axis=2).max(axis=(0, 1))
    return np.asarray(axes[:, shares >= min(_SHARE, shares.max())])


def _relative(nominal: Band, displaced: Band) -> Floats:
    """Return the spread of a displaced motion as that of its rotation from the nominal motion."""
    vector = so3.difference(nominal.motion[:, :4], displaced.motion[:, :4])[:, :, None]
    # The inverse of the right Jacobian of rotations, to the fourth order.
    first = np.cross(vector, displaced.spread[:, :3], axis=1)
    factor = 1.0 / 12.0 + (vector ** 2).sum(axis=1, keepdims=True) / 720.0
    change = 0.5 * first + factor * np.cross(vector, first, axis=1)
    return displaced.spread + np.pad(change, ((0, 0), (0, 3), (0, 0)))
