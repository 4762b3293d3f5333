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
import hashlib
from html import escape
import json
from pathlib import Path
import platform
from string import Template

from rigid_body_ros.report.report import Report, Rows, shown
from rigid_body_ros.runtime import files
from rigid_body_ros.runtime.fingerprint import fingerprint

_WEB = Path(__file__).with_name('web')
#: Characters in a JSON text that could end the script, or end a line of the script.
_UNSAFE = {ord(char): f'\\u{ord(char):04x}' for char in '<>&\u2028\u2029'}
#: A longer parameter, such as a URDF, is cut off after this many characters.
_LONGEST = 200


def write(path: str | Path, report: Report) -> None:
    """
    Write a report to an HTML file.

    Raises
    ------
    InputError
        The file cannot be written.

    """
    with files.atomic_output(path, '.html') as temporary:
        temporary.write_text(html(report), encoding='utf-8', errors='replace')


def html(report: Report) -> str:
    """Return the HTML of a report."""
    style, charts, body = (
        ''.join(f'\n{(_WEB / name).read_text(encoding="utf-8")}' for name in names)
        for names in (['page.css'], ['tools.js', 'charts.js'], ['body.js']))
    data = {'panels': [panel.as_data() for panel in report.panels], 'body': report.body}
    headline = report.headline[:1].upper() + report.headline[1:]
    return Template((_WEB / 'page.html').read_text(encoding='utf-8')).substitute(
        title=escape(report.title), headline=shown(headline),
        layout='moving' if report.body else 'charted' if report.panels else 'listed',
        style=style, style_hash=_hash(style),
        script_hashes=' '.join(map(_hash, (charts, body))), charts=charts, body=body,
        warnings=''.join(f'<p class="warning">{shown(text)}</p>' for text in report.warnings),
        story=_facts(report.story), table=report.table, picture=report.matrix,
        copied=''.join(f'<pre>{escape(text)}</pre><button class="copy" type="button">Copy</button>'
                       for text in report.copied),
        made=_facts(_origin(report)), data=embedded(data))


def embedded(data: object) -> str:
    """Return data as JSON that is safe to embed in HTML and in scripts."""
    return json.dumps(data, allow_nan=False).translate(_UNSAFE)


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _facts(rows: Rows) -> str:
    return ''.join(f'<dt>{escape(name)}</dt><dd>{shown(str(text))}</dd>' for name, text in rows)


def _origin(report: Report) -> Rows:
    rows = [('command', report.command)] if report.command else []
    if report.scene:
        parameters = report.scene.parameters
        rows.append(('scene', ', '.join(
            f'{name}: {_cut(value)}' for name, value in report.scene.values.items()
            if value != parameters[name].default)))
    versions = {'Python': platform.python_version(), **fingerprint()}
    return [*rows, ('versions', ', '.join(f'{name} {text}' for name, text in versions.items()))]


def _cut(value: object) -> str:
    text = str(value)
    return text if len(text) <= _LONGEST else f'{text[:_LONGEST]} ...'
