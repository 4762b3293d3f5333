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
import os
import subprocess
import sys

from conftest import at_night, chord, CONFIG, RECORDINGS, SECOND
from conftest import Reference as Known
import matplotlib.image
import numpy as np
from pages import array, data_of
import pytest
from rigid_body_ros import (
    GravityGradient,
    messages,
    propagate,
    read,
    recording,
    RigidBody,
    State,
    TorqueLog,
    UniformField,
)
from rigid_body_ros.commands import main
from rigid_body_ros.kernels import body_layout
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation import Problem
from rigid_body_ros.report.page import html
from rigid_body_ros.tradeoff import Error, measure, Measurement, recommend, Setting, TARGET
from rigid_body_ros.tradeoff.choices import OnWhole
from rigid_body_ros.tradeoff.problem import Case, Reference
from rigid_body_ros.tradeoff.problem import whole as whole_motion
from rigid_body_ros.tradeoff.result import _limits, report_of
from test_reference import NAMES
from test_replay import bad_input

TUMBLER = ('--scene', str(CONFIG / 'tumbler.yaml'))
TORQUES = ('--recording', str(RECORDINGS / 'tumbler.mcap'))
FREE = Problem(RigidBody.from_moments(1.0, 2.0, 2.5), State(0, angular_velocity=(0.1, 1.0, 0.2)))


pytestmark = pytest.mark.usefixtures('short_trades')


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
@pytest.mark.parametrize('fields', [(PIVOT,), (ORBIT,), (PIVOT, ORBIT)])
@pytest.mark.parametrize('rotors', [0.0, 0.3])
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
    motion = result.stretch.run(solver='taylor')
    energy = motion.kinetic_energy + sum(one.potential_energy(
        FREE.body, motion.times_ns, motion.attitude) for one in result.stretch.problem.fields)
    assert np.ptp(motion.kinetic_energy) > 1e-3  # the torques do act
    if fields == (PIVOT,):
        assert np.ptp(energy) < 1e-13
    text = result.text()
    assert 'under fields, without logged torque' in text
    assert 'in principal axes' not in text


@pytest.mark.slow
def test_a_scene_with_fields_may_begin_at_rest(tmp_path, capsys):
    path = tmp_path / 'scene.yaml'
    path.write_text('/**:\n  ros__parameters:\n    inertia: {ixx: 1, iyy: 2, izz: 2.5}\n'
                    '    fields: [pivot]\n    pivot: {moment: {x: 0.1}, field: {z: -9.81}}\n')
    assert main.attitude_tradeoff(['--scene', str(path)]) == 0
    assert 'recommended' in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize('seed', [*range(5), *at_night(*range(5, 20))])
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


def test_rotors_that_take_all_momentum_leave_small_drifts_and_a_target_that_is_met():
    body, rates = RigidBody.from_moments(1.0, 2.0, 2.5), np.array([0.1, 1.0, 0.2])
    start = State(0, angular_velocity=rates, rotor_momentum=-body.angular_momentum(rates))
    wheels = TorqueLog([0, 10 * SECOND], [[0.01, 0.02, -0.03], [0.0, 0.01, 0.0]])
    result = measure(Problem(body, start, wheels=wheels), end_ns=20 * SECOND, targets=[1e-8])
    assert {run.setting.solver for run in result.measurements if not run.failure} \
        == {'auto', 'taylor', 'rk4', 'explicit_euler'}
    best = [run for run in result.measurements if run.setting == Setting('taylor', 1e-15)]
    assert max(best[0].error.momentum, best[0].error.energy) < 1e-14
    expected = propagate(body, start, wheels=wheels, at=[20 * SECOND]).attitude
    found = propagate(body, start, wheels=wheels, at=[20 * SECOND],
                      **result.choices[1e-8].measurement.setting.options).attitude
    assert so3.angle_between(found, expected)[0] <= 1e-8
    assert 'principal axes' not in result.text()


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


def test_a_short_run_is_timed_after_one_of_its_own(monkeypatch):
    # Right after the longest run of another solver, a run takes more than twice its time.
    calls, run = [], Case.run

    def noted(case, **options):
        calls.append(options)
        return run(case, **options)
    monkeypatch.setattr(Case, 'run', noted)
    result = measure(FREE)
    short = [run.setting.options for run in result.measurements if run.first_seconds < 1e-3]
    assert len(short) > 10
    for options in short:
        places = [place for place, call in enumerate(calls) if call == options]
        last = calls.index(result.measurements[-1].setting.options)
        timed = [place for place in places if place > last]
        assert len(timed) >= 2 * 3
        assert set(np.diff(timed)[::2].tolist()) == {1}


