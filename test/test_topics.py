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

"""The topics that docs/nodes.md lists match a running node."""

import time

from live import options, PATIENCE, Session, TUMBLER
import nodes
import pytest
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rigid_body_ros.live.events import CAUSES

pytestmark = pytest.mark.ros
NODE = 'attitude_node'
#: Topics that ROS itself adds to a node.
ROS = {'/parameter_events', '/rosout', '/clock'}
#: Parameters of a named wheel; the topics of such wheels, and of rotors.
SOURCES = ('torque_topics:=[torque,disturbance] inertia_topic:=true '
           'actuator.topics:=[torque] ')
NAMED = 'wheel_names:=[rw] rw.axis.x:=1.0 rw.inertia:=0.001'
OF_WHEELS = ('/wheel_command', '/wheel_states', f'/{NODE}/accepted_wheel_command')
OF_ROTORS = ('/wheel_torque', '/rotor_momentum', f'/{NODE}/accepted_wheel_torque')


def by_full_name(topics):
    return {f'/{topic.name}'.replace('/~', f'/{NODE}').replace('//', '/'): topic
            for topic in topics}


def found(live, count, names_and_types, infos):
    """Return the types and the profile of the node's topics, once there are `count` topics."""
    until = time.monotonic() + PATIENCE
    while True:
        live.spin(0.1)
        topics = {}
        if (NODE, '/') in live.node.get_node_names_and_namespaces():
            for name, types in names_and_types(NODE, '/'):
                profiles = [info.qos_profile for info in infos(name) if info.node_name == NODE]
                if name not in ROS and profiles:
                    topics[name] = types, profiles[0]
        if len(topics) >= count or time.monotonic() > until:
            return topics


def agrees(topic, profile):
    """Return whether the page describes a profile; DDS does not report the history."""
    words = topic.qos.partition(', keep')[0]
    reliable = profile.reliability == ReliabilityPolicy.RELIABLE
    kept = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return ('reliable' in words, 'transient local' in words) == (reliable, kept)


def test_the_page_lists_every_cause_of_rejection():
    assert list(nodes.CAUSES) == list(CAUSES)


@pytest.mark.parametrize(('mode', 'arguments'), [
    ('lockstep', ''), ('realtime', f'{SOURCES} wheels:=true'), ('realtime', SOURCES + NAMED)])
def test_every_topic_of_the_page_is_there_and_no_other(domain, mode, arguments):
    published, subscribed = by_full_name(nodes.PUBLISHED), by_full_name(nodes.SUBSCRIBED)
    if arguments:
        published |= by_full_name(nodes.OPTIONAL)
        subscribed |= by_full_name(nodes.SUBSCRIBED_IF_ENABLED)
        # A scene has either rotors or named wheels.
        for name in ('/tf', '/clock', '/robot_description', *(
                OF_ROTORS if NAMED in arguments else OF_WHEELS)):
            published.pop(name, None)
            subscribed.pop(name, None)
        subscribed['/disturbance'] = subscribed['/torque']
    with Session(TUMBLER, domain, *options(f'mode:={mode} {arguments}')) as live:
        node = live.node
        writers = found(live, len(published), node.get_publisher_names_and_types_by_node,
                        node.get_publishers_info_by_topic)
        readers = found(live, len(subscribed), node.get_subscriber_names_and_types_by_node,
                        node.get_subscriptions_info_by_topic)
        services = dict(node.get_service_names_and_types_by_node(NODE, '/'))
    for page, topics in ((published, writers), (subscribed, readers)):
        assert {name: types for name, (types, _) in topics.items()} \
            == {name: [topic.kind] for name, topic in page.items()}
    for name in [name for name in readers if name not in ('/initial_state', '/inertia')]:
        _, torque = readers.pop(name)  # these depend on the mode
        assert (torque.reliability == ReliabilityPolicy.RELIABLE) == (mode == 'lockstep')
    for page, topics in ((published, writers), (subscribed, readers)):
        assert [name for name, (_, profile) in topics.items()
                if not agrees(page[name], profile)] == []
    assert services[f'/{NODE}/reset'] == ['std_srvs/srv/Trigger']
    assert services.get(f'/{NODE}/pause') == (
        ['std_srvs/srv/SetBool'] if mode == 'lockstep' else None)
