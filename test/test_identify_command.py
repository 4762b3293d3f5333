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

"""The command `attitude_identify`: from a recording to a fitted scene."""

from contextlib import redirect_stdout
from dataclasses import replace
from html import escape
from io import StringIO
import json
import re

from conftest import SECOND
import measurements
from measurements import header, INERTIA, messages_of, torque_messages, Vector3, Vector3Stamped
import numpy as np
from pages import array, data_of
from pyarrow import parquet
import pytest
from rigid_body_ros import RigidBody, scene, UniformField
from rigid_body_ros.commands import main
from rigid_body_ros.mechanics import so3
from rigid_body_ros.report.text import rounded
from scipy.spatial.transform import Rotation
from tumbling import shifted, Truth

pytestmark = pytest.mark.slow
GUESS = np.diag([0.03, 0.03, 0.03])


def write_tumble(folder, truth=None, guess=GUESS, sensor=None):
    """Write a recording of a tumble, and a scene with a guess; return the folder."""
    truth = truth or measurements.truth()
    record(folder / 'in.mcap', truth, sensor or truth.measured(2e-3, 5e-3))
    measurements.write_scene(folder / 'guess.yaml', replace(truth, inertia=guess))
    return folder


def record(path, truth, sensor, kind='Imu'):
    measurements.write(path, torque=torque_messages(truth), imu=messages_of(kind, sensor))


@pytest.fixture
def tumble(tmp_path):
    return write_tumble(tmp_path)


def identify(folder, *arguments, recordings=('in.mcap',)):
    return main.attitude_identify([*(str(folder / name) for name in recordings), '--scene',
                                  str(folder / 'guess.yaml'), *map(str, arguments)])


def results(folder, *arguments, status=0, **recordings):
    """Return the content of the JSON file, and the fitted scene."""
    assert identify(folder, *arguments, '-o', folder / 'fitted.yaml', '--json',
                    folder / 'out.json', **recordings) == status
    return json.loads((folder / 'out.json').read_text()), scene.load(folder / 'fitted.yaml')


@pytest.fixture(scope='module')
def fitted(tmp_path_factory):
    """Fit a recording with all outputs; return the folder, the results and the lines."""
    folder = write_tumble(tmp_path_factory.mktemp('fitted'))
    with redirect_stdout(StringIO()) as printed:
        found = results(folder, '--measured', '/imu', '--validate', 0.3, '--plot',
                        folder / 'errors.png', '--report', folder / 'page.html')
    return folder, *found, printed.getvalue().splitlines()


def test_from_a_recording_to_a_fitted_scene(fitted, tmp_path):
    folder, data, found, shown = fitted
    assert (folder / 'errors.png').read_bytes().startswith(b'\x89PNG')
    np.testing.assert_allclose(found.body.inertia, INERTIA, atol=1e-4)
    assert found.values['inertia.ixy'] == data['estimates']['inertia.ixy']['value']
    assert found.body_frame == scene.load(folder / 'guess.yaml').body_frame
    assert data['validation']['attitude_rms_rad'] == pytest.approx(2e-3, rel=0.3)
    assert 'errors white' in '\n'.join(shown)
    check_digits(shown, data['estimates'])
    assert main.attitude_replay([str(folder / 'in.mcap'), '--scene', str(folder / 'fitted.yaml'),
                                '-o', str(tmp_path / 'motion.mcap')]) == 0


def check_digits(shown, found):
    """Check that the printed values have the digits of their standard deviations."""
    for line in shown[2:14]:
        name, value, sigma, *_, unit = line.split()
        one = found[name]
        factor = np.degrees(1.0) if unit.startswith('deg') else 1.0
        assert float(sigma) == pytest.approx(factor * one['sigma'], rel=0.05)
        last = 10.0 ** (int(f'{factor * one["sigma"]:.1e}'.split('e')[1]) - 1)
        assert abs(float(value) - factor * one['value']) <= 0.501 * last
        assert len(value.partition('.')[2].partition('e')[0]) in (0, round(-np.log10(last)))
        assert one['unit'] != unit or factor == 1.0


