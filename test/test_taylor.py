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

"""The Taylor series is as accurate as requested, also with rotors and damping."""

from conftest import chord, SECOND
from mpmath import mp
import numpy as np
from parts import BODY
import pytest
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from rigid_body_ros.mechanics import so3
import truth

RANDOM = np.random.default_rng(31)


def some_body(kind):
    """Return a plate, a rod, a near-sphere, or any body, along its principal axes or turned."""
    if kind < 3:
        moments = [(1.0, 1.0, 2.0), (1e-6, 1.0, 1.0), (1.0, 1.0 + 1e-9, 1.0)][kind]
        return RigidBody(np.diag(moments))
    a, b, c = RANDOM.uniform(0.01, 1.0, 3)
    tensor = np.diag([a + b, b + c, c + a])
    if kind == 4:
        turn = so3.matrix(so3.normalize(RANDOM.normal(size=4)))
        tensor = turn @ tensor @ turn.T
    return RigidBody(0.5 * (tensor + tensor.T))


@pytest.mark.slow
@pytest.mark.parametrize('kind', range(5))
@pytest.mark.parametrize('tolerance', [1e-3, 1e-6, 1e-9, 1e-12])
def test_one_step_between_samples_keeps_to_the_tolerance(kind, tolerance):
    span_ns = SECOND // 1000
    for size in 10.0 ** RANDOM.uniform(-4, -0.5, 40):
        body, share = some_body(kind), RANDOM.uniform()
        w, a = (so3.normalize(RANDOM.normal(size=3)) for _ in range(2))
        w, a = share * size * 1e3 * w, (1.0 - share) ** 2 * size ** 2 * 1e6 * a
        start = State(0, angular_velocity=w)
        log = TorqueLog([0, span_ns], [body.torque(np.zeros(3), a), [0.0, 0.0, 0.0]])
        step = propagate(body, start, log, at=[span_ns], tolerance=tolerance)
        fine = propagate(body, start, log, at=[span_ns], max_step=1e-4)
        angle = np.linalg.norm(w) * 1e-3 + 0.5 * np.linalg.norm(a) * 1e-6
        assert chord(step.attitude, fine.attitude)[0] <= tolerance * angle + 1e-15
        off = np.linalg.norm(step.angular_velocity - fine.angular_velocity)
        assert off <= tolerance * (np.linalg.norm(w) + np.linalg.norm(a) * 1e-3) * 1.0001


@pytest.mark.parametrize('tolerance', [1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14])
@pytest.mark.parametrize(('moments', 'rates'), [
    ((1.0, 2.0, 3.0), (1.0, 0.4, 2.0)), ((1.0, 2.0, 3.0), (0.3, 1.0, 0.2)),
    ((1e-6, 1.0, 1.0000005), (50.0, 1.0, 1.0))])
def test_the_tolerance_is_kept_over_hundreds_of_turns(moments, rates, tolerance):
    body, start = RigidBody(np.diag(moments)), State(0, angular_velocity=rates)
    times = np.arange(1, 101) * round(10 / np.linalg.norm(rates) * SECOND)
    exact = propagate(body, start, at=times, solver='exact')
    series = propagate(body, start, at=times, solver='taylor', tolerance=tolerance)
    turned = np.linalg.norm(rates) * times * 1e-9
    assert np.all(chord(exact.attitude, series.attitude) <= tolerance * (1.0 + turned) + 2e-14)


