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


"""Draw a matrix of correlations as an SVG picture for a page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
import math

from rigid_body_ros.common.arrays import Floats

#: The width of a cell, and the width of a character in a name, px.
_CELL, _CHARACTER = 30, 6.6
#: Maximum number of rows. If there are more parameters than this, only the first parameters are
#: shown.
_MOST = 40
#: A cell shows the correlation as a number if the magnitude of the correlation is at least this
#: large.
_NUMBERED = 0.1


def picture(title: str, names: Sequence[str], values: Floats) -> str:
    """
    Return HTML with a heading and a picture of a correlation matrix.

    Parameters
    ----------
    title : str
        The heading.
    names : sequence of str
        The names of the n rows and columns.
    values : array, shape (n, n)
        The correlations, from -1 to 1, or NaN where a correlation is unknown.

    """
    shown = names[:_MOST]
    more = f'; the first {_MOST} of {len(names)}' if len(names) > _MOST else ''
    margin = round(_CHARACTER * max(map(len, shown))) + 10
    size = margin + _CELL * len(shown) + 1
    cells = ''.join(part for i, name in enumerate(shown) for part in (
        _label(name, i, margin), *_row(shown, values, i, margin)))
    return f'<section class="panel"><h3>{escape(title + more)}</h3><div class="wide-table">' \
           f'<svg class="matrix" viewBox="0 0 {size} {size}" width="{size}" height="{size}" ' \
           f'role="img" aria-label="{escape(title)}">{cells}</svg></div></section>'


def _label(name: str, row: int, margin: int) -> str:
    middle = margin + _CELL * (row + 0.5) + 4
    return f'<text x="{margin - 6}" y="{middle}" text-anchor="end">{escape(name)}</text>' \
           f'<text transform="translate({middle} {margin - 6}) rotate(-90)">{escape(name)}</text>'


def _row(names: Sequence[str], values: Floats, row: int, margin: int) -> Iterator[str]:
    top = margin + _CELL * row
    for column, name in enumerate(names):
        value, left = float(values[row, column]), margin + _CELL * column
        known, is_own = math.isfinite(value), row == column
        text = f'{value:.3f}' if known else 'unknown'
        sign = 'negative' if value < 0.0 else 'positive'
        yield f'<g><title>{escape(names[row])} and {escape(name)}: {text}</title>' \
              f'<rect class="{sign}" x="{left}" y="{top}" width="{_CELL}" height="{_CELL}" ' \
              f'fill-opacity="{abs(value) if known and not is_own else 0.0:.2f}"/>'
        if not known or (abs(value) >= _NUMBERED and not is_own):
            shown = f'{value:.2f}'.replace('0.', '.').replace('-', '−') if known else '?'
            yield f'<text x="{left + _CELL / 2}" y="{top + _CELL / 2 + 4}" ' \
                  f'text-anchor="middle">{shown}</text>'
        yield '</g>'
