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
Replay one recording: read the torques, compute the motion, and write the motion.

The torques are read and the motion is computed piece by piece, so that neither has to fit in
memory. A few recordings have to be read into memory as a whole, for example if their stamps are
far out of order, or if they contain several epochs of a node.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
import time

import numpy as np
from rigid_body_ros import recording
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.messages import joint_commands, VECTOR3
from rigid_body_ros.propagation import Trajectory
from rigid_body_ros.recording import Logged, NotInOrderError, Reading, Source, Topics
from rigid_body_ros.recording.account import merged
from rigid_body_ros.recording.problem import started, streamed, whole
from rigid_body_ros.replay import outputs
from rigid_body_ros.replay.batches import Batch, Batches, Collector, INPUT, Request
from rigid_body_ros.replay.check import drift, last_digits
from rigid_body_ros.replay.result import Replay
from rigid_body_ros.runtime import files, interrupts
from rigid_body_ros.runtime.terminal import progress
from rigid_body_ros.scene import Scene

#: The message types of all topics that a motion can depend on.
_KINDS = (*recording.TORQUES, VECTOR3, joint_commands(()))
#: The result and the batches of an epoch, or of a whole recording, before its motion is computed.
Epoch = tuple[Replay, Batches]


def replay(path: str | Path, scene: Scene, output: str | Path | None = None, *,
           topic: str | Sequence[str] | None = None, interpolation: str | None = None,
           rate: float | None = None, until: float | None = None, start: float = 0.0,
           time_source: str = 'header', also: Collection[str] = (), keep: bool | None = None,
           wheel_torque: str | None = None, wheel_momentum: str | None = None,
           wheel_command: str | None = None, inertia: str | None = None,
           columns: Mapping[str, str] | None = None,
           collect: Callable[[], Collector] | None = None,
           logged: Logged | None = None) -> Replay:
    """
    Compute the motion of a body from the torques in a recording.

    A node's log may contain several epochs. In that case, `replay` computes the motion of each
    epoch from its own start state, and writes the motions to the output one after the other.

    Parameters
    ----------
    path : str or Path
        The recording; see `recording.Source`.
    scene : Scene
        The body, its initial state and the options. If `start_time` is 0, the motion starts at
        the earliest stamp on any topic. In a node's log, the start state of each epoch is used
        in place of the scene's initial state.
    output : str or Path, optional
        Where to write the motion. If the name ends in .mcap or .csv, the output is an MCAP or CSV
        file, which replaces an existing file; otherwise the output is a new rosbag2 folder. The
        output contains the attitude, the Euler angles, the angular velocity, the rotor momentum if
        there are rotors, and the speeds and efforts of named wheels. The output must not be the
        recording or the scene file, under any name, and must not be in the folder of a bag that is
        read.
    topic : str or sequence of str, optional
        The topics whose torques are added up; by default, the torque topics of the scene. If the
        scene and the recording have only one topic each, the two topics may differ in name.
    interpolation : str, optional
        How to interpolate between samples; by default, as the scene specifies.
    rate : float, optional, Hz
        The output rate. By default, there is an output at every torque stamp from the start
        onward, at `until`, and, for a node's log, at the start of each epoch.
    until : float, optional, s
        The length of the motion or, in a node's log, of each epoch's motion. By default, the
        motion ends at the last stamp.
    start : float, s
        If positive, the motion starts this long after the earliest stamp, whatever the
        `start_time`. A torque that is held at the start acts. You cannot skip part of a node's
        log.
    time_source : str
        When a torque takes effect: at its stamp ('header'), when it was recorded ('log') or when
        it was published ('publish').
    also : collection of str
        Additional topics to write: 'imu' (/imu/data), 'tf' (/tf), 'markers' (/marker/...), and
        'input' (all messages of the recording, byte for byte). A CSV file cannot contain them.
    keep : bool, optional
        Whether to keep the problem and the trajectory in the result, which takes up memory. By
        default, they are kept only if there is no output.
    wheel_torque : str, optional
        The topic of the torque that the motors apply to the rotors. By default, the topic
        `wheel_torque` is read if the scene sets `wheels` and the recording has that topic.
    wheel_momentum : str, optional
        The topic of the measured rotor momentum, which is interpolated linearly between samples.
        The motion starts with the measured momentum. If this topic is used, the whole
        recording is read into memory.
    wheel_command : str, optional
        The topic of the commands to named wheels. By default, the topic `wheel_command` is read if
        the scene sets `wheel_names` and the recording has that topic. If this topic is used, the
        whole recording is read into memory.
    inertia : str, optional
        The topic of the inertia, for a body whose inertia changes. By default, the topic `inertia`
        is read if the scene sets `inertia_topic` and the recording has that topic. If this topic
        is used, the whole recording is read into memory.
    columns : mapping of str to str, optional
        The columns of a CSV file: for each of time, tx, ty and tz, with its unit as in a heading,
        the number of its column, which counts from 1, or its name.
    collect : callable, optional
        Returns an object that collects the motion. Each `Batch` is passed to the method `add` of
        this object. If there are several epochs, only the motion of the last epoch is collected.
        `collect` is called again if the recording has to be read a second time.
    logged : Logged, optional
        The problem to solve, in place of the one that the recording and the scene describe.

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
    outputs.check_also(also, output)
    topics = Topics.given(topic, wheel_torque=wheel_torque, wheel_momentum=wheel_momentum,
                          inertia=inertia, wheel_command=wheel_command, columns=columns)
    topics.check(scene)
    reading = Reading(topics=topics, interpolation=interpolation, time_source=time_source,
                      start=start, until=until)
    request = Request(path, scene, output, reading, rate, also, keep, collect, logged)
    with files.reading(path, scene=scene.path), ExitStack() as stack:
        if output is not None:
            files.check((output, outputs.suffix_of(output)))
        topics = topics.found_in(path, scene)
        request = replace(request, reading=replace(reading, topics=topics))
        others = topics.wheel_momentum or topics.wheel_command or topics.inertia
        copied = None
        if INPUT in also:
            copied = stack.enter_context(Source(
                path, next(iter(topics.wrenches), others), _KINDS, preferred=topics.preferred))
            copied.check_copied(outputs.topics(request))
        if not (logged or request.is_kept or others or scene.actuators or request.sensor_delay_ns):
            with suppress(NotInOrderError), ExitStack() as opened:
                return _replayed(request, partial(_pieces, request, opened), copied)
        return _replayed(request, partial(_whole, request), copied)


def _pieces(request: Request, stack: ExitStack) -> Sequence[Epoch]:
    """Return the single epoch of a recording whose torques are read piece by piece."""
    path, scene = request.path, request.scene
    reading = replace(request.reading, track=progress('replaying', size=len))
    begin, streams = stack.enter_context(streamed(path, scene, reading))
    first_ns = min([int(stream.piece.times_ns[0]) for stream in streams
                    if len(stream.piece.times_ns)], default=0)
    start = started(path, scene, begin, first_ns, reading.start)
    names = ', '.join(stream.source.topic for stream in streams if stream.source)
    return [(Replay(scene, request.interpolation, names, reading.topics.wheel_source),
             Batches(request, names, streams, scene.problem(start), begin is not None))]


def _whole(request: Request) -> Sequence[Epoch]:
    """Return all epochs, with the torques of each epoch as a single piece."""
    reading = replace(request.reading, track=progress('reading', size=len))
    logs = [request.logged] if request.logged else \
        recording.read_epochs(request.path, request.scene, reading)
    return [(Replay(request.scene, request.interpolation, ', '.join(logged.topics),
                    reading.topics.wheel_source, logged.account, damage=logged.damage),
             Batches(request, ', '.join(logged.topics), whole(logged.problem),
                     logged.problem, logged.is_epoch))
            for logged in logs]


def _replayed(request: Request, begin: Callable[[], Sequence[Epoch]],
              copied: Source | None) -> Replay:
    began = time.perf_counter()
    epochs = begin()
    *earlier, result = [replayed for replayed, _ in epochs]
    result.collected = request.collect() if request.collect else None
    with ExitStack() as stack:
        write = None if request.output is None else \
            stack.enter_context(outputs.writing(request.output, request, copied))
        logged_ns = epochs[0][1].start.time_ns
        for replayed, batches in epochs:
            delay_ns = max(logged_ns - batches.start.time_ns, 0)
            _compute(replayed, batches, write, request.is_kept, delay_ns)
            logged_ns = replayed.last.time_ns + delay_ns
    result.earlier = tuple(earlier)
    result.seconds['read'] = time.perf_counter() - began - sum(
        replayed.seconds['propagate'] + replayed.seconds['write'] for replayed, _ in epochs)
    return result


def _compute(result: Replay, batches: Batches, write: Callable[[Batch, int], None] | None,
             keep: bool, delay_ns: int) -> None:
    """Compute and write the motion of an epoch; the log times are `delay_ns` after the stamps."""
    kept: list[Batch] = []
    result.start = result.last = batches.start
    result.first_ns, result.gaps = batches.first_ns, batches.gaps
    result.saturation = batches.saturation
    for batch in batches:
        interrupts.check()
        _update(result, batch)
        interrupts.check()
        if write:
            writing = time.perf_counter()
            write(batch, delay_ns)
            result.seconds['write'] += time.perf_counter() - writing
        if result.collected:
            result.collected.add(batch)
        if keep:
            kept.append(batch)
    accounts = {stream.source: stream.account for stream in batches.streams
                if stream.source and stream.account}
    if accounts:
        result.damage = '; '.join(dict.fromkeys(
            source.damage for source in accounts if source.damage))
        result.account = merged({source.topic: account for source, account in accounts.items()})
    if keep:
        result.problem = kept[0].problem
        result.trajectory = _joined(kept)


def _update(result: Replay, batch: Batch) -> None:
    """Update the result with a batch of the motion."""
    began = time.perf_counter()
    trajectory = batch.trajectory
    result.last_ns = max(batch.last_ns, result.first_ns)
    if trajectory.times_ns.size:
        result.last = State(int(trajectory.times_ns[-1]), trajectory.attitude[-1],
                            trajectory.angular_velocity[-1], trajectory.rotor_momentum[-1])
        if not result.check:
            result.check = drift(batch.problem, trajectory)
            result.last_digits = last_digits(batch.problem, trajectory)
        total = float(result.last.time_ns - result.start.time_ns) * 1e-9
        result.check = result.check._replace(total=total)
        if result.last_digits:
            result.last_digits = result.last_digits._replace(total=total)
    for model in trajectory.models:
        name = f'{model.solver} ({model.reason})'
        result.solvers[name] = result.solvers.get(name, 0) + model.end_ns - model.start_ns
    result.seconds['propagate'] += batch.seconds + time.perf_counter() - began


def _joined(batches: list[Batch]) -> Trajectory:
    """Join the motion in all batches into one trajectory."""
    parts = [batch.trajectory for batch in batches]
    motion = [*(part.attitude.ravel() for part in parts),
              *(part.angular_velocity.ravel() for part in parts)]
    momenta = [part._momenta[:part.times_ns.size] for part in parts if part._momenta is not None]
    return replace(parts[-1], times_ns=np.concatenate([part.times_ns for part in parts]),
                   _motion=np.concatenate(motion),
                   _parts=tuple(use for part in parts for use in part._parts),
                   _momenta=np.concatenate(momenta) if momenta else None)
