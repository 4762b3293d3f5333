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
Find likely causes of the errors in a comparison.

The search removes the effect of each possible cause and compares the error that remains with the
measurement noise. If only noise remains, the cause explains the errors. If the error becomes
smaller but still exceeds the noise, the cause is at best part of the explanation.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from rigid_body_ros.common.errors import InputError
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.comparison.channels import ATTITUDE, Channel, channels_of, RATE, UNITS
from rigid_body_ros.comparison.result import compared, Comparison
from rigid_body_ros.comparison.sensor_faults import Fault, faults
from rigid_body_ros.comparison.torque_faults import explanations
from rigid_body_ros.inference.align import START
from rigid_body_ros.inference.motion import Motion
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.runtime.terminal import no_progress, Track

#: A cause that reduces the error but does not fully explain the error is reported only if less
#: than this fraction of the error remains.
_LEFT = 0.5
#: Two causes are equally good if the errors that they leave differ by less than this factor.
_ABOUT = 1.5
#: After a cause is removed, the alignment is fitted again to at most this many samples per sensor.
_SAMPLES = 2000


@dataclass(frozen=True)
class Cause:
    """
    A likely cause of the errors.

    Attributes
    ----------
    name : str
        The name of the fault. Sensor faults are 'quaternion_order', 'inverse_quaternion',
        'degrees', 'clock_offset', 'constant_rotation', 'gyro_bias', 'gyro_scale',
        'gyro_saturation', 'frozen_attitude' and 'flipped_attitude'. Model faults are 'start',
        'torque_axes', 'torque_scale', 'torque_gains', 'torque_bias', 'weight', 'rotor_momentum',
        'damping', 'inertia' and 'inertia_change'.
    text : str
        A description of the cause.
    before, after : float
        The median error before and after the effect of the cause is removed, in `unit`.
    unit : str
        The unit of the error: 'rad' for the attitude, 'rad/s' for the angular velocity, or 'N m'
        for the residual torque.
    topic : str
        The topic of the sensor; empty for a model fault.
    explains : bool
        Whether noise alone can explain the error that remains.

    """

    name: str
    text: str
    before: float
    after: float
    unit: str
    topic: str = ''
    explains: bool = True

    @property
    def evidence(self) -> str:
        """Return a text that tells how much the error drops when the cause is removed."""
        what = 'residual torque' if self.unit == 'N m' else 'error'
        rest = 'which is its noise' if self.explains else 'more than its noise'
        return f'without it the median {what} is {self.after:.2g} {self.unit}, {rest}, not ' \
               f'{self.before:.2g} {self.unit}'

    def as_dict(self) -> dict[str, Any]:
        """Return the cause as values that can be written to a JSON file."""
        return {'cause': self.name, 'topic': self.topic, 'explains': self.explains,
                'text': self.text, 'evidence': self.evidence, 'median_error': self.before,
                'median_error_without_it': self.after, 'unit': self.unit}


class _Tried(NamedTuple):
    """
    A cause that was tried.

    The fields also hold the channels that the cause affects, and the fraction of the error that
    remains when the effect of the cause is removed.
    """

    cause: Cause
    keys: frozenset[tuple[str, str]]
    left: float


def find_causes(motion: Motion, comparison: Comparison, align: Collection[str],
                track: Track = no_progress) -> tuple[Cause, ...]:
    """
    Return the likely causes of the errors.

    At most one cause is returned for each quantity of each sensor, plus at most one for the model.

    Parameters
    ----------
    motion : Problem or Recorded
        The motion before alignment. It begins with the initial state given in the scene.
    comparison : Comparison
        The comparison whose errors and residual torque are to be explained. Errors later than its
        `predictable_s` are ignored.
    align : collection of str
        The names of the alignments that were fitted for `comparison`.
    track : callable, optional
        Wraps the loop over the possible causes to show progress.

    """
    seconds = comparison.predictable_s
    until_ns = NEVER_NS if seconds is None else motion.start.time_ns + round(1e9 * seconds)
    wrong = {one.key: one for one in channels_of(comparison, until_ns) if not one.is_noise}
    if not wrong:
        return ()
    tried = [*_of_sensors(motion, comparison, align, until_ns, wrong, track)]
    open_keys, causes = {*wrong}, []
    for one in sorted((one for one in tried if one.cause.explains),
                      key=lambda one: -len(one.keys)):
        if one.keys <= open_keys:
            causes.append(one.cause)
            open_keys -= one.keys
    if open_keys:
        of_model = [*_of_model(motion, comparison, align, until_ns, wrong)]
        good = [one.cause for one in of_model if one.cause.explains]
        if good:
            return (*causes, good[0])
        causes += _reducing([*tried, *of_model], open_keys)
    return tuple(causes)


