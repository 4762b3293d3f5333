"""Recorded torques in, recorded motion out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from rigid_body_ros import messages, recording, so3
from rigid_body_ros.body import RigidBody, State
from rigid_body_ros.propagate import Trajectory, propagate, warm_up
from rigid_body_ros.scene import InputError, Scene
from rigid_body_ros.so3 import Floats
from rigid_body_ros.torque import INTERPOLATIONS, TorqueLog

ATTITUDE, EULER_ANGLES, ANGULAR_VELOCITY = '/attitude', '/euler_angles', '/angular_velocity'

#: What one run can hold in memory.
_MOST_OUTPUTS = 10 ** 8
#: The balance of work and energy is taken over at most so many pieces of at most this angle, rad.
_PIECES = 200_000
_PIECE_ANGLE = 0.05
_GAUSS_POINTS = 0.5 + 0.1 * np.sqrt(15.0) * np.array([-1.0, 0.0, 1.0])
_GAUSS_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


@dataclass(frozen=True, eq=False)
class Replay:
    """
    A replayed recording.

    Attributes
    ----------
    scene : Scene
    log : TorqueLog
    start : State
    trajectory : Trajectory
        At the output times.
    topic : str
        Where the torques came from.
    messages : int
        How many there were.
    logs : int
        How many logs they make, of which the last was replayed.
    seconds : float
        Time that the propagation took.

    """

    scene: Scene
    log: TorqueLog
    start: State
    trajectory: Trajectory
    topic: str
    messages: int
    logs: int
    seconds: float

    @property
    def timeout_ns(self) -> int:
        """The scene's torque timeout."""
        return round(self.scene.values['torque_timeout'] * 1e9)


def replay(path: str | Path, scene: Scene, *, topic: str | None = None,
           interpolation: str | None = None, rate: float | None = None,
           until: float | None = None) -> Replay:
    """
    Turn the torques of a recording into motion.

    Parameters
    ----------
    path : str or Path
        MCAP file.
    scene : Scene
    topic : str, optional
        May be left out where only one topic has torques.
    interpolation : str, optional
        Instead of the scene's.
    rate : float, optional, Hz
        Of the output; otherwise there is one at every torque stamp from the start on, and at
        `until`.
    until : float, optional, s
        End, counted from the start; otherwise the last stamp.

    Raises
    ------
    InputError
        The recording cannot be read or does not fit the scene.

    """
    recorded, log, start = read(path, scene, topic, interpolation)
    times = output_times(path, log, start.time_ns, rate, until)
    for prepare in bar('kernels, compiled on first use')([warm_up], 1):
        prepare()
    began = time.perf_counter()
    try:
        trajectory = propagate(scene.body, start, log, at=times, **scene.options)
    except ValueError as error:
        raise InputError(f'{path}: {recorded.topic}: {error}') from error
    seconds = time.perf_counter() - began
    return Replay(scene, log, start, trajectory, recorded.topic, len(recorded.stamps_ns),
                  len(recording.new_logs(recorded)) + 1, seconds)


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


def output_times(path: str | Path, log: TorqueLog, start_ns: int, rate: float | None = None,
                 until: float | None = None) -> NDArray[np.int64]:
    """Return when there is output (see `replay`), or raise InputError where there is none."""
    end_ns = int(log.times_ns[-1]) if until is None else start_ns + round(until * 1e9)
    if end_ns > messages.LAST_NS:
        raise InputError(f'--until: expected an end that a ROS stamp can name, before '
                         f'{messages.LAST_NS} ns, found {until} s after {start_ns} ns')
    if end_ns < start_ns:
        raise InputError(f'{path}: the last torque, at {end_ns} ns, lies before the start of the '
                         f'scene, {start_ns} ns')
    if rate is not None:
        count = int((end_ns - start_ns) * 1e-9 * rate * (1.0 + 1e-15)) + 1
        if count > _MOST_OUTPUTS:
            raise InputError(f'--rate: expected at most {_MOST_OUTPUTS} outputs, found {rate} Hz '
                             f'over {(end_ns - start_ns) * 1e-9:.9g} s')
        return start_ns + np.round(np.arange(count) * (1e9 / rate)).astype(np.int64)
    stamps = log.times_ns[(log.times_ns >= start_ns) & (log.times_ns <= end_ns)]
    return np.union1d(stamps, [end_ns])


