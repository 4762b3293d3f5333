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
Encode and decode ROS messages.

`kinds` defines the message types and their encoding in CDR, `definitions` contains the text of
their definitions, `joints` adds a type for named joints, and `px4` adds the types of PX4.
`contents` converts states and torques to messages and back.
"""

from rigid_body_ros.messages.contents import (
    ANGULAR_VELOCITY,
    epoch_marker,
    epoch_start,
    imu,
    imu_values,
    inertia,
    inertia_entries,
    is_epoch_marker,
    MASS_AND_CENTRE,
    odometry,
    ORIENTATION,
    torque,
    torque_frame,
    transform,
    transform_values,
    wrench,
    wrench_frame,
)
from rigid_body_ros.messages.joints import (
    decoded_joints,
    encoded_joints,
    joint_commands,
    joint_states,
    joint_values,
    JointCommands,
    JointState,
)
from rigid_body_ros.messages.kinds import (
    BARE_WRENCH,
    BLUE_ARROW,
    BOX,
    IMU,
    INERTIA,
    LAST_NS,
    MessageType,
    ODOMETRY,
    ORANGE_ARROW,
    POSE,
    POSE_WITH_COVARIANCE,
    QUATERNION,
    Stamped,
    TORQUE_VECTOR,
    TRANSFORM,
    TRANSFORM_STAMPED,
    TYPES,
    unstamped,
    VECTOR3,
    WRENCH,
)
from rigid_body_ros.messages.px4 import PX4_TYPES, Px4Type

__all__ = [
    'ANGULAR_VELOCITY', 'BARE_WRENCH', 'BLUE_ARROW', 'BOX', 'IMU', 'INERTIA', 'LAST_NS',
    'MASS_AND_CENTRE', 'ODOMETRY', 'ORANGE_ARROW', 'ORIENTATION', 'POSE',
    'POSE_WITH_COVARIANCE', 'PX4_TYPES', 'QUATERNION', 'TORQUE_VECTOR', 'TRANSFORM',
    'TRANSFORM_STAMPED', 'TYPES', 'VECTOR3', 'WRENCH',
    'JointCommands', 'JointState', 'MessageType', 'Px4Type', 'Stamped', 'decoded_joints',
    'encoded_joints', 'epoch_marker', 'epoch_start', 'imu', 'imu_values', 'inertia',
    'inertia_entries', 'is_epoch_marker', 'joint_commands', 'joint_states', 'joint_values',
    'odometry', 'torque', 'torque_frame', 'transform', 'transform_values', 'unstamped', 'wrench',
    'wrench_frame']
