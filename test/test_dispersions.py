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

"""Dispersions, from a file or from a fit: statistics of the numbers, and ways to a spread."""

from dataclasses import replace
import json
import re

from conftest import CONFIG, nearest_rank
import measurements
from measurements import messages_of, torque_messages
import numpy as np
from pyarrow import parquet
import pytest
from rigid_body_ros.commands import main
from rigid_body_ros.ensemble import dispersions
from rigid_body_ros.ensemble.dispersions import Dispersion, draws, load, load_fitted, UNITS
from rigid_body_ros.ensemble.runs import Ensemble
from rigid_body_ros.ensemble.summary import percentiles
from rigid_body_ros.mechanics import so3
from rigid_body_ros.scene import InputError, Scene
from scipy import stats

RUNS = np.arange(100_000)
VARY = (Dispersion('initial_attitude', 'tilt', (0.02,)),
        Dispersion('initial_angular_velocity.y', 'uniform', (0.5, 0.7)),
        Dispersion('torque_gain', 'normal', (0.03,)))
SIGMAS = np.array([0.02, 0.02, 0.02, 0.2 / np.sqrt(12.0), 0.03])


def test_draws_have_the_given_means_deviations_and_no_correlation():
    rows = np.concatenate([*draws(VARY, 1, RUNS).values()], axis=1)
    error = SIGMAS / np.sqrt(RUNS.size)
    assert np.all(np.abs(rows.mean(0) - [0, 0, 0, 0.6, 0]) < 4 * error)
    # The fourth moment is 3 times the squared variance for a normal number, and 9/5 for a uniform.
    fourth = np.array([3.0, 3.0, 3.0, 1.8, 3.0])
    assert np.all(np.abs(rows.std(0) - SIGMAS) < 4 * error * np.sqrt((fourth - 1.0) / 4.0))
    correlation = np.corrcoef(rows.T)[np.triu_indices(5, 1)]
    assert np.all(np.abs(correlation) < 4 / np.sqrt(RUNS.size))


def test_a_run_depends_on_seed_number_and_key_only():
    every, other = draws(VARY, 1, RUNS[:100]), draws(VARY, 2, RUNS[:100])
    for one in VARY:
        alone = draws([one], 1, RUNS[99:4:-1])[one.key]
        assert np.array_equal(alone, every[one.key][:4:-1])
        assert not np.intersect1d(alone, other[one.key]).size
    assert np.unique(np.concatenate([*every.values()], axis=1)).size == 500


@pytest.mark.parametrize(('seed', 'count'), [(0, 1), (2 ** 32, 4), (2 ** 63 - 1, 17)])
def test_the_numbers_of_a_run_do_not_depend_on_the_other_runs(seed, count):
    runs = np.arange(10 ** 9 - 50, 10 ** 9)
    for draw in (dispersions.uniforms, dispersions.normals):
        together = draw(seed, runs, 'inertia', count)
        alone = [draw(seed, runs[[row]], 'inertia', count)[0] for row in range(len(runs))]
        assert np.array_equal(together, alone)
        assert np.array_equal(together[::-3], draw(seed, runs[::-3], 'inertia', count))
        assert np.unique(together).size == together.size


def test_normal_numbers_have_the_normal_distribution():
    numbers = dispersions.normals(3, RUNS, 'inertia', 2).ravel()
    assert stats.kstest(numbers, 'norm').pvalue > 0.01
    tails = np.count_nonzero(np.abs(numbers) > 3.0)
    expected = 2.0 * stats.norm.sf(3.0) * numbers.size
    assert abs(tails - expected) < 4.0 * np.sqrt(expected)


@pytest.mark.parametrize('numbers', [
    np.random.default_rng(1).exponential(size=10_007), np.zeros(5), np.array([3.0]),
    np.array([5e-324, 0.0, 1e308, 1.0, 1.0 + 2.0 ** -52, 1e-300])])
def test_percentiles_are_among_the_numbers(numbers):
    wanted = [1, 5, 25, 50, 75, 95, 99, 100]
    assert percentiles(numbers.copy(), wanted).tolist() == nearest_rank(numbers, wanted)
    rows = np.stack([numbers, 0.3 * numbers[::-1]])
    expected = [nearest_rank(row, wanted) for row in rows]
    np.testing.assert_array_equal(percentiles(rows, wanted), expected)


