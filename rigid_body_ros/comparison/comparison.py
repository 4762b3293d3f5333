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

"""Compare measurements with a motion: computed from torques, or recorded."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial
import json
from pathlib import Path
from typing import Any

import numpy as np
from rigid_body_ros import messages, recording
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, located
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.comparison.result import Comparison, Errors
from rigid_body_ros.inference.align import align as aligned_by
from rigid_body_ros.inference.align import CLOCK, MOUNT
from rigid_body_ros.inference.evidence import LOST, Suspect
from rigid_body_ros.inference.findings import Findings, judged, start_suspect
from rigid_body_ros.inference.guess import LARGEST_OFFSET
from rigid_body_ros.inference.horizons import horizon, usual_horizons
from rigid_body_ros.inference.hypotheses import faults_of_samples
from rigid_body_ros.inference.monitor import is_checked, monitored, settings_of
from rigid_body_ros.inference.motion import (
    divided,
    errors_of,
    inside,
    Motion,
    no_overlap_error,
    Recorded,
)
from rigid_body_ros.inference.noise import FEWEST, spread_of
from rigid_body_ros.inference.residual_torque import residual_torque
from rigid_body_ros.inference.setup import setup_of_model
from rigid_body_ros.inference.verdict import scored
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.measured import faults_of, Measured
from rigid_body_ros.recording.measurements import read_measured
from rigid_body_ros.recording.observed import Measurements, read_observed
from rigid_body_ros.recording.selection import Reading
from rigid_body_ros.recording.writer import ANGULAR_VELOCITY, ATTITUDE, Column, writer_of
from rigid_body_ros.runtime.fingerprint import fingerprint, NAME
from rigid_body_ros.runtime.terminal import no_progress, Track
from rigid_body_ros.scene import Scene
from rigid_body_ros.scene.quantities import SPACE, split_topic, START

#: The topics of `write`.
ATTITUDE_ERROR, RATE_ERROR = '/error/rotation_vector', '/error/angular_velocity'
RESIDUAL_TORQUE = '/residual_torque'
#: The alignments that correct a parameter, by its kind.
_ALIGNED = {START: START, 'clock_offset': CLOCK, 'mount': MOUNT, SPACE: MOUNT}
#: The motion is predicted from a start that is estimated from this many seconds of the
#: measurement, but from at least `FEWEST` samples. Its uncertainty is computed at so many times.
_SPAN, _INSTANTS = 1.0, 1000


def compare(body: RigidBody, start: State, log: TorqueLog | Sequence[TorqueLog] | None = None, *,
            measured: Measured | Sequence[Measured], align: Collection[str] = (),
            horizons: Sequence[float] | None = (), causes: bool = True,
            **others: Any) -> Comparison:
    """
    Compare a measured motion with the motion computed from torques.

    The motion is computed exactly at the stamps of the measurements, so nothing is interpolated.

    Parameters
    ----------
    body, start, log
        The body, the initial state and the torques, as for `Problem`.
    measured : Measured or sequence of Measured
        The measurements of one or more sensors.
    align : collection of str
        What to fit before the comparison. 'start' fits the initial attitude and angular velocity.
        'clock' fits a constant clock offset for each sensor, up to 10 s. 'mount' fits a constant
        rotation between the axes of each sensor and the body axes, and another between the space
        axes of the measurements and the space axes of the motion. Use 'clock@TOPIC' or
        'mount@TOPIC' to fit a single sensor. If 'mount' applies to a sensor with attitudes,
        'start' fits only the angular velocity, because rotating the space axes has the same effect
        as changing the initial attitude.
    horizons : sequence of float or None, s
        For each horizon, the motion is restarted from measured states at intervals of this length,
        and the error at the end of each interval is returned. If None, the horizons are 0.1, 1 and
        10 s, except those that are shorter than the time between two samples or longer than the
        measurement.
    causes : bool
        Whether to judge the model, and to name what may be wrong.
    others
        Other keyword arguments of `Problem`, such as the wheels or the solver options. `changes`
        is not allowed.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        No sample lies within the time span of the motion, or a name in `align` is unknown.
    ValueError
        `propagate` or `Measured.check` rejects an argument; a horizon is not positive; or
        `changes` are given.

    """
    sensors = [measured] if isinstance(measured, Measured) else measured
    for sensor in sensors:
        sensor.check()
    problem = Problem(body, start, log, **others)
    if problem.changes:
        raise ValueError(f'changes: expected a body that does not change, found '
                         f'{len(problem.changes)} changes, which only `propagate` computes')
    # Replace named wheels by rotors, because restarts set rotor momenta, not wheel speeds.
    return compare_motion(problem.carried(), sensors, align, horizons, causes)


def compare_motion(motion: Motion, measured: Sequence[Measured],
                   align: Collection[str] = (), horizons: Sequence[float] | None = (),
                   causes: bool = True, track: Track = no_progress,
                   names_suspects: bool = True) -> Comparison:
    """
    Compare measurements with a motion that is given as a problem or as a recorded motion.

    The comparison is the same as in `compare`. The function `track` shows the progress. If samples
    are lost, `names_suspects` is false, and the verdict names no suspects.
    """
    for seconds in horizons or ():
        if not duration_ns(seconds, 'horizons'):
            raise ValueError(f'horizons: expected positive seconds, found {seconds}')
    if horizons and isinstance(motion, Recorded):
        raise InputError('horizons: expected a model that can restart, found a recorded motion')
    comparison = _compared(motion, measured, align)
    problem, aligned = comparison.motion, comparison.aligned
    if isinstance(problem, Problem):
        best = max(aligned, key=lambda sensor: (sensor.angular_velocity is not None, len(sensor)))
        comparison = replace(
            comparison, residual_torque=residual_torque(problem, best),
            horizons=tuple(horizon(problem, aligned, seconds, track) for seconds in (
                usual_horizons(aligned) if horizons is None else horizons)),
            predictable_s=_predictable_s(problem, comparison))
    setup = setup_of_model(problem, aligned) if causes else None
    if setup is None:
        return comparison
    findings = judged(setup, names_suspects)
    if names_suspects and isinstance(problem, Recorded):
        findings = _with_faults(findings, problem, aligned)
    elif names_suspects and START not in align:
        findings = _with_start(findings)
    return replace(comparison, verdict=scored(
        findings, partial(_option, isinstance(problem, Problem))))


def _compared(motion: Motion, measured: Sequence[Measured], align: Collection[str]) -> Comparison:
    """Align measurements with a motion, and return a comparison with errors only."""
    alignments = aligned_by(motion, measured, align)
    if START in align and isinstance(motion, Problem):
        motion = motion.replaced(start=alignments[0].start)
    sensors = [alignment.applied(sensor) for alignment, sensor in zip(alignments, measured)]
    aligned = tuple(sensor.rows(inside(motion, sensor.stamps_ns)) for sensor in sensors)
    if not any(map(len, aligned)):
        raise no_overlap_error(motion, sensors)
    states = motion.propagate(at=np.concatenate([sensor.stamps_ns for sensor in aligned]))
    errors = tuple(Errors(sensor.topic, sensor.stamps_ns, *errors_of(sensor, part))
                   for sensor, part in zip(aligned, divided(states, aligned)))
    left_out = sum(map(len, sensors)) - sum(map(len, aligned))
    return Comparison(tuple(measured), alignments, aligned, errors, left_out, (), None, motion)


def _predictable_s(problem: Problem, comparison: Comparison) -> float | None:
    """
    Return the time after which the uncertainty of the start alone causes an error of 0.1 rad.

    The start is assumed to be estimated from one second of the measurement, whose noise is
    estimated from the errors of the comparison. The time is counted from the start, s. It is None
    if the motion is predictable up to the last sample.
    """
    start_ns, deviations = problem.start.time_ns, _deviations(comparison)
    end = 1e-9 * (int(comparison.times_ns[-1]) - start_ns)
    if end <= 0.0 or not np.isfinite(deviations).all():
        return None
    seconds = np.linspace(0.0, end, _INSTANTS + 1)[1:]
    times_ns = start_ns + np.round(1e9 * seconds).astype(np.int64)
    derivatives = problem.derivatives([START], at=times_ns).both
    variances = np.sum((deviations * derivatives[:, :3]) ** 2, axis=(1, 2))
    lost = np.flatnonzero(variances > LOST ** 2)
    return float(seconds[lost[0]]) if lost.size else None


def _deviations(comparison: Comparison) -> Floats:
    """
    Return the standard deviations of the start.

    The first three values are for the attitude, rad, and the last three for the angular velocity,
    rad/s. If the attitude is not measured, the first three values are 0.
    """
    attitude, rate = np.full((2, 3), np.inf)
    for errors in comparison.errors:
        times_ns = errors.times_ns
        if len(times_ns) < FEWEST:
            continue
        spacing = 1e-9 * float(np.median(np.diff(times_ns)))
        count = max(FEWEST, round(_SPAN / spacing))
        if errors.rotation_vectors is not None:
            mean = spread_of(times_ns, errors.rotation_vectors, True) / np.sqrt(count)
            attitude = np.minimum(attitude, mean)
            # The rate is the slope of a line fitted to the attitudes, so compute the standard
            # deviation of this slope.
            rate = np.minimum(rate, mean * np.sqrt(12.0) / (count * spacing))
        if errors.rates is not None:
            rate = np.minimum(rate, spread_of(times_ns, errors.rates) / np.sqrt(count))
    return np.append(attitude if comparison.of('rotation_vectors') else np.zeros(3), rate)


def _with_faults(findings: Findings, motion: Recorded, aligned: Sequence[Measured]) -> Findings:
    """Add faults of some samples, unless a fault of all samples explains the errors."""
    if any(suspect.text for suspect in findings.suspects):
        return findings
    channels = [channel for sensor in aligned for channel in sensor.channels()
                if len(channel) > FEWEST]
    # A fault of some samples may look like a parameter, so it comes first.
    drop = max([float(findings.solution.count),
                *(suspect.chi2_drop for suspect in findings.suspects)])
    faults = [Suspect(name, drop, 0.0, text=text)
              for name, text in faults_of_samples(motion, channels)]
    return replace(findings, suspects=[*faults, *findings.suspects])


def _with_start(findings: Findings) -> Findings:
    """Add the start, unless the model is wrong, which may also move the start."""
    is_right = not (findings.suspects or findings.reasons)
    suspect = start_suspect(findings.solution) if is_right else None
    return replace(findings, suspects=[suspect]) if suspect else findings


def _option(is_computed: bool, name: str) -> str:
    """Return the option that corrects the comparison, the command of a fit, or advice."""
    if kind := _ALIGNED.get(split_topic(name)[0]):
        return f'--align {kind} corrects that'
    return f'attitude_identify --estimate start,{name} fits it' if is_computed else \
        'calibrate the sensor'


def compare_recording(path: str | Path, scene: Scene, reading: Reading | None = None, *,
                      motion: str | Path | None = None, align: Collection[str] = (),
                      horizons: Sequence[float] | None = None,
                      track: Track = no_progress) -> Comparison:
    """
    Compare the measurements in a recording with the motion computed from its torques.

    Parameters
    ----------
    path, scene
        The recording and the scene, as for `read_observed`.
    reading : Reading, optional
        Which topics to read from the recording, and how.
    motion : str or Path, optional
        A recording or CSV file of the motion to compare with, such as the output of a replay. By
        default, the motion is computed from the torques.
    align, horizons
        What to fit, and which horizons to use, as for `compare`. If `horizons` is None, the
        default horizons are used.
    track : callable
        Wraps the loops over restarts and over possible causes to show progress.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        The recording cannot be read or does not fit the scene, or the measurements and the motion
        do not overlap in time.

    """
    reading = reading or Reading()
    moves_clocks = any(name.partition('@')[0] == CLOCK for name in align)
    moved: Motion
    if motion is None:
        searched = LARGEST_OFFSET if moves_clocks else 0.0
        stated, during = read_observed(path, scene, reading, searched)
        # Replace named wheels by rotors, because restarts set rotor momenta, not wheel speeds.
        with located(path):
            moved = stated.carried()
    else:
        moved, during = read_motion(motion, scene), Measurements(reading.sensors(path, scene))
    with located(path):
        sensors = during.until_end()
        # A clock offset can move the last samples beyond the end.
        if moves_clocks and during.has_end:
            sensors = during.until_end([alignment.clock_offset_s for alignment
                                        in aligned_by(moved, sensors, align)])
        comparison = compare_motion(moved, sensors, align, horizons, track=track,
                                    names_suspects=not faults_of(during.torques, during.sensors))
    if horizons and isinstance(moved, Problem) and is_checked(moved, scene.values):
        comparison = replace(comparison, horizons=tuple(replace(errors, judgements=tuple(monitored(
            moved, sensors, settings_of(scene.values)._replace(window=errors.seconds))))
            for errors in comparison.horizons))
    left_out = sum(map(len, during.sensors)) - sum(map(len, sensors))
    return replace(comparison, recording=_name(path), left_out=comparison.left_out + left_out,
                   torques=during.torques)


def _name(path: str | Path) -> str:
    # A file name may contain bytes that cannot be decoded as text.
    return Path(path).name.encode(errors='replace').decode()


def compare_sensors(path: str | Path, reading: Reading, align: Collection[str] = (),
                    track: Track = no_progress) -> Comparison:
    """
    Compare the sensors of a recording with each other, without a model of the body.

    The sensor with the most attitudes defines the motion, and the angular velocities of all
    sensors, and the attitudes of the others, are compared with this motion.

    Raises
    ------
    InputError
        The recording cannot be read, fewer than two quantities are measured, no sensor measures
        attitudes, the attitudes do not change, or the sensors do not overlap in time.

    """
    sensors = reading.sensors(path, None)
    attitudes = [sensor for sensor in sensors
                 if sensor.attitude is not None and len(sensor) >= FEWEST]
    if not attitudes:
        raise InputError(f'{path}: expected at least {FEWEST} attitudes to compare with, or '
                         '--scene, found none')
    best = max(attitudes, key=len)
    others = [replace(sensor, attitude=None, attitude_covariance=None) if sensor is best
              else sensor for sensor in sensors
              if sensor is not best or sensor.angular_velocity is not None]
    if not others:
        raise InputError(f'{path}: {best.topic}: expected a second sensor to compare with, or '
                         '--scene, found none')
    with located(path):
        motion = Recorded.of_attitudes(replace(best, angular_velocity=None))
        comparison = compare_motion(motion, others, align, track=track,
                                    names_suspects=not faults_of(None, sensors))
    return replace(comparison, recording=_name(path))


def read_motion(path: str | Path, scene: Scene) -> Recorded:
    """
    Read a motion, with attitudes and angular velocities, from a recording or a CSV file.

    Raises
    ------
    InputError
        The file cannot be read; it contains neither the two topics of a replay, /attitude and
        /angular_velocity, nor a single topic or the columns with both attitudes and angular
        velocities; or the two topics of a replay have different stamps.

    """
    topics = recording.topics(path, (messages.QUATERNION, messages.VECTOR3))
    measured = partial(read_measured, path, body_frame=scene.body_frame,
                       space_frame=scene.space_frame)
    if ATTITUDE in topics and ANGULAR_VELOCITY in topics:
        attitude, rates = measured(ATTITUDE), measured(ANGULAR_VELOCITY)
        if not np.array_equal(attitude.stamps_ns, rates.stamps_ns):
            raise InputError(f'{path}: expected the same stamps on {ATTITUDE} and '
                             f'{ANGULAR_VELOCITY}, found others')
        return Recorded(replace(attitude, angular_velocity=rates.angular_velocity))
    motion = measured()
    if motion.attitude is None or motion.angular_velocity is None:
        raise InputError(f'{path}: {motion.topic}: expected a motion with attitude and angular '
                         'velocity, found one of them')
    return Recorded(motion)


def write(path: str | Path, comparison: Comparison, body_frame: str) -> None:
    """
    Write the errors and the residual torque of a comparison to a recording.

    Parameters
    ----------
    path : str or Path
        The recording to write: an MCAP file if the name ends in .mcap, otherwise a new rosbag2
        folder.
    comparison : Comparison
        The comparison. Messages are stamped with the clock of the motion, and all sensors share
        the same error topics.
    body_frame : str
        The frame_id of all messages.

    Raises
    ------
    InputError
        The recording cannot be written.

    """
    with writer_of(path) as writer:
        for topic in (ATTITUDE_ERROR, RATE_ERROR):
            writer.add_topic(topic, messages.VECTOR3)
        writer.add_topic(RESIDUAL_TORQUE, messages.WRENCH)
        writer.add_metadata(NAME, {'fingerprint': json.dumps(fingerprint()),
                                   'alignment': json.dumps(comparison.alignment.as_dict()),
                                   'alignments': json.dumps(comparison.of_sensors)})
        for errors in comparison.errors:
            writer.write_columns(errors.times_ns, [
                Column(topic, body_frame, values) for topic, values
                in ((ATTITUDE_ERROR, errors.rotation_vectors), (RATE_ERROR, errors.rates))
                if values is not None])
        if torque := comparison.residual_torque:
            values = np.hstack([np.zeros_like(torque.torques), torque.torques])
            writer.write_columns(torque.times_ns, [Column(RESIDUAL_TORQUE, body_frame, values)])
