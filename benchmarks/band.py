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
Compare the bands of `attitude_replay --uncertain` with sampled motions.

    python benchmarks/band.py [--runs N]

For each scene, the table contains the computing time of the band; the time of the warning that the
uncertainty is not linear; the largest error of the standard deviation before this warning; and the
first time at which the error exceeds 10 %. Times are in seconds. An error is a fraction of the
largest standard deviation of the three axes. The exit status is 1 if an error exceeds 3 % before
the warning.
"""

import argparse
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
import json
from pathlib import Path
import sys
import tempfile
import time

import numpy as np
from rigid_body_ros import Problem, RigidBody, State, TorqueLog
from rigid_body_ros.commands import main as commands
from rigid_body_ros.ensemble import band, dispersions, fitted
from rigid_body_ros.ensemble.runs import Ensemble
from rigid_body_ros.mechanics import so3
from rigid_body_ros.recording import read_problem

ROOT = Path(__file__).resolve().parent.parent
BODY = RigidBody.from_moments(0.045, 0.12, 0.14, 0.002, -0.001, 0.003)
START = State(0, angular_velocity=(0.15, 0.6, -0.1))
#: The largest error before the warning, and an error that makes a band wrong.
CORRECT, WRONG = 0.03, 0.1
#: Number of times at which motions are sampled, and of motions that are computed at once.
TIMES, AT_ONCE = 80, 4000


def torques(seconds):
    """Return smooth torques at 10 Hz."""
    times_ns = np.arange(0, seconds * 10 ** 9, 10 ** 8)
    phases = np.outer(1e-9 * times_ns, [0.7, 1.1, 0.5]) + np.arange(3.0)
    return TorqueLog(times_ns, 0.02 * np.sin(phases))


def varied(text):
    """Return the distributions in a YAML text."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'vary.yaml'
        path.write_text(text)
        return dispersions.load(path)


def identified(factor):
    """Return the fit of a flight, with its standard deviations multiplied by a factor."""
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(StringIO()):
        path = Path(folder) / 'fitted.json'
        commands.attitude_identify([
            f'{ROOT}/test/recordings/flight.mcap', '--scene', f'{ROOT}/config/tumbler.yaml',
            '--measured', '/mocap', '--json', str(path)])
        data = json.loads(path.read_text())
        data['covariance']['matrix'] = (factor ** 2 * np.array(
            data['covariance']['matrix'])).tolist()
        path.write_text(json.dumps(data))
        return fitted.load(path)


def scenes():
    """Generate the name and the ensemble of each scene."""
    rates = 'initial_angular_velocity.{}: {{normal: {}}}\n'
    start = ''.join(rates.format(axis, 0.005) for axis in 'xyz')
    yield 'free rotation, uncertain start', Ensemble(
        Problem(BODY, START), 100 * 10 ** 9, varied(f'{start}initial_attitude: {{tilt: 0.01}}'), 0)
    flight = read_problem(ROOT / 'test/recordings/flight.mcap', ROOT / 'config/tumbler.yaml')
    for factor in (1.0, 100.0):
        yield f'torques, fitted inertia and start (sigma x {factor:g})', Ensemble(
            flight, int(flight.stamps_ns[-1]), (), 0, identified(factor))
    yield 'torques, uncertain gain, bias and inertia', Ensemble(
        Problem(BODY, START, torques(30)), 30 * 10 ** 9, varied(
            'torque_gain: {uniform: [0.9, 1.05]}\ntorque_bias.x: {normal: 5.0e-4}\n'
            'torque_bias.z: {uniform: [0.0, 1.0e-3]}\ninertia: {relative: 0.03}'), 0)
    yield 'torques, uncertain damping and rotors', Ensemble(
        Problem(RigidBody(BODY.inertia, np.diag([1e-3, 2e-3, 1e-3])),
                replace(START, rotor_momentum=(0.01, 0.02, 0.0)), torques(60)), 60 * 10 ** 9,
        varied('damping.dxx: {normal: 0.1, relative: true}\n'
               'damping.dyy: {uniform: [1.8e-3, 2.2e-3]}\n'
               'initial_rotor_momentum.x: {normal: 1.0e-4}\n'
               'initial_rotor_momentum.y: {normal: 1.0e-4}'), 0)
    near = State(0, angular_velocity=(1e-3, 1.0, 1e-3))
    yield 'near the separatrix, uncertain rates', Ensemble(
        Problem(RigidBody.from_moments(1.0, 2.0, 3.0), near), 40 * 10 ** 9,
        varied(''.join(rates.format(axis, 1e-4) for axis in 'xyz')), 0)


def sampled(ensemble, nominal, runs):
    """Return the standard deviations of attitude and rates, shape (m, 6), in n runs."""
    moments = []
    for first in range(0, runs, AT_ONCE):
        motions = ensemble.rows(first, first + AT_ONCE)['motion']
        motions = motions[np.isfinite(motions[:, 0, 0])]
        turned = so3.log(so3.multiply(so3.conjugate(nominal[:, :4]), motions[..., :4]))
        changes = np.concatenate([turned, motions[..., 4:] - nominal[:, 4:]], axis=2)
        moments.append([np.ones_like(changes[0]) * len(changes), changes.sum(axis=0),
                        (changes ** 2).sum(axis=0)])
    count, first, second = np.sum(moments, axis=0)
    return np.sqrt(second / count - (first / count) ** 2)


def main():
    """Print a row for each scene."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--runs', type=int, default=100_000, help='100 000 by default')
    runs, failed = parser.parse_args().runs, False
    print(f'{"scene":55}{"time (s)":>10}{"warning":>10}{"error":>10}{"> 10 %":>10}')
    for name, ensemble in scenes():
        began = time.perf_counter()
        found = band.band_of(ensemble)
        took = time.perf_counter() - began
        start_ns, count = ensemble.problem.start.time_ns, len(found.spread)
        rows = np.linspace(0, len(found.seconds) - 1, TIMES).astype(int)
        times_ns = start_ns + np.rint(1e9 * found.seconds[rows]).astype(np.int64)
        deviations = sampled(replace(ensemble, times_ns=times_ns), found.motion[rows], runs)
        linear = np.linalg.norm(band._linear(ensemble, ensemble.moments[0], times_ns).spread,
                                axis=2)
        error, largest = (one.reshape(-1, 2, 3).max(axis=2)
                          for one in (np.abs(deviations - linear), linear))
        error = np.divide(error, largest, out=np.zeros_like(error), where=largest > 0.0)
        error = error.max(axis=1)
        before, wrong = error[rows < count].max(), np.flatnonzero(error > WRONG)
        warning = f'{found.seconds[count - 1]:.2f}' if count < len(found.seconds) else '-'
        until = f'{found.seconds[rows[wrong[0]]]:.2f}' if wrong.size else '-'
        print(f'{name:55}{took:10.2f}{warning:>10}{before:10.2%}{until:>10}', flush=True)
        failed |= before > CORRECT
    return int(failed)


if __name__ == '__main__':
    sys.exit(main())
