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
Draw the pictures of the pages on reports and ensembles.

    python docs/picture.py

docs/page.png shows the page that attitude_replay writes of the flip of a wing nut, and
docs/ensemble.png the spread of many such flips. The page needs Chromium and Playwright, which is
in the extra `test`.
"""

from pathlib import Path
import shutil
import sys
from tempfile import TemporaryDirectory

from playwright.sync_api import sync_playwright
from rigid_body_ros.commands.main import attitude_ensemble, attitude_replay

HERE = Path(__file__).resolve().parent
RECORDING = HERE.parent / 'test' / 'recordings' / 'torque_free_intermediate_axis'
#: The part of the page, px, and the time, s.
SIZE, TIME = {'width': 900, 'height': 1225}, 8.6
#: The dispersions of the ensemble.
VARY = """inertia: {relative: 0.02}
initial_attitude: {tilt: 0.02}
initial_angular_velocity.x: {normal: 0.1, relative: true}
initial_angular_velocity.y: {normal: 0.002, relative: true}
"""


def main() -> int:
    """Draw the pictures, and return the exit status."""
    with TemporaryDirectory() as folder:
        page = Path(folder) / 'page.html'
        status = attitude_replay([f'{RECORDING}.mcap', '--scene', f'{RECORDING}.yaml',
                                  '--rate', '20', '--until', '34', '--report', str(page)])
        if not status:
            draw(page)
    return status or draw_ensemble()


def draw_ensemble() -> int:
    """Draw the spread of many flips, and return the exit status."""
    with TemporaryDirectory() as folder:
        vary, runs = Path(folder) / 'vary.yaml', Path(folder) / 'runs'
        vary.write_text(VARY)
        status = attitude_ensemble(['--scene', f'{RECORDING}.yaml', '--vary', str(vary), '--until',
                                    '34', '--times', '10', '--runs', '2000', '-o', str(runs)])
        if not status:
            shutil.copyfile(runs / 'bands.png', HERE / 'ensemble.png')
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
