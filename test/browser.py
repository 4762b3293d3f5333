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

"""Pages in a headless Chromium that cannot reach any host."""

from contextlib import contextmanager
import shutil

import pytest

CHROMIUM = shutil.which('chromium')


@contextmanager
def started():
    """Yield the browser; skip the test if the browser or its driver is not installed."""
    driver = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
    if not CHROMIUM:
        pytest.skip('Chromium is not installed')
    with driver.sync_playwright() as playwright:
        yield playwright.chromium.launch(executable_path=CHROMIUM, args=[
            '--no-sandbox', '--host-resolver-rules=MAP * ~NOTFOUND'])


@contextmanager
def opened(browser, path, width=1280, **options):
    """Open a file and yield the page; fail on any request, error or message of the page."""
    page = browser.new_page(viewport={'width': width, 'height': 900}, **options)
    problems, requests = [], []
    page.on('console', lambda message: problems.append(message.text))
    page.on('pageerror', lambda error: problems.append(str(error)))
    page.on('dialog', lambda dialog: (problems.append(dialog.message), dialog.dismiss()))
    page.on('request', lambda request: requests.append(request.url))
    page.goto(path.as_uri())
    page.wait_for_selector('body[data-ready]')
    yield page
    page.close()
    assert problems == []
    assert requests == [path.as_uri()]
