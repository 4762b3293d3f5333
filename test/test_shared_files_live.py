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

"""A running node with parameters of other nodes."""

import subprocess

from conftest import program
from live import TUMBLER
from live_session import LiveSession
import pytest
from rcl_interfaces.srv import ListParameters
from rigid_body_ros import scene
from test_node import run_node
from test_shared_files import SHARED

pytestmark = pytest.mark.ros


def test_a_node_logs_parameters_of_other_nodes_once_and_has_none_of_them(tmp_path, domain):
    parameters, dump = tmp_path / 'shared.yaml', tmp_path / 'dump.yaml'
    parameters.write_text(SHARED)
    overrides = [f'qos_overrides./{topic}.depth:=5' for topic in (
        'torque.publisher', 'other/torque.subscription', 'torque2.subscription')]
    arguments = [word for override in overrides for word in ('-p', override)]
    with LiveSession(parameters, domain, *arguments) as live:
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


@pytest.mark.parametrize(('argument', 'message'), [
    ('qos_overrides./torque.subscription.depht:=5',
     'did you mean qos_overrides./torque.subscription.depth?'),
    ('qos_overrides./torque.subscription.depth:=deep', 'qos_overrides./torque.subscription.depth'),
    ('use_sim_time:=1', 'use_sim_time')])
def test_a_mistake_in_a_parameter_of_ros_is_reported_in_one_line(domain, argument, message):
    result = run_node(domain, '--ros-args', '--params-file', str(TUMBLER), '-p', argument)
    lines = [line for line in result.stderr.splitlines() if not line.startswith('[')]
    assert result.returncode == 2
    assert len(lines) == 1
    assert lines[0].startswith('attitude_node: error: ')
    assert message in lines[0]


def run_controller(live, *arguments):
    """Run the controller until it receives a state."""
    return subprocess.run([*program('attitude_controller'), '--ros-args', '-p',
                           'stop_after:=0.0', *arguments], env=live.environment,
                          capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.nightly
def test_the_controller_logs_parameters_of_other_nodes_once(tmp_path, domain):
    parameters = tmp_path / 'shared.yaml'
    parameters.write_text(SHARED)
    with LiveSession(TUMBLER, domain, '-p', 'mode:=lockstep') as live:
        live.disconnect()
        result = run_controller(live, '--params-file', parameters)
    assert result.returncode == 0
    assert result.stderr.count('parameters that are not those of a controller are ignored:') == 1
    for name in ('rate', 'plugins', 'controller.kp', 'qos_overrides./scan'):
        assert name in result.stderr
    assert 'stop_after' not in result.stderr


def test_a_misspelt_parameter_of_the_controller_is_reported_in_one_line(domain):
    result = run_controller(LiveSession(TUMBLER, domain), '-p', 'proportional_gian:=0.1')
    assert result.returncode == 2
    assert result.stderr == ('attitude_controller: error: proportional_gian: unknown key; '
                             'did you mean proportional_gain?\n')
