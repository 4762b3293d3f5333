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
Replay one recording: read torques, compute the motion, write it.

Torques are read and the motion is computed piece by piece, so neither has to fit in memory. Only
recordings with stamps far out of order, or with several epochs of a node, are read as a whole.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
import time

import numpy as np
from rigid_body_ros import recording
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.messages import VECTOR3
from rigid_body_ros.propagation import Trajectory, warm_up
from rigid_body_ros.recording import Messages, NotInOrderError, Piece, Source
from rigid_body_ros.replay import outputs
from rigid_body_ros.replay.batches import (
    Batch,
    Batches,
    Collector,
    CombinedBatches,
    Request,
)
from rigid_body_ros.replay.check import Check, drift, last_digits, LastDigits
from rigid_body_ros.replay.gaps import Gaps
from rigid_body_ros.replay.outputs import INPUT
from rigid_body_ros.replay.sources import absolute, read_sources, Topics, topics_of
from rigid_body_ros.runtime import files, interrupts
from rigid_body_ros.runtime.terminal import progress
from rigid_body_ros.scene import Scene

#: The types of all topics that a motion depends on.
_KINDS = (*recording.TORQUES, VECTOR3)


@dataclass(eq=False)
class Replay:
    """
    A replayed recording.

    Attributes
    ----------
    scene : Scene
    interpolation : str
    topic : str
        Topic of the torques; several are separated by commas.
    wheel_source : str
        Where the torque on the rotors comes from.
    messages : int
        Number of torque messages.
    unordered : int
        Number of messages whose stamp is not later than the stamp of the previous message.
    first_ns, last_ns : int
        First and last torque stamp, ns.
    damage : str
        Which part of the recording was lost; '' if none.
    start, last : State
        First and last state of the motion.
    solvers : dict
        By solver and reason, the length of the motion computed with it, ns.
    interpolation_differences : dict
        By other interpolation, the angle, rad, between its final attitude and that of the motion;
        None if the body spins too fast to compute.
    check : Check, optional
        How much the motion, or the part of it that is checked, violates the conservation laws.
    last_digits : LastDigits, optional
        How far the motion, or the beginning of it, moves if the last digits of inertia, torques
        and start change; None if that was not estimated.
    gaps : tuple of Gaps
        Those of each log: of the torques in the order of the topics, then on the rotors.
    seconds : dict
        Wall time spent to read, propagate and write, s.
    log, trajectory : TorqueLog, Trajectory, optional
        The whole log and motion, if `keep` was set. A scene with several topics, rotors or damping
        has a tuple of logs, one for each topic.
    wheels : TorqueLog, optional
        The torque on the rotors, if `keep` was set and the recording has it.
    collected : optional
        What `collect` returned.
    earlier : tuple of Replay
        Those of the earlier epochs, if the recording has several epochs of a node: this one is of
        the last epoch.

    """

    scene: Scene
    interpolation: str
    topic: str
    wheel_source: str = ''
    messages: int = 0
    unordered: int = 0
    first_ns: int = 0
    last_ns: int = 0
    damage: str = ''
    start: State = field(default_factory=State)
    last: State = field(default_factory=State)
    solvers: dict[str, int] = field(default_factory=dict)
    interpolation_differences: dict[str, float | None] = field(default_factory=dict)
    check: Check | None = None
    last_digits: LastDigits | None = None
    gaps: tuple[Gaps, ...] = ()
    seconds: dict[str, float] = field(
        default_factory=lambda: {'read': 0.0, 'propagate': 0.0, 'write': 0.0})
    log: TorqueLog | Sequence[TorqueLog] | None = None
    wheels: TorqueLog | None = None
    trajectory: Trajectory | None = None
    collected: Collector | None = None
    earlier: tuple[Replay, ...] = ()


#: An epoch of a node, or a whole recording, before its motion is computed.
Epoch = tuple[Replay, Batches | CombinedBatches]


