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
Faults of a recording that no parameter describes: misread channels, axes, and bad samples.

A fault of all samples is found by undoing it: each hypothesis is a recording in which one fault
is undone, and the best of them makes the errors of short windows much smaller. A fault of some
samples shows in the errors of a fit: the samples are frozen, flipped, or at a limit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import permutations, product
import math

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, written
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.inference.errors import of_training, Residuals
from rigid_body_ros.inference.evidence import Suspect
from rigid_body_ros.inference.fit import Solution
from rigid_body_ros.inference.growth import has_lasting_errors, log_misfit, rough, screened
from rigid_body_ros.inference.guess import davenport, guess, IDENTITY, kabsch
from rigid_body_ros.inference.motion import Recorded
from rigid_body_ros.inference.noise import FEWEST, spread_of, tail
from rigid_body_ros.inference.residual_torque import interpolated, measured_rates, residual_torque
from rigid_body_ros.inference.setup import Setup
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.recording.measured import Measured

#: A hypothesis is named only if it makes the errors smaller by at least the factor `_SMALLER` and
#: leaves no lasting errors, or by `_MUCH`. Hypotheses that differ by less than `_ABOUT` are about
#: equally good, and the first one is named.
_SMALLER, _MUCH, _ABOUT = 3.0, 30.0, 1.5
#: Values that differ by less than `_SAME` standard deviations are treated as equal. A sensor is
#: frozen only if the motion changes by `_MOVES` standard deviations in the meantime.
_SAME, _MOVES = 6.0, 30.0
#: A fault of some samples explains the outliers if it explains at least this fraction of them. A
#: gyro may saturate if less than this fraction of its samples are below the largest value.
_MOST = 0.8
#: Smaller clock offsets, s, and mountings, rad, are left to the linear test of a parameter.
_LATE, _TURNED = 0.1, 0.6
#: Samples are frozen where they change by less than this part of their usual change and of their
#: noise, and attitudes are flipped where they change by more than this angle, rad.
_STILL, _JUMP = 0.2, 0.3
#: A sensor may stand still while the motion changes by less than this, rad or rad/s.
_LITTLE = 0.05
#: A rotation that is within this angle of a swap of axes, rad, is described as a swap.
_NEAR = 0.09
#: All signed permutations of three axes; the first one is the identity.
_SWAPS = [np.diag(signs) @ np.eye(3)[list(order)] for order in permutations(range(3))
          for signs in product((1.0, -1.0), repeat=3)]


#: The name and the description of a fault, and the inputs of a fit in which the fault is undone.
_Hypothesis = tuple[str, str, Setup]


def fault_of_all_samples(few: Solution) -> Suspect | None:
    """
    Return the fault that explains why even short windows do not fit, or None.

    Its drop in chi-square is twice the logarithm of the likelihood ratio. The argument is the
    result of `rough`.
    """
    setup = few.problem.setup
    before, tried = log_misfit(screened(setup)), []
    for fault in _faults(setup):
        try:
            after = screened(fault[2])
        except (InputError, ValueError):  # nothing is left to fit, or the motion is too fast
            continue
        if _is_large(fault[0], after) and before - log_misfit(after) > math.log(
                _MUCH if has_lasting_errors(after) else _SMALLER):
            tried.append((log_misfit(after), fault))
    if not tried:
        return None
    least = min(size for size, _ in tried)
    name, text, best = next(fault for size, fault in tried if size <= least + math.log(_ABOUT))
    # A fit of few evaluations may have stopped too early, so fit the best fault as well as `few`.
    if setup.parameters.size and log_misfit(few) - log_misfit(rough(best)) < math.log(_SMALLER):
        return None
    drop = 6.0 * min(map(len, setup.channels[0])) * (before - least)
    return Suspect(name, drop, tail(drop, 1), text=text)


def _is_large(name: str, solution: Solution) -> bool:
    """Return whether a fitted clock offset or mounting is as large as its guess."""
    value = solution.physics.values.get(name)
    guessed = _LATE if name.startswith('clock') else _TURNED
    return value is None or float(np.linalg.norm(value)) >= 0.5 * guessed


