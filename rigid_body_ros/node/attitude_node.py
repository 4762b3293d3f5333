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
Provide `AttitudeNode`, the plain node, and `main`, which runs it as a command.

`AttitudeComponent` is the part that the plain node and the managed node share: everything except
the lifecycle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import time
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rigid_body_ros import messages, scene
from rigid_body_ros.common.arrays import written
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.live.checkpoint import Checkpoint
from rigid_body_ros.live.events import RejectedError, UNSAVED
from rigid_body_ros.live.inputs import decoded, Torque
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.node.clock_mode import ClockMode
from rigid_body_ros.node.diagnostics import Diagnostics
from rigid_body_ros.node.intake import PollingNode, subscription
from rigid_body_ros.node.lockstep import Lockstep
from rigid_body_ros.node.outputs import OnLog, Publishers
from rigid_body_ros.node.parameters import check_qos_overrides, NodeParameters
from rigid_body_ros.node.process import one_line_errors, run, timer
from rigid_body_ros.node.realtime import Realtime
from rigid_body_ros.node.sources import check_topics, COMMANDS, sources_of
from rigid_body_ros.scene.parameters import CLOCK, LOCKSTEP, REALTIME
from std_srvs.srv import Trigger

_MODES: dict[str, type[Lockstep | Realtime]] = {
    REALTIME: Realtime, LOCKSTEP: Lockstep, CLOCK: ClockMode}
#: When a node ends, it may spend at most this many seconds on publishing the pending states.
_END_TIME = 0.8
#: How often to check for silent sources, and how often to publish diagnostics, in seconds. The
#: second period is a multiple of the first.
_WATCH_PERIOD, _REPORT_PERIOD = 0.1, 1.0


