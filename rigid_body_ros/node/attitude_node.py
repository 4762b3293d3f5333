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

"""`AttitudeNode`, and `main`, which runs the node."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from copy import copy
from functools import partial
import os
from pathlib import Path
import signal
import sys
import time
from typing import Any

from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.utilities import remove_ros_args
from rigid_body_ros import scene
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.node.diagnostics import Diagnostics, RECEIVED
from rigid_body_ros.node.drain import DrainCallback, Sender
from rigid_body_ros.node.epoch import warm_up_for
from rigid_body_ros.node.inputs import Inputs, RejectedError
from rigid_body_ros.node.lockstep import Lockstep
from rigid_body_ros.node.outputs import Outputs
from rigid_body_ros.node.parameters import check_qos_overrides, Parameters
from rigid_body_ros.node.realtime import Realtime
from rigid_body_ros.node.sources import check_topics, Source, sources_of
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.scene import LOCKSTEP
from std_srvs.srv import Trigger

try:
    from rclpy.event_handler import SubscriptionEventCallbacks
except ModuleNotFoundError:  # Humble
    from rclpy.qos_event import SubscriptionEventCallbacks

#: Best effort matches any publisher; in lockstep a lost torque stops the loop.
_TORQUE_QOS = {scene.REALTIME: QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT),
               LOCKSTEP: QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)}
#: s; how long a clean shutdown may take.
_SHUTDOWN_TIME = 0.8
#: s; period of the worker. A slice of work takes longer, so slices follow each other immediately.
#: The worker is idle between slices only while all torques wait for the clock.
_WORK_PERIOD = 0.001
#: s; period of the check for signals.
_SIGNAL_PERIOD = 0.1


class AttitudeNode(Node):
    """
    Compute the attitude of a rigid body from torques on a topic, and publish it.

    Raises
    ------
    InputError
        The parameters are not a valid scene.

    """

    def __init__(self) -> None:
        try:
            super().__init__(scene.NODE, automatically_declare_parameters_from_overrides=True)
        except ValueError as error:  # rclpy reads an empty list as no value, and does not name it
            raise InputError('expected a value for each parameter, found one without a value, '
                             'such as an empty list') from error
        parameters = Parameters(self, lambda rate: self._mode.set_rate(rate))
        self._scene = parameters.scene
        self._sources = sources_of(self._scene)
        self._announce()
        warm_up_for(self._scene, self.get_logger().info)
        try:
            self._diagnostics = Diagnostics(self, self._sources)
            self._inputs = Inputs(self._scene, self._diagnostics.count_force)
            self._outputs = Outputs(self, self._scene, self._sources, self._diagnostics)
            mode = Lockstep if self._scene.values['mode'] == LOCKSTEP else Realtime
            self._mode = mode(self, parameters, self._inputs, self._outputs, self._diagnostics)
            self._subscribe()
            self._mode.connect(self._torques)
            check_qos_overrides(self, self._listening, self._outputs.publishers)
        except (RuntimeError, AssertionError) as error:  # such as an invalid QoS override
            raise InputError(' '.join(str(error).split())) from error
        self.create_service(Trigger, '~/reset', self._on_reset)
        parameters.make_read_only()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self._publish_diagnostics, clock=steady)
        #: Active while torques or a state wait: one slice of work in each cycle of the executor.
        self._worker = self.create_timer(_WORK_PERIOD, self._work, clock=steady)
        self._worker.cancel()
        self._mode.pipeline.wake = self._start_worker

    def finish(self, until: float) -> None:
        """Publish pending states and the last diagnostics by `until`, s, monotonic clock."""
        pipeline = self._mode.pipeline
        half_time = 0.5 * (time.monotonic() + until)  # the rest is for the states held back
        while not pipeline.process() and time.monotonic() < half_time:
            pass
        pipeline.end(until)
        self._report([])
        self._outputs.deliver(until)

    def _announce(self) -> None:
        body = self._scene.body
        self.get_logger().info(
            f'{body.symmetry}, principal moments {body.principal_moments.tolist()} kg m^2')
        for warning in self._scene.warnings:
            self.get_logger().warning(warning)

    def _subscribe(self) -> None:
        def subscription(kind: type, topic: str, callback: Callable[..., None],
                         qos: QoSProfile, events: SubscriptionEventCallbacks) -> Subscription:
            return self.create_subscription(
                kind, topic, callback, copy(qos), raw=True, event_callbacks=events,
                qos_overriding_options=QoSOverridingOptions.with_default_policies())

        def torques(source: Source) -> Subscription:
            callback = DrainCallback(partial(self._on_torque, source.number), self._start_work,
                                     partial(self._diagnostics.count_missing, source.number))
            callback.subscription = subscription(
                WrenchStamped, source.topic, callback, _TORQUE_QOS[self._scene.values['mode']],
                SubscriptionEventCallbacks(message_lost=partial(self._on_lost, source.number),
                                           use_default_callbacks=False))
            return callback.subscription
        self._states = subscription(
            Odometry, 'initial_state', self._on_state,
            QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE),
            SubscriptionEventCallbacks(use_default_callbacks=False))
        check_topics(self, self._sources, [self._states.topic_name, *(
            publisher.topic_name for publisher in self._outputs.publishers)])
        #: By number of the source.
        self._torques = {source.number: torques(source) for source in self._sources}

    @property
    def _listening(self) -> list[Subscription]:
        return [*self._torques.values(), self._states]

    def _on_torque(self, source: int, data: bytes, sender: Sender) -> None:
        self._diagnostics.count(RECEIVED, source)
        try:
            self._mode.enqueue(data, sender, source)
        except RejectedError as rejected:
            self._diagnostics.reject(rejected, source)

    def _start_work(self) -> None:
        if self._worker.is_canceled():  # otherwise the timer continues the work
            self._work()

    def _work(self) -> None:
        if self._mode.pipeline.process():
            self._worker.cancel()
        else:
            self._start_worker()

    def _start_worker(self) -> None:
        if self._worker.is_canceled():  # a reset would postpone a running one
            self._worker.reset()

    def _on_state(self, data: bytes) -> None:
        try:
            self._mode.set_state(self._inputs.state(data))
            self._diagnostics.count_state()
        except RejectedError as rejected:
            self._diagnostics.reject_state(rejected)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message = self._mode.reset()
            response.success = True
        except RejectedError as rejected:
            response.message = str(rejected)
        return response

    def _on_lost(self, source: int, event: Any) -> None:
        self._diagnostics.count_lost(source, event.total_count_change)

    def _publish_diagnostics(self) -> None:
        problems = self._mode.problems() + self._diagnostics.connection_problems(
            self._torques.values(), self._listening, self._outputs.publishers,
            self._mode.several_publishers)
        self._report(problems)

    def _report(self, problems: list[str]) -> None:
        pipeline = self._mode.pipeline
        epoch = 'waiting for the first torque or clock reading' if pipeline.epoch is None else \
            f'epoch from {pipeline.epoch.start.time_ns} ns'
        self._diagnostics.publish(problems, pipeline.waiting_by_source(), epoch,
                                  self._mode.stamp())


def main(arguments: Sequence[str] | None = None) -> None:
    """
    Run the node until SIGINT or SIGTERM.

    Raises
    ------
    InputError
        The arguments or parameters are not valid.

    """
    stop: list[int] = []
    try:
        _initialize(sys.argv if arguments is None else ['attitude_node', *arguments])
        node = AttitudeNode()
        executor = _executor()
        executor.add_node(node)
        # From here on a signal does not interrupt a callback.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda number, frame: stop.append(number))
        interrupts.check()
        while not stop:
            # With a timeout, to notice signals; without one EventsExecutor may hang.
            executor.spin_once(timeout_sec=_SIGNAL_PERIOD)
        node.finish(time.monotonic() + _SHUTDOWN_TIME)
        node.destroy_node()
    finally:
        rclpy.try_shutdown()


def _executor() -> Executor:
    try:  # takes half the processor time per message
        from rclpy.experimental import EventsExecutor
    except ImportError:  # before Jazzy
        return SingleThreadedExecutor()
    return EventsExecutor()


def _initialize(command_line: Sequence[str]) -> None:
    try:
        others = remove_ros_args(command_line)[1:]
        argparse.ArgumentParser(
            'attitude_node',
            description='Compute the attitude of a rigid body from torques on a topic.',
            epilog='Pass the scene as ROS parameters: --ros-args --params-file FILE',
        ).parse_args(others)
        # rclpy's own handlers would shut ROS down before the last states are published.
        rclpy.init(args=[*command_line, *_without_log_file()],
                   signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise InputError(' '.join(str(error).split())) from error


def _without_log_file() -> list[str]:
    """Return the arguments that disable the log file of rcl if its folder is not writable."""
    home = Path(os.environ.get('ROS_HOME') or '~/.ros')
    folder = Path(os.environ.get('ROS_LOG_DIR') or home / 'log').expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        writable = False
    else:
        writable = os.access(folder, os.W_OK)
    return [] if writable else ['--ros-args', '--disable-external-lib-logs', '--']
