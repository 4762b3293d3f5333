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

"""A hand-written loop in numba: RK4 with a fixed step, and a normalised quaternion."""

import numba
import numpy as np

NAME = f'RK4 in numba {numba.__version__}'
LADDER = [{'steps': steps} for steps in (
    200, 500, 1_000, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000, 200_000, 500_000, 1_000_000,
    2_000_000)]
STREAM_LADDER = [{}, {'substeps': 2}]


class Final:
    """The attitude at the end, under at most one torque; other states are not kept."""

    def __init__(self, problem, steps):
        """Divide the time into steps of equal length."""
        self.label = f'{steps} steps'
        accelerations = problem.accelerations if len(problem.torques) else np.zeros((1, 3))
        self._arguments = (*problem.start_vector, *problem.coupling,
                           np.broadcast_to(accelerations, (steps, 3)), problem.seconds / steps)

    def reset(self):
        """Do nothing: each run begins at the start."""

    def run(self):
        """Integrate."""
        self._attitude = _rk4(*self._arguments)

    def attitude(self):
        """Return x y z w."""
        return np.array(self._attitude)


class Stream(Final):
    """The attitude at the end, under torques that are held for one or more steps each."""

    def __init__(self, problem, substeps=1):
        """Take one step per torque by default, which reaches the level of rounding errors."""
        self.label = 'one step per sample' if substeps == 1 else f'{substeps} steps per sample'
        self._arguments = (*problem.start_vector, *problem.coupling,
                           np.repeat(problem.accelerations, substeps, axis=0),
                           problem.hold_ns * 1e-9 / substeps)


@numba.njit(cache=True)
def _derivative(a, b, c, x, y, z, w, k1, k2, k3, t1, t2, t3):
    return (k1 * b * c + t1, k2 * c * a + t2, k3 * a * b + t3,
            0.5 * (w * a + y * c - z * b), 0.5 * (w * b + z * a - x * c),
            0.5 * (w * c + x * b - y * a), -0.5 * (x * a + y * b + z * c))


@numba.njit(cache=True)
def _rk4(a, b, c, x, y, z, w, k1, k2, k3, accelerations, h):
    for i in range(len(accelerations)):
        k = (k1, k2, k3, accelerations[i, 0], accelerations[i, 1], accelerations[i, 2])
        a1, b1, c1, x1, y1, z1, w1 = _derivative(a, b, c, x, y, z, w, *k)
        g = 0.5 * h
        a2, b2, c2, x2, y2, z2, w2 = _derivative(
            a + g * a1, b + g * b1, c + g * c1, x + g * x1, y + g * y1, z + g * z1, w + g * w1,
            *k)
        a3, b3, c3, x3, y3, z3, w3 = _derivative(
            a + g * a2, b + g * b2, c + g * c2, x + g * x2, y + g * y2, z + g * z2, w + g * w2,
            *k)
        a4, b4, c4, x4, y4, z4, w4 = _derivative(
            a + h * a3, b + h * b3, c + h * c3, x + h * x3, y + h * y3, z + h * z3, w + h * w3,
            *k)
        g = h / 6.0
        a += g * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        b += g * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
        c += g * (c1 + 2.0 * c2 + 2.0 * c3 + c4)
        x += g * (x1 + 2.0 * x2 + 2.0 * x3 + x4)
        y += g * (y1 + 2.0 * y2 + 2.0 * y3 + y4)
        z += g * (z1 + 2.0 * z2 + 2.0 * z3 + z4)
        w += g * (w1 + 2.0 * w2 + 2.0 * w3 + w4)
        n = 1.0 / np.sqrt(x * x + y * y + z * z + w * w)
        x, y, z, w = x * n, y * n, z * n, w * n
    return x, y, z, w
