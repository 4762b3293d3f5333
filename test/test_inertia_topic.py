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

"""attitude_node with a body that changes, by messages on the topic inertia."""

from conftest import SECOND
from geometry_msgs.msg import InertiaStamped
from live import commit, decoded, live_values, PATIENT, TUMBLER
from live_session import COMMITTED
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from rigid_body_ros import messages, read, recording, RigidBody, scene, State
from rigid_body_ros.replay.verify import verify
from test_torque_topics import LOGS, plan, SOURCES, Sources

pytestmark = pytest.mark.ros
ACCEPTED = '/attitude_node/accepted_inertia'
CHANGES = ('-p', 'inertia_topic:=true', '-p', 'inertia_change:=keep_momentum')
LOCKSTEP = ('-p', 'mode:=lockstep', '-p', 'step:=0.02')


class Bodies(Sources):
    """A session that also publishes inertia, and records its log."""

    def _connect(self):
        super()._connect()
        self._inertia = self.node.create_publisher(InertiaStamped, 'inertia', 1000)
        self.received[ACCEPTED] = []
        self.node.create_subscription(
            InertiaStamped, ACCEPTED, self.received[ACCEPTED].append,
            QoSProfile(depth=100_000, durability=DurabilityPolicy.TRANSIENT_LOCAL), raw=True)
        self.wait_until(self._inertia.get_subscription_count, 'the node to subscribe')

    def change(self, stamp_ns, entries, frame_id=''):
        """Publish an inertia: ixx, iyy, izz, ixy, ixz, iyz, kg m^2."""
        self._inertia.publish(messages.inertia(stamp_ns, frame_id, entries))

    def bodies(self):
        """Return the accepted inertias, decoded, of all epochs."""
        return decoded(self, ACCEPTED, messages.INERTIA)

    def write(self, path):
        """Write the logs and the committed states to a recording, and return its topics."""
        kinds = {COMMITTED: messages.ODOMETRY, **dict.fromkeys(LOGS.values(), messages.WRENCH),
                 ACCEPTED: messages.INERTIA}
        with recording.Writer(path) as writer:
            for topic, kind in kinds.items():
                writer.add_topic(topic, kind)
                for data in self.received[topic]:
                    writer.write(topic, kind.decode(data).stamp_ns, data)
        torque, other, wheels = LOGS.values()
        return recording.Topics((torque, other), wheels, inertia=ACCEPTED)


def inertias(random, count):
    """Return the entries of inertia tensors of random clouds of points."""
    return [RigidBody.from_point_masses(random.uniform(0.1, 1.0, 6),
                                        0.3 * random.normal(size=(6, 3))).entries
            for _ in range(count)]


def verified(tmp_path, live):
    """Return how well the replay of all epochs agrees, and the last epoch's problem and states."""
    path, topics = tmp_path / 'live.mcap', live.write(tmp_path / 'live.mcap')
    run = scene.load(tmp_path / 'live.yaml')
    problem = read(path, run, topic=topics.torques, wheel_torque=topics.wheel_torque,
                   inertia=topics.inertia)
    committed = recording.read(path, COMMITTED, messages.ODOMETRY)
    begin = int(np.flatnonzero(committed.stamps_ns == problem.start.time_ns)[-1])
    return (verify(path, run, path, topics), problem, committed.stamps_ns[begin:],
            live_values(committed)[begin:])


