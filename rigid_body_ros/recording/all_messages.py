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

"""All messages of an MCAP file or a bag of such files, as they were recorded."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from mcap.records import Channel, Schema
import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.recording.bulk import Raw
from rigid_body_ros.recording.file import full_name
from rigid_body_ros.recording.source import read_all
from rigid_body_ros.recording.writer import Writer


class Topic(NamedTuple):
    """The messages on a topic, in the order of their log times."""

    channel: Channel
    schema: Schema | None
    log_ns: NDArray[np.int64]
    data: Sequence[bytes]

    @property
    def type_name(self) -> str:
        """Return the name of the message type; '' if it is not recorded."""
        return full_name(self.schema.name) if self.schema else ''


class AllMessages:
    """
    All messages of a recording.

    Parameters
    ----------
    path : str or Path
        An MCAP file, or a rosbag2 bag of such files.

    Attributes
    ----------
    path : str or Path
    topics : dict
        The messages of each topic, keyed by the name of the topic.
    span_ns : (int, int)
        The log times of the first and the last message, ns.

    Raises
    ------
    InputError
        The recording cannot be read, is damaged, contains no messages, or has another format.

    """

    def __init__(self, path: str | Path) -> None:
        self.path = path
        blocks: dict[str, list[tuple[Channel, Schema | None, Raw]]] = {}
        for channel, schema, raw in read_all(path):
            blocks.setdefault(channel.topic, []).append((channel, schema, raw))
        if not blocks:
            raise InputError(f'{path}: expected messages, found none')
        self.topics = {topic: _joined(some) for topic, some in sorted(blocks.items())}
        self.span_ns = (min(int(topic.log_ns[0]) for topic in self.topics.values()),
                        max(int(topic.log_ns[-1]) for topic in self.topics.values()))

    def groups(self, inputs: Collection[str],
               step_ns: int = 0) -> Iterator[tuple[int, list[tuple[str, bytes]]]]:
        """
        Generate the messages of some topics, together with all others of the same log time.

        With a `step_ns`, there is a group without messages whenever no message is due for so long.
        """
        order = sorted((time_ns, topic, row) for topic in inputs
                       for row, time_ns in enumerate(self.topics[topic].log_ns.tolist()))
        groups: dict[int, list[tuple[str, bytes]]] = {}
        for time_ns, topic, row in order:
            groups.setdefault(time_ns, []).append((topic, self.topics[topic].data[row]))
        before_ns = min(groups)
        for time_ns, messages in groups.items():
            for between_ns in range(before_ns + step_ns, time_ns, step_ns) if step_ns else ():
                yield between_ns, []
            yield time_ns, messages
            before_ns = time_ns

    def count(self, topic: str, from_ns: int, until_ns: int) -> int:
        """Return how many messages of a topic were logged from one time until before another."""
        first, last = np.searchsorted(self.topics[topic].log_ns, [from_ns, until_ns])
        return int(last - first)

    def write(self, path: str | Path,
              replaced: Mapping[str, Sequence[tuple[int, bytes]]]) -> None:
        """Write the recording with other messages on some topics, each after its log time, ns."""
        with Writer(path) as writer:
            for name, topic in self.topics.items():
                rows = replaced.get(name, [*zip(topic.log_ns.tolist(), topic.data)])
                times_ns = np.array([time_ns for time_ns, _ in rows], np.int64)
                writer.copy(topic.channel, topic.schema, Raw.from_bytes(
                    [data for _, data in rows], times_ns, times_ns))


def _joined(blocks: list[tuple[Channel, Schema | None, Raw]]) -> Topic:
    channel, schema, _ = blocks[0]
    log_ns = np.concatenate([raw.log_ns for _, _, raw in blocks])
    data = [raw.message(row) for _, _, raw in blocks for row in range(len(raw.starts))]
    order = np.argsort(log_ns, kind='stable')
    return Topic(channel, schema, log_ns[order], [data[row] for row in order.tolist()])
