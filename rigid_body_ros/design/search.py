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

"""Search for the maneuver after which an identification knows most, and report it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import as_json, Floats
from rigid_body_ros.design.information import Expected, Instrument, Question
from rigid_body_ros.design.maneuver import ANGLE, commands_of, FINE, Maneuvers
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.text_files import csv_lines
from rigid_body_ros.recording.writer import ANGULAR_VELOCITY, ATTITUDE, Column, Writer
from rigid_body_ros.report import moving_body
from rigid_body_ros.report.charts import Curves, Panel, RATES, TORQUES
from rigid_body_ros.report.report import Report, table
from rigid_body_ros.report.text import aligned, lines, numbers
from rigid_body_ros.runtime import files
from rigid_body_ros.runtime.terminal import no_progress, Track
from rigid_body_ros.scene import Scene
from rigid_body_ros.scene.quantities import components_of, quantity_of

#: Maneuvers in a population of the search, the number of maneuvers that it tries in all, and the
#: number that it tries to find out what another limit or sensor would tell.
_POPULATION, _TRIALS, _OTHERS = 24, 4080, 240
#: Size of the changes from which a search for an alternative begins, relative to the bounds.
_NEAR = 0.05
#: Number of bodies, drawn from a prior of the inertia, for which a maneuver is also good.
_DRAWS = 3
#: The search computes torques and samples at no more than these rates, Hz, but in a short flight
#: it computes at least so many samples.
_TORQUE_HZ, _SENSOR_HZ, _SAMPLES = 20.0, 5.0, 20.0
#: A limit is named as one that limits the maneuver if its load is above this number.
_ACTIVE = 0.98
#: The first line of a CSV file.
_HEADING = 'time_ns,tx (Nm),ty (Nm),tz (Nm),qx,qy,qz,qw,wx (rad/s),wy (rad/s),wz (rad/s)\n'


def design(maneuvers: Maneuvers, question: Question, track: Track = no_progress) -> Design:
    """
    Find the maneuver after which an identification knows most.

    Raises
    ------
    ValueError
        The question asks for something that the vehicle or the sensors do not have.

    """
    some = maneuvers.flown(maneuvers.motion(maneuvers.bounds[:, 1]))
    bodies = _bodies(some.body, question.expected(some, maneuvers.seconds))
    best, flown, expected = _best(maneuvers, question, bodies, track)
    flights = [('', flown, expected)]
    for name, motion in maneuvers.usual():
        flown = maneuvers.held(motion, bodies)
        flights.append((name, flown, question.expected(flown, maneuvers.seconds)))
    flights.sort(key=lambda flight: -flight[2].cost(question.criterion))  # the best comes last
    others = {name: _best(*other, bodies[:1], track, best)[2]
              for name, other in _alternatives(maneuvers, question)}
    usual = {name: expected for name, _, expected in flights if name}
    return Design(maneuvers, question, *flights[-1][1:], usual, others)


def _bodies(body: RigidBody, known: Expected) -> list[RigidBody]:
    """Return the body and, if its inertia has a prior, some bodies drawn from the prior."""
    sigmas = np.array([known.priors[name].sigma if name in known.priors else 0.0
                       for name in components_of('inertia')])
    random, bodies = np.random.default_rng(0), [body]
    while sigmas.any() and len(bodies) <= _DRAWS:
        with suppress(ValueError):  # an impossible body
            bodies.append(body.with_entries(body.entries + sigmas * random.standard_normal(6)))
    return bodies


def _best(maneuvers: Maneuvers, question: Question, bodies: list[RigidBody], track: Track,
          near: Floats | None = None) -> tuple[Floats, Problem, Expected]:
    """Return the numbers and the flight of the best maneuver, and what it tells."""
    from scipy.optimize import differential_evolution  # slow to import
    least_hz = _SAMPLES / maneuvers.seconds
    quick = replace(maneuvers, hz=min(maneuvers.hz, max(_TORQUE_HZ, least_hz)))
    sensor_hz = max(_SENSOR_HZ, least_hz)
    bounds, random = quick.bounds, np.random.default_rng(0)
    trials = _OTHERS if near is not None else _TRIALS // len(bodies)
    first = random.random((_POPULATION, len(bounds))) if near is None else \
        (near - bounds[:, 0]) / np.ptp(bounds, axis=1) + _NEAR * np.vstack([
            0.0 * near, random.standard_normal((_POPULATION - 1, len(near)))])
    steps = iter(track(range(trials), trials))

    def cost(trial: Floats) -> float:
        next(steps, None)
        flown = quick.flown(quick.motion(trial))
        return max(question.expected(flown.replaced(body=body), maneuvers.seconds, sensor_hz)
                   .cost(question.criterion) for body in bodies)
    found = differential_evolution(
        cost, bounds, init=bounds[:, 0] + np.clip(first, 0.0, 1.0) * np.ptp(bounds, axis=1),
        strategy='currenttobest1bin', recombination=0.9, maxiter=trials // _POPULATION - 1,
        tol=0.0, polish=False, seed=0).x
    flown = maneuvers.held(maneuvers.motion(found), bodies)
    return found, flown, question.expected(flown, maneuvers.seconds)


def _alternatives(maneuvers: Maneuvers, question: Question
                  ) -> Iterator[tuple[str, tuple[Maneuvers, Question]]]:
    """Generate what may tell more: more time, a larger angle, and another quantity."""
    yield 'twice as long', (replace(maneuvers, seconds=2.0 * maneuvers.seconds), question)
    if np.isfinite(maneuvers.limits[ANGLE]).all():
        limits = {**maneuvers.limits, ANGLE: 1.5 * maneuvers.limits[ANGLE]}
        yield 'angle x 1.5', (replace(maneuvers, limits=limits), question)
    first = question.sensors[0]
    if all(sensor.is_attitude == first.is_attitude for sensor in question.sensors):
        what = 'rates' if first.is_attitude else 'attitude'
        sensor = Instrument(f'/{what}', not first.is_attitude, first.noise, first.hz)
        yield f'{what} too', (maneuvers, replace(question, sensors=[*question.sensors, sensor]))


@dataclass(frozen=True, eq=False)
class Design:
    """
    A maneuver, and what an identification will know after it.

    Attributes
    ----------
    maneuvers : Maneuvers
    question : Question
    flown : Problem
        The flight.
    expected : Expected
    usual, others : dict of str to Expected
        What the usual maneuvers tell within the same limits, and what may tell more.

    """

    maneuvers: Maneuvers
    question: Question
    flown: Problem
    expected: Expected
    usual: Mapping[str, Expected]
    others: Mapping[str, Expected]

    @property
    def every(self) -> dict[str, Expected]:
        """Return the expected intervals of all maneuvers, by name."""
        return {'designed': self.expected, **self.usual, **self.others}

    @property
    def headline(self) -> str:
        """Return what is not determined, or how wide the widest interval is."""
        if names := self.expected.unknown_names:
            return f'no maneuver within these limits determines {", ".join(names)}'
        widest, (name, best) = self.expected.widest, min(
            self.usual.items(), key=lambda pair: pair[1].widest)
        compared = f'after a {name} within {100.0 * best.widest:.2g} %' \
            if np.isfinite(best.widest) else 'which no usual maneuver achieves'
        return f'all intervals within {100.0 * widest:.2g} % of their scales, {compared}'

    def as_dict(self) -> dict[str, Any]:
        """Return the result as JSON types, with None for intervals that are not known."""
        return {
            'values': dict(zip(self.expected.names, self.expected.values.tolist())),
            'half_widths_95': {name: dict(zip(one.names, as_json(one.half_widths)))
                               for name, one in self.every.items()},
            'unidentifiable': [asdict(one) for one in self.expected.unknown],
            'initial_angular_velocity_rad_s': self.flown.start.angular_velocity.tolist(),
            'loads': self.maneuvers.loads(self.flown, FINE)}

    def text(self) -> str:
        """Return the facts, and a table of the expected intervals."""
        return lines([*(f'{name:17}{text}' for name, text in self.rows()),
                      *aligned(self.table())])

    def table(self) -> list[list[str]]:
        """Return a table of the half-widths of the expected intervals, with a header."""
        return [['parameter', 'value', *self.every, 'unit'], *(
            [name, f'{value:.5g}', *(
                f'± {one.half_widths[k]:.2g}' if one.is_known[k] else 'unknown'
                for one in self.every.values()), quantity_of(name).unit]
            for k, (name, value) in enumerate(zip(self.expected.names, self.expected.values)))]

    def rows(self) -> Iterator[tuple[str, str]]:
        """Generate all facts but the table, each as a name and a text."""
        yield 'result', self.headline
        for direction in self.expected.unknown:
            yield 'not determined', f'{", ".join(direction.components)}: {direction.reason}'
        loads = self.maneuvers.loads(self.flown, FINE)
        yield 'limited by', ', '.join(name for name in sorted(loads) if loads[name] > _ACTIVE)
        if self.maneuvers.is_free:
            yield 'start', f'{numbers(self.flown.start.angular_velocity, 4)} rad/s, body axes'
        for topic, is_attitude, noise, hz in self.question.sensors:
            kind, unit = ('attitude', 'rad') if is_attitude else ('rates', 'rad/s')
            yield 'sensor', f'{topic}: {kind}, noise {noise:g} {unit} at {hz:g} Hz'

    def report(self, name: str) -> Report:
        """Return the report; `name` is that of the scene."""
        times_ns, wheels = self.maneuvers.times_ns, self.flown.named_wheels
        header, *rows = self.table()
        begin_ns, rates = int(times_ns[0]), self.flown.propagate(at=times_ns).angular_velocity
        panels = [Panel('angular velocity, body axes', 'rad/s', [Curves.thinned(
            times_ns, rates, RATES, begin_ns)])]
        if not self.maneuvers.is_free:
            panels.insert(0, Panel('torque', 'N m', [Curves.thinned(
                times_ns, commands_of(self.flown), wheels.names if wheels else TORQUES,
                begin_ns)]))
        return Report(f'{name}: a maneuver', self.headline, [*self.rows()], panels,
                      moving_body.of_motion(self.flown, times_ns), table=table(header, rows))

    def write(self, path: str, scene: Scene) -> None:
        """Write the torques and the motion, a reference for a controller, as MCAP or as .csv."""
        times_ns, commands = self.maneuvers.times_ns, commands_of(self.flown)
        motion, wheels = self.flown.propagate(at=times_ns), self.flown.named_wheels
        if path.lower().endswith('.csv'):
            values = np.hstack([commands, motion.attitude, motion.angular_velocity])
            with files.atomic_output(path, '.csv') as part:
                part.write_text(''.join([_HEADING, *csv_lines(times_ns, values)]), 'ascii')
            return
        topic, kind, values = (
            '/wheel_command', messages.joint_states(wheels.names),
            messages.joint_values(motion.wheel_speeds, commands)) if wheels else (
            f'/{scene.torque_topics[0].lstrip("/")}', messages.WRENCH,
            np.hstack([0.0 * commands, commands]))
        kinds = {topic: kind, f'/reference{ATTITUDE}': messages.QUATERNION,
                 f'/reference{ANGULAR_VELOCITY}': messages.VECTOR3}
        frames = scene.body_frame, scene.space_frame, scene.body_frame
        with Writer(path) as writer:
            for name, of_topic in kinds.items():
                writer.add_topic(name, of_topic)
            writer.write_columns(times_ns, [*map(Column, kinds, frames, (
                values, motion.attitude, motion.angular_velocity))])
