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

"""Measured motions with a known truth, from an integrator and a writer outside of the package."""

from dataclasses import dataclass, field
from functools import lru_cache

from conftest import EPOCH_NS, SECOND
from mcap.writer import Writer
import numpy as np
from rigid_body_ros import Measured, RigidBody, State, TorqueLog
from rosbags.typesys import get_typestore, Stores
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

STORE = get_typestore(Stores.ROS2_JAZZY)
MOMENTS = ((0.020, 0.001, -0.0005), (0.001, 0.031, 0.0015), (-0.0005, 0.0015, 0.042))
INERTIA = np.array(MOMENTS)
RATES = np.array([0.5, -0.7, 0.9])
TURN = Rotation.from_rotvec([0.2, -0.4, 0.3])


@dataclass(frozen=True, eq=False)
class Truth:
    """A motion under held torques: the torques, and the states at the measured stamps."""

    stamps_ns: np.ndarray
    attitude: Rotation
    rates: np.ndarray
    torque_times: np.ndarray
    torques: np.ndarray
    inertia: np.ndarray = field(default_factory=INERTIA.copy)
    rates_at_start: np.ndarray = field(default_factory=RATES.copy)
    turn: Rotation = TURN

    @property
    def body(self):
        return RigidBody(self.inertia)

    @property
    def start(self):
        return State(int(self.torque_times[0]), self.turn, self.rates_at_start)

    @property
    def log(self):
        return TorqueLog(self.torque_times, self.torques)

    def measured(self, attitude_noise=0.0, rate_noise=0.0, clock=0.0, mount=None, space=None,
                 outliers=0.0, seed=0):
        """Return the measurements of a sensor whose clock is `clock` seconds behind."""
        random, count = np.random.default_rng(seed), len(self.stamps_ns)
        # Not `mount or ...`: the truth value of a rotation needs a length, which a single one
        # lacks in SciPy 1.8.
        mount, space = (Rotation.identity() if one is None else one for one in (mount, space))
        noise = Rotation.from_rotvec(attitude_noise * random.normal(size=(count, 3)))
        attitude = (space * self.attitude * noise * mount).as_quat()
        rates = mount.inv().apply(self.rates) + rate_noise * random.normal(size=(count, 3))
        bad = random.random(count) < outliers
        attitude[bad] = Rotation.random(bad.sum(), random).as_quat()
        rates[bad] += random.normal(scale=10.0, size=(bad.sum(), 3))
        return Measured('/imu', self.stamps_ns - round(1e9 * clock), attitude, rates)


@lru_cache
def truth(seconds=20.0, torque_rate=20.0, rate=100.0, size=0.01, seed=1, rates=tuple(RATES),
          inertia=MOMENTS):
    """Integrate Euler's equations by DOP853 from one torque to the next."""
    inertia = np.array(inertia)
    random = np.random.default_rng(seed)
    count = round(seconds * torque_rate)
    phases, waves = random.uniform(0.0, 6.0, (3, 4)), random.uniform(0.5, 5.0, (3, 4))
    times = np.arange(count) / torque_rate
    torques = size * np.sin(waves * times[:, None, None] + phases).sum(axis=2)
    at = np.arange(round(seconds * rate)) / rate
    inverse, state = np.linalg.inv(inertia), np.concatenate([TURN.as_quat(), rates])
    found = np.empty((len(at), 7))
    ends = np.append(times[1:], seconds)
    for begin, end, torque in zip(times, ends, torques):
        def slope(_, y, torque=torque):
            (x, y_, z, w), rate = y[:4], y[4:]
            a, b, c = rate
            turn = 0.5 * np.array([w * a + y_ * c - z * b, w * b + z * a - x * c,
                                   w * c + x * b - y_ * a, -x * a - y_ * b - z * c])
            return np.concatenate([turn, inverse @ (np.cross(inertia @ rate, rate) + torque)])
        rows = np.flatnonzero((at >= begin - 1e-12) & (at < end - 1e-12))
        solved = solve_ivp(slope, (begin, end), state, 'DOP853',
                           np.clip(np.append(at[rows], end), begin, end), rtol=1e-12, atol=1e-14)
        found[rows], state = solved.y.T[:-1], solved.y.T[-1]

    def stamps(seconds):
        return EPOCH_NS + np.round(SECOND * seconds).astype(np.int64)
    return Truth(stamps(at), Rotation.from_quat(found[:, :4]), found[:, 4:], stamps(times),
                 torques, inertia, np.array(rates))


def free(**options):
    """Return a motion without torque."""
    return truth(size=0.0, **options)


def _types(*names):
    return [STORE.types[f'{package}/msg/{name}'] for package, name in
            (each.split('/') for each in names)]


(Time, Header, Quaternion, Vector3, Point, Pose, PoseStamped, PoseWithCovariance,
 PoseWithCovarianceStamped, Transform, TransformStamped, TFMessage, Twist, TwistWithCovariance,
 Odometry, Imu, QuaternionStamped, Vector3Stamped, Wrench, WrenchStamped) = _types(
    'builtin_interfaces/Time', 'std_msgs/Header', *(f'geometry_msgs/{name}' for name in (
        'Quaternion', 'Vector3', 'Point', 'Pose', 'PoseStamped', 'PoseWithCovariance',
        'PoseWithCovarianceStamped', 'Transform', 'TransformStamped')), 'tf2_msgs/TFMessage',
    'geometry_msgs/Twist', 'geometry_msgs/TwistWithCovariance', 'nav_msgs/Odometry',
    'sensor_msgs/Imu', *(f'geometry_msgs/{name}' for name in (
        'QuaternionStamped', 'Vector3Stamped', 'Wrench', 'WrenchStamped')))
