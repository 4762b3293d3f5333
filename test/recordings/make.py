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
Write the recordings of this folder whose scenes are in config/: iss, tumbler and flight.

The last contains measurements of noisy sensors on the body of tumbler.yaml, which moves under the
first 20 s of tumbler.mcap.

Each of the other recordings has a scene file of its own, torques on /torque, and a motion that was
computed with 50 digits on /truth/attitude and /truth/angular_velocity.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rigid_body_ros import messages, read
from rigid_body_ros.recording import Writer
from scipy.spatial.transform import Rotation

HERE = Path(__file__).parent
#: Shortly after 2026-01-01, where adjacent doubles are 238 ns apart in seconds.
EPOCH_NS = 1_767_225_600_123_456_789
SECOND = 10 ** 9

# NASA JEOD, verif/SIM_dyncomp/SET_test_val/RUN_9B: t (s), body rates (rad/s), and the left
# quaternion (scalar first), which is the conjugate of the quaternion from body to space.
ISS = (
    (0, (0.0, -0.001134454274550824, 0.0),
     (0.2368106365237557, 0.7173117043670278, -0.6140880728910785, 0.2286492509067215)),
    (480, (-1.006112432578578e-05, -0.001134451424614415, -2.664311320772557e-05),
     (0.3919794557775307, 0.7545392887947829, -0.5256020077247303, 0.02766039387186203)),
    (960, (-3.0108458605801e-05, -0.001133769499310447, -5.353893612196759e-05),
     (0.5153378057844473, 0.7409353448650479, -0.3936220396050609, -0.1746523707143307)),
    (1980, (-9.780689778191082e-06, -0.001123221755689028, -0.0001097798292757372),
     (0.6483827347535902, 0.5438618945375028, -0.02007799391243573, -0.5323635441162234)),
    (2340, (-4.574256439725902e-05, -0.001120948176063061, -0.0001311312986012251),
     (0.6481616456721732, 0.429302104796642, 0.1246656233082182, -0.6164776283547415)),
    (28800, (-0.0007282187220568775, -0.0008332384627087039, -0.0002424925044840342),
     (-0.3170011650039812, -0.5866170655406695, 0.376943289268734, 0.642887576857603)),
)


def write(path, frames, torques, truth):
    """Write rows (time_ns, frame, torque) and (time_ns, q, w), sorted by time."""
    space, body = frames
    rows = [(time_ns, '/torque', messages.wrench(time_ns, frame, torque))
            for time_ns, frame, torque in torques]
    for time_ns, attitude, rates in truth:
        rows += [(time_ns, '/truth/attitude',
                  messages.QUATERNION.encode(time_ns, space, attitude)),
                 (time_ns, '/truth/angular_velocity',
                  messages.VECTOR3.encode(time_ns, body, rates))]
    with Writer(path) as writer:
        writer.add_topic('/torque', messages.WRENCH)
        if truth:
            writer.add_topic('/truth/attitude', messages.QUATERNION)
            writer.add_topic('/truth/angular_velocity', messages.VECTOR3)
        for time_ns, topic, data in sorted(rows, key=lambda row: row[0]):
            writer.write(topic, time_ns, data)


def make_iss():
    """Record the torque on the Space Station every 20 s, with the rows above as reference."""
    torques = [(EPOCH_NS + t * SECOND, 'iss', (10.0 if 1000 <= t < 2000 else 0.0, 0.0, 0.0))
               for t in range(0, 28801, 20)]
    truth = [(EPOCH_NS + t * SECOND, (-x, -y, -z, w), rates) for t, rates, (w, x, y, z) in ISS]
    write(HERE / 'iss.mcap', ('eci', 'iss'), torques, truth)


def make_tumbler():
    """Record a minute of thruster pulses at 50 Hz."""
    random = np.random.default_rng(1992)
    torque, until, torques = np.zeros(3), 0.0, []
    for number in range(60 * 50 + 1):
        t = number / 50.0
        if t >= until:  # a pulse about one axis, then a pause
            torque = np.zeros(3)
            if torques and not np.any(torques[-1][2]):
                size = random.uniform(0.01, 0.03)
                torque[random.integers(3)] = random.choice([-size, size])
            until = t + random.uniform(0.3, 1.5)
        torques.append((EPOCH_NS + number * SECOND // 50, 'base_link', torque.copy()))
    write(HERE / 'tumbler.mcap', ('world', 'base_link'), torques, [])


def make_flight():
    """Record the tumbler for 20 s at 50 Hz, with noise of 2 mrad and 5 mrad/s."""
    random = np.random.default_rng(1993)
    problem = read(HERE / 'tumbler.mcap', HERE.parents[1] / 'config' / 'tumbler.yaml')
    times_ns = EPOCH_NS + np.arange(20 * 50 + 1) * SECOND // 50
    motion = problem.propagate(at=times_ns)
    attitude = motion.rotation * Rotation.from_rotvec(2e-3 * random.normal(size=(1001, 3)))
    rates = motion.angular_velocity + 5e-3 * random.normal(size=(1001, 3))
    log, = problem.logs
    with Writer(HERE / 'flight.mcap') as writer:
        writer.add_topic('/torque', messages.WRENCH)
        writer.add_topic('/mocap', messages.QUATERNION)
        writer.add_topic('/gyro', messages.VECTOR3)
        for time_ns, torque, one, rate in zip(times_ns.tolist(), log.torques, attitude.as_quat(),
                                              rates):
            writer.write('/torque', time_ns, messages.wrench(time_ns, 'base_link', torque))
            writer.write('/mocap', time_ns, messages.QUATERNION.encode(time_ns, 'world', one))
            writer.write('/gyro', time_ns, messages.VECTOR3.encode(time_ns, 'base_link', rate))


if __name__ == '__main__':
    make_iss()
    make_tumbler()
    make_flight()
