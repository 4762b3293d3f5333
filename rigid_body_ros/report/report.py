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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

from rigid_body_ros.report.charts import Panel
from rigid_body_ros.scene import Scene

#: Facts, each with a name and a text. If the name is empty, the text continues the previous fact.
Rows = Sequence[tuple[str, object]]


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
    warnings : sequence of str
    copied : sequence of str
        Texts to show with a button that copies them.
    table : str
        The table, as HTML returned by the function `table`; empty if there is no table.
    matrix : str
        HTML of a correlation matrix to show below the charts; empty if there is none.

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
    scene: Scene | None = field(default=None, kw_only=True)
    command: str = field(default='', kw_only=True)


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
