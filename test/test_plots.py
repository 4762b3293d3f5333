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

"""Figures show the right data, labels and units."""

from conftest import at_night, EPOCH_NS, SECOND
from matplotlib.figure import Figure
from matplotlib.text import Text
import numpy as np
import pytest
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from rigid_body_ros.report import figures, spread


@pytest.fixture
def panels(tmp_path, monkeypatch):
    """Return a function that draws a motion and returns the panels of the figure."""
    drawn = []

    class Kept(figures.Figure):

        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            drawn.append(self)

    monkeypatch.setattr(figures, 'Figure', Kept)

    def draw(trajectory, log):
        figures.motion(tmp_path / 'motion.png', trajectory, log, 'ZXZ', 'title')
        return drawn[-1].axes
    return draw


@pytest.mark.slow
@pytest.mark.parametrize('start_ns', [EPOCH_NS, *at_night(0)])
@pytest.mark.parametrize('count', [11, 30_000])
def test_times_are_drawn_to_the_nanosecond_at_any_epoch(panels, start_ns, count):
    # Adjacent doubles are 256 ns apart for times of this century in nanoseconds.
    stamps = start_ns + 100 * np.arange(count)
    log = TorqueLog(stamps, np.outer(np.arange(count) % 2, [1.0, 2.0, 3.0]))
    motion = propagate(RigidBody(np.eye(3)), State(start_ns), log, at=stamps)
    span = 100e-9 * (count - 1)
    for panel in panels(motion, log):
        seconds = panel.lines[0].get_xdata()
        assert seconds[0] == 0.0
        np.testing.assert_allclose([seconds[-1], panel.get_xlim()[1]], span, rtol=1e-14)
        assert np.all(np.diff(seconds) > 0.0)
        assert np.diff(seconds).max() <= max(100.5e-9, 1.1 * span / 5000)
    if count == 11:  # points on both sides of each change
        drawn = np.round(seconds * 1e9).astype(int)
        assert set(drawn.tolist()) >= {0, *range(99, 1000, 100), *range(100, 1001, 100)}
        np.testing.assert_array_equal(panel.lines[0].get_ydata(), drawn // 100 % 2)


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


@pytest.mark.slow
@pytest.mark.parametrize('scale', [1e-7, *at_night(1.0, 1e-3, 1e5)])
def test_small_numbers_have_a_unit_with_a_prefix(panels, scale):
    stamps = np.arange(11) * 10 ** 9
    log = TorqueLog(stamps, scale * np.outer(np.arange(11) % 3 - 1, [0.2, 0.5, -0.3]))
    motion = propagate(RigidBody(scale * np.eye(3)), State(0), log, at=stamps)
    torque = panels(motion, log)[-1]
    unit = {1e-7: 'nN m', 1e-3: 'µN m', 1.0: 'mN m', 1e5: 'N m'}[scale]
    assert torque.get_ylabel() == f'torque,\nbody axes ({unit})'
    torque.figure.canvas.draw()
    shown = [float(label.get_text().replace('−', '-')) for label in torque.get_yticklabels()]
    factor = {'nN m': 1e-9, 'µN m': 1e-6, 'mN m': 1e-3, 'N m': 1.0}[unit]
    np.testing.assert_allclose(np.array(shown) * factor, torque.get_yticks(), rtol=1e-6,
                               atol=1e-9 * factor)
    assert inside(torque.figure)


@pytest.mark.slow
def test_a_title_of_any_length_stays_inside_the_picture(panels, monkeypatch):
    stamps = np.arange(11) * 10 ** 9
    motion = propagate(RigidBody(np.eye(3)), State(0), at=stamps)
    draw = figures.motion
    monkeypatch.setattr(figures, 'motion', lambda path, trajectory, log, sequence, _: draw(
        path, trajectory, log, sequence, 250 * 'W' + '.mcap: /a/topic'))
    assert inside(panels(motion, TorqueLog(stamps, np.zeros((11, 3))))[0].figure)


@pytest.mark.slow
def test_the_labels_of_a_trade_stay_inside_the_picture(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(figures, 'Figure', lambda *arguments, **options: drawn.append(
        figure := Figure(*arguments, **options)) or figure)
    names = ('exact', 'auto', 'taylor', 'rk4', 'strang', 'explicit_euler')
    curves = {name: ([10.0 ** -number, 1e-16, 3.0], [1e-7, 10.0 ** -number, 1e-9])
              for number, name in enumerate(names)}
    lines = {'rounding floor 2e-16 rad': 2e-16, 'last-digit effect 3e-16 rad': 3e-16,
             'target 1e-06 rad': 1e-6, 'target 0.1 rad': 0.1,
             'linear interpolation 3e+00 rad': 3.0}
    figures.work_precision(tmp_path / 'p.png', curves, 250 * 'W', lines)
    assert inside(drawn[0])
    texts = [text.get_text() for text in drawn[0].axes[0].get_legend().get_texts()]
    assert texts[-5:] == [*lines]


@pytest.mark.slow
def test_any_name_is_drawn_as_it_is_and_powers_of_ten_as_formulas(tmp_path, monkeypatch):
    drawn, name = [], '$\\frac{$ \x1b[2J\n机器😀 العربية'
    for module in (figures, spread):
        monkeypatch.setattr(module, 'Figure', lambda *arguments, **options: drawn.append(
            figure := Figure(*arguments, **options)) or figure)
    times = np.arange(5) * SECOND
    panel = figures.Series(name, 'rad', times, np.geomspace(1e-6, 1.0, 15).reshape(5, 3))
    figures.errors(tmp_path / 'a.png', [panel], [panel], [], {}, name)
    figures.work_precision(tmp_path / 'b.png', {name: ([1e-9], [1e-3])}, name, {name: 1e-6})
    found = {'runs': 2, 'failed': 0, 'histogram': {'edges_rad': [0.0, 1.0], 'runs': [2]},
             'angle_from_nominal_rad': dict.fromkeys(('p5', 'p50', 'p95'), 0.5)}
    spread.draw(tmp_path / 'c.png', found, [(name, 0.5)], name)
    assert all(figure.texts[0].get_text().startswith('$\\frac{$ \\x1b[2J\\n机器😀')
               for figure in drawn)
    assert '$\\mathdefault{10^{-6}}$' in [
        text.get_text() for text in drawn[0].axes[0].get_yticklabels() if text.get_parse_math()]
