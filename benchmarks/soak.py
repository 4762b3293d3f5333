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
Run the node for a long time at 1 kHz with valid and invalid torques, and account for each.

    python benchmarks/soak.py [--seconds 600]

A driver sends torques over DDS in real time, with a fixed seed. They include invalid torques of
every kind, repeated stamps, late torques, bursts, and every 10 s a pause of 100 ms followed by the
delayed torques at once. The driver records what the node accepts, commits and publishes, and
finally compares this with what it sent. For ten minutes, the replay takes 2 GB of memory.
"""

import argparse
import math
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
import time
from typing import NamedTuple

import numpy as np
from processes import domain, processor_time
import psutil
from rigid_body_ros import messages, recording
from rigid_body_ros.live import events
from rigid_body_ros.scene import InputError

sys.path.extend(str(Path(__file__).resolve().parent.parent / name)
                for name in ('examples', 'test'))
from live import decoded, replayed, TUMBLER  # noqa: E402, I100
from live_session import ACCEPTED, ATTITUDE, COMMITTED, LiveSession, RELIABLE  # noqa: E402

#: Hz, and the seed of the torques.
RATE, SEED = 1000, 17
#: A queue so deep that no torque is lost while the machine is busy for a minute.
DEEP = ('-p', 'qos_overrides./torque.subscription.depth:=100000')
#: Torques that are not simply sent in order, and the fraction of each kind.
REPEATED, DELAYED, FORCED = 'repeated', 'delayed', 'forced'
SHARES = {REPEATED: 0.02} | dict.fromkeys([
    events.MALFORMED, events.FRAME, events.NOT_FINITE, events.TOO_LARGE, events.FUTURE,
    events.LATE, DELAYED, FORCED], 0.01)
#: s; longest delay of a torque, well below the node's `history`.
LONGEST_DELAY = 0.5
#: For how many steps torques are held back, to be sent all at once, and how often, in steps.
BURST, BURST_EVERY = 20, 1000
STALL, STALL_EVERY = 100, 10_000
#: In pauses of this length, the driver does not receive either.
SILENCE_NS = 50_000_000
#: Allowed growth of memory, MB, after SETTLED, s, when the queues of the log (10 000) are full.
GROWTH, SETTLED = 5.0, 60.0
PROCESSOR_TIME = 'processor time, us per torque'
#: Limit of the processor time: this fraction of one processor.
PROCESSOR = 0.75
#: s; how long counting the last torques may take.
PATIENCE = 60.0


class Line(NamedTuple):
    """A measured value, and the value that it must equal, or must not exceed."""

    name: str
    found: float
    bar: float
    at_most: bool = False

    @property
    def holds(self):
        """Return whether the measured value meets its limit."""
        return self.found <= self.bar if self.at_most else self.found == self.bar


class Plan:
    """
    What to send and when; relative to the start, it is the same in every run.

    Parameters
    ----------
    seconds, rate : float, int
        Duration, s, and number of torques per second.
    start_ns : int
        The time at which to begin.
    shares : dict
        The fraction of each kind.

    Attributes
    ----------
    due_ns : array of int64, shape (n,)
        When to send each torque, ascending.
    stamps_ns : array of int64, shape (n,)
        Stamps of the torques. Invalid torques are corrupted later, when they are sent.
    torques : array, shape (n, 3), N m
    frame_ids : list of n str
    causes : list of n str
        A key of SHARES, or '' for a valid torque that is sent in order.
    valid : array of bool, shape (n,)
        Whether the node must accept each torque.

    """

    def __init__(self, seconds, rate, start_ns, shares=SHARES):
        random = np.random.default_rng(SEED)
        count, step_ns = round(seconds * rate), 10 ** 9 // rate
        slots = np.arange(count)
        names = ['', *shares]
        causes = random.choice(len(names), count, p=[1.0 - sum(shares.values()), *shares.values()])
        causes[:BURST] = 0  # a torque can only be late after another one
        stamps = slots * step_ns + random.integers(0, step_ns, count)
        repeated = np.flatnonzero(causes == names.index(REPEATED))
        stamps[repeated] = stamps[repeated - 1]
        delays = random.integers(0, round(LONGEST_DELAY * rate), count)
        due = (slots + 1 + np.where(causes == names.index(DELAYED), delays, 0)) * step_ns
        for size, every in ((BURST, BURST_EVERY), (STALL, STALL_EVERY)):
            place = (due // step_ns - every // 2) % every
            due += np.where(place < size, size - place, 0) * step_ns
        order = np.argsort(due, kind='stable')
        self.due_ns, self.stamps_ns = start_ns + due[order], start_ns + stamps[order]
        self.causes = [names[cause] for cause in causes[order]]
        # One in ten torques is zero; consecutive zeros make a coast.
        self.torques = random.normal(0.0, 0.02, (count, 3)) * (random.random((count, 1)) > 0.1)
        self.frame_ids = random.choice(['', 'base_link', 'world'], count).tolist()
        self.valid = np.array([cause not in events.CAUSES for cause in self.causes])

    def __len__(self):
        return len(self.causes)

    def message(self, row):
        """Return the message to send, encoded as CDR."""
        cause, torque, frame_id = self.causes[row], self.torques[row], self.frame_ids[row]
        stamp_ns = int(self.stamps_ns[row])
        if cause == events.NOT_FINITE:
            torque = np.roll([(math.nan, math.inf, -math.inf)[row // 3 % 3], 0.0, 0.0], row)
        elif cause == events.TOO_LARGE:
            torque = np.roll([(1e9, 1e300)[row // 3 % 2], 0.0, 0.0], row)
        elif cause == events.FRAME:
            frame_id = ('map', 'World', 'base_link ', 'Ω')[row % 4]
        elif cause == events.FUTURE:
            stamp_ns += (100, 7200)[row % 2] * 10 ** 9
        elif cause == events.LATE:  # by `history`, or by the clock
            stamp_ns -= (2, 7200)[row % 2] * 10 ** 9
        elif cause == FORCED:
            return messages.WRENCH.encode(stamp_ns, frame_id, [1.0, 0.0, 0.0, *torque])
        data = messages.wrench(stamp_ns, frame_id, torque)
        return _corrupted(data, row) if cause == events.MALFORMED else data


def _corrupted(data, row):
    # Truncated; unknown encoding; a stamp before 1970, or with too many nanoseconds; a name longer
    # than the message, or that is not valid text.
    at, bytes_ = ((len(data) - 8, None), (1, b'\x07'), (4, b'\xff' * 4), (8, b'\xff' * 4),
                  (12, b'\xff' * 4), (12, b'\x02\0\0\0\xff\0'))[row % 6]
    return data[:at] if bytes_ is None else data[:at] + bytes_ + data[at + len(bytes_):]


class Usage:
    """Memory of a process, MB, over time, s, sampled once a second."""

    def __init__(self, process):
        self._process = process
        self._began = time.monotonic()
        self.curve = []

    def sample(self):
        """Record the memory, if a second has passed."""
        now = time.monotonic() - self._began
        if now >= len(self.curve):
            self.curve.append((now, self._process.memory_info().rss * 1e-6))

    def growth(self):
        """Return the largest growth of memory, MB, after it has settled."""
        settled = min(SETTLED, self.curve[-1][0] * 2 / 3)
        after = [memory for now, memory in self.curve if now >= settled]
        return max(after) - after[0]


def drive(live, plan, usage):
    """Send the torques of a plan when they are due."""
    for row, due_ns in enumerate(plan.due_ns.tolist()):
        rest_ns = due_ns - live.now_ns()
        if rest_ns >= SILENCE_NS:
            time.sleep(rest_ns * 1e-9)
        elif rest_ns > 0:
            live.spin(rest_ns * 1e-9)
        live.publish_bytes(plan.message(row))
        usage.sample()
        if live.process.poll() is not None:
            raise RuntimeError(f'the node ended after {row + 1} torques; its log:\n'
                               f'{live.words()}')


def soak(seconds, domain, rate=RATE):
    """
    Run the node for some seconds, in a ROS domain, with this many torques per second.

    Returns
    -------
    list of Line

    """
    with TemporaryDirectory() as folder, \
            LiveSession(TUMBLER, domain, *RELIABLE, *DEEP) as live:
        process = psutil.Process(live.process.pid)
        plan, usage = Plan(seconds, rate, live.now_ns()), Usage(process)
        before = processor_time(process)
        drive(live, plan, usage)
        # Wait, because counts are published only once a second.
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until and unfinished(live.diagnosis('torques')[0], len(plan)):
            live.spin(0.1)
        processor = processor_time(process) - before
        live.dump_parameters(Path(folder, 'live.yaml'))
        status = live.stop()
        return [*counted(live, plan), *published(live, plan, Path(folder)),
                Line('memory growth, MB', usage.growth(), GROWTH, True),
                Line(PROCESSOR_TIME, processor / len(plan) * 1e6, PROCESSOR / rate * 1e6, True),
                Line('exit status', status, 0)]


def unfinished(counts, sent):
    """Return whether torques are still in transit or waiting."""
    return counts[events.RECEIVED] < sent or counts[events.WAITING] > 0


def counted(live, plan):
    """Compare the node's counts with what was sent."""
    counts, valid = live.diagnosis('torques')[0], plan.stamps_ns[plan.valid]
    rejected = {cause: counts[events.rejections(cause)] for cause in events.CAUSES}
    return [Line(events.RECEIVED, counts[events.RECEIVED], len(plan)),
            Line('applied and rejected', counts[events.APPLIED] + sum(rejected.values()),
                 counts[events.RECEIVED]),
            *(Line(events.rejections(cause), found, plan.causes.count(cause))
              for cause, found in rejected.items()),
            Line(events.APPLIED, counts[events.APPLIED], valid.size),
            Line(events.REPLACED, counts[events.REPLACED], valid.size - np.unique(valid).size),
            Line(events.FORCE, counts[events.FORCE], plan.causes.count(FORCED)),
            Line(events.LOST, counts[events.LOST], 0),
            Line('messages accepted', len(live.torques), counts[events.APPLIED])]