def test_the_page_has_the_estimates_and_the_errors_that_are_left(fitted):
    folder, *_, shown = fitted
    text = (folder / 'page.html').read_text(encoding='utf-8')
    assert '<p class="source">in.mcap: estimated parameters</p>' in text
    assert re.search(r'<h1>Ixx = \S+ kg m² within \S+ %, Iyy = [^<]*; explained: no test rejects '
                     r'the model</h1>', text)
    assert f'<dt>verdict</dt><dd>{escape(shown[0][17:])}</dd>' in text
    for line in shown[2:14]:
        name, *_, unit = line.split('  ')
        assert f'<tr><td>{name.strip()}</td><td>' in text
        assert f'<td>{unit.replace("^2", "²")}</td></tr>' in text
    for line in shown[14:-1]:
        assert f'<dd>{escape(line[17:])}</dd>' in text
    panels = {panel['label']: panel for panel in data_of(text)['panels']}
    assert len(panels) == 10
    for quantity, noise in (('attitude', 2e-3), ('rate', 5e-3)):
        panel = panels[f'/imu: {quantity} error, computed minus measured, axes of the sensor']
        errors, band = panel['curves']
        assert np.sqrt(np.mean(columns(errors, 3) ** 2)) == pytest.approx(noise, rel=0.05)
        assert columns(errors, 3).min() < -noise
        assert columns(band, 1)[0] == pytest.approx(-2.0 * noise, rel=0.05)
        assert panel['lines'] == {'start of the validation': pytest.approx(14.0)}
        correlated = panels[f'/imu: autocorrelation of the {quantity} errors of the fit']
        values, limits = map(columns, correlated['curves'], (3, 1))
        assert np.mean(np.abs(values) > -limits[0, 0]) == pytest.approx(0.05, abs=0.03)
    assert '<title>inertia.ixx and inertia.iyy: ' in text


def test_measured_and_computed_curves_are_over_each_other_and_outliers_are_marks(tmp_path):
    truth, report = measurements.truth(), tmp_path / 'page.html'
    clean = truth.measured(2e-3, 5e-3)
    rates = clean.angular_velocity.copy()
    rates[500] += 3.0
    attitude = clean.attitude * np.where(np.arange(len(rates)) % 2, 1.0, -1.0)[:, None]
    write_tumble(tmp_path, truth, INERTIA, replace(clean, angular_velocity=rates,
                                                   attitude=attitude))
    assert identify(tmp_path, '--estimate', 'start', '--report', report, '--degrees') == 0
    data = data_of(report.read_text(encoding='utf-8'))
    quaternion, errors, velocity = data['panels'][:3]
    assert [one['style'] for one in quaternion['curves']] == ['broad', 'line']
    measured, computed = (columns(one, 4) for one in quaternion['curves'])
    assert np.abs(np.diff(computed)).max() < 0.05
    assert np.abs(measured - computed).max() < 0.01
    assert (errors['unit'], velocity['unit']) == ('deg', 'deg/s')
    assert [one['style'] for one in velocity['curves']] == ['broad', 'marks', 'line']
    assert columns(velocity['curves'][1], 3)[:, 0] == pytest.approx(np.degrees(rates[500]))
    ghost = data['body']['ghost']
    near = np.searchsorted(array(data['body']['times']), array(ghost['times']))
    shown = array(data['body']['attitude']).reshape(-1, 4)[near]
    assert so3.angle_between(array(ghost['attitude'], '<f4').reshape(-1, 4), shown).max() < 0.02


def columns(curves, count):
    return array(curves['low'], '<f4').reshape(count, -1) + np.array(curves['offsets'])[:, None]


@pytest.mark.parametrize(('value', 'sigma', 'text'), [
    (0.02003124, 9.96e-6, '0.020031'), (9.9999, 0.12, '10.00'), (1.2345e-7, 3e-9, '1.235e-07'),
    (123456.7, 1200.0, '123500'), (-1e-5, 3e-3, '0.0000'), (1e9, 1e5, '1.00000e+09'),
    (0.1234567, np.inf, '0.1234567'), (0.5, 0.0, '0.5')])
def test_rounding_to_an_uncertainty(value, sigma, text):
    assert rounded(value, sigma) == text


def test_two_recordings(tumble):
    truth = measurements.truth(seed=2)
    record(tumble / 'other.mcap', truth, truth.measured(2e-3, 5e-3, seed=1))
    data, _ = results(tumble, '--report', tumble / 'out.html',
                      recordings=('in.mcap', 'other.mcap'))
    assert {'initial_attitude.x', 'initial_attitude.x[2]'} <= data['estimates'].keys()
    # The page shows the errors of both.
    errors = {panel['label']: panel for panel in data_of((tumble / 'out.html').read_text(
        'utf-8'))['panels']}
    label = '/imu: rate error, computed minus measured, axes of the sensor'
    assert errors[label]['curves'] != errors[f'recording 2, {label}']['curves']


@pytest.mark.parametrize(('names', 'limit'), [('start', 22.0), ('torque_gain', 10.0)])
def test_only_a_fitted_speed_is_plausible(tmp_path, names, limit):
    fast = measurements.truth(seconds=2.0, rates=(2.0, 3.0, 22.0))
    _, fitted = results(write_tumble(tmp_path, fast, fast.inertia), '--estimate', names)
    assert fitted.values['plausible_speed'] == pytest.approx(limit, rel=0.03)
    assert bool(fitted.warnings) == (names == 'torque_gain')
    degrees = {**fitted.values, 'initial_angular_velocity.z': np.degrees(22.0)}
    assert len(scene.Scene.from_values(degrees).warnings) == 1


