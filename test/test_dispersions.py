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

"""Dispersions: valid files, statistics of the drawn numbers, and percentiles."""

from conftest import nearest_rank
import numpy as np
import pytest
from rigid_body_ros.ensemble import dispersions
from rigid_body_ros.ensemble.dispersions import Dispersion, draws, load
from rigid_body_ros.ensemble.summary import percentiles
from rigid_body_ros.scene import InputError
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


def test_the_axes_of_tilts_are_isotropic():
    tilts = draws(VARY[:1], 1, RUNS)['initial_attitude']
    axes = tilts / np.linalg.norm(tilts, axis=1, keepdims=True)
    # The components of isotropic unit vectors: mean 0, variance 1/3, fourth moment 1/5; products
    # of two: mean 0, variance 1/15.
    assert np.all(np.abs(axes.mean(0)) < 4 / np.sqrt(3 * RUNS.size))
    error = np.sqrt((1 / 5 - 1 / 9) / RUNS.size)
    assert np.all(np.abs((axes ** 2).mean(0) - 1 / 3) < 4 * error)
    products = (axes * np.roll(axes, 1, axis=1)).mean(0)
    assert np.all(np.abs(products) < 4 / np.sqrt(15 * RUNS.size))


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
    ('torque_gain: {normal: {a: 1}}', "expected a number greater than 0, found ['a group']"),
    ('torque_gain: {uniform: [-.inf, .inf]}', 'uniform: expected two ascending numbers, found'),
    ('torque_gain: {uniform: [-1e308, 1e308]}', 'uniform: expected two ascending numbers, found'),
    ('torque_gain: {normal: 1, relative: [true]}', 'expected true or false, found a list'),
    ('torque_gain: {normal: 1, normal: 2}', "normal or uniform, found ['normal', 'normal']"),
    ('? [torque_gain]\n: {normal: 1}', 'expected names as keys, found a list as a key in line 1'),
    ('torque_gain: {<<: {normal: 1}}', 'expected YAML without aliases (*name), anchors (&name) '
     'and merge keys (<<), which ROS parameter files do not have, found one in line 1'),
    ('inertia: {relative: 0.1}\ninertia.ixx: {normal: 1}', 'either inertia or its entries'),
])
def test_a_mistake_is_one_line(tmp_path, text, message):
    path = tmp_path / 'vary.yaml'
    path.write_text(text)
    with pytest.raises(InputError) as error:
        load(path)
    assert message in str(error.value)
    assert str(path) in str(error.value)