def write(path: str | Path, result: Replay) -> None:
    """
    Write attitude, Euler angles and angular velocity as a recording.

    Raises
    ------
    InputError
        The file cannot be written; none is left then.

    """
    values = result.scene.values
    space, body = values['space_frame'], values['body_frame']
    trajectory = result.trajectory
    columns = ((ATTITUDE, messages.QUATERNION, space, trajectory.attitude),
               (EULER_ANGLES, messages.VECTOR3, space,
                trajectory.euler_angles(values['euler_sequence'])),
               (ANGULAR_VELOCITY, messages.VECTOR3, body, trajectory.angular_velocity))
    with recording.Writer(path) as writer:
        for topic, kind, _, _ in columns:
            writer.add_topic(topic, kind)
        times = trajectory.times_ns.tolist()
        for row, stamp_ns in enumerate(bar('writing')(times, len(times))):
            for topic, kind, frame, rows in columns:
                writer.write(topic, stamp_ns, kind.encode(stamp_ns, frame, rows[row]))


def plot(path: str | Path, result: Replay, title: str) -> None:
    """
    Draw the motion and its torques into a PNG file.

    Raises
    ------
    InputError
        The file cannot be written.

    """
    from rigid_body_ros import plots  # matplotlib takes longer to load than most replays
    sequence = result.scene.values['euler_sequence']
    try:
        plots.motion(path, result.trajectory, result.log, sequence, title, result.timeout_ns)
    except OSError as error:
        raise InputError(f'{path}: cannot write: {error.strerror}') from error


def summary(result: Replay) -> str:
    """Return what happened, in lines for a person to read."""
    last = _last(result.trajectory)
    sequence = result.scene.values['euler_sequence']
    span = (result.trajectory.times_ns[-1] - result.start.time_ns) * 1e-9
    speed = span / result.seconds
    rows = [
        ('torques', f'{result.messages} on {result.topic}, over '
                    f'{(result.log.times_ns[-1] - result.log.times_ns[0]) * 1e-9:.9g} s'
                    + (f'; the last of {result.logs} epochs' if result.logs > 1 else '')),
        ('between them', _reading(result)),
        ('body', f'{result.scene.body.symmetry}{_excess(result.scene.body)}'),
        *(('solver', text) for text in _solvers(result)),
        ('final state', f'{span:.9g} s after the start'),
        ('  attitude', f'{_numbers(last.attitude)}  (x y z w)'),
        (f'  {sequence}', f'{_numbers(result.trajectory.euler_angles(sequence)[-1])}  rad'),
        ('  body rates', f'{_numbers(last.angular_velocity)}  rad/s'),
        ('check', _drift(result)),
        ('speed', f'{speed:.3g} times real time ({result.seconds:.3g} s)'),
    ]
    return '\n'.join(f'{name:14}{text}' for name, text in rows)


def _solvers(result: Replay) -> list[str]:
    spans: dict[str, int] = {}
    for model in result.trajectory.models:
        name = f'{model.solver} ({model.reason})'
        spans[name] = spans.get(name, 0) + model.end_ns - model.start_ns
    if len(spans) == 1:
        return [*spans]
    return [f'{span_ns * 1e-9:.9g} s by {name}' for name, span_ns in spans.items()]


def bar(label: str, unit: str = ' stamps',
        size: Callable[[Any], int] = lambda item: 1) -> recording.Track:
    """Return what shows the progress through items of some size, where somebody watches."""
    def track(items: Iterable[Any], total: int) -> Iterator[Any]:
        # disable=None: no bar where standard error is no terminal.
        with tqdm(None, label, total, unit=unit, unit_scale=True, leave=False,
                  disable=None) as shown:
            for item in items:
                yield item
                shown.update(size(item))
    return track


