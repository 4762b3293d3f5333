"""The ROS shell: torques of a topic in, attitude out, in real time."""

from __future__ import annotations

import argparse
import bisect
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from dataclasses import replace
import signal
import sys
import time
from typing import Any

from geometry_msgs.msg import QuaternionStamped, Vector3Stamped, WrenchStamped
from nav_msgs.msg import Odometry
import numpy as np
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from rigid_body_ros import euler, messages, scene
from rigid_body_ros.body import State
from rigid_body_ros.propagate import Propagator, warm_up
from rigid_body_ros.scene import InputError, Scene

#: Parameters that do not define the trajectory.
_CHANGEABLE = ('publish_rate',)
_TORQUE_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
_STATE_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
# The log of a run: all of it counts, for a recorder that comes a moment later too, and the
# states of the last `history` go out in one burst at the end.
_LOG_QOS = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.RELIABLE,
                      durability=DurabilityPolicy.TRANSIENT_LOCAL)
_REPORT_EVERY_S = 5.0
#: rad/s^2. A torque held at this turns any body by a radian a nanosecond within a second.
_LARGEST_ACCELERATION = 1e9
#: How long a clean end may take, and of that to wait for a recorder that does not answer.
_PATIENCE_S, _DELIVERY_S = 0.6, 0.2


