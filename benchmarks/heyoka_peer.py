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

import heyoka as hy
import numpy as np
from rigid_body_ros.mechanics import so3

NAME = f'heyoka {hy.__version__}'
LADDER = [{'tol': 10.0 ** -k} for k in range(3, 16)] + [{}]
#: With this tolerance, steps of 1 ms have errors at the level of rounding, at the lowest cost.
STREAM_TOLERANCE = 1e-6
STREAM_LADDER = [{}]


class Final:
    """The state at the end, under at most one torque."""

    def __init__(self, problem, tol=None):
        """Take heyoka's tolerance; None means its default, eps."""
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
    """The state at the end, under torques as parameters of the equations."""

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
    a, b, c, *q = hy.make_vars('a', 'b', 'c', 'x', 'y', 'z', 'w')
    rates = [k * p + t for k, p, t in zip(problem.coupling, (b * c, c * a, a * b), acceleration)]
    equations = [*zip((a, b, c), rates), *_turn((a, b, c), q)]
    return hy.taylor_adaptive(equations, problem.start_vector,
                              **({} if tol is None else {'tol': tol}))


def _turn(rates, q):
    a, b, c = rates
    x, y, z, w = q
    turn = [w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a,
            -(x * a + y * b + z * c)]
    return [(one, 0.5 * other) for one, other in zip(q, turn)]


class Top:
    """
    The state of a top, a body under its weight, at the end.

    The field in body axes is computed from the attitude or, if `carried`, is part of the state. In
    that case its equation v' = v x w is integrated as well.
    """

    def __init__(self, moments, start, moment, field, seconds, carried):
        """Take the principal moments, a State, the moment, the field, and the time, s."""
        a, b, c, x, y, z, w, *v = hy.make_vars('a', 'b', 'c', 'x', 'y', 'z', 'w', 'f', 'g', 'h')
        self.label = 'field carried along' if carried else 'field from the attitude'
        matrix = so3.matrix(start.attitude)
        state = [*start.angular_velocity, *start.attitude]
        if carried:
            state += (matrix.T @ field).tolist()
        else:
            v = _to_body((x, y, z, w), field)
        torque = _cross(moment, v)
        momentum = [i * rate for i, rate in zip(moments, (a, b, c))]
        rates = [(one + other) / i for one, other, i in zip(
            _cross(momentum, (a, b, c)), torque, moments)]
        equations = [*zip((a, b, c), rates), *_turn((a, b, c), (x, y, z, w))]
        if carried:
            equations += zip(v, _cross(v, (a, b, c)))
        self._integrator = hy.taylor_adaptive(equations, state)
        self._start, self._end = np.array(state), float(seconds)

    reset, run = Final.reset, Final.run

    def attitude(self):
        """Return x y z w."""
        return self._integrator.state[3:7].copy()


def _cross(u, v):
    return [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]


def _to_body(q, vector):
    # R^T v = v + 2 u x (u x v - w v), with q = (u, w).
    *u, w = q
    inner = [one - w * component for one, component in zip(_cross(u, vector), vector)]
    return [component + 2.0 * one for component, one in zip(vector, _cross(u, inner))]
