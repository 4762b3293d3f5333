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

"""The nodes in examples/ that connect others: two relays, and one that sets the initial state."""

import os
import subprocess
import sys
import time
from types import ModuleType, SimpleNamespace

from conftest import ROOT
import pytest

pytestmark = pytest.mark.ros
#: s; how long to wait for anything.
PATIENCE = 300


@pytest.fixture
def executor(context):
    from rclpy.executors import SingleThreadedExecutor
    executor = SingleThreadedExecutor(context=context)
    yield executor
    executor.shutdown()


def spun_until(executor, condition):
    """Spin until a condition holds; return whether it does."""
    end = time.monotonic() + PATIENCE
    while not condition() and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
    return condition()


def test_the_relay_publishes_the_torque_of_the_thrusts(context, executor):
    rclpy = pytest.importorskip('rclpy', reason='ROS 2 (rclpy) is not installed')
    from geometry_msgs.msg import WrenchStamped
    from relay import Relay
    from std_msgs.msg import Float64MultiArray
    relay, other, torques = Relay(context=context), rclpy.create_node('o', context=context), []
    executor.add_node(relay)
    executor.add_node(other)
    other.create_subscription(WrenchStamped, 'torque', torques.append, 10)
    thrusts = other.create_publisher(Float64MultiArray, 'thrusts', 10)
    assert spun_until(executor, lambda: thrusts.get_subscription_count()
                      and relay.count_subscribers('torque'))
    thrusts.publish(Float64MultiArray(data=[3.0, 1.0, 2.0, 1.0]))
    assert spun_until(executor, lambda: torques)
    found = torques[0].wrench.torque
    # Lever arms of 0.1 m: left minus right, rear minus front, and the drag of each propeller.
    assert (found.x, found.y, found.z) == pytest.approx((0.3, -0.1, 0.01), abs=1e-15)
    assert torques[0].header.frame_id == 'base_link'


def test_the_relay_of_px4_converts_stamps_order_and_scale(monkeypatch):
    pytest.importorskip('rclpy', reason='ROS 2 (rclpy) is not installed')
    from nav_msgs.msg import Odometry
    px4 = ModuleType('px4_msgs.msg')  # px4_msgs is not on PyPI; these have the fields that are set
    for name in ('VehicleAngularVelocity', 'VehicleAttitude', 'VehicleTorqueSetpoint'):
        setattr(px4, name, SimpleNamespace)
    monkeypatch.setitem(sys.modules, 'px4_msgs', ModuleType('px4_msgs'))
    monkeypatch.setitem(sys.modules, 'px4_msgs.msg', px4)
    import px4_relay
    state = Odometry()
    state.header.stamp.sec, state.header.stamp.nanosec = 1_790_000_000, 4_000_000
    orientation, rates = state.pose.pose.orientation, state.twist.twist.angular
    orientation.x, orientation.y, orientation.z, orientation.w = 0.1, 0.3, 0.5, 0.8
    rates.x, rates.y, rates.z = 1.0, 2.0, 3.0
    attitude, velocity = px4_relay.messages_of(state)
    assert attitude.q == [0.8, 0.1, 0.3, 0.5]
    assert velocity.xyz == [1.0, 2.0, 3.0]
    assert attitude.timestamp == velocity.timestamp_sample == 1_790_000_000_004_000
    answer = px4_relay.torque_of(SimpleNamespace(
        timestamp=0, timestamp_sample=velocity.timestamp_sample, xyz=[0.5, -1.0, 0.25]))
    assert answer.header.stamp == state.header.stamp
    torque = answer.wrench.torque
    assert (torque.x, torque.y, torque.z) == (1.0, -2.0, 0.125)


def test_the_relay_of_px4_says_what_it_needs():
    pytest.importorskip('rclpy', reason='ROS 2 (rclpy) is not installed')
    result = subprocess.run([sys.executable, ROOT / 'examples' / 'px4_relay.py'], text=True,
                            stderr=subprocess.PIPE, check=False)
    assert (result.returncode, result.stderr.count('\n')) == (1, 1)
    assert result.stderr.startswith('px4_relay: expected the package px4_msgs')


def test_the_initial_state_is_that_of_the_example(context, domain, executor):
    from rclpy.parameter import Parameter
    from rigid_body_ros.node import AttitudeNode
    node = AttitudeNode(context=context, parameter_overrides=[
        Parameter(f'inertia.{name}', value=1.0) for name in ('ixx', 'iyy', 'izz')])
    executor.add_node(node)
    with subprocess.Popen([sys.executable, ROOT / 'examples' / 'set_state.py'], text=True,
                          stdout=subprocess.PIPE, env={
                              **os.environ, 'ROS_DOMAIN_ID': str(domain)}) as process:
        try:
            assert spun_until(executor, lambda: process.poll() is not None)
        finally:
            process.kill()
        assert process.stdout.read().startswith('initial_state received')
    node.destroy_node()
