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

"""What a command reports: facts, tables, panels with curves, and a moving body."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
import math
from typing import Any, TYPE_CHECKING

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.report.charts import Panel

if TYPE_CHECKING:
    from rigid_body_ros.scene import Scene

#: Facts, each with a name and a text. If the name is empty, the text continues the previous fact.
Rows = Sequence[tuple[str, object]]
#: The width of a cell of a matrix, and the width of a character in a name, px.
_CELL, _CHARACTER = 30, 6.6
#: Maximum number of rows of a matrix. If there are more parameters than this, only the first
#: parameters are shown.
_MOST = 40
#: A cell shows the correlation as a number if the magnitude of the correlation is at least this
#: large.
_NUMBERED = 0.1


@dataclass(frozen=True)
class Report:
    """
    A result, as a page or a picture shows it.

    Attributes
    ----------
    title : str
        What the report is about.
    headline : str
        The result in one sentence, without a full stop. It may begin with a lower-case letter.
    story : sequence of (str, object)
        The facts, each with a name and a text. If the name is empty, the text continues the
        previous fact.
    panels : sequence of Panel
        The charts.
    body : dict, optional
        The motion to animate, as returned by `moving_body.as_data`.
    warnings, scene, command
        The warnings about the scene, the scene, and the command line. `Outputs.write_asked` adds
        them.
    copied : sequence of str
        Texts to show with a button that copies them.
    table : str
        The table, as HTML returned by the function `table`; empty if there is no table.
    matrix : str
        HTML of a correlation matrix to show below the charts, as returned by the function
        `matrix`; empty if there is none.

    """

    title: str
    headline: str
    story: Rows
    panels: Sequence[Panel] = ()
    body: Mapping[str, Any] | None = None
    warnings: Sequence[str] = ()
    copied: Sequence[str] = ()
    table: str = ''
    matrix: str = ''
    scene: Scene | None = None
    command: str = ''


class Markup(str):
    """A string that contains HTML. `table` treats all other strings as plain text."""


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return the HTML of a table. Each cell is plain text or `Markup`."""
    head, *body = (''.join(f'<{tag}>{_cell(cell)}</{tag}>' for cell in row)
                   for tag, row in [('th', header), *(('td', row) for row in rows)])
    lines = ''.join(f'<tr>{row}</tr>' for row in body)
    return f'<div class="wide-table"><table><thead><tr>{head}</tr></thead><tbody>{lines}</tbody>' \
           '</table></div>'


def _cell(cell: str) -> str:
    return cell if isinstance(cell, Markup) else shown(cell)


def shown(text: str) -> str:
    """Escape a text for HTML, and write the unit of inertia as kg m²."""
    return escape(text).replace('kg m^2', 'kg m²')


def matrix(title: str, names: Sequence[str], values: Floats) -> str:
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
        is_known, is_own = math.isfinite(value), row == column
        text = f'{value:.3f}' if is_known else 'unknown'
        sign = 'negative' if value < 0.0 else 'positive'
        yield f'<g><title>{escape(names[row])} and {escape(name)}: {text}</title>' \
              f'<rect class="{sign}" x="{left}" y="{top}" width="{_CELL}" height="{_CELL}" ' \
              f'fill-opacity="{abs(value) if is_known and not is_own else 0.0:.2f}"/>'
        if not is_known or (abs(value) >= _NUMBERED and not is_own):
            shown = f'{value:.2f}'.replace('0.', '.').replace('-', '−') if is_known else '?'
            yield f'<text x="{left + _CELL / 2}" y="{top + _CELL / 2 + 4}" ' \
                  f'text-anchor="middle">{shown}</text>'
        yield '</g>'