def _faults(setup: Setup) -> Iterator[_Hypothesis]:
    """Generate the faults of all samples, beginning with the simplest."""
    topics = dict.fromkeys((channel.topic, channel.is_attitude) for channel in setup.channels[0])
    for topic, is_attitude in topics:
        changes = _of_attitude() if is_attitude else _of_rates(setup, topic)
        for name, text, change in changes:
            yield name, f'{topic}: {text}', _changed(setup, topic, is_attitude, change)
    motion = setup.problems[0]
    if not isinstance(motion, Recorded):
        yield from _of_torques(setup)
    elif motion.source:
        for name, text, change in _of_attitude():
            yield name, f'{motion.source.topic}: {text}', replace(setup, problems=[
                Recorded.of_attitudes(change(motion.source, ()))])
    yield from _of_clock_and_mount(setup, [*dict.fromkeys(topic for topic, _ in topics)])


_Change = Callable[[Measured, Sequence[Measured]], Measured]


def _changed(setup: Setup, topic: str, is_attitude: bool, change: _Change) -> Setup:
    """Return a setup in which one quantity of a topic is changed in all recordings."""
    return replace(setup, channels=[[
        change(channel, channels) if (channel.topic, channel.is_attitude) == (topic, is_attitude)
        else channel for channel in channels] for channels in setup.channels])


def _of_attitude() -> Iterator[tuple[str, str, _Change]]:
    yield 'quaternion_order', 'the quaternions are in the order w, x, y, z; expected x, y, z, w', \
        lambda mocap, _: replace(mocap, attitude=np.roll(mocap.values, -1, axis=1))
    yield 'inverse_quaternion', 'the quaternions map space vectors to body vectors; expected ' \
        'the reverse', lambda mocap, _: replace(mocap, attitude=so3.conjugate(mocap.values))


def _of_rates(setup: Setup, topic: str) -> Iterator[tuple[str, str, _Change]]:
    yield 'degrees', 'the angular velocity is in degrees per second; expected rad/s', \
        lambda gyro, _: replace(gyro, angular_velocity=np.radians(gyro.values))
    yield 'rates_in_space', 'the angular velocity is in space axes; expected body axes', \
        lambda gyro, every: replace(gyro, angular_velocity=so3.rotate(
            so3.conjugate(_attitude_at(gyro, every, setup)), gyro.values))
    first = _channel(setup.channels[0], False, topic)
    assert first is not None
    limit = float(np.abs(first.values).max())
    noise = spread_of(first.stamps_ns, first.values)

    def unsaturated(gyro: Measured) -> Measured:
        return gyro.rows(np.flatnonzero((np.abs(gyro.values) < limit - _SAME * noise).all(axis=1)))
    if FEWEST <= len(unsaturated(first)) < _MOST * len(first):
        yield 'gyro_saturation', f'the gyro saturates at {limit:.4g} rad/s', \
            lambda gyro, _: unsaturated(gyro)
    vectors = _rates_of_both(setup, first)
    if vectors is None:
        return
    swap = _best_swap(*vectors)
    if swap is not None:
        yield 'gyro_axes', f'the gyro has swapped or reversed axes: {_axes_text(swap)}', \
            lambda gyro, _: replace(gyro, angular_velocity=gyro.values @ swap.T)
    if _channel(setup.channels[0], True, topic):  # otherwise, its parameter `mount` describes that
        turn = kabsch(*vectors)
        yield 'gyro_mount', f'the gyro is turned by {_turn_text(turn)}', \
            lambda gyro, _: replace(gyro, angular_velocity=so3.rotate(turn, gyro.values))


def _channel(channels: Sequence[Measured], is_attitude: bool, topic: str = '') -> Measured | None:
    """Return the first channel with attitudes or rates, of any topic or of one."""
    return next((channel for channel in channels if channel.is_attitude is is_attitude
                 and topic in ('', channel.topic)), None)


