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

"""Figures: what is drawn where."""

from conftest import EPOCH_NS
import numpy as np
import pytest
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from rigid_body_ros.report import figures


@pytest.fixture
def panels(tmp_path, monkeypatch):
    """Return what draws a motion and returns the panels of the figure."""
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


@pytest.mark.parametrize('start_ns', [0, EPOCH_NS])
@pytest.mark.parametrize('count', [11, 30_000])
def test_times_are_drawn_to_the_nanosecond_at_any_epoch(panels, start_ns, count):
    # As floats, times of this century in nanoseconds are 256 ns apart.
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
    if count == 11:  # both sides of each change
        drawn = np.round(seconds * 1e9).astype(int)
        assert set(drawn.tolist()) >= {0, *range(99, 1000, 100), *range(100, 1001, 100)}
        np.testing.assert_array_equal(panel.lines[0].get_ydata(), drawn // 100 % 2)
