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
Declare the contents of a scene as parameters of a ROS 2 node.

If the parameters contain no inertia, wait for the URDF of the body on the topic that
robot_state_publisher uses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
import time
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.wheels import Wheels
from rigid_body_ros.propagation.options import solver_named
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.runtime.parameters import checked as checked_value
from rigid_body_ros.runtime.parameters import Parameter as SceneParameter
from rigid_body_ros.runtime.parameters import resembled
from rigid_body_ros.scene import PARAMETERS, Scene
from rigid_body_ros.scene.parameters import checked_names, NAMED, parameters_with, QOS
from rigid_body_ros.scene.parts import at_start
from std_msgs.msg import String

_RATE = 'publish_rate'
#: The names of QoS overrides for rclpy's own topics begin with `QOS`, followed by one of these
#: strings.
_OF_RCLPY = ('/clock.', '/parameter_events.', '/rosout.')
#: Parameters that the node sets when an epoch begins, so that a parameter dump describes the scene
#: of that epoch.
_EPOCH = ('start_time', *(f'initial_attitude.{name}' for name in 'xyzw'),
          *(f'initial_angular_velocity.{name}' for name in 'xyz'),
          *(f'initial_rotor_momentum.{name}' for name in 'xyz'))
#: The name of the topic with the URDF, and also the name of the parameter with which users can
#: give the URDF instead.
_ROBOT_DESCRIPTION = 'robot_description'
#: The QoS of robot_state_publisher, which delivers the last message even to later subscriptions.
_LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                      durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: How often to check this topic, and how often to log that the node still waits, in seconds.
_URDF_PERIOD, _LOG_PERIOD = 0.05, 10.0


