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
Replay with the reader and writer of mcap-ros2-support and the engine of this package.

    python benchmarks/plain_replay.py INPUT SCENE OUTPUT

The script prints the time, s, without the imports.
"""

from dataclasses import replace
import sys
import time

from mcap_ros2.reader import read_ros2_messages
from mcap_ros2.writer import Writer
import numpy as np
from rigid_body_ros import messages, scene, TorqueLog


def read(path):
    """Return the torque log of a recording."""
    stamps, torques = [], []
    for message in read_ros2_messages(path, ['/torque']):
        stamp, torque = message.ros_msg.header.stamp, message.ros_msg.wrench.torque
        stamps.append(stamp.sec * 10 ** 9 + stamp.nanosec)
        torques.append((torque.x, torque.y, torque.z))
    return TorqueLog(np.array(stamps), np.array(torques))


def write(path, motion, values):
    """Write three topics at every stamp."""
    with open(path, 'wb') as stream, Writer(stream) as writer:
        quaternion, vector = (writer.register_msgdef(kind.name, kind.definition)
                              for kind in (messages.QUATERNION, messages.VECTOR3))
        rows = zip(motion.times_ns.tolist(), motion.attitude.tolist(),
                   motion.euler_angles(values['euler_sequence']).tolist(),
                   motion.angular_velocity.tolist())
        for stamp_ns, attitude, angles, rates in rows:
            sec, nanosec = divmod(stamp_ns, 10 ** 9)
            in_space, in_body = ({'stamp': {'sec': sec, 'nanosec': nanosec}, 'frame_id': frame}
                                 for frame in (values['space_frame'], values['body_frame']))
            for topic, schema, message in (
                    ('/attitude', quaternion,
                     {'header': in_space, 'quaternion': dict(zip('xyzw', attitude))}),
                    ('/euler_angles', vector,
                     {'header': in_space, 'vector': dict(zip('xyz', angles))}),
                    ('/angular_velocity', vector,
                     {'header': in_body, 'vector': dict(zip('xyz', rates))})):
                writer.write_message(topic, schema, message, stamp_ns)


def main():
    """Replay."""
    recording, config, output = sys.argv[1:]
    began = time.perf_counter()
    loaded = scene.load(config)
    log = read(recording)
    start = replace(loaded.start, time_ns=int(log.times_ns[0]))
    motion = loaded.problem(start).replaced(log=log).propagate(at=log.times_ns)
    write(output, motion, loaded.values)
    print(time.perf_counter() - began)


if __name__ == '__main__':
    main()
