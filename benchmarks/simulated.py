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
Recordings for right and wrong models, from a simulator that shares no code with the package.

A kind is a body with actuators and sensors. Either the model describes all of it, or one thing
differs. All seeds of a kind are integrated together by a fourth-order Runge-Kutta method with
steps of 5 ms.
"""

from dataclasses import dataclass, field
import zlib

import numpy as np
from scipy.interpolate import CubicSpline

STEP = 0.005
#: Rates of the torques and of the sensors, Hz.
TORQUE_HZ, SENSOR_HZ = 20, 100
SECOND = 10 ** 9
INERTIA = np.array([[0.020, 0.001, -0.002], [0.001, 0.030, 0.0005], [-0.002, 0.0005, 0.040]])
#: Nominal noise of a component, rad and rad/s.
ATTITUDE_NOISE, RATE_NOISE = 2e-3, 5e-3
GRAVITY = np.array([0.0, 0.0, -9.80665])


@dataclass(frozen=True)
class Kind:
    """The truth about a body, its actuators and its sensors; the defaults agree with the model."""

    name: str
    #: What the fit estimates, and the parameters that would correct the model; none if right.
    estimate: tuple = ('inertia', 'start')
    causes: tuple = ()
    seconds: float = 20.0
    torque: float = 0.02
    inertia: np.ndarray = field(default_factory=INERTIA.copy)
    # What acts on the body.
    weight: tuple = (0.0, 0.0, 0.0)
    dipole: tuple = (0.0, 0.0, 0.0)
    damping: float = 0.0
    drag: float = 0.0
    friction: float = 0.0
    rotor: tuple = (0.0, 0.0, 0.0)
    rotor_ramp: tuple = (0.0, 0.0, 0.0)
    bias: tuple = (0.0, 0.0, 0.0)
    disturbance: float = 0.0
    #: Factor of the inertia from half of the time on, and at the end of a steady change.
    dropped: float = 1.0
    burnt: float = 1.0
    #: Stiffness, N m/rad, inertia, kg m^2, and damping ratio of an appendage that bends about x.
    appendage: tuple = ()
    # How the actuators change the logged torque.
    gains: np.ndarray = field(default_factory=lambda: np.eye(3))
    delay: float = 0.0
    lag: float = 0.0
    limit: float = np.inf
    deadband: float = 0.0
    lost: float = 0.0
    # Errors of the sensors.
    mount: tuple = (0.0, 0.0, 0.0)
    gyro_mount: tuple = (0.0, 0.0, 0.0)
    clock: float = 0.0
    gyro_clock: float = 0.0
    drift: float = 0.0
    gyro_bias: tuple = (0.0, 0.0, 0.0)
    gyro_walk: float = 0.0
    gyro_scale: tuple = (1.0, 1.0, 1.0)
    gyro_limit: float = np.inf
    gyro_filter: float = 0.0
    gyro_unit: float = 1.0
    attitude_hz: float = SENSOR_HZ
    has_attitude: bool = True
    has_rates: bool = True
    frozen: tuple = ()
    conjugated: bool = False
    space_rate: tuple = (0.0, 0.0, 0.0)
    jitter: float = 0.0
    colour: float = 0.0
    gyro_colour: float = 0.0
    outliers: float = 0.0
    missing: float = 0.0
    axes: tuple = (1.0, 1.0, 1.0)
    #: The guess of the inertia; a sphere if empty.
    guess: tuple = ()


@dataclass(frozen=True)
class Recording:
    """What was logged for one seed: times in ns, torques, quaternions x y z w and rates."""

    start: tuple
    torque_ns: np.ndarray
    torques: np.ndarray
    attitude_ns: np.ndarray
    attitude: np.ndarray
    rate_ns: np.ndarray
    rates: np.ndarray


def wrong(name, cause, **what):
    """Return a kind that the model does not fully describe."""
    return Kind(name, causes=cause if isinstance(cause, tuple) else (cause,), **what)


def turned(degrees, axis=(0.6, -0.64, 0.48)):
    """Return the rotation vector of a turn by some degrees about an axis."""
    return tuple(np.radians(degrees) * np.array(axis))


_SHARED = 'inertia', 'start'
RIGHT = (
    Kind('all well'),
    Kind('attitude alone', has_rates=False),
    Kind('gyro alone', has_attitude=False),
    Kind('attitude at 20 Hz', attitude_hz=20),
    Kind('weak torque', torque=0.005),
    Kind('twice as long', seconds=40.0),
    Kind('noise AR 0.5', colour=0.5, gyro_colour=0.5),
    Kind('noise AR 0.8', colour=0.8, gyro_colour=0.8),
    Kind('gyro noise AR 0.8', gyro_colour=0.8),
    Kind('3 % outliers', outliers=0.03),
    Kind('20 % missing', missing=0.2),
    Kind('unequal axes', axes=(0.5, 1.0, 2.0)),
    Kind('guess of a plate', guess=(0.02, 0.03, 0.05)),
    Kind('gyro bias, estimated', (*_SHARED, 'gyro_bias'), gyro_bias=(0.02, -0.03, 0.01)),
    Kind('gyro scale, estimated', (*_SHARED, 'gyro_scale'), gyro_scale=(1.02, 0.98, 1.01)),
    Kind('mount and clock of each', (*_SHARED, 'mount@/mocap', 'clock_offset@/mocap', 'mount@/imu',
                                     'clock_offset@/imu'),
         mount=turned(3), gyro_mount=turned(30), clock=0.03, gyro_clock=-0.03),
    Kind('weight, estimated', (*_SHARED, 'weight'), weight=(0.001, -0.0005, -0.003)),
    Kind('delay, estimated', (*_SHARED, 'torque_delay'), delay=0.03),
    Kind('lag, estimated', (*_SHARED, 'torque_lag'), lag=0.08),
    Kind('damping and bias, estimated', (*_SHARED, 'damping', 'torque_bias'), damping=2e-3,
         bias=(1e-3, -5e-4, 8e-4)),
)
_CLOCKS = ('clock_offset@/mocap', 'clock_offset@/imu', 'torque_delay', 'torque_lag')
_CHANGE = ('inertia_change',)
WRONG = (
    wrong('weight', 'weight', weight=(0.001, -0.0005, -0.003)),
    wrong('weight, a tenth', 'weight', weight=(1e-4, -5e-5, -3e-4)),
    wrong('dipole in an unknown field', (), dipole=(2e-3, 1e-3, -1e-3)),
    wrong('damping', 'damping', damping=3e-3),
    wrong('quadratic drag', 'damping', drag=3e-3),
    wrong('friction', 'damping', friction=1e-3),
    wrong('rotor', 'rotor_momentum', rotor=(0.0, 5e-3, 2e-3)),
    wrong('rotor that spins up', (), rotor_ramp=(0.0, 5e-4, 0.0)),
    wrong('torque bias', 'torque_bias', bias=(1e-3, -5e-4, 8e-4)),
    wrong('periodic disturbance', (), disturbance=3e-3),
    wrong('payload dropped', _CHANGE, dropped=0.8),
    wrong('fuel burnt', _CHANGE, burnt=0.8),
    wrong('soft appendage', (), appendage=(0.05, 0.003, 0.01)),
    wrong('stiff appendage', (), appendage=(1.0, 0.003, 0.01)),
    wrong('gain of one axis', 'torque_gains', gains=np.diag([1.0, 1.1, 1.0])),
    wrong('gains of all axes', 'torque_gains', gains=np.diag([0.95, 1.1, 1.2])),
    wrong('thrusters turned by 5 degrees', (),
          gains=np.array([[1.0, -0.06, 0.03], [0.06, 1.0, -0.05], [-0.03, 0.05, 1.0]])),
    wrong('delay 20 ms', _CLOCKS, delay=0.02),
    wrong('delay 100 ms', _CLOCKS, delay=0.1),
    wrong('lag 30 ms', _CLOCKS, lag=0.03),
    wrong('lag 150 ms', _CLOCKS, lag=0.15),
    wrong('saturated torque', (), limit=0.015),
    wrong('deadband', (), deadband=4e-3),
    wrong('10 % of the torques lost', (), lost=0.1),
    wrong('mount 3 degrees', ('mount@/mocap', 'mount@/imu'), mount=turned(3)),
    wrong('mount 30 degrees', ('mount@/mocap', 'mount@/imu'), mount=turned(30)),
    wrong('mount of the gyro 5 degrees', ('mount@/imu', 'mount@/mocap'), gyro_mount=turned(5)),
    wrong('clock 10 ms', _CLOCKS, clock=0.01),
    wrong('clock of the gyro 50 ms', _CLOCKS, gyro_clock=0.05),
    wrong('clock drifts', ('clock_drift@/mocap', 'clock_drift@/imu'), drift=2e-3),
    wrong('gyro bias', 'gyro_bias', gyro_bias=(0.01, -0.02, 0.005)),
    wrong('gyro bias walks', 'gyro_bias', gyro_walk=5e-3),
    wrong('gyro scale', 'gyro_scale', gyro_scale=(1.03, 0.98, 1.0)),
    wrong('gyro saturates', ('gyro_saturation', 'gyro_scale'), gyro_limit=1.0),
    wrong('gyro filter 50 ms', _CLOCKS, gyro_filter=0.05),
    wrong('gyro in degrees per second', ('degrees', 'gyro_scale'), gyro_unit=np.degrees(1.0)),
    wrong('attitude frozen for 3 s', 'frozen_attitude', frozen=(8.0, 11.0)),
    wrong('attitude of space in body axes', 'inverse_quaternion', conjugated=True),
    wrong('space frame turns', (), space_rate=(0.0, 0.0, 2e-3)),
    wrong('stamps jitter by 10 ms', (), jitter=0.01),
)
#: Models that are a little wrong, as those of real robots are.
LITTLE = (
    wrong('appendage of a robot', (), appendage=(2.0, 0.001, 0.03)),
    wrong('gyro filter 5 ms', _CLOCKS, gyro_filter=0.005),
    wrong('gyro scale 2 %', 'gyro_scale', gyro_scale=(1.02, 0.99, 1.01)),
    wrong('gyro turned by 1 degree', ('mount@/imu', 'mount@/mocap'), gyro_mount=turned(1)),
    wrong('mocap turned by 1 degree', ('mount@/mocap', 'mount@/imu'), mount=turned(1)),
    wrong('little drag', 'damping', drag=3e-4),
    wrong('stamps jitter by 3 ms', (), jitter=0.003),
    wrong('little gyro bias', 'gyro_bias', gyro_bias=(0.003, -0.005, 0.002)),
    wrong('gains 2 % off', 'torque_gains', gains=np.diag([1.02, 0.98, 1.01])),
    wrong('lag 10 ms', _CLOCKS, lag=0.01),
)


def cross(a, b):
    """Return the cross products of vectors, shape (s, 3), in a quarter of the time of numpy."""
    return np.stack([a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1], a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
                     a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]], axis=1)


def multiply(p, q):
    """Return products of quaternions x y z w."""
    vector = p[..., 3:] * q[..., :3] + q[..., 3:] * p[..., :3] + np.cross(p[..., :3], q[..., :3])
    return np.concatenate([vector, p[..., 3:] * q[..., 3:]
                           - np.sum(p[..., :3] * q[..., :3], axis=-1, keepdims=True)], axis=-1)


def exponential(vector):
    """Return quaternions of rotation vectors."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.concatenate([0.5 * np.sinc(0.5 * angle / np.pi) * vector, np.cos(0.5 * angle)],
                          axis=-1)