@pytest.mark.slow
@pytest.mark.parametrize('name', NAMES)
def test_the_floor_is_about_the_true_error_or_more(name):
    known = Known(name)
    problem = Problem(known.scene.body, known.start, known.log)
    reference = Reference.of(Case(problem, known.times_ns))
    error = chord(known.attitude, reference.trajectory.attitude).max()
    assert error <= 1.5 * reference.floor
    bar = 1e-15 * (10.0 + known.phase()[-1])
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


@pytest.mark.slow
@pytest.mark.slow
def test_the_lines_of_a_plot_ascend_and_have_a_meaning():
    result = measure(a_rod(100), targets=[1e-20, 1.0], seconds=0.01)
    lines = result.reference_errors()
    reference, own = result.reference, result.interpolation_error
    assert {*lines} == {f'rounding floor {reference.floor:.0e} rad', 'target 1e-20 rad',
                        f'last-digit effect {reference.last_digits:.0e} rad', 'target 1 rad',
                        f'hold interpolation {own.estimate:.0e} rad'}
    assert [*lines.values()] == sorted(lines.values())
    assert lines['target 1e-20 rad'] == np.finfo(float).eps


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


def test_the_floor_is_shown_as_what_it_is():
    result = measure(FREE)
    meaning = result.as_dict()['rounding_floor_is']
    assert 'the series with other steps, in principal axes and, without torque, the ' in meaning
    assert 'does not show an error common to all' in meaning
    assert meaning in ' '.join(result.text().split())


def test_a_failed_setting_is_shown_as_failed():
    result = measure(FREE)
    failed = [run for run in result.measurements if run.failure]
    assert failed
    assert {run.setting.solver for run in failed} == {'explicit_euler'}
    assert math.isnan(failed[0].error.attitude)
    assert result.text(all_rows=True).count('failed: ') == len(failed)
    assert 'failed: ' not in result.text()
    assert not any(run.pareto_optimal for run in failed)


@pytest.mark.slow
def test_the_table_the_figures_and_the_picture(tmp_path):
    picture, figures, web = (tmp_path / name for name in ('p.png', 'o.json', 'o.html'))
    environment = {name: value for name, value in os.environ.items() if name != 'DISPLAY'}
    script = ('import sys; from rigid_body_ros.commands import main; '
              'from rigid_body_ros.tradeoff import trade; trade._MOST_STEPS = 20000;'
              'sys.exit(main.attitude_tradeoff())')
    done = subprocess.run([sys.executable, '-c', script, *TUMBLER, *TORQUES, '--target', '1e-9',
                           '--json', figures, '--plot', picture, '--report', web],
                          capture_output=True, text=True,
                          env=environment, check=True)
    assert done.stderr == ''
    for part in ('target            1e-09 rad\nrecommended ', 'limited by ', '\n* ',
                 'rounding floor ',
                 'interpolation     hold (linear would end 0.016 rad away, cubic'):
        assert part in done.stdout
    written = json.loads(figures.read_text())
    for line in written['recommended']['parameters']:
        assert f'    {line}\n' in done.stdout
    assert {run['solver'] for run in written['runs']} == {'auto', 'taylor', 'rk4', 'strang',
                                                          'explicit_euler'}
    assert matplotlib.image.imread(picture).shape[:2] == (600, 1080)
    assert '<p class="source">tumbler.mcap: /torque</p>' in web.read_text(encoding='utf-8')


@pytest.mark.slow
def test_the_recommendations_come_first_and_then_the_pareto_optimal_settings(capsys):
    targets = ('1e-3', '1e-9', '1e-20')
    arguments = [*TUMBLER, *TORQUES]
    assert main.attitude_tradeoff([*arguments, *(word for target in targets[:2]
                                                 for word in ('--target', target))]) == 0
    lines = capsys.readouterr().out.splitlines()
    starts = [number for number, line in enumerate(lines) if line.startswith('target ')]
    assert [lines[number].split()[1] for number in starts] == ['0.001', '1e-09']
    assert starts[0] == 0
    header = next(number for number, line in enumerate(lines)
                  if line.split()[:2] == ['solver', 'setting'])
    assert starts[1] < header
    end = next(number for number, line in enumerate(lines) if 'Pareto-optimal: ' in line)
    assert 3 <= end - header - 1 < 25
    assert all(line.startswith('* ') for line in lines[header + 1:end])
    errors = [float(line.split()[-6]) for line in lines[header + 1:end]]
    assert errors == sorted(errors, reverse=True)
    assert main.attitude_tradeoff([*arguments, '--all']) == 0
    rows = [line for line in capsys.readouterr().out.splitlines()
            if ' tolerance 1e-' in line or ' step ' in line]
    assert len(rows) > 35
    assert lines[end].endswith(f'--all prints the other {len(rows) - (end - header - 1)} settings')


