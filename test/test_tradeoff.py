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

"""attitude_tradeoff: true errors, recommendations that hold, and the output."""

from dataclasses import replace
import json
import math

from conftest import at_night, chord, CONFIG, limit_trades, RECORDINGS, SECOND
from conftest import Reference as Known
import matplotlib.image
import numpy as np
from pages import array, data_of
import pytest
from rigid_body_ros import messages, propagate, read, recording, RigidBody, State, TorqueLog
from rigid_body_ros.commands import main
from rigid_body_ros.kernels import body_layout
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.fields import GravityGradient, UniformField
from rigid_body_ros.propagation import Problem
from rigid_body_ros.report.page import html
from rigid_body_ros.tradeoff import Error, measure, Measurement, recommend, Setting
from rigid_body_ros.tradeoff.choices import OnWhole
from rigid_body_ros.tradeoff.problem import Case, Reference
from rigid_body_ros.tradeoff.problem import whole as whole_motion
from rigid_body_ros.tradeoff.result import _limits, report_of

NAMES = sorted(path.stem for path in RECORDINGS.glob('*.yaml'))
TUMBLER = ('--scene', str(CONFIG / 'tumbler.yaml'))
TORQUES = ('--recording', str(RECORDINGS / 'tumbler.mcap'))
FREE = Problem(RigidBody.from_moments(1.0, 2.0, 2.5), State(0, angular_velocity=(0.1, 1.0, 0.2)))
pytestmark = pytest.mark.usefixtures('short_trades')


