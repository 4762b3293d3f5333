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
Draw docs/page.png: the page that attitude_replay writes of the flip of a wing nut.

    python docs/picture.py

It needs Chromium and Playwright, which is in the extra `test`.
"""

from pathlib import Path
import sys
from tempfile import TemporaryDirectory

from playwright.sync_api import sync_playwright
from rigid_body_ros import cli

HERE = Path(__file__).resolve().parent
RECORDING = HERE.parent / 'test' / 'recordings' / 'torque_free_intermediate_axis'
#: The part of the page, px, and the time, s.
SIZE, TIME = {'width': 900, 'height': 1225}, 8.6


def main() -> int:
    """Write the page, draw it, and return the exit status."""
    with TemporaryDirectory() as folder:
        page = Path(folder) / 'page.html'
        status = cli.attitude_replay([f'{RECORDING}.mcap', '--scene', f'{RECORDING}.yaml',
                                      '--rate', '20', '--until', '34', '--report', str(page)])
        if not status:
            draw(page)
    return status


def draw(page: Path) -> None:
    """Draw the upper part of a page."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path='/usr/bin/chromium',
                                             args=['--no-sandbox'])
        shown = browser.new_page(viewport=SIZE)
        shown.goto(page.as_uri())
        shown.evaluate(f'motion.set({TIME})')
        shown.screenshot(path=HERE / 'page.png')


if __name__ == '__main__':
    sys.exit(main())
