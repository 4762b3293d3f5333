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

"""The records of a node's epochs: markers and torques in its logs, and committed states."""

from conftest import SECOND
import numpy as np
from rigid_body_ros import messages, recording, State, TorqueLog

COMMITTED, WHEELS = '/node/committed', '/node/accepted_wheel_torque'
KINDS = {COMMITTED: messages.ODOMETRY, '/h': messages.VECTOR3}


def rows(times, torques):
    """Return pairs (stamp, torque) for torques at times, s."""
    torques = np.broadcast_to(torques, (len(times), 3))
    return [(round(time * SECOND), tuple(torque)) for time, torque in zip(times, torques.tolist())]


def motion_of(run, start, torques, at=None):
    """Return the motion of an epoch at its start and at its later torques, or at given stamps."""
    logs = {topic: TorqueLog([stamp for stamp, _ in one], [torque for _, torque in one])
            for topic, one in torques.items()}
    if at is None:
        stamps = np.concatenate([np.empty(0, int), *(log.times_ns for log in logs.values())])
        at = np.union1d([start.time_ns], stamps[stamps > start.time_ns])
    body = [log for topic, log in logs.items() if topic != WHEELS]
    return run.problem(start).replaced(log=body, wheels=logs.get(WHEELS)).propagate(at=at)


def epoch(run, start, torques):
    """Return the messages that a node publishes in an epoch: (topic, message) in order."""
    motion = motion_of(run, start, torques)
    states = [State(int(time), *state) for time, *state in zip(
        motion.times_ns, motion.attitude, motion.angular_velocity)]
    sent = sorted((stamp, topic, torque) for topic, one in torques.items()
                  for stamp, torque in one)
    return [*((topic, messages.epoch_marker(start)) for topic in torques),
            *((topic, messages.wrench(stamp, 'base_link', torque))
              for stamp, topic, torque in sent),
            *((COMMITTED, messages.odometry(state, 'world', 'base_link')) for state in states)]


def save(path, sent, *empty):
    """Write messages, each 1 ms after the previous one, and empty topics; return the path."""
    with recording.Writer(path) as writer:
        for topic in dict.fromkeys([*(topic for topic, _ in sent), *empty, COMMITTED]):
            writer.add_topic(topic, KINDS.get(topic, messages.WRENCH))
        for number, (topic, data) in enumerate(sent):
            writer.write(topic, 1_700_000_000 * SECOND + number * SECOND // 1000, data)
    return str(path)


def without(sent, topic, *numbers):
    """Return messages without those with certain numbers (in order) on a topic."""
    places = [place for place, (name, _) in enumerate(sent) if name == topic]
    left_out = {places[number] for number in numbers}
    return [one for place, one in enumerate(sent) if place not in left_out]


def attitudes(path):
    return recording.read(path, '/attitude', messages.QUATERNION)
