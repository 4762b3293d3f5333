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

"""attitude_tradeoff --ensemble: the error of the setting is small compared with the spread."""

import json
import math

from conftest import CONFIG, RECORDINGS
import numpy as np
from pyarrow import parquet
import pytest
from rigid_body_ros import RigidBody, State, TorqueLog
from rigid_body_ros.commands import main
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation import Problem
from rigid_body_ros.tradeoff import ensemble, measure
from rigid_body_ros.tradeoff.choices import Advice, Spread
from rigid_body_ros.tradeoff.ensemble import read

SCENE = CONFIG / 'tumbler.yaml'
LOGS = (TorqueLog([0, 5 * 10 ** 8], [[0.1, 0.0, 0.2], [0.0, 0.1, 0.0]]),
        TorqueLog([3 * 10 ** 8], [[0.1, -0.1, 0.0]]))
TORQUES = ('--recording', str(RECORDINGS / 'tumbler.mcap'))


@pytest.fixture(autouse=True)
def _short_runs(monkeypatch):
    monkeypatch.setattr('rigid_body_ros.tradeoff.trade._MOST_STEPS', 5_000)
    monkeypatch.setattr('rigid_body_ros.tradeoff.trade._MOST_REPEATS', 3)


def run(folder, scene, *arguments):
    assert main.attitude_ensemble(['--scene', str(scene), '--vary', str(folder / 'vary.yaml'),
                                  '--runs', '40', *arguments]) == 0


@pytest.fixture(scope='module')
def spread(tmp_path_factory):
    """Return a folder with an ensemble of free motions, and an ensemble under torques."""
    folder = tmp_path_factory.mktemp('spread')
    (folder / 'vary.yaml').write_text('initial_attitude: {tilt: 1.0e-4}\n'
                                      'inertia: {relative: 1.0e-4}\n')
    run(folder, SCENE, *TORQUES, '-o', str(folder / 'torques'))
    run(folder, SCENE, '--until', '3', '-o', str(folder / 'free'))
    return folder


def tradeoff(*arguments):
    return main.attitude_tradeoff(['--scene', str(SCENE), *map(str, arguments)])


def ends(folder):
    table = parquet.read_table(folder / 'runs.parquet')
    return np.stack([table[f'attitude.{axis}'].to_numpy() for axis in 'xyzw'], axis=1)


@pytest.mark.slow
def test_the_runs_end_there_within_a_tenth_of_their_spread_with_the_setting(spread, tmp_path,
                                                                            capsys):
    assert tradeoff(*TORQUES, '--ensemble', spread / 'torques', '--json', tmp_path / 'o.json',
                    '--report', tmp_path / 'o.html') == 0
    printed, data = capsys.readouterr().out, json.loads((tmp_path / 'o.json').read_text())
    angles = parquet.read_table(spread / 'torques' / 'runs.parquet')['angle_from_nominal']
    advice, median = data['ensemble'], np.sort(angles.to_numpy())[19]
    assert (advice['runs'], advice['median_angle_rad']) == (40, median)
    assert advice['target_rad'] == data['target_rad'] == 0.1 * median
    saved = 40 * (advice['run_default_s'] - advice['run_s'])
    assert advice['saved_s'] == pytest.approx(max(saved, 0.0))
    line = f'40 runs end {median:.3g} rad from the nominal run (median); '
    assert f'\nensemble          {line}the target is a tenth of this: {0.1 * median:.3g} rad\n' \
        in printed
    assert line in (tmp_path / 'o.html').read_text(encoding='utf-8')
    scene = tmp_path / 'scene.yaml'
    given = ('solver', 'tolerance', 'max_step')
    kept = [text for text in SCENE.read_text().splitlines() if not text.strip().startswith(given)]
    scene.write_text('\n'.join([*kept, *(
        f'    {text}' for text in data['recommended']['parameters']), '']))
    run(spread, scene, *TORQUES, '-o', str(tmp_path / 'loose'))
    errors = so3.angle_between(ends(tmp_path / 'loose'), ends(spread / 'torques'))
    assert 0.0 < errors.max() < 0.1 * median


@pytest.mark.slow
def test_the_measured_motion_ends_where_the_runs_do(spread, tmp_path):
    assert tradeoff('--ensemble', spread / 'free', '--target', '1e-6', '--json',
                    tmp_path / 'o.json') == 0
    data = json.loads((tmp_path / 'o.json').read_text())
    assert data['whole_s'] == 3.0
    assert [each['target_rad'] for each in data['targets']] \
        == [1e-6, data['ensemble']['target_rad']]