def test_every_target_has_its_own_recommendation(tmp_path):
    result = measure(FREE, targets=[1e-2, 1e-6, 1e-20])
    data = result.as_dict()
    assert [each['target_rad'] for each in data['targets']] == [1e-2, 1e-6, 1e-20]
    assert data['targets'][2]['recommended'] is None
    for each in data['targets'][:2]:
        assert each['recommended']['whole_attitude_error_rad'] <= each['target_rad']
        assert each['recommended']['cost_s_per_simulated_s'] == min(
            run['cost_s_per_simulated_s'] for run in data['runs'] if not run['failure']
            and run['attitude_error_largest_rad'] + result.reference.guaranteed_error
            <= each['target_rad'])
    assert {name: data[name] for name in data['targets'][0]} == data['targets'][0]


@pytest.mark.slow
def test_other_interpolations_end_where_their_motions_do(capsys):
    problems = [read(TORQUES[1], TUMBLER[1], interpolation=name)
                for name in ('hold', 'linear', 'cubic')]
    hold, *others = (one.propagate(at=one.stamps_ns[-1:]).attitude[0] for one in problems)
    linear, cubic = so3.angle_between(others, hold)
    assert main.attitude_tradeoff([*TUMBLER, *TORQUES]) == 0
    assert f'\ninterpolation     hold (linear would end {linear:.2g} rad away, cubic would end ' \
           f'{cubic:.2g} rad away)\n' in capsys.readouterr().out


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


def test_curves_follow_the_settings_and_end_at_the_rounding_floor():
    result = measure(FREE)
    floor = result.reference.floor
    for solver, (errors, _) in result.curves().items():
        measured = [one.error.attitude for one in result.measurements
                    if one.setting.solver == solver and not one.failure]
        assert errors == [max(error, floor) for error in measured]
        if solver in ('auto', 'taylor'):
            turns = np.diff(np.log(errors))
            assert turns.max() <= math.log(2.0)


def test_the_help_states_the_default_target(capsys):
    with pytest.raises(SystemExit):
        main.attitude_tradeoff(['--help'])
    assert f'(default: {TARGET:g})' in ' '.join(capsys.readouterr().out.split())


def test_the_page_spells_out_every_setting_and_has_the_recommended_lines():
    targets = [1e-6, 1e-20]
    result = measure(FREE, targets=targets)
    text = html(report_of(result, '</script><b>: /torque'))
    assert '<b>' not in text
    assert '<p class="source">&lt;/script&gt;&lt;b&gt;: /torque</p>' in text
    lines = '\n'.join(result.choices[1e-6].measurement.setting.parameters)
    assert f'<pre># for attitude errors up to 1e-06 rad\n{lines}</pre>' in text
    assert text.count('<pre>') == 1
    assert '<dt>recommended</dt><dd>none: no setting is certain to meet it' in text
    panel, = data_of(text)['panels']
    assert {'target 1e-06 rad', 'target 1e-20 rad'} < panel['lines'].keys()
    for each, texts, (solver, (errors, costs)) in zip(panel['curves'], panel['texts'],
                                                      result.curves().items()):
        assert each['names'] == [solver]
        np.testing.assert_allclose(array(each['x']), np.maximum(errors, np.finfo(float).eps))
        shown = array(each['low'], '<f4') + each['offsets'][0]
        np.testing.assert_allclose(shown, costs, rtol=1e-6)
        assert len(texts) == len(errors)
        for spelled, cost in zip(texts, costs):
            assert f'{cost:.2e} s per simulated second' in spelled
    front, best = panel['curves'][-1], [one for one in result.measurements if one.pareto_optimal]
    assert (front['style'], front['names']) == ('front', ['Pareto-optimal'])
    np.testing.assert_allclose(array(front['x']), np.maximum(
        sorted(one.error.attitude for one in best), result.reference.floor))
    setting = result.choices[1e-6].measurement.setting
    assert f'<h1>Cheapest setting for errors up to 1e-06 rad: {setting.solver}, ' in text
    assert '; for errors up to 1e-20 rad: none is certain</h1>' in text


@pytest.mark.slow
def test_the_end_of_a_short_stretch_is_that_of_its_problem(monkeypatch):
    monkeypatch.setattr('rigid_body_ros.tradeoff.problem._WORK', 300)
    times = np.arange(2000) * SECOND // 10
    log = TorqueLog(times, np.sin(times * 1e-9)[:, None] * [1e-2, 0.0, 2e-2],
                    interpolation='cubic')
    start = State(0, angular_velocity=(0, 1, 0.1))
    result = measure(Problem(RigidBody.from_moments(1.0, 2.0, 2.5), start, log), seconds=0.5)
    assert result.stretch.seconds < result.whole.seconds
    cut, whole = (some.problem.logs[0].at(result.stretch.times_ns[:-1])[0]
                  for some in (result.stretch, result.whole))
    np.testing.assert_allclose(cut, whole, atol=1e-12)
    cubic, = (some for some in result.interpolation_errors if some.interpolation == 'cubic')
    hold, = (some for some in result.interpolation_errors if some.interpolation == 'hold')
    assert cubic.estimate < 1e-2 * hold.estimate