@pytest.fixture(scope='module')
def of_free():
    """Return what is measured on a motion without torque, with a target that none meets."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        limit_trades(monkeypatch)
        return measure(FREE, targets=[1e-2, 1e-6, 1e-20])


@pytest.mark.slow
def test_errors_are_those_of_a_motion_in_closed_form():
    # A symmetric top, whose rates turn about the axis, and whose attitude is two rotations.
    body, rates = RigidBody.from_moments(2.0, 2.0, 3.0), np.array([0.3, -0.2, 1.5])
    result = measure(Problem(body, State(0, angular_velocity=rates)))
    seconds = result.stretch.seconds
    momentum = body.angular_momentum(rates)
    known = so3.multiply(so3.exp(momentum / 2.0 * seconds),
                         so3.exp(np.array([0.0, 0.0, (1 - 3 / 2) * rates[2] * seconds])))
    for run in result.measurements:
        if run.failure:
            continue
        end = propagate(body, result.stretch.problem.start, at=result.stretch.times_ns[-1:],
                        **run.setting.options)
        assert run.error.attitude_final == pytest.approx(
            float(so3.angle_between(end.attitude[0], known)), rel=1e-6, abs=1e-11)
        assert run.error.attitude >= run.error.attitude_final


def random_problem(random):
    """Return a random problem, with or without torques on the body."""
    axes = so3.matrix(so3.normalize(random.normal(size=4)))
    a, b, c = random.uniform(0.1, 1.0, 3)
    body = RigidBody(axes @ np.diag([b + c, c + a, a + b]) @ axes.T)
    start = State(0, random.normal(size=4), random.normal(size=3) * 10.0 ** random.uniform(-2, 1))
    if random.random() < 0.3:
        return Problem(body, start)
    count = int(random.integers(5, 500))
    gaps = (random.uniform(0.2, 1.0, count) * 1e9 * 10.0 ** random.uniform(-2, 0)).astype(int)
    interpolation = str(random.choice(['hold', 'linear', 'cubic']))
    log = TorqueLog(np.cumsum(gaps), random.normal(size=(count, 3)) * 0.1,
                    str(random.choice(['body', 'space'])), interpolation)
    return Problem(body, start, log)


PIVOT = UniformField((0.03, 0.0, -0.2), (0.0, 0.0, -9.81))
ORBIT = GravityGradient(0.4, (0.0, 0.6, 0.8), (1.0, 0.0, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize(('fields', 'rotors'), [((PIVOT,), 0.0), ((PIVOT, ORBIT), 0.3)])
def test_every_solver_is_measured_on_a_scene_with_fields(fields, rotors):
    # A pendulum released from rest, without and with a rotor.
    start = State(0, so3.exp([1.0, 0.5, 0.0]), rotor_momentum=(0.0, rotors, 0.0))
    result = measure(Problem(FREE.body, start, fields=fields), end_ns=20 * 10 ** 9)
    every = {'auto', 'taylor', 'rk4', 'strang', 'explicit_euler'}
    solvers = {one.setting.solver for one in result.measurements}
    assert solvers == (every - {'strang'} if rotors else every)
    # Euler's method may fail, because it makes a body faster and faster.
    assert {one.setting.solver for one in result.measurements if one.failure} <= {'explicit_euler'}
    best = {solver: min(one.error.attitude for one in result.measurements
                        if one.setting.solver == solver and not one.failure)
            for solver in solvers}
    assert max(best['auto'], best['taylor']) < 1e-13
    assert best['rk4'] < 1e-10
    assert max(best.values()) < 0.2
    assert np.ptp(result.stretch.run(solver='taylor').kinetic_energy) > 1e-3  # the torques act
    text = result.text()
    assert 'under fields, without logged torque' in text
    assert 'in principal axes' not in text


@pytest.mark.slow
@pytest.mark.parametrize('seed', [*range(4), *at_night(*range(4, 20))])
def test_the_recommendation_is_right(seed, monkeypatch):
    # Use a small stretch, so that most logs are longer.
    monkeypatch.setattr('rigid_body_ros.tradeoff.problem._WORK', 400)
    random = np.random.default_rng(seed)
    problem = random_problem(random)
    target = 10.0 ** -(2 + 10 * seed / 19)
    result = measure(problem, targets=[target], seconds=1.0)
    choice = result.choices[target]
    assert choice is not None
    whole = result.whole
    right = whole.run(solver='taylor', tolerance=1e-15)
    if choice.measurement.setting.tolerance and target > 1e-11:
        tighter = max(choice.measurement.setting.tolerance / 10.0, 1e-15)
        stricter = whole.run(solver='taylor', tolerance=tighter)
        assert so3.angle_between(stricter.attitude, right.attitude).max() < 2.0 * target
    met = {}
    for run in result.measurements:
        if not run.failure:
            try:
                motion = whole.run(**run.setting.options)
            except ValueError:
                continue
            met[run.setting] = so3.angle_between(motion.attitude, right.attitude).max() <= target
    assert met[choice.measurement.setting]
    cheapest = min(run.seconds for run in result.measurements if met.get(run.setting))
    assert choice.measurement.seconds <= 1.5 * cheapest


def a_measurement(error, seconds):
    return Measurement(Setting('rk4', max_step=seconds), Error(*5 * [error]), seconds, seconds)


def test_what_cannot_be_tried_on_the_whole_log_has_a_margin():
    runs = [a_measurement(error, 1e-3 / error) for error in (1e-6, 1e-8, 1e-10)]
    measured = recommend(runs, 1e-5, 0.0, 10.0, lambda one: 2.0 * one.error.attitude)
    assert (measured.measurement, measured.measured) == (runs[0], True)
    scaled = recommend(runs, 1e-5, 0.0, 10.0, lambda one: None)
    assert (scaled.measurement, scaled.measured) == (runs[1], False)
    assert scaled.error == pytest.approx(1e-6)
    assert recommend(runs, 1e-12, 0.0, 10.0, lambda one: None) is None


@pytest.mark.slow
@pytest.mark.parametrize('name', NAMES)
def test_the_floor_is_about_the_true_error_or_more(name):
    known = Known(name)
    problem = Problem(known.scene.body, known.start, known.log)
    reference = Reference.of(Case(problem, known.times_ns))
    error = chord(known.attitude, reference.trajectory.attitude).max()
    assert error <= 1.5 * reference.floor
    bar = known.bound()[-1]
    assert reference.floor <= max(10.0 * bar, reference.last_digits)


def test_the_floor_shows_an_error_that_other_steps_share():
    # With J^-1 in plain doubles, the motion of this rod would be wrong by 1e-11 rad.
    known = Known('rod_full_tensor_body_torque')
    body = RigidBody(known.scene.body.inertia)
    body._constants[body_layout.LOST_INVERSE] = 0.0
    case = Case(Problem(body, known.start, known.log), known.times_ns)
    reference = Reference.of(case)
    motion = reference.trajectory.attitude
    error = chord(known.attitude, motion).max()
    assert error > 1e-12
    shorter = case.run(solver='taylor', max_step=0.01).attitude
    assert so3.angle_between(shorter, motion).max() < 1e-3 * error
    assert 0.5 * error < reference.floor < 2.0 * error


@pytest.mark.slow
def test_a_target_below_the_last_digits_is_refused_with_their_effect(tmp_path, capsys):
    path = RECORDINGS / 'rod_full_tensor_body_torque'
    arguments = ['--scene', f'{path}.yaml', '--recording', f'{path}.mcap', '--json',
                 str(tmp_path / 'o.json')]
    assert main.attitude_tradeoff([*arguments, '--target', '1e-12']) == 0
    figures = json.loads((tmp_path / 'o.json').read_text())
    assert figures['recommended'] is None
    effect = figures['last_digit_effect_rad']
    assert figures['rounding_floor_rad'] < 1e-13 < 1e-11 < effect < 1e-9
    text = (f'a change of the last digit of inertia, torque or start moves the attitude by '
            f'{effect:.1e} rad')
    printed = capsys.readouterr().out
    assert f'\nlast digits       {text}\n' in printed
    assert f'recommended       none: no setting is certain to meet it, {text}\n' in printed
    assert main.attitude_tradeoff([*arguments, '--target', '1e-9', '--overwrite']) == 0
    assert '\n    solver: ' in capsys.readouterr().out


def a_rod(samples, interpolation='hold'):
    """Return a rod under a smooth torque, for which last digits matter more and more."""
    times = np.linspace(0, 610 * SECOND, samples).astype(np.int64)
    waves = np.sin(times[:, None] * 1e-9 * [0.3, 0.2, 0.31] + [0.0, 1.0, 2.0])
    log = TorqueLog(times, waves * [1e-6, 1e-3, 1e-3], interpolation=interpolation)
    return Problem(RigidBody.from_moments(1e-3, 1.0, 1.0),
                   State(0, angular_velocity=(0.3, 1.2, 0.7)), log)


@pytest.mark.slow
def test_a_target_that_only_the_whole_motion_misses_is_refused_with_its_figure(monkeypatch):
    problem = a_rod(1000)
    assert measure(problem, seconds=0.1).whole.seconds == 610.0
    monkeypatch.setattr('rigid_body_ros.tradeoff.problem._WORK', 600)
    case = whole_motion(problem, None)
    part, whole = Reference.of(case.stretch()).last_digits, Reference.of(case).last_digits
    target = math.sqrt(part * whole)
    assert 3.0 * part < target < whole / 3.0
    result = measure(problem, targets=[target, part / 10.0], seconds=2.0)
    text = result.text()
    digits = 'a change of the last digit of inertia, torque or start moves the attitude by'
    assert f'to meet it, {digits} {whole:.1e} rad on the whole motion\n' in text
    assert f'to meet it, {digits} {part:.1e} rad in the first {result.stretch.seconds:.9g} s\n' \
        in text
    hurried = replace(result, error_on_whole=OnWhole(
        result.whole, result.stretch, result.reference, result.measurements, 0.0))
    assert 'scaled to the whole motion by the square of the time\n' in hurried.text()


@pytest.mark.parametrize('interpolation', ['hold', 'linear'])
def test_another_interpolation_is_advised_under_a_condition_if_hold_may_be_right(interpolation):
    result = measure(a_rod(1000, interpolation), seconds=0.1)
    held, *varies = (text for name, text in _limits(result, 1e-6))
    advice = f'the {interpolation} interpolation between torque samples'
    if interpolation == 'hold':
        assert held == 'if the actuator holds the torque between its samples, the solver: a ' \
                       'tighter setting is more accurate;'
        assert varies[0].startswith(f'if the torque varies between them, {advice}')
    else:
        assert held.startswith(advice)
        assert varies == []


def test_a_failed_setting_is_shown_as_failed(of_free):
    failed = [run for run in of_free.measurements if run.failure]
    assert {run.setting.solver for run in failed} == {'explicit_euler'}
    assert math.isnan(failed[0].error.attitude)
    assert of_free.text(all_rows=True).count('failed: ') == len(failed)
    assert 'failed: ' not in of_free.text()
    assert not any(run.pareto_optimal for run in failed)


@pytest.mark.slow
def test_the_recommendations_come_first_and_all_outputs_have_them(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv('DISPLAY', raising=False)
    picture, figures, web = (tmp_path / name for name in ('p.png', 'o.json', 'o.html'))
    assert main.attitude_tradeoff([
        *TUMBLER, *TORQUES, '--target', '1e-3', '--target', '1e-9', '--json', str(figures),
        '--plot', str(picture), '--report', str(web)]) == 0
    output, error = capsys.readouterr()
    assert error == ''
    lines = output.splitlines()
    first, second = (number for number, line in enumerate(lines) if line.startswith('target '))
    assert [lines[number].split()[1] for number in (first, second)] == ['0.001', '1e-09']
    header = next(number for number, line in enumerate(lines)
                  if line.split()[:2] == ['solver', 'setting'])
    assert first == 0 < second < header
    end = next(number for number, line in enumerate(lines) if 'Pareto-optimal: ' in line)
    best = lines[header + 1:end]
    assert 3 <= len(best) < 25
    assert all(line.startswith('* ') for line in best)
    errors = [float(line.split()[-6]) for line in best]
    assert errors == sorted(errors, reverse=True)
    problems = [read(TORQUES[1], TUMBLER[1], interpolation=name)
                for name in ('hold', 'linear', 'cubic')]
    hold, *others = (one.propagate(at=one.stamps_ns[-1:]).attitude[0] for one in problems)
    linear, cubic = so3.angle_between(others, hold)
    assert f'interpolation     hold (linear would end {linear:.2g} rad away, cubic would end ' \
        f'{cubic:.2g} rad away)' in lines
    written = json.loads(figures.read_text())
    assert written['rounding_floor_is'] in ' '.join(output.split())
    for each in written['targets']:
        for line in each['recommended']['parameters']:
            assert f'    {line}' in lines
    assert {run['solver'] for run in written['runs']} == {'auto', 'taylor', 'rk4', 'strang',
                                                          'explicit_euler'}
    assert matplotlib.image.imread(picture).shape[1] == 1080
    assert '<p class="source">tumbler.mcap: /torque</p>' in web.read_text(encoding='utf-8')
    assert main.attitude_tradeoff([*TUMBLER, *TORQUES, '--all']) == 0
    rows = [line for line in capsys.readouterr().out.splitlines()
            if ' tolerance 1e-' in line or ' step ' in line]
    assert len(rows) > 35
    assert lines[end].endswith(f'--all prints the other {len(rows) - len(best)} settings')


def test_every_target_has_its_own_recommendation(of_free):
    data = of_free.as_dict()
    assert [each['target_rad'] for each in data['targets']] == [1e-2, 1e-6, 1e-20]
    assert data['targets'][2]['recommended'] is None
    for each in data['targets'][:2]:
        assert each['recommended']['whole_attitude_error_rad'] <= each['target_rad']
        assert each['recommended']['cost_s_per_simulated_s'] == min(
            run['cost_s_per_simulated_s'] for run in data['runs'] if not run['failure']
            and run['attitude_error_largest_rad'] + of_free.reference.guaranteed_error
            <= each['target_rad'])
    assert {name: data[name] for name in data['targets'][0]} == data['targets'][0]


@pytest.mark.slow
@pytest.mark.parametrize('shape', ['smooth', 'pulses'])
def test_another_interpolation_is_advised_only_if_it_helps(shape):
    body, start = RigidBody.from_moments(1.0, 2.0, 2.5), State(0, angular_velocity=(0, 1, 0.1))

    def log(step_ns, interpolation):
        times = np.arange(0, 60 * SECOND + 1, step_ns)
        if shape == 'smooth':
            values = np.sin(times[:, None] * 1e-9 * [1.0, 0.7, 1.3])
        else:
            values = (np.sin(times * 1e-9 * 1.1) > 0.8)[:, None] * [1.0, 0.0, 0.5]
        return TorqueLog(times, 1e-2 * values, interpolation=interpolation)

    def error(interpolation):
        motions = [propagate(body, start, log(step_ns, name), at=[60 * SECOND]).attitude[0]
                   for step_ns, name in ((SECOND // 10, interpolation), (SECOND // 1000, 'hold'))]
        return float(so3.angle_between(*motions))
    result = measure(Problem(body, start, log(SECOND // 10, 'hold')), seconds=0.1)
    assert result.dominant(1e-6) == 'interpolation'
    better = result.better_interpolation
    if shape == 'pulses':
        assert better is None
        assert ': only more closely spaced samples help\n' in result.text()
    else:
        assert error(better.interpolation) < 0.1 * error('hold')
        assert f'use {better.interpolation} (about ' in result.text()


def test_the_page_spells_out_every_setting_and_has_the_recommended_lines(of_free):
    text = html(report_of(of_free, 'log.mcap: /torque'))
    for target in (1e-2, 1e-6):
        lines = '\n'.join(of_free.choices[target].measurement.setting.parameters)
        assert f'<pre># for attitude errors up to {target:g} rad\n{lines}</pre>' in text
    assert text.count('<pre>') == 2
    assert '<dt>recommended</dt><dd>none: no setting is certain to meet it' in text
    panel, = data_of(text)['panels']
    assert {'target 0.01 rad', 'target 1e-06 rad', 'target 1e-20 rad'} < panel['lines'].keys()
    for each, texts, (solver, (errors, costs)) in zip(panel['curves'], panel['texts'],
                                                      of_free.curves().items()):
        assert each['names'] == [solver]
        np.testing.assert_allclose(array(each['x']), np.maximum(errors, np.finfo(float).eps))
        shown = array(each['low'], '<f4') + each['offsets'][0]
        np.testing.assert_allclose(shown, costs, rtol=1e-6)
        assert len(texts) == len(errors)
        for spelled, cost in zip(texts, costs):
            assert f'{cost:.2e} s per simulated second' in spelled
    front, best = panel['curves'][-1], [one for one in of_free.measurements if one.pareto_optimal]
    assert (front['style'], front['names']) == ('front', ['Pareto-optimal'])
    np.testing.assert_allclose(array(front['x']), np.maximum(
        sorted(one.error.attitude for one in best), of_free.reference.floor))
    setting = of_free.choices[1e-2].measurement.setting
    assert f'<h1>Cheapest setting for errors up to 0.01 rad: {setting.solver}, ' in text
    assert '; for errors up to 1e-20 rad: none is certain</h1>' in text


def test_a_body_at_rest_has_nothing_to_measure(tmp_path, refusal):
    rest = tmp_path / 'rest.yaml'
    rest.write_text('/**: {ros__parameters: {inertia: {ixx: 1.0, iyy: 1.0, izz: 1.0}}}\n')
    assert refusal('attitude_tradeoff', '--scene', rest).endswith(
        'rest.yaml: expected a nonzero initial angular velocity or torque, found neither')


@pytest.mark.slow
def test_a_part_of_a_recording_is_measured_whatever_the_solver_of_the_scene(
        tmp_path, scene_with, capsys, refusal):
    figures = tmp_path / 'figures.json'
    part = ['--from', '1.5', '--until', '4', '--json', str(figures)]
    assert main.attitude_tradeoff(['--scene', scene_with('solver: exact'), *TORQUES, *part]) == 0
    assert '\n    solver: ' in capsys.readouterr().out
    assert json.loads(figures.read_text())['whole_s'] == 2.5
    assert '--from: expected a --recording, found none' in refusal(
        'attitude_tradeoff', *TUMBLER, '--from', '1')


@pytest.mark.parametrize(('log', 'end_ns', 'message'), [
    (None, 5, 'end_ns: expected a time after the start, 10 ns, found 5 ns'),
    (TorqueLog([3], [[1.0, 0.0, 0.0]]), None, 'expected the last torque after the start of the '
     'motion, 10 ns, found it at 3 ns')], ids=['end', 'log'])
def test_a_motion_that_ends_before_it_starts_is_rejected(log, end_ns, message):
    start = State(10, angular_velocity=(0.0, 1.0, 0.1))
    with pytest.raises(ValueError, match=message):
        measure(Problem(RigidBody.from_moments(1.0, 2.0, 2.5), start, log), end_ns=end_ns)


def test_of_several_topics_one_is_named(tmp_path, refusal):
    path, figures = tmp_path / 'two.mcap', tmp_path / 'figures.json'
    with recording.Writer(path) as writer:
        for topic, seconds in (('/one', 3), ('/other', 5)):
            writer.add_topic(topic, messages.WRENCH)
            for stamp_ns in (SECOND, (1 + seconds) * SECOND):
                writer.write(topic, stamp_ns, messages.wrench(stamp_ns, '', (0.01, 0.0, 0.0)))
    arguments = [*TUMBLER, '--recording', str(path), '--json', str(figures)]
    assert 'WrenchStamped); choose one with --topic' in refusal('attitude_tradeoff', *arguments)
    assert main.attitude_tradeoff([*arguments, '--topic', '/other']) == 0
    assert json.loads(figures.read_text())['whole_s'] == 5.0
