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

"""Helpers for the tests of the node."""

from dataclasses import replace
import os
import time
from typing import NamedTuple

from conftest import CONFIG, SECOND
from live_session import ACCEPTED, COMMITTED, LiveSession
import numpy as np
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rigid_body_ros import messages, Problem, read, recording, scene, TorqueLog
from rigid_body_ros.node import AttitudeNode
from rigid_body_ros.node.open_loop import message_type
from rigid_body_ros.node.process import executor_of
from rigid_body_ros.replay.verify import Verified, verify

TUMBLER = CONFIG / 'tumbler.yaml'
#: The log of the torques on the default topic.
LOG = recording.Topics((ACCEPTED,))
#: s; how long to wait for anything.
PATIENCE = 300.0
#: The profile for logs of the node: all messages, from its start on.
EVERYTHING = QoSProfile(depth=100_000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def options(text):
    """Return the arguments of a node for parameters, separated by spaces."""
    return [word for one in text.split() for word in ('-p', one)]


#: Parameters to accept every torque, however long the machine delays a process.
PATIENT = options('history:=60.0 max_future:=59.9')


class Session(LiveSession):
    """
    A session whose node runs in this process, in one executor with the recorder.

    It starts in 0.1 s instead of seconds. What depends on the process, such as signals and exit
    statuses, needs a `LiveSession`.

    Attributes
    ----------
    kind, executor : callable
        Called with a context to create the node, and the executor.
    tested : rclpy.node.Node
        The node.

    """

    kind = AttitudeNode
    executor = staticmethod(executor_of)
    pause = 0.005

    def _start(self):
        rclpy.init(args=self.command[self.command.index('--ros-args'):], context=self._context,
                   domain_id=self._domain)
        self.node = rclpy.create_node('live_session', context=self._context,
                                      use_global_arguments=False)
        self._stderr_before = os.dup(2)
        os.dup2(self._stderr.fileno(), 2)  # the log of the node
        try:
            self._create()
        except BaseException:
            self.tested = None
            super().__exit__(None, None, None)
            raise

    def _create(self):
        self._executor = self.executor(self._context)
        self.tested = self.kind(context=self._context)
        self._executor.add_node(self.tested)

    def _end(self, kind):
        self._destroy()
        os.dup2(self._stderr_before, 2)
        os.close(self._stderr_before)

    def _has_failed(self):
        return False

    def _destroy(self):
        if self.tested:
            self.tested.destroy_node()
            # An EventsExecutor would still call the timers of the node that have expired.
            self._executor.shutdown()
            self._executor = SingleThreadedExecutor(context=self._context)
            self._executor.add_node(self.node)
        self.tested = None

    def record(self, topic, kind, qos=EVERYTHING):
        """Record another topic, which `write` writes as well."""
        self.kinds[topic], self.received[topic] = kind, []
        self.node.create_subscription(message_type(topic, kind.name), topic,
                                      self.received[topic].append, qos, raw=True)

    def hold_clock(self, now_ns, condition, what):
        """Publish a simulated time until a condition holds."""
        def holds():
            self.set_clock(now_ns)
            return condition()
        self.wait_until(holds, what)

    def start_clock(self, now_ns):
        """Publish a time until the node begins its first epoch; before, it rejects torques."""
        self.hold_clock(now_ns, lambda: self.received[COMMITTED], 'the first epoch')

    def run_clock(self, begin_ns, end_ns, torque=None):
        """Advance simulated time in ticks of 10 ms, with a torque every tenth of a second."""
        for now_ns in range(begin_ns, end_ns + 1, SECOND // 100):
            self.set_clock(now_ns)
            self.spin(0.003)
            if torque and now_ns % (SECOND // 10) == 0:
                self.publish(now_ns, 'base_link', torque(now_ns))

    def set_parameter(self, name, value):
        """Set a parameter and return the result."""
        message = Parameter(name, value=value).to_parameter_msg()
        result, = self.call(SetParameters, 'set_parameters', parameters=[message]).results
        return result

    def restart(self):
        """Destroy the node, and create another."""
        self._destroy()
        self._executor.shutdown()
        self._create()
        self._executor.add_node(self.node)

    def stop(self):
        """Destroy the node, receive its last messages, return 0."""
        self._destroy()
        self._receive_all(0.02)
        return 0


def decoded(live, topic, kind=None):
    """Return the decoded messages of a topic, without the markers that begin epochs."""
    found = [(kind or live.kinds[topic]).decode(data) for data in live.received[topic]]
    return [message for message in found if not messages.is_epoch_marker(message.frame_id)]


def stamps_of(live, topic):
    """Return the stamps of the messages of a topic, without the markers that begin epochs."""
    return [message.stamp_ns for message in decoded(live, topic)]


def late(random, start_ns, count, rate):
    """Generate times to publish at, and stamps; half are late by up to half a second."""
    for number in range(count):
        stamp_ns = start_ns + number * SECOND // rate + int(random.integers(0, SECOND // 500))
        yield stamp_ns + int(random.integers(0, SECOND // 2)) * int(random.integers(2)), stamp_ns


def late_torques(start_ns, count, rate):
    """Return when to publish torques, their stamps, frames and values."""
    random = np.random.default_rng(17)
    return [(*times_ns, ('', 'base_link', 'world')[random.integers(3)],
             random.normal(size=3) * 0.02 * (random.random() > 0.3))
            for times_ns in late(random, start_ns, count, rate)]


def play(live, rows, publish):
    """Publish each row without its first number, which is when to do so, ns."""
    for due_ns, *row in sorted(rows, key=lambda row: row[0]):
        live.spin((due_ns - live.now_ns()) * 1e-9)
        publish(*row)


class Run(NamedTuple):
    """The last epoch of a session: its committed states (attitude and rates) and their replay."""

    stamps_ns: np.ndarray
    committed: np.ndarray
    replay: np.ndarray
    #: All accepted torques of all epochs, on the first topic.
    accepted: recording.Messages
    #: The parameters that the node reported, the problem of the epoch, and how all epochs agree.
    scene: scene.Scene
    problem: Problem
    verified: Verified


def replayed(tmp_path, live, topics=LOG, given=None):
    """
    Replay the torques that a session accepted, with the parameters in live.yaml.

    Check that each epoch has the bits of its states, with the parameters in the file `given`, if
    they were others at its start.
    """
    path, run = tmp_path / 'live.mcap', scene.load(tmp_path / 'live.yaml')
    live.write(path)
    result = verify(path, scene.load(given) if given else run, path, topics,
                    motion_topic=COMMITTED)
    assert result.same.all()
    assert result.epochs == result.compared_epochs
    problem = read(path, run, topic=topics.torques, wheel_torque=topics.wheel_torque,
                   wheel_command=topics.wheel_command, inertia=topics.inertia)
    committed = recording.read(path, COMMITTED, messages.ODOMETRY)
    # If several states have the start time, the last is the start of the last epoch.
    begin = int(np.flatnonzero(committed.stamps_ns == problem.start.time_ns)[-1])
    stamps_ns, values = committed.stamps_ns[begin:], live_values(committed)[begin:]
    motion = problem.propagate(at=stamps_ns)
    accepted = recording.read(path, ACCEPTED)
    is_torque = ~np.array([*map(messages.is_epoch_marker, accepted.frame_ids)])
    return Run(stamps_ns, values, np.hstack([motion.attitude, motion.angular_velocity]),
               accepted.rows(is_torque), run, problem, result)


def finished(tmp_path, live, topics=LOG, given=None):
    """End a session, and return its run, whose replay has the bits of the committed states."""
    live.dump_parameters(tmp_path / 'live.yaml')
    assert live.stop() == 0
    return same_bits(tmp_path, live, topics, given)


def same_bits(tmp_path, live, topics=LOG, given=None):
    """Return the run of a session that has ended; its replay has the bits of its states."""
    run = replayed(tmp_path, live, topics, given)
    np.testing.assert_array_equal(run.committed, run.replay)
    return run


def tumbler(stamps_ns, torques, start_ns=None):
    """Return the problem of the tumbler under torques; by default it starts at the first."""
    run = scene.load(TUMBLER)
    start = replace(run.start, time_ns=stamps_ns[0] if start_ns is None else start_ns)
    return run.problem(start).replaced(log=TorqueLog(stamps_ns, torques))


def live_values(committed):
    """Return attitude and body rates of Odometry messages, shape (n, 7)."""
    return np.hstack([committed.values[:, messages.ORIENTATION],
                      committed.values[:, messages.ANGULAR_VELOCITY]])


def commit(live, count):
    """Make `count` states of a PATIENT node final by publishing a torque far ahead."""
    live.spin(0.25)  # longer than the `history` that this torque leaves
    live.publish(live.now_ns() + 598 * SECOND // 10, '', [0.0, 0.0, 0.0])
    live.wait_until(lambda: len(live.received[COMMITTED]) == count, 'all states')


def check_late(tmp_path, live, count, rate):
    """Send torques late and out of order; check that their replay has the bits of the states."""
    torques = late_torques(live.now_ns(), count, rate)
    play(live, torques, live.publish)
    live.wait_until(lambda: len(live.torques) == count, 'all torques')
    stamps_ns = [stamp_ns for _, stamp_ns, *_ in torques]
    stamps = np.unique(stamps_ns)
    commit(live, 1 + len(stamps))
    run = finished(tmp_path, live)
    *accepted, _ = run.accepted.stamps_ns
    assert sorted(accepted) == sorted(stamps_ns)
    assert np.any(np.diff(accepted) < 0)  # they did come out of order
    np.testing.assert_array_equal(run.stamps_ns[1:1 + len(stamps)], stamps)
    # The start state comes first, at the time in the dumped parameters.
    assert run.stamps_ns[0] == scene.load(tmp_path / 'live.yaml').start.time_ns


def spin_until(executor, condition):
    """Execute callbacks of this process until a condition holds."""
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until
        executor.spin_once(timeout_sec=0.1)