def rotated_back(q, vector):
    """Convert vectors from space axes to body axes."""
    axis, w = -q[..., :3], q[..., 3:]
    twice = 2.0 * np.cross(axis, vector)
    return vector + w * twice + np.cross(axis, twice)


def commanded(kind, random):
    """Return the logged torques, shape (s, n, 3)."""
    count = round(kind.seconds * TORQUE_HZ)
    seeds = len(random)
    waves = np.stack([each.uniform(0.5, 2.5, (3, 3)) for each in random])[:, None]
    phases = np.stack([each.uniform(0.0, 2 * np.pi, (3, 3)) for each in random])[:, None]
    times = (np.arange(count) / TORQUE_HZ)[None, :, None, None]
    return kind.torque / np.sqrt(1.5) * np.sin(waves * times + phases).sum(axis=3).reshape(
        seeds, count, 3)


def acting(kind, torques, random):
    """Return the torques that act at each half step, shape (n, s, 3)."""
    lost = np.stack([each.random(torques.shape[1]) < kind.lost for each in random])
    held = torques.copy()
    for k in range(1, torques.shape[1]):
        held[lost[:, k], k] = held[lost[:, k], k - 1]
    held = np.clip(held, -kind.limit, kind.limit)
    held = np.where(np.abs(held) < kind.deadband, 0.0, held) @ kind.gains.T
    half = 0.5 * STEP
    at = np.arange(round(kind.seconds / half)) * half + 1e-9  # a jump belongs to what follows
    rows = np.floor((at - kind.delay) * TORQUE_HZ).astype(int)
    result = np.where((rows >= 0)[None, :, None], held[:, np.maximum(rows, 0)], 0.0)
    if kind.lag:
        share, state = np.exp(-half / kind.lag), np.zeros_like(result[:, 0])
        lagged = np.empty_like(result)
        for k in range(result.shape[1]):
            # Take the mean over the half step, so that each impulse is exact.
            mean = result[:, k] + (state - result[:, k]) * kind.lag / half * (1.0 - share)
            state = result[:, k] + (state - result[:, k]) * share
            lagged[:, k] = mean
        result = lagged
    return result.transpose(1, 0, 2)


