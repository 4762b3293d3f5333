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

"""AttitudeNode in a process that composes nodes itself, with any executor, name and parameters."""

import os
import signal
import subprocess
import sys

from conftest import at_night, ROOT, SECOND
from live import decoded, late_torques, PATIENCE, publish_when_due, replayed, spin_until, TUMBLER
from live_session import ACCEPTED, ATTITUDE, COMMITTED, LiveSession, RELIABLE
from nav_msgs.msg import Odometry
import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rigid_body_ros import messages, propagate, scene, State, TorqueLog
from rigid_body_ros.node import AttitudeNode

pytestmark = pytest.mark.ros
#: The executor; `beside` adds another node that blocks it for 50 ms at a time.
COMPOSITIONS = ['multi', 'events beside', *at_night('spin', 'single', 'events', 'multi beside',
                                                    'single beside', 'spin beside')]
#: Parameters with which a stall of the machine neither makes a torque late nor overflows a queue.
PATIENT = (*RELIABLE, '-p', 'history:=60.0',
           '-p', 'qos_overrides./torque.subscription.depth:=100000')
#: Messages of a replay if the machine stalled when the epoch or the node ended.
MISSING, UNKNOWN = 'states are missing on ~/committed', 'the end of the log may be lost'
BODY = [Parameter(f'inertia.{name}', value=value)
        for name, value in (('ixx', 0.02), ('iyy', 0.03), ('izz', 0.04))]


def composed(composition):
    return [sys.executable, ROOT / 'test' / 'composed.py', *composition.split()]


def stamps_of(states):
    return [messages.ODOMETRY.decode(data).stamp_ns for data in states]


@pytest.mark.parametrize('composition', COMPOSITIONS)
def test_late_and_shuffled_torques_replay_bit_for_bit_in_every_executor(
        tmp_path, domain, composition):
    with LiveSession(TUMBLER, domain, *PATIENT, program=composed(composition)) as live:
        torques = late_torques(live.now_ns(), 2000, rate=1000)
        publish_when_due(live, torques)
        live.wait_until(lambda: len(live.torques) == 2000, 'every torque')
        live.dump_parameters(tmp_path / 'live.yaml')
        # Begin another epoch, so that the node has enough time to deliver the log of this one.
        assert live.reset().success
        live.wait_until(lambda: stamps_of(live.received[COMMITTED][-1:])[0] > torques[-1].due_ns,
                        'the start of the next epoch')
        words = live.words()
        assert live.stop() == 0
    stamps = np.unique([torque.stamp_ns for torque in torques])
    del live.received[ACCEPTED][2001:], live.received[COMMITTED][-1:]
    run = replayed(tmp_path, live)
    assert sorted(run.accepted.stamps_ns) == sorted(torque.stamp_ns for torque in torques)
    assert np.any(np.diff(run.accepted.stamps_ns) < 0)  # they did come out of order
    np.testing.assert_array_equal(run.committed, run.replay)
    count = len(run.stamps_ns) - 1
    np.testing.assert_array_equal(run.stamps_ns[1:], stamps[:count])
    assert count == len(stamps) or MISSING in words


@pytest.mark.parametrize('composition', [
    'single beside', *at_night('multi', 'spin', 'events beside')])