def test_a_file_is_read(tmp_path):
    path = tmp_path / 'vary.yaml'
    path.write_text('torque_gain: {normal: 0.05, relative: true}\ninertia: {relative: 0.05}\n')
    assert load(path) == (Dispersion('torque_gain', 'normal', (0.05,), True),
                          Dispersion('inertia', 'relative', (0.05,)))


def test_values_of_the_fields_of_a_scene_vary(tmp_path):
    path = tmp_path / 'vary.yaml'
    path.write_text('pivot.moment.z: {normal: 0.1}\norbit.mean_motion: {uniform: [1, 2]}\n')
    assert load(path, ['pivot']) == (Dispersion('pivot.moment.z', 'normal', (0.1,)),
                                     Dispersion('orbit.mean_motion', 'uniform', (1.0, 2.0)))
    with pytest.raises(InputError, match='pivot.moment.z: unknown key; did you mean pivto.moment'):
        load(path, ['pivto'])
    path.write_text('pivot.field.z: {normal: -1}\n')
    with pytest.raises(InputError, match=r'pivot.field.z: normal: .* 0 \(m/s\^2 or T\), found'):
        load(path, ['pivot'])


@pytest.mark.parametrize(('text', 'message'), [
    ('', 'the file: expected keys and values'),
    ('torque_gian: {normal: 1}', 'torque_gian: unknown key; did you mean torque_gain?'),
    ('torque_gain: {normal: -1}', 'normal: expected a number greater than 0, found'),
    ('clock_offset: {uniform: [2, 1]}', 'uniform: expected two ascending numbers (s), found'),
    ('torque_noise: {normal: nan}', 'expected a number greater than 0 (N m), found'),
    ('initial_attitude: {normal: 1}', 'initial_attitude: expected tilt, found'),
    ('torque_gain: {normal: 1, relative: 2}', 'relative: expected true or false, found'),
    ('torque_gain: {normal: 1}\ntorque_gain: {normal: 1}', 'expected each key once'),
    ('{}', 'expected a parameter that varies, found none'),
    ('torque_gain: 3', 'torque_gain: expected keys and values (torque_gain: {normal: 0.03}), '
     "found '3'"),
    ('torque_gain: {normal: .inf}', "normal: expected a number greater than 0, found ['.inf']"),
    ('torque_gain: {uniform: [-1e308, 1e308]}', 'uniform: expected two ascending numbers, found'),
    ('torque_gain: {normal: 1, relative: [true]}', 'expected true or false, found a list'),
    ('inertia: {relative: 0.1}\ninertia.ixx: {normal: 1}', 'either inertia or its entries'),
])
def test_a_mistake_is_one_line(tmp_path, text, message):
    path = tmp_path / 'vary.yaml'
    path.write_text(text)
    with pytest.raises(InputError, match=re.escape(message)) as error:
        load(path)
    assert str(path) in str(error.value)


NAMES = ('inertia.ixx', 'initial_angular_velocity.y', 'torque_gain', 'torque_bias.z')
MEAN, SIGMA = np.array([0.02, -0.7, 1.01, 2e-5]), np.array([3e-5, 1e-3, 2e-2, 4e-7])
CORRELATION = np.array([[1.0, 0.3, 0.99, 0.0], [0.3, 1.0, 0.25, -0.5], [0.99, 0.25, 1.0, 0.0],
                        [0.0, -0.5, 0.0, 1.0]])
COVARIANCE = CORRELATION * np.outer(SIGMA, SIGMA)
ATTITUDE = tuple(f'initial_attitude.{axis}' for axis in 'xyz')
GUESS = np.array([0.5, -0.5, 0.5, 0.5])


def written(path, names=NAMES, values=MEAN, matrix=COVARIANCE, **more):
    units = ['rad' if name in ATTITUDE else UNITS.get(name, 'rad') for name in names]
    data = {'estimates': {name: {'value': float(value), 'unit': unit}
                          for name, value, unit in zip(names, values, units)},
            'covariance': {'names': [*names], 'units': units, 'matrix': [
                [None if np.isnan(value) else value for value in row] for row in matrix]},
            'guess_attitude_xyzw': GUESS.tolist(), 'converged': True,
            'verdict': {'level': 'explained'}, **more}
    path.write_text(json.dumps(data))
    return path


