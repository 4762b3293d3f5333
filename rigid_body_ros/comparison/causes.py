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
Likely causes of the errors of a comparison.

Each is tried: undone, it must leave less than half of the median error. Of those that do about as
well as the best, the simplest is named.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import permutations, product
import math
from typing import Any, NamedTuple

import numpy as np
from rigid_body_ros.common.arrays import entries, Floats, symmetric, written
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.comparison.align import CLOCK, MOUNT
from rigid_body_ros.comparison.errors import compared, Comparison
from rigid_body_ros.comparison.motion import Motion
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.fields import UniformField
from rigid_body_ros.propagation import Problem
from rigid_body_ros.runtime.terminal import no_progress, Track
from rigid_body_ros.sensing.measured import Measured
from rigid_body_ros.sensing.residual_torque import ResidualTorque

#: Part of the median error that may be left when a cause is undone.
_LEFT = 0.5
#: Causes whose error is this much larger than the least count as equally good.
_ABOUT = 1.5
#: Median errors, rad or rad/s, below which there is nothing to explain.
_NOTHING = 1e-7
#: Median errors below this, in rad or as a part of the angular velocity, can be noise.
_SMALL = 0.1
#: Number of samples of a sensor that an alignment uses.
_SAMPLES = 400
_DEGREES = 'the measured angular velocity is in degrees per second; expected rad/s'
#: rad; a rotation this close to one that swaps axes is described as that.
_NEAR = 0.09
ATTITUDE, RATE = 'rotation_vectors', 'rates'
_UNITS = {ATTITUDE: 'rad', RATE: 'rad/s'}


@dataclass(frozen=True)
class Cause:
    """
    A likely cause of the errors.

    Attributes
    ----------
    name : str
        'constant_rotation', 'quaternion_order', 'inverse_quaternion', 'degrees', 'clock_offset',
        'torque_axes', 'torque_scale' or 'inertia'.
    text : str
        The cause in words.
    before, after : float
        Median error as it is, and with the cause undone, in `unit`.
    unit : str
        'rad' of the attitude or 'rad/s' of the angular velocity.

    """

    name: str
    text: str
    before: float
    after: float
    unit: str

    @property
    def evidence(self) -> str:
        """Return what undoing the cause changes."""
        return f'without it the median error is {self.after:.2g} {self.unit}, ' \
               f'not {self.before:.2g} {self.unit}'

    def as_dict(self) -> dict[str, Any]:
        """Return the cause as JSON types."""
        return {'cause': self.name, 'text': self.text, 'evidence': self.evidence,
                'median_error': self.before, 'median_error_without_it': self.after,
                'unit': self.unit}


@dataclass(frozen=True, eq=False)
class _Trial:
    """A cause, undone: a motion, measurements, and what to align besides what the user asked."""

    name: str
    describe: Callable[[Comparison], str] | str
    motion: Motion
    measured: Sequence[Measured]
    align: tuple[str, ...] = ()
    #: What must improve; None: the attitude if it is measured, else the angular velocity.
    judged: str | None = None


def find_causes(motion: Motion, comparison: Comparison, align: Collection[str],
                track: Track = no_progress) -> tuple[Cause, ...]:
    """
    Return the likely causes of errors: none, or one for attitudes and one for angular velocities.

    Parameters
    ----------
    motion : Problem or Recorded
        As it was for `comparison`.
    comparison : Comparison
        With the residual torque.
    align : collection of str
        As it was for `comparison`.
    track : callable, optional
        Wraps the iteration over possible causes, to show progress.

    """
    kinds = [kind for kind in (ATTITUDE, RATE) if comparison.pooled(kind) is not None]
    before = {kind: _median(comparison, kind) for kind in kinds}
    hopeless = {kind: before[kind] < _NOTHING or _is_noise(comparison, kind, before[kind])
                for kind in kinds}
    if all(hopeless.values()):
        return ()
    tried: list[_Tried] = []
    trials = list(_trials(motion, comparison, align))
    for trial in track(trials, len(trials)):
        kind = trial.judged or kinds[0]
        if hopeless[kind]:
            continue
        with suppress(InputError, ValueError):  # the body spins too fast, or nothing overlaps
            undone = compared(trial.motion, trial.measured, {*align, *trial.align}, _SAMPLES)
            text = trial.describe if isinstance(trial.describe, str) else trial.describe(undone)
            cause = Cause(trial.name, text, before[kind], _median(undone, kind), _UNITS[kind])
            rates = RATE in kinds and not trial.judged \
                and _median(undone, RATE) < _LEFT * before[RATE]
            tried.append(_Tried(kind, cause, rates))
    best = [_best([each for each in tried if each.kind == kind]) for kind in kinds]
    if best[0] and best[0].explains_rates:
        best = best[:1]
    return tuple(each.cause for each in best if each)


