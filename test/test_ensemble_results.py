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

"""The figure of an ensemble shows the right numbers."""

import json
import re
import subprocess
import sys

from matplotlib.figure import Figure
import matplotlib.image
import numpy as np
from pyarrow import parquet
import pytest
from rigid_body_ros import propagate, scene
from rigid_body_ros.commands import main
from rigid_body_ros.ensemble import report, summary
from rigid_body_ros.ensemble.summary import histogram, percentiles
from rigid_body_ros.mechanics import so3
from rigid_body_ros.report import picture
from rigid_body_ros.report.page import html
from rigid_body_ros.report.report import Report
from test_ensemble import SCENE
import zarr

VARY = """inertia.izz: {normal: 0.014}
initial_attitude: {tilt: 0.02}
initial_angular_velocity.y: {normal: 0.01}
"""
PERCENTILES = (1, 5, 25, 50, 75, 95, 99, 100)


@pytest.fixture
def drawn(monkeypatch):
    """Return a list that collects the figures that are drawn."""
    figures = []
    monkeypatch.setattr(picture, 'Figure', lambda *arguments, **options: figures.append(
        figure := Figure(*arguments, **options)) or figure)
    return figures


@pytest.fixture
def arguments(tmp_path):
    (tmp_path / 'scene.yaml').write_text(SCENE)
    (tmp_path / 'vary.yaml').write_text(VARY)
    return ['--scene', str(tmp_path / 'scene.yaml'), '--vary', str(tmp_path / 'vary.yaml'),
            '--until', '5', '--runs', '400', '-o', str(tmp_path / 'out')]


def results_of(angles, **more):
    """Return the results for some angles, in the form of summary.json."""
    known = angles[np.isfinite(angles)]
    found = dict(zip((f'p{k}' for k in PERCENTILES), percentiles(known, PERCENTILES).tolist()))
    return {'runs': len(angles), 'failed': len(angles) - len(known),
            'angle_from_nominal_rad': found, 'histogram': histogram(known, found),
            'rank_correlation': {}, **more}


def heights(panel):
    """Return the heights and the edges of a histogram."""
    values, edges, _ = panel.patches[0].get_data()
    return values, edges


def draw(folder, found):
    """Draw the picture of some results."""
    picture.draw(folder / 'b.png', Report('title', '', [], [*report.panels_of(found)]))


@pytest.mark.slow
def test_the_picture_of_an_ensemble_has_its_numbers(arguments, drawn, tmp_path):
    assert main.attitude_ensemble(arguments) == 0
    assert matplotlib.image.imread(tmp_path / 'out' / 'bands.png').shape[1] == 1080
    angles = parquet.read_table(tmp_path / 'out' / 'runs.parquet')['angle_from_nominal']
    angles = angles.drop_null().to_numpy()
    found = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    figure, = drawn
    assert figure.get_suptitle() == 'scene.yaml: 400 runs'
    assert len(angles) < 400
    panel, = figure.axes
    values, edges = heights(panel)
    np.testing.assert_array_equal(values, np.histogram(angles, edges)[0])
    assert (edges[0], edges[-1], values.sum()) == (0.0, angles.max(), len(angles))
    assert {line.get_label(): line.get_xdata()[0] for line in panel.lines} == {
        name: np.percentile(angles, k, method='inverted_cdf')
        for name, k in (('5 %', 5), ('median', 50), ('95 %', 95))}
    assert found['histogram'] == {'edges_rad': edges.tolist(), 'runs': values.tolist()}


@pytest.mark.slow
@pytest.mark.parametrize('kept', [0, 2 ** 24], ids=['passes', 'in memory'])
def test_the_bands_are_the_percentiles_of_the_motions(arguments, drawn, tmp_path, monkeypatch,
                                                      kept):
    monkeypatch.setattr(summary, '_KEPT', kept)
    monkeypatch.setattr(summary, '_TIMES', 9)
    assert main.attitude_ensemble([*arguments, '--times', '3.3']) == 0
    ensemble = zarr.open_group(tmp_path / 'out' / 'motion.zarr', mode='r')
    rows = [0, 2, 4, 6, 8, 10, 12, 14, 17]
    loaded = scene.load(tmp_path / 'scene.yaml')
    times = ensemble['time'][:][rows]
    nominal = propagate(loaded.body, loaded.start, at=loaded.start.time_ns + np.round(
        times * 1e9).astype(np.int64))
    motions = ensemble['motion'][:, rows, :4]
    angles = so3.angle_between(motions[np.isfinite(motions[:, 0, 0])], nominal.attitude)
    expected = np.percentile(angles, [5, 25, 50, 75, 95], axis=0, method='inverted_cdf')
    found = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert found['bands']['times_s'] == times.tolist()
    for k, values in zip((5, 25, 50, 75, 95), expected):
        np.testing.assert_array_equal(found['bands'][f'p{k}_rad'], values)
    final = found['angle_from_nominal_rad']
    assert [final[f'p{k}'] for k in (5, 50, 95)] == expected[[0, 2, 4], -1].tolist()
    panel = drawn[0].axes[0]
    assert panel.lines[0].get_xydata().tolist() == np.column_stack([times, expected[2]]).tolist()
    for area, (low, high) in zip(panel.collections, ((0, 4), (1, 3))):
        corners = area.get_paths()[0].vertices
        for row in (low, high):
            assert {*zip(times, expected[row])} <= {*map(tuple, corners)}


