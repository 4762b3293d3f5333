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

"""Drake: a floating body in a multibody plant, integrated by its fifth-order Runge-Kutta pair."""

from importlib.metadata import version

from contenders import ladder, per_sample
import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant, Propeller, PropellerInfo
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource, ZeroOrderHold
from pydrake.trajectories import PiecewisePolynomial

NAME = f"Drake {version('drake')}"
# At equal cost, fixed steps are more accurate than Drake's error control.
LADDER = ladder(200, 200_000)
STREAM_LADDER = [{}]


class Final:
    """The state at the end, under at most one torque."""

    def __init__(self, problem, steps):
        """Divide the time into steps of equal length."""
        self.label = f'RK5, {steps} steps'
        self._prepare(problem, problem.seconds / steps)

    def _prepare(self, problem, step):
        builder = DiagramBuilder()
        self._plant = _body(builder, problem)
        self._simulator = Simulator(builder.Build())
        ResetIntegratorFromFlags(self._simulator, 'runge_kutta5', step).set_fixed_step_mode(True)
        self._context = self._plant.GetMyMutableContextFromRoot(
            self._simulator.get_mutable_context())
        self._rates, self._end = problem.rates, float(problem.seconds)

    def reset(self):
        """Reset to the start."""
        self._simulator.get_mutable_context().SetTime(0.0)
        self._plant.SetPositions(self._context, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        self._plant.SetVelocities(self._context, [*self._rates, 0.0, 0.0, 0.0])
        self._simulator.Initialize()

    def run(self):
        """Integrate."""
        self._simulator.AdvanceTo(self._end)

    def attitude(self):
        """Return x y z w, normalised, because the norm drifts in Drake."""
        attitude = np.roll(self._plant.GetPositions(self._context)[:4], -1)
        return attitude / np.linalg.norm(attitude)


class Stream(Final):
    """The state at the end, under torques that a block of the diagram holds."""

    def __init__(self, problem):
        """Take one step per torque, which reaches the level of rounding errors."""
        self.label = f'RK5, zero-order hold, {per_sample(1)}'
        self._prepare(problem, problem.hold_ns * 1e-9)


def _body(builder, problem):
    plant = builder.AddSystem(MultibodyPlant(0.0))
    inertia = SpatialInertia(1.0, np.zeros(3), UnitInertia(*problem.moments))
    body = plant.AddRigidBody('body', inertia)
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    if len(problem.torques):
        # Applied torques are about space axes. A propeller turns with the body without Python in
        # the loop, so each axis gets a propeller with a moment and no thrust.
        propeller = builder.AddSystem(Propeller([
            PropellerInfo(body.index(), RigidTransform(RotationMatrix.MakeFromOneVector(axis, 2)),
                          thrust_ratio=0.0, moment_ratio=1.0) for axis in np.eye(3)]))
        builder.Connect(plant.get_body_poses_output_port(),
                        propeller.get_body_poses_input_port())
        builder.Connect(propeller.get_spatial_forces_output_port(),
                        plant.get_applied_spatial_force_input_port())
        builder.Connect(_torques(builder, problem), propeller.get_command_input_port())
    return plant


def _torques(builder, problem):
    if len(problem.torques) == 1:
        return builder.AddSystem(ConstantVectorSource(problem.torques[0])).get_output_port()
    hold = problem.hold_ns * 1e-9
    # The hold block samples in the middle of each piece, so that rounding of the time does not
    # select another piece.
    breaks = (np.arange(len(problem.torques) + 1) - 0.5) * hold
    pieces = PiecewisePolynomial.ZeroOrderHold(
        breaks, np.vstack([problem.torques, problem.torques[-1]]).T)
    source = builder.AddSystem(TrajectorySource(pieces))
    sampler = builder.AddSystem(ZeroOrderHold(hold, 3))
    builder.Connect(source.get_output_port(), sampler.get_input_port())
    return sampler.get_output_port()
