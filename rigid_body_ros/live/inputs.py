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

"""Turn received messages into torques and states, or reject them and give the cause."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import quoted
from rigid_body_ros.live.events import (
    Events,
    FRAME,
    IMPOSSIBLE,
    MALFORMED,
    NOT_FINITE,
    RejectedError,
    TOO_LARGE,
)
from rigid_body_ros.mechanics.frames import Frame, OffAxisError
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.wheels import Wheels
from rigid_body_ros.propagation.options import FASTEST
from rigid_body_ros.propagation.sources import BODY, COMMANDS, WHEELS
from rigid_body_ros.scene import Scene

#: Largest angular acceleration that a torque may cause, rad/s^2. At this acceleration, a body at
#: rest would reach the angular velocity FASTEST, which is one radian per nanosecond, within one
#: second.
_LARGEST_ACCELERATION = 1e9
_NO_TIMES = np.zeros(1, np.int64)


class Torque(NamedTuple):
    """
    A torque, N m, that acts from its stamp onward, in the frame 'body' or 'space'.

    For two sources, `values` is not a torque. For BODY, `values` is the inertia of a body, kg m^2,
    in the form of `RigidBody.entries`. For COMMANDS, `values` contains the efforts of the named
    wheels, N m, with NaN for each wheel that keeps its previous effort.
    """

    stamp_ns: int
    values: Floats
    frame: str
    #: The number of a source (see `Propagator.apply`), or WHEELS (the rotors), COMMANDS or BODY.
    source: int = 0


class Inputs:
    """Decode messages, and express their contents in the frames of a scene."""

    def __init__(self, scene: Scene, events: Events) -> None:
        self._events = events
        self._frames = scene.body_frame, scene.space_frame
        self._links = scene.links
        self._scene_body = scene.body
        self._wheels = Wheels(scene.named_wheels)
        self._commands = messages.joint_commands(self._wheels.names)
        self._largest = _LARGEST_ACCELERATION * scene.body.principal_moments[0]

    def torque(self, data: bytes, source: int) -> Torque:
        """
        Decode a message and return its torque about the centre of mass.

        `data` is the serialized message (CDR). Its type depends on the source: an InertiaStamped
        for BODY, a JointState for COMMANDS, and a WrenchStamped for all other sources. If a wrench
        contains a force without a lever arm, the force is ignored and counted.

        Raises
        ------
        RejectedError
            The message is malformed or has an unknown frame, or the torque is not finite or is so
            large that the body would accelerate too fast. In addition, a wrench in a turning frame
            is rejected if it is not along the axis of that frame. An inertia is rejected if no
            body can have this inertia, or if no body with the wheels of the scene can have it. A
            command is rejected if it contains a name that is not the name of a wheel.

        """
        if source == BODY:
            return self._body(decoded(messages.INERTIA, data))
        if source == COMMANDS:
            return self._efforts(decoded(self._commands, data))
        wrench = decoded(messages.WRENCH, data)
        axes, frame = (self._only_body_axes(wrench, 'the torque on rotors'), None) \
            if source == WHEELS else self._frame(wrench)
        force, torque = wrench.values[:3], messages.torque(wrench)
        if frame:
            try:
                torque = frame.torque(force, torque)
            except OffAxisError as error:
                raise RejectedError(FRAME, f'frame {quoted(wrench.frame_id)}: {error}') from error
        x, y, z = torque.tolist()
        if not math.isfinite(x + y + z):
            raise RejectedError(NOT_FINITE, f'expected a finite torque, found {[x, y, z]}'
                                + _source(wrench, frame))
        if math.hypot(x, y, z) > self._largest:
            raise RejectedError(TOO_LARGE, f'expected a torque of at most {self._largest:.3g} N m '
                                f'for this inertia, found {[x, y, z]}'
                                + _source(wrench, frame))
        if any(force.tolist()) and not (frame and frame.has_arm):
            self._events.count_force(source)
        return Torque(wrench.stamp_ns, torque, axes, source)

    def _frame(self, wrench: messages.Stamped) -> tuple[str, Frame | None]:
        try:
            return messages.wrench_frame(wrench.frame_id, *self._frames, self._links)
        except ValueError as error:
            raise RejectedError(FRAME, str(error)) from error

    def _only_body_axes(self, message: messages.Stamped, what: str) -> str:
        if message.frame_id not in ('', self._frames[0]):
            raise RejectedError(FRAME, f"frame_id: expected '{self._frames[0]}' or '', because "
                                f'{what} is in body axes, found {quoted(message.frame_id)}')
        return 'body'

    def _body(self, inertia: messages.Stamped) -> Torque:
        axes = self._only_body_axes(inertia, 'the inertia')
        entries = messages.inertia_entries(inertia.values)
        try:
            body = self._scene_body.with_entries(entries)
            if self._wheels:
                self._wheels.carrier(body)
        except ValueError as error:
            raise RejectedError(IMPOSSIBLE, str(error)) from error
        if inertia.values[messages.MASS_AND_CENTRE].any():
            self._events.ignore_mass()
        return Torque(inertia.stamp_ns, entries, axes, BODY)

    def _efforts(self, command: messages.Stamped) -> Torque:
        if messages.is_epoch_marker(command.frame_id):  # commands ignore any other frame_id
            raise RejectedError(FRAME, 'frame_id: expected that of a command, found the marker of '
                                f'an epoch, {quoted(command.frame_id)}')
        largest = float(np.nanmax(np.abs(command.values), initial=-1.0))
        if largest < 0.0:
            raise RejectedError(MALFORMED, 'name: expected a wheel, found none')
        if largest > self._largest:
            raise RejectedError(TOO_LARGE, f'expected efforts of at most {self._largest:.3g} N m '
                                f'for this inertia, found {command.values.tolist()}')
        return Torque(command.stamp_ns, command.values, 'body', COMMANDS)

    def state(self, odometry: messages.Stamped) -> State:
        """
        Return the state in an Odometry message.

        Raises
        ------
        RejectedError
            The frames of the message are not those of the scene, a value is not finite, the
            angular velocity is too large, or the quaternion is zero.

        """
        body, space = self._frames
        frame_id, child_frame_id = odometry.frame_id, odometry.child_frame_id
        if frame_id not in ('', space) or child_frame_id not in ('', body):
            raise RejectedError(FRAME, f"frame_id, child_frame_id: expected '{space}' and "
                                f"'{body}', found '{frame_id}' and '{child_frame_id}'")
        rates = odometry.values[messages.ANGULAR_VELOCITY]
        if math.hypot(*rates.tolist()) > FASTEST:
            raise RejectedError(TOO_LARGE, f'expected at most {FASTEST:g} rad/s, '
                                f'found {rates.tolist()}')
        try:
            return State(odometry.stamp_ns, odometry.values[messages.ORIENTATION], rates)
        except ValueError as error:
            raise RejectedError(NOT_FINITE, str(error)) from error


def wrench_of(kind: messages.MessageType, data: bytes) -> bytes:
    """
    Convert a torque of another type to a WrenchStamped message; both are serialized (CDR).

    The stamp is 0 if the type has none. Raise RejectedError if the message is malformed.
    """
    try:
        if isinstance(kind, messages.Px4Type):
            from rigid_body_ros.recording.bulk import converted, Raw
            return converted(kind, Raw.from_bytes([data], _NO_TIMES, _NO_TIMES)).message(0)
        message = kind.decode(data)
        values = np.pad(message.values, (messages.WRENCH.doubles - kind.doubles, 0))
        return messages.WRENCH.encode(message.stamp_ns, message.frame_id, values)
    except ValueError as error:
        raise RejectedError(MALFORMED, str(error)) from error


def _source(wrench: messages.Stamped, frame: Frame | None) -> str:
    """
    Return the last words of an error message about a torque.

    They name the wrench from which the torque was computed.
    """
    return f', from the wrench {wrench.values.tolist()} in frame {quoted(wrench.frame_id)}' \
        if frame else ''


def decoded(kind: messages.MessageType, data: bytes) -> messages.Stamped:
    """Decode a serialized message (CDR); raise RejectedError if it is malformed."""
    try:
        return kind.decode(data)
    except ValueError as error:
        raise RejectedError(MALFORMED, str(error)) from error
