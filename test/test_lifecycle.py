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

"""The managed node: every transition, and the resulting state."""

from conftest import SECOND
from lifecycle_msgs.msg import State as LifeState
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from live import decoded, late_torques, options, play, same_bits, Session, TUMBLER, tumbler
from live_session import ATTITUDE, COMMITTED, RELIABLE
import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from rigid_body_ros import messages
from rigid_body_ros.node.lifecycle import AttitudeLifecycleNode

pytestmark = pytest.mark.ros
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class ManagedSession(Session):
    """A session with a managed node."""

    kind = AttitudeLifecycleNode
    # An EventsExecutor warns if a subscription is destroyed with messages in its queue.
    executor = staticmethod(lambda context: SingleThreadedExecutor(context=context))


class Unconfigured(ManagedSession):
    """A session with a managed node that is not configured yet."""

    def _connect(self):
        self.record(ATTITUDE, messages.QUATERNION, 100)

    def listen(self):
        """Return the next attitude."""
        self.received[ATTITUDE].clear()
        self.wait_until(lambda: self.received[ATTITUDE], 'an attitude')
        return decoded(self, ATTITUDE)[0]

    def topics(self):
        """Return the topics that the node publishes, and those that it subscribes to."""
        own = '/parameter_events', '/rosout', '/attitude_node/transition_event'
        return ({publisher.topic_name for publisher in self.tested.publishers}.difference(own),
                {subscription.topic_name for subscription in (*self.tested.subscriptions,
                                                              *self.tested.polled)})


@pytest.fixture
def managed(domain):
    """Yield a session with a managed node that is not configured yet."""
    with Unconfigured(TUMBLER, domain) as live:
        yield live


def test_each_transition_creates_and_destroys_what_it_needs(managed):
    node = managed.tested
    assert managed.topics() == (set(), set())
    assert node.trigger_configure() == SUCCESS
    published, subscribed = managed.topics()
    assert {'/attitude', '/attitude_node/committed', '/diagnostics'} < published
    assert subscribed == set()
    for _ in range(3):
        timers, services = len([*node.timers]), len([*node.services])
        assert node.trigger_activate() == SUCCESS
        assert managed.topics() == (published, {'/torque', '/initial_state'})
        assert node.trigger_deactivate() == SUCCESS
        assert managed.topics() == (published, set())
        assert (len([*node.timers]), len([*node.services])) == (timers, services)
    assert node.trigger_cleanup() == SUCCESS
    assert managed.topics() == (set(), set())
    assert node.trigger_shutdown() == SUCCESS


def test_the_motion_continues_after_a_pause_and_begins_again_after_a_cleanup(managed):
    node = managed.tested
    node.trigger_configure()
    node.trigger_activate()
    managed.listen()
    start_ns = node.get_parameter('start_time').value
    node.trigger_deactivate()
    node.trigger_activate()
    found = managed.listen()
    expected = tumbler([start_ns], [[0.0, 0.0, 0.0]]).propagate(at=[found.stamp_ns])
    assert found.values.tolist() == expected.attitude[0].tolist()
    node.trigger_deactivate()
    node.trigger_cleanup()
    assert node.get_parameter('start_time').value is None  # was not given
    assert node.get_parameter('inertia.ixx').value == 0.045
    node.trigger_configure()
    node.trigger_activate()
    assert node.get_parameter('start_time').value > start_ns
    node.trigger_shutdown()


def test_parameters_may_change_until_they_are_configured(managed):
    node = managed.tested
    assert node.set_parameters([Parameter('damping.dxx', value=0.5)])[0].successful  # not given
    for value, outcome in ((-1.0, FAILURE), (0.03, SUCCESS)):
        assert node.set_parameters([Parameter('inertia.ixx', value=value)])[0].successful
        assert node.trigger_configure() == outcome
    assert not node.set_parameters([Parameter('inertia.ixx', value=0.04)])[0].successful
    assert node.get_parameter('inertia.ixx').value == 0.03
    assert node.get_parameter('damping.dxx').value == 0.5
    node.trigger_cleanup()
    assert node.set_parameters([Parameter('inertia.ixx', value=0.04)])[0].successful
    node.trigger_configure()
    assert node.get_parameter('inertia.ixx').value == 0.04
    node.trigger_shutdown()


def test_a_failed_transition_leaves_the_state_before_it(managed):
    node = managed.tested
    taken = Parameter('torque_topics', value=['initial_state'])
    assert node.set_parameters([taken])[0].successful
    assert node.trigger_configure() == SUCCESS
    before = managed.topics()
    assert node.trigger_activate() == FAILURE
    assert managed.topics() == before
    assert node.trigger_cleanup() == SUCCESS
    assert node.set_parameters([Parameter('torque_topics', value=['torque'])])[0].successful
    # The mode stays that of the first configuration.
    assert node.set_parameters([Parameter('mode', value='lockstep')])[0].successful
    assert node.trigger_configure() == FAILURE
    assert managed.topics() == (set(), set())
    assert node.set_parameters([Parameter('mode', value='realtime')])[0].successful
    assert node.trigger_configure() == SUCCESS
    assert node.trigger_activate() == SUCCESS
    managed.listen()


def test_a_managed_node_that_starts_itself_replays_bit_for_bit(tmp_path, domain):
    with ManagedSession(TUMBLER, domain, *RELIABLE, *options(
            'history:=60.0 autostart:=true')) as live:
        def change(transition, state):
            assert live.call(ChangeState, 'change_state',
                             transition=Transition(id=transition)).success
            assert live.tested._state_machine.current_state[0] == state
        for _ in range(2):
            count = len(live.torques)
            play(live, late_torques(live.now_ns() - SECOND // 2, 300, rate=1000), live.publish)
            live.wait_until(lambda count=count: len(live.torques) == count + 300, 'every torque')
            change(Transition.TRANSITION_DEACTIVATE, LifeState.PRIMARY_STATE_INACTIVE)
            live.wait_until(lambda: not live.torque_subscriptions, 'the end of a subscription')
            change(Transition.TRANSITION_ACTIVATE, LifeState.PRIMARY_STATE_ACTIVE)
            live.wait_until(lambda: live.torque_subscriptions, 'a subscription')
        live.dump_parameters(tmp_path / 'live.yaml')
        change(Transition.TRANSITION_DEACTIVATE, LifeState.PRIMARY_STATE_INACTIVE)
        change(Transition.TRANSITION_CLEANUP, LifeState.PRIMARY_STATE_UNCONFIGURED)
        live.wait_until(lambda: len(live.received[COMMITTED]) > 1, 'the end of the log')
        same_bits(tmp_path, live)
