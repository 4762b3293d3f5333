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

"""SciPy: adaptive Runge-Kutta pairs, with the equations in plain Python."""

from contenders import derivative, Equations
import scipy
from scipy.integrate import solve_ivp

NAME = f'scipy {scipy.__version__}'
LADDER = [{'method': method, 'rtol': 10.0 ** -k}
          for method, finest in (('RK45', 9), ('DOP853', 13)) for k in range(3, finest + 1)]
LADDER.append({'method': 'DOP853', 'rtol': 3e-14})  # SciPy accepts none below 100 eps
#: With this tolerance, steps of 1 ms have errors at the level of rounding, and none is rejected.
STREAM_TOLERANCE = 1e-9
STREAM_LADDER = [{}]


class Final(Equations):
    """The state at the end, under at most one torque."""

    def __init__(self, problem, method, rtol):
        """Set the absolute tolerance to rtol / 100, because components of q cross zero."""
        self.label = f'{method} rtol={rtol:.0e}'
        self._equations = _equations(problem.coupling, problem.first_acceleration)
        self._span, self._start = (0.0, float(problem.seconds)), problem.start_vector
        self._options = {'method': method, 'rtol': rtol, 'atol': 0.01 * rtol}

    def run(self):
        """Integrate."""
        self._state = solve_ivp(self._equations, self._span, self._start, **self._options).y[:, -1]


class Stream(Final):
    """The state at the end, under torques, each of which begins a new problem."""

    def __init__(self, problem):
        """Fix the first step, so that no restart has to search for one."""
        self.label = f'RK45 rtol={STREAM_TOLERANCE:.0e}, restarted'
        hold = problem.hold_ns * 1e-9
        self._coupling, self._accelerations = problem.coupling, problem.accelerations.tolist()
        self._span, self._start = (0.0, hold), problem.start_vector
        self._options = {'method': 'RK45', 'rtol': STREAM_TOLERANCE, 'atol': STREAM_TOLERANCE,
                         'first_step': hold}

    def run(self):
        """Integrate from torque to torque."""
        state = self._start
        for acceleration in self._accelerations:
            state = solve_ivp(_equations(self._coupling, acceleration), self._span, state,
                              **self._options).y[:, -1]
        self._state = state


def _equations(coupling, acceleration):
    # Plain numbers are twice as fast as numpy's scalars.
    return lambda time, state: derivative(state.tolist(), coupling, acceleration)