def inertia_at(kind, time):
    """Return the inertia at a time; burnt fuel carries its momentum away."""
    if kind.burnt != 1.0:
        return kind.inertia * (1.0 + (kind.burnt - 1.0) * time / kind.seconds)
    factor = kind.dropped if time >= 0.5 * kind.seconds else 1.0
    return kind.inertia * np.array([[factor, 1, 1], [1, 1, 1], [1, 1, factor]])


def slope(kind, time, q, w, bend, torque, wheels=0.0):
    """Return the time derivatives of attitude, rate and appendage; `wheels` is a momentum."""
    inertia = inertia_at(kind, time)
    rotor = np.array(kind.rotor) + np.array(kind.rotor_ramp) * time + wheels
    total = torque + np.array(kind.bias) - kind.damping * w - kind.drag * np.abs(w) * w \
        - kind.friction * np.tanh(w / 0.01) - np.array(kind.rotor_ramp)
    if any(kind.weight):
        total = total + np.cross(np.array(kind.weight), rotated_back(q, GRAVITY))
    if any(kind.dipole):
        total = total + np.cross(np.array(kind.dipole), rotated_back(q, np.array([1.0, 0.5, 0.0])))
    if kind.disturbance:
        total = total + kind.disturbance * np.sin(2.0 * np.pi * 0.3 * time) * np.array(
            [1.0, -0.5, 0.7])
    total = total + cross(w @ inertia + rotor, w)
    moved = np.zeros_like(bend)
    if kind.appendage:  # an oscillator, driven by the angular acceleration about x
        stiffness, own, ratio = kind.appendage
        rate = 2.0 * ratio * np.sqrt(stiffness * own)
        pull = stiffness * bend[:, 0] + rate * bend[:, 1]
        total[:, 0] += pull
        reduced = inertia - np.diag([own, 0.0, 0.0])
        acceleration = total @ np.linalg.inv(reduced)
        moved = np.stack([bend[:, 1], -pull / own - acceleration[:, 0]], axis=1)
    else:
        acceleration = total @ np.linalg.inv(inertia)
    spin = np.concatenate([w, np.zeros((len(w), 1))], axis=1)
    return 0.5 * multiply(q, spin), acceleration, moved


