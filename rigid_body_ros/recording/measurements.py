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

"""Read measured attitudes and angular velocities from a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages, recording
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, listed, quoted, shortened
from rigid_body_ros.mechanics import so3
from rigid_body_ros.messages import MessageType
from rigid_body_ros.propagation.options import FASTEST
from rigid_body_ros.recording import Messages, Source
from rigid_body_ros.recording.measured import FEWEST, Measured
from rigid_body_ros.recording.text_files import is_text_file, read_text_file
from rigid_body_ros.runtime.terminal import no_progress, Track

#: A value whose variance is at least this large, rad^2 or rad^2/s^2, counts as not measured.
_MEANINGLESS = 1e3


class _Values(NamedTuple):
    """Where the values and their covariances are among the doubles of a message."""

    attitude: slice | None = None
    attitude_covariance: slice | None = None
    rate: slice | None = None
    rate_covariance: slice | None = None


_LAYOUTS: dict[MessageType, _Values] = {
    messages.QUATERNION: _Values(slice(0, 4)),
    messages.POSE: _Values(slice(3, 7)),
    messages.POSE_WITH_COVARIANCE: _Values(slice(3, 7), slice(7, 43)),
    messages.TRANSFORM_STAMPED: _Values(slice(3, 7)),
    messages.TRANSFORM: _Values(slice(3, 7)),
    messages.ODOMETRY: _Values(messages.ORIENTATION, slice(7, 43), messages.ANGULAR_VELOCITY,
                               slice(49, 85)),
    messages.IMU: _Values(slice(0, 4), slice(4, 13), slice(13, 16), slice(16, 25)),
    messages.VECTOR3: _Values(rate=slice(0, 3)),
}
#: Message types that a measured topic can have.
KINDS = tuple(_LAYOUTS)
#: Message types that always contain a measured attitude or angular velocity.
_CERTAIN = tuple(kind for kind in KINDS if kind is not messages.VECTOR3)
#: Message types whose frames can be chosen.
_TRANSFORMS = tuple(kind for kind in KINDS if kind.has_child_frame)


def read_measured(path: str | Path, topic: str | None = None, *,
                  frames: tuple[str, str] | None = None, body_frame: str = 'base_link',
                  space_frame: str = 'world', time_source: str = 'header',
                  track: Track = no_progress) -> Measured:
    """
    Read a measured topic: attitudes, angular velocities, or both.

    A message is rejected if its quaternion is zero or not finite, or if its angular velocity is
    not finite or above 1e9 rad/s. A value is treated as not measured if its covariance in an Imu
    message begins with -1, or if one of its variances is at least 1000 rad^2 or 1000 rad^2/s^2. A
    covariance that is zero or not positive definite is treated as unknown.

    Parameters
    ----------
    path : str or Path
        A recording, as for `recording.read`.
    topic : str, optional
        A topic of type QuaternionStamped, PoseStamped, PoseWithCovarianceStamped,
        TransformStamped, TFMessage, Odometry, Imu, or Vector3Stamped (an angular velocity). If no
        topic is given, the recording must contain exactly one topic of these types, not counting
        Vector3Stamped.
    frames : tuple of str, optional
        The parent frame and the child frame of the messages to read, if the topic contains
        transforms or Odometry messages. The default for a TFMessage topic is to read the
        transforms from the space frame to the body frame. The default for a TransformStamped or
        Odometry topic is to read all messages, which must have the same pair of frames.
    body_frame, space_frame : str
        The frames of the scene.
    time_source : str
        Where the stamps come from: 'header', 'log' (the time of recording) or 'publish' (the time
        of publishing).
    track : callable, optional
        A function that wraps the iteration over blocks of messages, to show progress.

    Returns
    -------
    Measured
        The samples, sorted by stamp. If several messages have the same stamp, the last one in the
        recording is used.

    Raises
    ------
    InputError
        The recording cannot be read; the topic is missing, ambiguous or of an unsupported type;
        the messages have several pairs of frames, or none has the requested pair; or the topic
        contains fewer than four usable messages with different stamps.

    """
    topic = topic or _only_topic(path)
    with Source(path, topic, KINDS, time_source) as source:
        kind = source.kind
    if frames and not kind.has_child_frame:
        raise InputError(f'{path}: {source.topic}: --frames: expected a topic of transforms or '
                         f'odometry, found {kind.name}')
    if kind is messages.TRANSFORM:
        frames = frames or (space_frame, body_frame)
    with Source(path, topic, (kind,), time_source, frames=frames) as source:
        blocks = list(track(source, source.count))
        recorded = recording.joined(source.topic, kind, blocks, source.damage)
    where = f'{path}: {recorded.topic}'
    if kind is messages.VECTOR3:
        _check_axes(where, recorded, space_frame)
    if not len(recorded) and frames and kind.has_child_frame:
        raise InputError(f'{where}: expected transforms from {quoted(frames[0])} to '
                         f'{quoted(frames[1])}, found none; choose other frames with --frames')
    return replace(_measured(where, recorded, kind),
                   frames=_other_frames(where, recorded, kind, (space_frame, body_frame)))


def samples(kind: MessageType, values: Floats) -> tuple[Floats, Floats]:
    """
    Extract attitudes and angular velocities from messages, with NaN for unmeasured values.

    Parameters
    ----------
    kind : MessageType
        One of `KINDS`.
    values : array, shape (n, doubles)
        The doubles of the messages.

    Returns
    -------
    attitude : array, shape (n, 4)
        Unit quaternions x, y, z, w.
    angular_velocity : array, shape (n, 3), rad/s

    """
    layout, found = _LAYOUTS[kind], (np.full((len(values), 4), np.nan),
                                     np.full((len(values), 3), np.nan))
    attitude = _given(values, layout.attitude, layout.attitude_covariance, kind, _is_rotation)
    rate = _given(values, layout.rate, layout.rate_covariance, kind, _is_slow)
    if attitude is not None:
        found[0][attitude] = so3.normalize(values[attitude, layout.attitude])
    if rate is not None:
        found[1][rate] = values[rate, layout.rate]
    return found


def _is_rotation(attitude: Floats) -> NDArray[np.bool_]:
    return np.any(attitude != 0.0, axis=1)


def _is_slow(rates: Floats) -> NDArray[np.bool_]:
    return np.all(np.abs(rates) <= FASTEST, axis=1)


def _only_topic(path: str | Path) -> str:
    found = recording.topics(path, _CERTAIN)
    if len(found) != 1:
        advice = '; choose one with --measured' if found else ''
        raise InputError(f'{path}: expected one topic of a measured attitude (QuaternionStamped, '
                         'PoseStamped, PoseWithCovarianceStamped, TransformStamped, TFMessage, '
                         f'Odometry, Imu), found {listed(found)}{advice}')
    return found[0]


def _check_axes(where: str, recorded: Messages, space_frame: str) -> None:
    if space_frame in recorded.names:
        number = int(np.argmax(recorded.frames == recorded.names.index(space_frame))) + 1
        raise InputError(f'{where}: message {number}: frame_id: expected an angular velocity in '
                         f'body axes, found {shortened(quoted(space_frame))} (space axes)')


def _other_frames(where: str, recorded: Messages, kind: MessageType,
                  expected: tuple[str, str]) -> str:
    """
    Describe the frames of messages that differ from the space and body frames of the scene.

    Return an empty string if there are no such frames.
    """
    if kind.has_child_frame:
        pairs = [f'{quoted(parent)} to {quoted(child)}' for parent, child in recorded.pairs]
        if len(pairs) > 1:
            raise InputError(f'{where}: expected one pair of frames, found {listed(pairs)}; '
                             'choose one with --frames')
        same = all(name in ('', frame) for pair in recorded.pairs
                   for name, frame in zip(pair, expected))
        return '' if same else f'expected frames {quoted(expected[0])} to ' \
                               f'{quoted(expected[1])}, found {pairs[0]}'
    frame = expected[kind in (messages.IMU, messages.VECTOR3)]
    others = [quoted(name) for name in recorded.names if name not in ('', frame)]
    return f'expected frame_id {quoted(frame)}, found {listed(others)}' if others else ''


def _measured(where: str, recorded: Messages, kind: MessageType) -> Measured:
    """Return the usable samples of messages, sorted by stamp."""
    layout, values = _LAYOUTS[kind], recorded.values
    attitude = _given(values, layout.attitude, layout.attitude_covariance, kind, _is_rotation)
    rate = _given(values, layout.rate, layout.rate_covariance, kind, _is_slow)
    usable: list[NDArray[np.bool_]] = [
        each for each in (attitude, rate) if each is not None and each.any()]
    rows = np.logical_and.reduce([*usable, np.full(len(recorded), bool(usable))])
    if rows.sum() < FEWEST:
        lost = f' ({recorded.damage})' if recorded.damage else ''
        raise InputError(f'{where}: expected at least {FEWEST} messages with a finite attitude '
                         f'or angular velocity, found {rows.sum()} among {len(recorded)}{lost}')
    order = _ordered(where, recorded.stamps_ns, np.flatnonzero(rows))
    values = values[order]
    has_attitude, has_rate = (each is not None and bool(each.any()) for each in (attitude, rate))
    quaternions = so3.normalize(values[:, layout.attitude]) if has_attitude else None
    fixed_axes = kind in (messages.POSE_WITH_COVARIANCE, messages.ODOMETRY)
    return Measured(
        recorded.topic, recorded.stamps_ns[order], quaternions,
        values[:, layout.rate] if has_rate else None,
        _covariance(values, layout.attitude_covariance, quaternions if fixed_axes else None)
        if has_attitude else None,
        _covariance(values, layout.rate_covariance) if has_rate else None,
        len(recorded) - int(rows.sum()), recorded.damage)


def _given(values: Floats, where: slice | None, covariance: slice | None, kind: MessageType,
           usable: Callable[[Floats], NDArray[np.bool_]]) -> NDArray[np.bool_] | None:
    """
    Return a mask of the messages that contain a usable value.

    Return None if the message type has no field for this value.
    """
    if where is None:
        return None
    found = values[:, where]
    given = np.isfinite(found).all(axis=1) & usable(found)
    if covariance is not None:
        if kind is messages.IMU:
            given &= values[:, covariance.start] != -1.0
        variances = np.diagonal(_block(values[:, covariance]), axis1=1, axis2=2)
        given &= ~(variances >= _MEANINGLESS).any(axis=1)
    return given


def _block(covariances: Floats) -> Floats:
    """Return the rotational (n, 3, 3) parts of covariances with 9 or 36 entries each."""
    size = 3 if covariances.shape[1] == 9 else 6
    return covariances.reshape(-1, size, size)[:, size - 3:, size - 3:]


def _covariance(values: Floats, where: slice | None, to_body: Floats | None = None
                ) -> Floats | None:
    """Return covariances in body axes, or None if any is unknown or not positive definite."""
    if where is None:
        return None
    found = _block(values[:, where])
    if not np.all(np.abs(found) < _MEANINGLESS) \
            or any(np.any(np.linalg.det(found[:, :size, :size]) <= 0.0) for size in (1, 2, 3)):
        return None
    if to_body is None:
        return found
    turn = so3.matrix(to_body)
    return np.asarray(np.swapaxes(turn, 1, 2) @ found @ turn)


def _ordered(where: str, stamps_ns: NDArray[np.int64], rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Sort rows by stamp, keeping only the last of several rows with the same stamp."""
    without = int(np.sum(stamps_ns[rows] == 0))
    if without > 1:
        raise InputError(f'{where}: expected stamps in the headers, found 0 in {without} of '
                         f'{len(rows)} messages; use --time-source log for the times of the '
                         'recording')
    rows = rows[np.argsort(stamps_ns[rows], kind='stable')]
    rows = rows[np.append(np.diff(stamps_ns[rows]) != 0, True)]
    if len(rows) < FEWEST:
        raise InputError(f'{where}: expected at least {FEWEST} different stamps, found '
                         f'{len(rows)}')
    return rows


def read_all(path: str | Path, topics: Iterable[str], **options: Any) -> list[Measured]:
    """
    Read several measured topics, with the options of `read_measured`.

    A topic can also be the name of a text file, which is then read with `read_text_file`.

    Raises
    ------
    InputError
        `read_measured` or `read_text_file` raised this error, or a topic was given twice.

    """
    frames: tuple[str, str] | None = options.pop('frames', None)
    names: list[str | None] = [*topics]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f'--measured: expected each topic once, found {name!r} twice')
    # The frames apply only to those of the given topics whose message type has two frames. If no
    # given topic has such a type, the frames apply to all topics.
    chosen = {*recording.topics(path, _TRANSFORMS)} & {*names} if frames else set()
    return [read_text_file(name) if name and is_text_file(name) else
            read_measured(path, name, frames=frames if name in chosen or not chosen else None,
                          **options) for name in names or [None]]
