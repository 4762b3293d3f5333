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
Read damaged recordings: each must give torques or a one-line error, within time and memory limits.

`python benchmarks/mutations.py --count 20000` damages recordings of every form at random, and
reads each of them in this process. It prints violations, and exits with status 1 if there are any.
`--first N --count 1` repeats mutation N.
"""

import argparse
from collections import Counter
from contextlib import contextmanager
from pathlib import Path
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / 'test'))

import bags  # noqa: E402, I100
from rigid_body_ros import recording  # noqa: E402
from rigid_body_ros.common.errors import InputError, LONGEST  # noqa: E402

#: Limits of time, s, and memory, bytes, for each mutation.
SECONDS, BYTES = 10, 500_000_000
#: Forms with checksums. From these, only messages of the original may be read.
CHECKED = ('mcap-none', 'mcap-lz4', 'mcap-zstd', 'mcap-zstd-unindexed')
FORMS = (*CHECKED, 'mcap-none-unchunked', 'mcap-idl', 'ours', 'rosbag2-mcap-none',
         'rosbag2-mcap-message', 'rosbag2-mcap-file', 'rosbag2-sqlite3-none',
         'rosbag2-sqlite3-message', 'split-sqlite3', 'sqlite3-killed', 'csv')
RECORDED = bags.torques()[6:]  # without infinities and NaN


def csv(folder, _):
    """Write the torques as a CSV file."""
    path = folder / 'torque.csv'
    rows = zip(RECORDED.stamps_ns.tolist(), RECORDED.values[:, 3:].tolist())
    path.write_text('t_ns,tx,ty,tz\n' + ''.join(
        f'{stamp},{",".join(map(repr, torque))}\n' for stamp, torque in rows))
    return path


def read(path):
    """Read the torques in pieces, as a replay does, and return the messages."""
    with recording.Source(path, None, recording.TORQUES) as source:
        blocks = [*source]
        try:
            for _ in recording.torque_pieces(str(path), iter(blocks), 'base_link', 'world'):
                pass
        except recording.NotInOrderError:
            whole = recording.joined(source.topic, source.kind, blocks, source.damage)
            for part in recording.epochs(path, whole):
                recording.torque_log(path, part, 'base_link', 'world')
        assert len(source.damage) <= LONGEST
        assert source.damage == '' or source.damage.isprintable()
        return recording.joined(source.topic, source.kind, blocks, ''), source.damage


def mutated(data, random):
    """Return a damaged copy of bytes."""
    data = bytearray(data)
    for _ in range(random.integers(1, 4)):
        one, other = sorted(random.integers(0, len(data) + 1, 2).tolist())
        size = int(random.choice([1, 2, 4, 8, 64, 4096]))
        match random.integers(8):
            case 0:  # flip bits
                for place in random.integers(0, max(len(data), 1), 4).tolist():
                    data[place:place + 1] = bytes(
                        byte ^ 1 << int(random.integers(8)) for byte in data[place:place + 1])
            case 1:
                del data[one:]
            case 2:
                del data[one:one + size]
            case 3:
                data[one:one] = random.bytes(size)
            case 4:  # repeat a block
                data[one:one] = data[one:min(other, one + 2 ** 16)]
            case 5:  # swap two blocks
                data[one:one + size], data[other:other + size] = \
                    data[other:other + size], data[one:one + size]
            case 6:  # a length or a count
                value = int(random.choice([0, 1, 255, 2 ** 15, 2 ** 31, 2 ** 32 - 1, 2 ** 62]))
                data[one:one + 8] = value.to_bytes(8, 'little')[:len(data[one:one + 8])]
            case 7:
                data[one:one + size] = bytes(len(data[one:one + size]))
    return bytes(data)


@contextmanager
def limits():
    """Raise TimeoutError or MemoryError beyond the limits, and treat warnings as errors."""
    def too_long(number, frame):
        raise TimeoutError(f'reads for more than {SECONDS} s')
    status = Path('/proc/self/statm').read_text().split()
    most = int(status[0]) * resource.getpagesize() + BYTES
    before = resource.getrlimit(resource.RLIMIT_AS)
    handler = signal.signal(signal.SIGALRM, too_long)
    resource.setrlimit(resource.RLIMIT_AS, (most, before[1]))
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('error')
            yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        resource.setrlimit(resource.RLIMIT_AS, before)
        signal.signal(signal.SIGALRM, handler)


class Original:
    """A recording of one form, of which damaged copies are made."""

    def __init__(self, form, folder):
        self.form, self._folder = form, folder
        folder.mkdir()
        self._path = (csv if form == 'csv' else bags.FORMS[form])(folder, bags.traffic(RECORDED))
        self._files = self._contents()
        found, damage = read(self._path)
        assert not damage
        self._rows = rows(found)

    def _contents(self):
        return {path: path.read_bytes() for path in self._folder.rglob('*') if path.is_file()}

    def check(self, random):
        """Damage a file and read the recording; return the outcome, and what is wrong with it."""
        names = sorted(self._files)
        damaged = names[random.integers(len(names))]
        before = {**self._files, damaged: mutated(self._files[damaged], random)}
        damaged.write_bytes(before[damaged])
        try:
            return self._outcome(before)
        finally:
            damaged.write_bytes(self._files[damaged])

    def _outcome(self, before):
        try:
            with limits():
                found, damage = read(self._path)
            outcome, wrong = 'damage' if damage else 'whole', ''
            if self.form in CHECKED and not self._rows.issuperset(rows(found)):
                wrong = 'messages that were never sent'
        except InputError as error:
            outcome, wrong = 'error', ''
            if len(str(error)) > LONGEST or not str(error).isprintable():
                wrong = f'more than a line: {error}'
        except Exception:
            outcome, wrong = 'exception', traceback.format_exc()
        return outcome, wrong if self._contents() == before else f'changed files; {wrong}'


def rows(found):
    """Return the messages in a form in which they are equal only if all bits are."""
    return {*zip(found.stamps_ns.tolist(), map(bytes, found.values), found.frame_ids)}


def main():
    """Damage recordings and report what happens."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n', maxsplit=1)[0])
    parser.add_argument('--count', type=int, default=2000, help='mutations (default: 2000)')
    parser.add_argument('--first', type=int, default=0, help='number of the first one')
    parser.add_argument('--seed', type=int, default=1)
    options = parser.parse_args()
    found, longest, wrong = Counter(), 0.0, 0
    with tempfile.TemporaryDirectory() as folder:
        originals = [Original(form, Path(folder, form)) for form in FORMS]
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        for number in range(options.first, options.first + options.count):
            original = originals[number % len(originals)]
            began = time.perf_counter()
            outcome, problem = original.check(np.random.default_rng([options.seed, number]))
            longest = max(longest, time.perf_counter() - began)
            found[outcome] += 1
            if problem:
                wrong += 1
                print(f'mutation {number} of {original.form}: {problem}', flush=True)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory
    print(f'{options.count} mutations: {dict(found)}; {wrong} wrong; longest {longest:.2f} s, '
          f'{memory / 1024:.0f} MB more')
    return int(wrong > 0)


if __name__ == '__main__':
    sys.exit(main())
