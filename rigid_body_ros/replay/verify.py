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

"""Compute a recorded motion again and compare the two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages, recording, so3
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, shortened
from rigid_body_ros.propagation import propagate
from rigid_body_ros.recording import Source
from rigid_body_ros.replay.reading import torques
from rigid_body_ros.replay.sources import topics_of
from rigid_body_ros.runtime.fingerprint import fingerprint, NAME, PROCESSOR, processor
from rigid_body_ros.scene import Scene
from rigid_body_ros.state import State

#: Message types of the states of a node and the attitude of a replay.
_KINDS = (messages.ODOMETRY, messages.QUATERNION)
#: rad; largest difference between the first attitude of a node and the start of its scene.
_SAME_START = 1e-6


@dataclass(frozen=True, eq=False)
class Verified:
    """
    A recorded motion compared with the motion computed from its torques.

    Attributes
    ----------
    topic : str
    stamps_ns : array of int64, shape (n,)
    same : array of bool, shape (n,)
        Whether all bits of a state are equal.
    angles : array, shape (n,), rad
        Angles between the two attitudes.
    versions : dict
        By package, the version that made the recording and the one in use, if they differ.

    """

    topic: str
    stamps_ns: NDArray[np.int64]
    same: NDArray[np.bool_]
    angles: Floats
    versions: dict[str, tuple[str, str]]


def verify(path: str | Path, scene: Scene, motion_path: str | Path, *,
           topic: str | Sequence[str] | None = None, motion_topic: str | None = None,
           interpolation: str | None = None, wheel_torque: str | None = None,
           wheel_momentum: str | None = None) -> Verified:
    """
    Compute a recorded motion again and compare the two.

    Parameters
    ----------
    path : str or Path
        Recording of the torques, such as the accepted_torque of a node.
    scene : Scene
        Scene of the recorded motion; its start and its options affect every bit.
    motion_path : str or Path
        Recording of the motion: the committed states of a node, or the attitude of a replay.
    topic, wheel_torque, wheel_momentum
        As for `replay`.
    motion_topic : str, optional
        Required if the recording of the motion has several suitable topics.
    interpolation : str, optional
        Interpolation between samples; otherwise the scene's.

    Returns
    -------
    Verified

    Raises
    ------
    InputError
        A recording cannot be read, does not match the scene, or has no states after the start.

    """
    logs, wheels, torques_ns, start = torques(
        path, scene, topics_of(topic, wheel_torque, wheel_momentum), interpolation)
    with Source(motion_path, motion_topic, _KINDS) as source:
        recorded = recording.joined(source.topic, source.kind, list(source), source.damage)
        made_by = source.metadata(NAME)
    is_state = source.kind is messages.ODOMETRY
    begun = np.flatnonzero(recorded.stamps_ns == start.time_ns)
    # A node records the start of each epoch; only the last epoch is compared.
    first = int(begun[-1]) if is_state and begun.size else 0
    stamps, values = recorded.stamps_ns[first:], recorded.values[first:]
    try:
        _check_begins(start, torques_ns, stamps)
        if is_state:
            _check_complete(start, torques_ns, stamps, values[0, messages.ORIENTATION])
    except InputError as error:
        raise InputError(f'{motion_path}: {source.topic}: {error}') from error
    motion = propagate(scene.body, start, logs, at=stamps, wheels=wheels, **scene.options)
    attitude = values[:, messages.ORIENTATION] if is_state else values
    found, expected = attitude, motion.attitude
    if is_state:
        found = np.hstack([attitude, values[:, messages.ANGULAR_VELOCITY]])
        expected = np.hstack([motion.attitude, motion.angular_velocity])
    same = np.all(np.ascontiguousarray(found).view(np.int64) == expected.view(np.int64), axis=1)
    angles = so3.angle_between(attitude, motion.attitude)
    return Verified(source.topic, stamps, same, angles, _different_versions(made_by))


def _check_begins(start: State, torques_ns: NDArray[np.int64],
                  stamps_ns: NDArray[np.int64]) -> None:
    """Raise InputError if a recorded motion has no states or begins before its torques."""
    if not stamps_ns.size:
        raise InputError('expected states, found no messages')
    first_ns, torque_ns = int(stamps_ns.min()), int(torques_ns[0])
    if first_ns >= start.time_ns:
        return
    if start.time_ns == torque_ns:
        raise InputError(
            f'expected the first state at or after the first torque, {torque_ns} ns, found it at '
            f'{first_ns} ns: the beginning of the torque log or the start_time of the scene is '
            'missing')
    raise InputError('expected the first state at or after the start_time of the scene, '
                     f'{start.time_ns} ns, found it at {first_ns} ns')


def _check_complete(start: State, torques_ns: NDArray[np.int64], stamps_ns: NDArray[np.int64],
                    first: Floats) -> None:
    """
    Raise InputError if the committed states of a node, or their torques, are incomplete.

    A node commits the start of an epoch first, then the state at every torque that it accepted.
    """
    late = 'the recorder started late, or the scene or its start_time is not that of the run'
    if start.time_ns not in stamps_ns:
        raise InputError(f'expected the first state at the start of the motion, {start.time_ns} '
                         f'ns, found it at {stamps_ns.min()} ns: {late}')
    angle = float(so3.angle_between(first, start.attitude))
    if angle > _SAME_START:
        raise InputError(f'expected the initial attitude of the scene at {start.time_ns} ns, '
                         f'found an attitude {angle:.2g} rad away: {late}')
    missing = np.setdiff1d(stamps_ns, [start.time_ns, *torques_ns])
    if missing.size:
        where = 'the beginning' if missing[0] < torques_ns[0] else 'a part'
        raise InputError(
            f'expected a torque at the stamp of each state, found none for {missing.size} of '
            f'{stamps_ns.size} states, the first at {missing[0]} ns: {where} of the torque log is '
            'missing')


def summary(result: Verified) -> str:
    """Return how far the two motions agree, one line per fact."""
    count = len(result.same)
    rows = [('compared', f'{count} states of {result.topic}'),
            ('same bits', f'{np.count_nonzero(result.same)} of {count}'),
            ('difference', f'at most {result.angles.max():.2g} rad')]
    if not result.same.all():
        row = int(np.argmin(result.same))
        rows.append(('', f'first in state {row + 1}, at {result.stamps_ns[row]} ns: '
                         f'{result.angles[row]:.2g} rad'))
    rows += [('made by', f'{name} {there}, here {here}: the last bits may differ')
             for name, (there, here) in result.versions.items()]
    return '\n'.join(f'{name:14}{text}' for name, text in rows)


def _different_versions(made_by: dict[str, str]) -> dict[str, tuple[str, str]]:
    here = fingerprint()
    try:
        there = json.loads(made_by.get('fingerprint', '{}'))
    except (ValueError, RecursionError):
        there = None
    if not isinstance(there, dict):
        return {name: ('unknown', version) for name, version in here.items()}
    if PROCESSOR in there:
        here[PROCESSOR] = processor()
    return {name: (shortened(str(there[name]), 100), version) for name, version in here.items()
            if name in there and there[name] != version}
