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

"""Clock mode: the node is the source of simulated time, for controllers that run on a timer."""

import re

from conftest import at_night, SECOND
from geometry_msgs.msg import WrenchStamped
from live import finished, options, Session, stamps_of, TUMBLER
from live_session import ACCEPTED, ATTITUDE, COMMITTED, RELIABLE
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.time import Time
from rigid_body_ros import messages, scene
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

pytestmark = pytest.mark.ros
STEP_NS = SECOND // 200
CLOCK = (*RELIABLE, *options('mode:=clock step:=0.005 history:=60.0'))


class TimerController(Node):
    """Sends a torque every 20 ms of simulated time, with the stamp of that time."""

    def __init__(self, live):
        super().__init__('timer_controller', context=live._context, use_global_arguments=False,
                         parameter_overrides=[Parameter('use_sim_time', value=True)])
        self.sent = []
        self._publisher = self.create_publisher(WrenchStamped, 'torque', 1000)
        self._timer = self.create_timer(0.02, self._on_timer)
        live._executor.add_node(self)

    def _on_timer(self):
        if not self._publisher.get_subscription_count():
            return
        now_ns = self.get_clock().now().nanoseconds
        self.sent.append(now_ns)
        self._publisher.publish(messages.wrench(now_ns, '', [1e-3 * np.sin(0.1 * len(self.sent)),
                                                             2e-3, 1e-3]))


def pause(live, is_paused):
    return live.call(SetBool, 'pause', data=is_paused).message


def standing(live):
    """Return the time at which the paused clock stands, ns."""
    return int(pause(live, True).split()[-2])


@pytest.mark.parametrize('factor', [1.0, 0.0, *at_night(0.1, 10.0)])
def test_a_controller_on_a_timer_runs_and_its_log_replays_to_the_same_bits(tmp_path, domain,
                                                                           factor):
    # At a low rate, the outputs leave this process time for its timer on a busy machine.
    with Session(TUMBLER, domain, *CLOCK, *options(
            f'real_time_factor:={factor} publish_rate:=20.0 start_time:={100 * SECOND}')) as live:
        assert stamps_of(live, COMMITTED)[0] == 100 * SECOND
        controller = TimerController(live)
        live.wait_until(lambda: len(controller.sent) > 20, '20 torques')
        standing(live)  # from now on, the controller sends nothing
        live.wait_for_torques(len(controller.sent))
        run = finished(tmp_path, live)
        published, accepted = stamps_of(live, ATTITUDE), stamps_of(live, ACCEPTED)
        controller.destroy_node()
    # A torque acts at its stamp, and all stamps are those of the clock.
    assert accepted == controller.sent == run.accepted.stamps_ns.tolist()
    assert not np.any(np.array([*published, *accepted]) % STEP_NS)


def test_a_pause_stops_the_clock_and_a_step_advances_it(domain):
    with Session(TUMBLER, domain, *CLOCK) as live:
        ticks = []
        live.node.create_subscription(Clock, '/clock', lambda clock: ticks.append(
            Time.from_msg(clock.clock).nanoseconds), 1000)
        live.wait_until(lambda: ticks, 'the clock')
        response = live.call(Trigger, 'step')
        assert (response.success, response.message) == (False, 'the clock runs: pause it first')
        now_ns = standing(live)
        live.wait_until(lambda: ticks[-1] == now_ns, 'the last tick')
        for number in range(1, 4):
            response = live.call(Trigger, 'step')
            assert response.message == f'the clock stands at {now_ns + number * STEP_NS} ns'
        live.wait_until(lambda: ticks[-1] == now_ns + 3 * STEP_NS, 'the steps')
        assert stamps_of(live, ATTITUDE)[-3:] == ticks[-3:]
        assert not np.any(np.diff(ticks) - STEP_NS)
        second = live.node.create_publisher(Clock, '/clock', 10)
        for text in (f'paused: the clock stands at {ticks[-1]} ns',
                     '/clock: another node publishes it, too'):
            live.wait_until(lambda text=text: text in live.diagnosis('torques')[2], 'a warning')
        live.node.destroy_publisher(second)
        assert pause(live, False) == 'resumed'
        live.wait_until(lambda: ticks[-1] > now_ns + 10 * STEP_NS, 'the clock to go on')
        live.wait_until(lambda: not re.search('paused|/clock', live.diagnosis('torques')[2]),
                        'the end of both')