def _attitude_at(rates: Measured, channels: Sequence[Measured], setup: Setup) -> Floats:
    """Return the attitude at each sample: measured, or integrated from rates in space axes."""
    motion, attitudes = setup.problems[0], _channel(channels, True)
    if isinstance(motion, Recorded):
        return motion.propagate(at=rates.stamps_ns).attitude
    if attitudes is not None:
        return interpolated(attitudes.stamps_ns, attitudes.values, rates.stamps_ns)
    steps = 1e-9 * np.diff(rates.stamps_ns)[:, None]
    turns = so3.exp(0.5 * steps * (rates.values[:-1] + rates.values[1:]))
    return so3.multiply(_accumulated(turns), setup.problems[0].start.attitude)


def _accumulated(turns: Floats) -> Floats:
    """Return the products 1, t[0], t[1] t[0], ... of rotations, shape (n + 1, 4)."""
    result = np.concatenate([[IDENTITY], turns])
    step = 1
    while step < len(result):
        result[step:] = so3.multiply(result[step:], result[:-step])
        step *= 2
    return result


def _rates_of_both(setup: Setup, gyro: Measured) -> tuple[Floats, Floats] | None:
    """Return the angular velocities of a gyro, and of the attitudes; None without attitudes."""
    motion, attitude = setup.problems[0], _channel(setup.channels[0], True)
    if isinstance(motion, Recorded):
        return gyro.values, motion.propagate(at=gyro.stamps_ns).angular_velocity
    if attitude is None:
        return None
    stamps_ns, expected = measured_rates(attitude)
    seen = np.stack([np.interp(stamps_ns - stamps_ns[0], gyro.stamps_ns - stamps_ns[0], column)
                     for column in gyro.values.T], axis=1)
    return seen, expected


def _best_swap(vectors: Floats, targets: Floats, of_inertia: Floats | None = None
               ) -> Floats | None:
    """
    Return the signed permutation of axes that best maps vectors to targets; None for the identity.

    With `of_inertia`, shape (n, 3, 6), the targets are the torques of an unknown inertia, per unit
    of its entries.
    """
    matrix = None if of_inertia is None else of_inertia.reshape(-1, 6)

    def left(turn: Floats) -> float:
        errors = targets - vectors @ turn.T
        if matrix is not None:
            flat = (vectors @ turn.T).ravel()
            inertia = np.linalg.lstsq(matrix, flat, rcond=None)[0]
            if inertia[:3].sum() <= 0.0:
                return math.inf
            errors = (flat - matrix @ inertia).reshape(-1, 3)
        return float(np.median(np.linalg.norm(errors, axis=1)))
    sizes = [left(turn) for turn in _SWAPS]
    best = int(np.argmin(sizes))
    return _SWAPS[best] if sizes[best] * _ABOUT < sizes[0] else None


def _of_torques(setup: Setup) -> Iterator[_Hypothesis]:
    logs = [log for log in setup.logs if log.torques.any()]
    if not logs:
        return
    name, text = ('torque_in_body', 'the torque is in body axes, not in space axes') \
        if logs[0].in_space.all() else \
        ('torque_in_space', 'the torque is in space axes, not in body axes')
    yield name, text, _with_logs(setup, lambda log: TorqueLog(
        log.times_ns, log.torques, ~log.in_space, log.interpolation))
    sensor = max(setup.channels[0], key=lambda channel: (not channel.is_attitude, len(channel)))
    residual = residual_torque(setup.problems[0], sensor)
    if residual is None or not residual.logged.any():
        return
    of_inertia = residual.of_inertia if 'inertia' in setup.parameters.groups else None
    turn = _best_swap(residual.logged, residual.logged + residual.torques, of_inertia)
    if turn is not None:
        yield 'torque_axes', f'the torque has swapped or reversed axes: {_axes_text(turn)}', \
            _with_logs(setup, lambda log: log.with_torques(log.torques @ turn.T))


def _with_logs(setup: Setup, change: Callable[[TorqueLog], TorqueLog]) -> Setup:
    return replace(setup, problems=[problem.replaced(log=[*map(change, problem.logs)])
                                    for problem in setup.problems])


