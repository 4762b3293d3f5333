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

"""
Prepare the charts of a page: panels with curves, as data for the script charts.js.

The script, which is part of this package, draws the charts in the browser. docs/report.md explains
why it does not use a library.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.report.thinning import Extremes

#: The names of the components of quaternions, vectors and errors.
QUATERNION = ('x', 'y', 'z', 'w')
RATES, MOMENTA, TORQUES = ('ω₁', 'ω₂', 'ω₃'), ('h₁', 'h₂', 'h₃'), ('τ₁', 'τ₂', 'τ₃')
SIGNED = ('e₁', 'e₂', 'e₃')
#: The label for the torque that the fields apply. This torque depends on the attitude.
FIELDS = 'torque of the fields'
#: A curve has a gap wherever the time between two samples exceeds this multiple of the median time
#: between samples.
_GAP = 10.0


@dataclass(frozen=True, eq=False)
class Curves:
    """
    Curves with common x values.

    Attributes
    ----------
    x : array, shape (n,)
    low, high : array, shape (n, k)
        The smallest and the largest value between each x and the next. The two are equal where the
        interval contains only one sample.
    names : sequence of str
        The names of the k curves.
    step : bool
        Whether each value holds until the next x.
    style : str
        How to draw the curves. 'line' draws lines. 'broad' draws broad lines, for curves that
        other lines are compared with. 'front' draws a broad line behind the points that it
        connects. 'band' fills the area between `low` and `high` or, with `step`, draws the bars of
        a histogram. 'marks' draws single points, which do not extend the range of the y axis.
        'limits' draws `low` and `high` as two dashed lines. Broad lines, marks, limits and several
        bands in column k have the same colour as line k. A single limit is black, or white on a
        dark page.
    gap : float, optional
        Do not join neighbouring points whose x values differ by more than `gap`.

    """

    x: Floats
    low: Floats
    high: Floats
    names: Sequence[str]
    step: bool = False
    style: str = 'line'
    gap: float | None = None

    @classmethod
    def thinned(cls, times_ns: NDArray[np.int64], values: Floats, names: Sequence[str],
                start_ns: int, style: str = 'line') -> Curves:
        """Thin a series of any length, and return its curves over the time since `start_ns`, s."""
        extremes = Extremes(values.shape[1])
        extremes.add(times_ns, values)
        curves = cls.of(extremes, names, start_ns, style=style)
        return replace(curves, gap=_GAP * float(np.median(np.diff(curves.x)))) \
            if len(curves.x) > 1 else curves

    @classmethod
    def of(cls, extremes: Extremes, names: Sequence[str], start_ns: int, step: bool = False,
           style: str = 'line') -> Curves:
        """Return the curves of a series that has already been thinned."""
        times, low, high = extremes.result()
        seconds = np.asarray((times - start_ns) * 1e-9, np.float64)
        return cls(seconds, low, high, names, step, style)

    def times(self, factor: float) -> Curves:
        """Return a copy of the curves with all values multiplied by a factor."""
        return replace(self, low=factor * self.low, high=factor * self.high)

    def as_data(self) -> dict[str, Any]:
        """Return the curves as data for the page; values are 32-bit differences from an offset."""
        offsets = _offsets(self.low, self.high)
        single = np.array_equal(self.low, self.high)
        return {'x': packed(self.x), 'names': [*self.names], 'step': self.step,
                'style': self.style, 'gap': self.gap, 'offsets': offsets.tolist(),
                'low': packed((self.low - offsets).T, np.float32),
                'high': None if single else packed((self.high - offsets).T, np.float32)}


@dataclass(frozen=True, eq=False)
class Panel:
    """
    A panel of a chart.

    Attributes
    ----------
    label, unit : str
        The label and the unit of the y axis. The unit is empty for plain numbers.
    curves : sequence of Curves
    x_label : str
        The label of the x axis, including the unit. Panels with the same `x_label` are zoomed
        together and share a cursor.
    kind : str
        The kind of axes: 'linear', 'log', 'logx', 'loglog' or 'angle'. With 'angle', the y axis is
        linear, and jumps by a full turn are not drawn.
    lines : dict
        The x values to mark with vertical lines. The keys are shown next to the lines.
    texts : sequence of sequence of str
        A description of each point, for each curve. Points with a description have markers.

    """

    label: str
    unit: str
    curves: Sequence[Curves]
    x_label: str = 'time from the start (s)'
    kind: str = 'linear'
    lines: Mapping[str, float] = field(default_factory=dict)
    texts: Sequence[Sequence[str]] = ()

    def as_data(self) -> dict[str, Any]:
        """Return the panel as data for the page."""
        return {'label': self.label, 'unit': self.unit, 'xLabel': self.x_label,
                'kind': self.kind, 'lines': dict(self.lines), 'texts': [*map(list, self.texts)],
                'curves': [curves.as_data() for curves in self.curves]}


def _offsets(low: Floats, high: Floats) -> Floats:
    """Return the middle of each column's range, or 0 if the range is wider than |middle|."""
    if not len(low):
        return np.zeros(low.shape[1])
    lowest, highest = low.min(axis=0), high.max(axis=0)
    middle = 0.5 * lowest + 0.5 * highest
    return np.asarray(np.where(highest - lowest < np.abs(middle), middle, 0.0), np.float64)


def packed(values: ArrayLike, kind: type = np.float64) -> str:
    """Encode an array as little-endian bytes in base64, the format that the scripts decode."""
    numbers = np.ascontiguousarray(values, np.dtype(kind).newbyteorder('<'))
    return base64.b64encode(numbers.tobytes()).decode()
