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

"""Pictures show the right data, labels and units."""

from dataclasses import replace

from conftest import at_night, EPOCH_NS
from matplotlib.colors import same_color
from matplotlib.figure import Figure
from matplotlib.text import Text
import numpy as np
import pytest
from rigid_body_ros import TorqueLog
from rigid_body_ros.report import picture
from rigid_body_ros.report.charts import Curves, Panel, SIGNED
from rigid_body_ros.report.panels import torque_panels
from rigid_body_ros.report.report import Report


@pytest.fixture
def drawn(tmp_path, monkeypatch):
    """Return a function that draws panels, and returns the figure."""
    figures = []
    monkeypatch.setattr(picture, 'Figure', lambda *arguments, **options: figures.append(
        figure := Figure(*arguments, **options)) or figure)

    def draw(*panels, title='title'):
        picture.draw(tmp_path / 'p.png', Report(title, '', [], panels))
        return figures[-1]
    return draw


def curves(values, names=SIGNED, **options):
    """Return curves of values, shape (n, k), over 0, 1, 2 ... s."""
    values = np.asarray(values, float)
    return Curves(np.arange(len(values), dtype=float), values, values, names, **options)


@pytest.mark.slow
@pytest.mark.parametrize('start_ns', [EPOCH_NS, *at_night(0)])
@pytest.mark.parametrize('count', [11, 30_000])
def test_times_are_drawn_to_the_nanosecond_at_any_epoch(drawn, start_ns, count):
    # Adjacent doubles are 256 ns apart for times of this century in nanoseconds.
    stamps = start_ns + 100 * np.arange(count)
    log = TorqueLog(stamps, np.outer(np.arange(count) % 2, [1.0, 2.0, 3.0]))
    axes, = drawn(*torque_panels([log], start_ns, int(stamps[-1]))).axes
    line = axes.lines[0]
    seconds, torques = line.get_data()
    # A thinned series has the first time of each interval, here of 4 samples.
    times = 100e-9 * np.arange(0, count, 1 if count == 11 else 4)
    np.testing.assert_allclose(np.unique(seconds), times, rtol=1e-14)
    np.testing.assert_allclose(axes.get_xlim(), times[[0, -1]], rtol=1e-14)
    assert (torques.min(), torques.max()) == (0.0, 1.0)  # thinning keeps the extremes
    if count == 11:
        assert line.get_drawstyle() == 'steps-post'
        np.testing.assert_array_equal(torques, np.arange(11) % 2)


def inside(figure):
    """Return whether all texts of a drawn figure lie inside the picture."""
    figure.canvas.draw()
    edges = figure.bbox
    axes = [axis for panel in figure.axes for axis in (panel.xaxis, panel.yaxis)]
    ticks = {label for axis in axes for label in axis.get_ticklabels(which='both')}
    boxes = [text.get_window_extent() for text in figure.findobj(Text)
             if text not in ticks and text.get_visible() and text.get_text()]
    renderer = figure.canvas.get_renderer()
    boxes += [box for axis in axes  # visible ticks
              if (box := axis.get_tightbbox(renderer)) is not None]
    return all(edges.x0 <= box.x0 and box.x1 <= edges.x1 and edges.y0 <= box.y0
               and box.y1 <= edges.y1 for box in boxes)


@pytest.mark.parametrize('scale', [1e-7, *at_night(1.0, 1e-3, 1e5)])
def test_small_numbers_have_a_unit_with_a_prefix(drawn, scale):
    values = scale * np.outer(np.arange(11) % 3 - 1, [0.2, 0.5, -0.3])
    axes, = drawn(Panel('torque', 'N m', [curves(values)])).axes
    unit = {1e-7: 'nN m', 1e-3: 'µN m', 1.0: 'mN m', 1e5: 'N m'}[scale]
    assert axes.get_ylabel() == f'({unit})'
    axes.figure.canvas.draw()
    shown = [float(label.get_text().replace('−', '-')) for label in axes.get_yticklabels()]
    factor = {'nN m': 1e-9, 'µN m': 1e-6, 'mN m': 1e-3, 'N m': 1.0}[unit]
    np.testing.assert_allclose(np.array(shown) * factor, axes.get_yticks(), rtol=1e-6,
                               atol=1e-9 * factor)


