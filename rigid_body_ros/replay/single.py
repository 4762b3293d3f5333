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
Replay of one recording: torques in, motion out.

The torques come piece by piece, and so does the motion: memory holds neither as a whole, unless
only the whole tells what the log is (where stamps go far back, or a node began its log anew).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
import json
from pathlib import Path
import sys
import time
from typing import Any

import numpy as np
from rigid_body_ros import messages, recording
from rigid_body_ros.body import State
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.messages import MessageType
from rigid_body_ros.propagation import Trajectory, warm_up
from rigid_body_ros.recording import Column, Messages, NotInOrderError, Piece, Source
from rigid_body_ros.replay import markers
from rigid_body_ros.replay.check import Check, drift, last_digits, LastDigits
from rigid_body_ros.replay.stretches import Asked, Stretch, Stretches
from rigid_body_ros.runtime import files, interrupts
from rigid_body_ros.runtime.fingerprint import fingerprint, NAME
from rigid_body_ros.scene import Scene
from rigid_body_ros.torque import TorqueLog
from tqdm import tqdm

ATTITUDE, EULER_ANGLES, ANGULAR_VELOCITY = '/attitude', '/euler_angles', '/angular_velocity'
_TOPICS = {ATTITUDE: messages.QUATERNION, EULER_ANGLES: messages.VECTOR3,
           ANGULAR_VELOCITY: messages.VECTOR3}
#: What can be written besides, by the names that are asked for.
IMU, TF, MARKERS, INPUT = 'imu', 'tf', 'markers', 'input'
_IMU_DATA, _TF = '/imu/data', '/tf'
_ALSO = {IMU: {_IMU_DATA: messages.IMU}, TF: {_TF: messages.TRANSFORM}, MARKERS: markers.TOPICS}


@dataclass(eq=False)
class Replay:
    """
    A replayed recording.

    Attributes
    ----------
    scene : Scene
    interpolation : str
    topic : str
        Where the torques came from.
    messages : int
        How many there were.
    unordered : int
        How many have no later stamp than the one before.
    logs : int
        How many logs they make, of which the last was replayed.
    first_ns, last_ns : int
        The stamps that it begins and ends with.
    damage : str
        What of the recording was lost, and where; '' if nothing.
    start, last : State
    solvers : dict
        By solver and reason, the time, ns, that it answered for.
    readings : dict
        By interpolation, how far away, rad, another reading between the samples would end; None
        where that spins the body beyond all bounds.
    check : Check, optional
        How far the motion, or the beginning of it that is checked, is from the conservation laws.
    last_digits : LastDigits, optional
        How far the motion, or the beginning of it, moves if the last digits of inertia, torques
        and start change; None where that was not estimated.
    seconds : dict
        The time that it took to read, propagate and write.
    log, trajectory : TorqueLog, Trajectory
        Where they were to be kept.

    """

    scene: Scene
    interpolation: str
    topic: str
    messages: int = 0
    unordered: int = 0
    logs: int = 1
    first_ns: int = 0
    last_ns: int = 0
    damage: str = ''
    start: State = field(default_factory=State)
    last: State = field(default_factory=State)
    solvers: dict[str, int] = field(default_factory=dict)
    readings: dict[str, float | None] = field(default_factory=dict)
    check: Check | None = None
    last_digits: LastDigits | None = None
    seconds: dict[str, float] = field(
        default_factory=lambda: {'read': 0.0, 'propagate': 0.0, 'write': 0.0})
    log: TorqueLog | None = None
    trajectory: Trajectory | None = None


