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

"""MuJoCo: one free body, stepped by RK4 on the rotation group."""

from contenders import ladder, per_sample
import mujoco
from mujoco import rollout
import numpy as np

NAME = f'MuJoCo {mujoco.__version__}'
LADDER = ladder(200, 1_000_000)
STREAM_LADDER = [{}, {'substeps': 2}, {'substeps': 4}]
STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
# Contacts are off, because their detection takes a fifth of the time. Automatic resets are off:
# with them, MuJoCo would restart the motion after an overflow caused by too long steps.
BODY = """
<mujoco>
  <compiler balanceinertia="false"/>
  <option timestep="{step!r}" gravity="0 0 0" integrator="RK4">
    <flag contact="disable" constraint="disable" autoreset="disable"/>
  </option>
  <worldbody>
    <body>
      <freejoint/>
      <inertial pos="0 0 0" mass="1" diaginertia="{moments[0]!r} {moments[1]!r} {moments[2]!r}"/>
    </body>
  </worldbody>
</mujoco>
"""

mujoco.set_mju_user_warning(lambda message: None)  # no log in the working directory


class Final:
    """The state at the end, under at most one torque."""

    def __init__(self, problem, steps):
        """Divide the time into steps of equal length; MuJoCo rejects impossible moments."""
        self.label = f'RK4, {steps} steps'
        self._steps = steps
        self._torque = problem.torques[0] if len(problem.torques) else np.zeros(3)
        self._prepare(problem, problem.seconds / steps)

    def _prepare(self, problem, step):
        self._model = mujoco.MjModel.from_xml_string(
            BODY.format(step=step, moments=problem.moments))
        self._data, self._rates = mujoco.MjData(self._model), problem.rates

    def reset(self):
        """Reset to the start."""
        mujoco.mj_resetData(self._model, self._data)
        self._data.qvel[3:] = self._rates
        self._data.qfrc_applied[3:] = self._torque  # body axes, unlike xfrc_applied

    def run(self):
        """Integrate."""
        mujoco.mj_step(self._model, self._data, self._steps)

    def attitude(self):
        """Return x y z w."""
        return np.roll(self._data.qpos[3:], -1)


class Stream(Final):
    """The state at the end, under torques that a rollout applies."""

    def __init__(self, problem, substeps=1):
        """Take one step per torque by default, which reaches the level of rounding errors."""
        self.label = f'RK4 rollout, {per_sample(substeps)}'
        self._torque = np.zeros(3)
        self._prepare(problem, problem.hold_ns * 1e-9 / substeps)
        self._forces = np.zeros((1, len(problem.torques) * substeps, 6))
        self._forces[0, :, 3:] = np.repeat(problem.torques, substeps, axis=0)
        self.reset()
        self._start = np.empty((1, mujoco.mj_stateSize(self._model, STATE)))
        mujoco.mj_getState(self._model, self._data, self._start[0], STATE)
        self._states = np.empty((1, self._forces.shape[1], self._start.shape[1]))

    def run(self):
        """Integrate."""
        rollout.rollout(self._model, self._data, self._start, self._forces,
                        control_spec=mujoco.mjtState.mjSTATE_QFRC_APPLIED, state=self._states)