@pytest.mark.slow
@pytest.mark.parametrize('count', [1, 7])
def test_titles_of_any_length_stay_inside_the_picture(drawn, count):
    panel = Panel(90 * 'e', 'rad', [curves(np.eye(3), names=['W' * 20] * 3)])
    figure = drawn(*count * [panel], title=250 * 'W' + '.mcap: /a/topic')
    assert inside(figure)
    assert [axes.axison for axes in figure.axes] == count * [True] + (count % 2) * (
        [False] if count == 7 else [])


def test_the_labels_of_a_trade_stay_inside_the_picture(drawn):
    lines = {'rounding floor 2e-16 rad': 2e-16, 'last-digit effect 3e-16 rad': 3e-16,
             'target 1e-06 rad': 1e-6, 'target 0.1 rad': 0.1,
             'linear interpolation 3e+00 rad': 3.0}
    errors, names = np.array([1e-9, 1e-16, 3.0]), ('auto', 'rk4', 'explicit_euler')
    costs = np.array([[1e-7], [1e-3], [1e-9]])
    figure = drawn(Panel('wall time', 's/s', [Curves(errors, costs, costs, [name])
                                              for name in names], 'error', 'loglog', lines,
                         [['']] * 3))
    assert inside(figure)
    axes, = figure.axes
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [*names, *lines]
    assert len({line.get_color() for line in axes.lines[:3]}) == 3
    # Which powers of ten are labelled depends on the version of Matplotlib.
    assert any(text.get_text().startswith('$\\mathdefault{10^{-')
               for text in axes.get_xticklabels() if text.get_parse_math())


def test_outliers_lie_at_the_edge_and_limits_are_dashed(drawn):
    marks = Curves(np.array([1.0]), np.full((1, 3), 50.0), np.full((1, 3), 50.0), [''] * 3,
                   style='marks')
    band = curves([[2.0], [2.0], [2.0]], ['limit'], style='limits')
    axes, = drawn(Panel('errors', 'rad', [marks, curves(np.eye(3)), replace(
        band, low=-band.high)])).axes
    *errors, lower, upper = axes.lines[:5]
    assert [line.get_linestyle() for line in (lower, upper)] == ['--', '--']
    assert (lower.get_ydata()[0], upper.get_ydata()[0]) == (-2.0, 2.0)
    top = axes.get_ylim()[1]
    assert 2.0 < top < 3.0
    assert [line.get_ydata()[0] for line in axes.lines[5:]] == [top] * 3
    assert all(same_color(line.get_color(), mark.get_color())
               for line, mark in zip(errors, axes.lines[5:]))


def test_curves_have_gaps_where_samples_are_missing_and_angles_jump(drawn):
    line = Curves(np.array([0.0, 1.0, 9.0, 10.0]), np.zeros((4, 1)), np.zeros((4, 1)), ['a'],
                  gap=5.0)
    angle = curves([[6.2], [0.1], [0.2]], ['b'])
    first, second = drawn(Panel('a', '', [line]), Panel('b', 'rad', [angle], kind='angle')).axes
    np.testing.assert_array_equal(first.lines[0].get_xdata(), [0.0, 1.0, np.nan, 9.0, 10.0])
    np.testing.assert_array_equal(second.lines[0].get_ydata(), [6.2, np.nan, 0.1, 0.2])
    assert second.get_yticklabels()[-1].get_text() == '2π'


def test_both_extremes_of_an_interval_are_drawn(drawn):
    thick = Curves(np.arange(3.0), np.array([[0.0], [-1.0], [0.5]]),
                   np.array([[1.0], [2.0], [0.5]]), ['a'])
    axes, = drawn(Panel('a', '', [thick])).axes
    np.testing.assert_array_equal(axes.lines[0].get_xydata(), [
        [0, 0], [0, 1], [1, -1], [1, 2], [2, 0.5], [2, 0.5]])
