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

"""Several nodes in one ROS domain, each with its own names and frames."""

from live import decoded, finished, get_parameters, Session, TUMBLER
from live_session import ACCEPTED, RELIABLE
import pytest
from rclpy.parameter import Parameter
from rigid_body_ros import messages
from rigid_body_ros.node import AttitudeNode
from sensor_msgs.msg import Imu

pytestmark = pytest.mark.ros


def test_the_nodes_of_a_fleet_differ_in_diagnostics_and_frames(tmp_path, domain):
    frames = {}
    with Session(TUMBLER, domain, *RELIABLE, '-p', 'history:=60.0',
                 '-p', 'frame_prefix:=one/') as live:
        two = AttitudeNode(context=live.node.context, namespace='two', parameter_overrides=[
            Parameter('frame_prefix', value='two/')])
        live._executor.add_node(two)
        for topic in ('/imu/data', '/two/imu/data'):
            live.node.create_subscription(Imu, topic, lambda imu, topic=topic: frames.update(
                {topic: imu.header.frame_id}), 10)

        def statuses():
            return {status.name: status.hardware_id for array in live.diagnostics
                    for status in array.status}
        live.wait_until(lambda: len(statuses()) >= 4 and len(frames) == 2, 'both nodes')
        assert statuses() == {f'{node}: {status}': node for status in ('torques', 'motion')
                              for node in ('/attitude_node', '/two/attitude_node')}
        assert frames == {'/imu/data': 'one/base_link', '/two/imu/data': 'two/base_link'}
        start_ns = live.now_ns()
        for number, frame_id in enumerate(('', 'one/base_link', 'world', 'base_link', 'two/world',
                                           'two/base_link')):
            live.publish(start_ns + number, frame_id, [0.01, 0.02, number * 0.01])
        live.wait_until(lambda: live.diagnosis('torques')[0]['received'] == 6, 'all torques')
        counts, _, _ = live.diagnosis('torques')
        assert counts['rejected: unknown frame'] == 3
        assert [torque.frame_id for torque in decoded(live, ACCEPTED, messages.WRENCH)] == [
            'one/base_link', 'one/base_link', 'world']
        prefix, = get_parameters(live, 'frame_prefix')
        assert prefix.string_value == 'one/'
        run = finished(tmp_path, live)
        two.destroy_node()
    assert len(run.stamps_ns) == 4
