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
Compare recordings that are wrong in common ways: none may be read wrongly in silence.

`python benchmarks/mutated_recordings.py [--count 500] [--seed 0]` makes small recordings with a
known truth, and gives two of three one or two faults. `attitude_compare` must recover the truth,
or name the fault. Otherwise the exit status is 1. `--only SEED` writes one recording to a folder,
and prints its command.

Some faults look like correct data, so the campaign does not make them: stamps rounded to less than
their period, a second publisher whose samples lie between those of the first, a constant attitude
of a body that hardly turns, a step back of the clock by less than two periods, a step ahead of a
few seconds, blank columns of a table, and torques that are blank in a table with other quantities.
"""

import argparse
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from decimal import Decimal
from functools import reduce
import io
from itertools import chain
import json
from operator import itemgetter, mul
import os
from pathlib import Path
import re
import shlex
import sys
import tempfile
import time
import traceback
from types import SimpleNamespace

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / 'test'))

import measurements as ros  # noqa: E402, I100
from mutations import limits  # noqa: E402
import numpy as np  # noqa: E402
from rigid_body_ros.commands.main import attitude_compare  # noqa: E402
from robots import robot  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402

FAILURES = ('silent', 'false alarm', 'false cause', 'slow', 'traceback')
OUTCOMES = ('right', 'named', *FAILURES)
BOTH, TEXTS = ('Imu', 'Odometry'), ('csv', 'tum')
ATTITUDES = ('PoseStamped', 'TFMessage', 'QuaternionStamped', 'TransformStamped')
KINDS = (*BOTH, *ATTITUDES, 'Vector3Stamped', *TEXTS)
#: Hz; the periods are whole milliseconds.
HERTZ = (4, 5, 8, 10, 20, 25, 40, 50, 100, 125, 200, 250, 500, 1000)
UNITS = {'s': 10 ** 9, 'ms': 10 ** 6, 'us': 10 ** 3, 'ns': 1}
#: Names of the time, of the components of a quaternion and of those of a vector.
HEADINGS = {
    'measured': (('time', 'q{}', 'w{}'), ('#timestamp', ' q_RS_{} []', ' w_RS_S_{} [rad s^-1]'),
                 ('__time', '/pose/orientation/{}', '/imu/angular_velocity/{}'),
                 ('Time', 'quaternion_{}', 'gyro.{}'), ('t', 'quat.{}', 'omega_{} (deg/s)'),
                 ('stamp', 'attitude/{}', 'Gyroscope {} (rad/s)')),
    'torque': (('time', '', 't{}'), ('__time', '', '/torque/wrench/torque/{}'),
               ('Timestamp', '', 'torque_{} [mNm]'), ('t', '', 'wrench.torque.{}'))}
#: The factors of the units in these names.
FACTORS = {'deg/s': np.degrees(1.0), 'mNm': 1e3}
#: The words that name a gap, and those that name any fault of stamps.
GAPS = 'acts for|acts until|computing the motion'
STAMPS = f'{GAPS}|same stamp|go back|are rejected|stamps? in the header'
#: The ways to mutate a recording, and the order of their groups.
WAYS, GROUPS = {}, ('body', 'frames', 'values', 'stamps', 'table')


def way(name, group, kinds, words, is_lost=False):
    """
    Return a decorator that adds a function to `WAYS`.

    A recording has at most one way of each group. `words` match what names the fault. If samples
    are lost, no cause may be named, unless a note says that the whole quantity is not used.
    """
    return lambda mutate: WAYS.setdefault(name, SimpleNamespace(
        mutate=mutate, group=group, kinds=kinds, words=words, is_lost=is_lost)).mutate


class Recording:
    """A recording, its scene and its command."""

    frame = torque_frame = 'base_link'
    delimiter, decimal, blank, every = ',', '.', '', 0
    is_matrix = is_joined = is_shuffled = is_renamed = False

    def __init__(self, seed):
        self.random = random = np.random.default_rng(seed)
        ways = [str(random.choice([*WAYS]))] if seed % 3 else []
        self.kind = str(random.choice(WAYS[ways[0]].kinds if ways else KINDS))
        others = [name for name, way in WAYS.items() if ways and self.kind in way.kinds
                  and way.group != WAYS[ways[0]].group]
        ways += random.permutation(others)[:int(random.random() < 1 / 3)].tolist()
        self.ways = sorted(ways, key=lambda name: GROUPS.index(WAYS[name].group))
        self.topic = 'tf' if self.kind in ('TFMessage', 'chain') else str(random.choice(
            ['imu', 'robot/pose', 'sensors/imu/data_raw']))
        self.links, self.joints, self.inertials, self.options, self.others = {}, [], {}, [], []
        self.tables = {who: SimpleNamespace(
            names=names[random.integers(len(names))], unit=str(random.choice([*UNITS])),
            time=str(random.choice(['{}_{}', '{} ({})', '{} [{}]'])))
            for who, names in HEADINGS.items()}
        self._set_motion(random)
        for name in self.ways:
            WAYS[name].mutate(self, random)

    def _set_motion(self, random):
        rate, self.count = int(random.choice(HERTZ[4:])), int(random.integers(60, 250))
        torque_rate = max(hertz for hertz in HERTZ if hertz * self.count <= 70 * rate)
        seed, axes = int(random.integers(2 ** 31)), Rotation.from_rotvec(random.normal(size=3))
        moments = random.uniform(0.6, 1.0, 3) * 10.0 ** random.uniform(-2.0, 0.0)
        inertia = axes.as_matrix() * moments @ axes.as_matrix().T
        self.truth = ros.truth(self.count / rate, torque_rate, rate, 0.2 * moments.max(), seed,
                               tuple(random.normal(size=3)), tuple(map(tuple, inertia)))
        self.noise = float(random.choice([0.0, 1e-3]))
        sensor = self.truth.measured(self.noise, self.noise, seed=seed)
        begin_ms = random.choice([0, random.integers(10 ** 8), random.integers(1.6e12, 1.8e12)])
        shift_ns = int(begin_ms) * 10 ** 6 - self.truth.torque_times[0]
        self.stamps = {'torque': self.truth.torque_times + shift_ns,
                       'measured': self.truth.stamps_ns + shift_ns}
        self.logged = {who: stamps.copy() for who, stamps in self.stamps.items()}
        self.values = {'torque': self.truth.torques.copy(),
                       'measured': np.hstack([sensor.attitude, sensor.angular_velocity])}
        only = int(random.integers(3)) if self.kind == 'csv' else 0
        self.has = {'attitude': self.kind != 'Vector3Stamped' and only != 1,
                    'rates': self.kind not in (*ATTITUDES, 'tum', 'chain') and only != 2}
        self.turned = np.linalg.norm(self.truth.rates.cumsum(axis=0), axis=1).max() / rate

    def take(self, who, rows):
        """Keep these rows, in this order."""
        for arrays in (self.stamps, self.logged, self.values):
            arrays[who] = arrays[who][rows]

    def write(self, folder):
        """Write the recording and the scene to a folder, and return the arguments."""
        scene, path = folder / 'scene.yaml', folder / 'recording.mcap'
        ros.write_scene(scene, self.truth)
        if self.joints:
            inertials = {'base_link': inertial(1.0, self.truth.inertia), **self.inertials}
            scene.write_text(re.sub(' +inertia.*\n', '', scene.read_text()) + (
                '    link: base_link\n    robot_description: '
                f"'{robot(*self.joints, inertials=inertials)}'\n"))
        measured = f'/{self.topic}'
        if self.kind in TEXTS:
            path, measured = self._write_texts(folder)
        else:
            ros.write(path, **self._topics())
        return [*map(str, (path, '--scene', scene, '--measured', measured)), *self.options,
                '--json', str(folder / 'found.json')]

    def _write_texts(self, folder):
        path, attitude = folder / f'measured.{self.kind}', self.values['measured'][:, :4]
        parts = [self._rows('torque', attitude[:, :0], 3)]
        if not self.is_joined:
            self._write_table(folder / 'torque.csv', parts)
            parts.clear()
        if self.kind == 'tum':
            rows = np.hstack([np.ones((len(attitude), 3 + 4 * self.is_matrix)), attitude])
            seconds = map('{:.9f}'.format, 1e-9 * self.stamps['measured'])
            path.write_text('\n'.join(f'{time} {" ".join(map(str, row))}'
                                      for time, row in zip(seconds, rows.tolist())))
        else:
            attitude, size = attitude[:, :4 * self.has['attitude']], 3 * self.has['rates']
            if self.every:  # the attitude is in some rows, the rates are in others
                parts.append(self._rows('measured', attitude, 0)[::self.every])
                attitude = attitude[:, :0]
            self._write_table(path, [*parts, self._rows('measured', attitude, size)])
        return (path if self.is_joined else folder / 'torque.csv'), path

    def _rows(self, who, attitude, size):
        """Return the log time and the texts by column of each row, with `size` of a vector."""
        table, (time, quaternion, vector) = self.tables[who], self.tables[who].names
        factor = next((FACTORS[unit] for unit in FACTORS if unit in vector), 1.0)
        names = [table.time.format(time, table.unit), *map(
            quaternion.format, 'xyzw'[:attitude.shape[1]]), *map(vector.format, 'xyz'[:size])]
        if self.is_renamed and who == 'measured':
            meanings, names = names, 'abcdefgh'[:len(names)]
            self.options = [','.join(map('{}={}'.format, meanings, names)) if option == '' else
                            option for option in self.options]
        return [(logged, dict(zip(names, [f'{Decimal(stamp) / UNITS[table.unit]:f}', *(
            f'{value:.12g}' for value in (*turn, *vector))])))
            for logged, stamp, turn, vector in zip(
            self.logged[who].tolist(), self.stamps[who].tolist(), attitude.tolist(),
            (factor * self.values[who][:, -3:][:, :size]).tolist())]

    def _write_table(self, path, parts):
        rows = sorted(chain(*parts), key=itemgetter(0))
        names = [*dict.fromkeys(chain(*map(itemgetter(1), rows))), *self.others]
        names = self.random.permutation(names).tolist() if self.is_shuffled else names
        path.write_text('\n'.join(map(self.delimiter.join, [names, *(
            [row.get(name, '3' if name in self.others else self.blank).replace('.', self.decimal)
             for name in names] for _, row in rows)])))

    def _topics(self):
        """Return pairs of a log time and a message for each topic."""
        attitude, rates = np.split(self.values['measured'], [4], axis=1)
        pairs = {'torque': ros.torque_messages(SimpleNamespace(
            torque_times=self.stamps['torque'], torques=self.values['torque']), self.torque_frame),
            'measured': ros.messages_of(self.kind, SimpleNamespace(
                stamps_ns=self.stamps['measured'], attitude=attitude, angular_velocity=rates),
                frame=self.frame)}
        torques, measured = ([(logged, message) for logged, (_, message) in zip(
            self.logged[who].tolist(), pairs[who])] for who in pairs)
        return {'torque': torques, **(self.links or {self.topic: measured})}


def inertial(mass, tensor):
    """Return an <inertial> of a URDF."""
    entries = ' '.join(f'i{"xyz"[i]}{"xyz"[j]}="{tensor[i, j]}"'
                       for i in range(3) for j in range(i, 3))
    return f'<inertial><mass value="{mass}"/><inertia {entries}/></inertial>'


def whose(random, count=3):
    """Choose the torques, the measurements or, if `count` is 3, both."""
    return [['torque'], ['measured'], ['torque', 'measured']][random.integers(count)]


@way('repeated stamps', 'stamps', KINDS, STAMPS, is_lost=True)
def repeat_stamps(recording, random):
    """Give some samples the stamp of the previous one."""
    for stamps in map(recording.stamps.get, whose(random)):
        rows = np.arange(1, len(stamps), random.integers(2, 20))
        stamps[rows] = stamps[rows - 1]


@way('rounded stamps', 'stamps', KINDS, STAMPS, is_lost=True)
def round_stamps(recording, random):
    """Round stamps to some digits, so that several are equal."""
    for stamps in map(recording.stamps.get, whose(random)):
        digits = random.integers(2) + np.ceil(np.log10(1.1 * np.median(np.diff(stamps))))
        stamps -= stamps % 10 ** int(digits)


@way('clock set back', 'stamps', KINDS, STAMPS, is_lost=True)
def set_back(recording, random):
    """Set the clock back by a random amount at a random place."""
    share, size = random.uniform(0.1, 0.9), 10.0 ** random.uniform(0.4, 3.5)
    for stamps in map(recording.stamps.get, whose(random)):
        stamps[int(share * len(stamps)):] -= int(size * np.median(np.diff(stamps)))


@way('clock set ahead', 'stamps', KINDS, GAPS, is_lost=True)
def set_ahead(recording, random):
    """Set the clock ahead by minutes to years at a random place."""
    share, seconds = random.uniform(0.1, 0.9), random.choice([300, 10 ** 5, 10 ** 8])
    for stamps in recording.stamps.values():
        stamps[int(share * len(stamps)):] += seconds * 10 ** 9


@way('two publishers', 'stamps', KINDS, STAMPS, is_lost=True)
def publish_twice(recording, random):
    """Let another publisher use the topic, with the same stamps or another clock."""
    who, = whose(random, 2)
    ahead_ns = random.choice([0.0, 3.3, 30.3, 300.3]) * np.median(np.diff(recording.stamps[who]))
    recording.take(who, np.repeat(np.arange(len(recording.stamps[who])), 2))
    recording.values[who][1::2] = recording.values[who][-2::-2]
    recording.stamps[who][1::2] += int(ahead_ns)


@way('looped', 'stamps', KINDS, STAMPS, is_lost=True)
def loop(recording, random):
    """Play the recording twice."""
    for who in whose(random):
        count, logged = len(recording.stamps[who]), recording.logged[who]
        recording.take(who, np.tile(np.arange(count), 2))
        recording.logged[who][count:] += logged[-1] - logged[0] + 1


@way('invalid stamps', 'stamps', KINDS[:-2], STAMPS)
def invalidate(recording, random):
    """Break the stamps of the headers, so that only the times of the recording are right."""
    case = random.integers(4)
    recording.options += ['--time-source', 'log'] * int(random.integers(2))
    for stamps in recording.stamps.values():
        stamps[:] = [0, -2 ** 31 * 10 ** 9, stamps[0],
                     random.integers(0, 2 ** 60, len(stamps))][case]


@way('constant', 'values', (*BOTH, 'csv'), 'is not used')
def freeze(recording, random):
    """Never set the orientation or the angular velocity of a body that turns."""
    if recording.turned > 0.3:
        recording.has = {'attitude': True, 'rates': True}
        columns, value = [(slice(4), (0, 0, 0, 1)), (slice(4), (0.5, 0.5, 0.5, 0.5)),
                          (slice(4, 7), 0.0), (slice(4, 7), -0.0)][random.integers(4)]
        recording.values['measured'][:, columns] = value


@way('no unit quaternions', 'values', (*BOTH, *ATTITUDES, *TEXTS), 'norm 1|not used', is_lost=True)
def replace_quaternions(recording, random):
    """Scale the quaternions, or write other numbers; blank columns of a table are not measured."""
    recording.has['attitude'], attitude = True, recording.values['measured'][:, :4]
    numbers, blank = random.normal(size=attitude.shape), 0.0 if recording.kind == 'csv' else np.nan
    attitude[:] = [-3.0 * attitude, 0.98 * attitude, 100.0 * attitude, 30.0 * numbers,
                   [1, 2, 3, 4], numbers.cumsum(axis=0), 0.0, blank][random.integers(8)]


@way('12 numbers', 'values', ('tum',), '^$')
def write_matrices(recording, random):
    """Write matrices of 3 x 4 in place of the trajectory."""
    recording.is_matrix = True


@way('NaN', 'values', KINDS, 'rejected', is_lost=True)
def lose(recording, random):
    """Lose a component of some torques or measurements."""
    for values in map(recording.values.get, whose(random)):
        values[3::random.integers(2, 20), [1, -2]] = np.nan


@way('rates in space axes', 'frames', (*BOTH, 'Vector3Stamped'), 'space')
def use_space(recording, random):
    """Give the angular velocity in space axes, and say so."""
    values, recording.frame = recording.values['measured'], '/world'[random.integers(2):]
    values[:, 4:] = Rotation.from_quat(values[:, :4]).apply(values[:, 4:])


@way('rotated link', 'frames', (*BOTH, 'TFMessage', 'TransformStamped', 'Vector3Stamped'),
     'axes of|expected frame')
def rotate(recording, random):
    """Measure on a rotated link, which the URDF fixes, moves or does not know."""
    angles, joint = random.normal(size=3).tolist(), str(random.choice(['fixed', 'revolute', '']))
    link, values = Rotation.from_euler('xyz', angles), recording.values['measured']
    values[:, :4] = (Rotation.from_quat(values[:, :4]) * link).as_quat()
    values[:, 4:] = link.inv().apply(values[:, 4:])
    recording.frame, rpy = 'imu_link', ' '.join(map(str, angles))
    recording.joints += [(joint, 'base_link', 'imu_link', '0.1 0 0', rpy)] * bool(joint)
    recording.options += ['--frames', 'world', 'imu_link'] * (recording.kind == 'TFMessage')


@way('leading slash', 'frames', KINDS, 'slash')
def add_slash(recording, random):
    """Write the frames as ROS 1 does."""
    recording.torque_frame = recording.frame = '/base_link'


@way('chain of transforms', 'frames', ('chain',), 'in a chain|rejected')
def chain_frames(recording, random):
    """Publish a chain of transforms in either direction, some of them fixed or missing."""
    whole, stamps_ns = (Rotation.from_quat(recording.values['measured'][:, :4]),
                        recording.stamps['measured'])
    rows, count = np.arange(len(stamps_ns)), int(random.integers(2, 5))
    between = random.permutation(['odom', 'map', 'hip'])[:count - 1].tolist()
    frames = ['world', *between, 'base_link']
    carrier, missing = random.integers(count), random.integers(12)
    moves = random.integers(2, size=count)
    seconds = 1e-9 * (stamps_ns - stamps_ns[0])
    turns = [Rotation.from_rotvec((1.0 + move * seconds)[:, None] * random.normal(size=3))
             for move in moves]
    before, after = (reduce(mul, part, Rotation.identity())
                     for part in (turns[:carrier], turns[carrier + 1:]))
    turns[carrier], moves[carrier] = before.inv() * whole * after.inv(), 1
    links = [*zip(frames, frames[1:], moves, turns), ('base_link', 'camera', 1, whole)]
    for number, (*pair, move, turn) in enumerate(links):
        pair, turn = (pair[::-1], turn.inv()) if random.integers(2) else (pair, turn)
        topic, sent = ('tf', rows) if move else [('tf_static', rows[:1]), ('tf', rows[:1]), (
            'tf', np.append(rows[::3], rows[-1]))][random.integers(3)]
        messages = [(int(stamp), ros.TFMessage([ros.transform(stamp, ros.Quaternion(*q), *pair)]))
                    for stamp, q in zip(stamps_ns[sent], turn[sent].as_quat().tolist())]
        if number != missing:
            recording.links[topic] = sorted([*recording.links.get(topic, []), *messages],
                                            key=itemgetter(0))


@way('mass on a fixed joint', 'body', KINDS, 'welded')
def add_battery(recording, random):
    """Describe the body as two links, whichever is the parent."""
    angles, total = random.normal(size=3), recording.truth.inertia
    place = random.normal(size=3) * 0.4 * np.sqrt(np.linalg.eigvalsh(total)[0])
    own, turn = 2e-3 * np.diag([9, 10, 11]) * total.max(), Rotation.from_euler('xyz', angles)
    turn, step, pair = turn.as_matrix(), random.choice([1, -1]), ('base_link', 'battery')
    recording.joints.append(('fixed', *pair[::step], *(
        ' '.join(map(str, vector.tolist())) for vector in (place, angles))))
    if step < 0:  # the battery is the parent
        turn, place = turn.T, -turn.T @ place
    recording.inertials = {'battery': inertial(0.5, own), 'base_link': inertial(
        1.0, total - turn @ own @ turn.T - 0.5 / 1.5 * (
            place @ place * np.eye(3) - np.outer(place, place)))}


@way('unit of time', 'table', TEXTS[:1], 'assumed|expected a time|expected measurements')
def omit_units(recording, random):
    """Write times in any unit, which the heading need not name."""
    for table in recording.tables.values():
        table.time = ['{}', '{}', '{} ({})'][random.integers(3)]


@way('layout of the table', 'table', TEXTS[:1], '^$')
def lay_out(recording, random):
    """Write the table as spreadsheets and plots do: sparse, shuffled, with other separators."""
    recording.delimiter, recording.decimal = str(random.choice([',.', ';,', ';.', '\t,', ',,']))
    recording.blank = str(random.choice(['', 'nan', 'NaN']))
    recording.others = ['battery', 'altitude [deg]', 'x_pos', 'mode'][:random.integers(5)]
    recording.is_shuffled, recording.is_joined = random.integers(2, size=2).tolist()
    recording.every = int(random.integers(6)) * all(recording.has.values())
    measured, torque = recording.tables.values()
    measured.names = HEADINGS['measured'][0]
    if recording.is_joined:
        torque.names = HEADINGS['torque'][0]
        torque.unit, torque.time = measured.unit, measured.time


@way('unknown headings', 'table', TEXTS[:1], '^$')
def rename(recording, random):
    """Name the columns in an unknown language, with or without --columns."""
    recording.is_renamed, recording.is_shuffled = True, bool(random.integers(2))
    table = recording.tables['measured']
    table.names, table.time = HEADINGS['measured'][0], '{}_{}'
    recording.options += ['--columns', ''] * int(random.integers(2))


def outcome(recording, status, shown, errors, path):
    """Classify what the command printed and wrote."""
    words = '|'.join(WAYS[name].words for name in recording.ways) or '$.'
    warnings = [line for line in errors.splitlines() if ': warning: ' in line]
    if status == 2:
        is_line = errors.count('\n') - len(warnings) - errors.count(': note: ') == 1
        return 'traceback' if not is_line else 'named' if recording.ways else 'false alarm'
    result = json.loads(path.read_text())
    sizes = [result[name]['rms'] for name, quantity in (
        ('attitude_error_rad', 'attitude'), ('rate_error_rad_s', 'rates'))
        if recording.has[quantity]]
    is_right = result['samples'] >= 0.99 * recording.count and all(
        size is not None and size < 1.35 * 3 ** 0.5 * recording.noise + 1e-5 for size in sizes)
    is_lost = any(WAYS[name].is_lost for name in recording.ways) and 'is not used' not in errors
    if result['likely_causes'] and is_lost:
        return 'false cause'
    if not all(re.search(words, line) for line in warnings) or (
            is_right and result['likely_causes']):
        return 'false alarm'
    return 'right' if is_right else 'named' if re.search(words, errors + shown) else 'silent'


def classified(seed, folder):
    """Make and compare a recording; return the ways, the outcome and what was printed."""
    recording, shown, errors = Recording(seed), io.StringIO(), io.StringIO()
    arguments, more = recording.write(folder), ''
    try:
        with redirect_stdout(shown), redirect_stderr(errors), limits():
            status = attitude_compare(arguments)
        end = outcome(recording, status, shown.getvalue(), errors.getvalue(), Path(arguments[-1]))
    except TimeoutError:  # a hang is a failure, unless it was announced
        end = 'named' if 'computing the motion takes' in errors.getvalue() else 'slow'
    except (Exception, SystemExit):
        end, more = 'traceback', traceback.format_exc()
    about = f'{" + ".join(recording.ways) or "control"}, {recording.kind}: {end}\n'
    return recording.ways, end, ''.join([about, errors.getvalue(), shown.getvalue(), more,
                                         shlex.join(['attitude_compare', *arguments])])


def main():
    """Print the recordings that failed, and a table of the outcomes."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n', maxsplit=1)[0])
    parser.add_argument('--count', type=int, default=500, help='recordings (default: 500)')
    parser.add_argument('--seed', type=int, default=0, help='that of the first (default: 0)')
    parser.add_argument('--only', type=int, metavar='SEED', help='write and compare only this one')
    options = parser.parse_args()
    if options.only is not None:
        _, end, text = classified(options.only, Path(tempfile.mkdtemp(prefix='mutated_')))
        print(text)
        return int(end in FAILURES)
    counts, began = Counter(), time.perf_counter()
    for seed in range(options.seed, options.seed + options.count):
        with tempfile.TemporaryDirectory() as folder:
            ways, end, text = classified(seed, Path(folder))
        counts.update([end, *((name, end) for name in ways or ['control'])])
        if end in FAILURES:
            print(f'--only {seed}: {text}', flush=True)
    print('| way |', ' | '.join(OUTCOMES), '|\n|---' + '|---' * len(OUTCOMES) + '|')
    for name in ('control', *WAYS):
        print(f'| {name} |', ' | '.join(str(counts[name, end]) for end in OUTCOMES), '|')
    failed = sum(counts[end] for end in FAILURES)
    print(f'{options.count} recordings in {time.perf_counter() - began:.0f} s, {failed} failed; '
          'one with two faults counts in two rows')
    return int(failed > 0)


if __name__ == '__main__':
    sys.exit(main())
