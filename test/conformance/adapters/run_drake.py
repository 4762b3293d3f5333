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
Compute the motions with Drake: a floating body, and its fifth-order Runge-Kutta pair.

    python run_drake.py RESULTS [--step 0.001]
"""

from motions import run, steps
import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import (
    ExternallyAppliedSpatialForce,
    MultibodyPlant,
    Propeller,
    PropellerInfo,
)
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder


def propagate(motion, step):
    """Yield the state at the end of each span of a motion."""
    motion.supports()
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.0))
    body = plant.AddRigidBody('body', SpatialInertia(
        1.0, np.zeros(3), UnitInertia(*motion.inputs['inertia_xx_yy_zz_xy_xz_yz'])))
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    # Drake applies torques in space axes. A propeller without thrust turns with the body.
    propeller = builder.AddSystem(Propeller([
        PropellerInfo(body.index(), RigidTransform(RotationMatrix.MakeFromOneVector(axis, 2)),
                      thrust_ratio=0.0, moment_ratio=1.0) for axis in np.eye(3)]))
    if not motion.in_space:
        builder.Connect(plant.get_body_poses_output_port(),
                        propeller.get_body_poses_input_port())
        builder.Connect(propeller.get_spatial_forces_output_port(),
                        plant.get_applied_spatial_force_input_port())
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    plant.SetPositions(context, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    plant.SetVelocities(context, [*motion.start[4:], 0.0, 0.0, 0.0])
    for begin_ns, end_ns, torque in motion.spans():
        if motion.in_space:
            force = ExternallyAppliedSpatialForce()
            force.body_index = body.index()
            force.F_Bq_W = SpatialForce(tau=torque, f=np.zeros(3))
            plant.get_applied_spatial_force_input_port().FixValue(context, [force])
        else:
            propeller.get_command_input_port().FixValue(
                propeller.GetMyMutableContextFromRoot(root), torque)
        _, length = steps(begin_ns, end_ns, step)
        ResetIntegratorFromFlags(simulator, 'runge_kutta5', length).set_fixed_step_mode(True)
        simulator.Initialize()
        simulator.AdvanceTo(end_ns / 1e9)
        pose = plant.EvalBodyPoseInWorld(context, body).rotation().ToQuaternion()
        rates = plant.GetVelocities(context)[:3]  # space axes
        yield end_ns, np.array([pose.x(), pose.y(), pose.z(), pose.w(),
                                *pose.inverse().rotation() @ rates])


if __name__ == '__main__':
    run(propagate, __doc__)
