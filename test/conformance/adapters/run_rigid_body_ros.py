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
Compute the motions with rigid_body_ros.

    python run_rigid_body_ros.py RESULTS
"""

from motions import run, tensor
import numpy as np
from rigid_body_ros import GravityGradient, RigidBody, State, TorqueLog, UniformField
from rigid_body_ros import propagate as propagated


def propagate(motion, step):
    """Yield the states of a motion; the step is not used."""
    inputs = motion.inputs
    body = RigidBody(motion.inertia, tensor(inputs.get('damping_xx_yy_zz_xy_xz_yz', [0.0] * 6)))
    start = State(0, motion.start[:4], motion.start[4:],
                  inputs.get('rotor_momentum', [0.0] * 3))
    rows = inputs['torques_t_ns_x_y_z']
    log = TorqueLog([row[0] for row in rows], [row[1:] for row in rows],
                    inputs['torque_frame']) if rows else None
    fields = []
    if 'uniform_field' in inputs:
        fields.append(UniformField(*inputs['uniform_field'].values()))
    if 'orbit' in inputs:
        fields.append(GravityGradient(*inputs['orbit'].values(), 0))
    found = propagated(body, start, log, at=motion.times_ns, fields=fields)
    return zip(motion.times_ns, np.hstack([found.attitude, found.angular_velocity]))


if __name__ == '__main__':
    run(propagate, __doc__)