class NodeParameters:
    """
    Declare the parameters of a scene on a node, and build the scene from their values.

    Parameters
    ----------
    node : Node
    on_rate : callable
        Called with the new value when `publish_rate` changes.
    is_managed : bool
        Whether the node calls `release` once it no longer uses the scene.

    Raises
    ------
    InputError
        The given parameters do not describe a scene that a node can run.

    """

    def __init__(self, node: Node, on_rate: Callable[[float], None],
                 is_managed: bool = False) -> None:
        self._node, self._on_rate, self._is_managed = node, on_rate, is_managed
        #: The scene parameters that the user has given.
        self._given: dict[str, Any] = {}
        self.scene = self._declare()
        #: The values that only `set_start` may change once the scene exists.
        self._fixed = {name: value for name, value in self.scene.values.items() if name != _RATE}
        node.add_on_set_parameters_callback(self._on_set)
        if hasattr(node, 'add_pre_set_parameters_callback'):  # not on Humble
            node.add_pre_set_parameters_callback(_with_float_rate)

    def release(self) -> None:
        """
        Declare the parameters anew with the values that the user has given.

        The user can then change these parameters again.

        This method does nothing unless the node is managed.
        """
        if self._is_managed:
            self._node.remove_on_set_parameters_callback(self._on_set)
            if hasattr(self._node, 'remove_pre_set_parameters_callback'):
                self._node.remove_pre_set_parameters_callback(_with_float_rate)
            for name in self.scene.values:
                self._node.undeclare_parameter(name)
            declare(self._node, self._given)

    def set_start(self, start: State) -> None:
        """
        Set the parameters that describe the start state to the start state of an epoch.

        Raises
        ------
        RuntimeError
            The node does not accept the values.

        """
        wheels = Wheels(self.scene.named_wheels)
        values = [start.time_ns, *start.attitude.tolist(), *start.angular_velocity.tolist(),
                  *wheels.others(start).tolist()]
        epoch = dict(zip(_EPOCH, values)) | at_start(self.scene.values, start.time_ns)
        speeds = start.wheel_speeds.tolist() or [
            wheel.initial_speed for wheel in self.scene.named_wheels]
        epoch |= {f'{name}.initial_speed': speed for name, speed in zip(wheels.names, speeds)}
        self._fixed |= epoch
        # The parameters are read-only for users, so make them writable just for this call.
        # Changing a returned descriptor is enough, because the node returns the descriptors that
        # it stores, not copies of them.
        descriptors = self._node.describe_parameters(list(epoch))
        is_fixed = [descriptor.read_only for descriptor in descriptors]
        for descriptor in descriptors:
            descriptor.read_only = False
        result = self._node.set_parameters_atomically(
            [Parameter(name, value=value) for name, value in epoch.items()])
        for descriptor, read_only in zip(descriptors, is_fixed):
            descriptor.read_only = read_only
        if not result.successful:
            raise RuntimeError(f'cannot set the parameters of the start state: {result.reason}')

    def _declare(self) -> Scene:
        # A managed node has already declared its parameters, and the user may have changed them
        # since then.
        given = given_parameters(self._node)
        for key in NAMED:
            if self._node.has_parameter(key):
                given[key] = self._node.get_parameter(key).value
        declared = {name: self._node.get_parameter(name).value for name in _known(given)
                    if self._node.has_parameter(name)}
        given |= {name: value for name, value in declared.items() if value is not None}
        checked = Scene.from_values(_with_robot_description(self._node, given))
        solver = solver_named(checked.solver)
        if not solver.takes_torque:
            raise InputError(f'solver: {solver.name!r} handles torque-free motion only')
        if checked.interpolation != 'hold':
            raise InputError("interpolation: expected 'hold', because a node does not know the "
                             f'next torque, found {checked.interpolation!r}')
        self._given = {name: value for name, value in given.items() if name in checked.values}
        for name, value in checked.values.items():
            if name in declared:
                self._node.undeclare_parameter(name)
            descriptor = _descriptor(checked.parameters[name])
            descriptor.read_only &= not self._is_managed  # rclpy cannot undeclare read-only ones
            self._node.declare_parameter(name, value, descriptor, ignore_override=True)
        return checked

    def _on_set(self, parameters: list[Parameter[Any]]) -> SetParametersResult:
        values = {parameter.name: parameter.value for parameter in parameters}
        for name, value in values.items():
            if value != self._fixed.get(name, value):
                return SetParametersResult(successful=False, reason=f'{name}: read-only in a '
                                           'running node: it defines the trajectory')
            # rclpy declares the QoS parameters of each endpoint when it creates the endpoint.
            if self._node.has_parameter(name) and name.startswith((QOS, 'use_sim_time')):
                return SetParametersResult(successful=False, reason=f'{name}: read-only in a '
                                           'running node: it takes effect only at the start')
        if _RATE in values:
            try:
                self._on_rate(checked_value(PARAMETERS[_RATE], values[_RATE]))
            except InputError as error:
                return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def declare(node: Node, given: Mapping[str, Any]) -> None:
    """
    Declare the parameters of a scene on a node, with the given values.

    Parameters that are not given are declared without a value.
    """
    for name, parameter in _known(given).items():
        node.declare_parameter(name, given.get(name), ParameterDescriptor(
            description=_described(parameter), dynamic_typing=True), ignore_override=True)


def _known(given: Mapping[str, Any]) -> dict[str, SceneParameter]:
    """
    Return the known parameters of a scene.

    If the name of a field or a wheel is invalid, the parameters of all fields and wheels are left
    out.
    """
    with suppress(InputError):
        return parameters_with(checked_names(given))
    return PARAMETERS


def given_parameters(node: Node) -> dict[str, Any]:
    """Return the values of all parameters given to a node, including those for other nodes."""
    # Use a private attribute, because the public interface of rclpy returns only declared
    # parameters. We cannot declare all given parameters, because rclpy fails to declare an empty
    # list, and a parameter for another node may be an empty list.
    return {name: parameter.value for name, parameter in node._parameter_overrides.items()}


