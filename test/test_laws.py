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
The laws that hold under every term: the same bits live and offline, in any order, in pieces.

A scene is named after its terms. Every law is tested on every scene to which it applies.
"""

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

from conftest import at_night, chord, SECOND
import numpy as np
from parts import BODY, DAMPED, FIELDS, FREE, LIMITED, SLOWED, SMALLER
import pytest
from rigid_body_ros import (
    Actuator,
    BodyLog,
    EffortLog,
    GravityGradient,
    Problem,
    State,
    TorqueLog,
    UniformField,
)
from rigid_body_ros.engine import layout
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation import Integration, timeline
from terms import applied, calls, live, numbers

BEGIN, END = 1_767_225_600_123_456_789, 1_767_225_603_123_456_789
STAMPS = BEGIN + np.arange(-2, 23) * 130_000_000
ROTORS = (0.2, 0.4, -0.3)
START = State(BEGIN, (0.1, -0.3, 0.2, 0.9), (0.5, -0.7, 0.9))
LAG = Actuator(0.05, 0.02, (0.8, 0.0, 0.5)), None, Actuator(0.02, 0.1)


def torque_log(random, stamps=STAMPS, frame=None, interpolation='hold'):
    """Return a log in which some torques are zero, and some are those of the sample before."""
    torques = random.normal(size=(len(stamps), 3)) * (random.random((len(stamps), 1)) > 0.4)
    for row in np.flatnonzero(random.random(len(stamps) - 1) > 0.7) + 1:
        torques[row] = torques[row - 1]
    frames = np.where(random.random(len(stamps)) > 0.5, 'space', 'body').tolist()
    return TorqueLog(stamps, torques, frame or frames, interpolation)


def sources(random, **options):
    """Return three logs with some common stamps, so that the order of their sum matters."""
    return [torque_log(random, frame='body', **options),
            torque_log(random, STAMPS[::3] + 12_345, 'space', **options),
            torque_log(random, np.union1d(STAMPS[::5], random.integers(BEGIN, END, 9)),
                       None if not options else 'body', **options)]


def rotors(random):
    return {'start': replace(START, rotor_momentum=ROTORS), 'body': DAMPED,
            'log': sources(random), 'wheels': torque_log(random, STAMPS[::2] + 777, 'body')}


def commanded(random, wheels):
    """Return wheels with commands, of which a third are missing; some have stamps of torques."""
    stamps = np.union1d(STAMPS[::2], random.integers(BEGIN - SECOND // 4, END, 9))
    efforts = random.normal(0.0, 0.4, (len(stamps), len(wheels)))
    efforts[random.random(efforts.shape) < 0.3] = np.nan
    return {'start': replace(START, rotor_momentum=ROTORS), 'log': sources(random)[:2],
            'wheels': wheels, 'efforts': EffortLog(stamps, efforts), 'fields': FIELDS[:1]}


def changing(keep, given):
    """Return what is given with a body that changes, at and between the stamps of torques."""
    return {**given, 'changes': BodyLog(
        [STAMPS[5], STAMPS[12] + 12_345, STAMPS[15], BEGIN + 2_345_678_901],
        [SMALLER, BODY, DAMPED, SMALLER], keep)}


def coasting(random):
    """Return small torques with coasts between them in which the body turns many times."""
    stamps = np.sort(BEGIN + random.integers(-SECOND // 2, 60 * SECOND, 12))
    log = torque_log(random, stamps)
    return {'log': log.with_torques(0.1 * log.torques)}


def everything(random, keep, wheels):
    """Return the torques of actuators, wheels and a body that changes, without fields."""
    return {**changing(keep, commanded(random, wheels)), 'log': sources(random), 'fields': (),
            'actuator': LAG}


#: What acts in each scene.
TERMS = {
    'torques': lambda random: {'log': torque_log(random)},
    'coasts': coasting,
    'sources': lambda random: {'log': sources(random)},
    'same stamps': lambda random: {'wheels': torque_log(random, frame='body'), 'log': [
        torque_log(random, frame=frame) for frame in ('body', 'space', 'body')]},
    'linear': lambda random: {'log': sources(random, interpolation='linear')},
    'cubic': lambda random: {'log': sources(random, interpolation='cubic')},
    'rotors': rotors,
    'fields': lambda random: {**rotors(random), 'fields': FIELDS},
    'fields alone': lambda random: {'log': sources(random), 'fields': FIELDS},
    'kept rate': lambda random: changing('rate', {**rotors(random), 'fields': FIELDS}),
    'kept momentum': lambda random: changing('momentum', {**rotors(random), 'fields': FIELDS}),
    'wheels': lambda random: changing('rate', commanded(random, FREE)),
    'limited wheels': lambda random: changing('momentum', commanded(random, LIMITED)),
    'slowed wheels': lambda random: changing('rate', commanded(random, SLOWED)),
    **{f'actuator, {name}': lambda random, actuator=actuator: {
        'log': sources(random), 'actuator': actuator} for name, actuator in (
            ('delay', Actuator(0.07)), ('limit', Actuator(limit=(0.8, 0.0, 0.3))),
            ('lag', Actuator(0.0, 0.08)), ('short lag', Actuator(0.013, 2e-4, (0.8, 0.5, 0.3))),
            ('long lag', Actuator(0.013, 30.0)), ('each its own', LAG),
            ('one lag of two', (Actuator(0.05, 0.02), Actuator(0.0, 0.02), None)))},
    **{f'all, {name}': lambda random, keep=keep, wheels=wheels: everything(random, keep, wheels)
       for name, keep, wheels in (('kept rate', 'rate', LIMITED), ('free', 'momentum', FREE),
                                  ('kept momentum', 'momentum', SLOWED))},
}
#: Options by name.
WAYS = {'auto': {}, 'taylor': {'solver': 'taylor'}, 'loose': {'tolerance': 1e-6},
        'short': {'tolerance': 1e-6, 'max_step': 5e-3},
        **{name: {'solver': name, 'max_step': 0.01}
           for name in ('rk4', 'strang', 'explicit_euler')}}


class Scene(NamedTuple):
    """A scene: its terms, options, timeout, s, and the seed of its numbers and of the order."""

    terms: str
    way: str = 'auto'
    timeout: float = 0.0
    seed: int = 0

    def __str__(self):
        return f'{self.terms}, {self.way}, {self.timeout}, {self.seed}'

    def problem(self):
        random = np.random.default_rng([len(self.terms), self.seed])
        return Problem(**{'body': BODY, 'start': START, **TERMS[self.terms](random)},
                       **WAYS[self.way], torque_timeout=self.timeout)


@lru_cache
def computed(scene):
    """Return the problem of a scene, times in no order, and the motion at these times."""
    problem, random = scene.problem(), np.random.default_rng([3, scene.seed])
    last = max(END, int(problem.stamps_ns[-1])) + SECOND
    stamps = problem.stamps_ns[problem.stamps_ns >= BEGIN]
    at = np.concatenate([random.integers(BEGIN, last, 20), random.permutation(stamps)[:20]])
    return problem, at, problem.propagate(at=at)


LIVE = [
    *[Scene('torques', *way) for way in (
        ('auto', 0.0), ('auto', 0.03), ('taylor', 0.4), ('strang', 0.03), ('loose', 0.03),
        ('short', 0.0))],
    *[Scene('coasts', *way) for way in (('auto', 0.0), ('auto', 5.0), ('taylor', 0.05))],
    *[Scene('sources', *way) for way in (
        ('auto', 0.03), ('rk4', 0.4), ('strang', 0.0), ('explicit_euler', 0.03))],
    Scene('same stamps'), Scene('same stamps', 'rk4', 0.1),
    *[Scene('rotors', *way) for way in (('auto', 0.0), ('taylor', 0.03), ('rk4', 0.4))],
    *[Scene('fields', *way) for way in (('auto', 0.07), ('rk4', 0.0), ('explicit_euler', 0.07))],
    Scene('fields alone', 'auto'), Scene('fields alone', 'strang', 0.07),
    *[Scene('kept rate', *way) for way in (('auto', 0.12), ('explicit_euler', 0.0))],
    *[Scene('kept momentum', *way) for way in (('taylor', 0.0), ('rk4', 0.12))],
    *[Scene('wheels', *way) for way in (('auto', 0.12), ('rk4', 0.0), ('explicit_euler', 0.12))],
    Scene('limited wheels', 'auto', 0.12), Scene('limited wheels', 'taylor'),
    Scene('slowed wheels', 'auto', 0.1), Scene('slowed wheels', 'taylor'),
    *[Scene(terms, 'auto', 0.3) for terms in TERMS if terms.startswith('actuator')],
    Scene('actuator, each its own', 'rk4', 0.04), Scene('actuator, lag', 'auto'),
    *[Scene(terms, solver, 0.04) for terms, solver in (
        ('all, kept rate', 'auto'), ('all, free', 'rk4'), ('all, kept momentum', 'auto'))]]
NIGHT = [*(scene for terms, way, *_ in LIVE for timeout in (0.0, 0.04, 0.3)
           if terms.startswith(('actuator', 'all'))
           and (scene := Scene(terms, way, timeout)) not in LIVE),
         *(Scene(terms, 'auto', timeout, seed) for seed in range(1, 11)
           for terms in ('coasts', 'sources', 'rotors', 'wheels') for timeout in (0.0, 0.03))]
OFFLINE = [*LIVE, *[Scene(terms, solver, timeout) for terms in ('linear', 'cubic')
                    for solver, timeout in (('auto', 0.0), ('rk4', 0.12))]]
each_live = pytest.mark.parametrize('scene', [*LIVE, *at_night(*[(one,) for one in NIGHT])],
                                    ids=str)
each_offline = pytest.mark.parametrize('scene', OFFLINE, ids=str)


def assert_states(propagator, at, motion):
    """Assert that a propagator returns the states of a motion at times."""
    np.testing.assert_array_equal(
        np.array([numbers(propagator.at(time_ns)) for time_ns in at.tolist()]), numbers(motion))


@pytest.mark.slow
@each_live
def test_any_order_of_arrival_and_any_questions_give_the_bits_of_the_logs(scene):
    problem, at, motion = computed(scene)
    random, arriving = np.random.default_rng([45, scene.seed]), calls(problem)
    propagator = live(problem)
    for row in random.permutation(len(arriving)):
        name, time_ns, *rest = arriving[row]
        if name == 'apply' and not row % 4:  # replaced by what comes later
            propagator.apply(time_ns, random.normal(size=3), *rest[1:])
        assert applied(propagator, arriving[row])
        if not row % 7:
            propagator.at(int(random.integers(BEGIN, END)))  # a prediction changes no bit
    assert_states(propagator, at, motion)
    assert propagator.stamps(BEGIN, END) == [
        stamp for stamp in problem.stamps_ns.tolist() if BEGIN < stamp <= END]


@pytest.mark.slow
@each_live
def test_a_state_older_than_the_history_is_final(scene):
    problem, at, motion = computed(scene)
    random, arriving, history_ns = np.random.default_rng([4, scene.seed]), calls(problem), SECOND
    propagator, newest, states = live(problem, history=history_ns / SECOND), BEGIN, {}
    due = [call[1] + random.integers(0, history_ns) for call in arriving]
    for row in np.argsort(due, kind='stable'):
        newest = max(newest, arriving[row][1])
        for time_ns in at[at <= newest - history_ns].tolist():
            if time_ns not in states:
                states[time_ns] = propagator.at(time_ns)
        assert applied(propagator, arriving[row])
        for asked in newest + random.integers(-SECOND, SECOND, random.integers(0, 3)):
            propagator.at(max(int(asked), propagator.earliest_ns))
    assert states
    found = [numbers(states.get(time_ns) or propagator.at(time_ns)) for time_ns in at.tolist()]
    np.testing.assert_array_equal(np.array(found), numbers(motion))


@pytest.mark.slow
@each_live
def test_a_motion_restarted_at_any_time_continues_with_the_same_bits(scene):
    problem, at, motion = computed(scene)
    whole, random = live(problem), np.random.default_rng([5, scene.seed])
    for call in calls(problem):
        assert applied(whole, call)
    early = at[at < at.max() - SECOND // 2]  # so that some times are later
    for time_ns in [*random.choice(early, 2), int(STAMPS[7]), int(STAMPS[15])]:
        middle = whole.at(int(time_ns))
        middle = whole.at(int(middle.time_ns + random.integers(0, SECOND // 2)))
        later = at >= middle.time_ns
        rests = [problem.replaced(start=middle)]
        if not problem.lagging():  # the sum of what lags is rounded otherwise
            rests.append(problem.between(middle, int(at.max())))
        for rest in rests:
            np.testing.assert_array_equal(numbers(rest.propagate(at=at[later])),
                                          numbers(motion)[later])
        if problem.lagging():  # a propagator does not know what acted before its start
            continue
        resumed = live(problem, middle)
        for call in calls(problem):
            assert applied(resumed, call)
        assert_states(resumed, at[later], problem.propagate(at=at[later]))


@pytest.mark.slow
@each_offline
def test_requested_times_and_pauses_of_the_kernels_change_no_bit(scene, monkeypatch):
    problem, at, motion = computed(scene)
    for row in range(0, len(at), 5):
        np.testing.assert_array_equal(numbers(problem.propagate(at=[at[row]]))[0],
                                      numbers(motion)[row])
    # The search for the time at which a wheel with friction reaches its limit is not interrupted.
    monkeypatch.setattr(layout, 'BUDGET', 20 if problem.is_coupled else 2)
    monkeypatch.setattr(timeline, '_CHUNK', 3)
    np.testing.assert_array_equal(numbers(problem.propagate(at=at)), numbers(motion))


@pytest.mark.slow
@pytest.mark.parametrize('scene', [
    scene for scene in OFFLINE if not scene.terms.startswith(('actuator', 'all'))], ids=str)
def test_a_motion_in_pieces_has_the_same_bits(scene):
    problem, at, motion = computed(scene)
    order, stamps = np.argsort(at, kind='stable'), problem.stamps_ns
    ends = [int(end) for end in stamps[stamps > BEGIN][[1, 5, 6, -9]]]
    run, found, rest, begin = None, [], at[order], BEGIN
    for end in [*ends, None]:
        last = end or int(at.max())
        piece = problem.replaced(
            log=[log.between(begin, last) for log in problem.logs],
            wheels=problem.wheels and problem.wheels.between(begin, last),
            efforts=problem.efforts and problem.efforts.between(begin, last))
        if run:
            run.extend(piece)
        else:
            run = Integration(piece)
            run.advance([])  # changes nothing
        asked = rest[rest <= last]
        found.append(numbers(run.advance(asked, end)))
        if end in asked:  # the end may be requested again
            np.testing.assert_array_equal(numbers(run.advance([end, end], end)),
                                          found[-1][[-1, -1]])
        rest, begin = rest[len(asked):], end
    np.testing.assert_array_equal(np.concatenate(found), numbers(motion)[order])


@pytest.mark.parametrize('scene', [
    Scene('linear', 'auto', 0.12), Scene('fields', 'auto', 0.07), Scene('kept momentum', 'taylor'),
    Scene('wheels', 'auto', 0.12), Scene('all, kept rate', 'auto', 0.04)], ids=str)
def test_turned_space_axes_give_the_turned_motion(scene):
    problem, at, motion = computed(scene)
    turn = so3.normalize([0.3, -0.1, 0.7, 0.4])
    logs = [log.with_torques(np.where(log.in_space[:, None], so3.rotate(turn, log.torques),
                                      log.torques)) for log in problem.logs]
    fields = [UniformField(one.moment, so3.rotate(turn, one.field)) if hasattr(one, 'moment')
              else GravityGradient(one.mean_motion, so3.rotate(turn, one.position),
                                   so3.rotate(turn, one.normal)) for one in problem.fields]
    start = replace(problem.start, attitude=so3.multiply(turn, problem.start.attitude))
    found = problem.replaced(start=start, log=logs, fields=fields).propagate(at=at)
    assert chord(so3.multiply(turn, motion.attitude), found.attitude).max() < 2e-14
    assert abs(found.angular_velocity - motion.angular_velocity).max() < 2e-14
