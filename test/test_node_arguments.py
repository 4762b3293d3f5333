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

"""Arguments and parameters of the nodes: mistakes, and parameters of other nodes."""

import subprocess
import sys

from conftest import program
from live import Session, TUMBLER
from live_session import LiveSession
import pytest
from rcl_interfaces.srv import ListParameters
from rigid_body_ros import scene
from test_scene import SHARED

pytestmark = pytest.mark.ros
TOPICS = 'torque_topics: expected topics that the node does not use for anything else, found'
#: Parameters with a mistake, and the beginning of the message; FILE is a scene without a mistake.
MISTAKES = {
    'attitude_node': [
        ('inertia.ixx:=1', 'inertia.iyy: expected a number (kg m^2), found none'),
        ('FILE intertia.ixx:=1.0', 'intertia.ixx: unknown key; did you mean inertia.ixx?'),
        ('FILE qos_overrides./torqe.subscription.depth:=5',
         'qos_overrides./torqe.subscription.depth: not a topic, endpoint or policy of this node; '
         'did you mean qos_overrides./torque.subscription.depth?'),
        ('FILE qos_overrides./torque.subscription.depht:=5',
         'qos_overrides./torque.subscription.depht: not a topic, endpoint or policy of this '
         'node; did you mean qos_overrides./torque.subscription.depth?'),
        ('FILE qos_overrides./torque.subscription.depth:=deep',
         'Trying to set parameter'),
        ('FILE qos_overrides./torque.subscription.history:=all',
         'Unexpected QoS override for policy'),
        ('FILE use_sim_time:=1', 'Trying to set parameter'),
        ('FILE solver:=exact', "solver: 'exact' handles torque-free motion only"),
        ('FILE interpolation:=cubic', "interpolation: expected 'hold', because a node does not "
         "know the next torque, found 'cubic'"),
        ('FILE mode:=lockstep time_source:=arrival',
         "time_source: expected 'header', because lockstep replies to stamps, found 'arrival'"),
        ('FILE mode:=clock use_sim_time:=true', 'mode: clock: expected use_sim_time false'),
        ('FILE publish_clock:=true', "publish_clock: expected mode 'lockstep' or 'clock', in "
         "which the node sets the time, found 'realtime'"),
        ('FILE mode:=lockstep publish_clock:=true use_sim_time:=true',
         'publish_clock: expected use_sim_time false'),
        ('FILE robot_description:=<robot>', 'robot_description: URDF: expected XML'),
        ('FILE link:=base_link', 'link: expected an empty text, because robot_description is '
         "empty, found 'base_link'"),
        ('FILE torque_topics:=[torque,/torque]', f'{TOPICS} /torque twice'),
        ('FILE torque_topics:=[initial_state]', f'{TOPICS} /initial_state twice'),
        ('FILE torque_topics:=[~/accepted_torque]',
         f'{TOPICS} /attitude_node/accepted_torque twice'),
        ('FILE torque_topics:=[torque,wheel_torque] wheels:=true', f'{TOPICS} /wheel_torque'),
        ('FILE torque_topics:=[a/,b]', 'torque_topics: expected names of topics (letters, digits, '
         "_ and /), found 'a/'"),
        ('FILE torque_topics:=[3,4]', 'torque_topics: expected names of topics'),
        ('FILE torque_topics:=[]', 'torque_topics: expected a list of text, found none')],
    'attitude_lifecycle_node': [
        ('autostart:=true inertia.ixx:=0.02', 'inertia.iyy: expected a number (kg m^2), found '),
        ('autostart:=1', 'autostart: expected true or false, found 1')],
    'attitude_controller': [('proportional_gian:=0.1', 'proportional_gian: unknown key; did you '
                             'mean proportional_gain?')],
    'attitude_monitor': [
        ('FILE MONITOR monitor.rate_noise:=0.0',
         'monitor.rate_noise: expected the standard deviation'),
        ('FILE MONITOR inertia_topic:=true', 'inertia_topic: expected false'),
        ('FILE MONITOR monitor.measured:=["a_b/"]',
         'monitor.measured: expected names of topics'),
        ('FILE MONITOR monitor.measured:=["/imu","/imu"]',
         'monitor.measured: expected each topic once')]}
