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

from contenders import derivative, FixedSteps, ladder
import numpy as np

NAME = f'RK4 in numpy {np.__version__}'
LADDER = ladder(1_000, 100_000)
STREAM_LADDER = [{}, {'substeps': 2}]


class Loop(FixedSteps):
    """The state at the end."""

    def run(self):
        """Integrate."""
        state = self._start
        for acceleration in self._accelerations.tolist():
            state = _rk4(state, self._step, self._coupling, acceleration)
        self._state = state


Final = Stream = Loop


def _derivative(state, *equations):
    # Plain numbers take a third of the time.
    return np.array(derivative(state.tolist(), *equations))


def _rk4(state, h, *equations):
    k1 = _derivative(state, *equations)
    k2 = _derivative(state + 0.5 * h * k1, *equations)
    k3 = _derivative(state + 0.5 * h * k2, *equations)
    k4 = _derivative(state + h * k3, *equations)
    state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    state[3:] /= np.linalg.norm(state[3:])
    return state
