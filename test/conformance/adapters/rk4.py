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
Compute the motions with RK4 and a fixed step, in plain NumPy.

    python rk4.py RESULTS [--step 0.001]
"""

from motions import run, steps, tensor
import numpy as np


def in_body(q, vector):
    """Rotate a vector from space axes to body axes."""
    u, s = -q[:3], q[3]
    return vector + 2.0 * np.cross(u, np.cross(u, vector) + s * vector)


def equations(motion):
    """Return a function that computes the derivative of the state under a torque."""
    inputs, inverse = motion.inputs, np.linalg.inv(motion.inertia)
    damping = tensor(inputs.get('damping_xx_yy_zz_xy_xz_yz', [0.0] * 6))
    rotors = np.array(inputs.get('rotor_momentum', [0.0] * 3))
    field, orbit = inputs.get('uniform_field'), inputs.get('orbit')
    if orbit:
        position = np.array(orbit['position_space'])
        along = np.cross(orbit['normal_space'], position)

    def derivative(seconds, state, torque):
        q, w = state[:4], state[4:]
        total = in_body(q, torque) if motion.in_space else torque
        total = total - damping @ w
        if field:
            total = total + np.cross(field['moment_body'],
                                     in_body(q, np.array(field['field_space'])))
        if orbit:
            angle = orbit['rate'] * seconds
            up = in_body(q, np.cos(angle) * position + np.sin(angle) * along)
            total = total + 3.0 * orbit['rate'] ** 2 * np.cross(up, motion.inertia @ up)
        change = inverse @ (np.cross(motion.inertia @ w + rotors, w) + total)
        turn = np.append(q[3] * w + np.cross(q[:3], w), -q[:3] @ w)
        return np.append(0.5 * turn, change)
    return derivative


def propagate(motion, step):
    """Yield the state at the end of each span of a motion."""
    derivative, state = equations(motion), motion.start
    for begin_ns, end_ns, torque in motion.spans():
        count, h = steps(begin_ns, end_ns, step)
        for k in range(count):
            t = begin_ns / 1e9 + k * h
            k1 = derivative(t, state, torque)
            k2 = derivative(t + 0.5 * h, state + 0.5 * h * k1, torque)
            k3 = derivative(t + 0.5 * h, state + 0.5 * h * k2, torque)
            k4 = derivative(t + h, state + h * k3, torque)
            state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            state[:4] /= np.linalg.norm(state[:4])
        yield end_ns, state


if __name__ == '__main__':
    run(propagate, __doc__)
