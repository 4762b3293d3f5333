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

"""Read the torques of a recording, and the initial state of the motion under them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import recording
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.replay.epochs import chosen
from rigid_body_ros.replay.sources import absolute, read_sources, Sources, Topics
from rigid_body_ros.runtime.terminal import progress
from rigid_body_ros.scene import Scene


def torques(path: str | Path, scene: Scene, topics: Topics, interpolation: str | None = None
            ) -> tuple[Sequence[TorqueLog], TorqueLog | None, NDArray[np.int64], State]:
    """
    Return the torques on body and rotors, the stamps of all, and the initial state.

    Of several epochs of a node, those of the last one that begins at the start_time of the scene.

    Raises
    ------
    InputError
        The recording cannot be read or does not fit the scene, or no epoch begins there.

    """
    epochs = read_epochs(path, scene, topics, interpolation)
    sources = epochs[chosen(path, scene, [one.start for one in epochs])]
    return sources.logs, sources.wheels, sources.times_ns, sources.start


def read_epochs(path: str | Path, scene: Scene, topics: Topics, interpolation: str | None = None
                ) -> list[Sources]:
    """
    Return the torques of each epoch of a node; other recordings have one.

    Raises
    ------
    InputError
        The recording cannot be read or does not fit the scene.

    """
    if not topics.is_plain(scene):
        return _read_all(path, scene, topics, interpolation)
    return [Sources((log,), None, False, start, len(recorded),
                    int(np.sum(np.diff(recorded.stamps_ns) <= 0)), recorded.start is not None,
                    recorded.damage)
            for recorded, log, start in _read_plain(path, scene, next(iter(topics.torques), None),
                                                    interpolation)]


def read(path: str | Path, scene: Scene, topic: str | None = None,
         interpolation: str | None = None) -> tuple[recording.Messages, TorqueLog, State]:
    """
    Return the torques of a recording, their log, and the initial state of the motion.

    Of several epochs of a node, those of the last one that begins at the start_time of the scene.

    Raises
    ------
    InputError
        The recording cannot be read or does not fit the scene, or no epoch begins there.

    """
    epochs = _read_plain(path, scene, topic, interpolation)
    return epochs[chosen(path, scene, [start for _, _, start in epochs])]


def _read_plain(path: str | Path, scene: Scene, topic: str | None, interpolation: str | None
                ) -> list[tuple[recording.Messages, TorqueLog, State]]:
    """Return the torques of a single topic in each epoch, their log, and the initial state."""
    recorded = recording.read(path, topic, track=progress('reading', size=len),
                              preferred=absolute(scene.torque_topics[0]))
    found = []
    for part in recording.epochs(path, recorded):
        log = recording.torque_log(path, part, scene.body_frame, scene.space_frame,
                                   interpolation or scene.interpolation, scene.links)
        found.append((part, log, part.start or replace(
            scene.start, time_ns=scene.start.time_ns or int(log.times_ns[0]))))
    return found


def _read_all(path: str | Path, scene: Scene, topics: Topics,
              interpolation: str | None = None) -> list[Sources]:
    """Return the torques of a scene that is not plain, with the errors of `read`."""
    return read_sources(path, scene, topics.found_in(path, scene),
                        interpolation or scene.interpolation,
                        progress('reading', size=len))
