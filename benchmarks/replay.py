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
Measure the replay of torques at 1 kHz: messages per second, and the peak memory.

    python benchmarks/replay.py [--hours H] [--rounds N]

The replay writes three topics at every stamp. Each round runs the command in a new process; the
time includes the start of Python. The table has the medians, and the times of the parts of a
replay in this process. The input is an MCAP file compressed with zstd. 1 MB is 10^6 bytes.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from processes import measure, SCENE
from rigid_body_ros import messages, recording, scene
from rigid_body_ros.replay import replay

RATE, EPOCH_NS = 1000, 1_767_225_600_123_456_789
#: Number of messages that are generated at a time.
PART = 100_000
#: Required values: minimum of messages per second, and maximum of the peak memory.
SPEED_BAR, MEMORY_BAR = 250_000, 500e6


def record(path, count):
    """Write a recording with a number of torques."""
    random = np.random.default_rng(6)
    with recording.Writer(path) as writer:
        writer.add_topic('/torque', messages.WRENCH)
        for first in range(0, count, PART):
            rows = np.arange(first, min(first + PART, count))
            writer.write_columns(EPOCH_NS + rows * (10 ** 9 // RATE), [recording.Column(
                '/torque', 'base_link', np.pad(torques(rows, random), ((0, 0), (3, 0))))])


def torques(rows, random):
    """Return torques, N m: sines of 5 mN m with noise of 1 mN m."""
    waves = np.sin(2.0 * np.pi / RATE * rows[:, None] * [0.7, 1.1, 1.9])
    return 5e-3 * waves + 1e-3 * random.standard_normal((len(rows), 3))


def main():
    """Measure, print the table, and mark required values that are not met."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--hours', type=float, default=1.0, help='length of the recording')
    parser.add_argument('--rounds', type=int, default=3)
    options = parser.parse_args()
    count = round(options.hours * 3600 * RATE)
    with TemporaryDirectory() as folder:
        path, output = Path(folder, 'torque.mcap'), Path(folder, 'motion.mcap')
        record(path, count)
        seconds, memory = np.median([
            measure('attitude_replay', path, '--scene', SCENE, '-o', output, '--overwrite')
            for _ in range(options.rounds)], axis=0)
        # Do this last: a process counts the memory of its parent as its own.
        parts = replay(path, scene.load(SCENE), output).seconds
    print(f'{"":16}{"found":>10}{"bar":>10}')
    for name, value, bar, met in (
            ('messages/s', count / seconds, SPEED_BAR, count / seconds >= SPEED_BAR),
            ('peak memory, MB', memory / 1e6, MEMORY_BAR / 1e6, memory <= MEMORY_BAR)):
        print(f'{name:16}{value:10.0f}{bar:10.0f}{"" if met else "  MISS"}')
    for name, part in parts.items():
        print(f'{name:16}{part:10.3g} s{1e9 * part / count:10.0f} ns a message')


if __name__ == '__main__':
    main()