@pytest.mark.slow
def test_angles_that_span_decades_have_a_logarithmic_axis(drawn, tmp_path):
    angles = np.exp(np.random.default_rng(1).normal(-9.0, 2.0, 10_000))
    angles[[3, 77]] = 0.0, np.nan
    found = results_of(angles)
    draw(tmp_path, found)
    panel, = drawn[0].axes
    values, edges = heights(panel)
    assert panel.get_xscale() == 'log'
    np.testing.assert_allclose(np.diff(np.log(edges)), np.log(edges[1] / edges[0]), rtol=1e-9)
    assert edges[0] == 0.1 * found['angle_from_nominal_rad']['p1'] > np.nanmin(angles)
    assert (edges[-1], values.sum()) == (np.nanmax(angles), 9999)
    assert values[0] == np.count_nonzero(angles < edges[1])


@pytest.mark.slow
@pytest.mark.parametrize('angles', [[0.0], [0.3, 0.3], [5e-324] * 200])
def test_angles_without_a_spread_are_counted(drawn, tmp_path, angles):
    draw(tmp_path, results_of(np.array(angles)))
    values, edges = heights(drawn[0].axes[0])
    assert (values.sum(), *np.sort(edges)) == (len(angles), *edges)


@pytest.mark.parametrize('kind', ['linear', 'logx'])
def test_the_page_has_the_histogram_and_the_correlations(kind):
    found = results_of(np.linspace(0.0, 1.0, 900) ** (9 if kind == 'logx' else 1), failures={
        '<b>': 7}, rank_correlation={'a': 0.5, 'b': -0.75})
    made = report.report_of(found, 'name', str)
    panel, = made.panels
    curves, = panel.curves
    assert panel.kind == kind
    assert panel.lines == {name: found['angle_from_nominal_rad'][key] for key, name in (
        ('p5', '5 %'), ('p50', 'median'), ('p95', '95 %'))}
    assert curves.x.tolist() == found['histogram']['edges_rad']
    assert curves.high[:-1, 0].tolist() == found['histogram']['runs']
    text = html(made)
    assert re.findall(r'<tr><td>(\w+)</td>', text) == ['b', 'a']
    assert re.findall(r'<rect class="bar [^"]*" width="([\d.]+)"', text) == ['75.0', '50.0']
    assert '7: &lt;b&gt;' in text
    assert re.search(r'<h1>Half of 900 runs end within 0\.', text)


@pytest.mark.slow
def test_no_picture_if_all_runs_failed(arguments, tmp_path, capsys):
    (tmp_path / 'vary.yaml').write_text('inertia.izz: {uniform: [-2.0, -1.0]}\n')
    assert main.attitude_ensemble(arguments) == 2
    assert not (tmp_path / 'out' / 'bands.png').exists()
    printed = capsys.readouterr()
    assert 'failed           400: inertia' in printed.out
    assert printed.err == (f'attitude_ensemble: error: {tmp_path / "out"}: expected runs that can '
                           'be computed, found that all 400 failed\n')
    assert len(parquet.read_table(tmp_path / 'out' / 'runs.parquet')) == 400
    found = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert found['histogram'] == found['angle_from_nominal_rad'] == {}


@pytest.mark.slow
def test_no_picture_without_matplotlib(arguments, tmp_path):
    script = ("import sys; sys.modules['matplotlib'] = None; "
              'from rigid_body_ros.commands import main; sys.exit(main.attitude_ensemble())')
    result = subprocess.run([sys.executable, '-c', script, *arguments], capture_output=True,
                            text=True, check=False)
    assert result.returncode == 0
    assert result.stderr == (f'attitude_ensemble: note: {tmp_path / "out" / "bands.png"}: not '
                             "drawn: Python module 'matplotlib' is not installed\n")
    assert not (tmp_path / 'out' / 'bands.png').exists()
    assert json.loads((tmp_path / 'out' / 'summary.json').read_text())['histogram']
