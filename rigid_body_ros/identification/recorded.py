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

"""Read the recordings of a fit, and write the result as a scene file or a URDF."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
import math
from pathlib import Path
from typing import Any

from rigid_body_ros.common.arrays import ENTRIES, entries
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.identification.result import Identification
from rigid_body_ros.mechanics.fields import UniformField
from rigid_body_ros.mechanics.urdf import robot
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.observed import Measurements, read_observed
from rigid_body_ros.recording.selection import Reading
from rigid_body_ros.scene import Scene
from rigid_body_ros.scene.parameters import FIELDS
from rigid_body_ros.scene.parts import values_of
from rigid_body_ros.scene.quantities import QUANTITIES, split_topic, WEIGHT
from rigid_body_ros.scene.scene import text_of


def read_experiments(paths: Sequence[str | Path], scene: Scene,
                     reading: Reading) -> list[tuple[Problem, Measurements]]:
    """
    Read several recordings, each with `read_observed`, up to the end of its motion.

    Raises
    ------
    InputError
        `read_observed` rejects a recording, or the same measurements appear twice and are
        therefore not independent.

    """
    experiments, names = [], dict[bytes, str]()
    for path in paths:
        problem, measurements = read_observed(path, scene, reading)
        measurements = replace(measurements, sensors=measurements.until_end())
        experiments.append((problem, measurements))
        for sensor in measurements.sensors:
            columns = sensor.stamps_ns, sensor.attitude, sensor.angular_velocity
            digest = sha256(b''.join(column.tobytes() for column in columns
                                     if column is not None)).digest()
            name = f'{path}: {sensor.topic}'
            if digest in names:
                raise InputError(f'{name}: expected measurements of its own, found those of '
                                 f'{names[digest]}')
            names[digest] = name
    return experiments


def fitted_scene(scene: Scene, fit: Identification) -> str:
    """
    Return the text of a scene file with the estimates for the first recording.

    Estimates that cannot be stored in a scene are added as comments. If the estimated initial
    angular speed exceeds the `plausible_speed` of the scene, it becomes the new `plausible_speed`.
    """
    others = [name for name in fit.estimates if _group(name) in QUANTITIES
              and _group(name) not in ('inertia', 'damping', WEIGHT)]
    values, speed = _changed(fit), math.hypot(*fit.starts[0].angular_velocity)
    if 'initial_angular_velocity.x' in fit.estimates and speed > scene.values['plausible_speed']:
        values['plausible_speed'] = speed
    return '\n'.join([*(f'# {line}' for line in _comments(fit, others)), text_of(scene, values)])


def fitted_urdf(scene: Scene, fit: Identification) -> str:
    """
    Return a URDF with the inertia of the fitted body; comments list all other estimates.

    The link is named after the scene parameter `link` or, if that is empty, after `body_frame`
    without `frame_prefix`.
    """
    about = 'the pivot' if any(field.name == WEIGHT for field in _uniform(fit)) else \
        'the centre of mass'
    others = [name for name in fit.estimates if _group(name) != 'inertia']
    comments = [*_comments(fit, others),
                f'inertia about {about}; mass: not known from a rotation, replace it']
    return robot(fit.body.inertia, scene.values['link'] or scene.values['body_frame'], comments)


def _comments(fit: Identification, names: Sequence[str]) -> list[str]:
    """Return comments that list the reasons for the verdict and the named estimates."""
    estimates = [fit.estimates[name] for name in names]
    return ['Fitted by attitude_identify.',
            *(f'{fit.verdict.level}: {reason}' for reason in fit.verdict.reasons),
            *(f'{estimate.name}: {estimate.value!r} {estimate.unit}'.rstrip()
              for estimate in estimates)]


def _group(name: str) -> str:
    """Return the name of the parameter that a component belongs to."""
    return split_topic(name)[0].split('.')[0]


def _uniform(fit: Identification) -> list[UniformField]:
    """Return the named uniform fields."""
    return [field for field in fit.fields if isinstance(field, UniformField) and field.name]


def _changed(fit: Identification) -> dict[str, Any]:
    """
    Return the scene parameters that the fit has estimated.

    The result also contains all parameters of the named uniform fields.
    """
    names = {name.split('.')[0] for name in fit.estimates}
    start = fit.starts[0]
    groups = {
        'inertia': ([f'i{entry}' for entry in ENTRIES], entries(fit.body.inertia)),
        'damping': ([f'd{entry}' for entry in ENTRIES], entries(fit.body.damping)),
        'initial_attitude': ('xyzw', start.attitude),
        'initial_angular_velocity': ('xyz', start.angular_velocity),
        'initial_rotor_momentum': ('xyz', start.rotor_momentum)}
    uniform = _uniform(fit)
    fields: dict[str, Any] = {FIELDS: [field.name for field in uniform]} if uniform else {}
    for field in uniform:
        fields |= values_of(field)
    return {f'{group}.{key}': float(value) for group, (keys, numbers) in groups.items()
            if group in names for key, value in zip(keys, numbers)} | fields
