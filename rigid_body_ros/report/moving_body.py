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

"""Prepare a motion as data for the animated body on a page."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.mechanics import hermite, so3
from rigid_body_ros.mechanics.body import RigidBody, uniform_box
from rigid_body_ros.propagation import Problem
from rigid_body_ros.report.charts import packed
from rigid_body_ros.report.thinning import thinned

#: The columns of the data: the attitude, and the angular velocity, torque and rotor momentum in
#: body axes.
ATTITUDE, RATE, TORQUE, ROTORS = slice(4), slice(4, 7), slice(7, 10), slice(10, 13)
#: Maximum number of attitudes on a page.
MOST = 2 ** 14
#: Where the interpolation error exceeds this angle, rad, the page does not interpolate between
#: attitudes. In such an interval, the page shows only computed attitudes.
_WORST = 1e-7
#: Minimum length of an edge of the box, so that a thin plate stays visible. The longest edge has
#: length 1.
_THINNEST = 0.05
#: A motion counts as nearly torque-free if its energy and its angular momentum change by less than
#: this fraction.
_NEARLY = 0.05


def as_data(body: RigidBody, times_ns: NDArray[np.int64], rows: Floats) -> dict[str, Any]:
    """
    Return the data that a page needs to animate a motion.

    Parameters
    ----------
    body : RigidBody
        The body.
    times_ns : array of int64, shape (n,)
        The times, ascending.
    rows : array, shape (n, 13)
        The values at these times, in the columns `ATTITUDE`, `RATE`, `TORQUE` and `ROTORS`.

    """
    seconds = (times_ns - times_ns[0]) * 1e-9
    return {'times': packed(seconds), 'attitude': packed(rows[:, ATTITUDE]),
            'rate': packed(rows[:, RATE]), 'torque': packed(rows[:, TORQUE], np.float32),
            'rotors': packed(rows[:, ROTORS], np.float32),
            'smooth': packed(_is_smooth(seconds, rows), np.uint8),
            'inertia': body.inertia.tolist(), 'axes': body.principal_axes.T.tolist(),
            'moments': body.principal_moments.tolist(),
            'sides': np.maximum(uniform_box(body), _THINNEST).tolist(),
            'poinsot': _is_nearly_free(body, rows)}


def of_motion(problem: Problem, stamps_ns: NDArray[np.int64],
              measured: tuple[NDArray[np.int64], Floats] | None = None) -> dict[str, Any]:
    """
    Compute a motion at some of the ascending times `stamps_ns`; return the data for a page.

    If `measured` is given, the page also shows the body with these attitudes, which come after
    their stamps.
    """
    times_ns = np.union1d(stamps_ns[thinned(len(stamps_ns), MOST)], stamps_ns[-1:])
    motion = problem.propagate(at=times_ns)
    torque = problem.torque(times_ns, motion.attitude)
    body = as_data(problem.body, times_ns, np.hstack([
        motion.attitude, motion.angular_velocity, torque, motion.rotor_momentum]))
    return body | {'ghost': _ghost(int(stamps_ns[0]), *measured)} if measured else body


def _ghost(start_ns: int, times_ns: NDArray[np.int64], attitude: Floats) -> dict[str, Any]:
    """
    Return the data that a page needs to draw the outline of a second body.

    The outline has the attitude of the nearest sample; attitudes are not interpolated.

    Parameters
    ----------
    start_ns : int
        The time at which the motion on the page begins, ns.
    times_ns : array of int64, shape (n,)
        The times of the samples, ascending.
    attitude : array, shape (n, 4)
        The attitudes of the samples, as quaternions x y z w.

    """
    rows = thinned(len(times_ns), MOST)
    seconds = (times_ns[rows] - start_ns) * 1e-9
    usual = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 0.0
    return {'times': packed(seconds), 'attitude': packed(attitude[rows], np.float32),
            'reach': 2.0 * usual}


def _is_smooth(seconds: Floats, rows: Floats) -> NDArray[np.bool_]:
    """
    Return a mask of the intervals in which the page may interpolate, shape (n - 1,).

    A sample is checked by interpolating its attitude from its two neighbours. An interval is
    smooth if, at both of its ends, the interpolated attitude agrees with the attitude of the
    sample.
    """
    states = rows[:, ATTITUDE], rows[:, RATE]
    if len(seconds) < 3:
        return np.zeros(max(len(seconds) - 1, 0), bool)
    first, last = ((states[0][part], states[1][part]) for part in (slice(-2), slice(2, None)))
    spans = seconds[2:] - seconds[:-2]
    attitude, _ = hermite.between(first, last, spans, (seconds[1:-1] - seconds[:-2]) / spans)
    good = so3.angle_between(attitude, states[0][1:-1]) < _WORST
    # Limit the rotation between samples to 1 rad, so that no full turn is missed.
    good &= np.linalg.norm(states[1][1:-1], axis=1) * spans < 1.0
    return np.append(good[:1], good) & np.append(good, good[-1:])


def _is_nearly_free(body: RigidBody, rows: Floats) -> bool:
    if rows[:, ROTORS].any():
        return False
    energy = body.kinetic_energy(rows[:, RATE])
    momentum = so3.rotate(rows[:, ATTITUDE], body.angular_momentum(rows[:, RATE]))
    change = np.linalg.norm(momentum - momentum[0], axis=1).max()
    return bool(energy.min() > 0.0 and np.ptp(energy) < _NEARLY * energy.max()
                and change < _NEARLY * np.linalg.norm(momentum[0]))