def replay(path: str | Path, scene: Scene, output: str | Path | None = None, *,
           topic: str | None = None, interpolation: str | None = None, rate: float | None = None,
           until: float | None = None, start: float = 0.0, time_source: str = 'header',
           also: Collection[str] = (), keep: bool | None = None) -> Replay:
    """
    Turn the torques of a recording into motion.

    Parameters
    ----------
    path : str or Path
        A recording, see `recording.Source`.
    scene : Scene
        Where its start_time is 0, the motion starts at the stamp of the first torque.
    output : str or Path, optional
        Where to write attitude, Euler angles and angular velocity: an MCAP file, or, if the name
        does not end in .mcap, a new folder of rosbag2. It is neither the recording nor the file
        of the scene, under any name, nor inside the folder of a bag that is read.
    topic : str, optional
        May be left out where only one topic has torques.
    interpolation : str, optional
        Instead of the scene's.
    rate : float, optional, Hz
        Of the output; otherwise there is one at every torque stamp from the start on, and at
        `until`.
    until : float, optional, s
        End, counted from the start; otherwise the last stamp.
    start : float, s
        Leave out torques from before this long after the first.
    time_source : str
        Where stamps are taken from: 'header', 'log' or 'publish'.
    also : collection of str
        'imu' (/imu/data), 'tf' (/tf) and 'markers' (/marker/...), to be written besides, and
        'input', all messages of the recording, byte for byte.
    keep : bool, optional
        Whether to return log and trajectory, which takes memory; if there is no output.

    Raises
    ------
    InputError
        The recording cannot be read or does not fit the scene, or the output cannot be written.

    """
    for name in also:
        if name not in (*_ALSO, INPUT):
            raise InputError(f'also: expected some of {", ".join((*_ALSO, INPUT))}, '
                             f'found {name!r}')
    keep = output is None if keep is None else keep
    asked = Asked(path, scene, interpolation or scene.values['interpolation'], rate, until, also)
    with files.reading(path), files.protected('scene', scene.path):
        if output is not None:
            files.check((output, suffix_of(output)))
        for prepare in bar('kernels, compiled on first use')([warm_up], 1):
            prepare()
        with Source(path, topic, recording.TORQUES, time_source, start) as source:
            if INPUT in also:
                source.check_copied(_topics(also))
            if not keep:
                try:
                    return _replayed(asked, source, _pieces, output)
                except NotInOrderError:
                    pass  # then as a whole
            return _replayed(asked, source, _whole, output, keep)


def suffix_of(output: str | Path) -> str:
    """Return what a motion is written as: '.mcap', or `files.FOLDER` for a bag of rosbag2."""
    name = Path(output).name.lower()  # as rosbag2 has it
    return '.mcap' if name.endswith('.mcap') else files.FOLDER


def read(path: str | Path, scene: Scene, topic: str | None = None,
         interpolation: str | None = None) -> tuple[recording.Messages, TorqueLog, State]:
    """
    Return the torques of a recording, the log that they make, and the start of its motion.

    Raises
    ------
    InputError
        The recording cannot be read or does not fit the scene.

    """
    recorded = recording.read(path, topic, track=bar('reading', size=len))
    log = recording.torque_log(path, recorded, scene.values['body_frame'],
                               scene.values['space_frame'],
                               interpolation or scene.values['interpolation'])
    start = replace(scene.start, time_ns=scene.start.time_ns or int(log.times_ns[0]))
    return recorded, log, start


def bar(label: str, unit: str = ' stamps',
        size: Callable[[Any], int] = lambda item: 1) -> recording.Track:
    """Return what shows the progress through items of some size, where somebody watches."""
    def track(items: Iterable[Any], total: int) -> Iterator[Any]:
        # disable=None: no bar if standard error is not a terminal.
        with tqdm(None, label, total, unit=unit, unit_scale=True, leave=False,
                  disable=True if sys.stderr is None else None) as shown:
            for item in items:
                yield item
                shown.update(size(item))
                interrupts.heed()
    return track


def plot(path: str | Path, result: Replay, title: str) -> None:
    """
    Draw the motion, which must have been kept, and its torques into a PNG file.

    Raises
    ------
    InputError
        The file cannot be written.

    """
    from rigid_body_ros.report import figures  # matplotlib takes longer to load than most replays
    assert result.trajectory is not None
    assert result.log is not None
    sequence = result.scene.values['euler_sequence']
    with files.whole(path, '.png') as part:
        figures.motion(part, result.trajectory, result.log, sequence, title,
                     result.scene.timeout_ns)


def _pieces(asked: Asked, source: Source, result: Replay) -> Iterator[Piece]:
    """Return the log piece by piece."""
    def counted() -> Iterator[Messages]:
        last: list[int] = []
        for block in bar('replaying', size=len)(source, source.count):
            result.messages += len(block)
            result.unordered += int(np.sum(np.diff(block.stamps_ns, prepend=last) <= 0))
            last = [int(block.stamps_ns[-1])]
            yield block
    values = asked.scene.values
    return recording.torque_pieces(f'{asked.path}: {source.topic}', counted(),
                                   values['body_frame'], values['space_frame'])


def _whole(asked: Asked, source: Source, result: Replay) -> Iterator[Piece]:
    """Return the log as one piece."""
    recorded = recording.joined(source.topic, source.kind,
                                [*bar('reading', size=len)(source, source.count)], source.damage)
    values = asked.scene.values
    log = recording.torque_log(asked.path, recorded, values['body_frame'], values['space_frame'])
    result.messages, result.logs = len(recorded), len(recording.new_logs(recorded)) + 1
    if result.logs == 1:
        result.unordered = int(np.sum(np.diff(recorded.stamps_ns) <= 0))
    yield Piece(log.times_ns, log.torques, log.in_space)


