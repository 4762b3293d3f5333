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
Assemble a page: a single HTML file that needs no network, no ROS and no installation.

All text from recordings and scenes is escaped. In addition, the page has a content security policy
that blocks network requests and allows only the scripts and styles of this package. The policy
identifies them by their hashes.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import hashlib
from html import escape
import json
from pathlib import Path
import platform
from string import Template
from typing import Any

from rigid_body_ros.report.charts import Panel
from rigid_body_ros.runtime import files
from rigid_body_ros.runtime.fingerprint import fingerprint
from rigid_body_ros.scene import Scene

_WEB = Path(__file__).with_name('web')
#: Characters in a JSON text that could end the script, or end a line of the script.
_UNSAFE = {ord(char): f'\\u{ord(char):04x}' for char in '<>&\u2028\u2029'}
#: A longer parameter, such as a URDF, is cut off after this many characters.
_LONGEST = 200

#: Facts, each with a name and a text. If the name is empty, the text continues the previous fact.
Rows = Sequence[tuple[str, object]]


@dataclass(frozen=True)
class Page:
    """
    The contents of a page.

    Attributes
    ----------
    title : str
        What the page is about.
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
    picture : str
        HTML of a picture to show below the charts; empty if there is no picture.

    """

    title: str
    headline: str
    story: Rows
    panels: Sequence[Panel] = ()
    body: Mapping[str, Any] | None = None
    warnings: Sequence[str] = ()
    copied: Sequence[str] = ()
    table: str = ''
    picture: str = ''
    scene: Scene | None = field(default=None, kw_only=True)
    command: str = field(default='', kw_only=True)


class Markup(str):
    """A string that contains HTML. `table` treats all other strings as plain text."""


def write(path: str | Path, page: Page) -> None:
    """
    Write a page to an HTML file.

    Raises
    ------
    InputError
        The file cannot be written.

    """
    with files.atomic_output(path, '.html') as temporary:
        temporary.write_text(html(page), encoding='utf-8', errors='replace')


def html(page: Page) -> str:
    """Return the HTML of a page."""
    style, charts, body = (
        ''.join(f'\n{(_WEB / name).read_text(encoding="utf-8")}' for name in names)
        for names in (['page.css'], ['tools.js', 'charts.js'], ['body.js']))
    data = {'panels': [panel.as_data() for panel in page.panels], 'body': page.body}
    headline = page.headline[:1].upper() + page.headline[1:]
    return Template((_WEB / 'page.html').read_text(encoding='utf-8')).substitute(
        title=escape(page.title), headline=_shown(headline), layout=_layout(page),
        style=style, style_hash=_hash(style),
        script_hashes=' '.join(map(_hash, (charts, body))), charts=charts, body=body,
        warnings=''.join(f'<p class="warning">{_shown(text)}</p>' for text in page.warnings),
        story=_facts(page.story), table=page.table, picture=page.picture,
        copied=''.join(f'<pre>{escape(text)}</pre><button class="copy" type="button">Copy</button>'
                       for text in page.copied),
        made=_facts(_origin(page)), data=embedded(data))


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return the HTML of a table. Each cell is plain text or `Markup`."""
    head, *body = (''.join(f'<{tag}>{_cell(cell)}</{tag}>' for cell in row)
                   for tag, row in [('th', header), *(('td', row) for row in rows)])
    lines = ''.join(f'<tr>{row}</tr>' for row in body)
    return f'<div class="wide-table"><table><thead><tr>{head}</tr></thead><tbody>{lines}</tbody>' \
           '</table></div>'


def _cell(cell: str) -> str:
    return cell if isinstance(cell, Markup) else _shown(cell)


def _shown(text: str) -> str:
    """Escape a text for HTML, and write the unit of inertia as kg m²."""
    return escape(text).replace('kg m^2', 'kg m²')


def _layout(page: Page) -> str:
    """Return the name of the page's layout: with a moving body, with charts, or with neither."""
    return 'moving' if page.body else 'charted' if page.panels else 'listed'


def embedded(data: object) -> str:
    """Return data as JSON that is safe to embed in HTML and in scripts."""
    return json.dumps(data, allow_nan=False).translate(_UNSAFE)


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _facts(rows: Rows) -> str:
    return ''.join(f'<dt>{escape(name)}</dt><dd>{_shown(str(text))}</dd>' for name, text in rows)


def _origin(page: Page) -> Rows:
    rows = [('command', page.command)] if page.command else []
    if page.scene:
        parameters = page.scene.parameters
        given = {name: value for name, value in page.scene.values.items()
                 if value != parameters[name].default}
        rows.append(('scene', ', '.join(f'{name}: {_cut(value)}' for name, value
                                        in given.items())))
    versions = {'Python': platform.python_version(), **fingerprint()}
    return [*rows, ('versions', ', '.join(f'{name} {text}' for name, text in versions.items()))]


def _cut(value: object) -> str:
    text = str(value)
    return text if len(text) <= _LONGEST else f'{text[:_LONGEST]} ...'