MONITOR = 'monitor.measured:=[/imu] monitor.attitude_noise:=1e-3 monitor.rate_noise:=1e-3'


@pytest.mark.parametrize(('command', 'parameters', 'message'), [
    (command, *row) for command, rows in MISTAKES.items() for row in rows])
def test_a_mistake_is_reported_in_one_line(monkeypatch, refusal, domain, command, parameters,
                                           message):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    words = [word for one in parameters.replace('MONITOR', MONITOR).split()
             for word in (('--params-file', str(TUMBLER)) if one == 'FILE' else ('-p', one))]
    assert refusal(command, '--ros-args', *words).startswith(f'{command}: error: {message}')


@pytest.mark.parametrize(('arguments', 'message'), [
    (('--rate', '5'), 'error: unrecognized arguments: --rate 5'),
    (('--ros-args', '--params-file', 'none.yaml'), 'none.yaml')])
def test_a_process_with_a_mistake_ends_with_status_2(domain, arguments, message):
    result = subprocess.run([*program('attitude_node'), *arguments], capture_output=True,
                            text=True, env=LiveSession(TUMBLER, domain).environment, check=False)
    assert result.returncode == 2
    line = result.stderr.splitlines()[-1]
    assert line.startswith('attitude_node: error: ')
    assert message in line


def test_a_transform_needs_its_message(monkeypatch, refusal, domain):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setitem(sys.modules, 'tf2_msgs', None)
    assert refusal('attitude_node', '--ros-args', '--params-file', TUMBLER,
                   '-p', 'publish_tf:=true') == (
        'attitude_node: error: publish_tf: needs the package tf2_msgs, which is not installed')


def test_a_node_logs_parameters_of_other_nodes_once_and_has_none_of_them(tmp_path, domain):
    parameters, dump = tmp_path / 'shared.yaml', tmp_path / 'dump.yaml'
    parameters.write_text(SHARED)
    overrides = [f'qos_overrides./{topic}.depth:=5' for topic in (
        'torque.publisher', 'other/torque.subscription', 'torque2.subscription')]
    arguments = [word for override in overrides for word in ('-p', override)]
    with Session(parameters, domain, *arguments) as live:
        names = live.call(ListParameters, 'list_parameters').result.names
        live.dump_parameters(dump)
        words = live.end()
    assert not [name for name in names
                if name not in scene.PARAMETERS and not name.startswith('qos_overrides./')
                and name not in ('use_sim_time', 'start_type_description_service')]
    assert not scene.load(dump).notes
    assert words.count('parameters that are not those of a scene are ignored:') == 1
    for name in ('rate', 'plugins', 'controller.kp', 'frame_id'):
        assert name in words
    assert 'torque_timout' not in words
    assert words.count('QoS overrides of other nodes are ignored:') == 1
    for override in overrides:
        assert override.partition(':=')[0] in words


@pytest.mark.nightly
def test_the_controller_logs_parameters_of_other_nodes_once(tmp_path, domain):
    parameters = tmp_path / 'shared.yaml'
    parameters.write_text(SHARED)
    with LiveSession(TUMBLER, domain, '-p', 'mode:=lockstep') as live:
        live.disconnect()
        result = subprocess.run([*program('attitude_controller'), '--ros-args', '-p',
                                 'stop_after:=0.0', '--params-file', parameters], text=True,
                                env=live.environment, capture_output=True, check=False)
    assert result.returncode == 0
    assert result.stderr.count('parameters that are not those of a controller are ignored:') == 1
    for name in ('rate', 'plugins', 'controller.kp', 'qos_overrides./scan'):
        assert name in result.stderr
    assert 'stop_after' not in result.stderr
