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

"""
A live run over DDS: a node process, a publisher of torques, and a recorder of the outputs.

No packet leaves the machine, and the run does not disturb other ROS domains.
"""

from __future__ import annotations

from contextlib import suppress
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped, WrenchStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import GetParameters, ListParameters
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from rigid_body_ros import messages, recording
from rigid_body_ros.runtime import interrupts
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger
import yaml

NODE = 'attitude_node'
ACCEPTED, COMMITTED, ATTITUDE = f'/{NODE}/accepted_torque', f'/{NODE}/committed', '/attitude'
_KINDS = {ACCEPTED: messages.WRENCH, COMMITTED: messages.ODOMETRY, ATTITUDE: messages.QUATERNION}
DIAGNOSTICS = '/diagnostics'
#: Arguments that let the node lose no torque on a busy machine; its default is best effort.
RELIABLE = ('-p', 'qos_overrides./torque.subscription.reliability:=reliable')
#: Environment variables that keep packets on the machine, for Humble and for later releases.
_LOCAL = {'ROS_LOCALHOST_ONLY': '1'} if os.environ.get('ROS_DISTRO') == 'humble' else \
    {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
_PROGRAM = (sys.executable, '-c',
            'import sys; from rigid_body_ros.commands import main; sys.exit(main.attitude_node())')
#: Long, because a busy machine takes long to start a process.
_PATIENCE_S = 60.0
#: s; a service that does not respond for so long is called again.
_RETRY_S = 15.0


class LiveSession:
    """
    Run `attitude_node` with a scene; on entry, the context waits until everything is connected.

    Parameters
    ----------
    scene : path
        Parameter file for the node.
    domain : int
        ROS_DOMAIN_ID.
    arguments : str
        Further arguments of the node, such as '-p', 'use_sim_time:=true'.

    Attributes
    ----------
    received : dict
        Serialized messages (CDR) by topic, in order of arrival.
    kinds : dict
        The kind of message of each of these topics.
    diagnostics : list
        DiagnosticArray messages, in order of arrival.
    process : Popen
        The process of the node.
    command, environment : list of str, dict
        Command line and environment of the node.
    node : rclpy.node.Node
        The recorder, for further subscriptions and publishers.

    """

    #: The name of the node, and the topic on which `publish` publishes.
    name, topic = NODE, 'torque'
    #: s; how long `wait_until` receives messages before it checks the condition again.
    pause = 0.02

    def __init__(self, scene, domain, *arguments):
        self._domain = domain
        self.environment = os.environ | _LOCAL | {'ROS_DOMAIN_ID': str(domain)}
        self.command = [*_PROGRAM, '--ros-args', '--params-file', str(scene), *arguments]
        # With these arguments, the node publishes nothing before the first /clock or torque.
        self._waits = {'use_sim_time:=true', 'mode:=lockstep'} & {*arguments}
        self.kinds = dict(_KINDS)
        self.received = {topic: [] for topic in _KINDS}
        self.diagnostics = []

    def __enter__(self):
        os.environ.update(_LOCAL)
        self._context = rclpy.Context()
        # A pipe that is not read blocks the node after 64 KiB.
        self._stderr = tempfile.TemporaryFile()
        self._start()
        self._executor.add_node(self.node)
        try:
            self._connect()
            if self._waits:  # outputs that are published only once must not be lost
                self.synchronize()
        except BaseException as error:  # leftovers would disturb the next session
            self.__exit__(type(error), error, None)
            raise
        return self

    def _start(self):
        """Start the node, and create the recorder and its executor."""
        self.process = subprocess.Popen(self.command, env=self.environment, stderr=self._stderr)
        rclpy.init(context=self._context, domain_id=self._domain)
        self.node = rclpy.create_node('live_session', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)

    def _connect(self):
        self._torque = self.node.create_publisher(WrenchStamped, self.topic, 100_000)
        if 'use_sim_time:=true' in self._waits:
            self._clock = self.node.create_publisher(Clock, '/clock', 10)
        everything = QoSProfile(depth=100_000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for topic, kind, qos in ((ACCEPTED, WrenchStamped, everything),
                                 (COMMITTED, Odometry, everything),
                                 (ATTITUDE, QuaternionStamped, 1000)):
            self.node.create_subscription(kind, topic, self.received[topic].append, qos, raw=True)
        self.node.create_subscription(DiagnosticArray, DIAGNOSTICS, self.diagnostics.append, 100)
        self._initial_state = self.node.create_publisher(Odometry, 'initial_state', 10)
        self.wait_until(lambda: self._torque.get_subscription_count()
                        and self._initial_state.get_subscription_count(), 'the node to subscribe')
        if not self._waits:
            self.wait_until(lambda: self.received[COMMITTED], 'the start state')
            self.wait_until(lambda: self.received[ATTITUDE], 'the first attitude')

    def __exit__(self, kind, error, trace):
        self._end(kind)
        self._stderr.close()
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    def _end(self, kind):
        """End the node; `kind` is the type of the exception that ends the session, or None."""
        if kind is KeyboardInterrupt:  # Fast DDS may crash if a process is killed as it ends
            self.process.send_signal(signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(timeout=5.0)
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()

    def _has_failed(self):
        return self.process.poll() not in (None, 0)

    def publish(self, time_ns, frame_id, torque):
        """Publish a torque, N m, with the stamp time_ns."""
        self._torque.publish(messages.wrench(time_ns, frame_id, torque))

    def publish_bytes(self, data):
        """Publish a serialized WrenchStamped (CDR)."""
        self._torque.publish(data)

    def listen(self, topic, callback):
        """Pass every serialized WrenchStamped of a topic to a callback."""
        self.node.create_subscription(WrenchStamped, topic, callback, 1000, raw=True)

    def set_state(self, state):
        """Publish an initial state."""
        self._initial_state.publish(messages.odometry(state, '', ''))

    def reset(self):
        """Call the service ~/reset and return its response."""
        return self.call(Trigger, 'reset')

    def status(self, name):
        """Return the latest DiagnosticStatus with this name."""
        self.wait_until(lambda: self.diagnostics, 'diagnostics')
        return next(status for array in reversed(self.diagnostics) for status in array.status
                    if status.name == f'/{self.name}: {name}')

    def diagnosis(self, name):
        """Return the values, level and message of the latest status with this name."""
        status = self.status(name)
        values = {pair.key: int(pair.value) for pair in status.values if pair.value.isdigit()}
        return values, int.from_bytes(status.level, 'little'), status.message

    @property
    def torques(self):
        """Return the serialized torques that the node accepted in all epochs."""
        return [data for data in self.received[ACCEPTED]
                if not messages.is_epoch_marker(messages.WRENCH.decode(data).frame_id)]

    @property
    def torque_subscriptions(self):
        """Return the number of subscriptions to the torques."""
        return self._torque.get_subscription_count()

    def disconnect(self):
        """Destroy the publisher of torques, and wait until the node knows that it is gone."""
        self.node.destroy_publisher(self._torque)
        self.synchronize()

    def set_clock(self, time_ns):
        """Publish simulated time."""
        self._clock.publish(Clock(clock=Time(nanoseconds=time_ns).to_msg()))

    def now_ns(self):
        """Return the wall time, ns."""
        return self.node.get_clock().now().nanoseconds

    def spin(self, seconds):
        """Receive messages for some seconds."""
        until = time.monotonic() + seconds
        while (rest := until - time.monotonic()) > 0.0:
            interrupts.check()
            self._executor.spin_once(timeout_sec=rest)

    def wait_until(self, condition, what):
        """Receive messages until a condition holds."""
        until = time.monotonic() + _PATIENCE_S
        while not condition():
            if self._has_failed() or time.monotonic() > until:
                raise RuntimeError(f'expected {what}, which did not happen; log of the node:\n'
                                   f'{self.words()}')
            self.spin(self.pause)

    def wait_for_torques(self, count):
        """Receive messages until the node has applied or rejected this many torques."""
        def are_done():
            values, *_ = self.diagnosis('torques')
            return count == values['applied'] + sum(
                number for name, number in values.items() if name.startswith('rejected'))
        self.wait_until(are_done, f'{count} torques')

    def call(self, kind, name, **fields):
        """Call a private service of the node and return its response."""
        client = self.node.create_client(kind, f'/{NODE}/{name}')
        try:
            self.wait_until(client.service_is_ready, f'the service {name}')
            began, futures = time.monotonic(), []

            def is_answered():
                # A response is lost if the node has not found the client after 0.1 s; ask again.
                if time.monotonic() >= began + _RETRY_S * len(futures):
                    futures.append(client.call_async(kind.Request(**fields)))
                return any(future.done() for future in futures)
            self.wait_until(is_answered, 'a response')
            return next(future.result() for future in futures if future.done())
        finally:
            self.node.destroy_client(client)

    def synchronize(self):
        """Wait until the node knows which publishers and subscriptions this session has."""
        # The middleware announces endpoints, and their end, in order. The node therefore answers
        # a new client only after it has learned of everything before.
        self.call(ListParameters, 'list_parameters')

    def parameters(self, *names):
        """Return the values of parameters of the node."""
        values = self.call(GetParameters, 'get_parameters', names=names).values
        return [*map(parameter_value_to_python, values)]

    def dump_parameters(self, path):
        """Write the parameters of the node into a parameter file."""
        names = self.call(ListParameters, 'list_parameters').result.names
        parameters = dict(zip(names, self.parameters(*names)))
        Path(path).write_text(yaml.dump({f'/{NODE}': {'ros__parameters': parameters}}))

    def stop(self, number=signal.SIGINT):
        """Stop the node with a signal, receive its last messages, return its exit status."""
        self.process.send_signal(number)
        self.wait_until(lambda: self.process.poll() is not None, 'the node to end')
        self._receive_all(0.3)
        return self.process.returncode

    def _receive_all(self, seconds):
        """Receive messages until none arrives for some seconds."""
        count = -1
        while count != (count := sum(map(len, self.received.values()))):
            self.spin(seconds)

    def end(self):
        """Stop the node with SIGINT, receive its last messages, return its log."""
        self.stop()
        return self.words()

    def words(self):
        """Return the stderr output of the node so far."""
        # The node shares the position in this file, and pread does not move the position.
        descriptor = self._stderr.fileno()
        return os.pread(descriptor, os.fstat(descriptor).st_size, 0).decode()

    def write(self, path):
        """Write the received messages to a recording."""
        with recording.Writer(path) as writer:
            for topic, kind in self.kinds.items():
                writer.add_topic(topic, kind)
                for data in self.received[topic]:
                    writer.write(topic, kind.decode(data).stamp_ns, data)
