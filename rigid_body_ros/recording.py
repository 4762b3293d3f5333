"""Recordings: torques in, motion out, as MCAP files in the profile of rosbag2."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
import os
from pathlib import Path
from types import TracebackType
from typing import Any
import weakref

from mcap.reader import McapReader, make_reader
from mcap.summary import Summary
from mcap.writer import Writer as McapWriter
import numpy as np
from numpy.typing import NDArray

from rigid_body_ros import messages
from rigid_body_ros.messages import MessageType
from rigid_body_ros.scene import InputError
from rigid_body_ros.so3 import Floats
from rigid_body_ros.torque import TorqueLog

#: Wraps an iterable of so many messages, to show progress.
Track = Callable[[Iterable[Any], int], Iterable[Any]]

#: Ten years, more than a simulation lasts and less than the wall clock shows.
_SIMULATED_NS = 315_576_000 * 10 ** 9
# The QoS that a player offers again: reliable, volatile, keep last 10, in the numbers that
# rosbag2 has read since Humble (later versions also read names).
_QOS = '\n'.join([
    '- history: 1', '  depth: 10', '  reliability: 1', '  durability: 2',
    '  deadline:', '    sec: 9223372036', '    nsec: 854775807',
    '  lifespan:', '    sec: 9223372036', '    nsec: 854775807',
    '  liveliness: 1',
    '  liveliness_lease_duration:', '    sec: 9223372036', '    nsec: 854775807',
    '  avoid_ros_namespace_conventions: false',
])


@dataclass(frozen=True, eq=False)
class Messages:
    """
    All messages of a topic, in the order of the file.

    Attributes
    ----------
    topic : str
    stamps_ns : array of int64, shape (n,)
        From the headers.
    frame_ids : list of n str
    values : array, shape (n, d)
        The doubles of each message in field order.

    """

    topic: str
    stamps_ns: NDArray[np.int64]
    frame_ids: list[str]
    values: Floats


def read(path: str | Path, topic: str | None = None, kind: MessageType = messages.WRENCH,
         track: Track = lambda items, total: items) -> Messages:
    """
    Read the messages of a topic.

    Parameters
    ----------
    path : str or Path
        An MCAP file.
    topic : str, optional
        May be left out where only one topic has the type.
    kind : MessageType
    track : callable, optional
        Wraps the iteration over the messages, to show progress.

    Raises
    ------
    InputError
        The file cannot be read or is no MCAP file, has no such topic, one of another type, or
        several that are meant, or a message is not what its type says.

    """
    try:
        with open(path, 'rb') as stream:
            reader, summary = _opened(path, stream)
            topic = _chosen(path, summary, topic, kind)
            total = _count(summary, topic)
            bodies = track(_bodies(path, reader, topic), total)
            decoded = [_decoded(path, topic, number, body, kind)
                       for number, body in enumerate(bodies, 1)]
    except OSError as error:
        raise InputError(f'{path}: cannot read the recording: {error.strerror}') from error
    return Messages(topic, np.array([message.stamp_ns for message in decoded], np.int64),
                    [message.frame_id for message in decoded],
                    np.array([message.values for message in decoded]).reshape(-1, kind.doubles))


def torque_log(path: str | Path, recorded: Messages, body_frame: str, space_frame: str,
               interpolation: str = 'hold') -> TorqueLog:
    """
    Return the log that WrenchStamped messages make: the last one, where it was begun anew.

    Raises
    ------
    InputError
        There is no message, or one has an unknown frame_id, no stamp or a torque that is not
        finite; or frames are mixed where torques are interpolated.

    """
    where = f'{path}: {recorded.topic}'
    if not len(recorded.stamps_ns):
        raise InputError(f'{where}: expected torques, found no message')
    torques = recorded.values[:, 3:]
    for row in np.flatnonzero(~np.isfinite(torques).all(axis=1)):
        raise InputError(f'{where}: message {row + 1} at {recorded.stamps_ns[row]} ns: expected '
                         f'a finite torque, found {torques[row].tolist()}')
    # After the last mark, or the mark itself, zero torque, where nothing came after it.
    first = min(int(np.append(0, new_logs(recorded) + 1)[-1]), len(torques) - 1)
    _check_stamped(where, recorded.stamps_ns, first)
    known: dict[str, str] = {}
    for number, frame_id in enumerate(recorded.frame_ids, 1):
        if frame_id not in known:
            try:
                known[frame_id] = messages.torque_frame(frame_id, body_frame, space_frame)
            except ValueError as error:
                raise InputError(f'{where}: message {number}: {error}') from error
    frames = [known[frame_id] for frame_id in recorded.frame_ids]
    try:
        return TorqueLog(recorded.stamps_ns[first:], torques[first:], frames[first:],
                         interpolation)
    except ValueError as error:
        raise InputError(f'{where}: {error}') from error


def _check_stamped(where: str, stamps_ns: NDArray[np.int64], first: int) -> None:
    """Raise InputError where torques, from row `first` on, have no stamp."""
    unstamped = first + np.flatnonzero(stamps_ns[first:] == 0)
    # Simulated time may begin with 0; it does not reach wall time.
    begins = stamps_ns[first] == 0 < stamps_ns.max() < _SIMULATED_NS
    if unstamped.size and not begins and len(stamps_ns) > 1:
        raise InputError(f'{where}: message {unstamped[0] + 1}: expected a stamp in its header, '
                         f'found 0, as in {np.sum(stamps_ns == 0)} of {len(stamps_ns)} messages')


def new_logs(recorded: Messages) -> NDArray[np.intp]:
    """Return the rows where the log of a node begins anew (see `messages.new_log`)."""
    unnamed = np.array([not frame_id for frame_id in recorded.frame_ids], bool)
    begun = (recorded.stamps_ns == 0) & ~recorded.values.any(axis=1) & unnamed
    return np.flatnonzero(begun[1:]) + 1


class Writer:
    """
    Write an MCAP file that `ros2 bag play`, Foxglove and PlotJuggler take.

    As a context manager. The file gets its name when it is complete; where anything goes wrong
    before, nothing is left and a file of that name stays as it was.

    Raises
    ------
    InputError
        The file cannot be written.

    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        # Where a link leads to, so that the link stays one.
        self._target = Path(os.path.realpath(path))
        self._part = self._target.with_name(f'.{self._target.name[:100]}.{os.getpid()}.part')
        self._channels: dict[str, int] = {}
        self._sequence: dict[str, int] = {}

    def __enter__(self) -> Writer:
        # From before there is a file, and at the latest when Python ends: a signal may come
        # between any two lines.
        self._remove_part = weakref.finalize(self, _remove, self._part)
        try:
            if self._target.exists() and not self._target.is_file():
                kind = 'a folder' if self._target.is_dir() else 'something else'
                raise InputError(f'{self._path}: expected a file to write, found {kind}')
            self._stream = open(self._part, 'wb')
            self._writer = McapWriter(self._stream)
            self._writer.start(profile='ros2', library='rigid_body_ros')
        except OSError as error:
            self._remove_part()
            raise InputError(f'{self._path}: cannot write: {error.strerror}') from error
        return self

    def add_topic(self, topic: str, kind: MessageType) -> None:
        """Announce a topic; to be done once, before its messages."""
        schema = self._writer.register_schema(kind.name, 'ros2msg', kind.definition.encode())
        self._channels[topic] = self._writer.register_channel(
            topic, 'cdr', schema, {'offered_qos_profiles': _QOS})
        self._sequence[topic] = 0

    def write(self, topic: str, time_ns: int, data: bytes) -> None:
        """Append a message in CDR to a topic, logged and published at a time."""
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns,
                                 self._sequence[topic])
        self._sequence[topic] += 1

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        try:
            if error is None:
                self._writer.finish()
                self._stream.close()
                os.replace(self._part, self._target)
        except OSError as failure:
            error = failure
        finally:
            with suppress(OSError):  # closing flushes, which fails again on a full disk
                self._stream.close()
            self._remove_part()
        if isinstance(error, OSError):
            raise InputError(f'{self._path}: cannot write: {error.strerror}') from error