class AttitudeNode(Node):
    """
    Publish the attitude of a body that the torques of a topic turn.

    Raises
    ------
    InputError
        The parameters are no valid scene.

    """

    def __init__(self) -> None:
        super().__init__(scene.NODE, automatically_declare_parameters_from_overrides=True)
        self._scene = self._declare_parameters()
        values = self._scene.values
        self._space_frame, self._body_frame = values['space_frame'], values['body_frame']
        self._max_future_ns = round(values['max_future'] * 1e9)
        self._propagator: Propagator | None = None
        self._largest_torque = _LARGEST_ACCELERATION * self._scene.body.principal_moments[0]
        self._start_ns = self._scene.start.time_ns
        #: Stamps whose states a late torque may still change, ascending.
        self._pending: list[int] = []
        self._refused: Counter[str] = Counter()
        self._reported: dict[str, int] = {}
        warm_up()
        self._announce()
        try:
            self._create_publishers()
            self.add_on_set_parameters_callback(self._on_set_parameters)
            self._begin()
            self._create_inputs()
        except (RuntimeError, AssertionError) as error:  # such as a QoS override that is none
            raise InputError(' '.join(str(error).split())) from error

    def finish(self) -> None:
        """Publish the states that were held back for late torques, and see them delivered."""
        until = time.monotonic() + _DELIVERY_S
        while self._pending:  # no more at once than the queue holds
            self._commit(self._pending[:_LOG_QOS.depth][-1])
            self._await_delivery(self._committed, until)
        self._await_delivery(self._accepted, until)

    def _await_delivery(self, publisher: Publisher, until: float) -> None:
        rest = max(0.0, until - time.monotonic())
        with suppress(RuntimeError):  # not every middleware can tell
            publisher.wait_for_all_acked(Duration(nanoseconds=round(rest * 1e9)))

    def _declare_parameters(self) -> Scene:
        # What the user gave is declared already, as the types that were given. Check it as one
        # scene, then declare each parameter with its own type and description.
        given = {name: parameter.value
                 for name, parameter in self.get_parameters_by_prefix('').items()}
        checked = Scene.from_values(given)
        if checked.values['solver'] == 'exact':
            raise InputError("solver: expected one that takes torques, found 'exact'")
        if checked.values['interpolation'] != 'hold':
            raise InputError('interpolation: expected hold, as the next torque is not known yet, '
                             f'found {checked.values["interpolation"]!r}')
        for name, value in checked.values.items():
            if name in given:
                self.undeclare_parameter(name)
            self.declare_parameter(name, value, _descriptor(scene.PARAMETERS[name]),
                                   ignore_override=True)
        return checked

    def _announce(self) -> None:
        body = self._scene.body
        self.get_logger().info(
            f'{body.symmetry}, principal moments {body.principal_moments.tolist()} kg m^2')
        if body.triangle_excess:
            self.get_logger().warning(
                'inertia: the largest principal moment exceeds the sum of the others by '
                f'{body.triangle_excess:.2g} of it, which no body has: rounded numbers?')

    def _create_publishers(self) -> None:
        def publisher(kind: type, topic: str, qos: QoSProfile) -> Publisher:
            # A copy: rclpy writes the overrides of one topic into the profile it is given.
            return self.create_publisher(
                kind, topic, copy(qos),
                qos_overriding_options=QoSOverridingOptions.with_default_policies())
        self._attitude = publisher(QuaternionStamped, 'attitude', _STATE_QOS)
        self._euler_angles = publisher(Vector3Stamped, 'euler_angles', _STATE_QOS)
        self._angular_velocity = publisher(Vector3Stamped, 'angular_velocity', _STATE_QOS)
        self._accepted = publisher(WrenchStamped, '~/accepted_torque', _LOG_QOS)
        self._committed = publisher(Odometry, '~/committed', _LOG_QOS)

    def _create_inputs(self) -> None:
        self._torques = self.create_subscription(
            WrenchStamped, 'torque', self._on_torque, copy(_TORQUE_QOS), raw=True,
            qos_overriding_options=QoSOverridingOptions.with_default_policies())
        # A wall clock may be set back, which would stop a timer that follows it.
        simulated = self.get_parameter('use_sim_time').value
        pace = self.get_clock() if simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(1.0 / self._scene.values['publish_rate'], self._publish,
                                        clock=pace)

    def _begin(self) -> bool:
        """Open the epoch once the clock is valid; return whether it is open."""
        if self._propagator is not None:
            return True
        now_ns = self.get_clock().now().nanoseconds
        if not now_ns:  # simulated time before the first message of /clock
            return False
        self._start_ns = self._start_ns or now_ns
        self.set_parameters([Parameter('start_time', value=self._start_ns)])
        start = replace(self._scene.start, time_ns=self._start_ns)
        self._propagator = Propagator(self._scene.body, start, **self._scene.options,
                                      history=self._scene.values['history'])
        self._publish_committed(start)
        self.get_logger().info(f'the initial state holds at {self._start_ns} ns')
        return True

    def _on_set_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        values = {parameter.name: parameter.value for parameter in parameters}
        if values.get('start_time', self._start_ns) != self._start_ns:
            return SetParametersResult(successful=False, reason='start_time: read-only in a '
                                       'running node: it defines the trajectory')
        if 'publish_rate' in values:
            try:
                rate = scene.checked(scene.PARAMETERS['publish_rate'], values['publish_rate'])
            except InputError as error:
                return SetParametersResult(successful=False, reason=str(error))
            self._timer.timer_period_ns = round(1e9 / rate)
        return SetParametersResult(successful=True)

    def _on_torque(self, data: bytes) -> None:
        now_ns = self.get_clock().now().nanoseconds
        if not self._begin():
            self._refuse('no clock', 'a torque came before the first message of /clock')
            return
        try:
            wrench = messages.WRENCH.decode(data)
            frame = messages.torque_frame(wrench.frame_id, self._body_frame, self._space_frame)
        except ValueError as error:
            self._refuse('unknown frame or malformed', str(error))
            return
        torque = messages.torque(wrench)
        if not np.isfinite(torque).all():
            self._refuse('not finite', f'expected a finite torque, found {torque.tolist()}')
            return
        if np.linalg.norm(torque) > self._largest_torque:
            self._refuse('too large', f'expected a torque of at most {self._largest_torque:.3g} '
                         f'N m for this inertia, found {torque.tolist()}')
            return
        if wrench.values[:3].any():
            self._refused['force'] += 1
            self._report('force', 'the force of a WrenchStamped is ignored: torques are about '
                         'the centre of mass', once=True)
        self._take(wrench.stamp_ns or now_ns, torque, frame, now_ns)

    def _take(self, stamp_ns: int, torque: Any, frame: str, now_ns: int) -> None:
        assert self._propagator is not None
        if stamp_ns - now_ns > self._max_future_ns:
            self._refuse('future', f'a torque is stamped {(stamp_ns - now_ns) * 1e-9:.9g} s ahead '
                         'of the clock')
            return
        # What this stamp puts beyond the reach of later ones is final before it is applied.
        self._commit(stamp_ns - self._propagator.history_ns)
        if not self._propagator.apply(stamp_ns, torque, frame):
            self._refuse('late', 'a torque is older than the newest stamp by history '
                         f'({self._propagator.history_ns * 1e-9:g} s) or more, and '
                         f'{(now_ns - stamp_ns) * 1e-9:.9g} s behind the clock')
            return
        frame_id = self._body_frame if frame == 'body' else self._space_frame
        self._accepted.publish(messages.wrench(stamp_ns, frame_id, torque))
        if stamp_ns > self._start_ns:
            place = bisect.bisect_left(self._pending, stamp_ns)
            if self._pending[place:place + 1] != [stamp_ns]:
                self._pending.insert(place, stamp_ns)

    def _commit(self, horizon_ns: int) -> None:
        """Publish the states at the stamps up to a time."""
        count = bisect.bisect_right(self._pending, horizon_ns)
        for stamp_ns in self._pending[:count]:
            state = self._state(stamp_ns)
            if state is not None:
                self._publish_committed(state)
        del self._pending[:count]

    def _publish(self) -> None:
        if not self._begin():
            return
        began = time.monotonic()
        now_ns = self.get_clock().now().nanoseconds
        state = self._state(now_ns)
        if state is None:
            return
        if (seconds := time.monotonic() - began) > self._timer.timer_period_ns * 1e-9:
            self._report('slow', f'the motion, at {np.linalg.norm(state.angular_velocity):.3g} '
                         f'rad/s, takes {seconds:.2g} s to work out: no longer in real time')
        angles = euler.from_quaternion(state.attitude, self._scene.values['euler_sequence'])
        for publisher, kind, frame_id, values in (
                (self._attitude, messages.QUATERNION, self._space_frame, state.attitude),
                (self._euler_angles, messages.VECTOR3, self._space_frame, angles),
                (self._angular_velocity, messages.VECTOR3, self._body_frame,
                 state.angular_velocity)):
            publisher.publish(kind.encode(now_ns, frame_id, values))

    def _publish_committed(self, state: State) -> None:
        self._committed.publish(messages.odometry(state, self._space_frame, self._body_frame))

    def _state(self, time_ns: int) -> State | None:
        """Return the state at a time, or None (and say why) where there is no finite one."""
        assert self._propagator is not None
        try:
            return self._propagator.at(time_ns)
        except ValueError as error:
            self._report('no state', f'no state at {time_ns} ns: {error}')
            return None

    def _refuse(self, cause: str, text: str) -> None:
        self._refused[cause] += 1
        self._report(cause, f'refused ({cause}, {self._refused[cause]} so far): {text}')

    def _report(self, cause: str, text: str, once: bool = False) -> None:
        now_ns = self.get_clock().now().nanoseconds
        last_ns = self._reported.get(cause)
        if last_ns is None or (not once and abs(now_ns - last_ns) > _REPORT_EVERY_S * 1e9):
            self._reported[cause] = now_ns
            self.get_logger().warning(text)


