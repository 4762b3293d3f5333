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
Published computations and observations, compared with results of this package.

Each row of `ROWS` returns the published value, the computed value, and their difference.
`test_validation.py` checks the rows against their bounds; `benchmarks/validation.py` prints them.
"""

import csv
from functools import cache
import os
from pathlib import Path

from conftest import chord, EPOCH_NS, Reference, SECOND
from known import damped_sphere, dual_spin, gyrostat, landau_zener, period, TOPS
import numpy as np
from rigid_body_ros import Experiment, identify, Measured, propagate, RigidBody, State, TorqueLog
from rigid_body_ros.mechanics import euler, so3


class DataNotHereError(Exception):
    """The published data are not part of the project, and not on this machine."""


def attitudes(right, found):
    """Return both scalar parts, and the angle between the attitudes, rad; q and -q differ."""
    return f'{right[3]:.16f}', f'{found[3]:.16f}', float(chord(right, found))


def rates(right, found):
    """Return both first components, and the relative difference of the vectors."""
    apart = np.linalg.norm(np.subtract(found, right)) / np.linalg.norm(right)
    return f'{right[0]:.15e}', f'{found[0]:.15e}', float(apart)


def worst(compare, cases):
    """Return the comparison with the largest difference."""
    return max(map(compare, cases), key=lambda compared: compared[2])


def numbers(right, found):
    """Return both numbers with 16 digits, and their difference."""
    return f'{right:.16g}', f'{found:.16g}', abs(found - right)


# The Space Station of NASA's JEOD.

#: Attitude and rates, rad/s, after 28 800 s, from a series with 32 digits.
STATION_ATTITUDE = (0.58661706554081749108, -0.37694328926934867502, -0.64288757685711177322,
                    -0.31700116500397213347)
STATION_RATES = (-7.2821872205668973925e-4, -8.3323846270873258681e-4, -2.4249250448404216832e-4)
STATION_SECONDS = (480, 960, 1980, 2340, 28800)


@cache
def station():
    """Return JEOD's log, and the computed motion at its times."""
    log = Reference('iss')
    assert ((log.times_ns[1:] - log.times_ns[0]) // SECOND).tolist() == [*STATION_SECONDS]
    return log, log.propagate()


def station_attitude(row):
    log, motion = station()
    return attitudes(log.attitude[row], motion.attitude[row])


def station_rates(row):
    log, motion = station()
    return rates(log.angular_velocity[row], motion.angular_velocity[row])


def station_rows():
    for name, compare, late in (('attitude {}, rad', station_attitude, 2e-12),
                                ('rates {}, relative', station_rates, 3e-13)):
        yield (name.format('until 2340 s, worst of four'),
               lambda compare=compare: worst(compare, range(1, 5)), 3e-14)
        yield name.format('after 28800 s'), lambda compare=compare: compare(5), late
    yield ('attitude after 28800 s, against 32 digits, rad',
           lambda: attitudes(STATION_ATTITUDE, station()[1].attitude[-1]), 1e-14)
    yield ('rates after 28800 s, against 32 digits, relative',
           lambda: rates(STATION_RATES, station()[1].angular_velocity[-1]), 1e-14)
    yield ("JEOD's attitude after 28800 s, against 32 digits, rad",
           lambda: attitudes(STATION_ATTITUDE, station()[0].attitude[-1]), 2e-12)


# The tumbling brick of NASA's check-cases.

#: slug ft^2
BRICK = 0.001894220, 0.006211019, 0.007194665


@cache
def brick_log():
    """
    Return times, ns, moments, attitudes and rates of the brick, as logged at 10 Hz.

    Slugs and feet are not converted, because only the ratio of moment to inertia matters.
    """
    if 'NESC_DATA' not in os.environ:
        raise DataNotHereError('needs NESC_DATA')
    with open(Path(os.environ['NESC_DATA']) / 'atmos_03_sim_04.csv', newline='') as stream:
        rows = list(csv.DictReader(stream))

    def columns(*endings):
        names = [next(name for name in rows[0] if name.endswith(ending)) for ending in endings]
        return np.array([[float(row[name]) for name in names] for row in rows])
    times = EPOCH_NS + np.round(columns('time')[:, 0] * 10).astype(np.int64) * (SECOND // 10)
    # The north-east-down frame rotates about its north axis as the Earth turns and the longitude
    # changes.
    local = euler.to_quaternion(np.radians(columns('deg_Yaw', 'deg_Pitch', 'deg_Roll')), 'ZYX')
    turned = (7.292115e-5 * (times - times[0]) * 1e-9
              + np.radians(columns('longitude_deg')[:, 0]))
    frame = so3.exp(turned[:, None] * [1.0, 0.0, 0.0])
    return (times, columns('Moment_ftlbf_L', 'Moment_ftlbf_M', 'Moment_ftlbf_N'),
            so3.multiply(frame, local),
            np.radians(columns('deg_s_Roll', 'deg_s_Pitch', 'deg_s_Yaw')))


@cache
def brick():
    """Return the largest errors of the brick: attitude, degrees, and rates, degrees/s."""
    times, moments, attitude, spin = brick_log()
    start = State(int(times[0]), angular_velocity=np.radians((10.0, 20.0, 30.0)))
    log = TorqueLog(times, moments, interpolation='cubic')
    motion = propagate(RigidBody.from_moments(*BRICK), start, log, at=times)
    apart = so3.angle_between(attitude, motion.attitude)
    return (np.degrees(apart.max()),
            np.degrees(np.abs(motion.angular_velocity - spin).max()))


def brick_inertia():
    """Return the moment about the long axis, published and identified, and the largest error."""
    times, moments, attitude, spin = brick_log()
    start = State(int(times[0]), attitude[0], spin[0])
    measured = Measured('/brick', times[1:], attitude[1:], spin[1:])
    log = TorqueLog(times, moments, interpolation='cubic')
    sphere = RigidBody(0.005 * np.eye(3))
    found = identify(sphere, Experiment(start, log, [measured])).body.inertia
    error = np.abs(found - np.diag(BRICK)).max() / max(BRICK)
    return f'{BRICK[2]:.9f}', f'{found[2, 2]:.9f}', float(error)


def brick_rows():
    # The data are not part of the project, so only the differences are shown.
    cells = 'logged at 10 Hz', 'replayed'
    yield 'attitude, largest in 30 s, degrees', lambda: (*cells, brick()[0]), 1e-5
    yield 'rates, largest in 30 s, degrees/s', lambda: (*cells, brick()[1]), 1e-6
    yield 'inertia fitted to the log, relative to the largest moment', brick_inertia, 2e-8


# The asteroid Toutatis.

DAY = 86400.0
TOUTATIS = RigidBody.from_moments(3.0836, 3.235, 1.0)  # of the long axis
TOUTATIS_EPOCH = np.datetime64('1992-11-09T17:49:47')
TOUTATIS_START = State(0, euler.to_quaternion(np.radians((145.498, 65.865, 241.524)), 'ZXZ'),
                       np.radians((14.51, 33.529, -98.709)) / DAY)
#: For the first and the last of 17 radar observations in 1992: the Euler angles 3-1-3, degrees,
#: and the errors of Principia's principal axes, degrees, in order of increasing moments.
TOUTATIS_SEEN = {
    '1992-12-02T21:40': ((122.2, 86.5, 107.0), (7.9, 5.4, 5.9)),
    '1992-12-18T07:09': ((91.6, 81.6, 142.4), (5.6, 6.3, 4.1)),
}


def angle_round(axis, vectors):
    """Return the angles, rad, by which vectors have rotated about an axis since the first."""
    ahead = np.cross(axis, vectors[0])
    return np.unwrap(np.arctan2(vectors @ ahead, vectors @ np.cross(ahead, axis)))


@cache
def toutatis_periods():
    """Return the periods, days, of rotation about the long axis and of its precession."""
    seconds = np.arange(0.0, 6 * DAY, 60.0)
    motion = propagate(TOUTATIS, TOUTATIS_START, at=(seconds * 1e9).astype(np.int64))
    momentum = TOUTATIS.angular_momentum(motion.angular_velocity)
    long_axis = np.array([0.0, 0.0, 1.0])
    turn = np.interp(2 * np.pi, np.abs(angle_round(long_axis, momentum)), seconds)
    north = motion.angular_momentum_space[0] / np.linalg.norm(motion.angular_momentum_space[0])
    precessed = np.abs(angle_round(north, so3.rotate(motion.attitude, long_axis)))
    return turn / DAY, turn / DAY * 2 * np.pi / np.interp(turn, seconds, precessed)


def toutatis_period(which, published):
    found = toutatis_periods()[which]
    return f'{published:.2f}', f'{found:.4f}', abs(found - published)


def toutatis_axes(seen):
    """Compare the errors of the axes against radar: Principia's solver and this package."""
    angles, published = TOUTATIS_SEEN[seen]
    time_ns = int((np.datetime64(seen) - TOUTATIS_EPOCH) / np.timedelta64(1, 'ns'))
    axes = so3.matrix(propagate(TOUTATIS, TOUTATIS_START, at=[time_ns]).attitude[0])
    radar = so3.matrix(euler.to_quaternion(np.radians(angles), 'ZXZ'))
    found = np.degrees(np.arccos((axes * radar).sum(axis=0)))[[2, 0, 1]]
    return (' '.join(f'{angle:.1f}' for angle in published),
            ' '.join(f'{angle:.2f}' for angle in found), np.abs(found - published).max())


def toutatis_rows():
    yield 'period of rotation about the long axis, days', lambda: toutatis_period(0, 5.38), 0.03
    yield 'period of precession of the long axis, days', lambda: toutatis_period(1, 7.40), 0.03
    for seen in TOUTATIS_SEEN:
        yield (f'axes 1, 2, 3 against radar on {seen[:10]}, degrees',
               lambda seen=seen: toutatis_axes(seen), 0.1)


# Bodies without torque from the literature.

#: Attitude and rates, rad/s, of `TOPS` after 10 s, starting at the identity, from a series with 34
#: digits. The series starts from the decimal numbers in the literature, which doubles only
#: approximate.
STATES = {
    'Hairer and Vilmart': (
        (-0.57078695124035073, -0.29938857183079009, -0.20683908610467319, -0.73606136416079394),
        (2.9432708475303459, -0.8693302462913614, 0.77955498148187109)),
    'Hairer and Vilmart, water': (
        (0.7497771466036243, -0.27756735059869179, -0.10754066386713205, -0.59095313005987768),
        (5.2340541859516433, -0.44894191432162688, 0.92915521481064942)),
    "van Zon's top": (
        (0.17783618504593759, 0.45844158615951027, 0.34110922853543152, -0.80115547653113008),
        (-8.9329781478705381, 10.951523571915611, 7.1771583276718637)),
    "Gazebo's boxes": (
        (-0.61992756249945249, -0.27702915068719459, 0.69874572364031014, 0.22516456341395816),
        (2.7558404051468494, -3.7359635192162199, -3.1618090034675183)),
}


@cache
def top(name):
    moments, start, _ = TOPS[name]
    return propagate(RigidBody.from_moments(*moments), State(0, angular_velocity=start),
                     at=[10 * SECOND])


def top_rows():
    yield ('attitude after 10 s, worst of four, rad', lambda: worst(
        lambda name: attitudes(STATES[name][0], top(name).attitude[0]), STATES), 2e-14)
    yield ('rates after 10 s, worst of four, relative', lambda: worst(
        lambda name: rates(STATES[name][1], top(name).angular_velocity[0]), STATES), 1e-14)
    for name in TOPS:
        yield f'{name}, period, s', lambda name=name: numbers(*period(name)), 5e-15


# The sweep of Landau and Zener.


def sweep():
    """
    Return the limit 2 exp(-pi / 2) - 1, and the cosine that approaches it.

    The cosine is the one between the final and the reversed initial rates, in space axes, because
    R33 of `landau_zener` approaches the limit only as 1 / T.
    """
    half_time = 200
    start = State(0, angular_velocity=(1.0, 0.0, -half_time))
    motion = propagate(RigidBody(np.eye(3)), start, TorqueLog([0], [[0.0, 0.0, 1.0]]),
                       at=[2 * half_time * SECOND])
    before, after = (w / np.linalg.norm(w)
                     for w in (start.angular_velocity, motion.angular_velocity[0]))
    return 2 * np.exp(-np.pi / 2) - 1, -before @ so3.matrix(motion.attitude[0]) @ after


def sweep_rows():
    yield 'R33 from -20 s to 20 s', lambda: numbers(*landau_zener(20)), 1e-13
    yield 'R33 from -40 s to 40 s', lambda: numbers(*landau_zener(40)), 1e-13
    yield 'limit, from -200 s to 200 s', lambda: numbers(*sweep()), 5e-7


# Rotors and damping.


def wheel_slew():
    """Return the momentum in space axes before and after 1000 s with 500 torques of wheels."""
    random = np.random.default_rng(5)
    wheels = TorqueLog(np.arange(500) * 2 * SECOND, random.normal(scale=0.05, size=(500, 3)))
    start = State(0, (0.1, -0.3, 0.2, 0.9), (0.05, -0.1, 0.2), (0.5, -1.0, 0.3))
    motion = propagate(RigidBody([[1.1, 0.15, -0.2], [0.15, 2.0, 0.05], [-0.2, 0.05, 2.7]]), start,
                       at=[0, 1000 * SECOND], wheels=wheels)
    return motion.angular_momentum_space


def gyrostat_rows():
    for name, motion in (('symmetric gyrostat', gyrostat), ('damped sphere', damped_sphere)):
        yield (f'{name}, attitude after 100 s, rad',
               lambda motion=motion: attitudes(*motion(100)['attitude']), 1e-13)
        yield (f'{name}, rates after 100 s, relative',
               lambda motion=motion: rates(*motion(100)['rates']), 1e-13)
    yield ('wheel slew, momentum in space after 1000 s, relative',
           lambda: rates(*wheel_slew()), 1e-14)
    for axis, rotors, kind in ((1, 0.9, 'growth rate, 1/s'), (1, 1.1, 'nutation rate, rad/s'),
                               (0, 1.5, 'growth rate, 1/s'), (0, 2.5, 'nutation rate, rad/s')):
        yield (f'dual spin about axis {axis + 1}, h = {rotors} N m s, {kind}',
               lambda axis=axis, rotors=rotors: numbers(*dual_spin(axis, rotors)), 1e-14)


#: The function that compares, and the bound, by source and quantity (with its unit).
ROWS = {source: {name: (compare, bound) for name, compare, bound in rows()}
        for source, rows in {'jeod': station_rows, 'nesc': brick_rows, 'toutatis': toutatis_rows,
                             'tops': top_rows, 'sweep': sweep_rows,
                             'gyrostat': gyrostat_rows}.items()}
