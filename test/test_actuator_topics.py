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

"""attitude_node with actuators: live is replay, and the topic applied_torque."""

from conftest import SECOND
from geometry_msgs.msg import WrenchStamped
from live import commit, decoded, PATIENT, TUMBLER
from live_session import COMMITTED
import numpy as np
import pytest
from rigid_body_ros import messages, read, recording, scene, State
from rigid_body_ros.replay.verify import verify
from test_torque_topics import LOGS, plan, SOURCES, Sources

pytestmark = pytest.mark.ros
APPLIED = 'applied_torque'
ACTUATOR = ('-p', 'actuator.topics:=[torque]', '-p', 'actuator.delay:=0.03',
            '-p', 'actuator.time_constant:=0.05', '-p', 'actuator.limit.x:=0.01',
            '-p', 'actuator.limit.z:=0.015')
STEP_NS = SECOND // 50
LOCKSTEP = ('-p', 'mode:=lockstep', '-p', 'step:=0.02')


class Actuators(Sources):
    """A session that also records the torque that acts."""

    def _connect(self):
        super()._connect()
        self.received[APPLIED] = []
        self.node.create_subscription(WrenchStamped, APPLIED, self.received[APPLIED].append, 1000,
                                      raw=True)

    def applied(self):
        """Return the torques that act, decoded."""
        return decoded(self, APPLIED, messages.WRENCH)


def problem_of(tmp_path, live, run):
    """Return the problem of the last epoch, and how well the replay of all epochs agrees."""
    path = tmp_path / 'live.mcap'
    live.write(path)
    torque, other, wheels = LOGS.values()
    topics = recording.Topics((torque, other), wheels)
    problem = read(path, run, topic=topics.torques, wheel_torque=wheels)
    return problem, verify(path, run, path, topics)


def test_live_is_replay_bit_for_bit_in_any_order_of_arrival(tmp_path, domain):
    random = np.random.default_rng(38)
    with Actuators(TUMBLER, domain, *SOURCES, *PATIENT, *ACTUATOR,
                   '-p', 'torque_timeout:=0.02') as live:
        rows = plan(live, random, LOGS)[::4]
        for due_ns, topic, stamp_ns, torque, frame_id in rows:
            live.spin((due_ns - live.now_ns()) * 1e-9)
            live.publish_on(topic, stamp_ns, torque, frame_id)
        live.wait_until(lambda: sum(len(live.accepted(topic)) for topic in LOGS) == len(rows),
                        'all torques')
        stamps = np.unique([row[2] for row in rows])
        commit(live, 1 + len(stamps))
        live.dump_parameters(tmp_path / 'live.yaml')
        assert live.stop() == 0
        run = scene.load(tmp_path / 'live.yaml')
        problem, result = problem_of(tmp_path, live, run)
        assert live.applied()
    assert result.same.all()
    assert not result.pending
    assert set(stamps.tolist()) <= set(result.stamps_ns.tolist())
    # The actuator matters: without it, the motion differs.
    assert problem.actuators[0].time_constant == 0.05
    assert problem.actuators[1] is None
    end = [int(stamps[-1])]
    other = problem.replaced(actuator=[None, None])
    assert abs(other.propagate(at=end).attitude - problem.propagate(at=end).attitude).max() > 0.01


def test_in_lockstep_each_state_comes_with_the_torque_that_acts(tmp_path, domain):
    random = np.random.default_rng(39)
    with Actuators(TUMBLER, domain, *SOURCES, *LOCKSTEP, *ACTUATOR) as live:
        def ask(stamp_ns):
            before = len(live.applied())
            # The other torques are constant, so the torque at a response is that after it.
            for topic in LOGS:
                is_command = topic == 'torque'
                live.publish_on(topic, stamp_ns, 0.02 * random.normal(size=3) if is_command
                                else [0.001, 0.0, 0.002],
                                'world' if is_command and random.random() < 0.3 else '')
            live.wait_until(lambda: len(live.applied()) > before, 'a torque')
        for number in range(25):
            ask(SECOND + number * STEP_NS)
        begin_ns = SECOND + 24 * STEP_NS + STEP_NS // 2
        live.set_state(State(begin_ns, (0, 0, 0, 1), (0.1, 0.2, 0.3)))
        live.wait_until(lambda: any(state.stamp_ns == begin_ns for state in decoded(
            live, COMMITTED, messages.ODOMETRY)), 'the next epoch')
        for number in range(25, 50):
            ask(SECOND + number * STEP_NS)
        live.dump_parameters(tmp_path / 'live.yaml')
        assert live.stop() == 0
        problem, result = problem_of(tmp_path, live, scene.load(tmp_path / 'live.yaml'))
        # The torque from before the new epoch acts from the start of the epoch on.
        applied = [message for message in live.applied()
                   if message.stamp_ns == begin_ns or message.stamp_ns > SECOND + 25 * STEP_NS]
    assert applied[0].stamp_ns == begin_ns
    assert applied[0].values.any()
    assert result.same.all()
    assert result.epochs == result.compared_epochs == 2
    times_ns = np.array([message.stamp_ns for message in applied])
    motion = problem.propagate(at=times_ns)
    np.testing.assert_allclose([message.values[3:] for message in applied],
                               problem.torque(times_ns, motion.attitude), rtol=1e-13, atol=1e-17)
