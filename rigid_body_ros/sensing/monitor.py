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

"""A live check of a model: torques and measurements in any order, a judgement of each window."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import Problem
from rigid_body_ros.propagation.segment import WHEELS
from rigid_body_ros.sensing.alarms import Alarms, Judgement, NoiseLevel, noises_of
from rigid_body_ros.sensing.measured import Measured
from rigid_body_ros.sensing.windows import window_error

#: What a topic does not measure.
_NO_ATTITUDE, _NO_RATE = np.full(4, np.nan), np.full(3, np.nan)
#: ns; of a recording, how much is taken at a time, and the first time.
_PIECE_NS, _EARLIEST_NS = 60 * 10 ** 9, -2 ** 63


class Settings(NamedTuple):
    """The settings of a live check."""

    #: s; length of a window, and how late a message may be.
    window: float
    history: float
    #: rad, rad/s; standard deviations of a component.
    attitude_noise: float
    rate_noise: float
    #: h; time in which a right model gives one alarm.
    false_alarms: float


def settings_of(values: Mapping[str, Any]) -> Settings:
    """Return the settings among the parameters of a scene."""
    return Settings(values['monitor.window'], values['history'],
                    *(values[f'monitor.{name}'] for name in Settings._fields[2:]))


def is_checked(problem: Problem, values: Mapping[str, Any]) -> bool:
    """Return whether a live check would accept a problem, and its scene states the noise."""
    others = problem.named_wheels or problem.actuators or problem.changes
    is_held = all(log.interpolation == 'hold' for log in problem.sources)
    is_stated = values['monitor.attitude_noise'] and values['monitor.rate_noise']
    return bool(is_stated and is_held and not others)


class Monitor:
    """
    Judge a model window by window, as torques and measurements come.

    Windows begin at multiples of their length. One is judged as soon as a message is newer than
    its end by `history`, so the order of arrival within that time changes nothing.

    Parameters
    ----------
    problem : Problem
        Its body, fields, options, and the momentum of its rotors; its torques do not matter.
    settings : Settings

    Attributes
    ----------
    newest_ns : int
        The newest stamp, 0 before the first.
    noises : dict of tuple of NoiseLevel
        How noisy attitude and angular velocity of each topic really are.
    skipped : int
        Number of windows with too few measurements, or whose motion cannot be computed.

    """

    def __init__(self, problem: Problem, settings: Settings) -> None:
        self._problem, self._settings = problem, settings
        self._window_ns = duration_ns(settings.window, 'window')
        self._history_ns = duration_ns(settings.history, 'history')
        self._torques = defaultdict[int, _Rows](_Rows)
        self._sensors = defaultdict[str, _Rows](_Rows)
        self.noises: dict[str, tuple[NoiseLevel, NoiseLevel]] = {}
        self._alarms = Alarms(settings.window, settings.false_alarms)
        #: The next window begins here, and the momentum of the rotors then.
        self._begin_ns, self._momentum = 0, problem.start.rotor_momentum
        self.newest_ns = self.skipped = 0

    def apply(self, time_ns: int, torque: Floats, frame: str = 'body', source: int = 0) -> bool:
        """
        Add a torque, N m, as `Propagator.apply` does; WHEELS is the source on the rotors.

        Return False if its window has been judged.
        """
        return self._put(self._torques[source], time_ns, torque, frame)

    def measure(self, topic: str, time_ns: int, attitude: Floats | None,
                angular_velocity: Floats | None) -> bool:
        """
        Add what a topic measured: a unit quaternion x y z w, rad/s in body axes, or both.

        Return False if its window has been judged.
        """
        return self._put(self._sensors[topic], time_ns, np.concatenate([
            _NO_ATTITUDE if attitude is None else attitude,
            _NO_RATE if angular_velocity is None else angular_velocity]), '')

    def _put(self, rows: _Rows, time_ns: int, values: Floats, frame: str) -> bool:
        if time_ns < self._begin_ns:
            return False
        self.newest_ns = max(self.newest_ns, time_ns)
        rows.put(time_ns, values, frame)
        return True

    def judgements(self, complete_ns: int | None = None) -> Iterator[Judgement]:
        """
        Judge the windows that are over, and forget them; those without samples are skipped.

        With `complete_ns`, only windows that end by then: messages from after it may still wait.
        """
        until_ns = self.newest_ns - self._history_ns
        if complete_ns is not None:
            until_ns = min(until_ns, complete_ns)
        while (begin_ns := self._next_ns()) is not None:
            end_ns = begin_ns + self._window_ns
            if end_ns > until_ns:
                return
            problem = self._between(begin_ns, end_ns)
            sensors = [measured for topic, rows in sorted(self._sensors.items())
                       if (measured := _measured(topic, rows, begin_ns, end_ns))]
            levels = [self._noise(sensor.topic) for sensor in sensors]
            try:
                error = window_error(problem, sensors, noises_of(levels), begin_ns, end_ns)
            except ValueError:  # faster than can be computed
                error = None
            self._begin_ns = end_ns
            self._momentum = problem.rotor_momentum(np.array([end_ns]))[0]
            for rows in (*self._torques.values(), *self._sensors.values()):
                rows.forget(end_ns)
            if error is None:
                self.skipped += 1
                continue
            yield self._alarms.judged(error)
            for pair, residuals in zip(levels, error.residuals):
                for level, errors in zip(pair, residuals):
                    level.add(errors)

    def _next_ns(self) -> int | None:
        """Return the begin of the next window that has measurements; None if there is none."""
        found = [rows.first_ns(self._begin_ns) for rows in self._sensors.values()]
        first = min((stamp_ns for stamp_ns in found if stamp_ns is not None), default=None)
        return first if first is None else \
            max(self._begin_ns, first // self._window_ns * self._window_ns)

    def _between(self, begin_ns: int, end_ns: int) -> Problem:
        """Return the problem of a window."""
        # The momentum of the rotors is that of the end of the window before.
        start_ns = self._begin_ns or begin_ns
        start = State(start_ns, self._problem.start.attitude, np.zeros(3), self._momentum)
        logs = {source: TorqueLog(*rows.between(start_ns, end_ns, 1))
                for source, rows in sorted(self._torques.items())}
        return self._problem.replaced(start=start, wheels=logs.pop(WHEELS, None),
                                      log=[*logs.values()])

    def _noise(self, topic: str) -> tuple[NoiseLevel, NoiseLevel]:
        return self.noises.setdefault(topic, (NoiseLevel(self._settings.attitude_noise),
                                              NoiseLevel(self._settings.rate_noise)))


def monitored(problem: Problem, sensors: Sequence[Measured], settings: Settings
              ) -> Iterator[Judgement]:
    """
    Judge a recorded motion as a live check of its torques and measurements does.

    Parameters
    ----------
    problem : Problem
        Its torques are held between samples.
    sensors : sequence of Measured
        In the axes of the body and the time of the torques.
    settings : Settings
        Its window and its noise.

    """
    monitor, begin_ns = Monitor(problem, settings), _EARLIEST_NS
    logs = dict(enumerate(problem.logs)) | ({WHEELS: problem.wheels} if problem.wheels else {})
    first_ns = min(int(sensor.stamps_ns[0]) for sensor in sensors)
    last_ns = max(int(sensor.stamps_ns[-1]) for sensor in sensors)
    for end_ns in range(first_ns + _PIECE_NS, last_ns + _PIECE_NS + 1, _PIECE_NS):
        for source, log in logs.items():
            rows = slice(*np.searchsorted(log.times_ns, [begin_ns, end_ns]).tolist())
            for time_ns, torque, in_space in zip(log.times_ns[rows].tolist(), log.torques[rows],
                                                 log.in_space[rows]):
                monitor.apply(time_ns, torque, 'space' if in_space else 'body', source)
        for sensor in sensors:
            part = sensor.between(begin_ns, end_ns)
            for row, time_ns in enumerate(part.stamps_ns.tolist()):
                monitor.measure(sensor.topic, time_ns, *(
                    None if values is None else values[row]
                    for values in (part.attitude, part.angular_velocity)))
        begin_ns = end_ns
        yield from monitor.judgements(end_ns)


class _Rows:
    """Values by stamp; one that comes later replaces one with the same stamp."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._values: dict[int, tuple[Floats, str]] = {}

    def put(self, stamp_ns: int, values: Floats, frame: str) -> None:
        if stamp_ns not in self._values:
            insort(self._stamps_ns, stamp_ns)
        self._values[stamp_ns] = values, frame

    def forget(self, before_ns: int) -> None:
        """Forget what is before a time, but for the newest of it."""
        row = max(bisect_left(self._stamps_ns, before_ns) - 1, 0)
        for stamp_ns in self._stamps_ns[:row]:
            del self._values[stamp_ns]
        del self._stamps_ns[:row]

    def first_ns(self, since_ns: int) -> int | None:
        """Return the first stamp from a time on; None if there is none."""
        row = bisect_left(self._stamps_ns, since_ns)
        return self._stamps_ns[row] if row < len(self._stamps_ns) else None

    def between(self, begin_ns: int, end_ns: int,
                earlier: int = 0) -> tuple[list[int], list[Floats], list[str]]:
        """Return stamps, values and frames between two times, and so many from before."""
        first = max(bisect_left(self._stamps_ns, begin_ns) - earlier, 0)
        stamps_ns = self._stamps_ns[first:bisect_left(self._stamps_ns, end_ns)]
        found = [self._values[stamp_ns] for stamp_ns in stamps_ns]
        return stamps_ns, [values for values, _ in found], [frame for _, frame in found]


def _measured(topic: str, rows: _Rows, begin_ns: int, end_ns: int) -> Measured | None:
    """Return what a topic measured between two times; None if nothing."""
    stamps_ns, values, _ = rows.between(begin_ns, end_ns)
    if not stamps_ns:
        return None
    found = np.array(values)
    attitude, rates = found[:, :4], found[:, 4:]
    return Measured(topic, np.array(stamps_ns), None if np.isnan(attitude).any() else attitude,
                    None if np.isnan(rates).any() else rates)
