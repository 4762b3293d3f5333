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
Provide `AttitudeMonitor`, a node that checks the model against measurements as they arrive.

`MonitorInputs` receives the torques and the measurements, and passes them to a `Monitor`.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Vector3Stamped, WrenchStamped
import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import as_json
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.inference.evidence import Suspect
from rigid_body_ros.inference.monitor import (
    ERROR,
    first_suspect,
    Judgement,
    Monitor,
    settings_of,
    WARN,
)
from rigid_body_ros.live import events
from rigid_body_ros.live.inputs import decoded, Torque
from rigid_body_ros.live.torque_queue import Sender
from rigid_body_ros.node.clocks import ArrivalStamps, check_stamp, ClockReading, WatchedClock
from rigid_body_ros.node.diagnostics import Diagnostics
from rigid_body_ros.node.intake import BEST_EFFORT, Intake, PollingNode
from rigid_body_ros.node.parameters import NodeParameters
from rigid_body_ros.node.process import run, timer
from rigid_body_ros.node.sources import sources_of, TorqueTopic
from rigid_body_ros.recording import measurements, Messages
from rigid_body_ros.recording.account import Account
from rigid_body_ros.recording.quantities import KINDS, of_messages, QUANTITIES
from rigid_body_ros.scene import Scene
from rigid_body_ros.scene.parameters import IGNORE

NAME = 'attitude_monitor'
#: How often to look for windows that have ended, and how often to publish diagnostics, in seconds.
_WATCH_PERIOD, _REPORT_PERIOD = 0.1, 1.0
_SEVERAL = 'messages of several publishers on one topic are treated as those of one sensor'
#: How long to wait for a topic that lags behind other topics by more than `history`, in seconds.
#: We also assume that messages from before a clock jump may arrive for this long after the jump. A
#: reliable connection may take three seconds to resend a lost message.
_PATIENCE = 5.0
#: How long to reuse a clock reading, in seconds. Reading the clock takes as long as processing a
#: message.
_CLOCK_PERIOD = 0.005
#: A stamp may be ahead of simulated time by at most this many seconds.
_OVERTAKING = 60.0
#: Reasons for not judging a window, in addition to the reasons that `Monitor` defines.
_LOST, _JUMP = 'torques lost', 'the clock jumped'
#: A step of a wall clock by more than this many nanoseconds counts as a jump.
_STEP_NS = 10 ** 6
#: In diagnostics, the source numbers of measured topics begin here. Torque sources have lower
#: numbers.
_FIRST_MEASURED = 10 ** 6


