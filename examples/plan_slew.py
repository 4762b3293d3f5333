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

"""
Plan a slew of 120 degrees in 30 s, from rest to rest, that takes the least effort.

Each torque is held for a second. SciPy minimises the effort, the integral of the squared torque,
with the gradients of the exact motion.

    python examples/plan_slew.py
"""

import numpy as np
from rigid_body_ros import Problem, propagate, RigidBody, so3, State, TorqueLog
from rigid_body_ros.autodiff import vjp
from scipy.optimize import minimize

SATELLITE = RigidBody.from_moments(0.045, 0.120, 0.140, ixy=0.002, ixz=-0.001, iyz=0.003)
TARGET = so3.exp(np.radians(120.0) * np.array([0.48, 0.60, 0.64]))
END_NS, COUNT = 30 * 10 ** 9, 30
STAMPS_NS = np.arange(COUNT) * (END_NS // COUNT)
#: N m; the optimiser wants unknowns of about 1.
UNIT = 1e-3


def plan(body, target):
    """
    Return the torques, N m, shape (COUNT, 3), and how many motions the optimiser computed.

    Parameters
    ----------
    body : RigidBody
        At rest at the attitude 0 0 0 1.
    target : array, shape (4,)
        The attitude at which the body is to rest at the end, x y z w.

    """
    problem = Problem(body, State(), TorqueLog(STAMPS_NS, np.zeros((COUNT, 3))))
    # At the end, the imaginary part of the rotation from the target and the rate must be zero.
    attitude, rate = np.zeros((6, 1, 4)), np.zeros((6, 1, 3))
    attitude[:3, 0] = so3.multiply(so3.conjugate(target), np.eye(4))[:, :3].T
    rate[3:, 0] = np.eye(3)

    def end(unknowns):
        return vjp(problem, {'torques': UNIT * unknowns.reshape(COUNT, 3)}, at=[END_NS])

    def miss(unknowns):
        motion, _ = end(unknowns)
        return (attitude @ motion.attitude[0] + rate @ motion.angular_velocity[0])[:, 0]

    def slopes(unknowns):
        _, pull = end(unknowns)
        return UNIT * pull(attitude, rate)['torques'].reshape(6, -1)

    found = minimize(lambda unknowns: 0.5 * unknowns @ unknowns, np.zeros(3 * COUNT),
                     jac=lambda unknowns: unknowns, method='SLSQP', options={'ftol': 1e-12},
                     constraints={'type': 'eq', 'fun': miss, 'jac': slopes})
    return UNIT * found.x.reshape(COUNT, 3), found.nfev + found.njev


def main():
    torques, count = plan(SATELLITE, TARGET)
    end = propagate(SATELLITE, State(), TorqueLog(STAMPS_NS, torques), at=[END_NS])
    error = np.degrees(so3.angle_between(end.attitude[0], TARGET))
    effort = np.sum(np.square(torques)) * END_NS / COUNT * 1e-9

    print('motions computed  ', count)
    print('effort            ', f'{effort:.6g} N^2 m^2 s')
    print('largest torque    ', f'{np.abs(torques).max():.6g} N m')
    print('attitude error    ', f'{error:.1g} deg')
    print('rate at the end   ', f'{np.linalg.norm(end.angular_velocity):.1g} rad/s')


if __name__ == '__main__':
    main()
