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
Compare motions that a program computed with the truth.

    python check.py RESULTS [--within RADIANS]

RESULTS is a folder with a file NAME.csv for each motion of the folder `motions`. Each line of it
has a time of the motion in ns, the attitude x, y, z, w (body to space), and the angular velocity
in body axes, rad/s. A motion without a file is left out. The exit status is 1 if an attitude
differs from the truth by more than --within. NumPy is all that this file needs.
"""

import argparse
import json
from pathlib import Path
import sys

import numpy as np

MOTIONS = Path(__file__).resolve().parent / 'motions'
TRUTH = 'truth_t_ns_attitude_xyzw_angular_velocity'


def errors(motion, rows):
    """Return the largest angle to the true attitude, rad, and the relative error of the rates."""
    angle = rate = 0.0
    by_time = {int(row[0]): row[1:] for row in rows}
    for time_ns, attitude, rates in motion[TRUTH]:
        if time_ns not in by_time:
            raise ValueError(f'expected a line with the time {time_ns} ns, found none')
        found, true = by_time[time_ns], np.array(attitude, float)
        q = found[:4] / np.linalg.norm(found[:4])
        chord = min(np.linalg.norm(q - true), np.linalg.norm(q + true))
        angle = max(angle, 4.0 * np.arcsin(min(0.5 * chord, 1.0)))
        true = np.array(rates, float)
        rate = max(rate, np.linalg.norm(found[4:] - true) / np.linalg.norm(true))
    return angle, rate


def main():
    """Print a line for each motion; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('results', type=Path)
    parser.add_argument('--within', type=float, default=np.inf, help='largest error, rad')
    arguments, failed = parser.parse_args(), 0
    print('| motion | attitude, rad | rates, relative | a last digit of the inputs, rad |')
    print('|---|---|---|---|')
    for path in sorted(MOTIONS.glob('*.json')):
        result = arguments.results / f'{path.stem}.csv'
        if not result.exists():
            print(f'| {path.stem} | - | - | - |')
            continue
        motion = json.loads(path.read_text())
        try:
            rows = np.loadtxt(result, delimiter=',', ndmin=2)
            angle, rate = errors(motion, rows)
        except ValueError as error:
            print(f'{result}: {error}', file=sys.stderr)
            return 2
        failed += not angle <= arguments.within
        print(f'| {path.stem} | {angle:.1e} | {rate:.1e} | {motion["rounding"]:.1e} |')
    return 1 if failed else 0


if __name__ == '__main__':
    sys.exit(main())