class MonitorInputs:
    """
    Subscribe to the torques of a scene and to measurements, and pass both to a `Monitor`.

    Parameters
    ----------
    node : PollingNode
    scene : Scene

    Attributes
    ----------
    diagnostics : Diagnostics
    intake : Intake
    monitor : Monitor
        The monitor that checks the model. When the clock jumps, it is replaced by a new one.

    """

    def __init__(self, node: PollingNode, scene: Scene) -> None:
        self._scene = scene
        parts = [measurements.parts_of('', name) for name in scene.values['monitor.measured']]
        kinds = tuple(kind for kind in KINDS if not kind.is_list)
        measured = [TorqueTopic(_FIRST_MEASURED + number, topic, '', f'measured {topic}',
                                'measurement', kinds)
                    for number, (_, topic, _) in enumerate(parts)]
        #: What is not used of each measured topic, and how its frames are interpreted.
        self._unused = {source.number: {*QUANTITIES} - {quantity} if quantity else ()
                        for source, (*_, quantity) in zip(measured, parts)}
        self._options = measurements.MeasuredOptions(None, scene.body_frame, scene.space_frame,
                                                     scene.links)
        sources = *sources_of(scene), *measured
        self.diagnostics = Diagnostics(node, sources)
        self._history_ns = duration_ns(scene.history, 'history')
        self._is_simulated = node.get_parameter('use_sim_time').value
        self._arrivals = ArrivalStamps()
        # Even a small step of a wall clock counts as a jump, because it makes stamps from before
        # and after the step inconsistent.
        self._clock = WatchedClock(node.get_clock(), self._is_simulated, self._history_ns) \
            if self._is_simulated else WatchedClock(node.get_clock(), False, _STEP_NS, _STEP_NS)
        #: The time until which to reuse `_reading`, and the time of the last clock jump. Both
        #: times are in seconds on the monotonic clock.
        self._read_until = self._jumped_at = 0.0
        self._reading, self._jump_ns = ClockReading(0, 0), 0
        #: The messages of each source that have arrived.
        self._waiting: dict[int, list[Any]] = defaultdict(list)
        # Otherwise, read the clock when a message arrives.
        self.intake = Intake(node, scene, sources, self.diagnostics, BEST_EFFORT,
                             not self._is_simulated, self._receive)
        self._begin()
        self.intake.listen()

    def _begin(self) -> None:
        """Begin a new check, which contains no torques or measurements yet."""
        self.monitor = Monitor(self._scene.problem(), settings_of(self._scene.values),
                               self._scene.actuators or ())
        #: The newest stamp of each source, ns.
        self._newest_ns: dict[int, int] = {}
        #: What each measured topic contains: 1 for attitudes, 2 for angular velocities, and 3 for
        #: both.
        self._measured: dict[int, int] = {}
        self._accounts = {number: Account('') for number in self._unused}
        #: When a message of each source was last accepted, in seconds on the monotonic clock.
        self._heard_at: dict[int, float] = {}
        #: When each source last kept up with the others, in seconds on the monotonic clock. A
        #: source keeps up if its newest stamp is at most `history` older than the newest stamp of
        #: all sources.
        self._abreast_at: dict[int, float] = {}

    def ages(self) -> dict[int, float | None]:
        """Return the age in s of each source's newest message, or None before the first one."""
        return {number: 1e-9 * (self._reading.now_ns - self._newest_ns[number])
                if number in self._newest_ns else None for number in self.intake.sources}

    def is_silent_since(self, time_ns: int) -> bool:
        """Return whether another window should have been completed in the time since `time_ns`."""
        window_ns = duration_ns(self._scene.values['monitor.window'], 'window')
        patience_ns = 2 * window_ns + self._history_ns + duration_ns(_PATIENCE, 'patience')
        return self._reading.now_ns > time_ns + patience_ns

    def problems(self) -> dict[int, list[str]]:
        """Return the current problems of each source, and look for the types of the topics."""
        self.intake.follow_types()
        problems, longest = self.intake.problems(), self._scene.stale_after
        for number, age in self.ages().items():
            topic = self.intake.sources[number].topic
            if age is not None and age > longest > 0.0:
                problems[number].append(f'{topic}: nothing for {age:.3g} s')
            if number in self._accounts:
                problems[number] += self._accounts[number].faults
        problems[self.intake.first] += self._clock.problems()
        return problems

    def _receive(self, data: bytes, sender: Sender, source: int, received_ns: int) -> None:
        """
        Keep a message until `take`.

        Raises
        ------
        RejectedError
            The message cannot be decoded, or its stamp is not acceptable.

        """
        if self._is_simulated:
            received_ns, now_ns = 0, self.now_ns()
        else:
            now_ns = received_ns or self._reading.now_ns
        if not now_ns:
            raise events.RejectedError(events.NO_CLOCK, events.NO_TIME)
        is_torque = source not in self._unused
        arrived_ns = received_ns or self._arrivals.stamp()
        message: Torque | messages.Stamped = self.intake.read(
            self.intake.inputs.torque, data, source, arrived_ns) if is_torque else \
            self.intake.read(self._measurement, data, source, arrived_ns)
        self._check_stamp(message.stamp_ns, now_ns)
        arrived, drain = self._waiting[source], self.intake.drains[source]
        if is_torque and drain.has_gap:
            drain.has_gap = False
            before_ns = arrived[-1].stamp_ns if arrived else self._newest_ns.get(source, 0)
            self.monitor.skip(before_ns, message.stamp_ns, _LOST)
        arrived.append(message)

    def now_ns(self) -> int:
        """
        Return the current time in ns, or 0 if there is no time yet.

        If the clock has jumped, the method also restarts the check, unless the scene ignores
        jumps.
        """
        now = time.monotonic()
        if self._reading.now_ns and now < self._read_until:
            return self._reading.now_ns
        reading = self._reading = self._clock.read()
        self._read_until = now + _CLOCK_PERIOD
        if reading.now_ns:
            self._arrivals.tick(reading.now_ns)
        if reading.jump_ns and self._scene.on_time_jump != IGNORE:
            self.take()
            self.diagnostics.event(events.TIME_JUMP, 'the clock jumped by '
                                   f'{1e-9 * reading.jump_ns:.9g} s: the check begins again')
            self._jump_ns, self._jumped_at = reading.jump_ns, now
            self._begin()
            # After a small jump, we cannot tell whether a message is from before or after the
            # jump.
            self.monitor.skip(reading.now_ns - self._reach_ns, reading.now_ns + self._reach_ns,
                              _JUMP)
        return reading.now_ns

    @property
    def _reach_ns(self) -> int:
        """Return for how long before and after a clock jump stamps are ambiguous, in ns."""
        return min(abs(self._jump_ns), 2 * self._history_ns) + self._history_ns

    def take(self) -> None:
        """
        Take the messages that have arrived.

        The messages of each topic are processed as one batch, because processing them one by one
        would take longer.
        """
        if not self._is_simulated:
            self.intake.poll()
        for source, arrived in self._waiting.items():
            put = self._measure if source in self._unused else self._apply
            put(source, np.array([message.stamp_ns for message in arrived]), arrived)
        self._waiting.clear()

    def _check_stamp(self, stamp_ns: int, now_ns: int) -> None:
        """Raise RejectedError if the stamp of a message is too far from the present time."""
        if self._is_simulated:  # a message may overtake a /clock message that was sent before it
            check_stamp(stamp_ns, now_ns, _OVERTAKING, 'a lead')
        else:
            check_stamp(stamp_ns, now_ns, self._scene.max_future)
        ahead_ns = stamp_ns - now_ns
        if (abs(self._jump_ns) > 2 * self._history_ns
                and abs(ahead_ns + self._jump_ns) < abs(ahead_ns)
                and time.monotonic() < self._jumped_at + _PATIENCE):
            raise events.RejectedError(events.STALE, f'stamped {stamp_ns} ns, before the clock '
                                       f'jumped by {1e-9 * self._jump_ns:.9g} s')

    def _apply(self, source: int, stamps_ns: NDArray[np.int64],
               torques: Sequence[Torque]) -> None:
        """Pass torques to the monitor."""
        self.monitor.awaited.add(source)
        self._count(source, stamps_ns, self.monitor.apply(
            stamps_ns, np.array([torque.values for torque in torques]),
            [torque.frame == 'space' for torque in torques], source))

    def _measure(self, source: int, stamps_ns: NDArray[np.int64],
                 stamped: Sequence[messages.Stamped]) -> None:
        """Pass measurements to the monitor, converted to body axes."""
        topic, kind = self.intake.topic(source), self.intake.types[source]
        attitude, rates = np.full((len(stamped), 4), np.nan), np.full((len(stamped), 3), np.nan)
        values = np.array([message.values for message in stamped])
        pairs = [(message.frame_id, message.child_frame_id) for message in stamped]
        for frames in dict.fromkeys(pairs):
            rows = np.array([pair == frames for pair in pairs])
            recorded = Messages(topic, stamps_ns[rows], np.zeros(rows.sum(), np.intp),
                                [frames[0]], values[rows], pairs=(frames,))
            with suppress(InputError):  # space axes, without an attitude
                samples = measurements.in_body_axes(
                    topic, of_messages(recorded, kind), recorded, kind, self._options)
                samples = samples.without(self._unused[source])
                attitude[rows], rates[rows] = samples.attitude, samples.rates
        sent = np.isfinite(attitude[:, 0]) + 2 * np.isfinite(rates[:, 0])
        if sent.any():
            self._measured.setdefault(source, int(sent[sent > 0][0]))
        # Just as in a recording, every message of a topic must contain the same quantities as the
        # first one.
        usable = sent == self._measured.get(source, -1)
        for _ in range(int(np.sum(~usable))):
            self.diagnostics.reject(events.RejectedError(
                events.NOT_FINITE, 'expected a finite attitude, angular velocity or both, as in '
                'the first message, found another'), source)
        self._accounts[source].add(stamps_ns[usable])
        self._count(source, stamps_ns[usable], self.monitor.measure(
            topic, stamps_ns[usable], attitude[usable], rates[usable]))

    def _count(self, source: int, stamps_ns: NDArray[np.int64], fits: NDArray[np.bool_]) -> None:
        """Count the messages selected by `fits` as applied, and all others as rejected (late)."""
        for stamp_ns in stamps_ns[~fits].tolist():
            self.diagnostics.reject(events.RejectedError(
                events.LATE, f'stamped {stamp_ns} ns, in a window that has been judged: a window '
                'is judged when a message is newer than its end by history '
                f'({self._scene.history:g} s)'), source)
        if fits.any():
            newest_ns = int(stamps_ns[fits].max())
            self._newest_ns[source] = max(self._newest_ns.get(source, 0), newest_ns)
            self._heard_at[source] = time.monotonic()
            self.diagnostics.count(events.APPLIED, source, int(fits.sum()))

    def _measurement(self, data: bytes, source: int) -> messages.Stamped:
        """
        Decode a measurement.

        Raises
        ------
        RejectedError
            The message is malformed, or is in another frame.

        """
        kind = self.intake.types[source]
        message = decoded(kind, data)
        if text := self._options.other_frames(kind, message.frame_id, message.child_frame_id):
            raise events.RejectedError(events.FRAME, text)
        return message

    def complete_ns(self, now: float) -> int:
        """
        Return the time, ns, up to which the messages of all topics should have arrived.

        Silent topics are ignored.
        """
        newest_ns = self.monitor.newest_ns
        sending = []
        for number in self.intake.drains:
            latest_ns = self._newest_ns.get(number, 0)
            if latest_ns >= newest_ns - self._history_ns or number not in self._abreast_at:
                self._abreast_at[number] = now
            # If the process has paused, messages of this topic may still be waiting while those of
            # other topics have been processed.
            if now < max(self._abreast_at[number], self._heard_at.get(number, 0.0)) + _PATIENCE:
                sending.append(latest_ns)
        return min(sending, default=newest_ns) - self._history_ns