def _of_clock_and_mount(setup: Setup, topics: Sequence[str]) -> Iterator[_Hypothesis]:
    """Generate clock offsets and mountings that are too large for a linear test."""
    parameters = setup.parameters
    for topic in topics:
        sensor = next(channel for channel in setup.channels[0] if channel.topic == topic)
        for name, clock, mount in (('clock_offset', True, False), ('mount', False, True)):
            full = f'{name}@{topic}' if len(topics) > 1 else name
            if {name, full} & {*parameters.groups}:
                continue
            (offset, turn, _), = guess(setup.problems[0], [sensor], [clock], [mount])
            if abs(offset) < _LATE and np.linalg.norm(so3.log(turn)) < _TURNED:
                continue
            value, text = (np.array([offset]), _clock_text(offset, setup)) if clock else (
                so3.log(turn), f'the sensor is turned by {_turn_text(turn)}')
            yield full, f'{topic}: {text}', setup.extended(
                parameters.guess.with_value(full, value), [full])


def faults_of_outliers(solution: Solution) -> Iterator[Suspect]:
    """Generate the faults of some samples that explain the outliers of a channel."""
    for part in of_training(solution):
        start_ns = solution.problem.setup.problems[part.recording].start.time_ns
        for name, text, rows in _of_outliers(part, start_ns):
            yield Suspect(name, *part.chi_square(rows), text=text)


def _of_outliers(part: Residuals, start_ns: int) -> Iterator[tuple[str, str, NDArray[np.bool_]]]:
    """Generate the name and the description of each fault, and the samples that it explains."""
    bad, sigma = ~part.inliers, part.noise
    if bad.sum() < FEWEST:
        return
    seconds = 1e-9 * (part.stamps_ns - start_ns)
    apart = so3.angle_between if part.is_attitude else _distance
    still = _still(part.measured, part.computed, sigma, apart)
    if np.mean(still[bad]) > _MOST:
        times = seconds[still]
        name, what = ('attitude', 'attitude') if part.is_attitude \
            else ('rates', 'angular velocity')
        yield f'frozen_{name}', f'{part.topic}: the {what} is frozen in {still.sum()} samples ' \
            f'from {times[0]:.4g} s to {times[-1]:.4g} s after the start', still & bad
    elif np.abs(part.errors).max() <= _MOVES * sigma:
        return
    elif part.is_attitude:
        turns = so3.exp(-part.errors[bad])
        turn = davenport(turns)
        if np.linalg.norm(so3.log(turn)) > _MOVES * sigma and np.mean(
                so3.angle_between(turns, turn) < _SAME * sigma) > _MOST:
            yield 'flipped_attitude', f'{part.topic}: the attitude is flipped in ' \
                f'{bad.sum()} of {len(bad)} samples, first {seconds[bad][0]:.4g} s after ' \
                f'the start: {_turn_text(turn)} about the body', bad
    else:
        values = np.abs(part.measured[np.abs(part.errors) > _SAME * sigma])
        limit, margin = float(np.median(values)), _SAME * sigma
        if np.mean(np.abs(values - limit) < margin) > _MOST and np.mean(
                np.abs(part.measured) > limit + margin) < 1.0 - _MOST:
            yield 'gyro_saturation', f'{part.topic}: the gyro saturates at {limit:.4g} rad/s', bad


def faults_of_samples(motion: Recorded, channels: Sequence[Measured]
                      ) -> Iterator[tuple[str, str]]:
    """Generate faults of some samples of sensors that are compared with each other."""
    gyro, source = _channel(channels, False), motion.source
    for channel in channels:
        states = motion.propagate(at=channel.stamps_ns)
        yield from _frozen(channel, motion, states.attitude if channel.is_attitude
                           else states.angular_velocity)
    if source is None:
        return
    if gyro is not None:  # through which angles it has turned, rad
        spans, start_ns = 1e-9 * np.diff(gyro.stamps_ns), gyro.stamps_ns[0]
        angles = np.cumsum(np.append(0.0, spans * np.linalg.norm(gyro.values[:-1], axis=1)))
        angles = np.interp(source.stamps_ns - start_ns, gyro.stamps_ns - start_ns, angles)
        yield from _frozen(source, motion, so3.exp(angles[:, None] * [1.0, 0.0, 0.0]))
    # A step across a gap may be long.
    spans = 1e-9 * np.diff(source.stamps_ns)
    steps = so3.angle_between(source.values[:-1], source.values[1:])
    jumps = np.flatnonzero(steps > np.maximum(_JUMP, _MOVES * spans * np.median(steps / spans)))
    if jumps.size and np.diff(jumps, prepend=-FEWEST).min() >= FEWEST:  # an outlier jumps back
        seconds = 1e-9 * (source.stamps_ns[jumps[0] + 1] - motion.start.time_ns)
        yield 'flipped_attitude', f'{source.topic}: the attitude jumps {jumps.size} times, ' \
            f'first by {math.degrees(steps[jumps[0]]):.3g} degrees {seconds:.4g} s after the start'


