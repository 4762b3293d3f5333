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
Measure attitude_ensemble: runs per second with one worker and with two, and the peak memory.

    python benchmarks/ensemble.py [--runs 20000] [--free 200000] [--pairs 5]

The scene is the CubeSat of the demo over a minute: under its recording (3001 torques), and without
torque. One worker and two alternate, each in a new process. The ratio is the median over the
pairs. The time is that of the whole command with its files, minus that of ten runs, which is
mostly the start of Python. The load average is printed, because other processes slow workers down.
"""

import argparse
import os
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from processes import measure, RECORDING, SCENE

VARY = """inertia: {relative: 0.05}
initial_attitude: {tilt: 0.02}
initial_angular_velocity.y: {uniform: [0.5, 0.7]}
"""
GAIN = 'torque_gain: {normal: 0.03}\n'


def measured(motion, vary, runs, workers):
    """Return the rate, 1/s, and the peak memory, bytes, of runs of a motion."""
    with TemporaryDirectory() as folder:
        file = Path(folder, 'vary.yaml')
        file.write_text(vary)
        (least, _), (seconds, memory) = (
            measure('attitude_ensemble', '--scene', SCENE, '--vary', file, *motion, '--workers',
                    workers, '--runs', count, '-o', Path(folder, f'{count}'))
            for count in (10, runs))
    return runs / (seconds - least), memory


def compare(name, motion, vary, runs, pairs):
    """Measure one worker and two alternately, and print their rates."""
    found = np.array([[measured(motion, vary, runs, workers) for workers in (1, 2)]
                      for _ in range(pairs)])
    rates = found[:, :, 0]
    one, two = np.median(rates, axis=0)
    ratio, peak = np.median(rates[:, 1] / rates[:, 0]), found[:, :, 1].max()
    print(f'{name:10}{runs:8}{one:10.0f} / s{two:10.0f} / s{ratio:7.2f}{peak / 1e6:7.0f} MB'
          f'{os.getloadavg()[0]:6.1f}', flush=True)


def main():
    """Measure in pairs, and print a line for each motion."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--runs', type=int, default=20_000, help='runs under the recording')
    parser.add_argument('--free', type=int, default=200_000, help='runs without torque')
    parser.add_argument('--pairs', type=int, default=5)
    options = parser.parse_args()
    print(f'{"":10}{"runs":>8}{"1 worker":>14}{"2 workers":>14}{"ratio":>7}{"memory":>10}'
          f'{"load":>6}')
    compare('recording', ['--recording', RECORDING], VARY + GAIN, options.runs, options.pairs)
    compare('no torque', ['--until', 60], VARY, options.free, options.pairs)


if __name__ == '__main__':
    main()