ZERO = Vector3(0.0, 0.0, 0.0)


def header(stamp_ns, frame_id):
    return Header(Time(*divmod(int(stamp_ns), SECOND)), frame_id)


def transform(stamp_ns, q, parent='world', child='base_link'):
    return TransformStamped(header(stamp_ns, parent), child,
                            Transform(Vector3(1.0, 2.0, 3.0), q))


def messages_of(kind, sensor, attitude_covariance=None, rate_covariance=None, frame='base_link'):
    """Generate messages of a type; covariances are 9 numbers, zeros by default."""
    unknown = np.zeros(9)
    one = unknown if attitude_covariance is None else np.ravel(attitude_covariance)
    two = unknown if rate_covariance is None else np.ravel(rate_covariance)
    wide = [np.zeros((6, 6)), np.zeros((6, 6))]
    wide[0][3:, 3:], wide[1][3:, 3:] = one.reshape(3, 3), two.reshape(3, 3)
    count = len(sensor.stamps_ns)
    attitude = sensor.attitude if sensor.attitude is not None \
        else np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    rates = sensor.angular_velocity if sensor.angular_velocity is not None \
        else np.zeros((count, 3))
    for stamp, q, w in zip(sensor.stamps_ns.tolist(), attitude.tolist(), rates.tolist()):
        yield stamp, _message(kind, stamp, Quaternion(*q), Vector3(*w), (one, two), wide, frame)


def _message(kind, stamp, q, w, covariances, wide, frame):
    space, body, point = header(stamp, 'world'), header(stamp, frame), Point(1.0, 2.0, 3.0)
    pose = PoseWithCovariance(Pose(point, q), wide[0].ravel())
    if kind == 'QuaternionStamped':
        return QuaternionStamped(space, q)
    if kind == 'PoseStamped':
        return PoseStamped(space, pose.pose)
    if kind == 'PoseWithCovarianceStamped':
        return PoseWithCovarianceStamped(space, pose)
    if kind == 'TransformStamped':
        return transform(stamp, q, child=frame)
    if kind == 'TFMessage':
        return TFMessage([transform(stamp, Quaternion(1.0, 0.0, 0.0, 0.0), child='odometer'),
                          transform(stamp, q, child=frame),
                          transform(stamp, Quaternion(0.0, 1.0, 0.0, 0.0), 'base_link', 'camera')])
    if kind == 'Odometry':
        return Odometry(space, frame, pose,
                        TwistWithCovariance(Twist(ZERO, w), wide[1].ravel()))
    if kind == 'Imu':
        return Imu(body, q, covariances[0], w, covariances[1], ZERO, np.zeros(9))
    return Vector3Stamped(body, w)


def torque_messages(truth, frame='base_link'):
    for stamp, torque in zip(truth.torque_times.tolist(), truth.torques.tolist()):
        yield stamp, WrenchStamped(header(stamp, frame), Wrench(ZERO, Vector3(*torque)))


def write(path, **topics):
    """Write an MCAP file with pairs of a stamp and a message for each topic."""
    with open(path, 'wb') as stream:
        writer = Writer(stream)
        writer.start('ros2', 'test')
        for topic, pairs in topics.items():
            channel = None
            for stamp, message in pairs:
                kind = message.__msgtype__
                if channel is None:
                    definition, _ = STORE.generate_msgdef(kind, ros_version=2)
                    schema = writer.register_schema(kind, 'ros2msg', definition.encode())
                    channel = writer.register_channel(f'/{topic}', 'cdr', schema)
                data = bytes(STORE.serialize_cdr(message, kind))
                writer.add_message(channel, stamp, data, stamp)
        writer.finish()
    return path


def write_scene(path, truth, **more):
    """Write the scene of a motion; further keys have _ in place of a dot."""
    names = ('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz')
    values = truth.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    start = truth.start
    lines = ['/**:', '  ros__parameters:',
             *(f'    inertia.{name}: {value!r}' for name, value in zip(names, values.tolist())),
             *(f'    initial_attitude.{name}: {value!r}'
               for name, value in zip('xyzw', start.attitude.tolist())),
             *(f'    initial_angular_velocity.{name}: {value!r}'
               for name, value in zip('xyz', start.angular_velocity.tolist())),
             *(f'    {name}: {value}' for name, value in more.items())]
    path.write_text('\n'.join([*lines, '']))
    return path


def table(path, heading, *columns, separator=','):
    """Write a CSV file; a column is a list of texts, or an array of shape (n,) or (n, k)."""
    texts = [[cell if isinstance(cell, str) else separator.join(map(repr, np.ravel(cell).tolist()))
              for cell in column] for column in columns]
    path.write_text('\n'.join([heading, *map(separator.join, zip(*texts))]))
    return path


def seconds(stamps):
    return [f'{stamp // SECOND}.{stamp % SECOND:09}' for stamp in stamps.tolist()]
