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

"""Markers for rviz and Foxglove: a box for the body, arrows for angular momentum and velocity."""

from __future__ import annotations

import numpy as np
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import RigidBody, uniform_box
from rigid_body_ros.propagation import Trajectory
from rigid_body_ros.recording import Column

BODY, ANGULAR_MOMENTUM, ANGULAR_VELOCITY = '/marker/body', '/marker/angular_momentum', \
    '/marker/angular_velocity'
TOPICS = {BODY: messages.BOX, ANGULAR_MOMENTUM: messages.ORANGE_ARROW,
          ANGULAR_VELOCITY: messages.BLUE_ARROW}
#: Length and thickness of the arrows, m. All arrows are equally long, so that small rates are
#: visible, too.
_LENGTH, _THICKNESS = 1.0, 0.03
#: Smallest size of a marker, m; rviz rejects markers of size zero.
_SMALLEST = 1e-3


def columns(trajectory: Trajectory, frame: str) -> list[Column]:
    """Return the markers of a motion; `frame` is the frame_id of the space axes."""
    attitude, body = trajectory.attitude, trajectory.body
    box_attitude = so3.multiply(attitude, so3.from_matrix(body.principal_axes))
    momentum = trajectory.angular_momentum_space
    velocity = so3.rotate(attitude, trajectory.angular_velocity)
    values = {BODY: _pose_and_scale(box_attitude, box(body)), ANGULAR_MOMENTUM: _arrows(momentum),
              ANGULAR_VELOCITY: _arrows(velocity)}
    return [Column(topic, frame, value, topic.rsplit('/')[-1]) for topic, value in values.items()]


def box(body: RigidBody) -> Floats:
    """Return the edge lengths, m, shape (3,), of the box that represents a body."""
    return np.maximum(uniform_box(body), _SMALLEST)


def _arrows(vectors: Floats) -> Floats:
    """
    Return the poses and scales, shape (n, 10), of arrows along the given vectors.

    rviz draws an arrow along x if its orientation is the identity.
    """
    sizes = np.linalg.norm(vectors, axis=1)
    x, y, z = (vectors / np.where(sizes > 0.0, sizes, 1.0)[:, None]).T
    # Use the shortest rotation from x to the vector; if the vector points along -x, rotate by 180
    # deg about z.
    opposite = x < -1.0 + 1e-12
    rotation = np.stack([np.zeros_like(x), np.where(opposite, 0.0, -z),
                         np.where(opposite, 1.0, y), np.where(opposite, 0.0, 1.0 + x)], axis=1)
    scale = np.full((len(vectors), 3), _THICKNESS)
    scale[:, 0] = np.where(sizes > 0.0, _LENGTH, _SMALLEST)
    return _pose_and_scale(so3.normalize(rotation), scale)


def _pose_and_scale(attitude: Floats, scale: Floats) -> Floats:
    """Return the position (the origin), orientation and scale of markers, shape (n, 10)."""
    return np.hstack([np.zeros((len(attitude), 3)), attitude,
                      np.broadcast_to(scale, (len(attitude), 3))])
