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

"""Provide `AttitudeMonitor`, a node that checks the model against measurements as they arrive."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Vector3Stamped, WrenchStamped
import numpy as np
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import as_json
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.inference.evidence import Suspect
from rigid_body_ros.inference.monitor import ERROR, first_suspect, Judgement, WARN
from rigid_body_ros.node.intake import PollingNode
from rigid_body_ros.node.monitor_inputs import MonitorInputs
from rigid_body_ros.node.parameters import NodeParameters
from rigid_body_ros.node.process import main as run
from rigid_body_ros.node.timers import timer
from rigid_body_ros.scene import Scene

NAME = 'attitude_monitor'
#: How often to look for windows that have ended, and how often to publish diagnostics, in seconds.
_WATCH_PERIOD, _REPORT_PERIOD = 0.1, 1.0
_SEVERAL = 'messages of several publishers on one topic are treated as those of one sensor'


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
        inputs, problems = self._inputs, self._inputs.problems()
        found = inputs.diagnostics.connection_problems(
            problems, inputs.intake.drains, inputs.intake.subscriptions,
            [self._attitude, self._rate, self._torque], _SEVERAL)
        window = self._scene.values['monitor.window']
        inputs.diagnostics.publish(found, Counter(), inputs.ages(), 'checked in windows of '
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
                **{f'noise of {topic} ({unit})': f'{level.found:.3g} (stated {level.stated:g})'
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
    run(arguments, AttitudeMonitor, NAME)
