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
Charts of a page: panels with curves, as data for charts.js.

Our own script draws them; docs/report.md says why no library does.
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

#: A gap between samples, in usual intervals.
_GAP = 10.0


@dataclass(frozen=True, eq=False)
class Curves:
    """
    Curves that share their abscissas.

    Attributes
    ----------
    x : array, shape (n,)
    low, high : array, shape (n, k)
        Smallest and largest values from an abscissa to the next; equal for single samples.
    names : sequence of str
        Of the k curves.
    step : bool
        Whether a value holds to the next abscissa.
    style : str
        'line', 'broad' (what the lines of other curves are compared with), 'front' (a broad line
        behind the points that stand out), 'band' (filled from the smallest value to the largest;
        with steps, the bars of a histogram), 'marks' (single values, which do not widen the range
        of the ordinate) or 'limits' (the smallest and the largest value as two dashed lines).
        Broad curves, marks and limits have the colours of the first lines.
    gap : float, optional
        Neighbours that are further apart are not joined.

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
        """Return the curves of any number of samples over the seconds from the start."""
        extremes = Extremes(values.shape[1])
        extremes.add(times_ns, values)
        found = cls.of(extremes, names, start_ns, style=style)
        return replace(found, gap=_GAP * float(np.median(np.diff(found.x)))) \
            if len(found.x) > 1 else found

    @classmethod
    def of(cls, extremes: Extremes, names: Sequence[str], start_ns: int, step: bool = False,
           style: str = 'line') -> Curves:
        """Return the curves of a series that has been thinned."""
        times, low, high = extremes.result()
        seconds = np.asarray((times - start_ns) * 1e-9, np.float64)
        return cls(seconds, low, high, names, step, style)

    def times(self, factor: float) -> Curves:
        """Return the curves with values in another unit."""
        return replace(self, low=factor * self.low, high=factor * self.high)

    def as_data(self) -> dict[str, Any]:
        """Return data for the page; the values are 32-bit differences from an offset."""
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
        Of the ordinate; the unit is '' for numbers.
    curves : sequence of Curves
    x_label : str
        With its unit. Panels with the same label share range and cursor.
    kind : str
        'linear', 'angle' (jumps by a turn are not drawn), 'log', 'logx' or 'loglog'.
    lines : dict
        By description, abscissas to mark.
    texts : sequence of sequence of str
        For each curve, a description of each point, which is then drawn with a marker.

    """

    label: str
    unit: str
    curves: Sequence[Curves]
    x_label: str = 'time from the start (s)'
    kind: str = 'linear'
    lines: Mapping[str, float] = field(default_factory=dict)
    texts: Sequence[Sequence[str]] = ()

    def as_data(self) -> dict[str, Any]:
        """Return data for the page."""
        return {'label': self.label, 'unit': self.unit, 'xLabel': self.x_label,
                'kind': self.kind, 'lines': dict(self.lines), 'texts': [*map(list, self.texts)],
                'curves': [each.as_data() for each in self.curves]}


def _offsets(low: Floats, high: Floats) -> Floats:
    """Return the middle of each column whose values are close to each other, otherwise 0."""
    if not len(low):
        return np.zeros(low.shape[1])
    lowest, highest = low.min(axis=0), high.max(axis=0)
    middle = 0.5 * lowest + 0.5 * highest
    return np.asarray(np.where(highest - lowest < np.abs(middle), middle, 0.0), np.float64)


def packed(values: ArrayLike, kind: type = np.float64) -> str:
    """Return an array as little-endian bytes in base64, which the scripts turn into an array."""
    found = np.ascontiguousarray(values, np.dtype(kind).newbyteorder('<'))
    return base64.b64encode(found.tobytes()).decode()
