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
Write `test/vectors.txt`: motions with their exact inputs and outputs.

    python benchmarks/make_vectors.py

`docs/vectors.md` describes the file. It contains the results of the engine that wrote it. Write it
again only if a change of the results is intended, and check what changes. The inputs of new
motions are drawn with fixed seeds. The inputs of motions that are already in the file are kept,
because their last bits depend on the processor that draws them.
"""

from collections.abc import Iterator
from itertools import cycle
import re
import sys
from typing import NamedTuple

import bits
import numpy as np
from rigid_body_ros import GravityGradient, Problem, RigidBody, State, TorqueLog, UniformField
from rigid_body_ros.common.arrays import entries
from vectors import alone, Motion, OPTIONS, Output, read, VECTORS

sys.path.insert(0, str(VECTORS.parent))
from scenes import FIXED_STEP, FULL, FULL_RATES, Scene, SCENES  # noqa: E402, I100

HEADER = """\
# Motions of rigid bodies: inputs, and the outputs that every implementation has to return, to the
# last bit. docs/vectors.md describes the lines; benchmarks/make_vectors.py wrote them.
"""
SEED = 20261124
SECOND = 10 ** 9
#: Number of random motions, and of motions without torque.
RANDOM, COASTS = 90, 18
#: Number of random motions under fields, and the number of the first of them.
WITH_FIELDS, FIRST_WITH_FIELDS = 16, 6000
#: Number of motions in a group: more than the lanes of an AVX-512 register, and not a multiple.
TOGETHER = 9
#: Number of samples of the longest log, 1 ms apart.
STREAM = 2000
#: rad; solvers with steps compute at most about this much.
LONGEST = 40.0


class Case(NamedTuple):
    """A motion to compute: its name, its problem, the times of its states, ns, and its group."""

    name: str
    problem: Problem
    at: np.ndarray
    group: str = ''


def scenes() -> Iterator[Case]:
    """Yield the scenes of the tests, each with one of its suitable solvers."""
    for number, scene in enumerate(SCENES):
        solvers = [solver for solver in scene.solvers if suits(scene, solver)]
        solver = solvers[number % len(solvers)]
        step = float(scene.step) if solver in FIXED_STEP else None
        at = np.unique([*scene.times_ns.tolist()[-2:], int(scene.times_ns[-1]) // 1000])
        yield Case(f'{scene.name}, {solver}',
                   Problem(scene.body, scene.start, scene.log, solver=solver, max_step=step), at)


def suits(scene: Scene, solver: str) -> bool:
    """Return whether a solver needs only a few steps for a scene."""
    if solver in ('exact', 'auto'):
        return True
    return scene.phase < 2.0 * LONGEST and (solver not in FIXED_STEP or scene.steps < 500)


def random_motions() -> Iterator[Case]:
    """Yield random motions with any body, start and torques, every solver, and all terms."""
    for number, solver in zip(range(RANDOM), cycle(bits.SOLVERS)):
        random = np.random.default_rng((SEED, number))
        motion = bits.random_motion(number)
        logs = [some_of(random, motion.log)]
        start, options = motion.start, motion.solver_options(solver)
        body, wheels, terms = motion.body, None, ''
        if number % 3 == 1:
            logs.append(some_of(random, bits.random_log(random, body, start)))
            terms += ', two sources'
        if number % 4 in (1, 2) and solver != 'strang':
            start = with_rotors(random, start, body)
            wheels = logs[0].with_torques(-0.3 * logs[0].torques[::-1])
            wheels = TorqueLog(wheels.times_ns, wheels.torques, 'body', wheels.interpolation)
            terms += ', wheels'
        if number % 4 in (2, 3) and solver != 'strang':
            body = damped(random, body)
            terms += ', damping'
        problem = Problem(body, start, logs, wheels=wheels, **options)
        yield Case(f'random {number}, {solver}, {logs[0].interpolation}{terms}', problem,
                   some_times(random, problem))


def under_fields() -> Iterator[Case]:
    """Yield random motions under fields, and a group of such motions."""
    for number, solver in zip(range(WITH_FIELDS), cycle(bits.SOLVERS)):
        random = np.random.default_rng((SEED, FIRST_WITH_FIELDS + number))
        motion = bits.random_motion(FIRST_WITH_FIELDS + number)
        body, start, logs, terms = motion.body, motion.start, [], ''
        if number % 3:
            logs = [some_of(random, motion.log)]
            terms += f', {logs[0].interpolation}'
        if number % 4 in (1, 2) and solver != 'strang':
            start = with_rotors(random, start, body)
            terms += ', rotors'
        if number % 4 in (2, 3) and solver != 'strang':
            body = damped(random, body)
            terms += ', damping'
        problem = Problem(body, start, logs, fields=motion.fields,
                          **motion.solver_options(solver))
        orbits = sum(isinstance(one, GravityGradient) for one in motion.fields)
        yield Case(f'fields {number}, {solver}, {len(motion.fields) - orbits} uniform'
                   + ', orbit' * orbits + terms, problem, some_times(random, problem))
    for number in range(TOGETHER):
        random = np.random.default_rng((SEED, FIRST_WITH_FIELDS, number))
        body, start = rotated(random), State(0, random.normal(size=4), random.normal(size=3))
        down = np.array([0.0, 0.0, -9.81])
        fields = [UniformField(0.125 * random.normal(size=3), down),
                  GravityGradient(0.5, random.normal(size=3) * [1.0, 1.0, 0.0])]
        yield Case(f'group fields, auto, {number}',
                   Problem(body, start, held(number), fields=fields),
                   np.array([SECOND // 3, 3 * SECOND]), 'fields, auto')


def some_of(random: np.random.Generator, log: TorqueLog) -> TorqueLog:
    """Return a few consecutive samples of a log."""
    first = random.integers(6)
    return log.rows(slice(first, first + random.integers(4, 11)))


def with_rotors(random: np.random.Generator, start: State, body: RigidBody) -> State:
    """Return the start with spinning rotors."""
    speed = 0.1 + np.linalg.norm(start.angular_velocity)
    momentum = 0.5 * body.angular_momentum(speed * random.normal(size=3))
    return State(start.time_ns, start.attitude, start.angular_velocity, momentum)


def damped(random: np.random.Generator, body: RigidBody) -> RigidBody:
    """Return the body with damping that stops it within seconds or minutes."""
    rows = random.normal(size=(3, 3))
    share = 10.0 ** random.uniform(-3.0, -1.0) * body.principal_moments[0]
    return RigidBody(body.inertia, share * (rows @ rows.T))


def some_times(random: np.random.Generator, problem: Problem) -> np.ndarray:
    """Return times between stamps, at a stamp, and after the last, for some motions unsorted."""
    start_ns = problem.start.time_ns
    speed = 0.1 + np.linalg.norm(problem.start.angular_velocity)
    latest_ns = start_ns + int(LONGEST / speed * SECOND)
    stamps = problem.logs[0].times_ns if problem.logs else np.array([latest_ns])
    end_ns = min(int(stamps[-1]) + SECOND // 4, latest_ns)
    inside = stamps[(stamps > start_ns) & (stamps < end_ns)]
    at = [*random.integers(start_ns, end_ns, 2), *inside[-1:], end_ns]
    return np.sort(at) if random.random() < 0.5 else np.array(at)


def coasts() -> Iterator[Case]:
    """Yield motions without torque of up to a day, at times that halve repeatedly."""
    for number, solver in zip(range(COASTS), cycle(('exact', 'auto', 'taylor'))):
        motion = bits.random_motion(1000 + number)
        speed = 0.1 + np.linalg.norm(motion.start.angular_velocity)
        seconds = LONGEST / speed if solver == 'taylor' else 86400.0
        at = motion.start.time_ns + (int(seconds * SECOND) >> np.array([27, 9, 0]))
        yield Case(f'coast {number}, {solver}',
                   Problem(motion.body, motion.start, solver=solver,
                           tolerance=motion.options['tolerance']), at)


def groups() -> Iterator[Case]:
    """Yield groups of motions with equal options and times; their bodies are alike or differ."""
    for name, solver, log in (('no torque', 'taylor', None), ('no torque', 'auto', None),
                              ('one log', 'auto', held(0)),
                              ('space axes', 'taylor', held(0, 'space')),
                              ('logs of their own', 'taylor', held), ('damping', 'auto', held(0)),
                              ('one log', 'rk4', held(0))):
        random = np.random.default_rng((SEED, len(name), len(solver)))
        for number in range(TOGETHER):
            body = rotated(random) if name != 'space axes' else RigidBody(np.diag([1.0, 2.0, 2.5]))
            body = damped(random, body) if name == 'damping' and number % 2 else body
            start = State(0, random.normal(size=4), 0.5 * random.normal(size=3))
            own = log(number) if callable(log) else log
            yield Case(f'group {name}, {solver}, {number}',
                       Problem(body, start, own, solver=solver,
                               max_step=0.125 if solver == 'rk4' else None),
                       np.array([SECOND // 3, 3 * SECOND]), f'{name}, {solver}')


def held(number: int, frame: str = 'body') -> TorqueLog:
    """Return held torques with short numbers, at the same stamps for every motion."""
    random = np.random.default_rng((SEED, number))
    torques = np.round(random.normal(size=(6, 3)) * 16.0) / 64.0
    torques[3] = 0.0
    return TorqueLog(np.arange(6) * 400_000_000, torques, frame)


def rotated(random: np.random.Generator) -> RigidBody:
    """Return a body with a full tensor."""
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    return RigidBody(turn * [1.0, 1.0 + random.random(), 2.0] @ turn.T)


def stream() -> Iterator[Case]:
    """Yield motions under torques at 1 kHz with short numbers and timeouts, for two solvers."""
    random = np.random.default_rng(SEED)
    stamps = np.arange(STREAM) * (SECOND // 1000)
    stamps[STREAM // 2:] += SECOND
    log = TorqueLog(stamps, np.round(random.normal(size=(STREAM, 3)) * 16.0) / 64.0)
    yield Case('two seconds at 1 kHz', Problem(
        RigidBody(FULL), State(angular_velocity=FULL_RATES), log, torque_timeout=0.02),
        np.array([1, SECOND, 2 * SECOND, 3 * SECOND, 4 * SECOND]))


def as_known(case: Case, known: dict[str, Motion]) -> Case:
    """Return a case with the inputs of the known motion of that name, if there is one."""
    if case.name not in known:
        return case
    motion = known[case.name]
    return case._replace(problem=motion.problem, at=np.array(motion.times_ns))


def lines(case: Case, sequence: str) -> Iterator[str]:
    """Yield the lines of a motion, with Euler angles of its last state in a given sequence."""
    problem, options = case.problem, case.problem.options
    yield f'motion {case.name}'
    if case.group:
        yield f'group {case.group}'
    yield f'solver {options.solver}'
    for name in OPTIONS:
        if getattr(options, name):
            yield line(name, [getattr(options, name)])
    yield line('inertia', entries(problem.body.inertia))
    if problem.body.is_damped:
        yield line('damping', entries(problem.body.damping))
    start = problem.start
    yield line(f'start {start.time_ns}', [*start.attitude, *start.angular_velocity])
    if start.rotor_momentum.any():
        yield line('rotor_momentum', start.rotor_momentum)
    for field in problem.fields:
        if isinstance(field, UniformField):
            yield line('uniform_field', [*field.moment, *field.field])
        else:
            yield line(f'orbit {field.time_ns}',
                       [field.mean_motion, *field.position, *field.normal])
    logs = [('source', log) for log in problem.logs]
    for key, log in [*logs, ('wheels', problem.wheels)] if problem.wheels else logs:
        yield f'{key} {log.interpolation}'
        for time_ns, in_space, torque in zip(log.times_ns, log.in_space, log.torques):
            yield line(f'torque {time_ns} {"space" if in_space else "body"}', torque)
    for key, time_ns, numbers in alone(Motion('', '', problem, outputs(case, sequence))):
        yield line(f'{key} {time_ns}' if key == 'state' else key, numbers)


def outputs(case: Case, sequence: str) -> list[Output]:
    """Return the keys and times of a motion's outputs, without numbers."""
    keys = ['state', 'rotor_momentum'] if case.problem.has_rotors else ['state']
    found = [Output(key, time_ns, ()) for time_ns in case.at.tolist() for key in keys]
    return [*found, Output(f'euler {sequence}', found[-1].time_ns, ())]


def line(start: str, numbers: list[float]) -> str:
    """Return a line that ends with hexadecimal numbers without trailing zeros."""
    return ' '.join([start, *(re.sub(r'\.?0+p', 'p', float(number).hex()) for number in numbers)])


def main() -> None:
    """Write the file, except for random motions that their solver rejects."""
    blocks = [HEADER.strip()]
    known = {motion.name: motion for motion in read()} if VECTORS.exists() else {}
    for case, sequence in zip(
            [*scenes(), *random_motions(), *coasts(), *groups(), *stream(),
             *under_fields()],
            cycle(bits.SEQUENCES)):
        try:
            blocks.append('\n'.join(lines(as_known(case, known), sequence)))
        except ValueError as error:
            print(f'left out: {case.name}: {error}')
    VECTORS.write_text('\n\n'.join(blocks) + '\n', encoding='ascii')
    print(f'{len(blocks) - 1} motions, {VECTORS.stat().st_size // 1000} kB')


if __name__ == '__main__':
    main()