def _reducing(tried: Sequence[_Tried], open_keys: set[tuple[str, str]]) -> Iterator[Cause]:
    """
    Generate the causes that leave the smallest errors when they are removed.

    If several causes leave about the same error, the simplest of these causes is preferred.
    """
    while open_keys:
        good = [one for one in tried if one.left < _LEFT and one.keys <= open_keys]
        if not good:
            return
        least = min(one.left for one in good)
        best = next(one for one in good if one.left <= _ABOUT * least)
        yield best.cause
        open_keys -= best.keys


def _of_sensors(motion: Motion, comparison: Comparison, align: Collection[str], until_ns: int,
                wrong: dict[tuple[str, str], Channel], track: Track) -> Iterator[_Tried]:
    jobs: list[tuple[Measured, Fault]] = []
    for sensor, aligned in zip(comparison.measured, comparison.aligned):
        own = [channel for channel in wrong.values() if channel.topic == sensor.topic]
        if own:
            jobs += [(sensor, fault) for fault in faults(
                _narrowed(sensor, own), _narrowed(aligned, own), own, align)]
    for sensor, fault in track(jobs, len(jobs)):
        names = [name for name in align if name.partition('@')[2] in ('', sensor.topic)]
        base = comparison.motion if fault.is_aligned else motion
        # Skip a fault if its removal leaves no overlap between measurements and motion, or makes
        # the body spin too fast.
        with suppress(InputError, ValueError):
            undone = compared(base, [fault.measured], {*names, *fault.align}, _SAMPLES)
            yield from _judged(fault, undone, until_ns, wrong)


def _narrowed(sensor: Measured, channels: Sequence[Channel]) -> Measured:
    """Return a sensor without the quantities that are not in the given channels."""
    kinds = {channel.kind for channel in channels}
    return replace(sensor, attitude=sensor.attitude if ATTITUDE in kinds else None,
                   angular_velocity=sensor.angular_velocity if RATE in kinds else None)


def _judged(fault: Fault, undone: Comparison, until_ns: int,
            wrong: dict[tuple[str, str], Channel]) -> Iterator[_Tried]:
    """Generate a cause from a fault if any quantity that the fault affects can be compared."""
    after = [*channels_of(undone, until_ns)]
    text = f'{fault.measured.topic}: {fault.described(undone.alignments[0])}'
    changed = [one for one in after if _is_of(fault, one)]
    if not changed:
        return
    is_noise = all(one.is_noise for one in changed)
    worst = max(changed, key=lambda one: wrong[one.key].ratio)
    before = wrong[worst.key]
    cause = Cause(fault.name, text, before.median, worst.median, UNITS[worst.kind], worst.topic,
                  is_noise)
    # Compare the median errors as well as the ratios of error to noise, because removing a scale
    # factor also scales the noise.
    left = max(worst.ratio / before.ratio, worst.median / before.median)
    yield _Tried(cause, frozenset(one.key for one in changed), left)


def _is_of(fault: Fault, channel: Channel) -> bool:
    """Return whether a fault affects the quantity that a channel contains."""
    if fault.name in ('quaternion_order', 'inverse_quaternion'):
        return channel.kind == ATTITUDE
    return fault.name != 'degrees' or channel.kind == RATE


def _of_model(motion: Motion, comparison: Comparison, align: Collection[str], until_ns: int,
              wrong: dict[tuple[str, str], Channel]) -> Iterator[_Tried]:
    """Generate the causes in the model, such as a wrong start, torque or inertia."""
    if not isinstance(motion, Problem):
        return
    keys, residual = frozenset(wrong), comparison.residual_torque
    problem = comparison.motion
    assert isinstance(problem, Problem)
    found = explanations(problem, residual, comparison.aligned) if residual else []
    if not found and START not in align:
        with suppress(InputError, ValueError):
            undone = compared(motion, comparison.measured, {*align, START}, _SAMPLES)
            after = {one.key: one for one in channels_of(undone, until_ns)}
            key = max(wrong, key=lambda one: wrong[one].ratio)
            yield _Tried(Cause('start', 'the start of the scene is not that of the motion; '
                               '--align start corrects that', wrong[key].median,
                               after[key].median, UNITS[key[1]], '',
                               all(one.is_noise for one in after.values())), keys,
                         after[key].ratio / wrong[key].ratio)
    for one in sorted(found, key=lambda one: (not one.explains, one.unknowns)):
        yield _Tried(Cause(one.name, one.text, one.before, one.after, 'N m', '', one.explains),
                     keys, one.after / one.before)