def test_every_torque_gets_its_response_in_every_executor(domain, composition):
    stamps, step_ns = [SECOND + number * SECOND // 50 for number in range(20)], SECOND // 50
    torques = [[0.01, 1e-3 * number, 0.0] for number in range(20)]
    with LiveSession(TUMBLER, domain, '-p', 'mode:=lockstep', '-p', 'step:=0.02',
                     program=composed(composition)) as live:
        for stamp_ns, torque in zip(stamps, torques):
            live.publish(stamp_ns, '', torque)
            live.wait_until(lambda stamp_ns=stamp_ns: live.received[ATTITUDE] and decoded(
                live, ATTITUDE, messages.QUATERNION)[-1].stamp_ns == stamp_ns + step_ns,
                'a response')
        assert live.stop() == 0
    run = scene.load(TUMBLER)
    start = State(stamps[0], run.start.attitude, run.start.angular_velocity)
    motion = propagate(run.body, start, TorqueLog(stamps, torques),
                       at=[stamp_ns + step_ns for stamp_ns in stamps])
    published = {message.stamp_ns: message.values.tolist()
                 for message in decoded(live, ATTITUDE, messages.QUATERNION)}
    for stamp_ns, attitude in zip(stamps, motion.attitude):
        assert published[stamp_ns + step_ns] == attitude.tolist()


def test_nodes_of_one_process_have_their_own_names_and_parameters(context):
    left, right = (AttitudeNode(name, namespace='fleet', context=context, parameter_overrides=[
        *BODY, Parameter('mode', value='lockstep'), Parameter('start_time', value=start_ns)])
        for name, start_ns in (('left', SECOND), ('right', 2 * SECOND)))
    client = rclpy.create_node('client', context=context)
    received = {'left': [], 'right': []}
    for name, states in received.items():
        client.create_subscription(
            Odometry, f'/fleet/{name}/committed', states.append,
            QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL), raw=True)
    executor = SingleThreadedExecutor(context=context)
    for node in (left, right, client):
        executor.add_node(node)
    spin_until(executor, lambda: all(received.values()))
    first = [messages.ODOMETRY.decode(received[name][0]).stamp_ns for name in ('left', 'right')]
    assert first == [SECOND, 2 * SECOND]
    assert left.get_parameter('inertia.izz').value == 0.04
    assert left.resolve_topic_name('torque') == '/fleet/torque'
    for node in (left, right, client):
        executor.remove_node(node)
        node.destroy_node()
    left.destroy_node()  # a second time changes nothing
    executor.shutdown()


@pytest.mark.parametrize(('arguments', 'message'), [
    ({'node_name': 'left body'}, 'Invalid node name: node name must not contain characters other '
                                 "than alphanumerics or '_': 'left body'"),
    ({'namespace': '1st'}, 'Invalid namespace: namespace must not'),
    ({'parameter_overrides': BODY[:1]}, 'inertia.iyy: expected a number (kg m^2), found none'),
    ({'parameter_overrides': [*BODY, Parameter('mode', value='fast')]},
     "mode: expected one of realtime, lockstep, clock, found 'fast'"),
    ({'parameter_overrides': [*BODY, Parameter('mode')]}, 'mode: expected text, found none'),
    ({'parameter_overrides': [*BODY, Parameter('torque_topics', value=['a/', 'b'])]},
     "torque_topics: expected names of topics (letters, digits, _ and /), found 'a/'"),
    ({'parameter_overrides': [*BODY, Parameter('torque_topics', value=['initial_state'])]},
     'torque_topics: expected topics that the node does not use for anything else')])
def test_mistakes_in_python_raise_one_line(context, arguments, message):
    with pytest.raises(scene.InputError) as raised:
        AttitudeNode(context=context, **arguments)
    assert str(raised.value).startswith(message)
    assert '\n' not in str(raised.value)


def test_a_mistake_leaves_no_node(context):
    observer = rclpy.create_node('observer', context=context)
    with pytest.raises(scene.InputError) as raised:  # holds a reference to the node
        AttitudeNode(namespace='mistaken', context=context, parameter_overrides=BODY[:1])
    spin_until(SingleThreadedExecutor(context=context), lambda: '/mistaken' not in [
        namespace for _, namespace in observer.get_node_names_and_namespaces()])
    assert raised
    observer.destroy_node()


def test_the_example_runs_two_bodies_and_ends_cleanly(context, domain):
    environment = os.environ | {'ROS_DOMAIN_ID': str(domain)}
    with subprocess.Popen([sys.executable, ROOT / 'examples' / 'two_bodies.py'],
                          env=environment) as process:
        client, heard = rclpy.create_node('client', context=context), set()
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(client)
        for name in ('cube', 'rod'):
            client.create_subscription(Odometry, f'/{name}/odometry',
                                       lambda state, name=name: heard.add(name), 10)
        try:
            spin_until(executor, lambda: len(heard) == 2)
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE) == 0
        finally:
            process.kill()
    executor.shutdown()
    client.destroy_node()


def test_destroying_a_node_publishes_what_is_pending(domain):
    with LiveSession(TUMBLER, domain, *PATIENT, program=composed('single')) as live:
        now_ns = live.now_ns()
        for number in range(10):
            live.publish(now_ns + number, '', [0.0, 0.0, 0.01])
        live.wait_until(lambda: len(live.torques) == 10, 'every torque')
        assert len(live.received[COMMITTED]) == 1  # the others may still change
        assert live.stop() == 0
        words = live.words()
        assert len(live.received[COMMITTED]) == 11 or MISSING in words or UNKNOWN in words
