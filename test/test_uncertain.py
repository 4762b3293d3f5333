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

"""The 95 % band of a replay with uncertain parameters."""

import json
import re

import numpy as np
from pages import data_of
import pytest
from rigid_body_ros import messages, Problem, RigidBody, State, TorqueLog
from rigid_body_ros.commands import main
from rigid_body_ros.ensemble import band, dispersions
from rigid_body_ros.ensemble.dispersions import Fitted
from rigid_body_ros.ensemble.runs import Ensemble
from rigid_body_ros.mechanics import so3
from rigid_body_ros.recording import read_problem, Source
from rigid_body_ros.report.charts import Panel
from rigid_body_ros.scene.scene import load, text_of

RECORDING, SCENE = 'test/recordings/flight.mcap', 'config/tumbler.yaml'
BODY = RigidBody.from_moments(0.045, 0.12, 0.14, 0.002, -0.001, 0.003)
SECOND = 10 ** 9
SIGMAS = 1.959963984540054
TIMES_NS = np.arange(0, 5 * SECOND, SECOND // 10)
LOG = TorqueLog(TIMES_NS, 0.02 * np.sin(np.outer(1e-9 * TIMES_NS, [0.7, 1.1, 0.5]) + 1.0))
PROBLEM = Problem(RigidBody(BODY.inertia, np.diag([1e-3, 2e-3, 1e-3])), State(
    0, (0.1, 0.2, -0.3, 0.9), (0.15, 0.6, -0.1), (0.01, 0.0, 0.02)), LOG)


def ensemble_of(path, text, problem=PROBLEM, seconds=5.0):
    path.write_text(text)
    end_ns = problem.start.time_ns + round(seconds * SECOND)
    return Ensemble(problem, end_ns, dispersions.load(path), 0)


@pytest.mark.parametrize('eigenvalues', [(1.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1.0, 0.3, 0.3),
                                         (1.0, 0.3, 0.05)])
def test_the_radius_contains_95_percent_of_the_vectors(eigenvalues):
    axes = so3.matrix(so3.normalize([0.1, -0.4, 0.7, 0.5]))
    covariance = axes * eigenvalues @ axes.T
    vectors = np.random.default_rng(1).standard_normal((400_000, 3)) * np.sqrt(eigenvalues)
    sampled = np.quantile(np.linalg.norm(vectors, axis=1), 0.95)
    found = band.radius(1e-40 * covariance[None])
    assert found == pytest.approx(1e-20 * sampled, rel=0.01, abs=0.0)
    assert band.radius(0.0 * covariance) == 0.0


@pytest.mark.parametrize('text', [
    'torque_gain: {uniform: [0.5, 0.8]}', 'torque_bias.y: {normal: 0.3}',
    'initial_attitude: {tilt: 0.2}', 'inertia: {relative: 0.1}'])
def test_moments_are_those_of_the_numbers_drawn(tmp_path, text):
    one, = ensemble_of(tmp_path / 'vary.yaml', text).dispersions
    numbers, (mean, sigma) = one.draw(1, np.arange(100_000)), one.moments.T
    assert (np.abs(numbers.mean(axis=0) - mean) < 4.0 * sigma / np.sqrt(100_000)).all()
    np.testing.assert_allclose(numbers.std(axis=0), sigma, rtol=0.01)


def fitted(seed):
    """Return a fit with correlated estimates and an attitude that is far from the guess."""
    names = ['torque_bias.x', 'inertia.ixx', *(f'initial_attitude.{axis}' for axis in 'xyz'),
             'initial_rotor_momentum.z', 'torque_gain']
    factor = np.random.default_rng(seed).standard_normal((7, 7)) * [
        [1e-7], [1e-6], *[[1e-5]] * 5]
    return Fitted(dict(zip(names, [0.002, 0.046, 0.8, -0.5, 0.3, 0.02, 1.2])),
                  np.array([0.5, -0.5, 0.5, 0.5]), factor @ factor.T)


@pytest.mark.slow
@pytest.mark.parametrize('case', ['all kinds', 'fitted'])
def test_a_band_is_the_change_of_the_motion_with_each_number(tmp_path, case):
    ensemble = Ensemble(PROBLEM, 5 * SECOND, (), 0, fitted(2)) if case == 'fitted' else \
        ensemble_of(tmp_path / 'vary.yaml', """
            inertia: {relative: 1.0e-4}
            initial_attitude: {tilt: 1.0e-4}
            initial_angular_velocity.y: {uniform: [0.5999, 0.6003]}
            initial_rotor_momentum.z: {normal: 0.001, relative: true}
            damping.dyy: {normal: 1.0e-6}
            torque_gain: {uniform: [1.1999, 1.2001]}
            torque_bias.x: {uniform: [0.002, 0.00201]}""")
    found = band.band_of(ensemble)
    times_ns = np.rint(found.seconds[[0, 700, 1999]] * 1e9).astype(np.int64)
    mean, factor = ensemble.moments

    def state(numbers):
        motion = ensemble.problem_of(ensemble.with_numbers(numbers[None]), 0).propagate(
            at=times_ns)
        return motion.attitude, motion.angular_velocity
    attitude, _ = state(mean)
    changes = []
    for column in factor.T:
        (above, fast), (below, slow) = state(mean + column), state(mean - column)
        turned = [so3.log(so3.multiply(so3.conjugate(attitude), one)) for one in (above, below)]
        changes.append(np.hstack([turned[0] - turned[1], fast - slow]) / 2.0)
    expected = np.stack(changes, axis=2)
    largest = np.abs(expected).max(axis=(0, 2))[:, None]
    np.testing.assert_allclose(found.spread[[0, 700, 1999]] / largest, expected / largest,
                               atol=1e-5)
    assert found.problem.start.attitude == pytest.approx(attitude[0], abs=1e-15)


def test_a_gain_may_be_zero(tmp_path):
    spin = Problem(RigidBody.from_moments(3.0, 3.0, 4.0), State(), TorqueLog([0], [[0, 0, 0.1]]))
    found = band.band_of(ensemble_of(
        tmp_path / 'vary.yaml', 'torque_gain: {uniform: [-1.0, 1.0]}', spin))
    rates = SIGMAS * found.seconds * 0.1 / 4.0 / np.sqrt(3.0)
    np.testing.assert_allclose(found.radii[1], rates, rtol=1e-9, atol=1e-15)


def test_a_spin_is_not_linear_when_its_angles_exceed_half_a_turn(tmp_path):
    spin = Problem(RigidBody.from_moments(1.0, 2.0, 3.0), State(angular_velocity=(0, 0, 1.0)))
    found = band.band_of(ensemble_of(
        tmp_path / 'vary.yaml', 'initial_angular_velocity.z: {normal: 0.01}', spin, 200.0))
    angles = 0.01 * SIGMAS * found.seconds[:len(found.spread)]
    np.testing.assert_allclose(found.radii[0], angles, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(found.radii[1], 0.01 * SIGMAS, rtol=1e-12)
    assert angles[-1] == pytest.approx(2.5, abs=0.003)


def test_a_warning_counts_the_product_of_two_parameters(tmp_path):
    # The rate w along x of a sphere with the rotor momentum h along y turns at the rate h / J, so
    # its component along z is w h t / J to the lowest order.
    sphere = Problem(RigidBody.from_moments(2.0, 2.0, 2.0), State())
    found = band.band_of(ensemble_of(tmp_path / 'vary.yaml', """
        initial_angular_velocity.x: {normal: 1.0e-6}
        initial_rotor_momentum.y: {normal: 0.01}""", sphere, 10.0))
    assert found.seconds[len(found.spread) - 1] == pytest.approx(0.02 * 2.0 / 0.01, abs=0.01)


def replayed(capsys, *arguments):
    assert main.attitude_replay([RECORDING, '--scene', SCENE, *map(str, arguments)]) == 0
    return capsys.readouterr().out


@pytest.mark.slow
def test_the_summary_and_the_page_show_the_band(tmp_path, capsys):
    page, plot = tmp_path / 'page.html', tmp_path / 'plot.png'
    text = replayed(capsys, '--uncertain', 'examples/vary.yaml', '--report', page, '--plot',
                    plot)
    lines = dict(line.split(None, 1) for line in text.splitlines() if line[:3] != '  9')
    assert lines['uncertain'] == 'vary.yaml: its mean values replace those of the scene'
    angle, rate = (line for line in text.splitlines() if line.startswith('  95 %'))
    end = re.fullmatch(r'the uncertainty is not linear after (18\.\d+ s); '
                       'attitude_ensemble --vary computes it from then on', lines['warning'])[1]
    number = r'[\d.]+'
    for line, what, unit in ((angle, 'attitude', 'deg'), (rate, 'body rates', 'rad/s')):
        assert re.fullmatch(f'  95 % +{what} within {number} {unit} at {end}, at most {number} '
                            f'{unit} at {number} s', line)
    panels = data_of(page.read_text())['panels']
    shaded = [panel for panel in panels if panel['curves'][-1]['style'] == 'band']
    assert [len(panel['curves'][-1]['names']) for panel in shaded] == [4, 3]
    assert [panel['label'] for panel in panels if 'half-width' in panel['label']] == [
        'attitude, rotation vector in body axes: half-width of 95 %',
        'angular velocity, body axes: half-width of 95 %']
    assert plot.stat().st_size > 10_000


@pytest.mark.slow
def test_the_quaternion_is_shaded_as_far_as_it_moves(tmp_path):
    found = band.band_of(ensemble_of(tmp_path / 'vary.yaml',
                                     'initial_attitude: {tilt: 1.0e-5}', PROBLEM, 1.0))
    quaternion, _ = (panel.curves[-1] for panel in found.panels([
        Panel('quaternion', '', []), Panel('angular velocity, body axes', 'rad/s', [])])[:2])
    vectors = 1e-5 * np.random.default_rng(3).standard_normal((100_000, 3))
    moved = so3.multiply(found.motion[-1, :4], so3.exp(vectors)).std(axis=0)
    np.testing.assert_allclose((quaternion.high - quaternion.low)[-1] / 2.0, 1.96 * moved,
                               rtol=0.01)
    np.testing.assert_allclose((quaternion.high + quaternion.low) / 2.0, found.motion[:, :4])


@pytest.mark.slow
def test_all_outputs_show_the_motion_with_the_mean_values(tmp_path, capsys):
    vary, motion, other = (tmp_path / name for name in ('vary.yaml', 'motion.mcap', 'scene.yaml'))
    vary.write_text('initial_angular_velocity.y: {uniform: [0.625, 0.6875]}\n'
                    'inertia.izz: {uniform: [0.125, 0.15625]}\n')
    given = load(SCENE)
    means = {'initial_angular_velocity.y': 0.65625, 'inertia.izz': 0.140625}
    other.write_text(text_of(given, means))
    text = replayed(capsys, '--uncertain', vary, '-o', motion)
    assert main.attitude_replay([RECORDING, '--scene', str(other), '--verify', str(motion)]) == 0
    with Source(motion, '/attitude', [messages.QUATERNION]) as source:
        written = json.loads(source.metadata('rigid_body_ros')['scene'])
    assert written == {**given.values, **means}
    found = band.band_of(ensemble_of(vary, vary.read_text(), read_problem(RECORDING, SCENE), 1.0))
    assert found.scene_of(given).body.inertia[2, 2] == 0.140625
    assert main.attitude_replay([RECORDING, '--scene', str(other)]) == 0
    assert final(text) == final(capsys.readouterr().out)


@pytest.mark.slow
def test_gain_and_bias_act_with_their_mean_values(tmp_path, capsys):
    vary = tmp_path / 'vary.yaml'
    vary.write_text('torque_gain: {uniform: [0.9, 1.0]}\n'
                    'torque_bias.x: {uniform: [0.0, 2.0e-4]}\n')
    text = replayed(capsys, '--uncertain', vary)
    problem = read_problem(RECORDING, SCENE)
    log, = problem.logs
    end_ns = int(log.times_ns[-1])
    expected = problem.replaced(log=TorqueLog(log.times_ns, 0.95 * log.torques)).biased(
        np.array([1e-4, 0.0, 0.0]), end_ns).propagate(at=[end_ns])
    found = next(line for line in text.splitlines() if line.startswith('  attitude'))
    np.testing.assert_allclose([float(word) for word in found.split()[1:5]],
                               expected.attitude[0], rtol=0, atol=1e-12)


@pytest.mark.parametrize(('text', 'words'), [
    ('clock_offset: {normal: 0.01}', "found 'clock_offset'"),
    ('torque_noise: {normal: 0.01}', "found 'torque_noise'"),
    ('orbit.mean_motion: {normal: 0.01}', 'expected a scene with an orbit'),
    ('inertia.ixx: {normal: 0.1}', 'inertia: expected a positive definite tensor'),
])
def test_what_has_no_derivatives_is_one_line(tmp_path, refusal, text, words):
    vary = tmp_path / 'vary.yaml'
    vary.write_text(text)
    line = refusal('attitude_replay', RECORDING, '--scene', SCENE, '--uncertain', vary)
    assert line.startswith(f'attitude_replay: error: {vary}: ')
    assert words in line
    assert line.endswith(f'attitude_ensemble --vary {vary} does without derivatives')


@pytest.mark.parametrize('arguments', [['--verify', 'motion.mcap'], [RECORDING]])
def test_a_band_is_that_of_one_replay(refusal, arguments):
    assert '--uncertain' in refusal('attitude_replay', *arguments, RECORDING, '--scene', SCENE,
                                    '--uncertain', 'examples/vary.yaml')


def final(text):
    """Return the final state in a summary."""
    return [line for line in text.splitlines() if line.startswith(('  attitude', '  body'))]