def _remove(part: Path) -> None:
    with suppress(FileNotFoundError, NotADirectoryError):
        part.unlink()


def _opened(path: str | Path, stream: Any) -> tuple[McapReader, Summary]:
    try:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
    except Exception as error:  # on damaged bytes mcap raises a dozen kinds
        raise InputError(f'{path}: expected an MCAP file, complete to its end, found none '
                         f'({_told(error)})') from error
    if summary is None:
        raise InputError(f'{path}: expected an MCAP file with a summary, found none')
    return reader, summary


def _chosen(path: str | Path, summary: Summary, topic: str | None, kind: MessageType) -> str:
    types = {channel.topic: summary.schemas[channel.schema_id].name
             for channel in summary.channels.values() if channel.schema_id in summary.schemas}
    fitting = [name for name, type_name in types.items() if type_name == kind.name]
    if topic is None:
        if len(fitting) != 1:
            raise InputError(f'{path}: expected one topic of {kind.name}, or the name of one '
                             f'with --topic; found {", ".join(fitting) or "none"}')
        return fitting[0]
    if topic not in types:
        raise InputError(f'{path}: no topic {topic}; found {", ".join(types) or "none"}')
    if topic not in fitting:
        raise InputError(f'{path}: {topic}: expected {kind.name}, found {types[topic]}')
    return topic


def _count(summary: Summary, topic: str) -> int:
    counts = summary.statistics.channel_message_counts if summary.statistics else {}
    return sum(counts.get(number, 0) for number, channel in summary.channels.items()
               if channel.topic == topic)


def _bodies(path: str | Path, reader: McapReader, topic: str) -> Iterator[bytes]:
    number = 0
    try:
        # In the order of the file: of equal stamps the later in the file counts.
        for _, channel, message in reader.iter_messages([topic], log_time_order=False):
            number += 1
            if channel.message_encoding != 'cdr':
                raise InputError(f'{path}: {topic}: expected the message encoding cdr, '
                                 f'found {channel.message_encoding!r}')
            yield message.data
    except (InputError, OSError):
        raise
    except Exception as error:
        raise InputError(f'{path}: damaged after {number} messages of {topic} '
                         f'({_told(error)})') from error


def _told(error: Exception) -> str:
    return ' '.join(str(error).split()) or type(error).__name__


def _decoded(path: str | Path, topic: str, number: int, body: bytes,
             kind: MessageType) -> messages.Stamped:
    try:
        return kind.decode(body)
    except ValueError as error:
        raise InputError(f'{path}: {topic}: message {number}: {error}') from error