def test_a_part_gives_the_state_at_its_beginning(tumble, capsys):
    data, fitted = results(tumble, '--from', '5.03', '--until', '15', '--degrees')
    check_digits(capsys.readouterr().out.splitlines(), data['estimates'])
    assert data['training']['samples'] == 2 * 998
    truth = measurements.truth()
    assert so3.angle_between(fitted.start.attitude, truth.attitude[503].as_quat()) < 1e-3
    np.testing.assert_allclose(fitted.start.angular_velocity, truth.rates[503], atol=3e-3)
    np.testing.assert_allclose(fitted.body.inertia, INERTIA, atol=5e-4)


def test_the_same_measurements_twice_are_not_independent(tumble, refusal):
    one, two, truth = tumble / 'in.mcap', tumble / 'copy.mcap', measurements.truth()
    record(two, truth, truth.measured(2e-3, 5e-3), 'Odometry')  # the bytes differ
    assert refusal('attitude_identify', one, two, '--scene', tumble / 'guess.yaml', '-o',
                   tumble / 'fitted.yaml') == (
        f'attitude_identify: error: {two}: /imu: expected measurements of its own, found those of '
        f'{one}: /imu')
    assert not (tumble / 'fitted.yaml').exists()


def test_an_incomplete_answer_has_exit_status_3_and_no_scene(tumble, capsys):
    outputs = [tumble / name for name in ('fitted.yaml', 'out.json', 'errors.png', 'page.html')]
    options = ['--estimate', 'inertia,start,torque_gain', *(
        word for pair in zip(('-o', '--json', '--plot', '--report'), outputs) for word in pair)]
    assert identify(tumble, *options) == 3
    assert [path.exists() for path in outputs] == [False, True, True, True]
    captured = capsys.readouterr()
    reason = 'only the ratio of torque to inertia enters the motion'
    assert 'not determined by the data' in captured.out
    assert reason in captured.out
    assert 'no scene was written (--force writes it)' in captured.err
    assert '<td>not determined by the data</td>' in outputs[3].read_text(encoding='utf-8')
    assert json.loads(outputs[1].read_text())['unidentifiable'][0]['reason'] == reason
    assert identify(tumble, *options[:4], '--force') == 3
    assert '# torque_gain: ' in outputs[0].read_text()


def test_a_flywheel_weighs_a_thrown_drone(tmp_path):
    spin = 0.05 * np.clip(np.arange(61) / 10 - 1.0, 0.0, 3.0) / 3.0
    truth = Truth(seconds=6.0, amplitude=0.0, momentum=np.outer(spin, [0.6, 0.5, 0.6]),
                  measured_hz=100)
    measurements.write(
        tmp_path / 'in.mcap', imu=messages_of('Imu', shifted(truth.measured(2e-3, 5e-3), -1.0)),
        wheels=[(stamp, Vector3Stamped(header(stamp, 'base_link'), Vector3(*momentum)))
                for stamp, momentum in zip((truth.times + SECOND).tolist(), truth.momentum)])
    (tmp_path / 'guess.yaml').write_text(
        '/**:\n  ros__parameters:\n    wheels: true\n    torque_topics: [torque]\n'
        '    inertia: {ixx: 0.03, iyy: 0.03, izz: 0.03}\n')
    _, fitted = results(tmp_path, '--measured', '/imu', '--wheel-momentum', '/wheels')
    np.testing.assert_allclose(fitted.body.inertia, truth.inertia, atol=3e-4)