class _Tried(NamedTuple):
    """A cause, what it is judged by, and whether it explains the angular velocities as well."""

    kind: str
    cause: Cause
    explains_rates: bool


def _best(tried: Sequence[_Tried]) -> _Tried | None:
    """Return the simplest, which comes first, of the causes that explain an error best."""
    good = [each for each in tried if each.cause.after < _LEFT * each.cause.before]
    least = min((each.cause.after for each in good), default=0.0)
    return next((each for each in good if each.cause.after <= _ABOUT * least + _NOTHING), None)


def _median(comparison: Comparison, kind: str) -> float:
    errors = comparison.pooled(kind)
    assert errors is not None
    return float(np.median(np.linalg.norm(errors, axis=1)))


def _is_noise(comparison: Comparison, kind: str, median: float) -> bool:
    """Return whether the errors change so much between samples that no cause explains most."""
    usual = 1.0
    if kind == RATE:
        usual = float(np.median(np.concatenate([np.linalg.norm(sensor.angular_velocity, axis=1)
                                                for sensor in comparison.measured
                                                if sensor.angular_velocity is not None])))
    if median > _SMALL * usual:  # so large that a change between samples can be motion
        return False
    changes = [np.diff(getattr(errors, kind), axis=0) for errors in comparison.of(kind)]
    # The difference of two samples of white noise is sqrt(2) times as large as the noise.
    noise = float(np.median(np.linalg.norm(np.concatenate(changes), axis=1))) / math.sqrt(2.0)
    return _LEFT * median < noise


def _trials(motion: Motion, comparison: Comparison,
            align: Collection[str]) -> Iterator[_Trial]:
    """Generate causes, the simplest first."""
    measured = comparison.measured
    yield from _misread(motion, measured)
    if CLOCK not in align:
        yield _Trial('clock_offset', _clock_text, motion, measured, (CLOCK,))
    if MOUNT not in align:
        yield _Trial('constant_rotation', _rotation_text, motion, measured, (MOUNT,))
        if len({sensor.attitude is not None for sensor in measured}) > 1 or any(
                sensor.attitude is not None and sensor.angular_velocity is not None
                for sensor in measured):
            gyros = [replace(sensor, attitude=None) for sensor in measured
                     if sensor.angular_velocity is not None]
            yield _Trial('constant_rotation', _rotation_text, motion, gyros, (MOUNT,), RATE)
    if isinstance(motion, Problem) and comparison.residual_torque is not None:
        yield from _of_problem(motion, comparison.residual_torque, measured)


def _misread(motion: Motion, measured: Sequence[Measured]) -> Iterator[_Trial]:
    def changed(attitude: Callable[[Floats], Floats] = np.copy, rate: float = 1.0
                ) -> list[Measured]:
        return [replace(
            sensor, attitude=None if sensor.attitude is None else attitude(sensor.attitude),
            angular_velocity=None if sensor.angular_velocity is None
            else rate * sensor.angular_velocity) for sensor in measured]
    if not any(sensor.attitude is not None for sensor in measured):
        yield _Trial('degrees', _DEGREES, motion, changed(rate=math.pi / 180.0))
        return
    yield _Trial('quaternion_order', 'the measured quaternions are in the order w x y '
                 'z; expected x y z w', motion, changed(lambda q: np.roll(q, -1, axis=1)),
                 judged=ATTITUDE)
    yield _Trial('inverse_quaternion', 'the measured quaternions are the inverse ones: '
                 'from space to body axes; expected body to space', motion,
                 changed(so3.conjugate), judged=ATTITUDE)
    if any(sensor.angular_velocity is not None for sensor in measured):
        yield _Trial('degrees', _DEGREES, motion, changed(rate=math.pi / 180.0), judged=RATE)


def _of_problem(problem: Problem, residual: ResidualTorque, measured: Sequence[Measured]
                ) -> Iterator[_Trial]:
    """Generate causes in the problem: its torque and its inertia."""
    needed = residual.torques + residual.logged
    logged = residual.logged
    if logged.any():
        turn = _best_axes(logged, needed)
        if not np.array_equal(turn, np.eye(3)):
            yield _Trial('torque_axes', 'the logged torque has swapped or reversed '
                         f'axes: {_axes_text(turn)}', _with_torque(problem, turn), measured)
        scale = _slope(logged.ravel(), needed.ravel())
        if scale > 0.0:
            yield _Trial('torque_scale', f'the torque is {scale:.4g} times the logged '
                         'one', _with_torque(problem, scale * np.eye(3)), measured)
    inertia = _inertia(problem, residual)
    if inertia is not None:
        yield _Trial('inertia', 'the inertia: ixx iyy izz ixy ixz iyz = '
                     f'{written(entries(inertia.inertia))} kg m^2 explains the growth of the '
                     'error; fit it with attitude_identify', problem.replaced(body=inertia),
                     measured)