def _frozen(sensor: Measured, motion: Recorded, expected: Floats) -> Iterator[tuple[str, str]]:
    """Generate the longest part in which a sensor stands still although it should measure more."""
    apart = so3.angle_between if sensor.is_attitude else _distance
    steps = apart(sensor.values[:-1], sensor.values[1:])
    seconds = 1e-9 * (sensor.stamps_ns - motion.start.time_ns)
    vectors = so3.log(sensor.values) if sensor.is_attitude else sensor.values
    noise = spread_of(sensor.stamps_ns, vectors, sensor.is_attitude)
    least = _STILL * min(float(np.median(steps)), float(noise.min()))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], steps < least, [0]])))
    first, last = max(edges.reshape(-1, 2).tolist(), key=lambda run: run[1] - run[0],
                      default=(0, 0))
    if last - first < FEWEST:
        return
    values = expected[first:last + 1]
    if apart(values, values[:1]).max() > max(_MOVES * noise.max(), _LITTLE):
        name, what = ('attitude', 'attitude is') if sensor.is_attitude else ('rates', 'rates are')
        yield f'frozen_{name}', f'{sensor.topic}: the {what} frozen from {seconds[first]:.4g} s ' \
            f'to {seconds[last]:.4g} s after the start'


def _distance(first: Floats, second: Floats) -> Floats:
    return np.asarray(np.linalg.norm(first - second, axis=1))


def _still(values: Floats, expected: Floats, sigma: float,
           apart: Callable[[Floats, Floats], Floats]) -> NDArray[np.bool_]:
    """Return a mask of the samples that are constant although the motion changes them."""
    steps = apart(expected[:-1], expected[1:])
    lag = max(1, math.ceil(_MOVES * sigma / max(float(np.median(steps)), 1e-12)))
    still = np.zeros(len(values), bool)
    if lag > len(values) // 4:
        return still
    begins = np.flatnonzero((apart(values[:-lag], values[lag:]) < _SAME * sigma)
                            & (apart(expected[:-lag], expected[lag:]) > 2.0 * _SAME * sigma))
    for begin in begins:  # one by one, since an array of all indices could take gigabytes
        still[begin:begin + lag + 1] = True
    return still


def _clock_text(offset: float, setup: Setup) -> str:
    late = 'early' if offset > 0.0 else 'late'
    source = setup.problems[0].source if isinstance(setup.problems[0], Recorded) else None
    reference = source.topic if source else 'the torques'
    return f'the stamps are {abs(offset):.4g} s too {late} relative to {reference}'


def _turn_text(quaternion: Floats) -> str:
    """Describe a rotation between the axes of a sensor and those of the body."""
    vector = so3.log(quaternion)
    angle = float(np.linalg.norm(vector))
    swap = np.round(so3.matrix(quaternion))
    text = f'{math.degrees(angle):.3g} degrees about ' \
           f'{written(np.round(vector / max(angle, 1e-300), 2) + 0.0)}'
    is_swap = any(np.array_equal(swap, axes) for axes in _SWAPS[1:]) and np.linalg.det(swap) > 0.0
    if is_swap and so3.angle_between(so3.from_matrix(swap), quaternion) < _NEAR:
        text += f', which swaps axes ({_axes_text(swap)})'
    return text


def _axes_text(turn: Floats) -> str:
    """Describe a signed permutation of axes in text such as 'x = -y, y = x, z = z'."""
    columns = np.argmax(np.abs(turn), axis=1)
    return ', '.join(f'{name} = {"-" if row[column] < 0.0 else ""}{"xyz"[column]}'
                     for name, row, column in zip('xyz', turn, columns))
