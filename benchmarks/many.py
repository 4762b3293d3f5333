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
Time many runs: `propagate_many` on one core, compared with the batch mode of heyoka.

Run `python benchmarks/many.py`. The runs are those of problem P3 with dispersed bodies and rates.
The time of a run includes the preparation of its body, except for `propagate`. Each tolerance is
measured in several processes, because the time of the peer depends on the process. Then the script
times 1000 bodies under a minute of torques at 1 kHz.
"""

import json
import sys
import time

from engine import child
import heyoka as hy
import numpy as np
import pairs
from problems import IDENTITY, PROBLEMS
from rigid_body_ros import propagate, propagate_many, RigidBodies, States, TorqueLog

PROBLEM, RUNS = PROBLEMS['P3'], 960
TOLERANCES, BATCHES = (1e-15, 1e-9, 1e-6, 1e-3), (4, 8, 16)
pairs.ROUNDS = 21
PROCESSES = 5


def dispersed(problem, count):
    """Return moments, shape (n, 3), kg m^2, and rates, shape (n, 3), rad/s."""
    random, moments = np.random.default_rng(1), np.array(problem.moments)
    # Vary the second moments of the mass, which are never negative; the moments are their sums.
    second = (0.5 * moments.sum() - moments) * np.exp(0.02 * random.standard_normal((count, 3)))
    rates = np.array(problem.rates) * (1.0 + 0.05 * random.standard_normal((count, 3)))
    return second.sum(axis=1, keepdims=True) - second, rates


class Ours:
    """`propagate_many`."""

    def __init__(self, problem, count, tolerance):
        self._moments, self._rates = dispersed(problem, count)
        _, _, self._log = problem.scene
        self._end, self._tolerance = [problem.end_ns], tolerance

    def reset(self):
        """Do nothing: each run begins anew."""

    def run(self):
        """Prepare the bodies and integrate."""
        self._found = propagate_many(
            RigidBodies(np.eye(3) * self._moments[:, None]), States(0, IDENTITY, self._rates),
            self._log, at=self._end, tolerance=self._tolerance)

    def attitude(self):
        """Return x y z w of all runs."""
        return self._found.attitude[:, -1]


class Alone:
    """`propagate`, called for one run after the other."""

    def __init__(self, problem, count, tolerance):
        moments, rates = dispersed(problem, count)
        bodies, starts = RigidBodies(np.eye(3) * moments[:, None]), States(0, IDENTITY, rates)
        self._runs = [(bodies[row], starts[row]) for row in range(count)]
        _, _, self._log = problem.scene
        self._end, self._tolerance = [problem.end_ns], tolerance

    def reset(self):
        """Do nothing: each run begins anew."""

    def run(self):
        """Integrate."""
        for body, start in self._runs:
            propagate(body, start, self._log, at=self._end, tolerance=self._tolerance)


class Heyoka:
    """heyoka's batch mode, with the constants of the bodies and the torques as parameters."""

    def __init__(self, problem, count, tolerance, batch):
        a, b, c, x, y, z, w = hy.make_vars('a', 'b', 'c', 'x', 'y', 'z', 'w')
        rates = [hy.par[i] * p + hy.par[i + 3] for i, p in enumerate((b * c, c * a, a * b))]
        turn = [w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a,
                -(x * a + y * b + z * c)]
        equations = [*zip((a, b, c), rates), *zip((x, y, z, w), (0.5 * each for each in turn))]
        self._integrator = hy.taylor_adaptive_batch(
            equations, np.zeros((7, batch)), tol=tolerance, pars=np.zeros((6, batch)))
        self._moments, self._rates = dispersed(problem, count)
        self._torque, self._end = problem.torques[0], float(problem.seconds)
        self._attitudes = np.empty((count, 4))

    def reset(self):
        """Do nothing: each run begins anew."""

    def run(self):
        """Compute the constants and integrate, batch by batch."""
        i1, i2, i3 = self._moments.T
        coupling = np.array([(i2 - i3) / i1, (i3 - i1) / i2, (i1 - i2) / i3])
        accelerations = self._torque[:, None] / self._moments.T
        integrator, batch = self._integrator, self._integrator.batch_size
        for k in range(0, len(self._rates), batch):
            integrator.set_time(0.0)
            integrator.pars[:3], integrator.pars[3:] = (coupling[:, k:k + batch],
                                                        accelerations[:, k:k + batch])
            integrator.state[:3] = self._rates[k:k + batch].T
            integrator.state[3:] = np.array(IDENTITY)[:, None]
            integrator.propagate_until(self._end)
            self._attitudes[k:k + batch] = integrator.state[3:].T

    def attitude(self):
        """Return x y z w of all runs."""
        return self._attitudes


def beside_heyoka(tolerance):
    """Return the times of a run, us: with `propagate_many`, heyoka and `propagate`."""
    ours = Ours(PROBLEM, RUNS, tolerance)
    peers = [Heyoka(PROBLEM, RUNS, tolerance, batch) for batch in BATCHES]
    peer = min(peers, key=pairs.quick)
    found = pairs.compare(ours, peer)
    apart = np.abs(ours.attitude() - peer.attitude()).max()
    if apart > 100.0 * tolerance:
        raise ValueError(f'tolerance {tolerance:g}: the attitudes differ by {apart:.1e}')
    alone = pairs.quick(Alone(PROBLEM, RUNS, tolerance))
    return [1e6 / RUNS * float(np.nanmedian(times))
            for times in (found.ours, found.peers, alone)]


def in_processes():
    """Print medians and ranges over several processes for each tolerance."""
    print(f'{PROBLEM.seconds} s of P3, {RUNS} runs: microseconds a run, medians of {PROCESSES} '
          'processes (smallest to largest)')
    for tolerance in TOLERANCES:
        times = np.array([json.loads(child('many.py', str(tolerance)))
                          for _ in range(PROCESSES)]).T
        ours, peer, alone, ratio = (f'{np.median(each):.4g} ({each.min():.4g} to {each.max():.4g})'
                                    for each in (*times, times[1] / times[0]))
        print(f'{tolerance:8g}: ours {ours}, heyoka in batches {peer}, propagate {alone}, '
              f'heyoka / ours {ratio}', flush=True)


def under_a_log(runs=1000):
    """Print the number of runs per second under a minute of torques at 1 kHz."""
    problem = PROBLEMS['P4']
    moments, rates = dispersed(problem, runs)
    bodies = RigidBodies(np.eye(3) * moments[:, None])
    log = TorqueLog(np.arange(len(problem.torques)) * problem.hold_ns, problem.torques)
    seconds = []
    for _ in range(5):
        began = time.process_time()
        propagate_many(bodies, States(0, IDENTITY, rates), log, at=[problem.end_ns])
        seconds.append(time.process_time() - began)
    print(f'{problem.seconds} s at 1 kHz: {runs / np.median(seconds):.0f} runs a second')


if __name__ == '__main__':
    if len(sys.argv) > 1:
        print(json.dumps(beside_heyoka(float(sys.argv[1]))))
    else:
        in_processes()
        under_a_log()
