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

"""Which solver computed each span of a motion, and why."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Ints
from rigid_body_ros.engine import FREE
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.propagation.options import AUTO, EXACT, LONG_COAST, Options, TAYLOR
from rigid_body_ros.propagation.timeline import Timeline
from rigid_body_ros.propagation.wheels import WheelTimeline


class Model(NamedTuple):
    """The solver that computed a span of a motion, and why this solver was used."""

    solver: str
    start_ns: int
    end_ns: int
    reason: str


class AtLimit(NamedTuple):
    """A span in which a wheel is at its largest speed although its command drives it."""

    wheel: str
    #: When it begins and ends, ns; the parts of a nanosecond are exact to about a femtosecond.
    begin_ns: int
    begin_fraction: float
    end_ns: int
    end_fraction: float

    @property
    def seconds(self) -> float:
        """Return the length of the span, s."""
        return (self.end_ns - self.begin_ns + self.end_fraction - self.begin_fraction) / 1e9


class SolverUsage(NamedTuple):
    """The data that show which solver computed each span of a motion."""

    body: RigidBody
    options: Options
    timeline: Timeline
    start_ns: int
    end_ns: int
    #: Whether the coast in each row was computed in closed form. The entry with index k + 1
    #: belongs to the row with index k.
    closed: NDArray[np.bool_]
    #: The named wheels, or None if there are none.
    wheels: WheelTimeline | None = None
    #: When wheels reach or leave their largest speed, with the last event of each wheel before
    #: the start; see `layout.Friction`.
    events: Sequence[Ints] = ()

    def models(self) -> tuple[Model, ...]:
        """Return a model for each span from the start to the last requested time, in order."""
        starts, closed = self._segments()
        changes = np.flatnonzero(np.append(True, closed[1:] != closed[:-1]))
        bounds = [*starts[changes].tolist(), self.end_ns]
        return tuple(self._model(bool(closed[change]), begin, end)
                     for change, begin, end in zip(changes, bounds, bounds[1:]))

    def _segments(self) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the time of each torque change, and whether a closed-form span follows."""
        times_ns = self.timeline.times_ns
        first, stop = np.searchsorted(times_ns, [self.start_ns, self.end_ns], side='right')
        coasts = np.append(not self.timeline.has_terms, ~self.timeline.acts())[first:stop + 1]
        closed = coasts & self.closed[first:stop + 1]
        # The loop marks only those rows of a coast that contain an output.
        coast = np.cumsum(np.append(False, ~(coasts[1:] & coasts[:-1])))
        used = np.zeros(coast[-1] + 1, np.bool_)
        np.logical_or.at(used, coast, closed)
        return np.append(self.start_ns, times_ns[first:stop]), used[coast]

    def _model(self, closed: bool, start_ns: int, end_ns: int) -> Model:
        body, options = self.body, self.options
        solver = options.record
        if solver == AUTO:
            if closed:
                return Model(EXACT.name, start_ns, end_ns,
                             f'auto: coast of a body that is {_with_article(body.symmetry)}, '
                             'in closed form from its beginning')
            terms = [name for name, acts in (('rotors', self.timeline.has_rotors),
                                             ('damping', body.is_damped),
                                             ('fields', self.timeline.has_fields)) if acts]
            if terms:
                return Model(TAYLOR.name, start_ns, end_ns,
                             f'auto: no closed form with {" and ".join(terms)}, truncated below '
                             f'{options.tolerance:g} rad per radian turned')
            return Model(TAYLOR.name, start_ns, end_ns,
                         f'auto: torque, or a coast of up to {LONG_COAST:g} rad or too close to '
                         f'the separatrix, truncated below {options.tolerance:g} rad per '
                         'radian turned')
        if solver == EXACT and not closed and end_ns > start_ns:
            return Model(TAYLOR.name, start_ns, end_ns,
                         'too close to the separatrix for the closed form')
        return Model(solver.name, start_ns, end_ns, 'as requested')


def _with_article(name: str) -> str:
    return f'an {name}' if name[0] in 'aeiou' else f'a {name}'


def at_limit(parts: Sequence[SolverUsage]) -> tuple[AtLimit, ...]:
    """Return the spans in which wheels are at their largest speed, ordered by their beginning."""
    spans = dict[int, list[AtLimit]]()
    for part in parts:
        assert part.wheels
        events = np.concatenate([np.empty((0, 4), np.int64), *part.events])
        for number, name in enumerate(part.wheels.wheels.names):
            own = events[events[:, 2] == number]
            # A span ends with the next event, or with the row; the next row begins another one.
            later_ns = np.append(part.timeline.times_ns, part.end_ns)
            ends_ns = np.minimum(part.end_ns, later_ns[np.minimum(
                np.searchsorted(later_ns, own[:, 0], 'right'), len(later_ns) - 1)])
            for event, following, row_ns in zip(own, [*own[1:], None], ends_ns.tolist()):
                time_ns, rest, _, mode = event.tolist()
                end_ns, end = row_ns, 0.0
                if following is not None and following[0] <= row_ns:
                    end_ns, end = int(following[0]), -int(following[1]) * 1e-6
                if time_ns <= part.start_ns:  # the wheel was there before
                    time_ns, rest = part.start_ns, 0
                begin = -rest * 1e-6
                if mode != FREE and (end_ns, end) >= (time_ns, begin):
                    _add(spans.setdefault(number, []),
                         AtLimit(name, time_ns, begin, end_ns, end))
    return tuple(sorted((span for some in spans.values() for span in some),
                        key=lambda span: (span.begin_ns, span.begin_fraction)))


def _add(spans: list[AtLimit], span: AtLimit) -> None:
    """Append a span, or extend the last one if it ends where the span begins."""
    if spans and spans[-1][3:] == span[1:3]:
        span = spans.pop()._replace(end_ns=span.end_ns, end_fraction=span.end_fraction)
    spans.append(span)
