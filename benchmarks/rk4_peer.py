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

from contenders import derivative, FixedSteps, ladder
import numba
import numpy as np

NAME = f'RK4 in numba {numba.__version__}'
LADDER = ladder(200, 2_000_000)
STREAM_LADDER = [{}, {'substeps': 2}]


class Loop(FixedSteps):
    """The state at the end; other states are not kept."""

    def run(self):
        """Integrate."""
        self._state = _rk4(tuple(self._start), self._coupling, self._accelerations, self._step)


Final = Stream = Loop
_derivative = numba.njit(derivative)


@numba.njit
def _moved(s, h, d):
    return (s[0] + h * d[0], s[1] + h * d[1], s[2] + h * d[2], s[3] + h * d[3],
            s[4] + h * d[4], s[5] + h * d[5], s[6] + h * d[6])


@numba.njit
def _rk4(state, coupling, accelerations, h):
    for i in range(len(accelerations)):
        acceleration = accelerations[i, 0], accelerations[i, 1], accelerations[i, 2]
        k1 = _derivative(state, coupling, acceleration)
        k2 = _derivative(_moved(state, 0.5 * h, k1), coupling, acceleration)
        k3 = _derivative(_moved(state, 0.5 * h, k2), coupling, acceleration)
        k4 = _derivative(_moved(state, h, k3), coupling, acceleration)
        slope = _moved(_moved(_moved(k1, 2.0, k2), 2.0, k3), 1.0, k4)
        a, b, c, x, y, z, w = _moved(state, h / 6.0, slope)
        n = 1.0 / np.sqrt(x * x + y * y + z * z + w * w)
        state = a, b, c, x * n, y * n, z * n, w * n
    return state
