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

from CyRK import __version__, cyjit, nbsolve2_ivp, nbsolve_ivp
import numba
import numpy as np

NAME = f'CyRK {__version__}'
LADDER = [{'method': method, 'rtol': 10.0 ** -k}
          for method in ('Vern7', 'Vern8') for k in range(3, 15)]
STREAM_TOLERANCE = 1e-9
STREAM_LADDER = [{}]


class Final:
    """The state at the end, under at most one torque."""

    def __init__(self, problem, method, rtol):
        """Use `rtol` as the absolute tolerance as well."""
        self.label = f'{method} rtol={rtol:.0e}'
        self._equations = cyjit(_equations(problem))
        self._arguments = (self._equations.address, float(problem.seconds), method, rtol)
        self._start, self._state = problem.start_vector, np.empty(7)

    def reset(self):
        """Do nothing: each run begins at the start."""

    def run(self):
        """Integrate."""
        _solve(*self._arguments, self._start, self._state)

    def attitude(self):
        """Return x y z w."""
        return self._state[3:].copy()


class Stream(Final):
    """The state at the end, under torques, each of which begins a new problem."""

    def __init__(self, problem):
        """Compile the loop over the torques."""
        self.label = f'RK45 rtol={STREAM_TOLERANCE:.0e}, restarted'
        self._solve = _stream_solver(_derivative(problem))
        self._arguments = (problem.accelerations, problem.hold_ns * 1e-9)
        self._start, self._state = problem.start_vector, np.empty(7)

    def run(self):
        """Integrate from torque to torque."""
        self._solve(*self._arguments, self._start, self._state)


def _derivative(problem):
    k1, k2, k3 = problem.coupling

    @numba.njit
    def derivative(time, state, t1, t2, t3):
        a, b, c, x, y, z, w = state
        return np.array([
            k1 * b * c + t1, k2 * c * a + t2, k3 * a * b + t3,
            0.5 * (w * a + y * c - z * b), 0.5 * (w * b + z * a - x * c),
            0.5 * (w * c + x * b - y * a), -0.5 * (x * a + y * b + z * c)])
    return derivative


def _equations(problem):
    # The same equations for the interface of the compiled solvers, `nbsolve2_ivp`.
    k1, k2, k3 = problem.coupling
    t1, t2, t3 = problem.accelerations[0] if len(problem.torques) else (0.0, 0.0, 0.0)

    def equations(out, time, state, arguments):
        a, b, c = state[0], state[1], state[2]
        x, y, z, w = state[3], state[4], state[5], state[6]
        out[0] = k1 * b * c + t1
        out[1] = k2 * c * a + t2
        out[2] = k3 * a * b + t3
        out[3] = 0.5 * (w * a + y * c - z * b)
        out[4] = 0.5 * (w * b + z * a - x * c)
        out[5] = 0.5 * (w * c + x * b - y * a)
        out[6] = -0.5 * (x * a + y * b + z * c)
    return equations


@numba.njit
def _solve(address, end, method, rtol, start, state):
    solution = nbsolve2_ivp(address, (0.0, end), start, method=method, rtol=rtol, atol=rtol,
                            force_retain_solver=False)
    state[:] = solution.y[:, -1]
    solution.free()


def _stream_solver(derivative):
    # For a thousand short problems per second, the solver written in numba is faster, and a given
    # first step saves the search for one.
    @numba.njit
    def solve(accelerations, hold, start, state):
        state[:] = start
        for i in range(len(accelerations)):
            torque = (accelerations[i, 0], accelerations[i, 1], accelerations[i, 2])
            solution = nbsolve_ivp(
                derivative, (0.0, hold), state, args=torque, rtol=STREAM_TOLERANCE,
                atol=STREAM_TOLERANCE, first_step=hold, rk_method=1, warnings=False)
            state[:] = solution.y[:, -1]
    return solve
