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

"""Count the causes of failed runs. Messages that differ only in their numbers have one cause."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import zip_longest
import re

from rigid_body_ros.common.errors import CUT

#: A number, unless it is part of a word or of a unit such as 'kg m^2'.
_NUMBER = re.compile(r'(?<![\w^.])[-+]?(?:\d+\.?\d*(?:e[-+]?\d+)?|inf|nan)(?![\w^])')
#: The placeholder for a number that differs between messages, and a pattern that matches a list of
#: placeholders.
_OTHER = '...'
_OTHERS = re.compile(r'\.\.\.(, \.\.\.)+')


def causes(messages: Iterable[str]) -> dict[str, int]:
    """
    Return the number of messages for each cause, in the order in which the causes first occur.

    A cause is the common text of its messages, with '...' in place of numbers that differ.
    """
    counts: dict[str, int] = {}
    common: dict[str, list[str]] = {}
    for message in messages:
        text = message.partition(CUT)[0]  # if a message was shortened, keep only its beginning
        pattern, numbers = _NUMBER.sub('\0', text), _NUMBER.findall(text)
        counts[pattern] = counts.get(pattern, 0) + 1
        common[pattern] = [one if one == other else _OTHER for one, other in
                           zip(common.get(pattern, numbers), numbers)]
    found: dict[str, int] = {}
    # Merge causes that differ only in the length of a list of numbers.
    for pattern, count in counts.items():
        cause = _OTHERS.sub(_OTHER, _filled(pattern, common[pattern]))
        found[cause] = found.get(cause, 0) + count
    return found


def _filled(pattern: str, numbers: Iterable[str]) -> str:
    pieces = zip_longest(pattern.split('\0'), numbers, fillvalue='')
    return ''.join(text + number for text, number in pieces)
