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

"""Read the inputs that most commands need: the scene, the torques and the measurements."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from contextlib import suppress
from typing import Any, TYPE_CHECKING

from rigid_body_ros.common.errors import InputError
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.runtime.terminal import progress, report

if TYPE_CHECKING:
    from rigid_body_ros.recording import Logged, Reading, Topics
    from rigid_body_ros.recording.account import Account
    from rigid_body_ros.recording.measured import Measured
    from rigid_body_ros.scene import Scene


def load_scene(options: argparse.Namespace, **values: Any) -> Scene:
    """Load the scene named in the options, and report its notes and warnings."""
    from rigid_body_ros.scene import load
    interrupts.check()  # the import is slow
    scene = load(options.scene, **values)
    for text in scene.notes:
        note(options, f'{options.scene}: {text}')
    for warning in scene.warnings:
        report(f'{options.command}: warning: {options.scene}: {warning}')
    return scene


def note(options: argparse.Namespace, text: str) -> None:
    """Print a note that starts with the name of the command."""
    report(f'{options.command}: note: {text}')


def warn_of_samples(options: argparse.Namespace, path: str, torques: Account | None,
                    measured: Iterable[Measured]) -> None:
    """Warn about samples that are lost or in other frames, and note what was converted."""
    parts = [(sensor.topic, sensor.frames, sensor.account) for sensor in measured]
    for topic, frames, account in [*parts, *([('torques', '', torques)] if torques else [])]:
        for text in filter(None, (frames, *account.faults)):
            report(f'{options.command}: warning: {path}: {topic}: {text}')
        for text in account.notes:
            note(options, f'{path}: {topic}: {text}')


def warn_of_units(options: argparse.Namespace, paths: Iterable[str]) -> None:
    """Warn about torques of PX4, which are not in N m."""
    from rigid_body_ros import messages, recording
    kinds = [kind for kind in messages.PX4_TYPES.values() if kind.like is messages.WRENCH]
    for path in paths:
        with suppress(InputError):  # the command reports the error when it reads the torques
            is_log = recording.is_ulog(path)  # reading it twice would take long
            topics = [] if is_log else recording.topics(path, kinds)
            if is_log or {*topics} & {*(options.topic or topics)}:
                report(f'{options.command}: warning: {path}: the torques of PX4 are normalized, '
                       'not in N m; attitude_identify --estimate start,torque_gains finds their '
                       'gains if the inertia is known')


def length_of(options: argparse.Namespace) -> float | None:
    """
    Return the length of the motion, s, or None if --until is not given.

    Raise InputError if the motion would end before it starts.
    """
    if options.until is None:
        return None
    if options.until <= options.start:
        raise InputError(f'--until: expected more than --from, {options.start:.9g} s, found '
                         f'{options.until:.9g} s')
    return float(options.until - options.start)


def topics_of(options: argparse.Namespace) -> Topics:
    """Return the topics named in the options."""
    from rigid_body_ros import recording
    return recording.Topics.given(
        options.topic, wheel_torque=options.wheel_torque, wheel_momentum=options.wheel_momentum,
        wheel_command=options.wheel_command, inertia=options.inertia, columns=options.columns)


def read_torques(options: argparse.Namespace, scene: Scene, skip: float = 0.0) -> Logged:
    """
    Combine the recording and the scene into a problem; see `recording.chosen`.

    If `skip` is positive, the motion starts `skip` seconds after the first sample.
    """
    from rigid_body_ros import recording
    warn_of_units(options, [options.recording])
    path, topics = options.recording, topics_of(options).found_in(options.recording, scene)
    reading = recording.Reading(topics=topics, start=skip, track=progress('reading', size=len))
    return recording.chosen(path, scene, recording.read_epochs(path, scene, reading))


def reading_of(options: argparse.Namespace) -> Reading:
    """Return a `Reading`, which says which torques and measurements to read, and how."""
    from rigid_body_ros.recording import Reading
    return Reading(tuple(options.measured or ()), topics_of(options), options.interpolation,
                   options.time_source, options.frames and tuple(options.frames),
                   options.start, length_of(options), progress('reading', size=len))


def estimate(text: str) -> tuple[str, ...]:
    """Read the names of parameters to estimate, separated by commas, for use as a `type`."""
    try:
        from rigid_body_ros.inference.coordinates import checked_names
        return checked_names([name.strip() for name in text.split(',')])
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error).removeprefix('estimate: ')) from error


def prior(text: str) -> tuple[str, str]:
    """Read a prior NAME=SIGMA, for use as the `type` of an option."""
    name, equals, sigma = text.partition('=')
    if not (name and equals and sigma):
        raise argparse.ArgumentTypeError(f'expected NAME=SIGMA, found {text!r}')
    return name, sigma