def test_live_is_replay_bit_for_bit_in_any_order_of_arrival(tmp_path, domain):
    random = np.random.default_rng(36)
    with Bodies(TUMBLER, domain, *SOURCES, *PATIENT, *CHANGES) as live:
        rows = plan(live, random, LOGS)[::4]
        # At the stamp of a torque, and between stamps.
        stamps = [rows[100][2], *(rows[k][2] + 1 for k in (50, 150, 250, 350, 450))]
        changes = [(stamp + int(random.integers(0, SECOND // 2)), 'inertia', stamp, entries, '')
                   for stamp, entries in zip(stamps, inertias(random, 6))]
        for due_ns, topic, stamp_ns, values, frame_id in sorted(
                [*rows, *changes], key=lambda row: row[0]):
            live.spin((due_ns - live.now_ns()) * 1e-9)
            if topic == 'inertia':
                live.change(stamp_ns, values)
            else:
                live.publish_on(topic, stamp_ns, values, frame_id)
        live.wait_until(lambda: len(live.bodies()) == 6, 'all bodies')
        live.wait_until(lambda: sum(len(live.accepted(topic)) for topic in LOGS) == len(rows),
                        'all torques')
        commit(live, 1 + len(np.unique([*stamps, *(row[2] for row in rows)])))
        live.dump_parameters(tmp_path / 'live.yaml')
        assert live.stop() == 0
        result, problem, stamps_ns, states = verified(tmp_path, live)
    assert result.same.all()
    assert not result.pending
    assert set(stamps) < set(result.stamps_ns.tolist())
    motion = problem.propagate(at=stamps_ns)
    np.testing.assert_array_equal(states, np.hstack([motion.attitude, motion.angular_velocity]))
    # The changes matter: without them, the motion differs.
    without = scene.load(tmp_path / 'live.yaml').problem(problem.start).replaced(
        log=problem.logs, wheels=problem.wheels).propagate(at=stamps_ns)
    assert abs(without.attitude - motion.attitude).max() > 0.1


def test_in_lockstep_an_inertia_gets_no_response_and_acts_in_the_next_epoch(tmp_path, domain):
    step, lighter = SECOND // 50, (0.015, 0.02, 0.022, 0.0, 0.0, 0.0)
    with Bodies(TUMBLER, domain, *SOURCES, *LOCKSTEP, *CHANGES) as live:
        def ask(stamp_ns):
            before = len(live.received[COMMITTED])
            for topic in LOGS:
                live.publish_on(topic, stamp_ns, [0.001, 0.0, 0.002])
            live.wait_until(lambda: len(live.received[COMMITTED]) > before or any(
                message.stamp_ns == stamp_ns for message in live.accepted('torque')), 'a torque')
        for number in range(20):
            ask(SECOND + number * step)
        live.change(SECOND + 20 * step, lighter)
        live.wait_until(live.bodies, 'the body')
        for number in range(20, 30):
            ask(SECOND + number * step)
        live.set_state(State(SECOND + 29 * step + step // 2, (0, 0, 0, 1), (0.1, 0.2, 0.3)))
        live.wait_until(lambda: len(live.bodies()) == 2, 'the body of the next epoch')
        for number in range(30, 40):
            ask(SECOND + number * step)
        live.dump_parameters(tmp_path / 'live.yaml')
        assert live.stop() == 0
        result, problem, _, _ = verified(tmp_path, live)
    assert result.same.all()
    assert result.epochs == result.compared_epochs == 2
    assert tuple(problem.body_at(problem.start.time_ns).entries) == lighter


def test_what_is_no_inertia_is_rejected_and_counted(domain):
    with Bodies(TUMBLER, domain, *SOURCES, *PATIENT, *CHANGES) as live:
        now_ns = live.now_ns()
        for entries, frame_id in [((1.0, 1.0, 3.0, 0.0, 0.0, 0.0), ''),
                                  ((1.0, np.nan, 1.0, 0.0, 0.0, 0.0), ''),
                                  ((1.0, 1.0, 1.0, 0.0, 0.0, 0.0), 'world')]:
            live.change(now_ns, entries, frame_id)
        live.wait_until(lambda: live.diagnosis('inertia')[0].get('received') == 3, 'all messages')
        counts, _, _ = live.diagnosis('inertia')
        assert counts['rejected: no body has this inertia'] == 2
        assert counts['rejected: unknown frame'] == 1
        words = live.end()
    assert 'inertia rejected (1 so far): no body has this inertia: ' in words
