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
    python benchmarks/ensemble.py --once [--free] --runs 1000000 --workers 2

The scene is the CubeSat of the demo over a minute: under its recording (3001 torques), and without
torque. One worker and two alternate, each in a new process that first loads the kernels. The ratio
is the median over the pairs. The time is that of the whole command with its files, without the
start of Python. It excludes time in which the workers wait for a processor that other processes
use. The load average is printed. With --once, a single measurement is printed as JSON. Linux only.
"""

import argparse
from contextlib import suppress
import json
import os
from pathlib import Path
import statistics
import subprocess
import sys
import tempfile
import threading
import time

from rigid_body_ros.commands.main import attitude_ensemble

ROOT = Path(__file__).resolve().parent.parent
SCENE = ROOT / 'config' / 'tumbler.yaml'
RECORDING = ROOT / 'test' / 'recordings' / 'tumbler.mcap'
VARY = """inertia: {relative: 0.05}
initial_attitude: {tilt: 0.02}
initial_angular_velocity.y: {uniform: [0.5, 0.7]}
"""
GAIN = 'torque_gain: {normal: 0.03}\n'


class Watch(threading.Thread):
    """Record how long the threads of this process run, and how long they wait for a processor."""

    def __init__(self):
        super().__init__(daemon=True)
        self._times, self._end = {}, threading.Event()

    def run(self):
        """Read the times of all threads until the end."""
        while not self._end.wait(0.02):
            for task in Path('/proc/self/task').iterdir():
                with suppress(OSError):  # the thread has ended
                    ran, waited, _ = (task / 'schedstat').read_text().split()
                    first = self._times.setdefault(task.name, (int(ran), int(waited)))[:2]
                    self._times[task.name] = *first, int(ran), int(waited)

    def waited(self, count):
        """Return the mean time, s, that the busiest threads waited."""
        self._end.set()
        self.join()
        threads = sorted((ran - ran_before, waited - waited_before) for
                         ran_before, waited_before, ran, waited in self._times.values())
        return sum(waited for _, waited in threads[-count:]) / count / 1e9


def once(free, runs, workers):
    """
    Run the command in this process, and return what it takes.

    The results are the rate, 1/s, and the time, s, both without waiting for a processor; the time
    that the workers waited, s; the processor time per run, us; and the peak memory, MB.
    """
    with tempfile.TemporaryDirectory() as folder:
        vary = Path(folder) / 'vary.yaml'
        vary.write_text(VARY if free else VARY + GAIN)
        given = ['--scene', SCENE, '--vary', vary, '--workers', workers,
                 *(['--until', 60] if free else ['--recording', RECORDING])]
        compute([*given, '--runs', 10, '-o', Path(folder) / 'first'])
        watch, began, used = Watch(), time.perf_counter(), time.process_time()
        watch.start()
        compute([*given, '--runs', runs, '-o', Path(folder) / 'runs'])
        taken, used = time.perf_counter() - began, time.process_time() - used
        waited = watch.waited(workers)
    lines = Path('/proc/self/status').read_text().splitlines()
    peak = next(int(line.split()[1]) for line in lines if line.startswith('VmHWM'))
    return {'rate': runs / (taken - waited), 'seconds': taken - waited, 'waited': waited,
            'processor_us': 1e6 * used / runs, 'peak_mb': peak * 1024 / 1e6}


def compute(given):
    """Run the command without printing its text."""
    text = os.dup(1)
    os.dup2(2, 1)
    status = attitude_ensemble([*map(str, given)])
    os.dup2(text, 1)
    os.close(text)
    if status:
        sys.exit(status)


def alone(free, runs, workers):
    """Return the result of `once` in a new process."""
    command = [sys.executable, __file__, '--once', '--runs', str(runs), '--workers', str(workers)]
    done = subprocess.run([*command, *(['--free'] if free else [])], check=True,
                          stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    return json.loads(done.stdout)


def main():
    """Measure in pairs, and print a line for each scene."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--runs', type=int, default=20_000, help='runs under the recording')
    parser.add_argument('--free', type=int, nargs='?', default=200_000, const=1,
                        help='runs without torque; with --once, whether there is no torque')
    parser.add_argument('--pairs', type=int, default=5)
    parser.add_argument('--workers', type=int, default=1, help='with --once')
    parser.add_argument('--once', action='store_true', help='measure once, in this process')
    options = parser.parse_args()
    if options.once:
        print(json.dumps(once(options.free == 1, options.runs, options.workers)))
        return
    print(f'{"":10}{"runs":>8}{"1 worker":>14}{"2 workers":>14}{"ratio":>7}{"memory":>10}'
          f'{"load":>6}')
    compare('recording', False, options.runs, options.pairs)
    compare('no torque', True, options.free, options.pairs)


def compare(name, free, runs, count):
    """Measure one worker and two alternately, and print their rates."""
    pairs = [(alone(free, runs, 1), alone(free, runs, 2)) for _ in range(count)]
    one, two = (statistics.median(pair[k]['rate'] for pair in pairs) for k in (0, 1))
    ratio = statistics.median(pair[1]['rate'] / pair[0]['rate'] for pair in pairs)
    peak = max(found['peak_mb'] for pair in pairs for found in pair)
    print(f'{name:10}{runs:8}{one:10.0f} / s{two:10.0f} / s{ratio:7.2f}{peak:7.0f} MB'
          f'{os.getloadavg()[0]:6.1f}', flush=True)


if __name__ == '__main__':
    main()
