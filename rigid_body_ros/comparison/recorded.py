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

"""Compare the measurements of a recording with the motion under its torques."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rigid_body_ros import messages, recording
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.comparison.align import CLOCK
from rigid_body_ros.comparison.coarse import LARGEST_OFFSET
from rigid_body_ros.comparison.comparison import compare_motion
from rigid_body_ros.comparison.errors import Comparison
from rigid_body_ros.comparison.motion import Model, Recorded
from rigid_body_ros.recording import ANGULAR_VELOCITY, ATTITUDE
from rigid_body_ros.replay.epochs import chosen
from rigid_body_ros.replay.sources import read_sources, Topics, topics_of
from rigid_body_ros.runtime.terminal import no_progress, Track
from rigid_body_ros.scene import Scene
from rigid_body_ros.sensing.measured import Measured
from rigid_body_ros.sensing.reading import read_all, read_measured


@dataclass(frozen=True)
class Reading:
    """
    How to read a recording.

    Attributes
    ----------
    interpolation : str, optional
        Interpolation of the torques between samples; otherwise the scene's.
    time_source : str
        Of torques and measurements, as for `recording.read`.
    frames : tuple of str, optional
        As for `read_measured`.
    track : callable
        Wraps the iteration over blocks of messages, to show progress.
    work : callable
        Wraps the iteration over restarts and possible causes, to show progress.

    """

    interpolation: str | None = None
    time_source: str = 'header'
    frames: tuple[str, str] | None = None
    track: Track = no_progress
    work: Track = no_progress


def compare_recording(path: str | Path, scene: Scene, measured: Sequence[str] = (), *,
                      topic: str | Sequence[str] | None = None, wheel_torque: str | None = None,
                      wheel_momentum: str | None = None, motion: str | Path | None = None,
                      align: Collection[str] = (), horizons: Sequence[float] = (),
                      reading: Reading | None = None) -> Comparison:
    """
    Compare measured topics of a recording with the motion under its torques.

    Parameters
    ----------
    path : str or Path
        The recording.
    scene : Scene
        If its start_time is 0, the motion starts at the earliest stamp of the torques or, without
        torques, of the measurements.
    measured : sequence of str
        Measured topics; can be empty if the recording has one, as for `read_measured`.
    topic, wheel_torque, wheel_momentum
        Topics of the torques, as for `replay`.
    motion : str or Path, optional
        A recorded motion to compare with instead, such as the output of a replay.
    align, horizons
        As for `compare`.
    reading : Reading, optional
        How to read the recording.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        The recording cannot be read, does not fit the scene, or measurements and motion do not
        overlap in time.

    """
    reading = reading or Reading()
    sensors = read_all(path, measured, frames=reading.frames, body_frame=scene.body_frame,
                       space_frame=scene.space_frame, time_source=reading.time_source,
                       track=reading.track)
    topics = topics_of(topic, wheel_torque, wheel_momentum)
    if motion is None:
        model: Model | Recorded = read_model(path, scene, topics, reading,
                                             min(int(each.stamps_ns[0]) for each in sensors))
        assert isinstance(model, Model)
        check_overlap(path, model, sensors, CLOCK in align)
    else:
        model = read_motion(motion, scene)
    try:
        found = compare_motion(model, sensors, align, horizons, track=reading.work)
    except ValueError as error:
        raise InputError(f'{path}: {error}') from error
    # A file name may hold bytes that are not text.
    return replace(found, recording=Path(path).name.encode(errors='replace').decode())


def read_model(path: str | Path, scene: Scene, topics: Topics, reading: Reading,
               first_ns: int = 0) -> Model:
    """
    Return the body of a scene, its start, and the torques of a recording.

    Without torques in the recording, the body is free and starts at `first_ns`, unless the scene
    has a start_time. Of several epochs of a node, its start_time chooses one; the motion ends
    where the next one begins.

    Raises
    ------
    InputError
        The recording cannot be read, or does not fit the scene.

    """
    topics.is_plain(scene)
    if topics == Topics() and not recording.topics(path, recording.TORQUES):
        start = replace(scene.start, time_ns=scene.start.time_ns or first_ns)
        return Model(scene.body, start, options=scene.options)
    epochs = read_sources(path, scene, topics.found_in(path, scene),
                          reading.interpolation or scene.interpolation, reading.track,
                          reading.time_source)
    starts = [one.start for one in epochs]
    sources = epochs[chosen(path, scene, starts)]
    later = [start.time_ns for start in starts if start.time_ns > sources.start.time_ns]
    model = Model(scene.body, sources.start, sources.logs, sources.wheels, scene.options)
    return replace(model, last_ns=min(later) - 1) if later else model


def read_motion(path: str | Path, scene: Scene) -> Recorded:
    """
    Return a recorded motion: attitudes with angular velocities.

    Raises
    ------
    InputError
        The file has neither the topics of a replay, /attitude and /angular_velocity, nor a single
        topic with both.

    """
    found = recording.topics(path, (messages.QUATERNION, messages.VECTOR3))

    def measured(topic: str | None = None) -> Measured:
        return read_measured(path, topic, body_frame=scene.body_frame,
                             space_frame=scene.space_frame)
    if ATTITUDE in found and ANGULAR_VELOCITY in found:
        attitude = measured(ATTITUDE)
        rates = measured(ANGULAR_VELOCITY)
        if not np.array_equal(attitude.stamps_ns, rates.stamps_ns):
            raise InputError(f'{path}: expected the same stamps on {ATTITUDE} and '
                             f'{ANGULAR_VELOCITY}, found others')
        return Recorded(replace(attitude, angular_velocity=rates.angular_velocity))
    motion = measured()
    if motion.attitude is None or motion.angular_velocity is None:
        raise InputError(f'{path}: {motion.topic}: expected a motion with attitude and angular '
                         'velocity, found one of them')
    return Recorded(motion)


def check_overlap(path: str | Path, model: Model, sensors: Sequence[Measured],
                  searched: bool) -> None:
    """Raise InputError if the measurements end before the torques begin, or the reverse."""
    margin = round(1e9 * LARGEST_OFFSET) if searched else 0
    stamps_ns = [int(time) for log in model.logs if len(log) for time in log.times_ns[[0, -1]]]
    first, last = model.first_ns, max(stamps_ns, default=model.last_ns)
    for sensor in sensors:
        begin, end = int(sensor.stamps_ns[0]), int(sensor.stamps_ns[-1])
        if end + margin < first or begin - margin > last:
            raise InputError(
                f'{path}: {sensor.topic}: expected measurements during the motion, from {first} '
                f'ns to the last torque at {last} ns, found them from {begin} ns to {end} ns; '
                'are the clocks the same (--time-source log)?')
