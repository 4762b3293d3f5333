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
Check a model live: judge the model window by window as torques and measurements arrive.

One test looks at each single window. Three more tests look at the residual torques of 4, 16 and 64
windows together, to find errors that are too small to show in a single window. The false-alarm
rate is divided equally among the four tests.
"""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import as_json, Floats, Ints
from rigid_body_ros.common.times import duration_ns, NEVER_NS
from rigid_body_ros.inference.evidence import Suspect
from rigid_body_ros.inference.findings import judged
from rigid_body_ros.inference.noise import NoiseLevel
from rigid_body_ros.inference.setup import setup_of_model, WINDOWS
from rigid_body_ros.inference.verdict import scored
from rigid_body_ros.inference.window_error import window_error, WindowError
from rigid_body_ros.mechanics.actuator import Actuator
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import Problem
from rigid_body_ros.propagation.sources import WHEELS
from rigid_body_ros.recording.account import Account
from rigid_body_ros.recording.measured import Measured, not_measured
from scipy.special import chdtrc, ndtri  # here, so that no window waits for it

#: Why a window is not judged, although its motion is known.
FEW = 'too few measurements'
#: The windows of the last 120 s are remembered, to find out what is wrong.
_REMEMBERED = 120.0
#: Length of the pieces in which a recording is processed, ns.
_PIECE_NS = 60 * 10 ** 9
OK, WARN, ERROR = range(3)
#: Numbers of windows that are tested together.
_TOGETHER = 1, 4, 16, 64
#: A test raises an alarm if the probability of its result is below a limit. The test warns if this
#: probability is below `_WARNING` times the limit.
_WARNING = 10.0


class Settings(NamedTuple):
    """The settings of a live check."""

    #: Length of a window, and maximum delay of a message, both in seconds.
    window: float
    history: float
    #: Standard deviations of each component of a measured attitude (rad) and of each component of
    #: a measured rate (rad/s).
    attitude_noise: float
    rate_noise: float
    #: Average time between false alarms if the model is correct, in hours.
    false_alarms: float
    #: A torque counts as unknown if no other torque follows within this time, in seconds. 0 means
    #: no limit.
    stale_after: float = 0.0


def settings_of(values: Mapping[str, Any]) -> Settings:
    """Get the settings of the live check from the parameters of a scene."""
    return Settings(*(values[name] for name in (
        'monitor.window', 'history', 'monitor.attitude_noise', 'monitor.rate_noise',
        'monitor.false_alarms', 'stale_after')))


def is_checked(problem: Problem, values: Mapping[str, Any]) -> bool:
    """Return whether a live check can handle the problem and knows the noise from the scene."""
    others = problem.named_wheels or problem.changes
    is_held = all(log.interpolation == 'hold' for log in problem.sources)
    is_stated = values['monitor.attitude_noise'] and values['monitor.rate_noise']
    return bool(is_stated and is_held and not others)


class Monitor:
    """
    Judge a model window by window, while torques and measurements arrive.

    Windows begin at multiples of their length. A window is judged as soon as a message arrives
    whose stamp is later than the end of the window plus `history`. Until then, messages may arrive
    in any order. If the torque in a window is unknown, the window is skipped, because such a
    window says nothing about the model.

    Parameters
    ----------
    problem : Problem
        The model: its body, fields, options and initial rotor momentum. Any torques in the problem
        are ignored.
    settings : Settings
    actuators : sequence of Actuator or None
        The actuator of each torque source, in the order of the sources. Empty if there are no
        actuators.

    Attributes
    ----------
    newest_ns : int
        The newest stamp so far, or 0 before the first message.
    noises : dict of tuple of NoiseLevel
        For each topic, the actual noise of the attitude and of the angular velocity.
    skipped : Counter of str
        Number of windows that were not judged, by reason.
    last_skipped : str
        Why the last window was not judged. Empty if the last window was judged.
    last : Judgement or None
        The latest judgement.
    awaited : set of int
        Sources whose torque is unknown until their first message arrives. The torque of any other
        source is zero until its first message arrives.
    notes : dict of str to str
        For topics of which a quantity was not used in the last window: why.

    """

    def __init__(self, problem: Problem, settings: Settings,
                 actuators: Sequence[Actuator | None] = ()) -> None:
        self._problem, self._settings = problem, settings
        self._window_ns = duration_ns(settings.window, 'window')
        self._history_ns = duration_ns(settings.history, 'history')
        self._stale_ns = duration_ns(settings.stale_after, 'stale_after') or NEVER_NS
        self._actuators = dict(enumerate(actuators))
        #: How long a command may still act after it has been replaced, ns. This is the longest
        #: delay plus lag of any actuator.
        self._reach_ns = max((actuator.delay_ns + actuator.expiry_ns for actuator in actuators
                              if actuator), default=0)
        count = int(np.clip(_REMEMBERED / settings.window, 1, WINDOWS))
        #: Each row holds a torque and whether it is in space axes, or an attitude and a rate.
        self._torques = defaultdict[int, _Rows](lambda: _Rows(4, count))
        self._sensors = defaultdict[str, _Rows](lambda: _Rows(7, count))
        self.noises: dict[str, tuple[NoiseLevel, NoiseLevel]] = {}
        self._alarms = Alarms(settings.window, settings.false_alarms)
        #: Beginning of the next window, ns, and the rotor momentum at this time.
        self._begin_ns, self._momentum = 0, problem.start.rotor_momentum
        #: The beginnings of the latest windows, with the rotor momenta, since one was skipped.
        self._latest = deque[tuple[int, Floats]](maxlen=count)
        #: Time spans, ns, in which no window is judged, each with a reason.
        self._spans: list[tuple[int, int, str]] = []
        self.newest_ns, self.skipped, self.last_skipped = 0, Counter[str](), ''
        self.last: Judgement | None = None
        self.awaited: set[int] = set()
        self.notes: dict[str, str] = {}

    def apply(self, times_ns: ArrayLike, torques: Floats, in_space: ArrayLike = False,
              source: int = 0) -> NDArray[np.bool_]:
        """
        Add torques from a source, N m, shape (n, 3). Torques on rotors have the source WHEELS.

        Return a mask of the torques that were accepted, shape (n,). A torque is accepted if its
        window has not been judged yet.
        """
        values = np.column_stack([torques, np.broadcast_to(in_space, len(torques))])
        return self._put(self._torques[source], np.asarray(times_ns), values)

    def measure(self, topic: str, times_ns: ArrayLike, attitude: Floats,
                angular_velocity: Floats) -> NDArray[np.bool_]:
        """
        Add measured attitudes, shape (n, 4), and angular velocities, rad/s, shape (n, 3).

        The attitudes are unit quaternions x, y, z, w. Pass NaN for a quantity that the topic does
        not measure. Return a mask of the samples that were accepted, shape (n,). A sample is
        accepted if its window has not been judged yet.
        """
        return self._put(self._sensors[topic], np.asarray(times_ns),
                         np.concatenate([attitude, angular_velocity], axis=1))

    def skip(self, begin_ns: int, end_ns: int, reason: str) -> None:
        """Skip all windows that overlap a time span with lost messages or ambiguous stamps."""
        self._spans.append((begin_ns, end_ns, reason))

    def _put(self, rows: _Rows, times_ns: Ints, values: Floats) -> NDArray[np.bool_]:
        fits = times_ns >= self._begin_ns
        rows.put(times_ns[fits], values[fits])
        self.newest_ns = int(times_ns[fits].max(initial=self.newest_ns))
        return np.asarray(fits)

    def judgements(self, complete_ns: int | None = None) -> Iterator[Judgement]:
        """
        Generate the judgements of all windows that are over.

        The measurements in these windows are then set aside. Windows without samples are skipped.
        Pass `complete_ns` if some messages with stamps after this time may not have been added
        yet. Only windows that end by `complete_ns` are then judged.
        """
        until_ns = self.newest_ns - self._history_ns
        if complete_ns is not None:
            until_ns = min(until_ns, complete_ns)
        while (begin_ns := self._next_ns(until_ns)) is not None:
            end_ns = begin_ns + self._window_ns
            if not self._is_decided(begin_ns, end_ns, until_ns):
                return
            # Start at the end of the previous window, where the rotor momentum is known.
            problem = self._between(self._begin_ns or begin_ns, end_ns, self._momentum)
            sensors = self._measured_between(begin_ns, end_ns)
            levels = [self.noises.setdefault(sensor.topic, (
                NoiseLevel(self._settings.attitude_noise), NoiseLevel(self._settings.rate_noise)))
                for sensor in sensors]
            self.notes = {sensor.topic: note for sensor in sensors for note
                          in sensor.account.notes}
            error = None
            if not (reason := self._unknown(begin_ns, end_ns)):
                try:
                    error = window_error(problem, sensors, levels, begin_ns, end_ns)
                    reason = '' if error else FEW
                except ValueError:
                    reason = 'motion not computable'
            if reason and reason != FEW:
                self._latest.clear()
            else:
                self._latest.append((problem.start.time_ns, self._momentum))
            self._begin_ns = end_ns
            self._momentum = problem.rotor_momentum(np.array([end_ns]))[0]
            self._forget(end_ns)
            self.last_skipped = reason
            if error is None:
                self.skipped[reason] += 1
                continue
            self.last = self._alarms.judged(error)
            yield self.last
            for pair, residuals in zip(levels, error.residuals):
                for level, errors in zip(pair, residuals):
                    level.add(errors)

    def _forget(self, before_ns: int) -> None:
        """Set data from before a given time aside, except torques that still act at that time."""
        for torques in self._torques.values():
            torques.forget(before_ns - self._reach_ns)
        for measured in self._sensors.values():
            measured.forget(before_ns)
        self._spans = [span for span in self._spans if span[1] > before_ns]

    def _unknown(self, begin_ns: int, end_ns: int) -> str:
        """
        Return why the torque between two times is unknown.

        Return an empty string if the torque is known.
        """
        for first_ns, last_ns, reason in self._spans:
            if first_ns < end_ns and last_ns > begin_ns:
                return reason
        for source, rows in self._torques.items():
            times_ns, held_ns = self._held(rows, begin_ns, end_ns)
            if times_ns[0] > begin_ns if len(times_ns) else source in self.awaited:
                return 'torque not known yet'
            if np.any(held_ns > self._stale_ns):
                return 'no torque for longer than stale_after'
        return ''

    def _held(self, rows: _Rows, begin_ns: int, end_ns: int) -> tuple[Ints, Ints]:
        """Return the stamps and durations, ns, of the torques that act between two times."""
        times_ns, values = rows.between(begin_ns, end_ns, 1)
        held_ns = np.diff(np.append(times_ns, rows.first_ns(end_ns)))
        # After the timeout of a torque, the torque is known to be zero.
        timeout_ns = self._problem.options.timeout_ns or NEVER_NS
        return times_ns, np.minimum(held_ns, timeout_ns) * values[:, :3].any(axis=1)

    def _is_decided(self, begin_ns: int, end_ns: int, until_ns: int) -> bool:
        """
        Return whether enough data has arrived to tell if the last torque of a window is stale.

        A torque is stale if no other torque follows within `stale_after`. If this time ends after
        `until_ns`, a torque that has not arrived yet may still follow in time.
        """
        for rows in self._torques.values():
            times_ns, held_ns = self._held(rows, begin_ns, end_ns)
            if len(times_ns) and held_ns[-1] > self._stale_ns > until_ns - times_ns[-1]:
                return False
        return True

    def _next_ns(self, until_ns: int) -> int | None:
        """
        Return the beginning of the next window that contains samples, ns.

        Return None if this window ends after `until_ns`.
        """
        last_ns = until_ns - self._window_ns
        if last_ns < self._begin_ns:
            return None
        first_ns = min((rows.first_ns(self._begin_ns) for rows in self._sensors.values()),
                       default=NEVER_NS)
        begin_ns = max(self._begin_ns, first_ns // self._window_ns * self._window_ns)
        return begin_ns if begin_ns <= last_ns else None

    def latest(self) -> tuple[Problem, list[Measured]]:
        """
        Return the model and the measurements of the latest windows.

        These are the windows of the last two minutes, since the last one that was skipped.
        """
        begin_ns, momentum = self._latest[0] if self._latest else (self._begin_ns, self._momentum)
        return (self._between(begin_ns, self._begin_ns, momentum),
                self._measured_between(begin_ns, self._begin_ns))

    def _measured_between(self, begin_ns: int, end_ns: int) -> list[Measured]:
        return [measured for topic, rows in sorted(self._sensors.items())
                if (measured := _measured(topic, rows, begin_ns, end_ns))]

    def _between(self, start_ns: int, end_ns: int, momentum: Floats) -> Problem:
        """Return the problem between two times, with the torques that act between them."""
        start = State(start_ns, self._problem.start.attitude, np.zeros(3), momentum)
        logs = {}
        for source, rows in sorted(self._torques.items()):
            times_ns, values = rows.between(start_ns - self._reach_ns, end_ns, 1)
            logs[source] = TorqueLog(times_ns, values[:, :3], values[:, 3] > 0.0)
        wheels = logs.pop(WHEELS, None)
        # Actuators with a lag are at rest until the first command in the logs.
        rest_ns = min([start_ns, *(int(log.times_ns[0]) for log in logs.values() if log)])
        problem = self._problem.replaced(
            start=replace(start, time_ns=rest_ns), wheels=wheels, log=[*logs.values()],
            actuator=[self._actuators[source] for source in logs] if self._actuators else None)
        return problem.replaced(start=start)


def monitored(problem: Problem, sensors: Sequence[Measured], settings: Settings
              ) -> Iterator[Judgement]:
    """
    Judge a recorded motion as a live check would have judged it.

    Parameters
    ----------
    problem : Problem
        The model and its torques, which are held between samples.
    sensors : sequence of Measured
        The measurements, already converted to body axes and to the torque clock.
    settings : Settings
        The settings of the check, such as the window length and the noise.

    """
    monitor, begin_ns = Monitor(problem, settings, problem.actuators), -NEVER_NS
    logs = dict(enumerate(problem.logs)) | ({WHEELS: problem.wheels} if problem.wheels else {})
    first_ns = min(int(sensor.stamps_ns[0]) for sensor in sensors)
    last_ns = max(int(sensor.stamps_ns[-1]) for sensor in sensors)
    for end_ns in range(first_ns + _PIECE_NS, last_ns + _PIECE_NS + 1, _PIECE_NS):
        for source, log in logs.items():
            rows = slice(*np.searchsorted(log.times_ns, [begin_ns, end_ns]).tolist())
            monitor.apply(log.times_ns[rows], log.torques[rows], log.in_space[rows], source)
        for sensor in sensors:
            part = sensor.between(begin_ns, end_ns)
            monitor.measure(sensor.topic, part.stamps_ns, *(
                np.full((len(part), size), np.nan) if values is None else values
                for values, size in ((part.attitude, 4), (part.angular_velocity, 3))))
        begin_ns = end_ns
        yield from monitor.judgements(end_ns)


def first_suspect(problem: Problem, sensors: Sequence[Measured]) -> Suspect | None:
    """
    Return what explains most of the errors of a model, as `compare` would name it.

    The arguments are those that `Monitor.latest` returns. Return None if nothing is found, or if
    the motion cannot be computed.
    """
    with suppress(ValueError):
        setup = setup_of_model(problem, sensors)
        if setup:
            verdict = scored(judged(setup), 'attitude_identify --estimate start,{} fits it'.format)
            return verdict.suspects[0] if verdict.suspects else None
    return None


class _Rows:
    """
    Rows of values keyed by stamp. A new row replaces an existing row with the same stamp.

    Rows that are no longer needed for the next windows are set aside, because sorting them again
    and again would take too long.
    """

    def __init__(self, columns: int, windows: int) -> None:
        self._new: list[tuple[Ints, Floats]] = []
        self._aside = deque[tuple[Ints, Floats]](maxlen=windows)
        self._sorted = np.empty(0, np.int64), np.empty((0, columns))

    def put(self, stamps_ns: Ints, values: Floats) -> None:
        self._new.append((stamps_ns, values))

    def _all(self) -> tuple[Ints, Floats]:
        """Return all stamps and values, sorted by stamp."""
        if self._new:
            stamps_ns, values = map(np.concatenate, zip(self._sorted, *self._new))
            order = np.argsort(stamps_ns, kind='stable')
            order = order[np.append(np.diff(stamps_ns[order]) != 0, True)]
            self._sorted, self._new = (stamps_ns[order], values[order]), []
        return self._sorted

    def forget(self, before_ns: int) -> None:
        """Set aside all values before a given time, except the newest of these values."""
        stamps_ns, values = self._all()
        row = max(int(stamps_ns.searchsorted(before_ns)) - 1, 0)
        self._aside.append((stamps_ns[:row], values[:row]))
        self._sorted = stamps_ns[row:].copy(), values[row:].copy()

    def first_ns(self, since_ns: int) -> int:
        """Return the first stamp at or after a given time, or NEVER_NS if there is none."""
        stamps_ns, _ = self._all()
        row = stamps_ns.searchsorted(since_ns)
        return int(stamps_ns[row]) if row < len(stamps_ns) else NEVER_NS

    def between(self, begin_ns: int, end_ns: int, earlier: int = 0) -> tuple[Ints, Floats]:
        """Return stamps and values between two times, plus up to `earlier` preceding values."""
        stamps_ns, values = self._all()
        if len(stamps_ns) and begin_ns < stamps_ns[0]:
            stamps_ns, values = map(np.concatenate, zip(*self._aside, (stamps_ns, values)))
        first, stop = stamps_ns.searchsorted([begin_ns, end_ns]).tolist()
        rows = slice(max(first - earlier, 0), stop)
        return stamps_ns[rows], values[rows]


def _measured(topic: str, rows: _Rows, begin_ns: int, end_ns: int) -> Measured | None:
    """Return the measurements of a topic between two times, or None if there are no samples."""
    stamps_ns, values = rows.between(begin_ns, end_ns)
    if not len(stamps_ns):
        return None
    attitude, rates = values[:, :4], values[:, 4:]
    constant, note = ('', '') if np.isnan(values).any() else \
        not_measured(stamps_ns, attitude, rates)
    return Measured(topic, stamps_ns,
                    None if np.isnan(attitude).any() or constant == 'attitude' else attitude,
                    None if np.isnan(rates).any() or constant == 'rates' else rates,
                    account=Account(notes=[note] if note else []))


class Judgement(NamedTuple):
    """
    How the model was judged in one window.

    Attributes
    ----------
    error : WindowError
        The error of the model in the window.
    level : int
        OK, WARN or ERROR. ERROR is an alarm. For a correct model, WARN is about ten times as
        frequent as ERROR.
    sigma : float
        The significance of the most significant of the latest tests: the probability of its
        result, converted to a number of standard deviations of a normal distribution.
    windows : int
        Number of windows in the most significant test.
    axis : str
        The component of the error that deviates most, followed by the deviation of this component
        as a number of standard deviations.
    since_ns : int
        End of the first window at the present level.

    """

    error: WindowError
    level: int
    sigma: float
    windows: int
    axis: str
    since_ns: int

    def as_dict(self) -> dict[str, Any]:
        """Return the judgement as JSON types, with units in the names."""
        error = self.error
        return {'end_ns': error.end_ns, 'level': ('OK', 'WARN', 'ERROR')[self.level],
                'sigma': self.sigma, 'windows': self.windows, 'axis': self.axis,
                'attitude_error_rad': as_json(error.attitude),
                'rate_error_rad_s': as_json(error.rate),
                'residual_torque_N_m': as_json(error.torque), 'outliers': error.outliers}


class Alarms:
    """
    Judge one window after another.

    Parameters
    ----------
    window_s : float, s
        Length of a window.
    hours : float, h
        Average time between false alarms if the model is correct.

    """

    def __init__(self, window_s: float, hours: float) -> None:
        #: Probability below which the test of a single window raises an alarm.
        self._usual = window_s / (3600.0 * hours * len(_TOGETHER))
        #: For each number of windows tested together, the weights and the weighted residual
        #: torques of the windows of the group that is not complete yet.
        self._groups: dict[int, list[tuple[Any, Any]]] = {
            count: [] for count in _TOGETHER[1:]}
        #: For each number of windows tested together, the probability of the latest test result,
        #: divided by the probability below which the test raises an alarm.
        self._ratios = dict.fromkeys(_TOGETHER, np.inf)
        self._level, self._since_ns = OK, 0

    def judged(self, error: WindowError) -> Judgement:
        """Judge the next window."""
        first = 3 if np.isnan(error.attitude[0]) else 0
        change = np.concatenate([error.attitude, error.rate])[first:]
        covariance = error.covariance[first:, first:]
        square = change @ np.linalg.solve(covariance, change)
        self._ratios[1] = chdtrc(len(change), square) / self._usual
        weight = np.linalg.inv(error.torque_covariance)
        for count, group in self._groups.items():
            group.append((weight, weight @ error.torque))
            if len(group) == count:
                total, product = (np.sum(parts, axis=0) for parts in zip(*group))
                square = product @ np.linalg.solve(total, product)
                self._ratios[count] = chdtrc(3, square) / (count * self._usual)
                group.clear()
        windows = min(self._ratios, key=self._ratios.__getitem__)
        ratio = self._ratios[windows]
        level = ERROR if ratio < 1.0 else WARN if ratio < _WARNING else OK
        if level != self._level or not self._since_ns:
            self._level, self._since_ns = level, error.end_ns
        probability = min(ratio * windows * self._usual, 1.0)
        return Judgement(error, level, float(-ndtri(0.5 * probability)), windows,
                         _axis(change, covariance), self._since_ns)


def _axis(change: Floats, covariance: Floats) -> str:
    """Return text that names the component that deviates most, with its deviation."""
    deviations = np.abs(change) / np.sqrt(np.diag(covariance))
    names = [f'{what} about {axis}' for what in ('attitude', 'rate') for axis in 'xyz']
    row = int(np.argmax(deviations))
    return f'{names[len(names) - len(change) + row]} ({deviations[row]:.1f} sigma)'