@pytest.mark.parametrize('name', ['missing', 'not mcap', 'empty', 'nan', 'overflow', 'frame',
                                  'quaternion', 'inertia', 'key', 'no scene'])
def test_a_mistake_is_answered_as_by_the_replay(name, tmp_path, capsys):
    recorded, *scene = bad_input(name, tmp_path)
    assert main.attitude_replay([recorded, *scene, '-o', str(tmp_path / 'o.mcap')]) == 2
    line, = capsys.readouterr().err.splitlines()
    assert main.attitude_tradeoff([*scene, '--recording', recorded]) == 2
    captured = capsys.readouterr()
    found, = captured.err.splitlines()
    assert found.split(': error: ')[1][:80] == line.split(': error: ')[1][:80]
    assert not captured.out


def test_a_body_at_rest_has_nothing_to_measure(tmp_path, capsys):
    rest = tmp_path / 'rest.yaml'
    rest.write_text('/**: {ros__parameters: {inertia: {ixx: 1.0, iyy: 1.0, izz: 1.0}}}\n')
    assert main.attitude_tradeoff(['--scene', str(rest)]) == 2
    error = 'expected a nonzero initial angular velocity or torque, found neither'
    assert f'rest.yaml: {error}\n' in capsys.readouterr().err


@pytest.mark.slow
def test_torques_are_measured_whatever_the_solver_of_the_scene(tmp_path, capsys):
    exact = tmp_path / 'exact.yaml'
    exact.write_text((CONFIG / 'tumbler.yaml').read_text() + '    solver: exact\n')
    assert main.attitude_tradeoff(['--scene', str(exact), *TORQUES]) == 0
    assert '\n    solver: ' in capsys.readouterr().out


def test_a_topic_of_rotors_needs_a_scene_that_has_them(capsys):
    assert main.attitude_tradeoff([*TUMBLER, '--wheel-torque', '/wheels']) == 2
    line, = capsys.readouterr().err.splitlines()
    assert '--wheel-torque: expected a scene with wheels: true, found wheels: false' in line


@pytest.mark.parametrize(('log', 'end_ns', 'message'), [
    (None, 5, 'end_ns: expected a time after the start, 10 ns, found 5 ns'),
    (TorqueLog([3], [[1.0, 0.0, 0.0]]), None, 'expected the last torque after the start of the '
     'motion, 10 ns, found it at 3 ns')], ids=['end', 'log'])
def test_a_motion_that_ends_before_it_starts_is_rejected(log, end_ns, message):
    start = State(10, angular_velocity=(0.0, 1.0, 0.1))
    with pytest.raises(ValueError, match=message):
        measure(Problem(RigidBody.from_moments(1.0, 2.0, 2.5), start, log), end_ns=end_ns)


@pytest.mark.slow
def test_only_a_part_of_a_recording_is_measured(tmp_path):
    figures = tmp_path / 'figures.json'
    assert main.attitude_tradeoff([*TUMBLER, *TORQUES, '--from', '1.5', '--until', '4', '--json',
                                  str(figures)]) == 0
    assert json.loads(figures.read_text())['whole_s'] == 2.5


def test_a_part_needs_a_recording(capsys):
    assert main.attitude_tradeoff([*TUMBLER, '--from', '1']) == 2
    assert '--from: expected a --recording, found none' in capsys.readouterr().err


def test_of_several_topics_one_is_named(tmp_path, capsys):
    path, figures = tmp_path / 'two.mcap', tmp_path / 'figures.json'
    with recording.Writer(path) as writer:
        for topic, seconds in (('/one', 3), ('/other', 5)):
            writer.add_topic(topic, messages.WRENCH)
            for stamp_ns in (SECOND, (1 + seconds) * SECOND):
                writer.write(topic, stamp_ns, messages.wrench(stamp_ns, '', (0.01, 0.0, 0.0)))
    arguments = [*TUMBLER, '--recording', str(path), '--json', str(figures)]
    assert main.attitude_tradeoff(arguments) == 2
    assert ('found /one (geometry_msgs/msg/WrenchStamped), /other (geometry_msgs/msg/'
            'WrenchStamped); choose one with --topic') in capsys.readouterr().err
    assert main.attitude_tradeoff([*arguments, '--topic', '/other']) == 0
    assert json.loads(figures.read_text())['whole_s'] == 5.0
