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

"""attitude_node with several topics of torques, rotors, actuators, a changing body and an IMU."""

import re

from conftest import SECOND
from geometry_msgs.msg import Twist, Vector3, Vector3Stamped, Wrench, WrenchStamped
from live import commit, finished, late, options, PATIENT, play, Session, stamps_of, TUMBLER
from live_session import ACCEPTED, ATTITUDE, RELIABLE
import numpy as np
import pytest
from rcl_interfaces.srv import DescribeParameters
from rigid_body_ros import messages, recording, RigidBody, scene, State
from rigid_body_ros.mechanics import so3
from rigid_body_ros.node.open_loop import message_type
from rigid_body_ros.replay import replay

pytestmark = pytest.mark.ros
WHEELS, INERTIA, APPLIED = 'wheel_torque', 'inertia', 'applied_torque'
#: The topics of torques and inertias, and the logs of what is accepted of them.
LOGS = {'torque': ACCEPTED, 'disturbance': f'{ACCEPTED}_1',
        WHEELS: '/attitude_node/accepted_wheel_torque',
        INERTIA: '/attitude_node/accepted_inertia'}
TORQUES = [*LOGS][:3]
KINDS = {**dict.fromkeys(TORQUES, messages.WRENCH), INERTIA: messages.INERTIA}
#: Other outputs that are recorded by topic and stamp.
OUTPUTS = {APPLIED: messages.WRENCH, 'imu/data': messages.IMU,
           'rotor_momentum': messages.VECTOR3, 'odometry': messages.ODOMETRY}
SOURCES = (*RELIABLE, *options(
    'torque_topics:=[torque,disturbance] wheels:=true initial_rotor_momentum.x:=0.01 '
    'initial_rotor_momentum.z:=-0.02 '
    'qos_overrides./disturbance.subscription.reliability:=reliable '
    'qos_overrides./wheel_torque.subscription.reliability:=reliable'))
ACTUATOR = options('actuator.topics:=[torque] actuator.delay:=0.03 actuator.time_constant:=0.05 '
                   'actuator.limit.x:=0.01 actuator.limit.z:=0.015')
CHANGES = options('inertia_topic:=true inertia_change:=keep_momentum')
DAMPED = options('torque_timeout:=0.02 damping.dxx:=0.01 damping.dyy:=0.02')
IMU = options('imu.gyro_noise_density:=0.002 imu.gyro_random_walk:=0.001 imu.gyro_bias.x:=0.01 '
              'imu.attitude_noise:=0.003 imu.delay:=0.05 imu.seed:=7 '
              'odometry.attitude_variance:=0.0001 odometry.rate_variance:=2.0e-6')
LOCKSTEP = options('mode:=lockstep step:=0.02')
#: The IMU measures states that late torques can no longer change.
FINAL = options('history:=0.02 max_future:=0.01')
STEP_NS = SECOND // 50
#: A weight below the pivot, a dipole, and an orbit whose gravity gradient is strong enough to see.
FIELDS = """
    fields: [pivot, magnet]
    pivot: {moment: {z: -0.002}, field: {z: -9.81}}
    magnet: {moment: {x: 2.0}, field: {y: 0.003}}
    orbit: {mean_motion: 0.2, position: {x: 0.8, y: 0.6}}
    start_time: 1000000000
"""


