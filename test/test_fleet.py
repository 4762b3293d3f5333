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

from contextlib import contextmanager
import subprocess

from live import decoded, get_parameters, replayed, TUMBLER
from live_session import ACCEPTED, LiveSession, RELIABLE
import numpy as np
import pytest
from rigid_body_ros import messages
from sensor_msgs.msg import Imu

pytestmark = pytest.mark.ros
STATUSES = ('torques', 'motion')


@contextmanager
def another(live, *arguments):
    """Run another node with the scene and in the domain of a session."""
    with subprocess.Popen([*live.command, *arguments], env=live.environment,
                          stderr=subprocess.DEVNULL) as process:
        try:
            yield
        finally:
            process.kill()


def test_the_nodes_of_a_fleet_differ_in_diagnostics_and_frames(tmp_path, domain):
    frames = {}
    with LiveSession(TUMBLER, domain, *RELIABLE, '-p', 'history:=60.0',
                     '-p', 'frame_prefix:=one/') as live, \
            another(live, '-r', '__ns:=/two', '-p', 'frame_prefix:=two/'):
        for topic in ('/imu/data', '/two/imu/data'):
            live.node.create_subscription(Imu, topic, lambda imu, topic=topic: frames.update(
                {topic: imu.header.frame_id}), 10)

        def statuses():
            return {status.name: status.hardware_id for array in live.diagnostics
                    for status in array.status}
        live.wait_until(lambda: len(statuses()) >= 4 and len(frames) == 2, 'both nodes')
        assert statuses() == {f'{node}: {status}': node for status in STATUSES
                              for node in ('/attitude_node', '/two/attitude_node')}
        assert frames == {'/imu/data': 'one/base_link', '/two/imu/data': 'two/base_link'}
        start_ns = live.now_ns()
        for number, frame_id in enumerate(('', 'one/base_link', 'world', 'base_link', 'two/world',
                                           'two/base_link')):
            live.publish(start_ns + number, frame_id, [0.01, 0.02, number * 0.01])
        live.wait_until(lambda: live.diagnosis('torques')[0]['received'] == 6, 'all torques')
        live.wait_until(lambda: len(live.torques) == 3, 'three torques')
        counts, _, _ = live.diagnosis('torques')
        assert counts['rejected: unknown frame'] == 3
        assert [torque.frame_id for torque in decoded(live, ACCEPTED, messages.WRENCH)] == [
            'one/base_link', 'one/base_link', 'world']
        prefix, = get_parameters(live, 'frame_prefix')
        assert prefix.string_value == 'one/'
        live.dump_parameters(tmp_path / 'live.yaml')
        live.end()
        run = replayed(tmp_path, live)
    assert len(run.stamps_ns) == 4
    np.testing.assert_array_equal(run.committed, run.replay)


def test_a_force_without_a_lever_arm_is_logged_once_and_counted_and_is_no_warning(domain):
    with LiveSession(TUMBLER, domain, *RELIABLE, '-p', 'history:=60.0') as live:
        start_ns = live.now_ns()
        for number in range(20):
            live.publish_bytes(messages.WRENCH.encode(
                start_ns + number, ('', 'world')[number % 2], [0, 0, 9.81, 0.01, 0, 0]))
        live.wait_until(lambda: live.diagnosis('torques')[0]['applied'] == 20, 'all torques')
        counts, _, _ = live.diagnosis('torques')
        reports = [status for array in live.diagnostics for status in array.status]
        lines = [line for line in live.end().splitlines() if 'force' in line]
    assert counts['force ignored'] == 20
    assert not [status.message for status in reports if 'force' in status.message]
    line, = lines
    assert line.startswith('[INFO]')
    assert 'the force of a WrenchStamped is ignored, as it has no lever arm' in line
