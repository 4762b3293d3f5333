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
Compute the motions with Basilisk: a spacecraft, and its RK4.

    python run_basilisk.py RESULTS [--step 0.001]
"""

from Basilisk.architecture import bskLogging
from Basilisk.simulation import extForceTorque, spacecraft
from Basilisk.utilities import SimulationBaseClass
from motions import run, steps, UnsupportedError
import numpy as np

bskLogging.setDefaultLogLevel(bskLogging.BSK_ERROR)


def propagate(motion, step):
    """Yield the state at the end of each span of a motion."""
    motion.supports()
    if motion.in_space:
        raise UnsupportedError('torque in space axes')
    spans = [*motion.spans()]
    # One step for all spans, because the clock of Basilisk counts whole steps in nanoseconds.
    step_ns = int(np.gcd.reduce([end_ns - begin_ns for begin_ns, end_ns, _ in spans]))
    step_ns //= steps(0, step_ns, step)[0]
    simulation = SimulationBaseClass.SimBaseClass()
    simulation.CreateNewProcess('process').addTask(simulation.CreateNewTask('task', step_ns))
    craft, effector = spacecraft.Spacecraft(), extForceTorque.ExtForceTorque()
    simulation.AddModelToTask('task', craft)
    craft.addDynamicEffector(effector)
    craft.hub.mHub, craft.hub.IHubPntBc_B = 1.0, motion.inertia.tolist()
    craft.hub.sigma_BNInit = [[0.0], [0.0], [0.0]]
    craft.hub.omega_BN_BInit = [[rate] for rate in motion.start[4:]]
    simulation.InitializeSimulation()
    for _, end_ns, torque in spans:
        effector.extTorquePntB_B = [[value] for value in torque]
        simulation.ConfigureStopTime(end_ns)
        simulation.ExecuteSimulation()
        state = craft.scStateOutMsg.read()
        sigma = np.array(state.sigma_BN)
        square = sigma @ sigma
        yield end_ns, np.array([*2.0 * sigma / (1.0 + square), (1.0 - square) / (1.0 + square),
                                *state.omega_BN_B])


if __name__ == '__main__':
    run(propagate, __doc__)