def replay(path: str | Path, scene: Scene, output: str | Path | None = None, *,
           topic: str | Sequence[str] | None = None, interpolation: str | None = None,
           rate: float | None = None, until: float | None = None, start: float = 0.0,
           time_source: str = 'header', also: Collection[str] = (), keep: bool | None = None,
           wheel_torque: str | None = None, wheel_momentum: str | None = None,
           collect: Callable[[], Collector] | None = None) -> Replay:
    """
    Compute the motion of a body from the torques of a recording.

    The log of a node may have several epochs. Each has a motion of its own from its start state,
    and these follow each other in the output.

    Parameters
    ----------
    path : str or Path
        The recording; see `recording.Source`.
    scene : Scene
        If its start_time is 0, the motion starts at the earliest stamp of all topics. The log of a
        node has its own start.
    output : str or Path, optional
        Where to write attitude, Euler angles, angular velocity and, if there are rotors, their
        momentum: an MCAP file, which may exist, or, if the name does not end in .mcap, a new
        rosbag2 folder. It must not be the recording or the scene file, under any name, or lie in
        the folder of the bag.
    topic : str or sequence of str, optional
        Topics of the torques, which add up; by default those of the scene. If the scene has one
        topic and the recording has one, their names may differ.
    interpolation : str, optional
        Interpolation between samples; otherwise the scene's.
    rate : float, optional, Hz
        Output rate; otherwise there is an output at every torque stamp from the start on, and at
        `until`, and of the log of a node at the start of each epoch.
    until : float, optional, s
        End of the motion, or of each epoch, after its start; otherwise the last stamp.
    start : float, s
        Skip this many seconds of the recording. Only for one topic of torques, and not for the log
        of a node.
    time_source : str
        When a torque takes effect: 'header' (its stamp), 'log' or 'publish'.
    also : collection of str
        Additional topics to write: 'imu' (/imu/data), 'tf' (/tf), 'markers' (/marker/...), and
        'input' (all messages of the recording, byte for byte).
    keep : bool, optional
        Whether to return log and trajectory, which takes memory; by default if there is no output.
    wheel_torque : str, optional
        Topic of the torque of the motors on the rotors; by default wheel_torque, if the scene has
        wheels and the recording has that topic.
    wheel_momentum : str, optional
        Topic of the measured momentum of the rotors, which is linear between samples. The motion
        starts with the measured momentum.
    collect : callable, optional
        Returns an object whose method `add` takes each `Batch` of the motion, or of the last
        epoch. It is called once more if the recording has to be read again.

    Returns
    -------
    Replay

    Raises
    ------
    InputError
        The recording cannot be read or does not fit the scene, or the output cannot be written.
    ValueError
        `start` or `until` is negative or longer than 1e9 s.

    """
    outputs.check_names(also)
    given = topics_of(topic, wheel_torque, wheel_momentum)
    is_plain = given.is_plain(scene)
    keep = output is None if keep is None else keep
    interpolation = interpolation or scene.interpolation
    request = Request(path, scene, interpolation, rate, until, also, collect)
    with files.reading(path), files.protected('scene', scene.path):
        if output is not None:
            files.check((output, recording.suffix_of(output)))
        for prepare in progress('loading kernels (compiled on first use)')([warm_up], 1):
            prepare()
        if not is_plain:
            topics = given.found_in(path, scene)
            return _combined(request, topics, output, keep, time_source, start)
        with Source(path, next(iter(given.torques), None), recording.TORQUES, time_source, start,
                    absolute(scene.torque_topics[0])) as source:
            return _in_pieces_or_whole(request, source, output, keep)


def plot(path: str | Path, result: Replay, name: str) -> None:
    """
    Draw a motion and its torques into a PNG file; `replay` must have kept them.

    Parameters
    ----------
    path : str or Path
        A PNG file.
    result : Replay
        With log and trajectory.
    name : str
        Name of the recording, for the title.

    Raises
    ------
    InputError
        The file cannot be written.

    """
    from rigid_body_ros.report import figures  # matplotlib takes longer to load than most replays
    assert result.trajectory is not None
    assert result.log is not None
    sequence = result.scene.euler_sequence
    with files.atomic_output(path, '.png') as temporary:
        figures.motion(temporary, result.trajectory, result.log, sequence,
                       f'{name}: {result.topic}', result.scene.timeout_ns)


def _pieces(request: Request, source: Source) -> Sequence[Epoch]:
    """Return the motion of a log that is read piece by piece; it has one epoch."""
    result = Replay(request.scene, request.interpolation, source.topic)
    start, blocks = recording.first_epoch(
        request.path, iter(progress('replaying', size=len)(source, source.count)))

    def counted() -> Iterator[Messages]:
        last: list[int] = []
        for block in blocks:
            result.messages += len(block)
            result.unordered += int(np.sum(np.diff(block.stamps_ns, prepend=last) <= 0))
            last = [int(block.stamps_ns[-1])]
            yield block
    scene = request.scene
    pieces = recording.torque_pieces(f'{request.path}: {source.topic}', counted(),
                                     scene.body_frame, scene.space_frame, scene.links)
    return [(result, Batches(request, source.topic, pieces, start))]


def _whole(request: Request, source: Source) -> Sequence[Epoch]:
    """Return the motions of all epochs, each with its log as one piece."""
    blocks = [*progress('reading', size=len)(source, source.count)]
    recorded = recording.joined(source.topic, source.kind, blocks, source.damage)
    scene, found = request.scene, []
    for part in recording.epochs(request.path, recorded):
        log = recording.torque_log(request.path, part, scene.body_frame, scene.space_frame,
                                   links=scene.links)
        piece = Piece(log.times_ns, log.torques, log.in_space)
        result = Replay(scene, request.interpolation, source.topic, messages=len(part),
                        unordered=int(np.sum(np.diff(part.stamps_ns) <= 0)))
        found.append((result, Batches(request, source.topic, iter([piece]), part.start)))
    return found