class AttitudeComponent:
    """
    Compute the attitude of a rigid body from torques on a topic, and publish it.

    Parameters
    ----------
    node : PollingNode
        A node whose parameters describe the scene. All callbacks join the node's default group.
    is_managed : bool
        Whether the scene parameters may change after the component is destroyed.
    on_log : callable, optional
        See `Publishers`.

    Attributes
    ----------
    mode : str
        The mode that the scene specifies.

    Raises
    ------
    InputError
        The parameters do not describe a valid scene.

    """

    def __init__(self, node: PollingNode, is_managed: bool = False,
                 on_log: OnLog | None = None) -> None:
        self._node, self._on_log, others = node, on_log, _entities(node)
        #: The entities (publishers, subscriptions, services and timers) that `activate` has
        #: created, followed by those that the constructor has created.
        self._active: set[Any] = set()
        self._own: set[Any] = set()
        self._parameters = NodeParameters(node, lambda rate: self._mode.set_rate(rate), is_managed)
        try:
            self._configure()
        except BaseException:
            self._own = _entities(node) - others
            self.destroy()
            raise
        self._own = _entities(node) - others

    def _configure(self) -> None:
        self._scene = self._parameters.scene
        self.mode = self._scene.mode
        self._sources = sources_of(self._scene)
        path, name = self._scene.checkpoint, self._node.get_fully_qualified_name()
        self._checkpoint = Checkpoint(path, self._scene, name) if path else None
        self._announce()
        with one_line_errors():
            self._diagnostics = Diagnostics(self._node, self._sources,
                                            self._scene.stamp_offset_warning)
            self._outputs = Publishers(self._node, self._scene, self._sources, self._diagnostics,
                                       self._on_log)
            self._mode = _MODES[self.mode](self._node, self._parameters, self._outputs,
                                           self._diagnostics, self._checkpoint)
            self._intake = self._mode.intake
        #: The sources that were silent at the last check.
        self._silent: set[int] = set()
        #: When the next diagnostics are due, in seconds on the monotonic clock.
        self._report_at = 0.0

    def activate(self) -> None:
        """
        Subscribe to the inputs, and begin to publish the motion.

        Raises
        ------
        InputError
            A topic name or a quality of service is not valid.

        """
        others = _entities(self._node)
        try:
            with one_line_errors():
                self._mode.activate()
                self._subscribe()
                self._node.create_service(Trigger, '~/reset', self._on_reset)
                timer(self._node, _WATCH_PERIOD, self._watch)
        finally:
            self._active |= _entities(self._node) - others

    def deactivate(self) -> None:
        """Unsubscribe and stop publishing, but keep the motion."""
        self._active.update(self._intake.subscriptions)
        self._intake.close()
        self._mode.deactivate()
        self._destroy(self._active)

    def finish(self) -> None:
        """Publish all pending states and the last diagnostics, unless ROS has been shut down."""
        if not self._node.context.ok():
            self._node.get_logger().warning('ROS was shut down before this node was destroyed: '
                                            'pending states are not published')
            return
        begin = time.monotonic()
        until, half_time = begin + _END_TIME, begin + 0.5 * _END_TIME
        self._mode.take()
        while not self._mode.process() and time.monotonic() < half_time:
            pass  # keep the other half of the time for committing the remaining states
        now_ns = self._mode.now_ns() if self._mode.run.epoch else 0
        self._mode.end(until)
        last = self._mode.run.committed
        if self._checkpoint:
            self._save(self._checkpoint.save_last)
        self._report({}, now_ns)
        self._node.get_logger().info('the motion ends; the last committed state is '
                                     + (f'that at {last.time_ns} ns' if last else 'none'))
        if not self._outputs.deliver(until):
            self._node.get_logger().warning('the end of the log may be lost: its subscribers have '
                                            f'not acknowledged it within {_END_TIME:g} s')

    def destroy(self) -> None:
        """Destroy everything the component has created, and release the parameters."""
        if self._active:
            self.deactivate()
        self._destroy(self._own)
        self._parameters.release()

    def _destroy(self, entities: set[Any]) -> None:
        node = self._node
        while entities:
            entity = entities.pop()
            any(destroy(entity) for destroy in (
                node.destroy_subscription, node.destroy_timer, node.destroy_service,
                node.destroy_publisher))

    def _announce(self) -> None:
        body, log = self._scene.body, self._node.get_logger().info
        saved = self._checkpoint and self._checkpoint.start
        start, source = (saved, f'the checkpoint {self._checkpoint}') if saved else \
            (self._scene.start, 'the initial state of the scene')
        first = 'stamp of the first torque' if self.mode == LOCKSTEP else 'first clock reading'
        when = f'{start.time_ns} ns' if start.time_ns else f'the {first}'
        log(f'starts at {when} from {source}: attitude {written(start.attitude)} (x y z w), '
            f'angular velocity {written(start.angular_velocity)} rad/s')
        log(f'{body.symmetry}, principal moments {written(body.principal_moments)} kg m^2')
        for note in self._scene.notes:
            self._node.get_logger().info(note)
        for warning in self._scene.warnings:
            self._node.get_logger().warning(warning)

    def _subscribe(self) -> None:
        self._states = subscription(
            self._node, messages.ODOMETRY, 'initial_state', self._on_state,
            QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE))
        check_topics(self._node, self._sources, [self._states.topic_name, *(
            publisher.topic_name for publisher in self._outputs.publishers)])
        self._intake.listen()
        others = check_qos_overrides(self._node, self._listening, self._outputs.publishers)
        if others:
            self._node.get_logger().info(
                f'QoS overrides of other nodes are ignored: {listed(others)}')

    @property
    def _listening(self) -> list[Subscription[Any]]:
        return [*self._intake.subscriptions, self._states]

    def _on_state(self, data: bytes) -> None:
        stamp_ns = None
        try:
            odometry = decoded(messages.ODOMETRY, data)
            stamp_ns = odometry.stamp_ns
            result = self._mode.set_state(self._intake.inputs.state(odometry))
            self._diagnostics.accept_state(result, stamp_ns)
        except RejectedError as rejected:
            self._diagnostics.reject_state(rejected, stamp_ns)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message = self._mode.reset()
            response.success = True
        except RejectedError as rejected:
            response.message = str(rejected)
        return response

    def _watch(self) -> None:
        """
        Publish diagnostics and save a checkpoint once a second.

        Diagnostics are also published as soon as a source falls silent or sends again.
        """
        self._intake.listen()
        now_ns = self._mode.now_ns()
        silent = {torque.source: torque for torque in self._mode.run.silent(now_ns)}
        for source in silent.keys() - self._silent:
            self._node.get_logger().warning(self._silence(silent[source], now_ns))
        now = time.monotonic()
        # The timer is not exact, and may skip periods on a busy machine.
        is_due = now > self._report_at - 0.5 * _WATCH_PERIOD
        if is_due:
            self._report_at = max(self._report_at, now - 0.5 * _REPORT_PERIOD) + _REPORT_PERIOD
        if is_due or silent.keys() != self._silent:
            problems = self._mode.problems()
            for source, torque in silent.items():
                problems[source].append(self._silence(torque, now_ns))
            self._report(self._diagnostics.connection_problems(
                problems, self._intake.drains, self._listening, self._outputs.publishers,
                self._mode.several_publishers), now_ns)
        self._silent = {*silent}
        self._intake.follow_types(is_due)
        self._outputs.flush()  # for listeners that came later, and before a state is saved
        if is_due and self._checkpoint:
            self._save(self._checkpoint.save)

    def _silence(self, torque: Torque, now_ns: int) -> str:
        topic = self._intake.topic(torque.source)
        axes = 'on the wheels' if torque.source == COMMANDS else f'in {torque.frame} axes'
        return (f'{topic}: no torque for {self._mode.run.age(torque.source, now_ns):.3g} s: the '
                f'last one, {torque.values.tolist()} N m {axes}, still acts '
                f'(stale_after: {self._scene.stale_after:g} s)')

    def _save(self, save: Callable[[State | None], None]) -> None:
        try:
            save(self._mode.run.committed)
        except InputError as error:
            self._diagnostics.event(UNSAVED, str(error))

    def _report(self, problems: Mapping[int, list[str]], now_ns: int) -> None:
        run = self._mode.run
        epoch = 'waiting for the first torque or clock reading' if run.epoch is None else \
            f'epoch from {run.epoch.start.time_ns} ns'
        ages = {source.number: run.age(source.number, now_ns) for source in self._sources}
        self._diagnostics.publish(problems, self._mode.waiting, ages, epoch, self._mode.stamp())


