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

import threading
import time

from conftest import at_night, SECOND
from live import check_late, decoded, PATIENT, Session, spin_until, stamps_of, TUMBLER, tumbler
from live_session import ATTITUDE, RELIABLE
import numpy as np
import pytest
import rclpy
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.parameter import Parameter
from rigid_body_ros import scene
from rigid_body_ros.node import AttitudeNode
from rigid_body_ros.node.process import executor_of

pytestmark = pytest.mark.ros
EXECUTORS = {'single': SingleThreadedExecutor, 'multi': MultiThreadedExecutor,
             'events': lambda context: executor_of(context)}
#: The executor; `beside` adds another node that blocks it for 50 ms at a time.
COMPOSITIONS = ['multi', 'single beside', 'events beside', *at_night('single', 'multi beside')]
BODY = [Parameter(f'inertia.{name}', value=value)
        for name, value in (('ixx', 0.02), ('iyy', 0.03), ('izz', 0.04))]


class Composed(Session):
    """A session whose node runs in a thread, in a given executor, perhaps with one that blocks."""

    def __init__(self, composition, *arguments):
        super().__init__(TUMBLER, *arguments)
        self._name, *self._beside = composition.split()
        self._is_done = threading.Event()

    def _create(self):
        self._executor = SingleThreadedExecutor(context=self._context)
        self.tested = AttitudeNode(context=self._context)
        executor = EXECUTORS[self._name](context=self._context)
        executor.add_node(self.tested)
        if self._beside:
            self._sibling = rclpy.create_node('sibling', context=self._context,
                                              use_global_arguments=False)
            self._sibling.create_timer(0.06, lambda: time.sleep(0.05))
            executor.add_node(self._sibling)
        self._thread = threading.Thread(target=self._run, args=[executor])
        self._thread.start()

    def _run(self, executor):
        while not self._is_done.is_set():
            executor.spin_once(timeout_sec=0.1)
        executor.shutdown()

    def _destroy(self):
        self._is_done.set()
        self._thread.join()
        super()._destroy()


@pytest.mark.parametrize('composition', COMPOSITIONS)
def test_late_and_shuffled_torques_replay_bit_for_bit_in_every_executor(
        tmp_path, domain, composition):
    with Composed(composition, domain, *RELIABLE, *PATIENT,
                  '-p', 'qos_overrides./torque.subscription.depth:=100000') as live:
        check_late(tmp_path, live, 600, rate=1000)


@pytest.mark.parametrize('composition', COMPOSITIONS)
def test_every_torque_gets_its_response_in_every_executor(domain, composition):
    step_ns = SECOND // 50
    stamps = [SECOND + number * step_ns for number in range(10)]
    torques = [[0.01, 1e-3 * number, 0.0] for number in range(10)]
    with Composed(composition, domain, '-p', 'mode:=lockstep', '-p', 'step:=0.02') as live:
        for stamp_ns, torque in zip(stamps, torques):
            live.publish(stamp_ns, '', torque)
            live.wait_until(lambda due_ns=stamp_ns + step_ns: stamps_of(
                live, ATTITUDE)[-1:] == [due_ns], 'a response')
    after = [stamp_ns + step_ns for stamp_ns in stamps]
    published = {message.stamp_ns: message.values for message in decoded(live, ATTITUDE)}
    np.testing.assert_array_equal([published[stamp_ns] for stamp_ns in after],
                                  tumbler(stamps, torques).propagate(at=after).attitude)


@pytest.mark.parametrize(('arguments', 'message'), [
    ({'node_name': 'left body'}, 'Invalid node name: node name must not contain characters other '
                                 "than alphanumerics or '_': 'left body'"),
    ({'namespace': '1st'}, 'Invalid namespace: namespace must not'),
    ({'parameter_overrides': [*BODY, Parameter('mode')]}, 'mode: expected text, found none')])
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