def started(random):
    """Return random attitudes and rates with which a motion begins."""
    return exponential(np.stack([each.uniform(-1.0, 1.0, 3) for each in random])), \
        np.stack([each.uniform(-0.8, 0.8, 3) for each in random])


def integrated(kind, torque, start, by_wheels=False):
    """
    Return attitudes and rates after each step, shape (n, s, 4) and (n, s, 3).

    If the torque acts by wheels, their momentum takes up what the body loses.
    """
    (q, w), seeds = start, len(start[0])
    wheels = -0.5 * STEP * np.cumsum(torque, axis=0) + 0.5 * STEP * torque
    wheels = np.concatenate([wheels, wheels[-1:] - 0.5 * STEP * torque[-1:]]) * by_wheels
    bend = np.zeros((seeds, 2))
    count = round(kind.seconds / STEP)
    attitudes, rates = np.empty((count + 1, seeds, 4)), np.empty((count + 1, seeds, 3))
    attitudes[0], rates[0] = q, w
    for k in range(count):
        time, now = k * STEP, (q, w, bend)
        slopes = [slope(kind, time, *now, torque[2 * k], wheels[2 * k])]
        for part, half, at in ((0.5, 0, 1), (0.5, 1, 1), (1.0, 1, 2)):
            moved = [x + part * STEP * dx for x, dx in zip(now, slopes[-1])]
            # Within a step, the torque is held, and the inertia does not jump.
            slopes.append(slope(kind, time, *moved, torque[2 * k + half], wheels[2 * k + at]))
        q, w, bend = (x + STEP / 6.0 * (a + 2.0 * b + 2.0 * c + d)
                      for x, a, b, c, d in zip(now, *slopes))
        q = q / np.linalg.norm(q, axis=1, keepdims=True)
        attitudes[k + 1], rates[k + 1] = q, w
    return attitudes, rates