def test_outputs_keep_their_rate_though_steps_do_not_divide_it(domain):
    with Session(TUMBLER, domain, *CLOCK, *options(
            'step:=0.003 real_time_factor:=0.1 start_time:=1')) as live:
        live.wait_until(lambda: len(live.received[ATTITUDE]) > 30, 'states')
        assert 'the clock is' not in live.words()
    # The first ones may be lost before the connection is complete.
    periods = np.diff(stamps_of(live, ATTITUDE)[3:])
    assert {*periods.tolist()} == {9_000_000, 12_000_000}
    assert abs(np.mean(periods) - 1e7) < 3e6 / (len(periods) + 4)


def simulation(live, name, **fields):
    """Call a service of simulation_interfaces, and return the code and the response."""
    from simulation_interfaces import srv
    kind = getattr(srv, ''.join(word.capitalize() for word in name.split('_')))
    response = live.call(kind, name, **fields)
    return response.result.result, response


def test_tools_drive_the_node_as_they_drive_other_simulators(domain):
    pytest.importorskip('simulation_interfaces', reason='simulation_interfaces is not installed; '
                        'CONTRIBUTING.md says how to build it')
    from simulation_interfaces.msg import Result, SimulationState
    with Session(TUMBLER, domain, *CLOCK) as live:
        def set_state(state):
            return simulation(live, 'set_simulation_state', state=SimulationState(state=state))
        assert simulation(live, 'step_simulation')[0] == Result.RESULT_INCORRECT_STATE
        assert set_state(SimulationState.STATE_PAUSED)[0] == Result.RESULT_OK
        code, response = set_state(SimulationState.STATE_PAUSED)
        assert code == response.ALREADY_IN_TARGET_STATE
        now_ns = standing(live)
        assert simulation(live, 'step_simulation', steps=7)[0] == Result.RESULT_OK
        code, found = simulation(live, 'get_entity_state', entity='base_link')
        assert (code, Time.from_msg(found.state.header.stamp).nanoseconds) == (
            Result.RESULT_OK, now_ns + 7 * STEP_NS)
        assert found.state.header.frame_id == 'world'
        loaded = scene.load(TUMBLER)
        motion = loaded.problem().propagate(at=[loaded.start.time_ns + now_ns + 6 * STEP_NS])
        q, rates = found.state.pose.orientation, found.state.twist.angular
        np.testing.assert_array_equal([q.x, q.y, q.z, q.w], motion.attitude[0])
        # Without torques, the angular momentum stays where it is, in the axes of the space frame.
        from rigid_body_ros.mechanics import so3
        np.testing.assert_allclose(so3.rotate(so3.conjugate(motion.attitude[0]), np.array(
            [rates.x, rates.y, rates.z])), motion.angular_velocity[0], rtol=1e-14)
        assert simulation(live, 'get_entity_state', entity='robot')[0] == Result.RESULT_NOT_FOUND
        assert simulation(live, 'reset_simulation', scope=1)[0] \
            == Result.RESULT_FEATURE_UNSUPPORTED
        assert simulation(live, 'reset_simulation', scope=2)[0] == Result.RESULT_OK
        assert standing(live) == now_ns + 7 * STEP_NS  # the scope is the state only
        assert simulation(live, 'reset_simulation')[0] == Result.RESULT_OK
        assert standing(live) == STEP_NS
        assert set_state(SimulationState.STATE_PLAYING)[0] == Result.RESULT_OK
        assert set_state(SimulationState.STATE_STOPPED)[0] == Result.RESULT_OK
        assert standing(live) == STEP_NS
        assert set_state(SimulationState.STATE_QUITTING)[0] == Result.RESULT_FEATURE_UNSUPPORTED
