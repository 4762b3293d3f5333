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

"""The security policy is valid, and allows exactly what the nodes use."""

from importlib.util import find_spec
import json
import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

from conftest import at_night, CONFIG
import pytest

POLICY = CONFIG / 'security' / 'rigid_body_ros.policy.xml'
#: The rules for policies of sros2, version 0.2.0: for each element, its attributes, which of these
#: are optional, and its children. A profile may have any number of each child.
RULES = {
    'policy': ({'version'}, set(), ['enclaves']), 'enclaves': (set(), set(), ['enclave']),
    'enclave': ({'path'}, set(), ['profiles']), 'profiles': (set(), set(), ['profile']),
    'profile': ({'ns', 'node'}, set(), ['topics', 'services', 'actions']),
    'topics': (set(), {'publish', 'subscribe'}, ['topic']),
    'services': (set(), {'reply', 'request'}, ['service']),
    'actions': (set(), {'call', 'execute'}, ['action'])}
#: Elements that occur only once.
ONCE = ('enclaves',)
#: The permission of each kind of endpoint.
KINDS = {'publisher': ('topics', 'publish'), 'subscriber': ('topics', 'subscribe'),
         'service': ('services', 'reply'), 'client': ('services', 'request')}
GRAPH = """
import json, sys
import rclpy
from {module} import {name}
rclpy.init(args=['node', '--ros-args', *sys.argv[1:]])
node = {name}()
where = node.get_name(), node.get_namespace()
print(json.dumps({{kind: [name for name, _ in getattr(
    node, f'get_{{kind}}_names_and_types_by_node')(*where)] for kind in {kinds}}}))
rclpy.try_shutdown()
"""
NODE = 'rigid_body_ros.node.attitude_node', 'AttitudeNode'
MANAGED = 'rigid_body_ros.node.lifecycle', 'AttitudeLifecycleNode'
MONITOR = 'rigid_body_ros.node.attitude_monitor', 'AttitudeMonitor'
CONTROLLER = 'rigid_body_ros.node.attitude_controller', 'AttitudeController'
#: Together, these configurations use every topic of the node except further torque_topics.
CONFIGURATIONS = [
    ('-p', 'mode:=lockstep', '-p', 'publish_clock:=true', '-p', 'wheel_names:=[rw]',
     '-p', 'rw.axis.x:=1.0', '-p', 'rw.inertia:=0.001', '-p', 'inertia_topic:=true',
     '-p', 'actuator.topics:=[torque]'),
    ('-p', 'use_sim_time:=true', '-p', 'wheels:=true',
     *(('-p', 'publish_tf:=true') if find_spec('tf2_msgs') else ())),
    ('-p', 'mode:=clock')]
#: Offered only if simulation_interfaces is installed.
SIMULATION = ('reset_simulation', 'step_simulation', 'set_simulation_state', 'get_entity_state')
#: Together, these use every topic of the monitor except the measured topics.
MONITORED = [('-p', 'monitor.measured:=[/measured]', '-p', 'monitor.attitude_noise:=0.001',
              '-p', 'monitor.rate_noise:=0.001', '-p', 'use_sim_time:=true',
              '-p', 'wheels:=true')]


def violations(element):
    """Return the violations of the rules in an element and its descendants."""
    required, optional, children = RULES.get(element.tag, (set(), set(), []))
    given = {*element.attrib}
    found = [f'{element.tag}: attributes {given}'] if not (
        required <= given <= required | optional and (given or not optional)) else []
    if any(element.get(name) not in ('ALLOW', 'DENY') for name in optional & given):
        found.append(f'{element.tag}: {element.attrib}')
    if not children:
        return found if (element.text or '').strip() and not len(element) else [element.tag]
    found += [f'{element.tag}: {child.tag}' for child in element if child.tag not in children]
    tags = [child.tag for child in element]
    if not tags or any(tags.count(tag) > 1 for tag in ONCE):
        found.append(f'{element.tag}: children {tags}')
    return found + [text for child in element for text in violations(child)]


def full_name(profile, name):
    space, node = profile.get('ns').rstrip('/'), profile.get('node')
    return name if name.startswith('/') else f'{space}/{name}'.replace('/~', f'/{node}')


