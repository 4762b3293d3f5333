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

"""Compare what a node publishes for recorded inputs with what it published before."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
import pickle
import struct
from typing import Any, NamedTuple

from rigid_body_ros.common.errors import quoted
from rigid_body_ros.recording.all_messages import AllMessages
from rigid_body_ros.regress.processes import Status
from rigid_body_ros.regress.regression import CAUSES, missing, Session, Span, Words
from rigid_body_ros.report.text import lines

#: A function that decodes a message of a topic and a type into its fields, keyed by their paths.
Decode = Callable[[str, str, bytes], Mapping[str, Any]]
#: The log times, ns, and the messages of one topic.
Series = list[tuple[int, bytes]]
_STAMP = 'header.stamp.'


class Difference(NamedTuple):
    """The first difference between two series of messages on a topic."""

    topic: str
    #: The stamp of the message, or the time at which it was recorded if it has none, ns.
    stamp_ns: int
    #: Which message of the topic it is, counted from 0.
    number: int
    #: The path of the field, or '' if only one of the two series has the message.
    field: str
    expected: str
    found: str

    @property
    def text(self) -> str:
        """Describe the difference in one line."""
        field = f', {self.field}' if self.field else ''
        return f'{self.topic} at {self.stamp_ns} ns, message {self.number}{field}: expected ' \
            f'{self.expected}, found {self.found}'


@dataclass(frozen=True)
class OpenLoop:
    """
    A node's command, and the recording that is fed to it.

    Attributes
    ----------
    recorded : AllMessages
    session : Session
        The command, and the function that creates the node that feeds it.
    decode : callable
        Decodes messages, to name the fields that differ.
    tolerances : mapping of str to float
        By how much numbers may differ, keyed by the path of a field or of what contains it, such
        as 'pose.pose', with the topic before it if only one topic is meant, as in
        '/odometry:pose.pose'. Other fields must have the same bits.

    """

    recorded: AllMessages
    session: Session
    decode: Decode
    tolerances: Mapping[str, float]

    def compare(self, folder: Path, key: str) -> Answer:
        """
        Feed the recording to the node, and compare the outputs with those recorded.

        If they differ, the node is run again to find out whether it is reproducible. The runs are
        written to `folder`. `key` is the key that the progress of the inputs has in a `Span`.

        Raises
        ------
        InputError
            `Session.run` raises InputError.

        """
        inputs, outputs = self._run(folder / 'first', key)
        before = {topic: [*zip(self.recorded.topics[topic].log_ns.tolist(),
                               self.recorded.topics[topic].data)] for topic in outputs}
        result = self._compared(inputs, before, outputs)
        if result.is_same:
            return result
        _, others = self._run(folder / 'second', key)
        exact = replace(self, tolerances={})
        return replace(result, ran_twice=True,
                       again=exact._compared(inputs, outputs, others).first)

    def update(self, folder: Path, key: str) -> Answer:
        """Run the node twice, and compare the runs; see `compare`."""
        inputs, outputs = self._run(folder / 'first', key)
        _, others = self._run(folder / 'second', key)
        result = self._compared(inputs, outputs, others)
        return replace(result, ran_twice=True, again=result.first)

    def _run(self, path: Path, key: str) -> tuple[list[str], dict[str, Series]]:
        first_ns, last_ns = self.recorded.span_ns
        self.session.run(path, Span(last_ns - first_ns, {key: last_ns - first_ns}))
        inputs, outputs = pickle.loads(path.read_bytes())
        return inputs, outputs

    def _compared(self, inputs: list[str], expected: Mapping[str, Series],
                  found: Mapping[str, Series]) -> Answer:
        topics = sorted({*expected, *found})
        changes = {topic: [*self._differences(topic, expected.get(topic, []),
                                              found.get(topic, []))] for topic in topics}
        counts = {topic: max(len(expected.get(topic, [])), len(found.get(topic, [])))
                  for topic in topics}
        return Answer(
            {topic: len(self.recorded.topics[topic].data) for topic in inputs},
            {topic: counts[topic] - len(changes[topic]) for topic in topics}, counts, found,
            min((some[0] for some in changes.values() if some),
                key=lambda change: change.stamp_ns, default=None))

    def _differences(self, topic: str, expected: Series, found: Series) -> Iterator[Difference]:
        kind = self.recorded.topics[topic].type_name
        for number, (before, after) in enumerate(zip_longest(expected, found)):
            if before is None or after is None:
                time_ns, data = before or after
                texts = ('no message', 'one') if before is None else ('a message', 'none')
                yield Difference(topic, _stamp_ns(self.decode(topic, kind, data), time_ns),
                                 number, '', *texts)
            elif before[1] != after[1]:
                fields, others = (self.decode(topic, kind, data) for _, data in (before, after))
                for path in {**fields, **others}:
                    values = fields.get(path), others.get(path)
                    if not _agree(*values, self._tolerance(topic, path)):
                        yield Difference(topic, _stamp_ns(fields, before[0]), number, path,
                                         *map(quoted, values))
                        break

    def _tolerance(self, topic: str, path: str) -> float:
        names = f'{topic}:{path}', path
        return max((value for part, value in self.tolerances.items() if any(
            name == part or name.startswith((f'{part}.', f'{part}[')) for name in names)),
            default=0.0)


@dataclass(frozen=True, eq=False)
class Answer:
    """
    The outputs of a node, compared with others.

    Attributes
    ----------
    inputs : dict
        The number of messages on each topic that was fed to the node.
    same, counts : dict
        For each output, how many messages agree, and how many there are.
    messages : dict
        For each output, the log times, ns, and the messages of the last run.
    first : Difference, optional
        The first difference by its stamp; None if all messages agree.
    again : Difference, optional
        The first difference between two runs, if there was a second one.
    ran_twice : bool
        Whether there was a second run.

    """

    inputs: Mapping[str, int]
    same: Mapping[str, int]
    counts: Mapping[str, int]
    messages: Mapping[str, Series]
    first: Difference | None
    again: Difference | None = None
    ran_twice: bool = False

    @property
    def is_same(self) -> bool:
        """Return whether all messages agree."""
        return self.first is None

    @property
    def verdict(self) -> str:
        """Summarize the result in one sentence."""
        if self.again:
            return f'the node is not reproducible: two runs differ from {self.again.stamp_ns} ' \
                   f'ns on, in {self.again.topic}; does it use {CAUSES}?'
        return 'the outputs are the same' if self.is_same else \
            'the outputs differ from the recording'

    def rows(self) -> list[tuple[str, str]]:
        """Return the result as rows to print, each with a name and a text."""
        rows = [('result', self.verdict)]
        rows += [('fed', f'{count} messages on {topic}') for topic, count in self.inputs.items()]
        rows += [('compared', f'{self.same[topic]} of {count} messages on {topic} are the same')
                 for topic, count in self.counts.items()]
        if self.first:
            rows.append(('first', self.first.text))
        if self.ran_twice and not self.again:
            rows.append(('second run', 'is the same as the first'))
        return rows

    def text(self) -> str:
        """Return the result as text, with one fact per line."""
        return lines(f'{name:14}{text}' for name, text in self.rows())

    __str__ = text

    def as_dict(self) -> dict[str, Any]:
        """Return the content of the file that the option --json writes, as JSON types."""
        return {'equal': self.is_same, 'inputs': {**self.inputs},
                'outputs': {topic: {'messages': count, 'same': self.same[topic]}
                            for topic, count in self.counts.items()},
                'first_difference': self.first and self.first._asdict(),
                'reproducible': None if not self.ran_twice else self.again is None}


def _progress(status: Status) -> str:
    if not status.elapsed_ns:
        return f'no node subscribes to one recorded topic and publishes another{missing(status)}'
    return f'its inputs reach {min(status.elapsed_ns.values()) * 1e-9:.9g} s of the recording'


#: What errors call a node and its recording.
WORDS = Words('node', 'recording', _progress)


def _stamp_ns(fields: Mapping[str, Any], time_ns: int) -> int:
    if f'{_STAMP}sec' not in fields:
        return time_ns
    return int(fields[f'{_STAMP}sec'] * 10 ** 9 + fields[f'{_STAMP}nanosec'])


def _agree(expected: Any, found: Any, tolerance: float) -> bool:
    """Return whether two values have the same bits, or differ by at most a tolerance."""
    if isinstance(expected, float) and isinstance(found, float):
        return (struct.pack('<d', expected) == struct.pack('<d', found)
                or (tolerance > 0.0 and abs(expected - found) <= tolerance))
    return bool(type(expected) is type(found) and expected == found)