class AttitudeMonitor(PollingNode):
    """
    Check a model against measurements, window by window.

    The node subscribes to the torque topics of the scene, and to the topics listed in
    `monitor.measured`. You can spin the node in any executor. All its callbacks are in one
    mutually exclusive group.

    Parameters
    ----------
    node_name : str
    **kwargs
        Arguments of `rclpy.node.Node`, such as `namespace` or `parameter_overrides`.

    Raises
    ------
    InputError
        The node name is not valid, or the parameters do not describe a scene that a monitor can
        check.

    """

    def __init__(self, node_name: str = NAME, **kwargs: Any) -> None:
        super().__init__(node_name, **kwargs)

    def _start(self) -> None:
        self._scene = NodeParameters(self, lambda rate: None).scene
        _check(self._scene)
        self._inputs = MonitorInputs(self, self._scene)
        self._attitude, self._rate = (self.create_publisher(Vector3Stamped, f'~/{name}', 10)
                                      for name in ('attitude_error', 'rate_error'))
        self._torque = self.create_publisher(WrenchStamped, '~/residual_torque', 10)
        #: When the next diagnostics are due, in seconds on the monotonic clock.
        self._report_at = 0.0
        #: Numbers of windows since the alarm, now and at the latest search for a suspect. A thread
        #: does the search, because it takes a second or two.
        self._alarmed, self._searched, self._thread = 0, 0, ThreadPoolExecutor(1)
        self._suspect: Suspect | None = None
        self._search: Future[Suspect | None] | None = None
        timer(self, _WATCH_PERIOD, self._watch)

    def _watch(self) -> None:
        """
        Judge the windows that have ended.

        Once a second, also look for topics and publish diagnostics.
        """
        inputs, now = self._inputs, time.monotonic()
        inputs.intake.listen()
        inputs.now_ns()
        inputs.take()
        for judgement in inputs.monitor.judgements(inputs.complete_ns(now)):
            self._publish(judgement)
            self._alarmed = self._alarmed + 1 if judgement.level == ERROR else 0
        self._find_suspect()
        if now > self._report_at:
            self._report_at = now + _REPORT_PERIOD
            self._report()

    def _publish(self, judgement: Judgement) -> None:
        error, body = judgement.error, self._scene.body_frame
        if not np.isnan(error.attitude[0]):
            self._attitude.publish(messages.VECTOR3.encode(error.end_ns, body, error.attitude))
        self._rate.publish(messages.VECTOR3.encode(error.end_ns, body, error.rate))
        self._torque.publish(messages.wrench(error.end_ns, body, error.torque))
        if judgement.level == ERROR and judgement.since_ns == error.end_ns:
            self.get_logger().error(_described(judgement))

    def _find_suspect(self) -> None:
        """Search for a suspect after the alarm, and whenever twice as many windows are judged."""
        if not self._alarmed:
            self._searched, self._suspect, self._search = 0, None, None
        if self._search and self._search.done():
            self._suspect, self._search = self._search.result(), None
            if self._suspect:
                self.get_logger().error(f'first suspect: {self._suspect.described()}')
        if self._search is None and self._alarmed > 2 * self._searched:
            self._searched = self._alarmed
            self._search = self._thread.submit(first_suspect, *self._inputs.monitor.latest())

    def _report(self) -> None:
        inputs = self._inputs
        problems = inputs.diagnostics.connection_problems(
            inputs.problems(), inputs.intake.drains, inputs.intake.subscriptions,
            [self._attitude, self._rate, self._torque], _SEVERAL)
        window = self._scene.values['monitor.window']
        inputs.diagnostics.publish(problems, Counter(), inputs.ages(), 'checked in windows of '
                                   f'{window:g} s', self.get_clock().now().to_msg(),
                                   [self._status()])

    def _status(self) -> DiagnosticStatus:
        """Return the diagnostic status that tells whether the model fits the measurements."""
        inputs, monitor = self._inputs, self._inputs.monitor
        last, skipped = monitor.last, {f'windows skipped: {reason}': count
                                       for reason, count in monitor.skipped.items()}
        doubt = f'the last window was skipped: {monitor.last_skipped}' if monitor.last_skipped \
            else ''
        notes = [f'{topic}: {note}' for topic, note in monitor.notes.items()]
        if last is None:
            return inputs.diagnostics.status(
                'model', False, bool(doubt), '; '.join(filter(None, ['no window yet', doubt])),
                skipped)
        error, noises, suspect = last.error, monitor.noises, self._suspect
        if not doubt and inputs.is_silent_since(error.end_ns):
            doubt = f'no measurements since {error.end_ns} ns'
        named = [f'first suspect: {suspect.name}'] if suspect else []
        return inputs.diagnostics.status(
            'model', last.level == ERROR, last.level == WARN or bool(doubt),
            '; '.join(filter(None, [doubt, _described(last), *named, *notes])), {
                **({'first suspect': suspect.described()} if suspect else {}),
                'sigma': f'{last.sigma:.2f}', 'windows tested together': last.windows,
                'largest component': last.axis, 'since (ns)': last.since_ns,
                'end of the window (ns)': error.end_ns, 'outliers': error.outliers,
                **skipped, 'attitude error (rad)': as_json(error.attitude),
                'rate error (rad/s)': error.rate.tolist(),
                'residual torque (N m)': error.torque.tolist(),
                **{f'noise of {topic} ({unit})': f'{level.size:.3g} (stated {level.stated:g})'
                   for topic, levels in noises.items()
                   for level, unit in zip(levels, ('rad', 'rad/s')) if level.is_measured}})


