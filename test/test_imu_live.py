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

"""The errors in imu/data, and the covariances in odometry, that a node publishes."""

from conftest import SECOND
from live import TUMBLER
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.qos import QoSProfile
from rigid_body_ros import messages, recording, scene
from rigid_body_ros.replay import replay
from sensor_msgs.msg import Imu
from test_torque_topics import LOGS, SOURCES, Sources

pytestmark = pytest.mark.ros
ERRORS = [word for key, value in {
    'imu.gyro_noise_density': 2e-3, 'imu.gyro_random_walk': 1e-3, 'imu.gyro_bias.x': 0.01,
    'imu.attitude_noise': 3e-3, 'imu.delay': 0.05, 'imu.seed': 7,
    'odometry.attitude_variance': 1e-4, 'odometry.rate_variance': 2e-6,
}.items() for word in ('-p', f'{key}:={value}')]
#: The IMU measures states that late torques can no longer change.
LOCKSTEP = ('-p', 'mode:=lockstep', '-p', 'step:=0.02', '-p', 'history:=0.02',
            '-p', 'max_future:=0.01', *SOURCES, *ERRORS)
STEPS, STEP_NS = 40, SECOND // 50


class Sensed(Sources):
    """A session that also records imu/data and odometry, by stamp."""

    def _connect(self):
        super()._connect()
        self.imu, self.odometry = {}, {}
        for topic, kind, code, found in (('imu/data', Imu, messages.IMU, self.imu),
                                         ('odometry', Odometry, messages.ODOMETRY,
                                          self.odometry)):
            def hear(data, code=code, found=found):
                message = code.decode(data)
                # While no torque arrives, a lockstep loop repeats its states.
                values = found.setdefault(message.stamp_ns, message.values)
                np.testing.assert_array_equal(values, message.values)
            self.node.create_subscription(kind, topic, hear, QoSProfile(depth=1000), raw=True)
            self.wait_until(lambda topic=topic: self.node.count_publishers(topic), topic)


def loop(tmp_path, domain, seed):
    """Send torques to a lockstep node in an order that depends on the seed; return IMU data."""
    random, torques = np.random.default_rng(seed), np.random.default_rng(4)
    with Sensed(TUMBLER, domain, *LOCKSTEP) as live:
        for number in range(STEPS):
            stamp_ns = SECOND + number * STEP_NS
            values = dict(zip(LOGS, 0.01 * torques.normal(size=(3, 3))))
            for topic in random.permutation([*LOGS]):
                live.publish_on(topic, stamp_ns, values[topic])
            live.wait_until(lambda next_ns=stamp_ns + STEP_NS: next_ns in live.imu,
                            'the response')
        live.dump_parameters(tmp_path / 'live.yaml')
        assert live.stop() == 0
        live.write(tmp_path / 'live.mcap')
    return live


def test_live_lockstep_and_replay_have_the_same_noise_in_any_order_of_arrival(tmp_path, domain):
    live = loop(tmp_path, domain, 1)
    again = loop(tmp_path, domain, 2)
    run, output = scene.load(tmp_path / 'live.yaml'), tmp_path / 'out.mcap'
    replay(tmp_path / 'live.mcap', run, output, topic=[*LOGS.values()][:2],
           wheel_torque=LOGS['wheel_torque'], also=('imu',))
    written = recording.read(output, '/imu/data', messages.IMU)
    # There is no live IMU message for the start, whose stamp was unknown when it was published.
    assert len(written.stamps_ns) == STEPS
    for stamp_ns, values in zip(written.stamps_ns.tolist()[1:], written.values[1:]):
        np.testing.assert_array_equal(live.imu[stamp_ns], values)
    for stamp_ns in live.imu.keys() - {0}:
        np.testing.assert_array_equal(again.imu[stamp_ns], live.imu[stamp_ns])
    # It is not a copy of the motion.
    state = live.odometry[int(written.stamps_ns[-1])]
    assert abs(written.values[-1, :4] - state[messages.ORIENTATION]).max() > 1e-3


def test_in_real_time_the_noise_is_that_of_the_stamp(tmp_path, domain):
    with Sensed(TUMBLER, domain, *SOURCES, *ERRORS) as live:
        live.wait_until(lambda: len(live.imu) > 50, 'imu/data')
        live.dump_parameters(tmp_path / 'live.yaml')
        assert live.stop() == 0
    run, stamps_ns = scene.load(tmp_path / 'live.yaml'), np.array([*live.imu])
    motion = run.problem().propagate(
        at=np.maximum(stamps_ns - run.imu.delay_ns, run.start.time_ns))
    np.testing.assert_array_equal([*live.imu.values()], messages.imu_values(
        stamps_ns, motion.attitude, motion.angular_velocity, run.imu))
    stated = np.array([*live.odometry.values()])
    np.testing.assert_array_equal(stated[:, 7:43:7], [[1e6] * 3 + [1e-4] * 3] * len(stated))
    np.testing.assert_array_equal(stated[:, 49::7], [[1e6] * 3 + [2e-6] * 3] * len(stated))
