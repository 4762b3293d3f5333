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

"""Interpret the heading of a CSV file: find the time and torque columns and their units."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from decimal import Decimal
import re
from typing import NamedTuple

from rigid_body_ros.common.errors import InputError, quoted

_NEEDED = ('time', 'tx', 'ty', 'tz')
#: Patterns for column names without a unit. A path may precede the name, as in /arm/torque/x, a
#: name that PlotJuggler writes.
_TIME = re.compile(r'(?:.*[/.])?(?:__)?(?:time|timestamp|stamp|t)')
_TORQUE = re.compile(r'(?:.*[/.])?(?:t|(?:wrench_)?torque[/._ ]?)([xyz])')
_IN_BRACKETS = re.compile(r'(.+?)\s*(?:\((.*)\)|\[(.*)\])')
#: The recognized units of time, each in ns.
_TIME_UNITS = {**dict.fromkeys(('s', 'sec', 'secs', 'second', 'seconds'), 10 ** 9),
               **dict.fromkeys(('ms', 'msec', 'millisecond', 'milliseconds'), 10 ** 6),
               **dict.fromkeys(('us', 'µs', 'μs', 'usec', 'microsecond', 'microseconds'), 10 ** 3),
               **dict.fromkeys(('ns', 'nsec', 'nanosecond', 'nanoseconds'), 1)}
_TORQUE_UNIT = re.compile(r'([numkMµμ]?)N[ *.·⋅_-]?m')
#: SI prefixes as powers of ten.
_PREFIXES = {'': 0, 'n': -9, 'u': -6, 'µ': -6, 'μ': -6, 'm': -3, 'k': 3, 'M': 6}
#: Names that might refer to a time, a torque or a frame. A column with such a name is never
#: ignored.
_AMBIGUOUS = re.compile(r'time|stamp|torque|frame|(?<![a-z])(?:(?:nano)?sec(?:ond)?s?|tau|moments?'
                        r'|[tm][xyz]?)(?![a-z])')
#: The longest column name that is interpreted, in characters.
_LONGEST = 200
_ACCEPTED = ('expected time, t or stamp (s, ms, us, ns) and tx ty tz or torque_x torque_y '
             'torque_z (N m, mN m, uN m, kN m), with units as in "tx (mN m)" or "time_ms"')


class Columns(NamedTuple):
    """
    The positions and units of the time and torque columns; by default time (s), tx, ty, tz (N m).

    Attributes
    ----------
    width : int
        Number of columns in a line.
    positions : tuple of int
        Indices of the columns that hold time, tx, ty and tz.
    scales : tuple of int
        The unit of time in ns, followed by the units of tx, ty and tz as powers of ten. For
        example, -3 stands for mN m.

    """

    width: int = 4
    positions: tuple[int, ...] = (0, 1, 2, 3)
    scales: tuple[int, ...] = (10 ** 9, 0, 0, 0)

    def stamp_ns(self, line: Sequence[str], last_ns: int) -> int:
        """Return the time in a line, ns; raise ValueError unless it lies in [0, `last_ns`]."""
        # Use Decimal: a double is too coarse to hold today's date to the nanosecond.
        time_ns = (Decimal(line[self.positions[0]]) * self.scales[0]).to_integral_value()
        if not 0 <= time_ns <= last_ns:  # check before `int`, which would expand a huge exponent
            raise ValueError
        return int(time_ns)

    def torque(self, line: Sequence[str]) -> list[float]:
        """Return the torque in a line, N m; raise ValueError unless its components are numbers."""
        return [float(Decimal(line[position]).scaleb(scale)) if scale else float(line[position])
                for position, scale in zip(self.positions[1:], self.scales[1:])]


def columns(heading: Sequence[str]) -> Columns:
    """
    Find the time and torque columns in a heading.

    Columns that clearly hold something else are ignored.

    Raises
    ------
    InputError
        The time, tx, ty or tz column is missing or occurs twice; or a column that might hold one
        of these quantities has an unknown name or unit.

    """
    found: dict[str, tuple[int, int]] = {}
    for position, text in enumerate(heading):
        name, scale = _meaning(text.lstrip('#') if position == 0 else text)
        if name in found:
            first = heading[found[name][0]]
            raise InputError(f'two columns for {name}: {quoted(first)} and {quoted(text)}; '
                             f'{_ACCEPTED}')
        if name:
            found[name] = position, scale
    for name in _NEEDED:
        if name not in found:
            raise InputError(f'no column for {name}; {_ACCEPTED}, '
                             f'found {quoted(",".join(heading))}')
    positions, scales = zip(*(found[name] for name in _NEEDED))
    return Columns(len(heading), positions, scales)


def _meaning(text: str) -> tuple[str, int]:
    """
    Return the quantity in a column and its unit, as in `Columns.scales`.

    The quantity is '' if the column is to be ignored.
    """
    for name, unit in splits(text.strip()):
        torque = _TORQUE.fullmatch(name.lower())
        if torque and (found := _TORQUE_UNIT.fullmatch(unit or 'Nm')):
            return f't{torque[1]}', _PREFIXES[found[1]]
        if scale := time_scale(name, unit):
            return 'time', scale
    # Look only at the last two parts of a path: /torque/wrench/force/x is a force, even though
    # its topic is called torque.
    if len(text) > _LONGEST or _AMBIGUOUS.search('.'.join(re.split('[/.]', text.lower())[-2:])):
        raise InputError(f'column {quoted(text)}: unknown name or unit; {_ACCEPTED}')
    return '', 0


def time_scale(name: str, unit: str) -> int:
    """Return the time unit of a column, ns, or 0 if the column does not hold times."""
    return _TIME_UNITS.get(unit or 's', 0) if _TIME.fullmatch(name.lower()) else 0


def splits(text: str) -> Iterator[tuple[str, str]]:
    """Generate all ways to split a string into a name and a unit; the unit may be ''."""
    if len(text) > _LONGEST:
        return
    yield text, ''
    if (brackets := _IN_BRACKETS.fullmatch(text)) and (unit := brackets[2] or brackets[3]):
        yield brackets[1], unit.strip()
    for position, char in enumerate(text):
        if char in '_ ':
            yield text[:position], text[position + 1:]