@pytest.mark.parametrize('tolerance', [1e-6, 1e-8, 1e-9, 1e-12])
def test_the_tolerance_is_kept_under_a_stream_of_torques(tolerance):
    seconds = np.arange(20_000) * 1e-3
    torques = 10.0 * np.sin(2 * np.pi * np.outer(seconds, [0.7, 1.1, 1.9]))
    log = TorqueLog(np.arange(20_000) * (SECOND // 1000), torques)
    body, start = RigidBody.from_moments(1.0, 2.0, 3.0), State(0, angular_velocity=(6, -4, 10))
    times = np.arange(1, 21) * SECOND
    fine = propagate(body, start, log, at=times)
    loose = propagate(body, start, log, at=times, tolerance=tolerance)
    turned = 12.0 * times * 1e-9
    assert np.all(chord(fine.attitude, loose.attitude) <= tolerance * turned + 1e-14)


@pytest.mark.parametrize(('step_ms', 'tolerance', 'tensor'), [
    (1, 1e-15, BODY.inertia), (1, 1e-15, np.diag([1.0, 2.0, 2.5])),
    (10, 1e-12, np.diag([1.0, 1.0, 0.02])), (30, 1e-9, BODY.inertia)])
def test_torques_that_repeat_give_the_motion_of_held_ones(step_ms, tolerance, tensor):
    # Compare short steps from stamp to stamp with long steps of the series.
    stamps, at = np.arange(0, 3 * SECOND, step_ms * SECOND // 1000), np.arange(1, 4) * SECOND
    torques = np.array([[0.03, -0.02, 0.004], [-0.02, 0.03, 0.005], [0.01, 0.02, -0.003]])
    body = RigidBody(tensor, 0.05 * np.diag([0.3, 0.2, 0.1]))
    start = State(0, (0.1, -0.3, 0.2, 0.9), (0.3, -0.2, 0.4), (0.05, 0.04, -0.03))
    repeated, held = (propagate(
        body, start, [TorqueLog(times, np.tile(torque, (len(times), 1)), frame)
                      for torque, frame in zip(torques, ('body', 'space'))], at=at,
        wheels=TorqueLog(times, np.tile(torques[2], (len(times), 1))), tolerance=limit)
        for times, limit in ((stamps, tolerance), (stamps[:1], 1e-15)))
    assert chord(repeated.attitude, held.attitude).max() < 0.01 * tolerance + 2e-15
    apart = np.linalg.norm(repeated.angular_velocity - held.angular_velocity, axis=1).max()
    assert apart < 0.01 * tolerance + 2e-15


@pytest.mark.parametrize('seed', range(2))
def test_the_energy_of_a_gyrostat_does_not_drift(seed):
    # Without the low-order part of J^-1 in the linear terms, the energy changes by at least
    # 1.6e-13.
    random = np.random.default_rng(seed)
    start = State(0, angular_velocity=random.normal(size=3),
                  rotor_momentum=2.0 * random.normal(size=3))
    motion = propagate(BODY, start, at=np.arange(0, 201) * 100 * SECOND)
    energy = motion.kinetic_energy
    assert np.abs(energy / energy[0] - 1.0).max() < 1.2e-13


def damped_turn(damping, inertia, rate, torque, seconds):
    """Return the rate and the angle about a fixed axis, with fifty digits."""
    damping, rate, torque = mp.mpf(damping), mp.mpf(rate), mp.mpf(torque)
    decay = damping / mp.mpf(inertia)
    terminal = torque / damping
    return (terminal + (rate - terminal) * mp.exp(-decay * seconds),
            terminal * seconds - (rate - terminal) * mp.expm1(-decay * seconds) / decay)


@pytest.mark.parametrize('per_second', [50.0, 5000.0])
def test_strong_damping_reaches_the_terminal_velocity(per_second, fifty_digits):
    # The motion about one principal axis is known; it is compared during and after the decay.
    inertia, torque = 2.5, 3.0 * 2.5 * per_second
    body = RigidBody(np.diag([1.0, 2.0, inertia]), per_second * np.diag([1.0, 2.0, inertia]))
    times = np.unique(np.geomspace(1e4, 2e9, 40).astype(np.int64))
    motion = propagate(body, State(0, angular_velocity=(0.0, 0.0, -7.0)),
                       TorqueLog([0], [[0.0, 0.0, torque]]), at=times)
    for k, time_ns in enumerate(times.tolist()):
        seconds = mp.mpf(time_ns) / SECOND
        rate, angle = damped_turn(per_second * inertia, inertia, -7.0, torque, seconds)
        attitude = truth.exact([0, 0, mp.sin(angle / 2), mp.cos(angle / 2)])
        assert truth.chord(attitude, motion.attitude[k]) <= 1e-15 * (10.0 + 3.0 * float(seconds))
        assert abs(float(rate - mp.mpf(motion.angular_velocity[k, 2]))) <= 1e-14 * 7.0
    assert motion.angular_velocity[-1, 2] == pytest.approx(3.0, rel=1e-14)