def _entities(node: Node) -> set[Any]:
    return {*node.publishers, *node.subscriptions, *node.services, *node.timers}


class AttitudeNode(PollingNode):
    """
    Compute the attitude of a rigid body from torques on a topic, and publish it.

    You can spin this node in any executor, alone or together with other nodes. All its callbacks
    are in one mutually exclusive group, so a MultiThreadedExecutor runs only one of them at a
    time.

    If the parameters give neither an inertia nor a URDF, the constructor waits until a URDF
    arrives on the topic `robot_description`.

    Parameters
    ----------
    node_name : str
    on_log : callable, optional
        Called with the name of a log, such as '~/committed', and each message of it. The log is
        then not published.
    **kwargs
        Arguments of `rclpy.node.Node`, such as `namespace` or `parameter_overrides`.

    Raises
    ------
    InputError
        The node name is not valid, or the parameters do not describe a valid scene.

    """

    #: The component, from its activation until it has published the pending states. None before
    #: and after this time.
    _component: AttitudeComponent | None = None

    def __init__(self, node_name: str = scene.NODE, on_log: OnLog | None = None,
                 **kwargs: Any) -> None:
        self._on_log = on_log
        super().__init__(node_name, **kwargs)

    def _start(self) -> None:
        component = AttitudeComponent(self, on_log=self._on_log)
        component.activate()
        self._component = component

    def destroy_node(self) -> None:
        """Publish all pending states and the last diagnostics, and then destroy the node."""
        if self._component:
            self._component.finish()
        self._component = None
        super().destroy_node()


def main(arguments: Sequence[str] | None = None) -> None:
    """
    Run the node until it receives SIGINT or SIGTERM.

    Raises
    ------
    InputError
        The arguments or parameters are not valid.

    """
    run(AttitudeNode, scene.NODE, arguments)
