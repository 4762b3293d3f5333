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

"""Account for the samples of a topic: each of them is used, or counted and named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.scene.scene import UNIT

#: If more than this fraction of the samples is lost, no cause is named from the rest.
_LOST = 0.01
#: A step back of the stamps is a change of the clock, not a sample that arrived late, unless the
#: stamps make up for more than this fraction of the step.
_MADE_UP = 0.5
#: At least this many stamps before and after a step decide what it is.
_AROUND = 64
#: A note about a frame_id such as /base_link, as in ROS 1.
SLASH = 'the leading slash of a frame_id is ignored'
_Stamps = NDArray[np.int64]


@dataclass
class Account:
    """
    What became of the samples of one topic.

    Attributes
    ----------
    advice : str
        What to do about stamps that cannot be right; '' if there is no other source of stamps.
    samples : int
        The number of samples in the recording.
    rejected : int
        The number of samples without a usable value.
    replaced : int
        The number of samples that are not used because a later sample has the same stamp.
    steps : list of tuple
        The number of the sample, and the size in ns, of each step back of the clock of the stamps.
        Samples that only arrive late do not count; they are sorted.
    notes : list of str
        What was converted, assumed or left out.
    doubts : list of str
        Other warnings about the samples.
    parts : mapping of str to Account
        The account of each topic, if there are several.

    """

    advice: str = ' (--time-source log uses the times of the recording)'
    samples: int = 0
    rejected: int = 0
    replaced: int = 0
    steps: list[tuple[int, int]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    parts: Mapping[str, Account] = field(default_factory=dict)
    #: The last stamps, the latest one, how many were not later than those before, and the number
    #: of the first sample that is replaced.
    _held: _Stamps = field(default_factory=lambda: np.empty(0, np.int64), repr=False)
    _latest_ns: int = field(default=-2 ** 63, repr=False)
    _not_later: int = field(default=0, repr=False)
    _first_repeated: int = field(default=0, repr=False)

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers and texts as JSON types."""
        return {'samples': self.samples, 'rejected': self.rejected, 'replaced': self.replaced,
                'steps_back': len(self.steps), 'faults': self.faults, 'notes': self.notes}

    def add(self, stamps_ns: _Stamps, rejected: int = 0) -> None:
        """
        Count the next block of samples.

        `stamps_ns` are the stamps of those that are not rejected, in the order of the recording.
        """
        earlier = self.samples - len(self._held)
        self.samples += len(stamps_ns) + rejected
        self.rejected += rejected
        is_open = self.steps and self.steps[-1][0] > earlier
        since = np.append(self._latest_ns, stamps_ns)
        if not is_open and (since[1:] > since[:-1]).all():  # as nearly always
            self._held = stamps_ns if len(stamps_ns) >= 2 * _AROUND else \
                np.concatenate([self._held, stamps_ns])[-2 * _AROUND:]
            self._latest_ns = int(since[-1])
            return
        stamps = np.concatenate([self._held, stamps_ns])
        # Whether a stamp steps back or only arrives late, the next block may decide.
        decided = len(self._held) // 2
        self.steps = [step for step in self.steps if step[0] <= earlier + decided + 1] + [
            (earlier + row + 1, size_ns) for row, size_ns in _steps_back(stamps) if row > decided]
        latest = np.maximum.accumulate(since)
        self._not_later += int(np.sum(stamps_ns <= latest[:-1]))
        repeated = _repeated(stamps)
        if repeated.size and not self._first_repeated:
            self._first_repeated = earlier + int(repeated.min()) + 1
        self.replaced += len(repeated) - len(_repeated(self._held))
        self._held, self._latest_ns = stamps[-2 * max(len(stamps_ns), _AROUND):], int(latest[-1])

    def check_norms(self, norms: Floats) -> None:
        """Name quaternions whose norms, shape (n,), are not 1."""
        wrong = norms[np.abs(norms - 1.0) > UNIT]
        if len(wrong) > _LOST * len(norms):
            self.doubts.append(
                f'{len(wrong)} of {len(norms)} quaternions do not have norm 1; the worst has norm '
                f'{wrong[np.argmax(np.abs(wrong - 1.0))]:.6g}: they are normalised, but are they '
                'rotations?')

    @property
    def faults(self) -> list[str]:
        """
        Return warnings about samples that are lost or doubtful.

        While there are any, no cause of an error can be inferred.
        """
        if self.parts:
            return [f'{name}: {text}' for name, part in self.parts.items() for text in part.faults]
        texts = [*self.doubts]
        if self.rejected > _LOST * self.samples:
            texts.append(f'{self.rejected} of {self.samples} samples are rejected: expected '
                         'finite values, of a possible size')
        repeated = f'{self.replaced} of {self.samples} samples have the same stamp as a later ' \
                   f'one, which replaces them; the first is sample {self._first_repeated}'
        if self.steps:  # samples of two times are mixed, or those before and after do not fit
            number, size_ns = self.steps[0]
            apart = max(min(step, self.samples - step) for step, _ in self.steps)
            more = f', and {len(self.steps) - 1} more times' if len(self.steps) > 1 else ''
            lost, text = max(self._not_later, apart), (
                f'the stamps go back by {size_ns * 1e-9:.6g} s at sample {number}{more}: was the '
                f'clock set, or do two publishers use the topic?{self.advice}'
                + f' {repeated}' * bool(self.replaced))
        else:
            lost, text = self.replaced, f'{repeated}: are the stamps rounded, or do two ' \
                f'publishers use the topic?{self.advice}'
        return [*texts, text] if lost > _LOST * self.samples else texts

    @property
    def counted(self) -> str:
        """Return the numbers as text, or '' if all samples are used as they were recorded."""
        late = 0 if self.steps else self._not_later - self.replaced
        counts = [f'{count} {what}' for count, what in (
            (self.rejected, 'rejected'), (self.replaced, 'replaced by a later one of that stamp'),
            (late, 'late and sorted'), (len(self.steps), 'at which the clock goes back')) if count]
        used = self.samples - self.rejected - self.replaced
        return f'{used} of {self.samples} samples are used: {", ".join(counts)}' if counts else ''


