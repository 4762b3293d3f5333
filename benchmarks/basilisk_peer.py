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

"""Basilisk: a spacecraft with one rigid hub, integrated by RK4 in Rodrigues parameters (MRP)."""

from importlib.metadata import version

from Basilisk.architecture import bskLogging, messaging
from Basilisk.architecture.numbaModel import NumbaModel
from Basilisk.simulation import extForceTorque, spacecraft
from Basilisk.utilities import SimulationBaseClass
from contenders import ladder, per_sample
import numpy as np

NAME = f"Basilisk {version('bsk')}"
# A step must be a whole number of nanoseconds, because the clock of Basilisk counts these.
LADDER = ladder(200, 500_000)
STREAM_LADDER = [{}, {'substeps': 2}]

bskLogging.setDefaultLogLevel(bskLogging.BSK_ERROR)  # or it warns at every restart


class Final:
    """The state at the end, under at most one torque."""

    def __init__(self, problem, steps):
        """Divide the time into steps of equal length."""
        self.label = f'RK4, {steps} steps'
        self._prepare(problem, problem.end_ns // steps)
        if len(problem.torques):
            self._effector.extTorquePntB_B = problem.torques.T.tolist()

    def _prepare(self, problem, step_ns):
        self._simulation = SimulationBaseClass.SimBaseClass()
        process = self._simulation.CreateNewProcess('process')
        process.addTask(self._simulation.CreateNewTask('task', step_ns))
        self._spacecraft = spacecraft.Spacecraft()
        self._simulation.AddModelToTask('task', self._spacecraft)
        hub = self._spacecraft.hub
        hub.mHub, hub.IHubPntBc_B = 1.0, np.diag(problem.moments).tolist()
        hub.sigma_BNInit = [[0.0], [0.0], [0.0]]
        hub.omega_BN_BInit = [[rate] for rate in problem.rates]
        if len(problem.torques):
            self._effector = extForceTorque.ExtForceTorque()
            self._spacecraft.addDynamicEffector(self._effector)
        self._end_ns = problem.end_ns

    def reset(self):
        """Reset to the start."""
        self._simulation.InitializeSimulation()
        self._simulation.ConfigureStopTime(self._end_ns)

    def run(self):
        """Integrate."""
        self._simulation.ExecuteSimulation()

    def attitude(self):
        """Return x y z w; the parameters do not determine the sign."""
        sigma = np.array(self._spacecraft.scStateOutMsg.read().sigma_BN)
        square = sigma @ sigma
        return np.append(2.0 * sigma, 1.0 - square) / (1.0 + square)


class Stream(Final):
    """The state at the end, under torques that a compiled module sends."""

    def __init__(self, problem, substeps=1):
        """Take one step per torque by default, which reaches the level of rounding errors."""
        self.label = f'RK4, {per_sample(substeps)}'
        self._prepare(problem, problem.hold_ns // substeps)
        self._sender = Sender(np.repeat(problem.torques, substeps, axis=0))
        self._effector.cmdTorqueInMsg.subscribeTo(self._sender.torqueOutMsg)
        # Run these after the spacecraft, which advances from the previous sample to this one. In
        # the other order, each torque would act one sample early.
        for model in (self._sender, self._effector):
            self._simulation.AddModelToTask('task', model)

    def reset(self):
        """Reset to the start."""
        self._sender.memory.sent = 0
        super().reset()


class Sender(NumbaModel):
    """A module that sends one torque after the other."""

    def __init__(self, torques):
        super().__init__()
        self.torqueOutMsg = messaging.CmdTorqueBodyMsg()
        self.memory.torques, self.memory.sent = torques, 0

    @staticmethod
    def UpdateStateImpl(torqueOutMsgPayload, memory):  # noqa: N802, N803
        """Send the next torque, if there is one."""
        if memory.sent < len(memory.torques):
            torqueOutMsgPayload.torqueRequestBody[:] = memory.torques[memory.sent]
            memory.sent += 1
