"""The engine against motions computed by others: 50 digits, NASA's JEOD, NASA's check-cases."""

import csv
import os
from pathlib import Path

from conftest import EPOCH_NS, RECORDINGS, SECOND, Reference, chord
from mpmath import mp
import numpy as np
import pytest

from rigid_body_ros import (
    RigidBody,
    State,
    TorqueLog,
    euler,
    messages,
    propagate,
    recording,
    scene,
    so3,
)
from rigid_body_ros.replay import replay

NAMES = sorted(path.stem for path in RECORDINGS.glob('*.yaml'))
#: Scenes that amplify rounding: rad.
AMPLIFYING = {'separatrix': 1e-7, 'torque_free_intermediate_axis': 5e-12}


def test_every_reference_motion_is_here():
    assert len(NAMES) == 14


def cases():
    """Return each scene with the solvers that it is for."""
    for name in NAMES:
        solvers = ('auto', 'taylor') if Reference(name).log.torques.any() else \
            ('auto', 'taylor', 'exact')
        yield from ((name, solver) for solver in solvers)


@pytest.mark.parametrize(('name', 'solver'), [*cases()])
def test_motion_is_that_of_fifty_digits(name, solver):
    reference = Reference(name)
    motion = reference.propagate(solver=solver)
    bound = AMPLIFYING.get(name, 1e-15 * (10.0 + reference.phase()))
    assert np.all(chord(reference.attitude, motion.attitude) <= bound)
    fastest = np.linalg.norm(reference.angular_velocity, axis=1).max()
    apart = np.linalg.norm(motion.angular_velocity - reference.angular_velocity, axis=1)
    assert np.all(apart <= bound * fastest)
    assert np.abs(np.linalg.norm(motion.attitude, axis=1) - 1.0).max() < 1e-14
    assert np.all(euler_error(reference.attitude, motion.euler_angles()) <= 4.0 * bound)


def euler_error(attitude, angles):
    """Return by how much 3-1-3 angles are off; at a pole, theta and the sum or difference."""
    errors = []
    with mp.workdps(30):
        for (x, y, z, w), given in zip(attitude.tolist(), angles.tolist()):
            theta = 2 * mp.atan2(mp.hypot(x, y), mp.hypot(w, z))
            half_sum, half_difference = mp.atan2(z, w), mp.atan2(y, x)
            pairs = [(given[0] + mp.mpf(given[2]), 2 * half_sum),
                     (given[0] - mp.mpf(given[2]), 2 * half_difference)]
            if abs(mp.sin(theta)) < 1e-7:
                pairs = pairs[:1] if theta < 1 else pairs[1:]
            turns = [(found - right) / (4 * mp.pi) for found, right in pairs]
            errors.append(max(abs(given[1] - theta), *(
                4 * mp.pi * abs(turn - mp.nint(2 * turn) / 2) for turn in turns)))
    return np.array(errors, float)


def test_station_is_where_nasa_logged_it():
    station = Reference('iss')
    apart = chord(station.attitude, station.propagate().attitude)
    seconds = (station.times_ns - station.times_ns[0]) // SECOND
    assert seconds.tolist() == [0, 480, 960, 1980, 2340, 28800]
    assert np.all(apart[:5] < 1e-12)
    assert apart[5] < 5e-12


def test_station_is_closer_to_32_digits_than_nasa():
    station = Reference('iss')
    exact = [0.58661706554081749108, -0.37694328926934867502, -0.64288757685711177322,
             -0.31700116500397213347]
    assert chord(exact, station.propagate().attitude[-1]) < 5e-14


@pytest.mark.skipif('NESC_DATA' not in os.environ,
                    reason='NESC_DATA does not name the folder of atmos_03_sim_04.csv')
def test_nasas_tumbling_brick(tmp_path):
    # NESC atmospheric case 3: moments logged at 10 Hz; only their ratio to the inertia matters,
    # so that slugs and feet may stay.
    with open(Path(os.environ['NESC_DATA']) / 'atmos_03_sim_04.csv', newline='') as stream:
        rows = list(csv.DictReader(stream))

    def columns(*endings):
        names = [next(name for name in rows[0] if name.endswith(ending)) for ending in endings]
        return np.array([[float(row[name]) for name in names] for row in rows])
    times = EPOCH_NS + np.round(columns('time')[:, 0] * 10).astype(np.int64) * (SECOND // 10)
    moments = columns('Moment_ftlbf_L', 'Moment_ftlbf_M', 'Moment_ftlbf_N')
    with recording.Writer(tmp_path / 'brick.mcap') as writer:
        writer.add_topic('/moment', messages.WRENCH)
        for time_ns, moment in zip(times.tolist(), moments):
            writer.write('/moment', time_ns, messages.wrench(time_ns, 'base_link', moment))
    result = replay(tmp_path / 'brick.mcap', scene.Scene.from_values({
        'inertia.ixx': 0.001894220, 'inertia.iyy': 0.006211019, 'inertia.izz': 0.007194665,
        **{f'initial_angular_velocity.{axis}': np.radians(rate)
           for axis, rate in zip('xyz', (10.0, 20.0, 30.0))}}), interpolation='cubic')
    rates = np.degrees(result.trajectory.angular_velocity)
    logged_rates = columns('deg_s_Roll', 'deg_s_Pitch', 'deg_s_Yaw')
    assert np.abs(rates - logged_rates).max() < 2e-6
    # The north-east-down frame turns about its north axis with the Earth and the longitude.
    local = euler.to_quaternion(np.radians(columns('deg_Yaw', 'deg_Pitch', 'deg_Roll')), 'ZYX')
    turned = (7.292115e-5 * (times - times[0]) * 1e-9
              + np.radians(columns('longitude_deg')[:, 0]))
    frame = so3.exp(turned[:, None] * [1.0, 0.0, 0.0])
    apart = so3.angle_between(so3.multiply(frame, local), result.trajectory.attitude)
    assert np.degrees(apart.max()) < 2e-5


def test_sphere_under_constant_body_torque_turns_about_one_axis():
    # Torque along the spin: theta = w t + tau t^2 / 2 I, from -50 rad/s through rest to +50.
    body, axis = RigidBody(2.0 * np.eye(3)), so3.normalize([1.0, -2.0, 2.0])
    times = np.arange(0, 21) * SECOND
    motion = propagate(body, State(0, angular_velocity=-50.0 * axis),
                       TorqueLog([0], [10.0 * axis]), at=times)
    t = times * 1e-9
    angle = -50.0 * t + 10.0 * t * t / (2.0 * 2.0)
    np.testing.assert_allclose(motion.angular_velocity, np.outer(-50.0 + 5.0 * t, axis),
                               atol=1e-14 * 50)
    assert chord(so3.exp(angle[:, None] * axis), motion.attitude).max() < 1e-15 * (10 + 250)


def test_symmetric_top_precesses_at_l_over_i():
    # Free symmetric top: space precession rate L / It about L, body rate (I3 - It) w3 / It.
    body, w = RigidBody.from_moments(3.0, 3.0, 1.0), np.array([0.4, 0.0, 2.0])
    times = np.linspace(0, 100 * SECOND, 51).astype(np.int64)
    motion = propagate(body, State(0, angular_velocity=w), at=times)
    t = times[:, None] * 1e-9
    momentum = body.angular_momentum(w)
    expected = so3.multiply(so3.exp(t * momentum / 3.0),
                            so3.exp(t * [0.0, 0.0, (3.0 - 1.0) * 2.0 / 3.0]))
    assert chord(expected, motion.attitude).max() < 1e-15 * (10 + 204)
