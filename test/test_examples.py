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

"""The examples, run as by a user, compared with formulas, the truth and the commands."""

import re
import subprocess
import sys

from conftest import at_night, chord, CONFIG, RECORDINGS, ROOT, SECOND
import intermediate_axis
import matplotlib.image
import monte_carlo
from mpmath import mp
import numpy as np
import plan_slew
import pytest
from rigid_body_ros import (
    messages,
    Problem,
    propagate,
    recording,
    RigidBody,
    scene,
    State,
    TorqueLog,
)
from rigid_body_ros.autodiff import vjp
from rigid_body_ros.commands import main
from rigid_body_ros.replay import replay
from scipy.spatial.transform import Rotation
import spinning_top

pytestmark = pytest.mark.slow
NUMBER = r'(?<!\w)[-+]?\d+\.?\d*(?:e[-+]?\d+)?'
TUMBLER = (RECORDINGS / 'tumbler.mcap', CONFIG / 'tumbler.yaml')
PULSES, COAST = (tuple(RECORDINGS / f'{name}.{ending}' for ending in ('mcap', 'yaml'))
                 for name in ('thruster_pulses_irregular', 'torque_free_asymmetric'))


def started(folder, name, *arguments):
    return subprocess.run([sys.executable, '-W', 'error', ROOT / 'examples' / f'{name}.py',
                           *arguments], cwd=folder, capture_output=True, text=True, check=False)


def printed(folder, name, *arguments):
    """Run an example, and return the lines that it prints, by their labels."""
    result = started(folder, name, *arguments)
    assert (result.returncode, result.stderr) == (0, '')
    return dict(re.split('  +', line.strip(), maxsplit=1) for line in result.stdout.splitlines())


def numbers(text):
    return [float(number) for number in re.findall(NUMBER, text)]


def textbook(moments, rates):
    """Return 2 K(k) / lambda, s, from Landau and Lifshitz (Mechanics, section 37)."""
    with mp.workdps(40):
        low, middle, high = (mp.mpf(moment) for moment in moments)
        rates = [mp.mpf(rate) for rate in rates]
        energy = low * rates[0] ** 2 + middle * rates[1] ** 2 + high * rates[2] ** 2
        square = (low * rates[0]) ** 2 + (middle * rates[1]) ** 2 + (high * rates[2]) ** 2
        if square < energy * middle:
            low, high = high, low
        one = (high - middle) * (square - energy * low)
        modulus = (middle - low) * (energy * high - square) / one
        return float(2 * mp.ellipk(modulus) * mp.sqrt(low * middle * high / one))


def test_the_top_precesses_at_the_rate_of_the_formula(tmp_path):
    lines = printed(tmp_path, 'spinning_top')
    assert lines['symmetry'] == 'symmetric top'
    across, _, along = spinning_top.child_top().principal_moments
    np.testing.assert_allclose(numbers(lines['principal moments'])[:3], (across, across, along),
                               rtol=1e-5)
    wobble, _, spin = spinning_top.RATES
    momentum = np.hypot(across * wobble, along * spin)
    assert numbers(lines['axis to momentum']) == pytest.approx(
        [np.degrees(np.arctan2(across * wobble, along * spin))], abs=1e-3)
    for found in ('precession, motion', 'precession, |L|/I_t'):
        assert numbers(lines[found])[0] == pytest.approx(momentum / across, rel=1e-14, abs=0.0)
    assert numbers(lines['relative difference'])[0] < 1e-14


@pytest.mark.parametrize(('arguments', 'name'), [
    ((), 'intermediate_axis.png'), *at_night((('flips.picture',), 'flips.picture'))])
def test_the_wing_nut_flips_as_often_as_the_formula_says(tmp_path, arguments, name):
    lines = printed(tmp_path, 'intermediate_axis', *arguments)
    flips = numbers(lines['flips at'])
    known = textbook(intermediate_axis.wing_nut().principal_moments, intermediate_axis.RATES)
    assert len(flips) >= 4
    np.testing.assert_allclose(np.diff(flips), known, atol=2e-3)
    for found in ('time between flips', 'textbook'):
        assert numbers(lines[found])[0] == pytest.approx(known, rel=1e-14, abs=0.0)
    assert numbers(lines['relative difference'])[0] < 1e-14
    # The picture is a light PNG of sensible size.
    path = tmp_path / name
    assert lines['wrote'] == name
    assert [*tmp_path.iterdir()] == [path]
    assert path.read_bytes().startswith(b'\x89PNG')
    picture = matplotlib.image.imread(path, format='png')
    height, width = picture.shape[:2]
    assert 500 < height < width < 2000
    light = picture[..., :3].min(axis=2)
    assert np.median(light) == light[0, 0] == 1.0
    assert 0.01 < np.mean(light < 0.5) < 0.1