def merged(accounts: Mapping[str, Account]) -> Account:
    """Return one account for several topics, by name; faults and notes then name the topic."""
    if len(accounts) == 1:
        return next(iter(accounts.values()))
    total = Account(parts=accounts)
    for topic, account in accounts.items():
        for name in ('samples', 'rejected', 'replaced', 'steps', '_not_later'):
            setattr(total, name, getattr(total, name) + getattr(account, name))
        total.notes += [f'{topic}: {text}' for text in account.notes]
    return total


def _repeated(stamps_ns: _Stamps) -> NDArray[np.intp]:
    """Return the indices of the stamps that a later stamp repeats."""
    order = np.argsort(stamps_ns, kind='stable')
    return order[:-1][np.diff(stamps_ns[order]) == 0]


def _steps_back(stamps_ns: _Stamps) -> list[tuple[int, int]]:
    """Return the index and the size, ns, of each step back of the clock of the stamps."""
    steps = np.diff(stamps_ns)
    back = np.flatnonzero(steps < 0) + 1
    if not back.size:
        return []
    sizes, period = -steps[back - 1], max(float(np.median(np.abs(steps[steps != 0]))), 1.0)
    # A sample that arrives late leaves a gap in the stamps before it or after it, which makes up
    # for the step.
    around = np.minimum(sizes / period, len(stamps_ns)).astype(np.intp) + 3
    first = np.maximum(back - 1 - around, 0)
    last = np.minimum(back + around, len(stamps_ns) - 1)
    passed = np.maximum(stamps_ns[last - 1], stamps_ns[last]) - stamps_ns[first]
    is_step = passed < (last - first) * period - _MADE_UP * sizes
    return [*zip(back[is_step].tolist(), (sizes[is_step] + round(period)).tolist())]
