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

"""The examples that run nodes: the demo, two bodies, relays, and one that sets the state."""

import os
import shutil
import signal
import subprocess
import sys
from types import ModuleType, SimpleNamespace

from conftest import ROOT
from geometry_msgs.msg import WrenchStamped
from live import PATIENCE, Session, spin_until, TUMBLER
from nav_msgs.msg import Odometry
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import deserialize_message
from relay import Relay
from rigid_body_ros import messages, State
from std_msgs.msg import Float64MultiArray

pytestmark = pytest.mark.ros


@pytest.fixture
def root(tmp_path):
    """Return a copy of what the demo needs, because it writes to the folder of the repository."""
    shutil.copytree(ROOT / 'examples', tmp_path / 'examples')
    for name in ('config', 'test'):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


def start(folder, name, domain, **options):
    return subprocess.Popen([sys.executable, folder / 'examples' / f'{name}.py'], cwd=folder,
                            env={**os.environ, 'ROS_DOMAIN_ID': str(domain)}, text=True,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options)


def test_the_demo_runs(root, domain):
    process = start(root, 'demo', domain)
    words, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, words + errors
    assert 'same bits     3001 of 3001' in words
    assert 'open demo/report.html in a browser' in words
    assert 'attitude_replay' in (root / 'demo' / 'report.html').read_text(encoding='utf-8')


def test_an_interrupted_demo_says_so_in_one_line(root, domain):
    process = start(root, 'demo', domain, start_new_session=True)
    try:
        if not any(line.startswith('The node is up.') for line in process.stdout):
            raise RuntimeError(process.stderr.read())
        os.killpg(process.pid, signal.SIGINT)  # as a terminal sends it
        _, errors = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (errors, process.returncode) == ('demo: interrupted\n', 130)


@pytest.fixture
def client(context):
    """Return a node of the test, and its executor."""
    node, executor = rclpy.create_node('client', context=context), SingleThreadedExecutor(
        context=context)
    executor.add_node(node)
    yield node, executor
    executor.shutdown()
    node.destroy_node()


def test_two_bodies_run_in_one_process_and_end_cleanly(client, domain):
    node, executor = client
    heard = set()
    for name in ('cube', 'rod'):
        node.create_subscription(Odometry, f'/{name}/odometry',
                                 lambda state, name=name: heard.add(name), 10)
    with start(ROOT, 'two_bodies', domain) as process:
        try:
            spin_until(executor, lambda: len(heard) == 2)
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE) == 0
        finally:
            process.kill()


def test_the_relay_publishes_the_torque_of_the_thrusts(client, context):
    node, executor = client
    relay, torques = Relay(context=context), []
    executor.add_node(relay)
    node.create_subscription(WrenchStamped, 'torque', torques.append, 10)
    thrusts = node.create_publisher(Float64MultiArray, 'thrusts', 10)
    spin_until(executor, lambda: thrusts.get_subscription_count()
               and relay.count_subscribers('torque'))
    thrusts.publish(Float64MultiArray(data=[3.0, 1.0, 2.0, 1.0]))
    spin_until(executor, lambda: torques)
    found = torques[0].wrench.torque
    # Lever arms of 0.1 m: left minus right, rear minus front, and the drag of each propeller.
    assert (found.x, found.y, found.z) == pytest.approx((0.3, -0.1, 0.01), abs=1e-15)
    assert torques[0].header.frame_id == 'base_link'


def test_the_relay_of_px4_converts_stamps_order_and_scale(monkeypatch):
    px4 = ModuleType('px4_msgs.msg')  # px4_msgs is not on PyPI; these have the fields that are set
    for name in ('VehicleAngularVelocity', 'VehicleAttitude', 'VehicleTorqueSetpoint'):
        setattr(px4, name, SimpleNamespace)
    monkeypatch.setitem(sys.modules, 'px4_msgs', ModuleType('px4_msgs'))
    monkeypatch.setitem(sys.modules, 'px4_msgs.msg', px4)
    import px4_relay
    start = State(1_790_000_000_004_000_000, (0.1, 0.3, 0.5, 0.8), (1.0, 2.0, 3.0))
    state = deserialize_message(messages.odometry(start, 'world', 'base_link'), Odometry)
    attitude, velocity = px4_relay.messages_of(state)
    assert attitude.q == start.attitude[[3, 0, 1, 2]].tolist()
    assert velocity.xyz == [1.0, 2.0, 3.0]
    assert attitude.timestamp == velocity.timestamp_sample == 1_790_000_000_004_000
    answer = px4_relay.torque_of(SimpleNamespace(
        timestamp=0, timestamp_sample=velocity.timestamp_sample, xyz=[0.5, -1.0, 0.25]))
    assert answer.header.stamp == state.header.stamp
    torque = answer.wrench.torque
    assert (torque.x, torque.y, torque.z) == (1.0, -2.0, 0.125)


def test_the_relay_of_px4_says_what_it_needs():
    result = subprocess.run([sys.executable, ROOT / 'examples' / 'px4_relay.py'], text=True,
                            stderr=subprocess.PIPE, check=False)
    assert (result.returncode, result.stderr.count('\n')) == (1, 1)
    assert result.stderr.startswith('px4_relay: expected the package px4_msgs')


def test_the_initial_state_is_that_of_the_example(domain):
    with Session(TUMBLER, domain) as live, start(ROOT, 'set_state', domain) as process:
        live.wait_until(lambda: process.poll() is not None, 'the example to end')
        assert process.stdout.read().startswith('initial_state received')
