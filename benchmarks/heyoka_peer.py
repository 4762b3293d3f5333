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

"""heyoka: a Taylor integrator for any system of equations, compiled for this one."""

from contenders import derivative
import heyoka as hy

NAME = f'heyoka {hy.__version__}'
LADDER = [{'tol': 10.0 ** -k} for k in range(3, 16)] + [{}]
#: With this tolerance, steps of 1 ms have errors at the level of rounding, at the lowest cost.
STREAM_TOLERANCE = 1e-6
STREAM_LADDER = [{}]


class Final:
    """The state at the end, under at most one torque."""

    def __init__(self, problem, **options):
        """Take heyoka's tolerance, `tol`, or use its default, eps."""
        self.label = f'tol={options.get("tol", "default")}'
        self._integrator = _integrator(problem, problem.first_acceleration, **options)
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
    """The state at the end, under torques as parameters of the equations."""

    def __init__(self, problem):
        """Compile the equations once for all torques."""
        self.label = f'propagate_for, tol={STREAM_TOLERANCE}'
        self._integrator = _integrator(problem, [hy.par[i] for i in range(3)],
                                       tol=STREAM_TOLERANCE)
        self._start = problem.start_vector
        self._accelerations, self._hold = problem.accelerations, problem.hold_ns * 1e-9

    def run(self):
        """Integrate from torque to torque."""
        parameters, propagate_for = self._integrator.pars, self._integrator.propagate_for
        for acceleration in self._accelerations:
            parameters[:] = acceleration
            propagate_for(self._hold)


def _integrator(problem, acceleration, **options):
    state = hy.make_vars('a', 'b', 'c', 'x', 'y', 'z', 'w')
    equations = [*zip(state, derivative(state, problem.coupling, acceleration))]
    return hy.taylor_adaptive(equations, problem.start_vector, **options)
