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
Measure whether the intervals of `identify` cover the truth, and how long a fit takes.

Run `python benchmarks/identify.py [SEEDS]`. It first prints the time and the memory for recordings
of a minute and of an hour. Then it fits one motion, integrated by SciPy, with new noise for each
seed. It prints the fraction of the 95 % intervals of the inertia that cover the truth, chi-square
per degree of freedom, and the standard deviations relative to the Cramer-Rao bound, which follows
from derivatives of the motion at the truth.
"""

from pathlib import Path
import resource
import sys
import time

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))

from rigid_body_ros import Experiment, identify, Measured, State, TorqueLog  # noqa: E402
from rigid_body_ros.mechanics import so3  # noqa: E402
from rigid_body_ros.mechanics.body import RigidBody  # noqa: E402
from rigid_body_ros.propagation import propagate  # noqa: E402
from tumbling import INERTIA, Truth  # noqa: E402

ATTITUDE, RATE = 2e-3, 5e-3
ROWS, COLUMNS = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)


def bound(truth):
    """Return the Cramer-Rao bound of the six entries of the inertia."""
    start = truth.start

    def motion(change):
        inertia = INERTIA.copy()
        inertia[ROWS, COLUMNS] += change[:6]
        inertia[COLUMNS, ROWS] = inertia[ROWS, COLUMNS]
        moved = State(0, so3.multiply(start.attitude, so3.exp(change[6:9])),
                      start.angular_velocity + change[9:])
        return propagate(RigidBody(inertia), moved, truth.log, at=truth.stamps_ns)
    centre, columns = motion(np.zeros(12)), []
    for i in range(12):
        step = np.eye(12)[i] * (1e-8 if i < 6 else 1e-6)
        ahead, behind = motion(step), motion(-step)
        turned = so3.multiply(so3.conjugate(centre.attitude), ahead.attitude - behind.attitude)
        rates = ahead.angular_velocity - behind.angular_velocity
        columns.append(np.concatenate([(2.0 * turned[:, :3] / ATTITUDE).ravel(),
                                       (rates / RATE).ravel()]) / (2.0 * step[i]))
    jacobian = np.array(columns).T
    return np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))[:6]


def coverage(seeds):
    """Print how often the intervals cover the truth."""
    truth, guess = Truth(), RigidBody(np.diag([0.03, 0.03, 0.03]))
    covered, errors, sigmas, chi2 = [], [], [], []
    for seed in range(seeds):
        result = identify(guess, truth.experiment(truth.measured(ATTITUDE, RATE, seed)),
                          attitude_noise=ATTITUDE, rate_noise=RATE)
        found = [one for name, one in result.estimates.items() if name.startswith('inertia')]
        values = INERTIA[ROWS, COLUMNS]
        covered.append([one.interval_95[0] <= value <= one.interval_95[1]
                        for one, value in zip(found, values)])
        errors.append([one.value - value for one, value in zip(found, values)])
        sigmas.append([one.sigma for one in found])
        chi2.append(result.training.chi2_per_dof)
    least = bound(truth)
    print(f'{seeds} seeds: 95 % intervals cover the truth in {100 * np.mean(covered):.1f} %')
    print(f'chi-square per degree of freedom {min(chi2):.3f} to {max(chi2):.3f}')
    print(f'sigma / Cramer-Rao bound: reported {(np.mean(sigmas, axis=0) / least).round(3)}, '
          f'from the errors {(np.sqrt(np.mean(np.square(errors), axis=0)) / least).round(3)}')


def recording(seconds):
    """Return torques at 200 Hz, and attitudes and rates at 100 Hz that the engine computes."""
    times = np.arange(200 * seconds + 1) * 5_000_000
    phases = np.outer(times * 1e-9, [0.7, 1.1, 1.7]) + np.arange(3.0)
    log, start = TorqueLog(times, 0.02 * np.sin(phases)), State(angular_velocity=(0.5, 1.0, 0.2))
    stamps = times[2:-1:2]
    motion = propagate(RigidBody(INERTIA), start, log, at=stamps)
    turned, added = np.random.default_rng(0).standard_normal((2, len(stamps), 3))
    q = so3.multiply(motion.attitude, so3.exp(ATTITUDE * turned))
    return Experiment(start, log, [Measured('/imu', stamps, q,
                                            motion.angular_velocity + RATE * added)])


def duration(seconds, repetitions):
    """Print the time of a fit to a recording with this length, and the memory of the process."""
    experiment = recording(seconds)
    for _ in range(repetitions):
        begin = time.perf_counter()
        result = identify(RigidBody(np.diag([0.03, 0.03, 0.03])), experiment)
        taken = time.perf_counter() - begin
        resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # Linux counts in kB
        print(f'recording of {seconds} s: {taken:.2f} s, {result.evaluations} evaluations in '
              f'windows up to {result.window_s:.0f} s, {resident:.2f} GB resident', flush=True)


if __name__ == '__main__':
    duration(60, 3)
    duration(3600, 1)
    coverage(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
