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

"""A simple loop in Python: RK4 with a fixed step, and a normalised quaternion."""

import numpy as np

NAME = f'RK4 in numpy {np.__version__}'
LADDER = [{'steps': steps} for steps in (
    1_000, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000)]
STREAM_LADDER = [{}, {'substeps': 2}]


class Final:
    """The state at the end, under at most one torque."""

    def __init__(self, problem, steps):
        """Divide the time into steps of equal length."""
        self.label = f'{steps} steps'
        self._accelerations = (problem.accelerations.tolist() or [[0.0, 0.0, 0.0]]) * steps
        self._step = problem.seconds / steps
        self._coupling, self._start = problem.coupling, problem.start_vector

    def reset(self):
        """Do nothing: each run begins at the start."""

    def run(self):
        """Integrate."""
        state = self._start
        for acceleration in self._accelerations:
            state = _rk4(state, self._step, self._coupling, acceleration)
        self._state = state

    def attitude(self):
        """Return x y z w."""
        return self._state[3:]


class Stream(Final):
    """The state at the end, under torques that are held for one or more steps each."""

    def __init__(self, problem, substeps=1):
        """Take one step per torque by default, which reaches the level of rounding errors."""
        self.label = 'one step per sample' if substeps == 1 else f'{substeps} steps per sample'
        self._accelerations = np.repeat(problem.accelerations, substeps, axis=0).tolist()
        self._step = problem.hold_ns * 1e-9 / substeps
        self._coupling, self._start = problem.coupling, problem.start_vector


def _derivative(state, coupling, acceleration):
    a, b, c, x, y, z, w = state.tolist()  # plain numbers take a third of the time
    (k1, k2, k3), (t1, t2, t3) = coupling, acceleration
    return np.array([
        k1 * b * c + t1, k2 * c * a + t2, k3 * a * b + t3,
        0.5 * (w * a + y * c - z * b), 0.5 * (w * b + z * a - x * c),
        0.5 * (w * c + x * b - y * a), -0.5 * (x * a + y * b + z * c)])


def _rk4(state, h, *equations):
    k1 = _derivative(state, *equations)
    k2 = _derivative(state + 0.5 * h * k1, *equations)
    k3 = _derivative(state + 0.5 * h * k2, *equations)
    k4 = _derivative(state + h * k3, *equations)
    state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    state[3:] /= np.linalg.norm(state[3:])
    return state