def rows_of(fit, count, seed=1):
    return np.stack([*fit.draw(seed, np.arange(count)).values()], axis=1)


def test_draws_have_the_means_deviations_and_correlations_of_the_fit(tmp_path):
    rows, runs = rows_of(load_fitted(written(tmp_path / 'fitted.json')), 100_000), 100_000
    assert np.all(np.abs(rows.mean(0) - MEAN) < 4 * SIGMA / np.sqrt(runs))
    assert np.all(np.abs(rows.std(0) - SIGMA) < 4 * SIGMA / np.sqrt(2 * runs))
    error = (1.0 - CORRELATION ** 2) / np.sqrt(runs)
    assert np.all(np.abs(np.corrcoef(rows.T) - CORRELATION) <= 4 * error + 1e-12)


def test_the_systematic_part_of_an_interval_widens_the_distribution(tmp_path):
    path = written(tmp_path / 'fitted.json')
    data = json.loads(path.read_text())
    data['estimates']['torque_gain']['systematic'] = np.sqrt(3.0) * SIGMA[2]
    path.write_text(json.dumps(data))
    wider = np.diag([1.0, 1.0, np.sqrt(2.0), 1.0])
    np.testing.assert_allclose(load_fitted(path).covariance, wider @ COVARIANCE @ wider,
                               rtol=1e-14)


def test_sensors_and_later_recordings_do_not_change_the_distribution_of_the_others(tmp_path):
    sensors = 'clock_offset', 'gyro_bias.z', 'gyro_scale.x@/imu', 'clock_drift@/a.csv'
    names = ('mount.x@/imu', *NAMES, *sensors, 'initial_attitude.x[2]')
    matrix = np.full((10, 10), np.nan)  # of what the recording does not determine
    matrix[1:5, 1:5] = COVARIANCE
    fit = load_fitted(written(tmp_path / 'more.json', names, [9, *MEAN, 9, 9, 9, 9, 9],
                              matrix))
    assert fit.ignored == ('mount.x@/imu', *sensors, 'initial_attitude.x[2]')
    alone = load_fitted(written(tmp_path / 'fitted.json'))
    assert np.array_equal(rows_of(fit, 9), rows_of(alone, 9))


def test_estimates_that_depend_on_each_other_exactly_stay_so(tmp_path):
    matrix = np.outer(SIGMA, SIGMA) * [[1, 0, 1, 0], [0, 0, 0, 0], [1, 0, 1, 0], [0, 0, 0, 1]]
    fit = load_fitted(written(tmp_path / 'fitted.json', matrix=matrix))
    drawn = (rows_of(fit, 50) - MEAN) / SIGMA
    np.testing.assert_allclose(drawn[:, 0], drawn[:, 2], rtol=0, atol=1e-9)
    assert np.ptp(drawn[:, 1]) == 0.0


def test_the_attitude_is_the_guess_turned_by_the_rotation_vector(tmp_path):
    vector, sigma = np.array([0.3, -0.2, 0.1]), np.array([1e-3, 2e-3, 3e-3])
    fit = load_fitted(written(tmp_path / 'fitted.json', ATTITUDE, vector, np.diag(sigma ** 2)))
    drawn = fit.draw(1, np.arange(2000))
    rows = np.stack([drawn[f'initial_attitude.{axis}'] for axis in 'xyzw'], axis=1)
    vectors = so3.log(so3.multiply(so3.conjugate(GUESS), rows))
    assert np.all(np.abs(vectors.mean(0) - vector) < 4 * sigma / np.sqrt(2000))
    assert np.all(np.abs(vectors.std(0) - sigma) < 4 * sigma / np.sqrt(4000))
    nominal = [fit.nominal[f'initial_attitude.{axis}'] for axis in 'xyzw']
    assert so3.angle_between(nominal, so3.multiply(GUESS, so3.exp(vector))) < 1e-15


