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

"""A small motion, recorded with noise in messages and tables, to which tests add faults."""

from collections import namedtuple
import json
from types import SimpleNamespace

from conftest import SECOND
from measurements import messages_of, torque_messages
import numpy as np
import pytest
from rigid_body_ros import Measured, propagate, RigidBody, State, TorqueLog
from rigid_body_ros.commands import main
from rigid_body_ros.mechanics import so3

COUNT, STEP_NS, START_NS = 301, 10_000_000, 1_700_000_000 * SECOND
ROWS = np.arange(COUNT)
STAMPS = START_NS + STEP_NS * ROWS
TORQUES = np.column_stack([0.02 * np.sin(0.05 * ROWS), 0.01 * np.cos(0.03 * ROWS),
                           np.full(COUNT, 0.005)])
TRUTH = propagate(RigidBody([[0.045, 0.002, 0.0], [0.002, 0.120, 0.0], [0.0, 0.0, 0.140]]),
                  State(START_NS, angular_velocity=[0.0, 0.6, 0.0]), TorqueLog(STAMPS, TORQUES),
                  at=STAMPS)
RANDOM = np.random.default_rng(3)
ATTITUDE = so3.multiply(TRUTH.attitude, so3.exp(1e-3 * RANDOM.normal(size=(COUNT, 3))))
RATES = TRUTH.angular_velocity + 2e-3 * RANDOM.normal(size=(COUNT, 3))
PARAMETERS = '/**:\n  ros__parameters:\n    initial_angular_velocity: {y: 0.6}\n'
SCENE = PARAMETERS + '    inertia: {ixx: 0.045, iyy: 0.120, izz: 0.140, ixy: 0.002}\n'
#: The same body with a sensor in the axes of another link.
LINKS = PARAMETERS + """    link: base_link
    robot_description: '<robot name="a"><link name="base_link"><inertial><mass value="1"/>
      <inertia ixx="0.045" iyy="0.120" izz="0.140" ixy="0.002" ixz="0" iyz="0"/></inertial></link>
      <link name="imu_link"/><joint name="m" type="fixed"><parent link="base_link"/>
      <child link="imu_link"/><origin xyz="0.1 0 0" rpy="0.1 0.2 0.3"/></joint></robot>'
"""
#: The errors in a JSON file, and the noise of the measurements, rad and rad/s.
NOISE = {'attitude_error_rad': 1e-3, 'rate_error_rad_s': 2e-3}
ATTITUDES, GYRO = NOISE
BOTH = ATTITUDES, GYRO
#: The errors that measurements of a type have.
CHANNELS = {'Imu': BOTH, 'Odometry': BOTH, 'PoseStamped': (ATTITUDES,), 'tum': (ATTITUDES,),
            'csv': (GYRO,), 'Vector3Stamped': (GYRO,)}
Result = namedtuple('Result', 'status shown error found')


def logged(messages, change=lambda message: None):
    """Return messages with the times at which a recorder without faults logs them."""
    sent = [message for _, message in messages]
    for message in sent:
        change(message)
    return list(zip((START_NS + 300_000 + STEP_NS * np.arange(len(sent))).tolist(), sent))


def sensor(kind, stamps=STAMPS, attitude=ATTITUDE, rates=RATES, covariance=None, frame=None,
           child=None, change=lambda message: None):
    """Return messages; `frame` may be a list with the frame_id of each message."""
    sent = logged(messages_of(kind, Measured('', stamps, attitude, rates), covariance), change)
    for number, (_, message) in enumerate(sent):
        if frame is not None:
            message.header.frame_id = frame if isinstance(frame, str) else frame[number]
        if child is not None:
            message.child_frame_id = child
    return sent


def torque(stamps=STAMPS, torques=TORQUES, change=lambda message: None):
    return logged(torque_messages(SimpleNamespace(torque_times=stamps, torques=torques)), change)


def table(path, heading, *columns, separator=','):
    """Write a CSV file; a column is a list of texts, or an array of shape (n,) or (n, k)."""
    texts = [[cell if isinstance(cell, str) else separator.join(map(repr, np.ravel(cell).tolist()))
              for cell in column] for column in columns]
    path.write_text('\n'.join([heading, *map(separator.join, zip(*texts))]))
    return path


def seconds(stamps):
    return [f'{stamp // SECOND}.{stamp % SECOND:09}' for stamp in stamps.tolist()]


def called(capsys, folder, command, path, *arguments, scene=SCENE):
    """Run a command, and return its status, its outputs and its JSON file."""
    scene_file, out = folder / 'scene.yaml', folder / 'out.json'
    scene_file.write_text(scene)
    options = [] if command == 'replay' else ['--json', out, '--overwrite']
    options += ['--horizon', '1'] if command == 'compare' else []
    status = getattr(main, f'attitude_{command}')([*map(str, (
        path, '--scene', scene_file, *arguments, *options))])
    return Result(status, *capsys.readouterr(),
                  json.loads(out.read_text()) if status != 2 and options else None)


def is_clean(result, *names):
    """Check that a command reports nothing, and that the errors are the noise."""
    assert (result.status, result.error) == (0, '')
    is_noise(result.found, *names)


def is_noise(found, *names):
    """Check that the errors are the noise, and that nothing else is compared."""
    for name, sigma in NOISE.items():
        expected = pytest.approx([sigma] * 3, rel=0.1) if name in names else None
        assert (found[name] or {}).get('axes_rms') == expected
