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
Compute the motions with MuJoCo: a free body without gravity.

    python run_mujoco.py RESULTS [--step 0.001] [--integrator RK4]
"""

from motions import run, steps
import mujoco
import numpy as np

BODY = """
<mujoco>
  <compiler balanceinertia="false"/>
  <option gravity="0 0 0" integrator="{integrator}">
    <flag contact="disable" constraint="disable" autoreset="disable"/>
  </option>
  <worldbody>
    <body>
      <freejoint/>
      <inertial pos="0 0 0" mass="1" fullinertia="{entries}"/>
    </body>
  </worldbody>
</mujoco>
"""


def propagate(motion, step, integrator):
    """Yield the state at the end of each span of a motion."""
    motion.supports()
    entries = ' '.join(map(repr, motion.inputs['inertia_xx_yy_zz_xy_xz_yz']))
    model = mujoco.MjModel.from_xml_string(BODY.format(integrator=integrator, entries=entries))
    data = mujoco.MjData(model)
    data.qvel[3:] = motion.start[4:]  # body axes
    for begin_ns, end_ns, torque in motion.spans():
        count, model.opt.timestep = steps(begin_ns, end_ns, step)
        if motion.in_space:
            data.xfrc_applied[1, 3:] = torque
        else:
            data.qfrc_applied[3:] = torque
        mujoco.mj_step(model, data, count)
        yield end_ns, np.append(np.roll(data.qpos[3:], -1), data.qvel[3:])


if __name__ == '__main__':
    run(propagate, __doc__, integrator='RK4')
