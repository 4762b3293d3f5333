"""The node alone: torques of a topic in, attitude out."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

TUMBLER = PathJoinSubstitution([FindPackageShare('rigid_body_ros'), 'config', 'tumbler.yaml'])


def generate_launch_description():
    return LaunchDescription([
        DeclareLaunchArgument('scene', default_value=TUMBLER,
                              description='parameter file: inertia, start, frames'),
        DeclareLaunchArgument('namespace', default_value='',
                              description='of the node and its topics'),
        DeclareLaunchArgument('use_sim_time', default_value='false', choices=['false', 'true'],
                              description='whether /clock has the time'),
        DeclareLaunchArgument('torque', default_value='torque',
                              description='topic of the torques, geometry_msgs/WrenchStamped'),
        Node(package='rigid_body_ros', executable='attitude_node',
             namespace=LaunchConfiguration('namespace'),
             parameters=[LaunchConfiguration('scene'),
                         {'use_sim_time': LaunchConfiguration('use_sim_time')}],
             remappings=[('torque', LaunchConfiguration('torque'))],
             output='screen'),
    ])
