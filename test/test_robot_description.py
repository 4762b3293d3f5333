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

"""The inertia from the topic of robot_state_publisher."""

import signal
import time

from conftest import at_night
from live import finished, PATIENCE, Session, TUMBLER
from live_session import LiveSession, RELIABLE
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from rigid_body_ros import messages, scene
from rigid_body_ros.live.events import FRAME, NOT_FINITE, RejectedError
from rigid_body_ros.live.inputs import Inputs
from rigid_body_ros.mechanics import urdf
from robots import JOINTS, ROBOT, robot
from std_msgs.msg import String

pytestmark = pytest.mark.ros
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
WAITS = 'waiting for a URDF on /robot_description'
SOLID = '<inertial><mass value="0.5"/><inertia ixx="0.05" iyy="0.12" izz="0.14" ixy="0" ixz="0" ' \
        'iyz="0"/></inertial>'
#: Two links that fixed joints connect have a mass.
WELDED = robot(*JOINTS, inertials=dict.fromkeys(('base_link', 'lamp'), SOLID))


@pytest.fixture
def parameters(tmp_path):
    """Return a parameter file without an inertia."""
    path = tmp_path / 'robot.yaml'
    path.write_text('/**:\n  ros__parameters:\n    initial_angular_velocity: {y: 0.6}\n')
    return path


class WaitingSession(LiveSession):
    """A session whose node waits for a description."""

    def _connect(self):
        self.wait_until(lambda: WAITS in self.words(), 'the node to wait')


class DescribedSession(LiveSession):
    """A session with a robot_state_publisher that starts when the node waits for it."""

    def _connect(self):
        WaitingSession._connect(self)
        self.wait_until(lambda: ('/robot_description', ['std_msgs/msg/String']) in (
            self.node.get_subscriber_names_and_types_by_node('attitude_node', '/')
            if ('attitude_node', '/') in self.node.get_node_names_and_namespaces() else ()),
            'the subscription')
        self.description = self.node.create_publisher(String, 'robot_description', LATCHED)
        self.description.publish(String(data=WELDED))
        super()._connect()


def test_a_node_without_an_inertia_takes_that_of_the_topic(tmp_path, domain, parameters):
    with DescribedSession(parameters, domain, *RELIABLE, '-p', 'history:=60.0') as live:
        assert live.parameters('robot_description') == [WELDED]
        assert "robot_description: welded to 'base_link' by fixed joints: lamp (total mass 1 kg)" \
            in live.words()
        live.description.publish(String(data='<robot/>'))  # too late: the motion has begun
        start_ns = live.now_ns()
        for number, frame_id in enumerate(('', 'thruster', 'lamp', 'world')):
            live.publish_bytes(messages.WRENCH.encode(
                start_ns + number * 1000, frame_id, [0.1, 0.2, 0.3, 0.01, 0.02, 0.03]))
        live.wait_until(lambda: live.diagnosis('torques')[0]['applied'] == 4, 'all torques')
        run = finished(tmp_path, live)
    assert len(run.stamps_ns) == 5
    np.testing.assert_array_equal(run.scene.body.inertia, scene.Scene.from_values(
        {'robot_description': WELDED}).body.inertia)
    assert {*run.scene.links} == {*urdf.fixed_frames(WELDED)}


def test_the_parameters_come_first(domain):
    with Session(TUMBLER, domain) as live:
        live.node.create_publisher(String, 'robot_description', LATCHED).publish(
            String(data=ROBOT))
        assert live.parameters('robot_description', 'inertia.ixx') == ['', 0.045]
        assert WAITS not in live.end()


class WrongSession(LiveSession):
    """A session with a robot that has no inertia."""

    def _connect(self):
        self.node.create_publisher(String, 'robot_description', LATCHED).publish(
            String(data='<robot name="r"><link name="a"/></robot>'))
        until = time.monotonic() + PATIENCE
        while self.process.poll() is None and time.monotonic() < until:
            self.spin(0.05)


def test_a_robot_without_an_inertia_ends_the_node_with_one_line(domain, parameters):
    with WrongSession(parameters, domain) as live:
        assert live.process.returncode == 2
        line, = [line for line in live.words().splitlines() if not line.startswith('[')]
    assert line.startswith('attitude_node: error: robot_description: URDF')


@pytest.mark.parametrize('number', [signal.SIGTERM, *at_night(signal.SIGINT)])
def test_a_signal_ends_a_node_that_waits(domain, parameters, number):
    with WaitingSession(parameters, domain) as live:
        live.process.send_signal(number)
        assert live.process.wait(timeout=PATIENCE) == 128 + number
        words = live.words()
    assert words.splitlines()[-1].startswith('attitude_node: interrupted')
    assert 'Traceback' not in words


class LonelySession(DescribedSession):
    """A session that waits until the node reports that nobody publishes the description."""

    def _connect(self):
        self.wait_until(lambda: 'still waiting for a URDF on /robot_description: no node '
                        'publishes it' in self.words(), 'the node to report')
        super()._connect()


@pytest.mark.nightly
def test_a_node_that_waits_says_what_is_missing(domain, parameters):
    with LonelySession(parameters, domain) as live:
        assert live.stop() == 0


def test_a_wrench_across_the_axis_of_a_propeller_is_rejected_with_frame_and_joint():
    loaded, axis = scene.Scene.from_values({'robot_description': ROBOT, 'frame_prefix': 'one/'}), \
        np.array([1.0, 2.0, 2.0])
    inputs = Inputs(loaded, None)  # does not count forces without lever arms
    along = messages.WRENCH.encode(1, 'one/propeller', [*axis, *(1e-3 * axis)])
    assert inputs.torque(along, 0).values.tobytes() \
        == loaded.links['one/propeller'].torque(axis, 1e-3 * axis).tobytes()
    for values, cause, words in (
            ([1, 0, 0, 0, 0, 0], FRAME, "^frame 'one/propeller': expected force and torque along"),
            ([0, 0, 0, 0, 0, 1], FRAME, "of joint 'to_propeller' .continuous., found force"),
            ([np.nan, 0, 0, 0, 0, 0], NOT_FINITE, 'expected a finite torque')):
        with pytest.raises(RejectedError, match=words) as found:
            inputs.torque(messages.WRENCH.encode(1, 'one/propeller', values), 0)
        assert found.value.cause == cause