def energy_balance(result: Replay) -> tuple[float, float]:
    """
    Compare the work of the torques with the change of the kinetic energy.

    The work is the integral of tau w over time, by Gauss' formula with three points in pieces of
    at most 0.05 rad between the changes of the torque. Its points are whole nanoseconds, which
    limits the comparison to about 1e-10 of a piece.

    Returns
    -------
    imbalance : float
        |work - change of energy|, relative to the largest kinetic energy met.
    seconds : float
        How far from the start that was looked at: there is a limit to the number of pieces.

    """
    edges = _piece_edges(result)
    lengths = np.diff(edges)
    points = edges[:-1, None] + np.round(lengths[:, None] * _GAUSS_POINTS).astype(np.int64)
    times = np.concatenate([points.ravel(), edges[[0, -1]]])
    body, options = result.scene.body, result.scene.options
    motion = propagate(body, result.start, result.log, at=times, **options)
    torque, in_space = result.log.at(times[:-2], result.timeout_ns)
    to_body = so3.conjugate(motion.attitude[:-2])
    torque = np.where(in_space[:, None], so3.rotate(to_body, torque), torque)
    power = np.sum(torque * motion.angular_velocity[:-2], axis=1).reshape(-1, 3)
    work = np.sum(power @ _GAUSS_WEIGHTS * lengths) * 1e-9
    energy = motion.kinetic_energy
    change, scale = energy[-1] - energy[-2], energy.max()
    return (abs(float((work - change) / scale)) if scale else 0.0), \
        float(edges[-1] - edges[0]) * 1e-9


def _last(trajectory: Trajectory) -> State:
    return State(int(trajectory.times_ns[-1]), trajectory.attitude[-1],
                 trajectory.angular_velocity[-1])


def _numbers(values: Floats) -> str:
    return ' '.join(f'{value:.15g}' for value in values)


def _excess(body: RigidBody) -> str:
    if not body.triangle_excess:
        return ''
    return (f' (its largest moment exceeds the sum of the others by {body.triangle_excess:.2g} '
            'of it, which no body has: rounded numbers?)')


def _reading(result: Replay) -> str:
    """How the log is read between its samples, and what another reading would give."""
    log, end = result.log, result.trajectory.times_ns[-1:]
    if np.unique(log.in_space).size > 1:
        return log.interpolation
    frame = 'space' if log.in_space[0] else 'body'
    others = []
    for name in INTERPOLATIONS:
        if name != log.interpolation:
            other = TorqueLog(log.times_ns, log.torques, frame, name)
            try:
                ends = propagate(result.scene.body, result.start, other, at=end,
                                 **result.scene.options)
            except ValueError:  # this reading alone spins the body beyond all bounds
                others.append(f'{name} would spin it up beyond what can be worked out')
                continue
            apart = so3.angle_between(ends.attitude[0], result.trajectory.attitude[-1])
            others.append(f'{name} would end {apart:.2g} rad away')
    return f'{log.interpolation} ({", ".join(others)})'


def _drift(result: Replay) -> str:
    if not result.log.torques.any():
        momentum = result.trajectory.angular_momentum_space
        size = float(np.linalg.norm(momentum[0]))
        drift = float(np.linalg.norm(momentum - momentum[0], axis=1).max())
        return f'space angular momentum drifts by {drift / size if size else drift:.1e} of itself'
    imbalance, seconds = energy_balance(result)
    return (f'work and energy differ by {imbalance:.1e} of the largest energy, '
            f'over {seconds:.9g} s')


def _piece_edges(result: Replay) -> NDArray[np.int64]:
    # Every change of the torque, and so many points between that no piece turns by more.
    changes, _ = result.log.segments(result.timeout_ns)
    start_ns, end_ns = result.start.time_ns, int(result.trajectory.times_ns[-1])
    inside = changes[(changes > start_ns) & (changes < end_ns)]
    edges = np.concatenate([[start_ns], inside, [end_ns]])[:_PIECES + 1]
    lengths = np.diff(edges)
    speed = float(np.linalg.norm(result.trajectory.angular_velocity, axis=1).max())
    counts = np.ceil(lengths * 1e-9 * speed / _PIECE_ANGLE).clip(1, _PIECES).astype(int)
    counts = counts[:np.searchsorted(np.cumsum(counts), _PIECES) + 1]
    lengths = lengths[:len(counts)]
    number = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    offsets = np.round(number / np.repeat(counts, counts) * np.repeat(lengths, counts))
    pieces = np.repeat(edges[:len(counts)], counts) + offsets.astype(np.int64)
    return np.append(pieces, edges[len(counts)])[:_PIECES + 1]