@pytest.mark.nightly
def test_a_fitted_weight_is_a_field_of_the_fitted_scene(tmp_path):
    truth = Truth(seconds=10.0, attitude=(0.5, 0.1, 0.0, 0.9), options={
        'fields': [UniformField((0.002, 0.0, -0.02), (0.0, 0.0, -9.81))]})
    later = measurements.Truth(truth.stamps_ns + SECOND, Rotation.from_quat(truth.q), truth.w,
                               truth.times + SECOND, truth.torques, truth.inertia)
    record(tmp_path / 'in.mcap', later, later.measured(2e-3, 5e-3))
    (tmp_path / 'guess.yaml').write_text(
        '/**:\n  ros__parameters:\n    inertia: {ixx: 0.03, iyy: 0.03, izz: 0.03}\n'
        '    start_time: 1000000000\n    fields: [dipole]\n'
        '    dipole: {moment: {x: 1.0e-9}, field: {y: 1.0}}\n')
    data, found = results(tmp_path, '--estimate', 'inertia,start,weight', '--gravity', 0, 0, -9.81)
    fitted, out, estimates = tmp_path / 'fitted.yaml', tmp_path / 'out.json', data['estimates']
    assert '# weight' not in fitted.read_text()
    dipole, weight = found.fields
    assert (dipole.name, dipole.moment.tolist(), weight.name) == ('dipole', [1e-9, 0, 0], 'weight')
    assert weight.moment.tolist() == [estimates[f'weight.{axis}']['value'] for axis in 'xyz']
    assert weight.field.tolist() == [0.0, 0.0, -9.81]
    arguments = [str(tmp_path / 'in.mcap'), '--scene', str(fitted)]
    assert main.attitude_compare([*arguments, '--check']) == 0
    assert main.attitude_ensemble(['--scene', str(fitted), '--vary', str(out), '--recording',
                                   str(tmp_path / 'in.mcap'), '--runs', '20', '-o',
                                   str(tmp_path / 'runs')]) == 0
    rows = parquet.read_table(tmp_path / 'runs' / 'runs.parquet')
    assert np.std(rows['weight.moment.x'].to_numpy()) == pytest.approx(
        estimates['weight.x']['sigma'], rel=0.6)


def test_a_fitted_body_is_a_urdf_with_the_same_numbers(tumble, capsys):
    urdf, out, guess = (tumble / name for name in ('fitted.urdf', 'out.json', 'guess.yaml'))
    # The names in a URDF lack the prefix, which robot_state_publisher adds.
    guess.write_text(f'{guess.read_text()}\n    frame_prefix: base_\n    body_frame: link\n')
    assert identify(tumble, '--measured', '/imu', '--estimate', 'inertia,start,gyro_bias', '-o',
                    urdf, '--json', out) == 0
    text, estimates = urdf.read_text(), json.loads(out.read_text())['estimates']
    expected = [estimates[f'inertia.i{entry}']['value'] for entry in (
        'xx', 'xy', 'xz', 'xy', 'yy', 'yz', 'xz', 'yz', 'zz')]
    assert RigidBody.from_urdf(text, 'link').inertia.ravel().tolist() == expected
    assert f'<!-- gyro_bias.x: {estimates["gyro_bias.x"]["value"]!r} rad/s -->' in text
    assert 'inertia about the centre of mass' in text
    assert identify(tumble, '-o', urdf) == 2
    assert 'fitted.urdf: output exists' in capsys.readouterr().err


@pytest.mark.parametrize(('arguments', 'message'), [
    (['--measured', '/pose'], '/pose'), (['--measured', '/torque'], '/torque'),
    (['-o', 'SCENE'], 'guess.yaml'), (['--report', 'SCENE'], 'guess.yaml'),
    (['--wheel-momentum', '/wheels'], 'wheels: true')])
def test_bad_input_has_exit_status_2(tumble, refusal, arguments, message):
    guess = tumble / 'guess.yaml'
    before = guess.read_bytes()
    arguments = [guess if one == 'SCENE' else one for one in arguments]
    assert message in refusal('attitude_identify', tumble / 'in.mcap', '--scene', guess,
                              *arguments, '--overwrite')
    assert guess.read_bytes() == before


@pytest.mark.parametrize('text', ['mass', ''])
def test_unknown_names_to_estimate(tumble, capsys, text):
    with pytest.raises(SystemExit) as ended:
        identify(tumble, '--estimate', text)
    assert ended.value.code == 2
    assert '--estimate: expected' in capsys.readouterr().err


@pytest.mark.parametrize(('inertia', 'status'), [(1.0, 0), (1.5, 4)])
def test_a_check_says_by_its_exit_status_whether_the_model_is_right(tmp_path, capsys, inertia,
                                                                    status):
    write_tumble(tmp_path, guess=INERTIA * (1.0 + np.diag([0.0, inertia - 1.0, 0.0])))
    arguments = [str(tmp_path / 'in.mcap'), '--scene', str(tmp_path / 'guess.yaml'), '--json',
                 str(tmp_path / 'out.json')]
    assert main.attitude_compare([*arguments, '--check', '--report',
                                  str(tmp_path / 'page.html')]) == status
    captured = capsys.readouterr()
    verdict = json.loads((tmp_path / 'out.json').read_text())['verdict']
    assert verdict['consistent'] == (status == 0)
    assert captured.out.startswith(f'verdict          {verdict["level"]}: ')
    assert (captured.err == '') == (status == 0)
    page = (tmp_path / 'page.html').read_text(encoding='utf-8')
    assert f'<h1>{verdict["level"].capitalize()}: ' in page
    if status:
        assert 'inertia' in [one['name'] for one in verdict['suspects'][:2]]
        assert main.attitude_compare([*arguments, '--overwrite']) == 0
