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

"""In extreme scenes, every solver is accurate to rounding, or reports that it is not."""


from conftest import chord, ROOT, SECOND
import extremes
from known import KNOWN
import numpy as np
import pytest
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from rigid_body_ros.propagation import Problem, SOLVERS
from rigid_body_ros.tradeoff.problem import Case, Reference
from scenes import FIXED_STEP, FULL, FULL_RATES, RESULTS, SCENES
from tables import marks
import truth

pytestmark = pytest.mark.slow

#: Limits of the cost of a test: angle, rad, for a solver with steps, and number of fixed steps.
LONGEST_PHASE, MOST_STEPS = 2e5, 1e5
TO_ROUNDING = ('auto', 'taylor', 'exact')

scenes = pytest.mark.parametrize('scene', SCENES, ids=lambda scene: scene.name)


def affordable(scene):
    return [solver for solver in TO_ROUNDING if solver in scene.solvers
            and (solver != 'taylor' or scene.phase < LONGEST_PHASE)]


@scenes
def test_motion_is_that_of_fifty_digits(scene):
    worst = {}
    for solver in affordable(scene):
        apart, rates_apart = scene.errors(scene.propagate(solver))
        assert apart.max() <= scene.bound(solver)
        assert rates_apart.max() <= scene.bound(solver) * scene.fastest
        worst[solver] = apart.max()
    assert worst['auto'] <= worst.get('taylor', np.inf) + 2e-15
    if scene.torques:
        check_estimates(scene)


def check_estimates(scene):
    """Check the estimates of a trade-off."""
    problem = Problem(scene.body, scene.start, scene.log)
    reference = Reference.of(Case(problem, scene.times_ns))
    apart, _ = scene.errors(reference.trajectory)
    assert apart.max() <= 1.5 * reference.floor
    assert reference.floor <= (scene.growth if scene.amplifies else 10.0 * scene.bar)
    if scene.amplifies:
        assert 0.1 * scene.growth < reference.last_digits < 10.0 * scene.growth


@pytest.mark.nightly
@pytest.mark.parametrize('scene', [scene for scene in SCENES if scene.torques],
                         ids=lambda scene: scene.name)
def test_the_file_has_the_results_under_torque(scene):
    *computed, growth = scene.computed()
    for found, expected in zip(computed, scene.truth):
        assert np.abs(truth.exact(found) - expected).max() < 1e-20 * np.abs(expected).max()
    assert growth == pytest.approx(RESULTS[scene.name][2], rel=1e-6)


@scenes
@pytest.mark.parametrize('solver', FIXED_STEP)
def test_a_step_that_is_too_long_gives_numbers_or_is_refused(scene, solver):
    for step in (scene.step, 100.0 * scene.step):
        if scene.times_ns[-1] * 1e-9 > MOST_STEPS * step:
            continue
        try:
            motion = scene.propagate(solver, max_step=step)
        except ValueError as error:
            assert f'may be too long for {solver}' in str(error)
        else:
            assert np.isfinite(motion.angular_velocity).all()
            assert np.abs(np.linalg.norm(motion.attitude, axis=1) - 1.0).max() < 1e-15


@pytest.mark.parametrize('what', KNOWN)
def test_what_is_known_is_found(what):
    quantity, tolerance = KNOWN[what]
    right, found = quantity()
    assert abs(found - right) <= tolerance * abs(right)


@pytest.mark.parametrize('solver', SOLVERS)
@pytest.mark.parametrize('axis', [0, 1, 2])
def test_rotation_about_a_principal_axis_stays_there(axis, solver):
    # This includes the middle axis: nothing pushes the body off it, not even rounding.
    rates = 3.0 * np.eye(3)[axis]
    motion = propagate(RigidBody.from_moments(1.0, 2.0, 3.0), State(0, angular_velocity=rates),
                       at=np.arange(0, 1000, 7) * SECOND, solver=solver,
                       max_step=0.1 if solver in FIXED_STEP else None)
    apart = np.abs(motion.angular_velocity - rates)
    assert not np.delete(apart, axis, axis=1).any()
    assert apart.max() <= 1e-12  # `strang` divides by what it multiplied with


@pytest.mark.parametrize('power', [-300, -40, 40, 300])
@pytest.mark.parametrize('solver', SOLVERS[:2] + FIXED_STEP)
def test_the_unit_of_inertia_does_not_matter(power, solver):
    # Tensor and torque times a power of two give the same motion, to the last bits.
    times = np.arange(1, 11) * 2 * SECOND

    def moved(scale):
        return propagate(RigidBody(scale * FULL), State(0, angular_velocity=FULL_RATES),
                         TorqueLog([0, 5 * SECOND], scale * np.array([[0.2, -0.1, 0.3], [0] * 3])),
                         at=times, solver=solver, max_step=0.01)
    assert chord(moved(1.0).attitude, moved(2.0 ** power).attitude).max() < 2e-15


def test_the_page_has_every_scene_in_a_family():
    grouped = [scene.name for scenes in extremes.families().values() for scene in scenes]
    assert sorted(grouped) == sorted(scene.name for scene in SCENES)
    page = (ROOT / 'docs' / 'extremes.md').read_text()
    begin, end = marks(extremes.__file__)
    written = page.split(begin)[1].split(end)[0].strip().splitlines()[2:]
    assert [line.split(' | ')[0] for line in written] == [
        f'| {name}' for name in extremes.FAMILIES]
