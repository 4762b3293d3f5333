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
Compare the replay of torques at 1 kHz with the plain pipeline in plain_replay.py.

    python benchmarks/replay.py [--hours H] [--plain-hours H] [--rounds N] [--folder DIR]

Both write three topics at every stamp. They alternate, each in a new process, and the table
contains the medians. The time of this package includes loading; that of the plain pipeline does
not. The plain pipeline may get a shorter recording, because the ratio compares messages per
second. Its memory is then for the shorter recording. The inputs are MCAP files compressed with
zstd. With --folder they are kept for the next run. 1 MB is 10^6 bytes.
"""

import argparse
import itertools
import json
import os
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

import numpy as np
from rigid_body_ros import messages, recording, scene
from rigid_body_ros.replay import replay

HERE = Path(__file__).resolve().parent
SCENE = HERE.parent / 'config' / 'tumbler.yaml'
OURS = ['-c', 'import sys; from rigid_body_ros.commands.main import attitude_replay; '
              'sys.exit(attitude_replay())']
RATE, EPOCH_NS = 1000, 1_767_225_600_123_456_789
#: Number of messages that are generated at a time.
PART = 100_000
#: Required values: minimum ratio and minimum messages per second, maximum peak memory.
RATIO_BAR, SPEED_BAR, MEMORY_BAR = 12.0, 250_000, 500e6


def recorded(folder, hours):
    """Return the path of a recording with this many hours; write it if it does not exist."""
    path = folder / f'torque_{hours:g}h.mcap'
    if not path.exists():
        random = np.random.default_rng(6)
        with recording.Writer(path) as writer:
            writer.add_topic('/torque', messages.WRENCH)
            for first in range(0, count(hours), PART):
                rows = np.arange(first, min(first + PART, count(hours)))
                writer.write_columns(EPOCH_NS + rows * (10 ** 9 // RATE), [recording.Column(
                    '/torque', 'base_link', np.pad(torques(rows, random), ((0, 0), (3, 0))))])
    return path


def count(hours):
    """Return the number of messages in a recording with this many hours."""
    return round(hours * 3600 * RATE)


def torques(rows, random):
    """Return torques, N m: sines of 5 mN m with noise of 1 mN m."""
    waves = np.sin(2.0 * np.pi / RATE * rows[:, None] * [0.7, 1.1, 1.9])
    return 5e-3 * waves + 1e-3 * random.standard_normal((len(rows), 3))


def ours(path, output):
    """Replay with the command; return the time, s, and the peak memory, bytes."""
    seconds, memory, _ = run(*OURS, path, '--scene', SCENE, '-o', output, '--overwrite')
    return seconds, memory


def plain(path, output):
    """Replay with the plain pipeline; return the time, s, and the peak memory, bytes."""
    _, memory, printed = run(HERE / 'plain_replay.py', path, SCENE, output)
    return float(printed), memory


def run(*arguments):
    """Run Python; return the time, s, the peak memory, bytes, and what was printed."""
    began = time.perf_counter()
    with subprocess.Popen([sys.executable, *arguments], stdout=subprocess.PIPE) as process:
        printed = process.stdout.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f'{arguments}: exit status {process.returncode}')
    return time.perf_counter() - began, usage.ru_maxrss * 1024, printed


def split(path, output):
    """Replay in this process, and return the times, s, of the parts."""
    return replay(path, scene.load(SCENE), output).seconds


def measure(folder, hours, plain_hours, rounds):
    """Return messages per second and peak memory, bytes, as two arrays of shape (rounds, 2)."""
    cases = {'ours': (ours, recorded(folder, hours), hours),
             'plain': (plain, recorded(folder, plain_hours), plain_hours)}
    figures = {name: [] for name in cases}
    output = folder / 'motion.mcap'
    ours(recorded(folder, 1 / 3600), output)  # loads its files into the cache for later runs
    for _, (name, (run_it, path, length)) in itertools.product(range(rounds), cases.items()):
        seconds, memory = run_it(path, output)
        figures[name].append((count(length) / seconds, memory))
        output.unlink()
    return {name: np.array(rows) for name, rows in figures.items()}


def report(figures, parts, messages_read):
    """Print the table, and mark required values that are not met."""
    (speed, memory), (plain_speed, plain_memory) = (
        np.median(figures[name], axis=0) for name in ('ours', 'plain'))
    ratio = np.median(figures['ours'][:, 0] / figures['plain'][:, 0])
    print(f'{"":16}{"ours":>10}{"plain":>10}{"bar":>10}')
    for name, mine, other, bar, met in (
            ('messages/s', f'{speed:.0f}', f'{plain_speed:.0f}', SPEED_BAR, speed >= SPEED_BAR),
            ('ratio', f'{ratio:.2f}', '', f'{RATIO_BAR:g}', ratio >= RATIO_BAR),
            ('peak memory, MB', f'{memory / 1e6:.0f}', f'{plain_memory / 1e6:.0f}',
             f'{MEMORY_BAR / 1e6:.0f}', memory <= MEMORY_BAR)):
        print(f'{name:16}{mine:>10}{other:>10}{bar:>10}{"" if met else "  MISS"}')
    for name, seconds in parts.items():
        print(f'{name:16}{seconds:10.3g} s{1e9 * seconds / messages_read:10.0f} ns a message')


def main():
    """Measure and report."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--hours', type=float, default=1.0, help='length of our recording')
    parser.add_argument('--plain-hours', type=float, default=0.02, help="length of the other's")
    parser.add_argument('--rounds', type=int, default=3)
    parser.add_argument('--folder', type=Path, help='where recordings are kept')
    parser.add_argument('--json', type=Path, help='write the figures')
    arguments = parser.parse_args()
    with TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        folder.mkdir(exist_ok=True)
        figures = measure(folder, arguments.hours, arguments.plain_hours, arguments.rounds)
        # Do this last: a process counts the memory of its parent as its own.
        parts = split(recorded(folder, arguments.hours), folder / 'motion.mcap')
    report(figures, parts, count(arguments.hours))
    if arguments.json:
        arguments.json.write_text(json.dumps(
            {'split': parts, **{name: rows.tolist() for name, rows in figures.items()}},
            indent=1))


if __name__ == '__main__':
    main()
