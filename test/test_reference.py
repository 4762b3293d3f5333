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

"""The engine, compared with motions of 24 to 50 digits."""

import json

from conftest import bound_at, chord, RECORDINGS, Reference
import numpy as np
import pytest
from rigid_body_ros import State
import terms
import truth

NAMES = sorted(path.stem for path in RECORDINGS.glob('*.yaml'))
#: Largest error, rad, in scenes that amplify rounding errors.
AMPLIFYING = {'separatrix': 1e-7, 'torque_free_intermediate_axis': 5e-12}

pytestmark = pytest.mark.usefixtures('fifty_digits')


def test_every_reference_motion_is_here():
    assert len(NAMES) == 15


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'solver'), [
    (name, solver) for name in NAMES for solver in ('auto', 'taylor', 'exact')
    if solver != 'exact' or not Reference(name).log.torques.any()])
def test_recorded_motions(name, solver):
    reference = Reference(name)
    motion = reference.propagate(solver=solver)
    bound = AMPLIFYING.get(name, reference.bound())
    assert np.all(chord(reference.attitude, motion.attitude) <= bound)
    fastest = np.linalg.norm(reference.angular_velocity, axis=1).max()
    apart = np.linalg.norm(motion.angular_velocity - reference.angular_velocity, axis=1)
    assert np.all(apart <= bound * fastest)
    assert np.abs(np.linalg.norm(motion.attitude, axis=1) - 1.0).max() < 1e-14


@pytest.mark.parametrize(('name', 'folder'), [
    *((name, terms.TRUTH) for name in terms.NAMES),
    *((name, terms.TRUTH_OF_FIELDS) for name in terms.NAMES_OF_FIELDS if 'pendulum' not in name)])
def test_motions_under_sources_rotors_damping_and_fields(name, folder):
    scene = terms.Reference(name, folder)
    motion, limits = scene.propagate(scene.times_ns), scene.bound
    attitude = [truth.chord(*pair) for pair in zip(scene.truth('q'), motion.attitude)]
    assert np.all(attitude <= limits)
    for found, key in ((motion.angular_velocity, 'w'), (motion.angular_momentum_space, 'L_space'),
                       (motion.rotor_momentum, 'rotor_momentum')):
        assert np.all(terms.relative(truth.exact(found), scene.truth(key)) <= limits)


@pytest.mark.slow
def test_no_second_of_the_pendulum_loses_more_than_it_magnifies():
    # From each row of the truth to the next, a second later, the factor is 1 to 1e3. From the
    # first to the last it is 1.7e9, because the pendulum passes near its upper balance point.
    scene = terms.Reference('pendulum_swing', terms.TRUTH_OF_FIELDS)
    attitudes, rates = scene.truth('q'), scene.truth('w')
    speed = np.linalg.norm(rates.astype(float), axis=1).max()
    for row, (begin_ns, end_ns) in enumerate(zip(scene.times_ns, scene.times_ns[1:])):
        start, at = State(begin_ns, attitudes[row].astype(float), rates[row].astype(float)), \
            np.array([end_ns])
        limit = bound_at(
            at, lambda at, start=start: scene.propagate(at, start), begin_ns, 5001
        ) * terms.magnification(lambda start, at: scene.propagate(at, start), start, at)
        motion = scene.propagate(at, start)
        assert truth.chord(attitudes[row + 1], motion.attitude[0]) <= limit
        apart = (motion.angular_velocity[0] - rates[row + 1]).astype(float)
        assert np.linalg.norm(apart) <= limit * speed


@pytest.mark.parametrize('name', [
    'actuator_lag', 'actuator_delay_limit', 'wheels_spin_up', 'wheels_friction', 'payload_dropped',
    'arm_deployed'])
def test_motions_with_actuators_wheels_and_bodies_that_change(name):
    values = json.loads((terms.TRUTH_OF_LOOPS / f'{name}.json').read_text())
    for solver in ('auto', 'taylor'):
        terms.assert_agrees(terms.problem_of(values, solver=solver), values)
