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
Measure the page of a replay: its size, the time to write it, and the time until it can be used.

    python benchmarks/page.py [--seconds S ...] [--rounds N] [--folder DIR]

The recordings contain torques at 1 kHz. Each replay is a new process that writes only the page;
its time includes loading. The browser is already running when it opens a page. The time of opening
runs from the start of the navigation to the mark that the page sets when it is complete. The
script needs Chromium and Playwright, which is in the extra `test`. The table contains medians.
1 MB is 10^6 bytes.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from playwright.sync_api import sync_playwright
from replay import count, OURS, recorded, run, SCENE


def replayed(path, *options):
    """Return the time, s, and the peak memory, bytes, of a replay."""
    return run(*OURS, path, '--scene', SCENE, '--overwrite', *options)[:2]


def opened(browser, path):
    """Return the time, s, until a page can be used."""
    page = browser.new_page(viewport={'width': 1280, 'height': 900})
    page.goto(path.as_uri())
    page.wait_for_selector('body[data-ready]')
    seconds = 1e-3 * float(page.get_attribute('body', 'data-ready'))
    page.close()
    return seconds


def main():
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--seconds', type=float, nargs='+', default=[3.0, 60.0, 3600.0])
    parser.add_argument('--rounds', type=int, default=3)
    parser.add_argument('--folder', type=Path, help='where recordings and pages are kept')
    arguments = parser.parse_args()
    print('| samples | page, MB | replay, s | with page, s | memory, MB | opens in, s |')
    print('|---|---|---|---|---|---|')
    with TemporaryDirectory() as temporary, sync_playwright() as playwright:
        folder = arguments.folder or Path(temporary)
        browser = playwright.chromium.launch(executable_path='/usr/bin/chromium',
                                             args=['--no-sandbox'])
        for hours in np.array(arguments.seconds) / 3600.0:
            path, page = recorded(folder, hours), folder / 'page.html'
            replayed(path)  # loads its files into the cache for later runs
            rounds = [(*replayed(path)[:1], *replayed(path, '--report', page),
                       opened(browser, page)) for _ in range(arguments.rounds)]
            plain, with_page, memory, opens = np.median(rounds, axis=0)
            print(f'| {count(hours)} | {page.stat().st_size / 1e6:.1f} | {plain:.1f} | '
                  f'{with_page:.1f} | {memory / 1e6:.0f} | {opens:.1f} |', flush=True)


if __name__ == '__main__':
    main()