def coloured(random, shape, colour):
    """Return first-order autoregressive noise with unit variance."""
    white = random.standard_normal(shape)
    for k in range(1, len(white)):
        white[k] = colour * white[k - 1] + np.sqrt(1.0 - colour ** 2) * white[k]
    return white


def sampled(times, values, at):
    """Interpolate between steps by the cubic through four of them."""
    return CubicSpline(times, values)(at)


def recordings(kind, seeds, level=1.0):
    """
    Return the recordings of a kind.

    Parameters
    ----------
    kind : Kind
        The truth.
    seeds : sequence of int
        Seeds of the torques, the starts and the noise.
    level : float
        Noise, relative to the nominal noise.

    Returns
    -------
    list of Recording

    """
    random = [np.random.default_rng((zlib.crc32(kind.name.encode()), seed)) for seed in seeds]
    torques = commanded(kind, random)
    torque, start = acting(kind, torques, random), started(random)
    attitudes, rates = integrated(kind, torque, start)
    torque_ns = np.arange(torques.shape[1]) * (SECOND // TORQUE_HZ)
    return [measured(kind, each, torque_ns, torques[k], attitudes[:, k], rates[:, k], level)
            for k, each in enumerate(random)]


def measured(kind, random, torque_ns, torques, attitudes, rates, level):
    """Return the recording of one seed, with what its sensors measure."""
    times = np.arange(len(attitudes)) * STEP
    start = attitudes[0], rates[0]
    own = {'attitude': (kind.attitude_hz, kind.clock, kind.colour),
           'rate': (SENSOR_HZ, kind.gyro_clock, kind.gyro_colour)}
    stamps, found = {}, {}
    for name, (hz, clock, colour) in own.items():
        at = np.arange(1.0, kind.seconds * hz) / hz  # true times
        at = at[(at > 0.1) & (at < kind.seconds - 0.1) & (random.random(len(at)) >= kind.missing)]
        stamp = at - clock
        if name == 'attitude':
            stamp = stamp - kind.drift * at
        stamp = stamp + kind.jitter * random.uniform(-1.0, 1.0, len(at)) / 2.0
        noise = coloured(random, (len(at), 3), colour) * np.array(kind.axes) * level
        if name == 'attitude':
            seen = np.where((at > kind.frozen[0]) & (at < kind.frozen[1]), kind.frozen[0], at) \
                if kind.frozen else at
            q = sampled(times, attitudes, seen)
            q = multiply(exponential(np.outer(at, kind.space_rate)), q)
            q = multiply(multiply(q, exponential(np.array(kind.mount))[None]),
                         exponential(ATTITUDE_NOISE * noise))
            bad = random.random(len(at)) < kind.outliers
            q[bad] = random.standard_normal((int(bad.sum()), 4))
            q = q / np.linalg.norm(q, axis=1, keepdims=True)
            found[name] = q * [-1, -1, -1, 1] if kind.conjugated else q
        else:
            w = sampled(times, rates, at)
            if kind.gyro_filter:
                w = filtered(times, rates, kind.gyro_filter, at)
            w = rotated_back(exponential(np.array(kind.gyro_mount))[None], w)
            walk = kind.gyro_walk * np.cumsum(random.standard_normal((len(at), 3)), axis=0) \
                / np.sqrt(SENSOR_HZ)
            w = w * kind.gyro_scale + kind.gyro_bias + walk
            w = np.clip(w, -kind.gyro_limit, kind.gyro_limit) + RATE_NOISE * noise
            bad = random.random(len(at)) < kind.outliers
            w[bad] += 5.0 * random.standard_normal((int(bad.sum()), 3))
            found[name] = kind.gyro_unit * w
        order = np.argsort(stamp)
        stamps[name] = np.round(stamp[order] * SECOND).astype(np.int64)
        found[name] = found[name][order]
    return Recording(start, torque_ns, torques, stamps['attitude'], found['attitude'],
                     stamps['rate'], found['rate'])


def filtered(times, values, lag, at):
    """Return values after a first-order lag."""
    state, result = values[0], np.empty_like(values)
    share = np.exp(-STEP / lag)
    for k, value in enumerate(values):
        state = value + (state - value) * share
        result[k] = state
    return sampled(times, result, at)


def named(name):
    """Return the kind with a name."""
    return next(kind for kind in (*RIGHT, *WRONG, *LITTLE) if kind.name == name)