def allowed(executable):
    """Return the names that the policy of an executable allows, by kind of endpoint."""
    profile, = ElementTree.parse(POLICY).iterfind(
        f'.//enclave[@path="/rigid_body_ros/{executable}"]//profile')
    return {kind: [full_name(profile, entry.text) for group in profile.iterfind(tag)
                   if group.get(right) == 'ALLOW' for entry in group]
            for kind, (tag, right) in KINDS.items()}


def test_it_keeps_the_rules_of_sros2():
    root = ElementTree.parse(POLICY).getroot()
    assert root.tag == 'policy'
    assert root.get('version') == '0.2.0'
    assert violations(root) == []


@pytest.mark.parametrize(('change', 'violation'), [
    (('<topics publish="ALLOW">', '<topics publish="YES">'), "topics: {'publish': 'YES'}"),
    (('<topics publish="ALLOW">', '<topics>'), 'topics: attributes set()'),
    (('<topic>torque</topic>', '<topic> </topic>'), 'topic'),
    (('<topic>torque</topic>', '<service>torque</service>'), 'topics: service'),
    ((' ns="/"', ''), "profile: attributes {'node'}")])
def test_the_rules_find_a_mistake(change, violation):
    root = ElementTree.fromstring(POLICY.read_bytes().replace(*map(str.encode, change), 1))
    assert violations(root) == [violation]


@pytest.mark.parametrize('executable', [
    'attitude_node', 'attitude_lifecycle_node', 'attitude_monitor', 'attitude_controller'])
def test_it_allows_nothing_twice_and_denies_nothing(executable):
    for names in allowed(executable).values():
        assert len(names) == len({*names})
    assert b'DENY' not in POLICY.read_bytes()


@pytest.mark.slow
def test_it_is_installed(installed):
    path = installed / 'share' / 'rigid_body_ros' / 'config' / 'security' / POLICY.name
    assert path.read_bytes() == POLICY.read_bytes()


def graph(domain, node, *arguments):
    """Return the names of all endpoints of a node by kind; a node knows its own at once."""
    module, name = node
    environment = os.environ | {
        'ROS_DOMAIN_ID': str(domain), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'PYTHONPATH': os.pathsep.join(sys.path)}
    program = GRAPH.format(module=module, name=name, kinds=[*KINDS])
    result = subprocess.run([sys.executable, '-c', program, *arguments], env=environment,
                            capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


@pytest.mark.ros
@pytest.mark.parametrize(('executable', 'node', 'configurations', 'started'), [
    ('attitude_node', NODE, CONFIGURATIONS, ()),
    ('attitude_monitor', MONITOR, MONITORED, ()),
    *at_night(('attitude_lifecycle_node', MANAGED, CONFIGURATIONS, ('-p', 'autostart:=true')))])
def test_a_node_uses_exactly_what_its_policy_allows(domain, executable, node, configurations,
                                                    started):
    pytest.importorskip('rclpy', reason='ROS 2 (rclpy) is not installed')
    policy, used = allowed(executable), {kind: set() for kind in KINDS}
    for arguments in configurations:
        found = graph(domain, node, '--params-file', str(CONFIG / 'tumbler.yaml'), *started,
                      *arguments)
        for kind, names in found.items():
            assert {*names} <= {*policy[kind]}, arguments
            used[kind] |= {*names}
    # Used only until the URDF arrives; the node of test_robot_description.py waits for it.
    used['subscriber'].add('/robot_description')
    if node is not MONITOR and not find_spec('tf2_msgs'):
        used['publisher'].add('/tf')
    if node is not MONITOR and not find_spec('simulation_interfaces'):
        used['service'] |= {f'/attitude_node/{name}' for name in SIMULATION}
    assert used == {kind: {*names} for kind, names in policy.items()}


@pytest.mark.ros
def test_the_controller_uses_exactly_what_its_policy_allows(domain):
    pytest.importorskip('rclpy', reason='ROS 2 (rclpy) is not installed')
    found = graph(domain, CONTROLLER, '-p', 'use_sim_time:=true')
    assert {kind: {*names} for kind, names in found.items()} \
        == {kind: {*names} for kind, names in allowed('attitude_controller').items()}