@pytest.mark.parametrize('rates', [(0.0, 6.0, 0.05), (0.05, 6.0, 0.0), (-0.3, -5.0, 0.7)])
@pytest.mark.parametrize('moments', [(4.06e-7, 1.65e-6, 1.756e-6), (1e-6, 1.2e-6, 2.1e-6)])
def test_flips_take_the_same_time_on_both_sides_of_the_separatrix(moments, rates):
    begin = State(angular_velocity=rates)
    motion = propagate(RigidBody.from_moments(*moments), begin, at=intermediate_axis.TIMES_NS)
    flips = intermediate_axis.flip_times(begin, motion)
    known = textbook(moments, rates)
    np.testing.assert_allclose(np.diff(flips), known, rtol=1e-12)
    formula = intermediate_axis.textbook_time(np.array(moments), rates)
    assert formula == pytest.approx(known, rel=1e-14, abs=0.0)


def test_the_picture_shows_rates_and_angle_with_their_units(tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr(intermediate_axis.Figure, 'savefig',
                        lambda figure, *_, **__: figures.append(figure))
    monkeypatch.setattr(sys, 'argv', ['intermediate_axis.py'])
    intermediate_axis.main()
    upper, lower = figures[0].axes
    assert lower.get_xlabel() == 'time (s)'
    assert '(rad/s)' in upper.get_ylabel()
    assert '(deg)' in lower.get_ylabel()
    assert [text.get_text() for text in upper.texts] == ['smallest', 'intermediate', 'largest']
    assert len({line.get_linestyle() for line in upper.lines}) == 3
    nut = intermediate_axis.wing_nut()
    motion = propagate(nut, State(angular_velocity=nut.principal_axes @ intermediate_axis.RATES),
                       at=np.round(lower.lines[0].get_xdata() * SECOND).astype(np.int64))
    for axis, line in zip(nut.principal_axes.T, upper.lines):
        np.testing.assert_allclose(line.get_ydata(), motion.angular_velocity @ axis, atol=1e-14)
    axes = Rotation.from_quat(motion.attitude).apply(nut.principal_axes[:, 1])
    momentum = motion.angular_momentum_space[0]
    cosine = np.cos(np.radians(lower.lines[0].get_ydata()))
    np.testing.assert_allclose(cosine, axes @ momentum / np.linalg.norm(momentum), atol=1e-13)
    assert cosine.max() > np.cos(np.radians(1.0))
    assert cosine.min() < -np.cos(np.radians(1.0))


def test_the_planned_slew_ends_at_rest_at_the_target(tmp_path):
    lines = printed(tmp_path, 'plan_slew')
    assert numbers(lines['attitude error'])[0] < 1e-9
    assert numbers(lines['rate at the end'])[0] < 1e-12
    assert numbers(lines['motions computed'])[0] < 50


def test_no_slew_near_the_planned_one_takes_less_effort():
    torques, _ = plan_slew.plan(plan_slew.SATELLITE, plan_slew.TARGET)
    size = np.abs(torques).max()
    problem = Problem(plan_slew.SATELLITE, State(), TorqueLog(plan_slew.STAMPS_NS, torques))
    _, pull = vjp(problem, {'torques': torques}, at=[plan_slew.END_NS])
    slopes = [pull(one[None, :4], one[None, 4:])['torques'].ravel() for one in np.eye(7)]
    # Lagrange: the gradient of the effort is a combination of those of the state at the end.
    factors, *_ = np.linalg.lstsq(np.transpose(slopes), torques.ravel(), rcond=None)
    np.testing.assert_allclose(factors @ slopes, torques.ravel(), atol=1e-5 * size)


def test_a_slew_of_a_sphere_takes_the_effort_of_the_formula():
    moment, angle, seconds, count = 0.1, np.radians(120.0), 30.0, plan_slew.COUNT
    torques, _ = plan_slew.plan(RigidBody(moment * np.eye(3)), plan_slew.TARGET)
    # With held torques, those of the linear law of a double integrator cost n^2 / (n^2 - 1) more.
    known = 12.0 * (moment * angle) ** 2 / seconds ** 3 * count ** 2 / (count ** 2 - 1)
    assert np.sum(torques ** 2) * seconds / count == pytest.approx(known, rel=1e-10)


def test_torch_fits_the_inertia_to_the_noise(tmp_path):
    pytest.importorskip('torch', reason='PyTorch (torch) is not installed')
    lines = printed(tmp_path, 'fit_inertia_torch')
    assert numbers(lines['largest error, fitted'])[0] < 1e-4
    assert numbers(lines['mean square misfit'])[0] == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize(('arguments', 'recorded', 'config'), [
    ((), *TUMBLER), *at_night(((PULSES[0], '--scene', PULSES[1]), *PULSES),
                              ((COAST[0], '--scene', COAST[1]), *COAST))])
def test_the_replayed_log_ends_where_the_command_does(tmp_path, capsys, arguments, recorded,
                                                      config):
    lines = printed(tmp_path, 'replay_log', *arguments)
    output = tmp_path / 'motion.mcap'
    assert main.attitude_replay([str(recorded), '--scene', str(config), '-o', str(output)]) == 0
    attitude = recording.read(output, '/attitude', messages.QUATERNION).values[-1]
    angles = recording.read(output, '/euler_angles', messages.VECTOR3).values[-1]
    assert numbers(lines['final attitude']) == attitude.tolist()
    assert numbers(lines['final angles']) == angles.tolist()
    summary = ' '.join(capsys.readouterr().out.split())
    assert f'torques {lines["torques"]}, over ' in summary
    assert f'final state {lines["motion"]} after the start' in summary
    assert f'interpolation {lines["interpolation"]} (' in summary


@pytest.mark.parametrize(('name', 'arguments', 'message'), [
    ('replay_log', ('none.mcap',), 'none.mcap: '),
    *at_night(
        ('intermediate_axis', ('none/flips.png',), 'none/flips.png: cannot write: No such file'),
        ('replay_log', ('--scene', 'none.yaml'), 'none.yaml: cannot read the scene'),
        ('replay_log', ('--speed', '2'), 'unrecognized arguments: --speed'))])
def test_a_wrong_argument_is_told_in_one_line(tmp_path, name, arguments, message):
    result = started(tmp_path, name, *arguments)
    assert result.returncode == 2
    usage, line = result.stderr.splitlines()
    assert usage.startswith(f'usage: {name}.py')
    assert line.startswith(f'{name}.py: error: {message}')


def test_monte_carlo_prints_the_distances_from_the_right_motion_and_its_times(tmp_path):
    lines = printed(tmp_path, 'monte_carlo')
    for name in ('time per body drawn', 'time per run'):
        assert 1e-3 < numbers(lines[name])[0] < 1e3
    nominal = numbers(lines['nominal end'])
    tumbler = scene.load(TUMBLER[1])
    result = replay(TUMBLER[0], tumbler)
    assert nominal == result.last.attitude.tolist()
    given = (result.start, result.problem.logs)
    rk4 = propagate(tumbler.body, *given, at=[result.last_ns], solver='rk4', max_step=1e-3)
    assert chord(rk4.attitude[0], nominal) < 1e-9
    ends = [propagate(body, *given, at=[result.last_ns]).attitude[0]
            for body in monte_carlo.draw(tumbler.body)]
    apart = (Rotation.from_quat(nominal).inv() * Rotation.from_quat(ends)).magnitude()
    for share, found in ((50, 'median distance'), (95, '95th percentile')):
        assert numbers(lines[found])[0] == pytest.approx(np.percentile(apart, share), rel=1e-5)


def test_monte_carlo_draws_a_thousand_real_bodies_over_all_of_five_percent():
    nominal = scene.load(TUMBLER[1]).body
    bodies = monte_carlo.draw(nominal)
    moments = np.array([np.diag(nominal.principal_axes.T @ body.inertia @ nominal.principal_axes)
                        for body in bodies])
    assert moments.shape == (1000, 3)
    assert all(body.triangle_excess == 0.0 for body in bodies)
    change = moments / nominal.principal_moments - 1.0
    np.testing.assert_allclose(change.min(axis=0), -0.05, atol=5e-4)
    np.testing.assert_allclose(change.max(axis=0), 0.05, atol=5e-4)
    assert np.abs(np.corrcoef(change.T) - np.eye(3)).max() < 0.1
    smallest, middle, largest = nominal.principal_moments
    assert 1.05 * largest < 0.95 * (smallest + middle)