def check_qos_overrides(node: Node, subscriptions: Iterable[Subscription[Any]],
                        publishers: Iterable[Publisher[Any]]) -> list[str]:
    """
    Return the names of the given QoS overrides that are meant for other nodes.

    Raises
    ------
    InputError
        An override would have no effect, because the name of its topic, endpoint or policy is
        misspelt.

    """
    own = [f'{QOS}{endpoint.topic_name}.{kind}.{policy.name.lower()}'
           for kind, endpoints in (('subscription', subscriptions), ('publisher', publishers))
           for endpoint in endpoints
           for policy in QoSOverridingOptions.with_default_policies().policy_kinds]
    others = [name for name in given_parameters(node)
              if name.startswith(QOS) and name not in own
              and not name.removeprefix(QOS).startswith(_OF_RCLPY)]
    for name in others:
        # Compare only with names in the same namespace. The namespaces of two bodies may differ in
        # a single letter, and that would not be a misspelling.
        space = name.rpartition('/')[0]
        close = resembled(name, [key for key in own if key.rpartition('/')[0] == space])
        if close:
            raise InputError(f'{name}: not a topic, endpoint or policy of this node; '
                             f'did you mean {close}?')
    return others


def _with_float_rate(parameters: list[Parameter[Any]]) -> list[Parameter[Any]]:
    """Convert an integer rate such as 50 to a float, and leave all other parameters unchanged."""
    return [Parameter(_RATE, value=float(parameter.value))
            if parameter.name == _RATE and parameter.type_ == Parameter.Type.INTEGER
            else parameter for parameter in parameters]


def _described(parameter: SceneParameter) -> str:
    return parameter.description + (f' ({parameter.unit})' if parameter.unit else '')


def _descriptor(parameter: SceneParameter) -> ParameterDescriptor:
    fixed = parameter.name != _RATE
    limits = ', '.join(parameter.choices)
    descriptor = ParameterDescriptor(
        name=parameter.name, description=_described(parameter), read_only=fixed,
        # With dynamic typing, a running node accepts a rate of 50 as well as 50.0.
        dynamic_typing=not fixed,
        additional_constraints='; '.join(filter(None, [
            limits and f'one of {limits}',
            'read-only while running: it defines the trajectory' if fixed else ''])))
    if parameter.interval:
        low, high = parameter.interval
        if parameter.value_type is int:
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    return descriptor


def _with_robot_description(node: Node, given: Mapping[str, Any]) -> Mapping[str, Any]:
    """
    Return the given parameters; if they contain no inertia, add the URDF from the topic.

    If the parameters contain an inertia or a `robot_description`, the node does not subscribe to
    the topic, and does not wait.

    Raises
    ------
    InputError
        A parameter other than the inertia is not valid. The node checks these parameters before it
        waits for the URDF.
    ExternalShutdownException
        The context was shut down while the node was waiting.

    """
    if given.get(_ROBOT_DESCRIPTION) or any(name.startswith('inertia.') for name in given):
        return given
    Scene.from_values({**given, 'link': '', _ROBOT_DESCRIPTION: '',
                       **{f'inertia.{entry}': 1.0 for entry in ('ixx', 'iyy', 'izz')}})
    return {**given, _ROBOT_DESCRIPTION: _wait_for_urdf(node)}


def _wait_for_urdf(node: Node) -> str:
    """
    Wait for a message and return the URDF in it.

    The function does not spin the node, because the node may already belong to an executor.
    """
    subscription = node.create_subscription(String, _ROBOT_DESCRIPTION, lambda _: None, _LATCHED)
    topic, logger = subscription.topic_name, node.get_logger()
    logger.info(f'waiting for a URDF on {topic}, because the parameters have neither inertia.ixx '
                'nor robot_description')
    logged_at = time.monotonic()
    try:
        while True:
            with subscription.handle:
                taken = subscription.handle.take_message(String, False)
            if taken is not None:
                return str(taken[0].data)
            interrupts.check()
            if not node.context.ok():
                raise ExternalShutdownException
            if time.monotonic() > logged_at + _LOG_PERIOD:
                logged_at = time.monotonic()
                count = node.count_publishers(topic)
                why = 'no node publishes it' if not count else \
                    f'publishers: {count}, none of which has sent one with transient local QoS'
                logger.warning(f'still waiting for a URDF on {topic}: {why}')
            time.sleep(_URDF_PERIOD)
    finally:
        node.destroy_subscription(subscription)