class Sources(Session):
    """
    A session that publishes on every topic of torques and inertias, and records everything.

    The file `given` has the parameters of the node at its start.
    """

    def __init__(self, folder, *arguments):
        super().__init__(*arguments)
        self._folder = folder

    def _connect(self):
        super()._connect()
        self.topics = [*LOGS] if CHANGES[1] in self.command else TORQUES
        self.publishers = {topic: self.node.create_publisher(
            message_type(topic, kind.name), topic, 10_000)
            for topic, kind in KINDS.items() if topic != 'torque'}
        self.publishers['torque'] = self._torque
        for topic in self.topics[1:]:
            self.record(LOGS[topic], KINDS[topic])
        self.outputs = {topic: {} for topic in OUTPUTS}
        for topic, kind in OUTPUTS.items():
            def hear(data, topic=topic, kind=kind):
                message = kind.decode(data)
                first = self.outputs[topic].setdefault(message.stamp_ns, message)
                # While no torque arrives, a lockstep loop repeats its states.
                np.testing.assert_array_equal(message.values, first.values)
            self.node.create_subscription(message_type(topic, kind.name), topic, hear, 1000,
                                          raw=True)
        for topic in self.topics:
            self.wait_until(self.publishers[topic].get_subscription_count, 'the subscription')
        self.given = self._folder / 'given.yaml'
        self.dump_parameters(self.given)

    def publish_on(self, topic, stamp_ns, values, frame_id=''):
        """Publish a torque, N m, or an inertia: ixx, iyy, izz, ixy, ixz, iyz, kg m^2."""
        made = messages.inertia if topic == INERTIA else messages.wrench
        self.publishers[topic].publish(made(stamp_ns, frame_id, values))

    def accepted(self, topic):
        """Return the stamps of the accepted messages of a topic, of all epochs."""
        return stamps_of(self, LOGS[topic])

    def log(self):
        """Return the topics of the logs, in the order of a replay."""
        torque, other, wheels, *inertia = (LOGS[topic] for topic in self.topics)
        return recording.Topics((torque, other), wheels, inertia=inertia[0] if inertia else None)


def flown(folder, live):
    """End a session; a replay has the bits of the states of every epoch."""
    # The orbit begins with the first epoch, so the node reports another at the end.
    return finished(folder, live, live.log(), live.given)


