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
Measure the time and the memory of one long motion, in a new process.

    python benchmarks/growth.py SAMPLES {end,each}

The torques are sampled at 1 kHz and held. The output is the state at the end, or at each sample.
The script prints JSON: the time per sample, and the peak memory, MiB, for building the log and for
computing the motion, both without inputs and results. Linux only.
"""

import ctypes
import json
from pathlib import Path
import sys
import time

import numpy as np
from rigid_body_ros import propagate, RigidBody, State, TorqueLog

BODY = RigidBody.from_moments(1.0, 2.0, 3.0)
START = State(0, angular_velocity=(0.3, -0.2, 0.5))
#: s; a shorter run is repeated for timing.
LEAST = 0.5


def samples(count):
    """Return stamps and torques; compute them without temporary arrays."""
    times_ns = np.arange(count) * 1_000_000
    torques = np.empty((count, 3))
    for column, frequency in zip(torques.T, (0.7, 1.1, 1.9)):
        np.multiply(times_ns, 2e-9 * np.pi * frequency, out=column)
        np.sin(column, out=column)
        column *= 0.5
    return times_ns, torques


def memory(field):
    """Return a field of /proc/self/status, MiB."""
    # Not ru_maxrss, which a process inherits from its parent.
    lines = Path('/proc/self/status').read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(field))


def peak(function, *arguments, **options):
    """Return the result of a function, and the peak growth of memory during the call, MiB."""
    ctypes.CDLL(None).malloc_trim(0)  # return freed memory, which would hide growth
    Path('/proc/self/clear_refs').write_text('5')  # reset the peak to the present use
    before = memory('VmRSS')
    result = function(*arguments, **options)
    return result, memory('VmHWM') - before


def array_size(*arrays):
    """Return the size of arrays, MiB."""
    return sum(array.nbytes for array in arrays if isinstance(array, np.ndarray)) / 2 ** 20


def main():
    """Measure, and print the result."""
    count, each = int(sys.argv[1]), sys.argv[2] == 'each'
    propagate(BODY, START, TorqueLog(*samples(10)), at=[1_000_000])
    times_ns, torques = samples(count)
    at = times_ns if each else times_ns[-1:] + 1_000_000
    log, log_mib = peak(TorqueLog, times_ns, torques)
    log_mib -= array_size(*vars(log).values())
    runs = []

    def run():
        start = time.process_time()
        motion = propagate(BODY, START, log, at=at)
        runs.append(time.process_time() - start)
        # A view of the given times takes no additional memory.
        new_times = [] if np.shares_memory(motion.times_ns, at) else [motion.times_ns]
        return array_size(motion.attitude, motion.angular_velocity, *new_times)

    outputs, motion_mib = peak(run)
    while sum(runs) < LEAST:
        run()
    print(json.dumps({'samples': count, 'output': 'each' if each else 'end',
                      'ns_per_sample': 1e9 * float(np.median(runs)) / count, 'runs': runs,
                      'log_mib': log_mib, 'motion_mib': motion_mib - outputs}))


if __name__ == '__main__':
    main()
