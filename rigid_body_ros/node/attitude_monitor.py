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

"""`AttitudeMonitor`: a node that checks the model against measurements as they arrive."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Vector3Stamped, WrenchStamped
import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import as_json
from rigid_body_ros.common.errors import InputError, listed, quoted
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.live.events import (
    APPLIED,
    FRAME,
    LATE,
    MALFORMED,
    NO_CLOCK,
    NOT_FINITE,
    RECEIVED,
    RejectedError,
    TIME_JUMP,
)
from rigid_body_ros.live.inputs import Inputs, Torque
from rigid_body_ros.live.torque_queue import Sender
from rigid_body_ros.node.attitude_node import one_line_errors
from rigid_body_ros.node.clocks import (
    ArrivalStamps,
    check_stamp,
    ClockMonitor,
    ClockReading,
    JumpDetector,
)
from rigid_body_ros.node.diagnostics import Diagnostics
from rigid_body_ros.node.drain import DrainCallback, subscription
from rigid_body_ros.node.parameters import NodeParameters
from rigid_body_ros.node.process import main as run
from rigid_body_ros.node.sources import sources_of, TorqueTopic
from rigid_body_ros.scene import Scene
from rigid_body_ros.scene.parameters import ARRIVAL, IGNORE
from rigid_body_ros.sensing.alarms import ERROR, Judgement, WARN
from rigid_body_ros.sensing.monitor import Monitor, settings_of
from rigid_body_ros.sensing.reading import KINDS, samples

NAME = 'attitude_monitor'
#: How to decode a message, and what to do with several: stamps, ns, and contents.
_Decode = Callable[[bytes], Any]
_Put = Callable[..., None]
_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
#: s; period of the search for windows that are over, and that of diagnostics.
_WATCH_PERIOD, _REPORT_PERIOD = 0.1, 1.0
#: s; how long to wait for a topic that is behind others by more than `history`. A reliable
#: connection may take three seconds to send a lost message again.
_PATIENCE = 5.0
#: s; a reading of the clock, which takes as long as a message, counts for so long.
_CLOCK_PERIOD = 0.005
#: s; how far a stamp may be ahead of simulated time.
_OVERTAKING = 60.0
#: Number of the first measured topic as a source of diagnostics; torques have lower ones.
_FIRST_MEASURED = 10 ** 6
_SEVERAL = 'messages of several publishers of one topic are taken as those of one sensor'


class AttitudeMonitor(Node):
    """
    Check a model against measurements, window by window.

    It subscribes to the torques of the scene and to the topics of `monitor.measured`. Any executor
    may spin it; all its callbacks are in one mutually exclusive group.

    Parameters
    ----------
    node_name : str
    **kwargs
        Arguments of `rclpy.node.Node`, such as `namespace` or `parameter_overrides`.

    Raises
    ------
    InputError
        The name is not valid, or the parameters are not a scene with a monitor.

    """

    def __init__(self, node_name: str = NAME, **kwargs: Any) -> None:
        with one_line_errors():
            super().__init__(node_name, **kwargs)
        try:
            self._scene = NodeParameters(self, lambda rate: None).scene
            self._settings = settings_of(self._scene.values)
            self._configure()
        except BaseException:  # otherwise the node would stay in the graph
            self.destroy_node()
            raise

    def _configure(self) -> None:
        _check(self._scene)
        topics = self._scene.values['monitor.measured']
        measured = [TorqueTopic(_FIRST_MEASURED + number, topic, '', f'measured {topic}',
                                what='measurement') for number, topic in enumerate(topics)]
        #: By number.
        self._sources = {source.number: source
                         for source in (*sources_of(self._scene), *measured)}
        self._diagnostics = Diagnostics(self, [*self._sources.values()])
        self._inputs = Inputs(self._scene, self._diagnostics)
        self._arrivals, self._clock_check = ArrivalStamps(), ClockMonitor(self)
        self._is_simulated = self.get_parameter('use_sim_time').value
        self._jumps = JumpDetector(self.get_clock(), self._is_simulated,
                                   duration_ns(self._scene.history, 'history'))
        self._attitude, self._rate = (self.create_publisher(Vector3Stamped, f'~/{name}', 10)
                                      for name in ('attitude_error', 'rate_error'))
        self._torque = self.create_publisher(WrenchStamped, '~/residual_torque', 10)
        #: By number of the source: its subscription, how to decode its messages and what to do
        #: with them, and those that wait, each with the time and the stamp of its arrival, ns.
        self._drains: dict[int, DrainCallback] = {}
        self._takes: dict[int, tuple[_Decode, _Put]] = {}
        self._waiting: dict[int, list[tuple[bytes, int, int]]] = {}
        self._begin()
        for source in sources_of(self._scene):
            self._subscribe(source, source.kind, partial(
                self._inputs.torque, source=source.number), self._apply)
        #: s, monotonic clock; when the next report is due, and until when a reading counts.
        self._report_at = self._read_until = 0.0
        self._reading = ClockReading(0, 0)
        self.create_timer(_WATCH_PERIOD, self._watch,
                          clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _begin(self) -> None:
        """Begin without any torque or measurement."""
        self._monitor = Monitor(self._scene.problem(), self._settings)
        self._last: Judgement | None = None
        #: By number of the source: the newest stamp, ns, and whether the topic has attitudes (1),
        #: angular velocities (2) or both (3).
        self._newest_ns: dict[int, int] = {}
        self._measured: dict[int, int] = {}
        #: s, monotonic clock; when a message was accepted, and when the topic was last not behind
        #: others by more than `history`.
        self._heard_at: dict[int, float] = {}
        self._abreast_at: dict[int, float] = {}

    def _subscribe(self, source: TorqueTopic, kind: type, decode: _Decode, put: _Put) -> None:
        number = source.number
        drain = DrainCallback(partial(self._on_message, number), lambda: None,
                              partial(self._diagnostics.count_lost, number))
        with one_line_errors():
            drain.subscription = subscription(self, kind, source.topic, drain, _QOS)
        self._drains[number], self._waiting[number] = drain, []
        self._takes[number] = decode, partial(put, number, drain.subscription.topic_name)

    def _on_message(self, source: int, data: bytes, sender: Sender) -> None:
        self._waiting[source].append((data, self._now_ns(), self._arrivals.stamp()))

    def _take(self) -> None:
        """Take the messages that have arrived, topic by topic: many at once are cheaper."""
        for source, arrived in self._waiting.items():
            self._diagnostics.count(RECEIVED, source, len(arrived))
            decode, put = self._takes[source]
            stamps_ns, found = [], []
            for data, now_ns, arrival_ns in arrived:
                try:
                    message = decode(data)
                    stamps_ns.append(self._stamp(message.stamp_ns, now_ns, arrival_ns))
                    found.append(message)
                except RejectedError as rejected:
                    self._diagnostics.reject(rejected, source)
            arrived.clear()
            if found:
                put(np.array(stamps_ns), found)

    def _stamp(self, stamp_ns: int, now_ns: int, arrival_ns: int) -> int:
        """Return the stamp to use; raise RejectedError if it is not one of the present time."""
        if not now_ns:
            raise RejectedError(NO_CLOCK, 'no time was received on /clock yet')
        if not stamp_ns or self._scene.time_source == ARRIVAL:
            stamp_ns = arrival_ns
        if self._is_simulated:  # a message may overtake the one on /clock sent before it
            check_stamp(stamp_ns, now_ns, _OVERTAKING, 'a lead')
        else:
            check_stamp(stamp_ns, now_ns, self._scene.max_future)
        return stamp_ns

    def _apply(self, source: int, topic: str, stamps_ns: NDArray[np.int64],
               found: Sequence[Torque]) -> None:
        """Put torques into the check."""
        self._count(source, stamps_ns, self._monitor.apply(
            stamps_ns, np.array([torque.values for torque in found]),
            [torque.frame == 'space' for torque in found], source))

    def _measure(self, kind: messages.MessageType, source: int, topic: str,
                 stamps_ns: NDArray[np.int64], found: Sequence[messages.Stamped]) -> None:
        """Put measurements into the check."""
        attitude, rates = samples(kind, np.array([message.values for message in found]))
        sent = np.isfinite(attitude[:, 0]) + 2 * np.isfinite(rates[:, 0])
        if sent.any():
            self._measured.setdefault(source, int(sent[sent > 0][0]))
        # As in a recording, every message of a topic has what the first has.
        usable = sent == self._measured.get(source, -1)
        for _ in range(int(np.sum(~usable))):
            self._diagnostics.reject(RejectedError(
                NOT_FINITE, 'expected a finite attitude, angular velocity or both, as in the '
                'first message, found another'), source)
        self._count(source, stamps_ns[usable], self._monitor.measure(
            topic, stamps_ns[usable], attitude[usable], rates[usable]))

    def _count(self, source: int, stamps_ns: NDArray[np.int64], fits: NDArray[np.bool_]) -> None:
        """Count messages, and reject those that do not fit, because they are too late."""
        for stamp_ns in stamps_ns[~fits].tolist():
            self._diagnostics.reject(RejectedError(
                LATE, f'stamped {stamp_ns} ns, in a window that was judged when a message was '
                f'newer than its end by history ({self._scene.history:g} s)'), source)
        if fits.any():
            newest_ns = int(stamps_ns[fits].max())
            self._newest_ns[source] = max(self._newest_ns.get(source, 0), newest_ns)
            self._heard_at[source] = time.monotonic()
            self._diagnostics.count(APPLIED, source, int(fits.sum()))

    def _measurement(self, data: bytes, kind: messages.MessageType) -> messages.Stamped:
        """Return a measurement; raise RejectedError if it is malformed or in another frame."""
        try:
            message = kind.decode(data)
        except ValueError as error:
            raise RejectedError(MALFORMED, str(error)) from error
        self._check_frame(kind, message)
        return message

    def _check_frame(self, kind: messages.MessageType, message: messages.Stamped) -> None:
        space, body = self._scene.space_frame, self._scene.body_frame
        expected = (body,) if kind in (messages.IMU, messages.VECTOR3) else \
            (space, body) if kind.has_child_frame else (space,)
        for frame, found in zip(expected, (message.frame_id, message.child_frame_id)):
            if found not in ('', frame):
                raise RejectedError(FRAME, f'frame_id: expected {quoted(frame)}, found '
                                    f'{quoted(found)}')

    def _now_ns(self) -> int:
        """Return the time, ns, 0 if there is none yet; begin again if the clock has jumped."""
        if self._reading.now_ns and time.monotonic() < self._read_until:
            return self._reading.now_ns
        reading = self._reading = self._jumps.read()
        self._read_until = time.monotonic() + _CLOCK_PERIOD
        if reading.now_ns:
            self._arrivals.tick(reading.now_ns)
        if reading.jump_ns and self._scene.on_time_jump != IGNORE:
            self._take()
            self._diagnostics.event(TIME_JUMP, f'the clock jumped by {1e-9 * reading.jump_ns:.9g} '
                                    's: the check begins again')
            self._begin()
        return reading.now_ns

    def _watch(self) -> None:
        """Judge the windows that are over; once a second, look for topics, and report."""
        now_ns, now = self._now_ns(), time.monotonic()
        self._take()
        for judgement in self._monitor.judgements(self._complete_ns(now)):
            self._publish(judgement)
        if now > self._report_at:
            self._report_at = now + _REPORT_PERIOD
            self._report(self._problems(), now_ns)

    def _complete_ns(self, now: float) -> int:
        """Return up to when the messages of all topics but silent ones have arrived, ns."""
        newest_ns = self._monitor.newest_ns
        history_ns = duration_ns(self._scene.history, 'history')
        sending = []
        for number in self._drains:
            found_ns = self._newest_ns.get(number, 0)
            if found_ns >= newest_ns - history_ns or number not in self._abreast_at:
                self._abreast_at[number] = now
            # After a pause of the process, its messages may wait behind those of other topics.
            if now < max(self._abreast_at[number], self._heard_at.get(number, 0.0)) + _PATIENCE:
                sending.append(found_ns)
        return min(sending, default=newest_ns) - history_ns

    def _publish(self, judgement: Judgement) -> None:
        error, body = judgement.error, self._scene.body_frame
        if not np.isnan(error.attitude[0]):
            self._attitude.publish(messages.VECTOR3.encode(error.end_ns, body, error.attitude))
        self._rate.publish(messages.VECTOR3.encode(error.end_ns, body, error.rate))
        self._torque.publish(messages.wrench(error.end_ns, body, error.torque))
        before, self._last = self._last, judgement
        if judgement.level == ERROR and not (before and before.level == ERROR):
            self.get_logger().error(_described(judgement))

    def _problems(self) -> dict[int, list[str]]:
        """Return problems by source, and subscribe to the topics that have a type by now."""
        problems: dict[int, list[str]] = {number: [] for number in self._sources}
        problems[next(iter(problems))] = self._clock_check.problems()
        for number, source in self._sources.items():
            if number not in self._drains:
                problems[number] = self._found(source)
        return problems

    def _found(self, source: TorqueTopic) -> list[str]:
        topic = self.resolve_topic_name(source.topic)
        names = {info.topic_type for info in self.get_publishers_info_by_topic(topic)}
        kinds = {kind.name: kind for kind in KINDS if not kind.is_list}
        if not names:
            return [f'{topic}: no publisher']
        if len(names) > 1 or not names <= {*kinds}:
            return [f'{topic}: expected one of {listed(kinds)}, found {listed(names)}']
        name = names.pop()
        package, _, kind = name.split('/')
        self._subscribe(source, getattr(import_module(f'{package}.msg'), kind),
                        partial(self._measurement, kind=kinds[name]),
                        partial(self._measure, kinds[name]))
        return []

    def _report(self, problems: dict[int, list[str]], now_ns: int) -> None:
        ages = {number: 1e-9 * (now_ns - self._newest_ns[number]) if number in self._newest_ns
                else None for number in self._sources}
        for number, age in ages.items():
            if age is not None and age > self._scene.stale_after > 0.0:
                problems[number].append(f'{self._sources[number].topic}: nothing for {age:.3g} s')
        drains = self._drains
        inputs = [drain.subscription for drain in drains.values()]
        outputs = [self._attitude, self._rate, self._torque]
        found = self._diagnostics.connection_problems(problems, drains, inputs, outputs, _SEVERAL)
        self._diagnostics.publish(found, Counter(), ages, 'checked in windows of '
                                  f'{self._settings.window:g} s', self.get_clock().now().to_msg(),
                                  [self._status()])

    def _status(self) -> DiagnosticStatus:
        """Return the status of the model."""
        last = self._last
        if last is None:
            return self._diagnostics.status('model', False, False, 'no window yet', {})
        error, noises = last.error, self._monitor.noises
        return self._diagnostics.status(
            'model', last.level == ERROR, last.level == WARN, _described(last), {
                'sigma': f'{last.sigma:.2f}', 'windows tested together': last.windows,
                'largest component': last.axis, 'since (ns)': last.since_ns,
                'end of the window (ns)': error.end_ns, 'outliers': error.outliers,
                'windows skipped': self._monitor.skipped,
                'attitude error (rad)': as_json(error.attitude),
                'rate error (rad/s)': error.rate.tolist(),
                'residual torque (N m)': error.torque.tolist(),
                **{f'noise of {topic} ({unit})': f'{level.found:.3g} (stated {level.stated:g})'
                   for topic, levels in noises.items()
                   for level, unit in zip(levels, ('rad', 'rad/s')) if level.is_measured}})


def _described(judgement: Judgement) -> str:
    windows = f'{judgement.windows} windows together' if judgement.windows > 1 else 'one window'
    if judgement.level not in (WARN, ERROR):
        return f'the model explains the measurements ({judgement.sigma:.1f} sigma at most)'
    return (f'the model does not explain the measurements: {judgement.sigma:.1f} sigma in '
            f'{windows}, since {judgement.since_ns} ns; {judgement.axis} is off most')


def _check(scene: Scene) -> None:
    """Raise InputError if a scene is not one that a monitor can check."""
    for name in ('monitor.attitude_noise', 'monitor.rate_noise'):
        if not scene.values[name]:
            raise InputError(f'{name}: expected the standard deviation of a component, found 0')
    if not scene.values['monitor.measured']:
        raise InputError('monitor.measured: expected at least one topic, found an empty list')
    if scene.named_wheels:
        raise InputError('wheel_names: expected none, because attitude_monitor knows rotors '
                         f'without names, found {listed(scene.values["wheel_names"])}')
    if scene.inertia_topic:
        raise InputError('inertia_topic: expected false, because attitude_monitor checks one '
                         'inertia, found true')
    if scene.named_wheels:
        raise InputError('wheel_names: expected none, because attitude_monitor does not know the '
                         f'speeds of wheels, found {listed(scene.values["wheel_names"])}')
    if scene.values['actuator.topics']:
        raise InputError('actuator.topics: expected none, because attitude_monitor takes torques '
                         'as they act, such as those on applied_torque, found '
                         f'{listed(scene.values["actuator.topics"])}')


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the monitor until SIGINT or SIGTERM; raise InputError as `AttitudeMonitor` does."""
    run(arguments, AttitudeMonitor, NAME)
