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

"""Tables in Markdown, and pages that contain what a benchmark prints."""

from pathlib import Path


def row(*cells):
    """Return a row of a table."""
    return '| ' + ' | '.join(cells) + ' |'


def header(*cells):
    """Return the first two rows of a table."""
    return [row(*cells), '|' + '---|' * len(cells)]


def marks(script):
    """Return the lines of a page that begin and end what a script prints."""
    name = f'printed by benchmarks/{Path(script).name} -->'
    return f'<!-- what follows is {name}', f'<!-- end of what is {name}'


def write_into(page, script, text):
    """Write what a script prints into a page, between its marks."""
    begin, end = marks(script)
    old = page.read_text()
    page.write_text(
        f'{old.split(begin)[0]}{begin}\n\n{text.strip()}\n\n{end}{old.split(end)[1]}')
