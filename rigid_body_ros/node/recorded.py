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

"""Provide the node that `attitude_regress` runs, which keeps its own log."""

from __future__ import annotations

from collections.abc import Collection
import json
from pathlib import Path
import time

from rclpy.logging import LoggingSeverity
from rclpy.parameter import Parameter
from rigid_body_ros import messages, recording
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.node.attitude_node import AttitudeNode
from rigid_body_ros.node.outputs import COMMITTED
from rigid_body_ros.node.process import executor_of, Observer
from rigid_body_ros.node.sources import BODY, sources_of
from rigid_body_ros.runtime.fingerprint import fingerprint, NAME
from rigid_body_ros.scene import Scene
from rigid_body_ros.scene.parameters import LOCKSTEP

#: If no further torque publisher appears for this many seconds, we assume that all publishers are
#: connected.
_QUIET = 3.0


class RecordedNode(Observer):
    """
    Run a scene in a node in lockstep, and keep the node's log.

    Use this class as a context manager. The node is in the ROS domain that the environment
    selects, and neither reads nor writes a checkpoint. If the scene has several torque topics, the
    node does not begin until the expected topics have publishers. If the node began earlier, it
    would not wait for the torques of a publisher that connects later.

    Parameters
    ----------
    scene : Scene
    logs : collection of str
        The topics to wait for, given by the names of their logs, such as 'accepted_torque'. If the
        collection is empty, the node waits until no more publishers appear, and begins with the
        topics that have a publisher by then.

    """

    def __init__(self, scene: Scene, logs: Collection[str] = ()) -> None:
        super().__init__([])
        self._scene = scene
        sources = sources_of(scene)
        #: The message type of each log, and the stamps, ns, and messages of the current epoch.
        self._types = {**{source.log: source.logged for source in sources},
                       COMMITTED: messages.ODOMETRY}
        self._epoch: dict[str, list[tuple[int, bytes]]] = {name: [] for name in self._types}
        self._elapsed_ns: dict[str, int] = {}
        #: The torque topics by the names of their logs.
        self._topics = {_base(source.log): self._observer.resolve_topic_name(source.topic)
                        for source in sources if source.number != BODY}
        self._awaited = {self._topics[name] for name in logs if name in self._topics}
        self._node: AttitudeNode | None = None
        if len(self._topics) == 1:
            self._begin()

    def _begin(self) -> None:
        values = {name: value for name, value in self._scene.values.items()
                  if value != self._scene.parameters[name].default}
        values.update(mode=LOCKSTEP, checkpoint='')
        self._node = AttitudeNode(
            context=self._context, on_log=self._keep, parameter_overrides=[
                Parameter(name, value=value) for name, value in values.items()])
        self._node.get_logger().set_level(LoggingSeverity.WARN)
        #: The full name of each log. We store it, because a destroyed node cannot resolve names.
        self._names = {name: self._node.resolve_topic_name(name) for name in self._types}
        self._executor = executor_of(self._context)
        self._executor.add_node(self._node)

    def __exit__(self, *error: object) -> None:
        self._end_node()
        super().__exit__(*error)

    @property
    def elapsed_ns(self) -> dict[str, int]:
        """Return the time in ns from the start to the newest torque of each torque log."""
        return dict(self._elapsed_ns)

    @property
    def unpublished(self) -> list[str]:
        """Return the torque topics that have no publisher."""
        return [topic for topic in self._topics.values()
                if not self._observer.count_publishers(topic)]

    @property
    def has_rival(self) -> bool:
        """Return whether another node publishes states on the same topic."""
        states = self._observer.resolve_topic_name('odometry')
        return self._observer.count_publishers(states) > (self._node is not None)

    def spin(self, seconds: float) -> None:
        """
        Run the node for a number of seconds.

        If the node has not begun yet, this method sleeps for that time instead, and then begins
        the node if the publishers are ready.
        """
        if not self._node:
            time.sleep(seconds)
            if self._is_connected():
                self._begin()
            return
        until = time.monotonic() + seconds
        while (rest := until - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=rest)

    def _is_connected(self) -> bool:
        """Return whether every topic on which the node expects torques has a publisher."""
        missing = self.unpublished
        if self._awaited:
            return not self._awaited.intersection(missing)
        are_lasting = self._are_lasting(missing, _QUIET)
        return len(missing) < len(self._topics) and (not missing or are_lasting)

    def _keep(self, name: str, data: bytes) -> None:
        log, key = self._epoch[name], _base(name)
        stamp_ns, frame_id, *_ = self._types[name].decode(data)
        if messages.is_epoch_marker(frame_id):
            log.clear()
            self._elapsed_ns.pop(key, None)
        elif key in self._topics:
            self._elapsed_ns[key] = max(self._elapsed_ns.get(key, 0), stamp_ns - log[0][0])
        log.append((stamp_ns, data))

    def finish(self) -> None:
        """
        Shut down the node so that it commits its last states.

        Raises
        ------
        InputError
            There is no committed state at the stamp of some torque.

        """
        self._end_node()
        if pending := self._pending():
            raise InputError(f'expected a committed state at each torque, found none at '
                             f'{len(pending)} of them, the first at {min(pending)} ns; choose a '
                             'shorter history in the scene')

    def _end_node(self) -> None:
        if self._node:
            self._executor.shutdown()
            self._node.destroy_node()

    def _pending(self) -> set[int]:
        """Return the stamps of torques in the current epoch at which no state is committed yet."""
        stamps = {name: {stamp_ns for stamp_ns, _ in log} for name, log in self._epoch.items()}
        final = stamps.pop(COMMITTED)
        return {stamp_ns for name in stamps if _base(name) in self._topics
                for stamp_ns in stamps[name] - final}

    def write(self, path: str | Path, last_ns: int) -> None:
        """
        Write the log of the current epoch to a recording at `path`.

        Messages stamped more than `last_ns` after the start of the epoch are left out.
        """
        start_ns = next(iter(self._epoch.values()))[0][0]
        with recording.Writer(path) as writer:
            writer.add_metadata(NAME, {'fingerprint': json.dumps(fingerprint()),
                                       'scene': json.dumps(dict(self._scene.values))})
            for name, log in self._epoch.items():
                topic = self._names[name]
                writer.add_topic(topic, self._types[name])
                first = 0
                if name == COMMITTED:  # no markers in this log: look for the last start state
                    stamps = [stamp_ns for stamp_ns, _ in log]
                    first = len(stamps) - 1 - stamps[::-1].index(start_ns)
                for stamp_ns, data in log[first:]:
                    if stamp_ns <= start_ns + last_ns:
                        writer.write(topic, stamp_ns, data)


def _base(name: str) -> str:
    return name.removeprefix('~/')
