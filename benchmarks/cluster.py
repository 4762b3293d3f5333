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
Compare two worker processes of Dask with one, for runs of the demo under its recorded torques.

    python benchmarks/cluster.py [--runs N] [--rounds N]

Clusters of one and two worker processes, with one thread each, alternate. Each computes the
ensemble into a new folder. The workers have already loaded the kernels. The time includes what the
command does with the runs, but not the start of the cluster. The table contains the medians, and
the processor time of scheduler, workers and command for a million runs. The ratio requires an
otherwise idle machine; the processor time depends less on other processes.
"""

import argparse
from functools import partial
import os
from pathlib import Path
from tempfile import TemporaryDirectory
import time

from distributed import LocalCluster
import numpy as np
import psutil
from rigid_body_ros.ensemble import driver
from rigid_body_ros.ensemble.dispersions import Dispersion
from rigid_body_ros.ensemble.folder import Folder
from rigid_body_ros.ensemble.runs import Ensemble
from rigid_body_ros.recording import read_problem
from rigid_body_ros.runtime.cluster import connected

HERE = Path(__file__).resolve().parent
SCENE = HERE.parent / 'config' / 'tumbler.yaml'
RECORDING = HERE.parent / 'test' / 'recordings' / 'tumbler.mcap'
VARY = (Dispersion('inertia', 'relative', (0.05,)),
        Dispersion('initial_attitude', 'tilt', (0.02,)),
        Dispersion('torque_gain', 'normal', (0.03,)))
#: Minimum ratio of the rate of two worker processes to the rate of one.
BAR = 1.7


def ensemble():
    """Return the ensemble to compute."""
    problem = read_problem(RECORDING, SCENE)
    return Ensemble(problem, int(problem.logs[0].times_ns[-1]), VARY, 0)


def seconds(motions, runs, workers):
    """Return wall time, s, with some worker processes, and processor time, s, of all processes."""
    # Without these addresses, the metrics would be served on all network interfaces.
    with LocalCluster(n_workers=workers, threads_per_worker=1, host='127.0.0.1',
                      dashboard_address='127.0.0.1:0',
                      worker_dashboard_address='127.0.0.1:0') as started, \
            TemporaryDirectory() as folder:
        compute = partial(computed, motions, started.scheduler_address)
        compute(1000, f'{folder}/first')
        began = np.array([time.perf_counter(), processor_time()])
        compute(runs, f'{folder}/timed')
        return np.array([time.perf_counter(), processor_time()]) - began


def processor_time():
    """Return the processor time, s, of this process and of the processes that it started."""
    this = psutil.Process()
    return sum(sum(process.cpu_times()[:2]) for process in (
        this, *this.children(recursive=True)))


def computed(motions, address, runs, path):
    """Compute an ensemble into a folder."""
    driver.compute(motions, Folder(path, {}, motions.columns, runs), connected(address, print),
                   lambda blocks, total: blocks)


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--runs', type=int, default=100_000)
    parser.add_argument('--rounds', type=int, default=3)
    options = parser.parse_args()
    motions = ensemble()
    times = {1: [], 2: []}
    for number in range(options.rounds):
        for workers in (1, 2) if number % 2 else (2, 1):
            times[workers].append(seconds(motions, options.runs, workers))
            print(f'{workers} worker processes: {times[workers][-1][0]:.1f} s, load '
                  f'{os.getloadavg()[0]:.1f}', flush=True)
    for workers, found in times.items():
        wall, processor = np.median(found, axis=0) / options.runs
        print(f'{workers} worker processes: {1 / wall:.0f} runs/s, '
              f'{processor * 1e6 / 3600:.2f} processor hours for a million runs')
    ratios = np.divide(times[1], times[2])[:, 0]
    print(f'ratio: median {np.median(ratios):.2f} of {np.round(ratios, 2)}, expected {BAR}')


if __name__ == '__main__':
    main()
