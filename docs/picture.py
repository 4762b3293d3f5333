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
Draw the pictures of the pages on reports, ensembles and fields.

    python docs/picture.py

docs/page.png shows the page that attitude_replay writes of the flip of a wing nut,
docs/ensemble.png the spread of many such flips, and docs/fields.png three scenes of config/. The
page needs Chromium and Playwright, which is in the extra `test`.
"""

from pathlib import Path
import shutil
import sys
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
from playwright.sync_api import sync_playwright
from rigid_body_ros import Problem, scene, so3
from rigid_body_ros.commands.main import attitude_ensemble, attitude_replay

HERE = Path(__file__).resolve().parent
CONFIG = HERE.parent / 'config'
RECORDING = HERE.parent / 'test' / 'recordings' / 'torque_free_intermediate_axis'
#: The part of the page, px, and the time, s.
SIZE, TIME = {'width': 1120, 'height': 1008}, 8.6
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
    return status or draw_ensemble() or draw_fields()


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


def draw_fields() -> int:
    """Draw the motions of the scenes with fields, and return the exit status."""
    with plt.rc_context({'font.size': 9, 'axes.grid': True, 'grid.alpha': 0.3,
                         'axes.spines.top': False, 'axes.spines.right': False}):
        figure, (gimbal, orbit, top) = plt.subplots(1, 3, figsize=(11, 3.4), layout='constrained')
        swing = scene.load(CONFIG / 'gimbal.yaml').problem()
        seconds = np.linspace(0.0, 20.0, 801)
        roll = so3.log(swing.propagate(at=np.round(seconds * 1e9).astype(int)).attitude)[:, 0]
        gimbal.plot(seconds, np.degrees(roll))
        gimbal.set(title='Drone in a gimbal', xlabel='time, s', ylabel='roll, degrees')
        _draw_orbit(orbit)
        spin = scene.load(CONFIG / 'top.yaml').problem()
        x, y, _ = _axis(spin, np.linspace(0.0, 1.2, 3001)).T
        top.plot(x, y)
        top.plot(x[0], y[0], 'o', color='C0')
        top.set(title='Axis of a heavy top, from above', xlabel='x, space axes',
                ylabel='y, space axes', aspect='equal')
        figure.savefig(HERE / 'fields.png', dpi=130)
    return 0


def _draw_orbit(axes: plt.Axes) -> None:
    satellite = scene.load(CONFIG / 'cubesat.yaml').problem()
    orbit = satellite.fields[-1]
    hours = np.linspace(0.0, 6.0, 721)
    up = orbit.directions(np.round(hours * 3600e9).astype(int))
    for name, fields in (('gravity gradient', [orbit]), ('and dipole', satellite.fields)):
        axis = _axis(satellite.replaced(fields=fields), hours * 3600.0)
        angle = np.degrees(np.arccos(np.clip(np.sum(axis * up, axis=1), -1.0, 1.0)))
        axes.plot(hours, angle, label=name)
    axes.set(title='CubeSat in orbit', xlabel='time, h',
             ylabel='long axis from the vertical, degrees', ylim=(0.0, 22.0))
    axes.legend(loc='upper center', ncols=2, frameon=False)


def _axis(problem: Problem, seconds: np.ndarray) -> np.ndarray:
    """Return the z axis of the body in space axes at times, s."""
    attitude = problem.propagate(at=np.round(seconds * 1e9).astype(int)).attitude
    return so3.rotate(attitude, np.tile([0.0, 0.0, 1.0], (len(seconds), 1)))


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
