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

"""A node has exactly the endpoints that docs/nodes.md lists and the security policy allows."""

from importlib import import_module
from importlib.util import find_spec
import xml.etree.ElementTree as ElementTree

from conftest import at_night, CONFIG
import nodes
import pytest
from rigid_body_ros.live.events import CAUSES

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
#: Parameters of a named wheel.
NAMED = 'wheel_names:=[rw] rw.axis.x:=1.0 rw.inertia:=0.001'
CONFIGURATIONS = [
    f'mode:=lockstep publish_clock:=true {NAMED} inertia_topic:=true actuator.topics:=[torque]',
    'use_sim_time:=true wheels:=true' + ' publish_tf:=true' * bool(find_spec('tf2_msgs')),
    'mode:=clock']
#: Offered only if simulation_interfaces is installed.
SIMULATION = ('reset_simulation', 'step_simulation', 'set_simulation_state', 'get_entity_state')
#: Together, these use every topic of the monitor except the measured topics.
MONITORED = ['monitor.measured:=[/measured] monitor.attitude_noise:=0.001 '
             'monitor.rate_noise:=0.001 use_sim_time:=true wheels:=true']


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
    assert b'DENY' not in POLICY.read_bytes()


def endpoints(domain, node, parameters):
    """Return the type and the QoS of all endpoints that a node creates, by kind and name."""
    import rclpy
    words = [word for one in parameters.split() for word in ('-p', one)]
    rclpy.init(args=['node', '--ros-args', '--params-file', str(CONFIG / 'tumbler.yaml'), *words],
               domain_id=domain)
    try:
        module, name = node
        made = getattr(import_module(f'rigid_body_ros.node.{module}'), name)()
        polled = getattr(made, 'polled', ())
        found = {kind: {one.topic_name: (type_name(one.msg_type), one.qos_profile)
                        for one in topics}
                 for kind, topics in (('publisher', made.publishers),
                                      ('subscriber', (*made.subscriptions, *polled)))}
        found |= {kind: {made.resolve_service_name(one.srv_name): (type_name(one.srv_type), None)
                         for one in services}
                  for kind, services in (('service', made.services), ('client', made.clients))}
        made.destroy_node()
        return found
    finally:
        rclpy.shutdown()


def type_name(kind):
    package, part, _ = kind.__module__.split('.')
    return f'{package}/{part}/{kind.__name__}'


@pytest.mark.ros
@pytest.mark.parametrize(('executable', 'name', 'configurations', 'started'), [
    ('attitude_node', 'AttitudeNode', CONFIGURATIONS, ''),
    ('attitude_monitor', 'AttitudeMonitor', MONITORED, ''),
    ('attitude_controller', 'AttitudeController', ['use_sim_time:=true'], ''),
    *at_night(('attitude_lifecycle_node', 'AttitudeLifecycleNode', CONFIGURATIONS,
               'autostart:=true '))])
def test_a_node_uses_exactly_what_its_policy_allows(domain, executable, name, configurations,
                                                    started):
    pytest.importorskip('rclpy', reason='ROS 2 (rclpy) is not installed')
    policy, used = allowed(executable), {kind: set() for kind in KINDS}
    assert all(len(names) == len({*names}) for names in policy.values())
    module = 'lifecycle' if 'lifecycle' in executable else executable
    for parameters in configurations:
        found = endpoints(domain, (module, name), started + parameters)
        for kind, names in found.items():
            assert {*names} <= {*policy[kind]}, parameters
            used[kind] |= {*names}
    used['publisher'].add('/rosout')  # rcl itself creates this publisher, and the next one
    if 'lifecycle' in executable:
        used['publisher'].add('/attitude_node/transition_event')
    if executable != 'attitude_controller':
        # Used only until the URDF arrives; the node of test_robot_description.py waits for it.
        used['subscriber'].add('/robot_description')
    if name in ('AttitudeNode', 'AttitudeLifecycleNode'):
        if not find_spec('tf2_msgs'):
            used['publisher'].add('/tf')
        if not find_spec('simulation_interfaces'):
            used['service'] |= {f'/attitude_node/{name}' for name in SIMULATION}
    assert used == {kind: {*names} for kind, names in policy.items()}


def by_full_name(topics):
    return {f'/{topic.name}'.replace('/~', '/attitude_node').replace('//', '/'): topic
            for topic in topics}


def test_the_page_lists_every_cause_of_rejection():
    assert list(nodes.CAUSES) == list(CAUSES)


@pytest.mark.ros
@pytest.mark.parametrize(('mode', 'parameters', 'absent'), [
    ('lockstep', '', ()),
    ('realtime', 'wheels:=true', ('wheel_command', 'wheel_states', 'accepted_wheel_command')),
    ('realtime', NAMED, ('wheel_torque', 'rotor_momentum', 'accepted_wheel_torque'))])
def test_a_node_has_exactly_the_topics_of_the_page(domain, mode, parameters, absent):
    published, subscribed = by_full_name(nodes.PUBLISHED), by_full_name(nodes.SUBSCRIBED)
    if parameters:
        parameters += (' torque_topics:=[torque,disturbance] inertia_topic:=true '
                       'actuator.topics:=[torque]')
        published |= by_full_name(nodes.OPTIONAL)
        subscribed |= by_full_name(nodes.SUBSCRIBED_IF_ENABLED)
        subscribed['/disturbance'] = subscribed['/torque']
    found = endpoints(domain, ('attitude_node', 'AttitudeNode'), f'mode:={mode} {parameters}')
    # A scene has either rotors or named wheels.
    others = {'tf', 'clock', 'robot_description', 'parameter_events', *absent}
    for kind, page in (('publisher', published), ('subscriber', subscribed)):
        topics, expected = ({name: one for name, one in all_.items()
                             if name.rpartition('/')[2] not in others}
                            for all_ in (found[kind], page))
        assert {name: one for name, (one, _) in topics.items()} \
            == {name: topic.kind for name, topic in expected.items()}
        for name, (_, profile) in topics.items():
            qos = expected[name].qos
            assert ('transient local' in qos) == (profile.durability.name == 'TRANSIENT_LOCAL')
            # The reliability of torques and commands depends on the mode.
            is_reliable = mode == 'lockstep' if kind == 'subscriber' and name not in (
                '/initial_state', '/inertia') else 'reliable' in qos.partition(', keep')[0]
            assert is_reliable == (profile.reliability.name == 'RELIABLE'), name
    services = found['service']
    assert services['/attitude_node/reset'][0] == 'std_srvs/srv/Trigger'
    assert services.get('/attitude_node/pause', [None])[0] == (
        'std_srvs/srv/SetBool' if mode == 'lockstep' else None)