def plan(live, random):
    """Return messages: when to publish them, topic, stamp, values, frame."""
    start_ns, rows = live.now_ns(), []
    for topic in TORQUES:
        frames = ('', 'base_link') if topic == WHEELS else ('', 'base_link', 'world')
        for due_ns, stamp_ns in late(random, start_ns, 200, 200):
            torque = random.normal(size=3) * 0.02 * (random.random() > 0.3)
            rows.append((due_ns, topic, stamp_ns, torque, frames[random.integers(len(frames))]))
    if INERTIA in live.topics:  # at the stamp of a torque, and between stamps
        for stamp_ns in (rows[20][2], *(rows[k][2] + 1 for k in (10, 30, 50, 70, 90))):
            body = RigidBody.from_point_masses(random.uniform(0.1, 1.0, 6),
                                               0.3 * random.normal(size=(6, 3)))
            rows.append((stamp_ns + int(random.integers(0, SECOND // 2)), INERTIA, stamp_ns,
                         body.entries, ''))
    return rows


@pytest.mark.parametrize('arguments', [
    DAMPED, CHANGES, [*ACTUATOR, *options('torque_timeout:=0.02')]],
    ids=['damped', 'changes', 'actuator'])
def test_live_is_replay_bit_for_bit_in_any_order_of_arrival(tmp_path, domain, arguments):
    with Sources(tmp_path, TUMBLER, domain, *SOURCES, *PATIENT, *arguments) as live:
        rows = plan(live, np.random.default_rng(29))
        play(live, rows, live.publish_on)
        live.wait_until(lambda: sum(len(live.accepted(topic)) for topic in live.topics)
                        == len(rows), 'all messages')
        stamps = np.unique([stamp_ns for _, _, stamp_ns, *_ in rows])
        commit(live, 1 + len(stamps))
        run = flown(tmp_path, live)
    for topic in live.topics:
        accepted = live.accepted(topic)
        if topic == 'torque':
            accepted.pop()  # the torque that is far ahead
        assert sorted(accepted) == sorted(row[2] for row in rows if row[1] == topic)
        assert np.any(np.diff(accepted) < 0)  # they did come out of order
    # One state for each change, however many sources there are.
    np.testing.assert_array_equal(run.stamps_ns[1:1 + len(stamps)], stamps)
    assert run.scene.start.rotor_momentum.tolist() == [0.01, 0.0, -0.02]
    # The arguments matter: without them, the motion differs.
    end, problem = [int(stamps[-1])], run.problem
    without = scene.load(TUMBLER).problem(problem.start).replaced(
        log=problem.logs, wheels=problem.wheels)
    assert abs(without.propagate(at=end).attitude
               - problem.propagate(at=end).attitude).max() > 1e-3


LIGHTER = (0.015, 0.02, 0.022, 0.0, 0.0, 0.0)


@pytest.fixture(scope='module')
def lockstep(tmp_path_factory, domain):
    """Run a lockstep loop with every term, in two epochs."""
    folder, random = tmp_path_factory.mktemp('lockstep'), np.random.default_rng(39)
    given = folder / 'scene.yaml'
    given.write_text(TUMBLER.read_text() + FIELDS)
    with Sources(folder, given, domain, *SOURCES, *LOCKSTEP, *FINAL, *ACTUATOR, *CHANGES,
                 *IMU) as live:
        def ask(numbers):
            for number in numbers:
                for topic in random.permutation(TORQUES):
                    # The other torques are constant, so the torque at a response is that after it.
                    command = topic == 'torque'
                    live.publish_on(topic, number * STEP_NS, 0.02 * random.normal(size=3)
                                    if command else [0.001, 0.0, 0.002],
                                    'world' if command and random.random() < 0.3 else '')
                live.wait_until(lambda due_ns=(number + 1) * STEP_NS: due_ns in stamps_of(
                    live, ATTITUDE), 'a response')
        ask(range(50, 65))
        count = len(live.received[ATTITUDE])
        live.publish_on(INERTIA, 65 * STEP_NS, LIGHTER)
        live.wait_until(lambda: live.accepted(INERTIA), 'the body')
        assert len(live.received[ATTITUDE]) == count  # an inertia gets no response
        ask(range(65, 80))
        begin_ns = 79 * STEP_NS + STEP_NS // 2
        live.set_state(State(begin_ns, (0, 0, 0, 1), (0.1, 0.2, 0.3)))
        live.wait_until(lambda: begin_ns in stamps_of(live, ATTITUDE)
                        and len(live.accepted(INERTIA)) == 2, 'the new epoch')
        ask(range(80, 100))
        names = [f'{name}.{group}.{axis}' for name in ('pivot', 'magnet')
                 for group in ('moment', 'field') for axis in 'xyz']
        described = live.call(DescribeParameters, 'describe_parameters', names=names).descriptors
        assert all(each.read_only and each.floating_point_range and each.description
                   for each in described)
        denied = live.set_parameter('pivot.moment.z', 0.0)
        assert 'pivot.moment.z' in denied.reason
        run = flown(folder, live)
        return live, folder / 'live.mcap', run


def test_a_new_epoch_has_the_orbit_body_and_torques_of_the_last_one(lockstep):
    live, _, run = lockstep
    problem, begin_ns = run.problem, run.problem.start.time_ns
    # `flown` has replayed this scene, which begins later on the orbit than the given one.
    assert begin_ns == 79 * STEP_NS + STEP_NS // 2
    angle = 0.2 * (begin_ns - SECOND) * 1e-9
    np.testing.assert_allclose(problem.fields[-1].position, so3.rotate(
        so3.exp([0.0, 0.0, angle]), [0.8, 0.6, 0.0]), rtol=0, atol=1e-15)
    without = problem.replaced(fields=())
    assert abs(without.propagate(at=run.stamps_ns).attitude - run.replay[:, :4]).max() > 0.01
    assert tuple(problem.body_at(begin_ns).entries) == LIGHTER
    # Each state comes with the torque that acts.
    applied = live.outputs[APPLIED]
    times_ns = np.array([begin_ns, *(stamp_ns for stamp_ns in applied if stamp_ns > 80 * STEP_NS)])
    assert len(times_ns) == 21
    assert applied[begin_ns].values.any()  # the torque from before the epoch still acts
    np.testing.assert_allclose(
        [applied[stamp_ns].values[3:] for stamp_ns in times_ns],
        without.torque(times_ns, problem.propagate(at=times_ns).attitude), rtol=1e-13, atol=1e-17)


def test_the_noise_of_the_imu_is_that_of_a_replay(lockstep, tmp_path):
    (live, path, _), output = lockstep, tmp_path / 'out.mcap'
    topics = live.log()
    replay(path, scene.load(live.given), output, topic=topics.torques, inertia=topics.inertia,
           wheel_torque=topics.wheel_torque, also=('imu',))
    written = recording.read(output, '/imu/data', messages.IMU)
    found, odometry = (live.outputs[topic] for topic in ('imu/data', 'odometry'))
    assert len(written.stamps_ns) == 51
    # The first was published before this session connected.
    for stamp_ns, values in zip(written.stamps_ns.tolist()[1:], written.values[1:]):
        if stamp_ns != 80 * STEP_NS:  # in both epochs
            np.testing.assert_array_equal(found[stamp_ns].values, values)
    # It is not a copy of the motion.
    state = odometry[int(written.stamps_ns[-1])].values
    assert abs(written.values[-1, :4] - state[messages.ORIENTATION]).max() > 1e-3


def test_in_real_time_every_output_is_that_of_its_stamp(tmp_path, domain):
    with Sources(tmp_path, TUMBLER, domain, *SOURCES, *IMU) as live:
        ahead_ns = live.now_ns() + 3 * SECOND // 10
        live.publish_on(WHEELS, ahead_ns, [0.001, 0.0, 0.002])
        live.wait_until(lambda: live.accepted(WHEELS), 'the torque')
        known_ns = live.now_ns()  # on a busy machine, outputs before it may lack the torque
        live.wait_until(lambda: max(live.outputs['imu/data'], default=0)
                        > max(ahead_ns, known_ns) + SECOND // 5, 'outputs')
        run = flown(tmp_path, live)
    imu, odometry, rotors = ({stamp_ns: message.values for stamp_ns, message in
                              live.outputs[topic].items() if stamp_ns > known_ns}
                             for topic in ('imu/data', 'odometry', 'rotor_momentum'))
    stamps_ns, sensor = np.array([*imu]), run.scene.imu
    motion = run.problem.propagate(
        at=np.maximum(stamps_ns - sensor.delay_ns, run.scene.start.time_ns))
    np.testing.assert_array_equal([*imu.values()], messages.imu_values(
        stamps_ns, motion.attitude, motion.angular_velocity, sensor))
    stated = np.array([*odometry.values()])
    np.testing.assert_array_equal(stated[:, 7:43:7], [[1e6] * 3 + [1e-4] * 3] * len(stated))
    np.testing.assert_array_equal(stated[:, 49::7], [[1e6] * 3 + [2e-6] * 3] * len(stated))
    assert len(rotors.keys() & imu.keys()) > 10
    for stamp_ns, momentum in rotors.items():
        seconds = max(0, stamp_ns - ahead_ns) * 1e-9
        np.testing.assert_allclose(momentum, [0.01 + 0.001 * seconds, 0.0,
                                              -0.02 + 0.002 * seconds], rtol=0, atol=1e-16)
    assert {message.frame_id for message in live.outputs['rotor_momentum'].values()} == {
        'base_link'}


def test_each_status_is_about_its_own_source(tmp_path, domain):
    with Sources(tmp_path, TUMBLER, domain, *SOURCES, *CHANGES,
                 '-p', 'torque_timeout:=0.5') as live:
        now_ns = live.now_ns()
        for topic, values, frame_id in [
                ('disturbance', [np.nan, 0.0, 0.0], ''), ('disturbance', [0.1, 0.0, 0.0], 'map'),
                (WHEELS, [0.1, 0.0, 0.0], 'world'), ('disturbance', [0.05, 0.0, 0.0], ''),
                (INERTIA, (1.0, 1.0, 3.0, 0.0, 0.0, 0.0), ''),
                (INERTIA, (1.0, np.nan, 1.0, 0.0, 0.0, 0.0), ''),
                (INERTIA, (1.0, 1.0, 1.0, 0.0, 0.0, 0.0), 'world')]:
            live.publish_on(topic, now_ns, values, frame_id)
        second = live.node.create_publisher(WrenchStamped, 'disturbance', 10)
        for text in ('torque_timeout (0.5 s) has passed', '/disturbance: 2 publishers: '
                     '/live_session, /live_session; torques of several publishers'):
            live.wait_until(lambda text=text: text in live.diagnosis('torques_1')[2], 'a warning')
        assert live.diagnosis('torques')[1:] == live.diagnosis('wheel torques')[1:] == (0, 'OK')
        live.node.destroy_publisher(second)
        live.node.destroy_publisher(live.publishers[WHEELS])
        live.wait_until(lambda: live.diagnosis('wheel torques')[2]
                        == '/wheel_torque: no publisher', 'a warning')
        found = [live.diagnosis(name)[0]
                 for name in ('torques', 'torques_1', 'wheel torques', 'inertia')]
        words = live.end()
    counts = [{name.removeprefix('rejected: '): count for name, count in values.items()
               if name.startswith('rejected') and count} for values in found]
    assert counts == [{}, {'not finite': 1, 'unknown frame': 1}, {'unknown frame': 1},
                      {'no body has this inertia': 2, 'unknown frame': 1}]
    assert 'torque on disturbance rejected (1 so far): not finite: ' in words
    assert ('torque on wheel_torque rejected (1 so far): unknown frame: frame_id: expected '
            "'base_link' or '', because the torque on rotors is in body axes, found 'world'"
            ) in words
    assert 'inertia rejected (1 so far): no body has this inertia: ' in words


def test_a_reset_keeps_the_torques_and_a_new_state_the_rotor_momentum(tmp_path, domain):
    with Sources(tmp_path, TUMBLER, domain, *SOURCES, '-p', 'history:=0.6') as live:
        begin_ns = live.now_ns()
        live.publish_on(WHEELS, begin_ns, [0.0, 0.1, 0.0])
        live.wait_until(lambda: live.accepted(WHEELS), 'the torque on the rotors')
        live.spin(0.7)  # longer than `history`: a slow source keeps its torque
        live.publish_on('disturbance', live.now_ns(), [0.0, 0.0, 0.01])
        live.wait_until(lambda: live.accepted('disturbance'), 'the torque')
        given = State(live.now_ns() - 1, (0, 0, 1, 0), (0.1, 0.2, 0.3))
        live.set_state(given)
        live.wait_until(lambda: len(live.accepted(WHEELS)) == 2, 'the new epoch')
        live.dump_parameters(tmp_path / 'live.yaml')
        start = scene.load(tmp_path / 'live.yaml').start
        assert (start.time_ns, start.attitude.tolist()) == (given.time_ns, [0, 0, 1, 0])
        expected = 0.1 * (start.time_ns - begin_ns) * 1e-9
        np.testing.assert_allclose(start.rotor_momentum, [0.01, expected, -0.02], rtol=1e-14)
        live.set_state(State(SECOND))
        live.wait_until(lambda: 'initial_state rejected: late' in live.words(), 'its rejection')
        assert live.reset().success
        live.wait_until(lambda: len(live.accepted(WHEELS)) == 3, 'the torques of the new epoch')
        live.publish_on('torque', live.now_ns(), [0.01, 0.0, 0.0])
        live.wait_until(lambda: live.accepted('torque'), 'the torque')
        run = flown(tmp_path, live)
    initial = scene.load(TUMBLER).start
    assert run.committed[0].tolist() == [*initial.attitude, *initial.angular_velocity]
    assert run.scene.start.rotor_momentum.tolist() == [0.01, 0.0, -0.02]
    # Each epoch logs the torques in force again.
    assert [len(live.accepted(topic)) for topic in TORQUES] == [1, 3, 3]
    assert [len(log.times_ns) for log in (*run.problem.logs, run.problem.wheels)] == [1, 1, 1]


def test_lockstep_waits_for_every_topic_that_has_a_publisher(tmp_path, domain):
    with Sources(tmp_path, TUMBLER, domain, *SOURCES, *LOCKSTEP) as live:
        for number in range(1, 7):
            stamp_ns = number * STEP_NS
            for place, topic in enumerate(TORQUES[number % 3:] + TORQUES[:number % 3]):
                live.publish_on(topic, stamp_ns, [1e-3 * number, 2e-3 * place, 0.0])
                if number == 5 and place < 2:
                    live.spin(0.1)
                    assert stamps_of(live, ATTITUDE)[-1] == stamp_ns
            live.wait_until(lambda due=stamp_ns + STEP_NS: stamps_of(live, ATTITUDE)[-1:] == [due],
                            'a response')
        live.publish_on(WHEELS, 7 * STEP_NS, [0.0, 0.0, 1e-3])
        live.publish_on('torque', 7 * STEP_NS, [0.0, 0.0, 1e-3])
        live.wait_until(lambda: re.search(
            '/disturbance: no torque for .* has not responded to the state at 140000000',
            live.diagnosis('torques_1')[2]), 'a warning')
        live.node.destroy_publisher(live.publishers['disturbance'])

        def has_responded():  # repeat the torque, as a controller does
            live.publish_on('torque', 7 * STEP_NS, [0.0, 0.0, 1e-3])
            live.spin(0.1)
            return stamps_of(live, ATTITUDE)[-1] == 8 * STEP_NS
        live.wait_until(has_responded, 'a response')
        run = flown(tmp_path, live)
    assert run.stamps_ns.tolist() == [number * STEP_NS for number in range(1, 8)]


class Thrusters(Session):
    """A session whose only topic of torques has another name."""

    topic = 'thrusters'


@pytest.mark.parametrize('kind', [Wrench, Vector3Stamped])
def test_torques_of_another_type_are_accepted_and_replayed(tmp_path, domain, stranger, kind):
    with Thrusters(TUMBLER, domain, *PATIENT, *options(
            'stale_after:=0.0 torque_topics:=[thrusters] '
            'qos_overrides./thrusters.subscription.reliability:=reliable')) as live:
        live.publish(live.now_ns(), '', [0.01, 0.0, 0.0])
        live.wait_for_torques(1)
        live.disconnect()
        publisher = stranger.create_publisher(kind, 'thrusters', 10)
        live.wait_until(publisher.get_subscription_count, 'the node to subscribe')
        begin_ns, sent = live.now_ns(), []
        for number in range(5):
            stamp_ns, torque = live.now_ns(), [0.0, 0.001 * number, -0.02]
            sent.append((stamp_ns, torque))
            publisher.publish(Wrench(torque=Vector3(**dict(zip('xyz', torque))))
                              if kind is Wrench else
                              messages.VECTOR3.encode(stamp_ns, 'base_link', torque))
        live.wait_for_torques(6)
        stranger.destroy_publisher(publisher)
        live._torque = stranger.create_publisher(WrenchStamped, 'thrusters', 10)
        live.wait_until(lambda: live.torque_subscriptions, 'the node to subscribe again')
        end_ns = live.now_ns()
        commit(live, 7)
        live.wait_until(lambda: live.diagnosis('torques')[1:] == (0, 'OK'), 'no warning')
        assert '/torque' not in [subscription.topic_name for subscription in (
            *live.tested.subscriptions, *live.tested.polled)]
        run, words = finished(tmp_path, live), live.words()
    assert f'/thrusters: torques are geometry_msgs/msg/{kind.__name__}' in words
    np.testing.assert_array_equal(run.accepted.values[1:-1, 3:], [torque for _, torque in sent])
    stamps_ns = run.accepted.stamps_ns[1:-1]
    if kind is Vector3Stamped:
        np.testing.assert_array_equal(stamps_ns, [stamp_ns for stamp_ns, _ in sent])
    else:  # a Wrench is stamped as it arrives
        assert np.all(np.diff([begin_ns, *stamps_ns, end_ns]) > 0)


@pytest.mark.parametrize(('kind', 'arguments', 'accepted'), [
    (Twist, (), 'geometry_msgs/msg/WrenchStamped, geometry_msgs/msg/Wrench, '
     'geometry_msgs/msg/Vector3Stamped, px4_msgs/msg/VehicleTorqueSetpoint'),
    (Wrench, LOCKSTEP, 'geometry_msgs/msg/WrenchStamped, geometry_msgs/msg/Vector3Stamped')])
def test_diagnostics_name_a_type_that_is_not_accepted(domain, stranger, kind, arguments,
                                                      accepted):
    with Session(TUMBLER, domain, *arguments) as live:
        live.disconnect()
        publisher = stranger.create_publisher(kind, 'torque', 10)
        expected = f'/torque: expected one of {accepted}, found geometry_msgs/msg/{kind.__name__}'
        live.wait_until(lambda: expected in live.diagnosis('torques')[2], 'a warning')
        assert not publisher.get_subscription_count()
