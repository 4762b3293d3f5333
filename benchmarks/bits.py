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
Print a hash of the results of the engine, to show that a change preserves every bit.

    python benchmarks/bits.py [--count N]

Random motions with a fixed seed are computed by every solver, as Euler angles, by a Propagator and
by an Integration, and again under fields. Each group of results has its own SHA-256, so that a
difference can be located. The last line is the hash of all groups. Compare only runs on one
machine with the same versions of Python packages.
"""

import argparse
import hashlib
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from rigid_body_ros import (
    GravityGradient,
    propagate,
    Propagator,
    RigidBody,
    State,
    TorqueLog,
    UniformField,
)
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation import Integration, Problem

SEED, COUNT = 20260101, 200
SECOND = 10 ** 9
EPOCH_NS = 1_767_225_600_123_456_789
INTERPOLATIONS = ('hold', 'linear', 'cubic')
#: Solvers that accept torques.
SOLVERS = ('auto', 'taylor', 'rk4', 'strang', 'explicit_euler')
SEQUENCES = ('ZXZ', 'XYX', 'YZY', 'ZYZ', 'XZX', 'YXY', 'XYZ', 'YZX', 'ZXY', 'XZY', 'ZYX', 'YXZ')
#: Number of samples on each side that the cubics of a piece, and of the next sample, need.
_BESIDE = 3


class Motion(NamedTuple):
    """A random motion: a body, its start, its torques, times (ns) and options of `propagate`."""

    body: RigidBody
    start: State
    log: TorqueLog
    at: np.ndarray
    options: dict
    #: s; for solvers with a fixed step.
    max_step: float
    #: The fields, which only the last group of results includes.
    fields: tuple = ()

    def solver_options(self, solver):
        """Return the options for a solver."""
        fixed = solver in ('rk4', 'strang', 'explicit_euler')
        return {**self.options, 'solver': solver, 'max_step': self.max_step if fixed else None}


def random_body(random):
    """Return any body, a rod, a plate, a symmetric top or a sphere, in principal axes or not."""
    a, b, c = 10.0 ** random.uniform(-1.5, 1.5, 3)
    second_moments = np.array([(a, b, c), (1.0, 1e-3 * a, 1e-3 * b), (a, b, 0.0), (a, a, b),
                               (a, a, a)][random.integers(5)])
    moments = 10.0 ** random.uniform(-3.0, 3.0) * (second_moments.sum() - second_moments)
    turn = so3.matrix(so3.normalize(random.normal(size=4)))
    return RigidBody(np.diag(moments) if random.random() < 0.4 else turn * moments @ turn.T)


def random_start(random, body):
    """Return a start with any rates, with rates along a principal axis, or at rest."""
    direction = random.normal(size=3)
    if random.random() < 0.15:
        direction = body.principal_axes[:, random.integers(3)]
    size = 0.0 if random.random() < 0.05 else 10.0 ** random.uniform(-2.0, 1.0)
    attitude = (0, 0, 0, 1) if random.random() < 0.2 else random.normal(size=4)
    return State([0, EPOCH_NS, -SECOND][random.integers(3)], attitude, size * direction)


def random_log(random, body, start):
    """Return torques with coasts, irregular and repeated stamps, in body, space or both axes."""
    interpolation = INTERPOLATIONS[random.integers(3)]
    stream = random.random() < 0.4
    # A cubic through samples with very different spacing overshoots.
    shortest = -3.0 if interpolation == 'hold' else -1.0
    spans = np.full(300, 1e-3) if stream else 10.0 ** random.uniform(shortest, 0.5, 40)
    rates = random.normal(size=(len(spans), 3)) * (0.1 + np.linalg.norm(start.angular_velocity))
    rates[np.repeat(random.random(len(spans) // 10) < 0.4, 10)] = 0.0
    torques = 0.2 * body.angular_momentum(rates) / spans.max()
    if interpolation == 'hold':  # otherwise a torque would ramp up during the gap
        spans[(rates == 0.0).all(axis=1) & (random.random(len(spans)) < 0.05)] *= 1e3
    stamps = start.time_ns - SECOND // 50 + np.cumsum(np.round(spans * 1e9).astype(np.int64))
    stamps[7::9] = stamps[6::9][:len(stamps[7::9])]
    order = random.permutation(len(stamps)) if random.random() < 0.3 else np.arange(len(stamps))
    frames = ['body', 'space', random.choice(['body', 'space'], len(stamps)).tolist()]
    frame = frames[random.integers(3 if interpolation == 'hold' else 2)]
    return TorqueLog(stamps[order], torques[order], frame, interpolation)


def random_motion(number):
    """Return the motion with a number; it is the same in every run."""
    random = np.random.default_rng((SEED, number))
    body = random_body(random)
    start = random_start(random, body)
    log = random_log(random, body, start)
    end_ns = max(int(log.times_ns[-1]), start.time_ns + 1)
    at = np.concatenate([random.integers(start.time_ns, end_ns + SECOND // 100, 60),
                         random.choice(log.times_ns[log.times_ns > start.time_ns], 20),
                         [start.time_ns]])
    speed = max(0.1, np.linalg.norm(start.angular_velocity))
    return Motion(body, start, log, np.sort(at) if random.random() < 0.7 else at, {
        'tolerance': 10.0 ** -random.uniform(3.0, 15.0) if random.random() < 0.6 else 1e-15,
        'torque_timeout': 10.0 ** random.uniform(-3.0, 1.0) if random.random() < 0.4 else 0.0},
        random.uniform(0.02, 0.2) / speed, random_fields(number, body, start))


def random_fields(number, body, start):
    """Return up to five uniform fields, an orbit or both, with torques that suit the rotation."""
    random = np.random.default_rng((SEED, number, 3))
    speed = 0.1 + np.linalg.norm(start.angular_velocity)
    size = np.sqrt(0.1 * body.principal_moments[0]) * speed
    uniform = [UniformField(*size * random.normal(size=(2, 3)))
               for _ in range(random.integers(0, 6))]
    if uniform and random.random() < 0.4:
        return tuple(uniform)
    position, other = random.normal(size=(2, 3))
    time_ns = start.time_ns - int(random.integers(0, 10 * SECOND)) \
        if random.random() < 0.5 else None
    return (*uniform, GravityGradient(10.0 ** random.uniform(-2.0, 0.0) * speed, position,
                                      np.cross(position, other), time_ns))


def solved(motion, solver):
    """Yield attitude and rates by a solver."""
    trajectory = propagate(motion.body, motion.start, motion.log, at=motion.at,
                           **motion.solver_options(solver))
    yield trajectory.attitude
    yield trajectory.angular_velocity


def coasted(motion, solver):
    """Yield attitude and rates without torques, over an hour, or over a day in closed form."""
    span_ns = (86400 if solver == 'exact' else 3600) * SECOND
    # Times by halving, because the last bit of a power depends on the machine.
    at = motion.start.time_ns + (span_ns >> np.arange(39, -1, -1))
    free = propagate(motion.body, motion.start, at=at, **motion.solver_options(solver))
    yield free.attitude
    yield free.angular_velocity


def euler_angles(motion):
    """Yield the Euler angles of all sequences, wrapped and continuous."""
    trajectory = propagate(motion.body, motion.start, motion.log, at=np.sort(motion.at),
                           **motion.options)
    for sequence in SEQUENCES:
        for continuous in (False, True):
            yield trajectory.euler_angles(sequence, continuous)
        yield trajectory.degenerate(sequence)


def asked_in_any_order(motion, solver, number):
    """Yield states of a Propagator at times in random order, under torques that arrive late."""
    random = np.random.default_rng((SEED, number, 1))
    options = motion.solver_options(solver)
    stamps = motion.log.times_ns
    propagator = Propagator(motion.body, motion.start, history=1e5, **options)
    arrival = np.argsort(stamps + random.integers(0, SECOND // 10, len(stamps)), kind='stable')
    for row in arrival.tolist():
        propagator.apply(int(stamps[row]), motion.log.torques[row],
                         'space' if motion.log.in_space[row] else 'body')
        if random.random() < 0.2:
            yield from states(propagator, random.permutation(motion.at)[:3])
    yield from states(propagator, random.permutation(motion.at))


def states(propagator, times_ns):
    """Yield attitude and rates at times."""
    for time_ns in times_ns.tolist():
        state = propagator.at(time_ns)
        yield state.attitude
        yield state.angular_velocity


def streamed(motion, solver, number):
    """Yield attitude and rates of an Integration that receives its log in pieces."""
    random = np.random.default_rng((SEED, number, 2))
    log, at = motion.log, np.unique(motion.at)
    cuts = np.unique(random.integers(4, len(log) - 4, 4)).tolist()
    run, reached = None, motion.start.time_ns - 1
    for front, cut in pairwise([0, *cuts, None]):
        piece = log.rows(slice(max(front - _BESIDE, 0),
                               None if cut is None else cut + 1 + _BESIDE))
        problem = Problem(motion.body, motion.start, piece, **motion.solver_options(solver))
        if run:
            run.extend(problem)
        else:
            run = Integration(problem)
        end = int(at[-1] if cut is None else log.times_ns[cut])
        trajectory = run.advance(at[(at > reached) & (at <= end)], None if cut is None else end)
        yield trajectory.attitude
        yield trajectory.angular_velocity
        reached = max(end, reached)


def under_fields(motion):
    """Return the motion under its fields."""
    return motion._replace(options={**motion.options, 'fields': motion.fields})


def solved_by_all(motion):
    """Yield attitude and rates by every solver."""
    for solver in SOLVERS:
        yield from solved(motion, solver)


def groups(motion, number):
    """Yield the name of each group and an iterator over its results for a motion."""
    for solver in SOLVERS:
        yield solver, solved(motion, solver)
    for solver in ('exact', 'auto', 'taylor'):
        yield f'coast {solver}', coasted(motion, solver)
    yield 'euler', euler_angles(motion)
    solver = SOLVERS[number % len(SOLVERS)]
    yield 'propagator', asked_in_any_order(motion, solver, number)
    yield 'streaming', streamed(motion, solver, number)
    if motion.fields:
        motion = under_fields(motion)
        yield 'fields', solved_by_all(motion)
        yield 'fields propagator', asked_in_any_order(motion, solver, number)
        yield 'fields streaming', streamed(motion, solver, number)


def add(digest, arrays):
    """Add arrays to a hash, or a mark if the motion is rejected; return whether it is rejected."""
    try:
        for array in arrays:
            digest.update(np.ascontiguousarray(array).tobytes())
    except ValueError:
        digest.update(b'refused')
        return True
    return False


def main():
    """Print the hash of every group, and of all groups."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--count', type=int, default=COUNT, help=f'motions; {COUNT} by default')
    digests, refused = {}, {}
    for number in range(parser.parse_args().count):
        for name, arrays in groups(random_motion(number), number):
            digest = digests.setdefault(name, hashlib.sha256())
            refused[name] = refused.get(name, 0) + add(digest, arrays)
    for name, digest in digests.items():
        print(f'{name:17} {digest.hexdigest()}  ({refused[name]} refused)')
    print(f'{"all":17} '
          f'{hashlib.sha256(b"".join(d.digest() for d in digests.values())).hexdigest()}')


if __name__ == '__main__':
    main()
