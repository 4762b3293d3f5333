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
Measure runs of ensembles on one core: with rotors, several sources, and their own logs.

    python benchmarks/dispersed.py [--before FOLDER] [--rounds 3]

All runs are a minute long, with dispersed inertia and attitude. The time is the shortest processor
time of the rounds, without files. With --before, this checkout and another one alternate;
`git archive REVISION | tar -x -C FOLDER` creates one.
"""

import argparse
import json
import os
from pathlib import Path
import subprocess
import sys
import time

import numpy as np
from rigid_body_ros import TorqueLog
from rigid_body_ros.ensemble.dispersions import Dispersion
from rigid_body_ros.ensemble.runs import Ensemble
from rigid_body_ros.scene import Scene

ROOT = Path(__file__).resolve().parent.parent
SECOND = 10 ** 9
BODY = {'inertia.ixx': 0.045, 'inertia.iyy': 0.12, 'inertia.izz': 0.14,
        'initial_angular_velocity.y': 0.6}
ROTORS, DAMPING = {'initial_rotor_momentum.z': 0.003}, {'damping.dxx': 1e-4}
VARY = (Dispersion('inertia', 'relative', (0.05,)),
        Dispersion('initial_attitude', 'tilt', (0.02,)))
GAIN, MOMENTUM, BIAS, NOISE, OFFSET = (Dispersion(key, 'normal', (sigma,)) for key, sigma in (
    ('torque_gain', 0.03), ('initial_rotor_momentum.z', 1e-4), ('torque_bias.x', 1e-4),
    ('torque_noise', 1e-4), ('clock_offset', 0.01)))


def log(rate, size, phase=0.0):
    """Return a minute of torques with an amplitude, N m, at a rate, Hz."""
    times = np.arange(60 * rate) / rate
    return TorqueLog(np.rint(times * SECOND).astype(np.int64),
                     size * np.sin(times[:, None] * [2.0, 3.0, 5.0] + phase))


RATE = Dispersion('initial_angular_velocity.y', 'uniform', (0.1, 3.0))
HELD = TorqueLog([0], [[1e-3, 2e-3, -1e-3]])
SLOW, FAST, OTHER, WHEELS = log(50, 0.01), log(1000, 0.01), log(1000, 0.003, 1.0), log(1000, 0.001)
#: Number of measurements in a process.
REPEATS = 4
#: For each case: values of the scene, torques on the body, torque on the rotors, dispersions, and
#: number of runs.
CASES = {
    'plain, free': ({}, (), None, (), 4000),
    'held torque': ({}, (HELD,), None, (), 2000),
    'held torque, unlike rates': ({}, (HELD,), None, (RATE,), 800),
    'plain, 50 Hz': ({}, (SLOW,), None, (GAIN,), 800),
    'plain, 1 kHz': ({}, (FAST,), None, (), 80),
    'rotors, free': (ROTORS, (), None, (), 1000),
    'damping, free': (DAMPING, (), None, (), 1000),
    'rotors, 50 Hz': (ROTORS, (SLOW,), None, (GAIN,), 200),
    'damping, 50 Hz': (DAMPING, (SLOW,), None, (GAIN,), 200),
    'two sources, 1 kHz': ({}, (FAST, OTHER), None, (), 80),
    'two sources, 1 kHz, gain': ({}, (FAST, OTHER), None, (GAIN,), 80),
    'wheels and two sources, 1 kHz': (ROTORS, (FAST, OTHER), WHEELS, (), 40),
    'the same, dispersed momentum': (ROTORS, (FAST, OTHER), WHEELS, (MOMENTUM,), 40),
    'bias, 50 Hz': ({}, (SLOW,), None, (BIAS,), 400),
    'noise, 50 Hz': ({}, (SLOW,), None, (NOISE,), 400),
    'clock offset, 50 Hz': ({}, (SLOW,), None, (OFFSET,), 400),
    'bias, 1 kHz': ({}, (FAST,), None, (BIAS,), 40),
    'noise, 1 kHz': ({}, (FAST,), None, (NOISE,), 40),
}


def measured():
    """Return the processor time per run, us, of each case; the first runs load the kernels."""
    found = {}
    for name, (values, logs, wheels, vary, count) in CASES.items():
        problem = Scene.from_values({**BODY, **values}).problem().replaced(
            log=logs, wheels=wheels)
        ensemble = Ensemble(problem, 60 * SECOND, (*VARY, *vary), 1)
        ensemble.rows(0, 16)
        times = [time.process_time()]
        for _ in range(REPEATS):
            ensemble.rows(0, count)
            times.append(time.process_time())
        found[name] = 1e6 * min(np.diff(times)) / count
    return found


def once(folder):
    """Return the result of `measured` in a new process that imports from a folder."""
    done = subprocess.run([sys.executable, __file__, '--once'], check=True, stdout=subprocess.PIPE,
                          env={**os.environ, 'PYTHONPATH': str(folder)}, cwd=folder)
    return json.loads(done.stdout)


def main():
    """Measure in turns, and print a row for each case."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--before', type=Path, metavar='FOLDER', help='another checkout')
    parser.add_argument('--rounds', type=int, default=3)
    parser.add_argument('--once', action='store_true', help='measure once, in this process')
    options = parser.parse_args()
    if options.once:
        print(json.dumps(measured()))
        return
    folders = [*([options.before.resolve()] if options.before else []), ROOT]
    rounds = [[once(folder) for folder in folders] for _ in range(options.rounds)]
    print(f'{"runs per second":32}{"before":>10}{"now":>10}{"ratio":>8}' if options.before
          else 'runs per second')
    for name in CASES:
        times = [min(one[k][name] for one in rounds) for k in range(len(folders))]
        print(f'{name:32}' + ''.join(f'{1e6 / each:10.0f}' for each in times)
              + (f'{times[0] / times[1]:8.2f}' if options.before else ''))


if __name__ == '__main__':
    main()
