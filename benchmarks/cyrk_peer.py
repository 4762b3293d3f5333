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

"""CyRK: compiled Runge-Kutta pairs with adaptive steps, for equations that numba compiles."""

from contenders import derivative, Equations
from CyRK import __version__, cyjit, nbsolve2_ivp, nbsolve_ivp
import numba
import numpy as np

NAME = f'CyRK {__version__}'
LADDER = [{'method': method, 'rtol': 10.0 ** -k}
          for method in ('Vern7', 'Vern8') for k in range(3, 15)]
STREAM_TOLERANCE = 1e-9
STREAM_LADDER = [{}]
_derivative = numba.njit(derivative)


class Final(Equations):
    """The state at the end, under at most one torque."""

    def __init__(self, problem, method, rtol):
        """Use `rtol` as the absolute tolerance as well."""
        self.label = f'{method} rtol={rtol:.0e}'
        self._equations = cyjit(_equations(problem))
        self._arguments = (self._equations.address, float(problem.seconds), method, rtol)
        self._start, self._state = problem.start_vector, np.empty(7)

    def run(self):
        """Integrate."""
        _solve(*self._arguments, self._start, self._state)


class Stream(Final):
    """The state at the end, under torques, each of which begins a new problem."""

    def __init__(self, problem):
        """Compile the loop over the torques."""
        self.label = f'RK45 rtol={STREAM_TOLERANCE:.0e}, restarted'
        self._solve = _stream_solver(problem.coupling)
        self._arguments = (problem.accelerations, problem.hold_ns * 1e-9)
        self._start, self._state = problem.start_vector, np.empty(7)

    def run(self):
        """Integrate from torque to torque."""
        self._solve(*self._arguments, self._start, self._state)


def _equations(problem):
    coupling, acceleration = problem.coupling, problem.first_acceleration

    def equations(out, time, state, arguments):
        vector = state[0], state[1], state[2], state[3], state[4], state[5], state[6]
        (out[0], out[1], out[2], out[3], out[4], out[5], out[6]) = _derivative(
            vector, coupling, acceleration)
    return equations


@numba.njit
def _solve(address, end, method, rtol, start, state):
    solution = nbsolve2_ivp(address, (0.0, end), start, method=method, rtol=rtol, atol=rtol,
                            force_retain_solver=False)
    state[:] = solution.y[:, -1]
    solution.free()


def _stream_solver(coupling):
    # For a thousand short problems per second, the solver written in numba is faster, and a given
    # first step saves the search for one.
    @numba.njit
    def equations(time, state, t1, t2, t3):
        return np.array(_derivative(state, coupling, (t1, t2, t3)))

    @numba.njit
    def solve(accelerations, hold, start, state):
        state[:] = start
        for i in range(len(accelerations)):
            torque = (accelerations[i, 0], accelerations[i, 1], accelerations[i, 2])
            solution = nbsolve_ivp(
                equations, (0.0, hold), state, args=torque, rtol=STREAM_TOLERANCE,
                atol=STREAM_TOLERANCE, first_step=hold, rk_method=1, warnings=False)
            state[:] = solution.y[:, -1]
    return solve