def _best_axes(logged: Floats, needed: Floats) -> Floats:
    """Return the signed permutation of axes that turns the logged torques into those needed."""
    best, least = np.eye(3), math.inf
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.diag(signs) @ np.eye(3)[list(order)]
            left = float(np.median(np.linalg.norm(needed - logged @ turn.T, axis=1)))
            if left < least * (1.0 - 1e-9):
                best, least = turn, left
    return best


def _slope(x: Floats, y: Floats) -> float:
    """Return k of y = k x, with less weight on outliers."""
    weights = np.ones(len(x))
    for _ in range(10):
        slope = float(np.sum(weights * x * y) / max(np.sum(weights * x * x), 1e-300))
        left = np.abs(y - slope * x)
        weights = 1.0 / np.maximum(left / max(2.0 * float(np.median(left)), 1e-300), 1.0)
    return slope


def _inertia(problem: Problem, residual: ResidualTorque) -> RigidBody | None:
    """Return the body whose inertia needs the least residual torque; None if there is none."""
    own = entries(problem.body.inertia)
    # What the inertia must explain: its own torque now, less what is left over.
    target = np.einsum('nak,k->na', residual.of_inertia, own) - residual.torques
    rows, values = residual.of_inertia.reshape(-1, 6), target.ravel()
    known = residual.logged.any() or any(isinstance(one, UniformField) for one in problem.fields)
    if not known:  # only ratios are determined: keep the trace
        free = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
        scale = np.abs(rows).max() or 1.0
        rows = np.vstack([rows, scale * len(rows) * free])
        values = np.append(values, scale * len(values) * own[:3].sum())
    weights = np.ones(len(values))
    for _ in range(10):
        fitted = np.linalg.lstsq(weights[:, None] * rows, weights * values, rcond=None)[0]
        left = np.abs(values - rows @ fitted)
        weights = 1.0 / np.sqrt(np.maximum(
            left / max(2.0 * float(np.median(left)), 1e-300), 1.0))
    try:
        return RigidBody(symmetric(fitted), problem.body.damping)
    except ValueError:  # no body has that inertia
        return None


def _with_torque(problem: Problem, turn: Floats) -> Problem:
    return problem.replaced(log=[log.with_torques(log.torques @ turn.T) for log in problem.logs])


def _clock_text(comparison: Comparison) -> str:
    offset = comparison.alignment.clock_offset_s
    late = 'early' if offset > 0.0 else 'late'
    return f'the measured stamps are {abs(offset):.4g} s too {late} for the torques; ' \
           '--align clock corrects that'


def _rotation_text(comparison: Comparison) -> str:
    parts, alignment = [], comparison.alignment
    for name, quaternion in (('the axes of the sensor and of the body', alignment.mount),
                             ('the two space axes', alignment.space)):
        if so3.angle_between(quaternion, [0.0, 0.0, 0.0, 1.0]) > 3e-3:
            parts.append(f'{_turn_text(quaternion)} between {name}')
    return f'a constant rotation: {" and ".join(parts) or "too small to name"}; --align mount ' \
           'corrects that'


def _turn_text(quaternion: Floats) -> str:
    vector = so3.log(quaternion)
    angle = float(np.linalg.norm(vector))
    matrix = so3.matrix(quaternion)
    swap = np.round(matrix)
    is_swap = np.array_equal(swap @ swap.T, np.eye(3)) and np.linalg.det(swap) > 0.0
    axis = vector / max(angle, 1e-300)
    if is_swap and so3.angle_between(so3.from_matrix(swap), quaternion) < _NEAR \
            and not np.array_equal(swap, np.eye(3)):
        return f'{math.degrees(angle):.0f} degrees about {written(np.round(axis, 2) + 0.0)}, ' \
               f'which swaps axes ({_axes_text(swap)})'
    return f'{math.degrees(angle):.3g} degrees about {written(np.round(axis, 2) + 0.0)}'


def _axes_text(turn: Floats) -> str:
    """Describe a signed permutation: 'x = -y, y = x, z = z'."""
    parts = []
    for row, name in zip(turn, 'xyz'):
        column = int(np.argmax(np.abs(row)))
        parts.append(f'{name} = {"-" if row[column] < 0.0 else ""}{"xyz"[column]}')
    return ', '.join(parts)