def _described(judgement: Judgement) -> str:
    windows = f'{judgement.windows} windows together' if judgement.windows > 1 else 'one window'
    if judgement.level not in (WARN, ERROR):
        return f'the model explains the measurements ({judgement.sigma:.1f} sigma at most)'
    return (f'the model does not explain the measurements: {judgement.sigma:.1f} sigma in '
            f'{windows}, since {judgement.since_ns} ns; largest error: {judgement.axis}')


def _check(scene: Scene) -> None:
    """Raise InputError if the scene is one that a monitor cannot check."""
    for name in ('monitor.attitude_noise', 'monitor.rate_noise'):
        if not scene.values[name]:
            raise InputError(f'{name}: expected the standard deviation of a component, found 0')
    if not scene.values['monitor.measured']:
        raise InputError('monitor.measured: expected at least one topic, found an empty list')
    if scene.inertia_topic:
        raise InputError('inertia_topic: expected false, because attitude_monitor checks one '
                         'inertia, found true')
    if scene.named_wheels:
        raise InputError('wheel_names: expected none, because attitude_monitor does not know the '
                         f'speeds of wheels, found {listed(scene.values["wheel_names"])}')


def main(arguments: Sequence[str] | None = None) -> None:
    """
    Run the monitor until it receives SIGINT or SIGTERM.

    Raises
    ------
    InputError
        The arguments or parameters are not valid.

    """
    run(AttitudeMonitor, NAME, arguments)