def test_an_impossible_body_is_a_row_with_its_reason(tmp_path):
    names, moments = ('inertia.ixx', 'inertia.iyy', 'inertia.izz'), [0.02, 0.03, 0.045]
    fit = load_fitted(written(tmp_path / 'fitted.json', names, moments, np.eye(3) * 0.01 ** 2))
    scene = Scene.from_values({'inertia.ixx': 1, 'inertia.iyy': 1, 'inertia.izz': 1,
                               'initial_angular_velocity.x': 1.0})
    rows = Ensemble(scene.problem(), 10 ** 9, (), 1, fit).rows(0, 50)
    failed = rows['message'][rows['status'] == 'failed']
    assert 5 < len(failed) < 45
    assert all(message.startswith('inertia: ') for message in failed)


@pytest.mark.parametrize(('change', 'message'), [
    ({'estimates': {}}, 'expected a JSON file of attitude_identify, found another'),
    ({'estimates': dict.fromkeys(NAMES, 1.0)}, 'of attitude_identify, found another'),
    ({'estimates': {name: {'value': 0.02} for name in NAMES}}, "found one without 'unit'"),
    ({'estimates': {name: {'unit': 'g m^2', 'value': 1.0} for name in NAMES}},
     "inertia.ixx: expected the unit 'kg m^2', found 'g m^2'"),
    ({'covariance': {'names': NAMES}}, "found one without 'matrix'"),
    ({'guess_attitude_xyzw': [0, 0, 0, 0]}, 'of attitude_identify, found another'),
    ({'converged': False}, 'expected a fit that converged'),
    ({'verdict': {'level': 3}}, 'found one that is 3 (attitude_ensemble --force takes it)'),
    ({'verdict': {'level': 'rejected'}}, 'is rejected (attitude_ensemble --force takes it)'),
    ({'names': ('torque_bais.x', *NAMES[1:])}, 'did you mean torque_bias.x?'),
    ({'names': ('initial_attitude.x', *NAMES[1:])}, 'initial_attitude: expected three components'),
    ({'names': ('mount.x', 'mount.y', 'mount.z', 'clock_offset')}, 'found none'),
    ({'values': [np.inf, 1, 1, 1]}, 'inertia.ixx: expected a finite value, found inf'),
    ({'names': (NAMES[0], *ATTITUDE), 'values': [3.0, 0, 0, 0]}, 'inertia: not physical'),
    ({'matrix': COVARIANCE[:3]}, 'of attitude_identify, found another'),
    ({'matrix': np.where(np.eye(4)[:1].T, np.nan, COVARIANCE)},
     'inertia.ixx: expected an estimate that the recording determines'),
    ({'matrix': -COVARIANCE}, 'expected a positive semidefinite matrix'),
    ({'matrix': np.triu(COVARIANCE)}, 'expected a symmetric matrix'),
    ({'matrix': [[0, 1e-14, 0, 0], [1e-14, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]},
     'with the eigenvalue -1'),
    ({'matrix': COVARIANCE + np.diag([np.inf, 0, 0, 0])}, 'expected finite numbers'),
])
def test_a_file_that_is_no_fit_is_one_line(tmp_path, refusal, change, message):
    path = written(tmp_path / 'fitted.json', **change)
    line = refusal('attitude_ensemble', '--scene', CONFIG / 'tumbler.yaml', '--vary', path,
                   '--runs', 3, '--until', 1, '-o', tmp_path / 'out')
    assert line.startswith(f'attitude_ensemble: error: {path}: ')
    assert message in line
    assert not (tmp_path / 'out').exists()


@pytest.mark.parametrize('text', ['{', '[' * 100_000, '[1]', '9' * 5000,
                                  '{"estimates": {"x": 1, "x": 2}}', '\udcff'])
def test_a_file_that_is_not_json_is_one_line(tmp_path, text):
    path = tmp_path / 'fitted.json'
    path.write_bytes(text.encode('utf-8', 'surrogateescape'))
    with pytest.raises(ValueError, match=r'fitted\.json: expected (a )?JSON'):
        load_fitted(path)


@pytest.fixture(scope='module')
def fit(tmp_path_factory):
    """Run the first command; return the folder with its recording, its guess and its outputs."""
    folder, truth = tmp_path_factory.mktemp('fit'), measurements.truth()
    measurements.write_scene(folder / 'guess.yaml', replace(truth, inertia=0.03 * np.eye(3)))
    sensor = truth.measured(2e-3, 5e-3, clock=0.01)
    measurements.write(folder / 'in.mcap', torque=torque_messages(truth),
                       imu=messages_of('Imu', sensor))
    assert main.attitude_identify([
        str(folder / 'in.mcap'), '--scene', str(folder / 'guess.yaml'), '--estimate',
        'inertia,start,torque_bias,clock_offset', '-o', str(folder / 'fitted.yaml'), '--json',
        str(folder / 'fitted.json')]) == 0
    return folder


def ensemble(folder, scene, out):
    return main.attitude_ensemble([
        '--scene', str(folder / scene), '--vary', str(folder / 'fitted.json'), '--recording',
        str(folder / 'in.mcap'), '--runs', '200', '--seed', '4', '-o', str(out)])


@pytest.fixture(scope='module')
def spread(fit, tmp_path_factory):
    """Run the second command; return its folder."""
    out = tmp_path_factory.mktemp('spread') / 'out'
    assert ensemble(fit, 'fitted.yaml', out) == 0
    return out


@pytest.mark.slow
def test_from_a_bag_to_a_spread_in_two_commands(fit, spread):
    table = parquet.read_table(spread / 'runs.parquet')
    assert set(table['status'].to_pylist()) == {'ok'}
    data = json.loads((fit / 'fitted.json').read_text())
    assert {name: table.schema.field(name).metadata[b'unit'].decode() for name in (
        'inertia.ixy', 'torque_bias.x')} == {'inertia.ixy': 'kg m^2', 'torque_bias.x': 'N m'}
    for name, one in data['estimates'].items():
        if name in table.column_names and name not in ATTITUDE:
            numbers = table[name].to_numpy() - one['value']
            assert abs(numbers.mean()) < 4 * one['sigma'] / np.sqrt(200), name
            assert abs(numbers.std() - one['sigma']) < 4 * one['sigma'] / np.sqrt(400), name


@pytest.mark.slow
def test_the_true_motion_ends_within_the_spread(spread):
    table, truth = parquet.read_table(spread / 'runs.parquet'), measurements.truth()
    ends = np.stack([table[f'attitude.{axis}'].to_numpy() for axis in 'xyzw'], axis=1)
    # The truth of an independent solver, whose last state is later.
    row = np.flatnonzero(truth.stamps_ns == truth.torque_times[-1]).item()
    errors = so3.log(so3.multiply(so3.conjugate(truth.attitude.as_quat()[row]), ends))
    distance = errors.mean(0) @ np.linalg.solve(np.cov(errors.T), errors.mean(0))
    assert 0.0 < distance < 16.3  # 99.9 % of chi-square with three degrees of freedom
    assert np.sqrt(np.trace(np.cov(errors.T))) < 0.01


@pytest.mark.slow
def test_the_runs_are_centred_on_the_fit_whatever_the_scene_says(fit, spread, tmp_path, capsys):
    assert ensemble(fit, 'guess.yaml', tmp_path / 'guess') == 0
    assert 'clock_offset: no effect on the motion' in capsys.readouterr().err
    assert (tmp_path / 'guess' / 'runs.parquet').read_bytes() \
        == (spread / 'runs.parquet').read_bytes()


@pytest.mark.slow
def test_another_covariance_is_refused_and_gives_another_spread(fit, spread, tmp_path, capsys):
    # If the estimates were independent, the spread would be larger.
    data = json.loads((fit / 'fitted.json').read_text())
    matrix = np.array(data['covariance']['matrix'])
    data['covariance']['matrix'] = np.diag(np.diag(matrix)).tolist()
    for name in ('in.mcap', 'fitted.yaml'):
        (tmp_path / name).write_bytes((fit / name).read_bytes())
    (tmp_path / 'fitted.json').write_text(json.dumps(data))
    assert ensemble(tmp_path, 'fitted.yaml', spread) == 2
    assert 'expected the covariance of its runs' in capsys.readouterr().err
    assert ensemble(tmp_path, 'fitted.yaml', tmp_path / 'out') == 0
    medians = [json.loads((folder / 'summary.json').read_text())['angle_from_nominal_rad']['p50']
               for folder in (spread, tmp_path / 'out')]
    assert medians[1] > 5 * medians[0]
