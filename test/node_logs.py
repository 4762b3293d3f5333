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

from conftest import CONFIG, SECOND
import numpy as np
import pytest
from rigid_body_ros import messages, recording, scene, State, TorqueLog
from rigid_body_ros.commands import main

ACCEPTED, ACCEPTED_1, WHEELS = (f'/node/accepted_{name}' for name in (
    'torque', 'torque_1', 'wheel_torque'))
COMMITTED = '/node/committed'
KINDS = {COMMITTED: messages.ODOMETRY, '/h': messages.VECTOR3}
COMMANDS = {
    'replay': [main.attitude_replay, '{log}', '-o', '{out}.mcap'],
    'verify': [main.attitude_replay, '{log}', '--verify', '{log}'],
    'compare': [main.attitude_compare, '{log}', '--measured', COMMITTED, '--json', '{out}.json'],
    'identify': [main.attitude_identify, '{log}', '--measured', COMMITTED, '--json', '{out}.json'],
    'tradeoff': [main.attitude_tradeoff, '--recording', '{log}', '--json', '{out}.json'],
    'ensemble': [main.attitude_ensemble, '--recording', '{log}', '--runs', '4', '-o', '{out}',
                 '--vary', '{vary}']}


def rows(times, torques):
    """Return pairs (stamp, torque) for torques at times, s."""
    torques = np.broadcast_to(torques, (len(times), 3))
    return [(round(time * SECOND), tuple(torque)) for time, torque in zip(times, torques.tolist())]


#: The starts of two epochs, and their torques. In the first, a torque acts from the start on.
FIRST = State(5 * SECOND, (0.1, 0.2, 0.3, 0.9), (0.15, 0.6, -0.1))
SECOND_START = State(20 * SECOND, (0.5, -0.5, 0.5, 0.5), (-0.2, 0.1, 0.3))
TORQUES = {ACCEPTED: rows(5.0 + 0.1 * np.arange(40), 0.01 * np.random.default_rng(1).normal(
    size=(40, 3)))}
MORE = {ACCEPTED: rows(20.0 + 0.05 * np.arange(1, 31), 0.01 * np.random.default_rng(2).normal(
    size=(30, 3)))}


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


def two_epochs(run):
    """Return the messages that a node publishes in the two epochs."""
    return [*epoch(run, FIRST, TORQUES), *epoch(run, SECOND_START, MORE)]


def save(path, sent, *empty):
    """Write messages, each 1 ms after the previous one, and empty topics; return the path."""
    with recording.Writer(path) as writer:
        for topic in dict.fromkeys([*(topic for topic, _ in sent), *empty, COMMITTED]):
            writer.add_topic(topic, KINDS.get(topic, messages.WRENCH))
        for number, (topic, data) in enumerate(sent):
            writer.write(topic, 1_700_000_000 * SECOND + number * SECOND // 1000, data)
    return str(path)


@pytest.fixture
def run():
    return scene.load(CONFIG / 'tumbler.yaml')


@pytest.fixture
def two(run, tmp_path):
    """Return a recording of two epochs."""
    return save(tmp_path / 'two.mcap', two_epochs(run))


def without(sent, topic, *numbers):
    """Return messages without those with certain numbers (in order) on a topic."""
    places = [place for place, (name, _) in enumerate(sent) if name == topic]
    left_out = {places[number] for number in numbers}
    return [one for place, one in enumerate(sent) if place not in left_out]


def attitudes(path):
    return recording.read(path, '/attitude', messages.QUATERNION)


def called(tmp_path, name, log, *lines):
    """Run a command with a recording and a tumbler with more lines; return its exit status."""
    command, *arguments = COMMANDS[name]
    vary, config = tmp_path / 'vary.yaml', tmp_path / 'scene.yaml'
    vary.write_text('initial_angular_velocity.z: {normal: 0.01}\n')
    config.write_text((CONFIG / 'tumbler.yaml').read_text()
                      + ''.join(f'    {line}\n' for line in lines))
    return command([word.format(log=log, out=tmp_path / 'out', vary=vary) for word in arguments]
                   + ['--scene', str(config)])
