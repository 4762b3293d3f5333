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

"""Why runs failed: messages that differ only in their numbers count as one cause."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import zip_longest
import re

from rigid_body_ros.common.errors import CUT

#: A number that is not part of a word or of a unit such as 'kg m^2'.
_NUMBER = re.compile(r'(?<![\w^.])[-+]?(?:\d+\.?\d*(?:e[-+]?\d+)?|inf|nan)(?![\w^])')
#: Placeholder for a number that differs between messages, and a pattern for several
#: placeholders in a list.
_OTHER = '...'
_OTHERS = re.compile(r'\.\.\.(, \.\.\.)+')


def causes(messages: Iterable[str]) -> dict[str, int]:
    """
    Return the number of messages of each cause, in the order in which the causes first occur.

    A cause is a text in which '...' replaces the numbers that differ between messages.
    """
    counts: dict[str, int] = {}
    common: dict[str, list[str]] = {}
    for message in messages:
        text = message.partition(CUT)[0]  # ignore the end of a message that was shortened
        pattern, numbers = _NUMBER.sub('\0', text), _NUMBER.findall(text)
        counts[pattern] = counts.get(pattern, 0) + 1
        common[pattern] = [one if one == other else _OTHER for one, other in
                           zip(common.get(pattern, numbers), numbers)]
    found: dict[str, int] = {}
    for pattern, count in counts.items():  # merge messages with lists of different lengths
        cause = _OTHERS.sub(_OTHER, _filled(pattern, common[pattern]))
        found[cause] = found.get(cause, 0) + count
    return found


def _filled(pattern: str, numbers: Iterable[str]) -> str:
    pieces = zip_longest(pattern.split('\0'), numbers, fillvalue='')
    return ''.join(text + number for text, number in pieces)