def _in_pieces_or_whole(request: Request, source: Source, output: str | Path | None,
                        keep: bool) -> Replay:
    """Replay piece by piece; if `keep` is set or stamps are far out of order, as a whole."""
    if INPUT in request.also:
        source.check_copied(outputs.topics_of(request))

    if not keep:
        with suppress(NotInOrderError):
            return _replayed(request, source, _pieces, output)
    return _replayed(request, source, _whole, output, keep)


def _combined(request: Request, topics: Topics, output: str | Path | None, keep: bool,
              time_source: str, skip: float) -> Replay:
    """Replay a scene with several topics, rotors or damping, whose logs are read as a whole."""
    if skip and (len(topics.torques) != 1 or topics.wheel_torque or topics.wheel_momentum):
        raise InputError('--start: expected one topic of torques, found several, or rotors; set '
                         'start_time in the scene instead')
    names = [*topics.torques, *filter(None, [topics.wheel_torque, topics.wheel_momentum])]
    named = ', '.join(names)

    def begin(request: Request, source: Source) -> Sequence[Epoch]:
        scene, interpolation = request.scene, request.interpolation
        return [(Replay(scene, interpolation, named, topics.wheel_source, one.messages,
                        one.unordered, damage=one.damage), CombinedBatches(request, named, one))
                for one in read_sources(request.path, scene, topics, interpolation,
                                        progress('reading', size=len), time_source, skip)]
    with Source(request.path, names[0], _KINDS, time_source) as source:
        if INPUT in request.also:
            source.check_copied(outputs.topics_of(request))
        return _replayed(request, source, begin, output, keep)


def _replayed(request: Request, source: Source,
              begin: Callable[[Request, Source], Sequence[Epoch]],
              output: str | Path | None, keep: bool = False) -> Replay:
    began = time.perf_counter()
    epochs = begin(request, source)
    *earlier, result = [found for found, _ in epochs]
    result.collected = request.collect() if request.collect else None
    with ExitStack() as stack:
        writer = stack.enter_context(recording.writer_of(output)) if output is not None else None
        if writer:
            outputs.add_topics(writer, request)
        logged_ns = epochs[0][1].start.time_ns
        for found, batches in epochs:
            delay_ns = max(logged_ns - batches.start.time_ns, 0)
            _compute(request, found, batches, writer, keep, delay_ns)
            logged_ns = found.last.time_ns + delay_ns
        if writer and INPUT in request.also:
            source.copy_to(writer)
        interrupts.check()  # last chance before the output gets its final name
    result.earlier = tuple(earlier)
    result.seconds['read'] = time.perf_counter() - began - sum(
        found.seconds['propagate'] + found.seconds['write'] for found, _ in epochs)
    result.damage = result.damage or source.damage
    return result


def _compute(request: Request, result: Replay, batches: Batches | CombinedBatches,
             writer: recording.Writer | None, keep: bool, delay_ns: int) -> None:
    """Compute the motion of an epoch, which is logged `delay_ns` later than its stamps."""
    kept: list[Batch] = []
    result.start = result.last = batches.start
    result.first_ns, result.gaps = batches.first_ns, batches.gaps
    for batch in batches:
        interrupts.check()
        _update(result, batch)
        interrupts.check()
        if writer:
            writing = time.perf_counter()
            outputs.write(writer, request, batch.trajectory, delay_ns)
            result.seconds['write'] += time.perf_counter() - writing
        if result.collected:
            result.collected.add(batch)
        if keep:
            kept.append(batch)
    result.interpolation_differences = batches.differences(result.last.attitude)
    if keep:
        result.log, result.wheels = kept[0].log, kept[0].wheels
        result.trajectory = _joined(kept)


def _update(result: Replay, batch: Batch) -> None:
    """Update the result with a batch of the motion."""
    began = time.perf_counter()
    log, trajectory = batch.log, batch.trajectory
    result.last_ns = max(batch.last_ns, result.first_ns)
    if trajectory.times_ns.size:
        result.last = State(int(trajectory.times_ns[-1]), trajectory.attitude[-1],
                            trajectory.angular_velocity[-1], trajectory.rotor_momentum[-1])
        if not result.check:
            checked = result.scene, log, result.start, trajectory, batch.wheels
            result.check, result.last_digits = drift(*checked), last_digits(*checked)
        total = float(result.last.time_ns - result.start.time_ns) * 1e-9
        result.check = result.check._replace(total=total)
        if result.last_digits:
            result.last_digits = result.last_digits._replace(total=total)
    for model in trajectory.models:
        name = f'{model.solver} ({model.reason})'
        result.solvers[name] = result.solvers.get(name, 0) + model.end_ns - model.start_ns
    result.seconds['propagate'] += batch.seconds + time.perf_counter() - began


def _joined(batches: list[Batch]) -> Trajectory:
    """Return the motion of all batches of one log, with the `models` of the last."""
    parts = [batch.trajectory for batch in batches]
    motion = [*(part.attitude.ravel() for part in parts),
              *(part.angular_velocity.ravel() for part in parts)]
    return replace(parts[-1], times_ns=np.concatenate([part.times_ns for part in parts]),
                   _motion=np.concatenate(motion))
