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

"""heyoka: Taylor series of any system of equations, compiled for this one."""

import heyoka as hy

NAME = f'heyoka {hy.__version__}'
LADDER = [{'tol': 10.0 ** -k} for k in range(3, 16)] + [{}]
#: With it, steps of 1 ms have errors at rounding level, at the lowest cost.
STREAM_TOLERANCE = 1e-6
STREAM_LADDER = [{}]


class Final:
    """The state at the end, under at most one torque."""

    def __init__(self, problem, tol=None):
        """`tol` is that of heyoka; None: its default, eps."""
        self.label = f'tol={tol or "default"}'
        acceleration = problem.accelerations[0] if len(problem.torques) else (0.0, 0.0, 0.0)
        self._integrator = _integrator(problem, acceleration, tol)
        self._start, self._end = problem.start_vector, float(problem.seconds)

    def reset(self):
        """Reset to the start."""
        self._integrator.time = 0.0
        self._integrator.state[:] = self._start

    def run(self):
        """Integrate."""
        self._integrator.propagate_until(self._end)

    def attitude(self):
        """Return x y z w."""
        return self._integrator.state[3:].copy()


class Stream(Final):
    """The state at the end, under torques that are parameters of the equations."""

    def __init__(self, problem):
        """Compile the equations once for all torques."""
        self.label = f'propagate_for, tol={STREAM_TOLERANCE}'
        self._integrator = _integrator(problem, [hy.par[i] for i in range(3)], STREAM_TOLERANCE)
        self._start = problem.start_vector
        self._accelerations, self._hold = problem.accelerations, problem.hold_ns * 1e-9

    def run(self):
        """Integrate from torque to torque."""
        parameters, propagate_for = self._integrator.pars, self._integrator.propagate_for
        for acceleration in self._accelerations:
            parameters[:] = acceleration
            propagate_for(self._hold)


def _integrator(problem, acceleration, tol):
    a, b, c, x, y, z, w = hy.make_vars('a', 'b', 'c', 'x', 'y', 'z', 'w')
    rates = [k * p + t for k, p, t in zip(problem.coupling, (b * c, c * a, a * b), acceleration)]
    turn = [w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a,
            -(x * a + y * b + z * c)]
    equations = list(zip((a, b, c), rates)) + [(q, 0.5 * t) for q, t in zip((x, y, z, w), turn)]
    return hy.taylor_adaptive(equations, problem.start_vector,
                              **({} if tol is None else {'tol': tol}))
