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
Compare the engine with the committed vectors, `test/vectors.txt`, bit for bit.

    python benchmarks/vectors.py [--every N]

The file contains motions with their exact inputs and outputs; `docs/vectors.md` describes it.
`make_vectors.py` writes it. The exit status is 1 if a bit differs.
"""

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path
import sys
from typing import NamedTuple

import numpy as np
from rigid_body_ros import (
    GravityGradient,
    Problem,
    propagate_many,
    RigidBodies,
    RigidBody,
    State,
    States,
    TorqueLog,
    Trajectory,
    UniformField,
)
from rigid_body_ros.common.arrays import symmetric

VECTORS = Path(__file__).resolve().parent.parent / 'test' / 'vectors.txt'
OPTIONS = ('tolerance', 'max_step', 'torque_timeout')
_NAMES = {'state': ('attitude x', 'attitude y', 'attitude z', 'attitude w', 'angular velocity x',
                    'angular velocity y', 'angular velocity z'),
          'rotor_momentum': ('rotor momentum x', 'rotor momentum y', 'rotor momentum z'),
          'euler': ('first Euler angle', 'second Euler angle', 'third Euler angle')}


class Output(NamedTuple):
    """Numbers of a motion at a time, ns, with the key of their line: state, euler ZXZ, ..."""

    key: str
    time_ns: int
    numbers: tuple[float, ...]


class Motion(NamedTuple):
    """A motion of the file: the problem, and what every implementation must return."""

    name: str
    #: Motions of a group are also computed together; empty if the motion belongs to no group.
    group: str
    problem: Problem
    outputs: list[Output]

    @property
    def times_ns(self) -> list[int]:
        """Return the times of the states."""
        return [output.time_ns for output in self.outputs if output.key == 'state']


class Reader:
    """
    Reads the lines of one motion.

    Parameters
    ----------
    shared : dict
        The logs of all motions by their lines; equal lines share one log.

    """

    def __init__(self, shared: dict) -> None:
        self._shared, self._logs, self._fields, self.outputs = shared, [], [], []
        self._given = {'group': ''}

    def take(self, key: str, words: list[str]) -> None:
        """Read a line; raise ValueError if the line does not match the format."""
        if key in ('motion', 'group', 'solver'):
            self._given[key] = ' '.join(words)
        elif key in OPTIONS:
            self._given[key], = numbers(words)
        elif key in ('source', 'wheels'):
            self._logs.append((key, *words, []))
        elif key == 'torque':
            self._logs[-1][-1].append(tuple(words))
        elif not self.outputs and key in ('uniform_field', 'orbit'):
            self._fields.append(field(key, words))
        elif key == 'state' or (self.outputs and key in _NAMES):
            self._take_output(key, words)
        elif not self.outputs and key in ('inertia', 'damping', 'start', 'rotor_momentum'):
            self._given[key] = words
        else:
            raise ValueError(f'{self._given["motion"]}: expected a line of docs/vectors.md, '
                             f'found the key {key!r}')

    def _take_output(self, key: str, words: list[str]) -> None:
        if key == 'state':
            self.outputs.append(Output(key, int(words[0]), numbers(words[1:])))
            return
        if key == 'euler':
            key, *words = f'{key} {words[0]}', *words[1:]
        self.outputs.append(Output(key, self.outputs[-1].time_ns, numbers(words)))

    def motion(self) -> Motion:
        """Return the motion from the lines that were read."""
        given = self._given
        body = RigidBody(symmetric(numbers(given['inertia'])),
                         symmetric(numbers(given['damping'])) if 'damping' in given else None)
        time_ns, *values = given['start']
        values = numbers(values)
        start = State(int(time_ns), values[:4], values[4:],
                      numbers(given.get('rotor_momentum', 3 * ['0'])))
        logs = [(name, self._log(interpolation, tuple(rows)))
                for name, interpolation, rows in self._logs]
        problem = Problem(body, start, [log for name, log in logs if name == 'source'],
                          wheels=next((log for name, log in logs if name == 'wheels'), None),
                          fields=self._fields, solver=given['solver'],
                          **{name: given[name] for name in OPTIONS if name in given})
        return Motion(given['motion'], given['group'], problem, self.outputs)

    def _log(self, interpolation: str, rows: tuple) -> TorqueLog:
        key = interpolation, rows
        if key not in self._shared:
            times_ns, frames, *torques = zip(*rows)
            self._shared[key] = TorqueLog(list(map(int, times_ns)),
                                          np.transpose(list(map(numbers, torques))), frames,
                                          interpolation)
        return self._shared[key]


def numbers(words: Iterable[str]) -> tuple[float, ...]:
    """Return the values of hexadecimal numbers."""
    return tuple(map(float.fromhex, words))


def field(key: str, words: list[str]) -> UniformField | GravityGradient:
    """Return the field that a line describes."""
    if key == 'uniform_field':
        values = numbers(words)
        return UniformField(values[:3], values[3:])
    rate, *directions = numbers(words[1:])
    return GravityGradient(rate, directions[:3], directions[3:], int(words[0]))


def read(path: Path = VECTORS) -> list[Motion]:
    """Return the motions of a file."""
    shared, readers = {}, []
    for line in path.read_text(encoding='ascii').splitlines():
        if line and not line.startswith('#'):
            key, *words = line.split()
            if key == 'motion':
                readers.append(Reader(shared))
            readers[-1].take(key, words)
    return [reader.motion() for reader in readers]


def output(trajectory: Trajectory, row: int, key: str) -> tuple[float, ...]:
    """Return the numbers of a line for one state of a trajectory."""
    if key == 'state':
        found = *trajectory.attitude[row], *trajectory.angular_velocity[row]
    elif key == 'rotor_momentum':
        found = trajectory.rotor_momentum[row]
    else:
        found = trajectory.euler_angles(key.split()[1])[row]
    return tuple(map(float, found))


def alone(motion: Motion) -> list[Output]:
    """Compute a motion, and return the value of each of its outputs."""
    trajectory = motion.problem.propagate(at=motion.times_ns)
    found, row = [], -1
    for key, time_ns, _ in motion.outputs:
        row += key == 'state'
        found.append(Output(key, time_ns, output(trajectory, row, key)))
    return found


def together(motions: list[Motion]) -> Iterator[list[Output]]:
    """Compute all motions of a group in one call, and yield the states of each."""
    problems, times_ns = [motion.problem for motion in motions], motions[0].times_ns
    bodies = RigidBodies([problem.body.inertia for problem in problems],
                         [problem.body.damping for problem in problems])
    starts = [problem.start for problem in problems]
    states = States(np.array([start.time_ns for start in starts]),
                    [start.attitude for start in starts],
                    [start.angular_velocity for start in starts],
                    [start.rotor_momentum for start in starts])
    no_log = TorqueLog([], [])
    options = problems[0].options
    found = propagate_many(
        bodies, states, [problem.logs for problem in problems], at=times_ns,
        wheels=[problem.wheels or no_log for problem in problems],
        fields=[problem.fields for problem in problems], solver=options.solver,
        tolerance=options.tolerance, max_step=options.max_step,
        torque_timeout=options.torque_timeout)
    for attitude, rates in zip(found.attitude.tolist(), found.angular_velocity.tolist(),
                               strict=True):
        yield [Output('state', time_ns, (*q, *w))
               for time_ns, q, w in zip(times_ns, attitude, rates, strict=True)]


def difference(expected: list[Output], found: list[Output]) -> str:
    """Return the first number that differs in a bit or is missing, as text, or ''."""
    if len(expected) != len(found):
        return f'expected {len(expected)} outputs, found {len(found)}'
    for there, here in zip(expected, found, strict=True):
        names = _NAMES[there.key.split()[0]]
        if len(there.numbers) != len(names):
            return (f'{there.key} at {there.time_ns} ns: expected {len(there.numbers)} numbers, '
                    f'found {len(names)}')
        for name, value, other in zip(names, there.numbers, here.numbers, strict=True):
            if value.hex() != other.hex():
                return (f'{name} at {there.time_ns} ns: expected {value.hex()} ({value}), found '
                        f'{other.hex()} ({other})')
    return ''


def differences(motions: list[Motion]) -> list[str]:
    """Return a line for each motion that differs when computed alone or with its group."""
    lines = [(motion.name, difference(motion.outputs, alone(motion))) for motion in motions]
    groups = {}
    for motion in motions:
        if motion.group:
            groups.setdefault(motion.group, []).append(motion)
    for group in groups.values():
        for motion, found in zip(group, together(group), strict=True):
            states = [output for output in motion.outputs if output.key == 'state']
            lines.append((f'{motion.name}, computed with its group', difference(states, found)))
    return [f'{name}: {line}' for name, line in lines if line]


def main() -> int:
    """Print the differences; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--every', type=int, default=1, help='of the motions, compare every Nth')
    motions = read()[::parser.parse_args().every]
    found = differences(motions)
    print(*found, f'{len(motions)} motions: '
          + (f'{len(found)} differences' if found else 'the same bits'), sep='\n')
    return 1 if found else 0


if __name__ == '__main__':
    sys.exit(main())
