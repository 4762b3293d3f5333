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

import os
import time
from typing import NamedTuple

from conftest import CONFIG, SECOND
from live_session import ACCEPTED, COMMITTED, LiveSession
import numpy as np
from rcl_interfaces.srv import GetParameters, SetParameters
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rigid_body_ros import messages, recording, scene
from rigid_body_ros.node import AttitudeNode
from rigid_body_ros.node.process import executor_of
from rigid_body_ros.replay.verify import verify

TUMBLER = CONFIG / 'tumbler.yaml'
#: Parameters to accept every torque, however long the machine delays a process.
PATIENT = ('-p', 'history:=60.0', '-p', 'max_future:=59.9')
#: s; how long to wait for anything.
PATIENCE = 300.0


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


def decoded(live, topic, kind):
    """Return the decoded messages of a topic, without the markers that begin epochs."""
    found = [kind.decode(data) for data in live.received[topic]]
    return [message for message in found if not messages.is_epoch_marker(message.frame_id)]


class LateTorque(NamedTuple):
    """A torque, and the time at which to publish it, ns."""

    due_ns: int
    stamp_ns: int
    frame_id: str
    torque: np.ndarray


def late_torques(start_ns, count, rate):
    """Return torques in the order of publication; half of them are late by up to half a second."""
    random, torques = np.random.default_rng(17), []
    for number in range(count):
        stamp_ns = start_ns + number * SECOND // rate + int(random.integers(0, SECOND // 500))
        delay_ns = int(random.integers(0, SECOND // 2)) * int(random.integers(0, 2))
        torque = random.normal(size=3) * 0.02 * (random.random() > 0.3)
        frame_id = ('', 'base_link', 'world')[random.integers(3)]
        torques.append(LateTorque(stamp_ns + delay_ns, stamp_ns, frame_id, torque))
    return sorted(torques)


def publish_when_due(live, torques):
    for due_ns, *torque in torques:
        live.spin((due_ns - live.now_ns()) * 1e-9)
        live.publish(*torque)


class Run(NamedTuple):
    """The committed states (attitude and body rates) of the last epoch, and their replay."""

    stamps_ns: np.ndarray
    committed: np.ndarray
    replay: np.ndarray
    #: All accepted torques of all epochs.
    accepted: recording.Messages


def replayed(tmp_path, live):
    """Replay the torques that a session accepted, with the parameters in live.yaml."""
    live.write(tmp_path / 'live.mcap')
    path, run = tmp_path / 'live.mcap', scene.load(tmp_path / 'live.yaml')
    recorded = recording.read(path, ACCEPTED)
    is_torque = ~np.array([*map(messages.is_epoch_marker, recorded.frame_ids)])
    *_, last = recording.epochs(path, recorded)
    log = recording.torque_log(path, last, run.body_frame, run.space_frame)
    committed = recording.read(path, COMMITTED, messages.ODOMETRY)
    # --verify accepts every epoch.
    accepted = recording.Topics((ACCEPTED,))
    assert verify(path, run, path, accepted, motion_topic=COMMITTED).same.all()
    # If several states have the start time, the last is the start of the last epoch.
    begin = int(np.flatnonzero(committed.stamps_ns == run.start.time_ns)[-1])
    stamps_ns, values = committed.stamps_ns[begin:], live_values(committed)[begin:]
    motion = run.problem().replaced(log=log).propagate(at=stamps_ns)
    return Run(stamps_ns, values, np.hstack([motion.attitude, motion.angular_velocity]),
               recorded.rows(is_torque))


def finished(tmp_path, live):
    """End a session, and return its run, whose replay has the bits of the committed states."""
    live.dump_parameters(tmp_path / 'live.yaml')
    assert live.stop() == 0
    run = replayed(tmp_path, live)
    np.testing.assert_array_equal(run.committed, run.replay)
    return run


def live_values(committed):
    """Return attitude and body rates of Odometry messages, shape (n, 7)."""
    return np.hstack([committed.values[:, messages.ORIENTATION],
                      committed.values[:, messages.ANGULAR_VELOCITY]])


def commit(live, count):
    """Make `count` states of a PATIENT node final by publishing a torque far ahead."""
    live.spin(0.25)  # longer than the `history` that this torque leaves
    live.publish(live.now_ns() + 598 * SECOND // 10, '', [0.0, 0.0, 0.0])
    live.wait_until(lambda: len(live.received[COMMITTED]) == count, 'all states')


def check_late_torques(tmp_path, live, count, rate):
    """Send torques late and out of order; check that their replay has the bits of the states."""
    torques = late_torques(live.now_ns(), count, rate)
    publish_when_due(live, torques)
    live.wait_until(lambda: len(live.torques) == count, 'all torques')
    stamps = np.unique([torque.stamp_ns for torque in torques])
    commit(live, 1 + len(stamps))
    run = finished(tmp_path, live)
    *accepted, _ = run.accepted.stamps_ns
    assert sorted(accepted) == sorted(torque.stamp_ns for torque in torques)
    assert np.any(np.diff(accepted) < 0)  # they did come out of order
    np.testing.assert_array_equal(run.stamps_ns[1:1 + len(stamps)], stamps)
    # The start state comes first, at the time in the dumped parameters.
    assert run.stamps_ns[0] == scene.load(tmp_path / 'live.yaml').start.time_ns


def run_clock(live, start_ns, until=lambda: False, seconds=100):
    """Advance simulated time, or keep it at the start until a condition holds."""
    for tick in range(seconds * 100 + 1):
        live.set_clock(start_ns + (tick * SECOND // 100 if seconds < 100 else 0))
        live.spin(0.002)
        if until():
            return


def spin_until(executor, condition):
    """Execute callbacks of this process until a condition holds."""
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until
        executor.spin_once(timeout_sec=0.1)


def get_parameters(live, *names):
    return live.call(GetParameters, 'get_parameters', names=names).values


def set_parameter(live, name, value):
    """Set a parameter and return the result."""
    message = Parameter(name, value=value).to_parameter_msg()
    result, = live.call(SetParameters, 'set_parameters', parameters=[message]).results
    return result
