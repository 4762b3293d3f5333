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

"""Runs of an ensemble: drawn values are applied, and applied values are reported."""

from dataclasses import replace

from conftest import SECOND
import numpy as np
from parts import BODY, FREE, START
import pytest
from rigid_body_ros import Problem, State, TorqueLog
from rigid_body_ros.ensemble import applied
from rigid_body_ros.ensemble.dispersions import Dispersion
from rigid_body_ros.ensemble.runs import Ensemble
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation.sensitivity import last_digit_effect
from rigid_body_ros.scene import InputError, Scene

TIMES = np.arange(20) * SECOND // 10
SEEN = np.array([0, 1, SECOND // 3, SECOND, 2 * SECOND])
TORQUES = 0.01 * np.sin(np.arange(60.0)).reshape(20, 3)
LOGS = (TorqueLog(TIMES, TORQUES),)
OTHER = TorqueLog(TIMES[3:] - 5, -0.3 * TORQUES[3:], 'space')
WHEELS = TorqueLog(TIMES + 3, 0.001 * TORQUES[::-1])
SCENE = {'inertia.ixx': 0.045, 'inertia.iyy': 0.12, 'inertia.izz': 0.14, 'inertia.ixy': 0.002,
         'initial_attitude.x': 0.1, 'initial_angular_velocity.y': 0.6,
         'initial_rotor_momentum.z': 0.003, 'damping.dxx': 1e-4}
NOISE = Dispersion('torque_noise', 'normal', (1e-4,))
TILT = Dispersion('initial_attitude', 'tilt', (0.02,))
VARY = (Dispersion('inertia', 'relative', (0.05,)), TILT,
        Dispersion('initial_angular_velocity.y', 'uniform', (0.5, 0.7)),
        Dispersion('initial_rotor_momentum.z', 'normal', (0.1,), relative=True),
        Dispersion('damping.dxx', 'uniform', (-0.5, 0.5), relative=True),
        Dispersion('torque_gain', 'normal', (0.03,)),
        Dispersion('torque_bias.x', 'normal', (1e-4,)),
        Dispersion('clock_offset', 'normal', (0.01,)))


def ensemble(*dispersions, logs=LOGS, wheels=None, **values):
    scene = Scene.from_values({**SCENE, **values})
    return Ensemble(scene.problem().replaced(log=logs, wheels=wheels), 2 * SECOND, dispersions, 1)


def rows(found, first, stop):
    """Return some runs as dicts by column."""
    columns = found.rows(first, stop)
    return [dict(zip(columns, values)) for values in zip(*(column.tolist() for column
                                                           in columns.values()))]


def numbers(row, prefix, axes='xyz'):
    return [row[f'{prefix}{axis}'] for axis in axes]


FIELDS = {'fields': ['pivot', 'magnet'], 'pivot.moment.z': -0.002, 'pivot.field.z': -9.81,
          'magnet.moment.x': 2.0, 'magnet.field.y': 0.003, 'orbit.mean_motion': 0.2}
OF_FIELDS = (Dispersion('pivot.moment.z', 'normal', (0.1,), relative=True),
             Dispersion('pivot.field.x', 'normal', (0.1,)),
             Dispersion('magnet.moment.y', 'uniform', (-1.0, 1.0)),
             Dispersion('orbit.mean_motion', 'uniform', (0.1, 0.3)),
             Dispersion('orbit.position.y', 'uniform', (-1.0, 1.0)))
BOTH, TIMEOUT = (*LOGS, OTHER), {'torque_timeout': 0.5}
STILL = {**TIMEOUT, 'initial_rotor_momentum.z': 0.0}


@pytest.mark.slow
@pytest.mark.parametrize(('vary', 'logs', 'wheels', 'values'), [
    (VARY, LOGS, None, TIMEOUT), ((*VARY[:3], VARY[-1]), LOGS, None, STILL),
    (VARY[:1] + VARY[-3:], LOGS, None, STILL), (VARY[1:3], LOGS, None, STILL),
    (VARY[:3] + VARY[4:6], LOGS, None, STILL), (VARY[:5], (), None, {}),
    (VARY[:5], BOTH, WHEELS, {}), (VARY[:3], (), WHEELS, {}),
    ((*VARY[:3], VARY[5]), (*LOGS, LOGS[0].rows(slice(5, 9))), None, {}),
    (VARY[4:7], BOTH, None, {}), (VARY[:6], BOTH, WHEELS, {}),
    (VARY + OF_FIELDS, BOTH, WHEELS, FIELDS), (VARY[:3] + OF_FIELDS[:1], BOTH, WHEELS, FIELDS),
    ((TILT, NOISE), BOTH, WHEELS, FIELDS)],
    ids=['all', 'offset', 'bias', 'start', 'gain', 'free', 'two frames', 'wheels', 'two logs',
         'bias of two', 'gain of wheels', 'fields', 'moment', 'noise'])
def test_runs_have_the_bits_of_propagate(monkeypatch, vary, logs, wheels, values):
    found = replace(ensemble(*vary, logs=logs, wheels=wheels, **values), times_ns=SEEN)
    assert found.times.tolist() == [0.0, 1e-9, 333_333_333e-9, 1.0, 2.0]
    nominal = found.problem.propagate(at=SEEN)
    np.testing.assert_array_equal(found.nominal_motion, states(nominal))
    monkeypatch.delattr(Ensemble, 'solved')  # all runs are computed at once
    for row in rows(found, 123_456_700, 123_456_720):
        assert row['status'] == 'ok'
        own = found.recorded(found.applied(np.array([row['run']])), 0) if NOISE in vary else None
        motion = motion_of(row, logs, wheels, values, own)
        assert row['motion'] == states(motion).tolist()
        assert row['motion'][-1] == numbers(row, 'attitude.', 'xyzw') + numbers(
            row, 'angular_velocity.')
        assert row['angle_from_nominal'] == so3.angle_between(motion.attitude[-1],
                                                              nominal.attitude[-1])


def states(motion):
    return np.concatenate([motion.attitude, motion.angular_velocity], axis=-1)


def motion_of(row, logs, wheels, values, own=None):
    """Return the motion with the values of a row; logs and wheels may be those of the run."""
    kinds = 'inertia', 'pivot', 'magnet', 'orbit', 'damping'
    problem = Scene.from_values({**SCENE, **values, **{
        key: value for key, value in row.items() if key.split('.')[0] in kinds}}).problem()
    start = State(0, numbers(row, 'initial_attitude.', 'xyzw'),
                  numbers(row, 'initial_angular_velocity.'), (0.0, 0.0, row.get(
                      'initial_rotor_momentum.z', problem.start.rotor_momentum[2])))
    offset = round(row.get('clock_offset', 0.0) * SECOND)
    logs = [TorqueLog(log.times_ns + offset, row.get('torque_gain', 1.0) * log.torques,
                      log.in_space) for log in logs]
    wheels = wheels and TorqueLog(wheels.times_ns + offset, wheels.torques)
    if 'torque_bias.x' in row:
        times = np.arange(0, 2 * SECOND + 1, SECOND // 4) if 'torque_timeout' in values else [0]
        logs.append(TorqueLog(times, np.outer(np.ones(len(times)), [row['torque_bias.x'], 0, 0])))
    logs, wheels = own or (logs, wheels)
    return problem.replaced(start=start, log=logs, wheels=wheels).propagate(at=SEEN)


def test_the_speeds_of_wheels_at_the_start_are_kept_where_the_start_varies():
    start = replace(START, wheel_speeds=(50.0, -20.0, 0.0, 70.0))
    problem = Problem(BODY, start, wheels=FREE)
    runs = Ensemble(problem, SECOND, (Dispersion('inertia.ixx', 'normal', (0.0,)),), 1).rows(0, 1)
    assert [runs[f'attitude.{axis}'][0] for axis in 'xyzw'] == problem.propagate(
        at=[SECOND]).attitude[0].tolist()
    assert last_digit_effect(problem, [SECOND]) < 1e-13


@pytest.mark.parametrize('vary', [VARY[:3], VARY], ids=['shared', 'own'])
def test_long_logs_are_computed_in_blocks_for_which_an_interrupt_need_not_wait(vary):
    stamps = np.arange(100_000)
    fine = TorqueLog(stamps, np.ones((len(stamps), 3)))
    for logs, wheels in (((fine,), None), (LOGS, fine)):
        found = ensemble(*vary, logs=logs, wheels=wheels)
        assert found._at_once * len(stamps) <= 2 ** 22


@pytest.mark.parametrize('vary', [VARY, (*VARY[:2], NOISE)], ids=['all', 'noise'])
def test_a_run_does_not_depend_on_the_others(vary):
    found = ensemble(*vary)
    whole = found.rows(5, 25)
    parts = [found.rows(*span) for span in ((5, 6), (6, 16), (16, 25))]
    for name, column in whole.items():
        assert np.array_equal(column, np.concatenate([part[name] for part in parts]))


def test_values_are_those_drawn():
    found = ensemble(*VARY)
    columns = found.rows(0, 200)
    assert columns['initial_angular_velocity.y'].min() >= 0.5
    assert columns['initial_angular_velocity.y'].max() <= 0.7
    assert 0.5e-4 <= columns['damping.dxx'].min() < columns['damping.dxx'].max() <= 1.5e-4
    for name, mean, sigma in (('initial_rotor_momentum.z', 0.003, 0.0003),
                              ('torque_gain', 1.0, 0.03), ('torque_bias.x', 0.0, 1e-4),
                              ('clock_offset', 0.0, 0.01)):
        values = columns[name]
        assert abs(values.mean() - mean) < 4 * sigma / np.sqrt(200)
        assert abs(values.std() - sigma) < 4 * sigma / np.sqrt(400)
    attitudes = np.stack([columns[f'initial_attitude.{axis}'] for axis in 'xyzw'], axis=-1)
    tilts = so3.angle_between(attitudes, found.problem.start.attitude)
    assert abs(np.mean(tilts ** 2) - 3 * 0.02 ** 2) < 4 * np.sqrt(6 / 200) * 0.02 ** 2


@pytest.mark.parametrize('fraction', [0.5, 0.05])
def test_a_relative_inertia_is_that_of_a_body_with_its_axes_and_spreads_as_given(fraction):
    found = ensemble(Dispersion('inertia', 'relative', (fraction,)))
    axes = found.problem.body.principal_axes
    tensors = axes.T @ found.applied(np.arange(1000)).bodies.inertia @ axes
    moments = np.diagonal(tensors, axis1=1, axis2=2)
    np.testing.assert_allclose(tensors, moments[:, None] * np.eye(3), rtol=0, atol=1e-15)
    assert np.all(2.0 * moments.max(axis=1) < moments.sum(axis=1))
    spread = np.std(moments, axis=0) / found.problem.body.principal_moments
    assert np.all(spread < fraction * 1.1)
    if fraction == 0.05:  # hardly any drawn moments are those of no body
        assert np.all(spread > fraction * 0.64)


@pytest.mark.parametrize(('one', 'values', 'message'), [
    (Dispersion('inertia.izz', 'normal', (0.1,)), {}, 'inertia'),
    (Dispersion('damping.dxx', 'normal', (1e-4,)), {}, 'damping'),
    (Dispersion('initial_angular_velocity.x', 'normal', (1e308,)), {}, 'angular at'),
    (Dispersion('initial_rotor_momentum.z', 'normal', (1e308,)), {}, 'rotor at'),
    (Dispersion('initial_angular_velocity.x', 'uniform', (2e9, 3e9)), {}, 'at'),
    (Dispersion('torque_gain', 'normal', (1e309 / 2,)), {}, 'torque'),
    (Dispersion('torque_gain', 'normal', (1e40,)), {}, 'the'),
    (Dispersion('torque_bias.x', 'normal', (1e308,)), {}, 'torque at'),
    (Dispersion('torque_noise', 'normal', (7e307,)), {}, 'torque at'),
    (Dispersion('clock_offset', 'normal', (1e10,)), {}, 'clock_offset'),
    (Dispersion('orbit.mean_motion', 'uniform', (-0.1, 0.1)), FIELDS, 'mean'),
    (Dispersion('clock_offset', 'normal', (1e308,)), {}, 'clock_offset'),
    (Dispersion('damping.dyy', 'uniform', (0.0, 1.0)), {'solver': 'strang', 'max_step': 0.1,
                                                        'damping.dxx': 0.0}, 'solver'),
])
def test_a_run_that_is_not_possible_is_a_row_with_its_reason(one, values, message):
    found = rows(ensemble(one, **{'initial_rotor_momentum.z': 0.0, **values}), 0, 50)
    failed = [row for row in found if row['status'] == 'failed']
    words = {row['message'].split(maxsplit=1)[0].rstrip(':') for row in failed}
    assert words == set(message.split())
    assert all(np.isnan(row['attitude.x']) for row in failed)
    assert all(row['message'] == '' for row in found if row['status'] == 'ok')


def test_a_run_that_turns_too_far_fails_and_leaves_the_others_as_they_are(monkeypatch):
    varied = Dispersion('torque_gain', 'normal', (50.0,)), TILT
    before = rows(ensemble(*varied), 0, 40)
    monkeypatch.setattr(applied, 'FARTHEST', 20.0)
    after = rows(ensemble(*varied), 0, 40)
    failed = [row['status'] == 'failed' for row in after]
    assert 10 < sum(failed) < 30
    for row, other, fails in zip(before, after, failed):
        assert row == other or fails
        assert ('too far to be computed (limit 31.9 rad)' in other['message']) == fails


@pytest.mark.parametrize(('one', 'logs'), [
    (Dispersion('torque_gain', 'normal', (1e12,)), LOGS),
    (Dispersion('torque_bias.x', 'uniform', (1e9, 2e9)), LOGS),
    (Dispersion('torque_noise', 'normal', (1e9,)), LOGS),
    (Dispersion('initial_angular_velocity.y', 'uniform', (1e8, 2e8)), ()),  # with damping
    (Dispersion('initial_rotor_momentum.x', 'uniform', (1e8, 2e8)), ()),
    (Dispersion('damping.dxx', 'uniform', (1e7, 2e7)), ()),
    # The rates and the torques are small: only the field turns the body.
    (Dispersion('pivot.moment.z', 'uniform', (1e14, 2e14)), ()),
], ids=lambda value: getattr(value, 'key', None))
def test_runs_that_would_take_days_fail_at_once(one, logs):
    for row in rows(ensemble(one, logs=logs, **FIELDS), 0, 8):
        assert 'the body may turn by' in row['message']


def test_a_long_coast_is_no_long_way():
    loud = TorqueLog(np.array([0, 1]) * SECOND, [[1.0, 0.2, 0.1], [0.0, 0.0, 0.0]])
    found = ensemble(TILT, Dispersion('clock_offset', 'normal', (1e-3,)), logs=(loud,), **{
        'damping.dxx': 0.0, 'initial_rotor_momentum.z': 0.0})
    for row in rows(replace(found, end_ns=10 ** 8 * SECOND), 0, 4):
        assert row['status'] == 'ok'


def test_noise_differs_from_sample_to_sample_and_from_run_to_run():
    found = ensemble(NOISE, TILT)
    applied = found.applied(np.arange(100))
    noise = np.concatenate([found.recorded(applied, row)[0][0].torques - TORQUES
                            for row in range(100)])
    assert abs(noise.mean()) < 4 * 1e-4 / np.sqrt(noise.size)
    assert abs(noise.std() - 1e-4) < 4 * 1e-4 / np.sqrt(2 * noise.size)
    assert len(np.unique(noise)) == noise.size


@pytest.mark.parametrize(('one', 'values', 'message'), [
    (Dispersion('clock_offset', 'normal', (0.1,), relative=True), {},
     'clock_offset: relative: expected a nominal value other than 0'),
    (Dispersion('pivot.moment.x', 'normal', (0.1,), relative=True), FIELDS,
     'pivot.moment.x: relative: expected a nominal value other than 0'),
    (Dispersion('torque_gain', 'normal', (0.1,)), {'logs': ()}, 'expected a recording of torques'),
    (Dispersion('orbit.mean_motion', 'uniform', (0.1, 0.3)), {},
     'orbit.mean_motion: expected a scene with an orbit, found none')])
def test_a_dispersion_without_effect_is_a_mistake(one, values, message):
    with pytest.raises(InputError, match=message):
        ensemble(one, **values)