def test_the_recommended_setting_is_the_cheapest_for_many_runs(monkeypatch):
    spread = Spread(10, 1e-5, 0, 20 * 10 ** 9, '')
    problem = Problem(RigidBody.from_moments(1.0, 2.0, 2.5), State(angular_velocity=(0.1, 1, 0.2)))
    single = measure(problem, targets=[spread.target, 1e-3], end_ns=spread.end_ns)
    for solver in ('taylor', 'rk4'):
        monkeypatch.setattr(ensemble, '_seconds_per_run', lambda _, settings, solver=solver: [
            1e-9 if one.solver == solver else 1.0 for one in settings])
        result = ensemble.advise(single, spread)
        choice, others = result.choices[spread.target], [
            one for one in single.measurements if one.setting.solver == solver
            and one.error.attitude + single.reference.guaranteed_error <= spread.target]
        assert choice.measurement == min(others, key=lambda one: one.seconds)
        assert choice.error <= spread.target
        assert result.choices[1e-3] == single.choices[1e-3]
        assert result.ensemble == Advice(spread, 1e-9, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(('logs', 'momentum'), [((), (0.1, 0.0, 0.3)), ((), (0.0, 0.0, 0.0)),
                                                (LOGS, (0.0, 0.0, 0.0))],
                         ids=['rotors', 'free', 'two logs'])
def test_any_motion_of_an_ensemble_has_a_setting(logs, momentum):
    spread = Spread(10, 1e-5, 0, 10 ** 9, '')
    start = State(angular_velocity=(0.1, 1, 0.2), rotor_momentum=momentum)
    problem = Problem(RigidBody.from_moments(1.0, 2.0, 2.5), start, logs)
    single = measure(problem, targets=[spread.target], end_ns=spread.end_ns)
    result = ensemble.advise(single, spread)
    assert result.choices[spread.target].error <= spread.target
    assert result.ensemble.default_seconds > 0.0
    assert result.ensemble.seconds > 0.0


def test_a_setting_that_is_not_faster_saves_nothing():
    spread = Spread(10, 1e-3, 0, 1, '')
    assert Advice(spread, 2.0, 1.0).saved_seconds == 0.0
    assert Advice(spread, None, 1.0).saved_seconds == 0.0
    assert Advice(spread, 1.0, 3.0).saved_seconds == 20.0
    assert spread.target == 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(('more', 'message'), [
    (['--ensemble', 'missing'], 'missing/summary.json: cannot read the summary of the ensemble'),
    (['--ensemble', 'free', *TORQUES], 'free: expected an ensemble under the torques of '),
    (['--ensemble', 'torques'], 'torques: expected an ensemble without torques, found another'),
    (['--ensemble', 'free', '--until', '2'], '--until: expected the end of the runs of '),
    (['--ensemble', 'free', '--json', 'free/summary.json', '--overwrite'],
     'free/summary.json: would be written into the folder of the ensemble '),
], ids=['missing', 'free', 'torques', 'until', 'overwrite'])
def test_another_ensemble_is_one_line(spread, capsys, monkeypatch, more, message):
    monkeypatch.chdir(spread)
    before = (spread / 'free' / 'summary.json').read_bytes()
    assert tradeoff(*more) == 2
    line, = capsys.readouterr().err.splitlines()
    assert line.startswith('attitude_tradeoff: error: ')
    assert message in line
    assert (spread / 'free' / 'summary.json').read_bytes() == before


@pytest.mark.parametrize(('change', 'message'), [
    ({'angle_from_nominal_rad': {}}, 'p50: expected an angle greater than 0, found None'),
    ({'angle_from_nominal_rad': {'p50': math.inf}}, 'expected an angle greater than 0, found inf'),
    ({'runs': None}, 'expected the summary of an ensemble, found another file'),
    ({'start_ns': 7}, None)])
def test_a_summary_without_a_spread_is_rejected(spread, tmp_path, change, message, capsys):
    data = json.loads((spread / 'free' / 'summary.json').read_text())
    (tmp_path / 'summary.json').write_text(json.dumps({**data, **change}))
    if message:
        with pytest.raises(ValueError, match=message):
            read(tmp_path)
    else:
        assert tradeoff('--ensemble', tmp_path) == 2
        assert 'expected an ensemble that starts at 0 ns, found 7 ns' in capsys.readouterr().err