def main(arguments: Sequence[str] | None = None) -> None:
    """
    Run the node until SIGINT or SIGTERM.

    Raises
    ------
    InputError
        The arguments or parameters are not valid.

    """
    stop: list[int] = []

    def request_stop(number: int, frame: Any) -> None:
        stop.append(number)
        signal.setitimer(signal.ITIMER_REAL, _PATIENCE_S)

    try:
        _initialize(sys.argv if arguments is None else ['attitude_node', *arguments])
        node = AttitudeNode()
        # From here on a signal does not cut a callback short, unless that takes too long.
        signal.signal(signal.SIGALRM, signal.getsignal(signal.SIGINT))
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, request_stop)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not stop:
            executor.spin_once(timeout_sec=0.1)
        node.finish()
        node.destroy_node()
    except KeyboardInterrupt:
        if stop:
            print('attitude_node: cut short: the last states could not be worked out and '
                  f'delivered within {_PATIENCE_S} s', file=sys.stderr)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        rclpy.try_shutdown()


def _initialize(command_line: Sequence[str]) -> None:
    try:
        others = remove_ros_args(command_line)[1:]
        argparse.ArgumentParser(
            'attitude_node',
            description='Turn the torques of a topic into attitude, in real time.',
            epilog='The scene comes as ROS parameters: --ros-args --params-file FILE',
        ).parse_args(others)
        # The handlers of rclpy would shut ROS down before the last states are published.
        rclpy.init(args=command_line, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise InputError(' '.join(str(error).split())) from error


def _descriptor(parameter: scene.Parameter) -> ParameterDescriptor:
    fixed = parameter.name not in _CHANGEABLE
    unit = f' ({parameter.unit})' if parameter.unit else ''
    limits = ', '.join(parameter.choices)
    descriptor = ParameterDescriptor(
        name=parameter.name, description=parameter.description + unit,
        # start_time is set by the node itself when the clock becomes valid.
        read_only=fixed and parameter.name != 'start_time',
        # The others may be given as 50 for 50.0 while running.
        dynamic_typing=not fixed,
        additional_constraints='; '.join(filter(None, [
            limits and f'one of {limits}',
            'read-only while running: it defines the trajectory' if fixed else ''])))
    if parameter.range:
        low, high = parameter.range
        if parameter.type is int:
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    return descriptor
