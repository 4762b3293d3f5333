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

"""The columns of a CSV file: which of them hold time and torque, and in which units."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from decimal import Decimal
import re
from typing import NamedTuple

from rigid_body_ros.common.errors import InputError, quoted

_NEEDED = ('time', 'tx', 'ty', 'tz')
#: Names without a unit; a path of ROS or PlotJuggler may come first: /arm/wrench/torque/x.
_TIME = re.compile(r'(?:.*[/.])?(?:__)?(?:time|timestamp|stamp|t)')
_TORQUE = re.compile(r'(?:.*[/.])?(?:t|(?:wrench_)?torque[/._ ]?)([xyz])')
_IN_BRACKETS = re.compile(r'(.+?)\s*(?:\((.*)\)|\[(.*)\])')
#: ns
_TIME_UNITS = {**dict.fromkeys(('s', 'sec', 'secs', 'second', 'seconds'), 10 ** 9),
               **dict.fromkeys(('ms', 'msec', 'millisecond', 'milliseconds'), 10 ** 6),
               **dict.fromkeys(('us', 'µs', 'μs', 'usec', 'microsecond', 'microseconds'), 10 ** 3),
               **dict.fromkeys(('ns', 'nsec', 'nanosecond', 'nanoseconds'), 1)}
_TORQUE_UNIT = re.compile(r'([numkMµμ]?)N[ *.·⋅_-]?m')
#: Powers of ten.
_PREFIXES = {'': 0, 'n': -9, 'u': -6, 'µ': -6, 'μ': -6, 'm': -3, 'k': 3, 'M': 6}
#: Names that may mean time, torque or its axes: such a column is never ignored.
_DOUBTFUL = re.compile(r'time|stamp|torque|frame|(?<![a-z])(?:(?:nano)?sec(?:ond)?s?|tau|moments?'
                       r'|[tm][xyz]?)(?![a-z])')
#: Characters of a name that is looked at.
_LONGEST = 200
_ACCEPTED = ('expected time, t or stamp (s, ms, us, ns) and tx ty tz or torque_x torque_y '
             'torque_z (N m, mN m, uN m, kN m), with units as in "tx (mN m)" or "time_ms"')


class Columns(NamedTuple):
    """
    Where the numbers of a line are, and their units; by default time (s), tx, ty, tz (N m).

    Attributes
    ----------
    width : int
        Columns of a line.
    places : tuple of int
        The columns of time, tx, ty, tz.
    scales : tuple of int
        The unit of time, ns, and the units of tx, ty, tz as powers of ten, N m.

    """

    width: int = 4
    places: tuple[int, ...] = (0, 1, 2, 3)
    scales: tuple[int, ...] = (10 ** 9, 0, 0, 0)

    def stamp_ns(self, line: Sequence[str], last_ns: int) -> int:
        """Return the time of a line, ns; raise ValueError unless it is from 0 to `last_ns`."""
        # As a decimal: a double does not resolve nanoseconds in this century.
        time_ns = (Decimal(line[self.places[0]]) * self.scales[0]).to_integral_value()
        if not 0 <= time_ns <= last_ns:  # before `int`, which writes out any exponent
            raise ValueError
        return int(time_ns)

    def torque(self, line: Sequence[str]) -> list[float]:
        """Return the torque of a line, N m; raise ValueError if it is not numbers."""
        return [float(Decimal(line[place]).scaleb(scale)) if scale else float(line[place])
                for place, scale in zip(self.places[1:], self.scales[1:])]


def columns(heading: Sequence[str]) -> Columns:
    """
    Return where the columns of a heading are, and their units.

    Columns that clearly hold something else are ignored.

    Raises
    ------
    InputError
        One of time, tx, ty and tz is missing or there twice, or the name or the unit of a column
        is unknown and it may hold one of them.

    """
    found: dict[str, tuple[int, int]] = {}
    for place, text in enumerate(heading):
        name, scale = _meaning(text.lstrip('#') if place == 0 else text)
        if name in found:
            first = heading[found[name][0]]
            raise InputError(f'two columns of {name}: {quoted(first)} and {quoted(text)}; '
                             f'{_ACCEPTED}')
        if name:
            found[name] = place, scale
    for name in _NEEDED:
        if name not in found:
            raise InputError(f'no column of {name}; {_ACCEPTED}, '
                             f'found {quoted(",".join(heading))}')
    places, scales = zip(*(found[name] for name in _NEEDED))
    return Columns(len(heading), places, scales)


def _meaning(text: str) -> tuple[str, int]:
    """Return what a column holds and its unit; '' if it can be ignored."""
    for name, unit in _readings(text.strip()):
        torque = _TORQUE.fullmatch(name.lower())
        if torque and (found := _TORQUE_UNIT.fullmatch(unit or 'Nm')):
            return f't{torque[1]}', _PREFIXES[found[1]]
        if _TIME.fullmatch(name.lower()) and (unit or 's') in _TIME_UNITS:
            return 'time', _TIME_UNITS[unit or 's']
    # The topic of a path may be called torque: /torque/wrench/force/x.
    if len(text) > _LONGEST or _DOUBTFUL.search('.'.join(re.split('[/.]', text.lower())[-2:])):
        raise InputError(f'column {quoted(text)}: unknown name or unit; {_ACCEPTED}')
    return '', 0


def _readings(text: str) -> Iterator[tuple[str, str]]:
    """Generate the ways to read a text as a name and a unit, which may be ''."""
    if len(text) > _LONGEST:
        return
    yield text, ''
    if (brackets := _IN_BRACKETS.fullmatch(text)) and (unit := brackets[2] or brackets[3]):
        yield brackets[1], unit.strip()
    for place, char in enumerate(text):
        if char in '_ ':
            yield text[:place], text[place + 1:]
