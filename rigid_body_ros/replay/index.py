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

"""Make a page for several replayed recordings: a table with a small picture of each."""

from __future__ import annotations

from collections.abc import Sequence
import os

from rigid_body_ros.replay.batches import Batch
from rigid_body_ros.replay.many import Outcome
from rigid_body_ros.report.page import Markup, Page, table
from rigid_body_ros.report.thinning import Extremes
from rigid_body_ros.scene import Scene

#: The width and height of a picture, in SVG units, and the largest number of intervals in a curve.
_WIDTH, _HEIGHT, _INTERVALS = 200.0, 40.0, 128


class Picture:
    """The angular velocity of a motion, thinned while the motion is computed."""

    def __init__(self) -> None:
        self._rates = Extremes(3, _INTERVALS)

    def add(self, batch: Batch) -> None:
        """Add a part of the motion."""
        motion = batch.trajectory
        if motion.times_ns.size:
            self._rates.add(motion.times_ns, motion.angular_velocity)

    def svg(self) -> str:
        """Draw the three components of the angular velocity as curves in SVG."""
        times, low, high = self._rates.result()
        if not len(times):
            return ''
        x = _WIDTH * (times - times[0]) / max(int(times[-1] - times[0]), 1)
        span = float(high.max() - low.min()) or 1.0
        paths = []
        for k in range(3):
            tops, bottoms = (_HEIGHT * (high.max() - part[:, k]) / span for part in (high, low))
            points = ' '.join(f'{at:.1f},{top:.1f} {at:.1f},{bottom:.1f}'
                              for at, top, bottom in zip(x, tops, bottoms))
            paths.append(f'<polyline class="c{k}" points="{points}"/>')
        return f'<svg class="picture" viewBox="-1 -1 {_WIDTH + 2:g} {_HEIGHT + 2:g}" role="img" ' \
               f'aria-label="angular velocity over time">{"".join(paths)}</svg>'


def page(outcomes: Sequence[Outcome], scene: Scene, command: str) -> Page:
    """
    Return a page that lists several recordings.

    Parameters
    ----------
    outcomes : sequence of Outcome
        The outcomes of the recordings, which must have been replayed with `collect=Picture`.
    scene : Scene
        The scene that all recordings share.
    command : str
        The command line.

    """
    failed = sum(bool(outcome.error) for outcome in outcomes)
    rows = [(os.path.basename(os.path.abspath(outcome.path)), _picture(outcome), _text(outcome))
            for outcome in outcomes]
    written = f'{len(outcomes) - failed} of {len(outcomes)} recordings replayed'
    return Page(f'{len(outcomes)} recordings', written, [(
        'pictures', 'angular velocity about the body axes x (blue), y (orange), z (green)')],
        warnings=scene.warnings, scene=scene, command=command,
        table=table(('recording', 'angular velocity', 'motion'), rows))


def _picture(outcome: Outcome) -> Markup:
    return Markup(outcome.collected.svg() if isinstance(outcome.collected, Picture) else '')


def _text(outcome: Outcome) -> str:
    """Return what the terminal shows for an outcome, with file names instead of paths."""
    text = outcome.summary or f'failed: {outcome.error}'
    for path in (outcome.output, outcome.path):
        text = text.replace(path, os.path.basename(os.path.abspath(path)))
    return text