def _replayed(asked: Asked, source: Source,
              pieces: Callable[[Asked, Source, Replay], Iterator[Piece]],
              output: str | Path | None, keep: bool = False) -> Replay:
    result = Replay(asked.scene, asked.interpolation, source.topic)
    began, kept = time.perf_counter(), []
    stretches = Stretches(asked, source.topic, pieces(asked, source, result))
    result.start = result.last = stretches.start
    result.first_ns = stretches.first_ns
    with ExitStack() as stack:
        writer = stack.enter_context(_writer(output)) if output is not None else None
        if writer:
            _announce(writer, asked)
        for stretch in stretches:
            interrupts.heed()
            _take(result, stretch)
            interrupts.heed()
            if writer:
                writing = time.perf_counter()
                _write(writer, asked, stretch.trajectory)
                result.seconds['write'] += time.perf_counter() - writing
            if keep:
                kept.append(stretch)
        if writer and INPUT in asked.also:
            source.copy_to(writer)
        interrupts.heed()  # for the last time before the output gets its name
    result.seconds['read'] = time.perf_counter() - began - result.seconds['propagate'] \
        - result.seconds['write']
    result.damage = source.damage
    result.readings = stretches.readings(result.last.attitude)
    if keep:
        result.log, result.trajectory = kept[0].log, _joined(kept)
    return result


def _take(result: Replay, stretch: Stretch) -> None:
    """Add a stretch to what is known of the whole."""
    began = time.perf_counter()
    log, trajectory = stretch.log, stretch.trajectory
    result.last_ns = int(log.times_ns[-1])
    if trajectory.times_ns.size:
        result.last = State(int(trajectory.times_ns[-1]), trajectory.attitude[-1],
                            trajectory.angular_velocity[-1])
        if not result.check:
            checked = result.scene, log, result.start, trajectory
            result.check, result.last_digits = drift(*checked), last_digits(*checked)
        total = float(result.last.time_ns - result.start.time_ns) * 1e-9
        result.check = result.check._replace(total=total)
        if result.last_digits:
            result.last_digits = result.last_digits._replace(total=total)
    for model in trajectory.models:
        name = f'{model.solver} ({model.reason})'
        result.solvers[name] = result.solvers.get(name, 0) + model.end_ns - model.start_ns
    result.seconds['propagate'] += stretch.seconds + time.perf_counter() - began


def _writer(output: str | Path) -> recording.Writer:
    kind = recording.FolderWriter if suffix_of(output) == files.FOLDER else recording.Writer
    return kind(output, keep_partial=True)


def _topics(also: Collection[str]) -> dict[str, MessageType]:
    topics = dict(_TOPICS)
    for name in also:
        topics.update(_ALSO.get(name, {}))  # the input brings its own
    return topics


def _announce(writer: recording.Writer, asked: Asked) -> None:
    """Say what comes, and how it was made."""
    for topic, kind in _topics(asked.also).items():
        writer.add_topic(topic, kind)
    writer.add_metadata(NAME, {
        'fingerprint': json.dumps(fingerprint()), 'scene': json.dumps(dict(asked.scene.values)),
        'interpolation': asked.interpolation,
        # A file name need not be text.
        'torques': Path(asked.path).name.encode(errors='replace').decode()})


def _write(writer: recording.Writer, asked: Asked, trajectory: Trajectory) -> None:
    values = asked.scene.values
    space, body = values['space_frame'], values['body_frame']
    attitude, rates = trajectory.attitude, trajectory.angular_velocity
    columns = [Column(ATTITUDE, space, attitude),
               Column(EULER_ANGLES, space, trajectory.euler_angles(values['euler_sequence'])),
               Column(ANGULAR_VELOCITY, body, rates)]
    if IMU in asked.also:
        columns.append(Column(_IMU_DATA, body, messages.imu_values(attitude, rates)))
    if TF in asked.also:
        columns.append(Column(_TF, space, messages.transform_values(attitude), body))
    if MARKERS in asked.also:
        columns += markers.columns(trajectory, space)
    writer.write_columns(trajectory.times_ns, columns)


def _joined(stretches: list[Stretch]) -> Trajectory:
    """Return the motion of stretches under one log as one; its `models` are those of the last."""
    parts = [stretch.trajectory for stretch in stretches]
    return replace(parts[-1], times_ns=np.concatenate([part.times_ns for part in parts]),
                   attitude=np.concatenate([part.attitude for part in parts]),
                   angular_velocity=np.concatenate([part.angular_velocity for part in parts]))
