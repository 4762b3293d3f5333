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

"""The definitions of ROS message types, and the hashes of these types."""

from __future__ import annotations

#: The definition of each type, with one line per field.
FIELDS = {
    'builtin_interfaces/Time': 'int32 sec\nuint32 nanosec\n',
    'std_msgs/Header': 'builtin_interfaces/Time stamp\nstring frame_id\n',
    'geometry_msgs/Vector3': 'float64 x\nfloat64 y\nfloat64 z\n',
    'geometry_msgs/Point': 'float64 x\nfloat64 y\nfloat64 z\n',
    'geometry_msgs/Quaternion': 'float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n',
    'geometry_msgs/Wrench': 'Vector3 force\nVector3 torque\n',
    'geometry_msgs/Pose': 'Point position\nQuaternion orientation\n',
    'geometry_msgs/Twist': 'Vector3 linear\nVector3 angular\n',
    'geometry_msgs/PoseWithCovariance': 'Pose pose\nfloat64[36] covariance\n',
    'geometry_msgs/TwistWithCovariance': 'Twist twist\nfloat64[36] covariance\n',
    'geometry_msgs/Transform': 'Vector3 translation\nQuaternion rotation\n',
    'geometry_msgs/TransformStamped': 'std_msgs/Header header\nstring child_frame_id\n'
                                      'Transform transform\n',
    'geometry_msgs/PoseStamped': 'std_msgs/Header header\nPose pose\n',
    'geometry_msgs/PoseWithCovarianceStamped': 'std_msgs/Header header\n'
                                               'PoseWithCovariance pose\n',
    'geometry_msgs/WrenchStamped': 'std_msgs/Header header\nWrench wrench\n',
    'geometry_msgs/QuaternionStamped': 'std_msgs/Header header\nQuaternion quaternion\n',
    'geometry_msgs/Vector3Stamped': 'std_msgs/Header header\nVector3 vector\n',
    'geometry_msgs/Inertia': 'float64 m\ngeometry_msgs/Vector3 com\nfloat64 ixx\nfloat64 ixy\n'
                             'float64 ixz\nfloat64 iyy\nfloat64 iyz\nfloat64 izz\n',
    'geometry_msgs/InertiaStamped': 'std_msgs/Header header\nInertia inertia\n',
    'sensor_msgs/Imu': 'std_msgs/Header header\n'
                       'geometry_msgs/Quaternion orientation\n'
                       'float64[9] orientation_covariance\n'
                       'geometry_msgs/Vector3 angular_velocity\n'
                       'float64[9] angular_velocity_covariance\n'
                       'geometry_msgs/Vector3 linear_acceleration\n'
                       'float64[9] linear_acceleration_covariance\n',
    'sensor_msgs/JointState': 'std_msgs/Header header\nstring[] name\nfloat64[] position\n'
                              'float64[] velocity\nfloat64[] effort\n',
    'tf2_msgs/TFMessage': 'geometry_msgs/TransformStamped[] transforms\n',
    'nav_msgs/Odometry': 'std_msgs/Header header\nstring child_frame_id\n'
                         'geometry_msgs/PoseWithCovariance pose\n'
                         'geometry_msgs/TwistWithCovariance twist\n',
    'builtin_interfaces/Duration': 'int32 sec\nuint32 nanosec\n',
    'std_msgs/ColorRGBA': 'float32 r\nfloat32 g\nfloat32 b\nfloat32 a\n',
    'sensor_msgs/CompressedImage': 'std_msgs/Header header\nstring format\nuint8[] data\n',
    'visualization_msgs/UVCoordinate': 'float32 u\nfloat32 v\n',
    'visualization_msgs/MeshFile': 'string filename\nuint8[] data\n',
    'visualization_msgs/Marker': 'std_msgs/Header header\nstring ns\nint32 id\nint32 type\n'
                                 'int32 action\ngeometry_msgs/Pose pose\n'
                                 'geometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n'
                                 'builtin_interfaces/Duration lifetime\nbool frame_locked\n'
                                 'geometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\n'
                                 'string texture_resource\n'
                                 'sensor_msgs/CompressedImage texture\n'
                                 'UVCoordinate[] uv_coordinates\nstring text\n'
                                 'string mesh_resource\nMeshFile mesh_file\n'
                                 'bool mesh_use_embedded_materials\n',
}

#: The hash of each type. ROS 2 Iron and later releases identify a type by its hash (REP-2011).
HASHES = {name: f'RIHS01_{digits}' for name, digits in {
    'geometry_msgs/msg/Wrench':
        '018e8519d57c16adbe97c9fe1460ef21fec7e31bc541de3d653a35895677ce52',
    'geometry_msgs/msg/WrenchStamped':
        '8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77',
    'geometry_msgs/msg/QuaternionStamped':
        '381add86c6c3160644d228ca342182c7fd6c7fab11c7a85ad817a9cc22dbac6e',
    'geometry_msgs/msg/Vector3Stamped':
        'd4829622288cbb443886e7ea94ea5671a3b1be6bab4ad04224432a65f7d7887a',
    'geometry_msgs/msg/InertiaStamped':
        '766be45976252babf7f9d8ac4ae7c912a7ceccf71035622529f27518b695aa09',
    'sensor_msgs/msg/Imu': '7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b',
    'sensor_msgs/msg/JointState':
        'a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e',
    'nav_msgs/msg/Odometry': '3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0',
    'tf2_msgs/msg/TFMessage': 'e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087',
    'visualization_msgs/msg/Marker':
        '45b13ccf791f225962bf74e746f9644518855d783a6f42ba0cc14fde2b4f3ce0',
}.items()}


def definition(name: str) -> str:
    """Return the complete definition of a type in MCAP's schema encoding 'ros2msg'."""
    name = name.replace('/msg/', '/')
    nested = [f'{"=" * 80}\nMSG: {part}\n{FIELDS[part]}' for part in _nested(name)]
    return ''.join([FIELDS[name], *nested])


def _nested(name: str) -> list[str]:
    # Return all types that a definition uses, directly or indirectly. List each type once, in the
    # order in which they are first used.
    parts: list[str] = []
    for line in FIELDS[name].splitlines():
        field = line.split()[0].removesuffix('[]')
        part = field if '/' in field else f'{name.split("/")[0]}/{field}'
        if part in FIELDS:
            parts += [part, *_nested(part)]
    return list(dict.fromkeys(parts))