def published(live, plan, folder):
    """Compare the published messages with the sent ones and with a replay."""
    bad = sum(not np.isfinite(message.values).all() for topic, kind in (
        (ACCEPTED, messages.WRENCH), (COMMITTED, messages.ODOMETRY),
        (ATTITUDE, messages.QUATERNION)) for message in decoded(live, topic, kind))
    finite = Line('not finite', bad, 0)
    try:
        run = replayed(folder, live)
    except InputError as error:  # the log is not valid
        return [finite, Line(f'replay: {error}\n', 0, 1)]
    accepted = run.accepted
    logged = zip(accepted.stamps_ns, accepted.frame_ids, *accepted.values[:, 3:].T)
    sent = [(plan.stamps_ns[row], plan.frame_ids[row] or 'base_link', *plan.torques[row])
            for row in np.flatnonzero(plan.valid)]
    stamps = np.unique(plan.stamps_ns[plan.valid])
    return [finite,
            Line('logged as sent, in order', sum(a == b for a, b in zip(logged, sent)), len(sent)),
            Line('stamps committed', np.intersect1d(run.stamps_ns, stamps).size, stamps.size),
            Line('states committed', len(run.committed), 1 + stamps.size), replayed_bits(run)]


def replayed_bits(run):
    """Compare the committed states with their replay."""
    same = recording.same_bits(run.committed, run.replay)
    return Line('states with the bits of the replay', int(same.sum()), same.size)


def printed(lines):
    """Print a table that marks values beyond their limits; return the exit status."""
    print(f'{"":36}{"found":>12}{"expected":>12}')
    for line in lines:
        print(f'{line.name:36}{line.found:12.8g}{"<=" if line.at_most else "":>4}'
              f'{line.bar:8.8g}{"" if line.holds else "  MISS"}')
    return 0 if all(line.holds for line in lines) else 1


def main():
    """Run the node, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--seconds', type=float, default=600.0)
    seconds = parser.parse_args().seconds
    return printed(soak(seconds, domain()))


if __name__ == '__main__':
    sys.exit(main())
