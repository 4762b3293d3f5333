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

"""Interpret the heading of a table: find the columns of time, torque, attitude and rates."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from decimal import Decimal
import math
import re
from typing import NamedTuple

from rigid_body_ros.common.errors import InputError, listed, quoted

#: The columns of each quantity. Angular velocities are in body axes.
TORQUE = tuple(f't{axis}' for axis in 'xyz')
ATTITUDE = tuple(f'q{axis}' for axis in 'xyzw')
RATES = tuple(f'w{axis}' for axis in 'xyz')
#: The recognized units of time, each in ns.
TIME_UNITS = {**dict.fromkeys(('s', 'sec', 'secs', 'second', 'seconds'), 10 ** 9),
              **dict.fromkeys(('ms', 'msec', 'millisecond', 'milliseconds'), 10 ** 6),
              **dict.fromkeys(('us', 'µs', 'μs', 'usec', 'microsecond', 'microseconds'), 10 ** 3),
              **dict.fromkeys(('ns', 'nsec', 'nanosecond', 'nanoseconds'), 1)}
_RATE_UNITS = {**dict.fromkeys(('', 'rad/s', 'rad s^-1', 'rads', 'rad/sec'), 1.0),
               **dict.fromkeys(('deg/s', 'deg s^-1', 'degs', 'deg/sec', 'degrees/s', '°/s', 'º/s',
                                'dps'), math.radians(1.0))}
_TORQUE_UNIT = re.compile(r'([numkMµμ]?)N[ *.·⋅_-]?m')
#: SI prefixes as powers of ten.
_PREFIXES = {'': 0, 'n': -9, 'u': -6, 'µ': -6, 'μ': -6, 'm': -3, 'k': 3, 'M': 6}
#: Patterns for column names without a unit, in lower case. A path may precede the name, as in
#: /arm/torque/x, a name that PlotJuggler writes. The names that EuRoC files, PX4's tools and
#: telephones use are included.
_PATH, _AXIS = r'(?:.*[/.])?', r'[/._ ]?([xyz])'
#: What the columns x, y and z are, if the name of the file contains one of these words only.
_CALLED = {'torque': 'torque', 'gyro': 'gyro|angular[_ ]?vel|omega|rotation_?rate'}
_TIME = re.compile(_PATH + r'(?:__)?(?:time|timestamp|stamp|t)')
_ATTITUDE = re.compile(_PATH + r'(?:q|quat|quaternion|orientation|attitude|q_rs)[/._ ]?([xyzw])')
_RATE = re.compile(_PATH + r'(?:w|omega|gyro(?:scope|rotation)?|ang_?vel|w_rs_s|rotation_?rate|'
                   r'(?:vehicle_)?angular[_ ]?velocity(?:_groundtruth)?(?:_[0-9])?)' + _AXIS)
_TORQUE = re.compile(_PATH + r'(?:t|(?:(?:wrench_)?torque|vehicle_torque_setpoint(?:_[0-9])?)'
                     r'[/._ ]?)([xyz])')
#: Numbered components: q0 and q[0] are w, as in most libraries with numbered quaternions; xyz[0]
#: is x. PlotJuggler writes q.00.
_NUMBERED = re.compile(r'(.*?)(q|xyz)(?:\[([0-3])\]|[._]?0?([0-3]))')
_IN_BRACKETS = re.compile(r'(.+?)\s*(?:\((.*)\)|\[(.*)\])')
#: Names that might refer to a time, a torque or a frame. In a table of torques, a column with such
#: a name is never ignored.
_AMBIGUOUS = re.compile(r'time|stamp|torque|frame|(?<![a-z])(?:(?:nano)?sec(?:ond)?s?|tau|moments?'
                        r'|[tm][xyz]?)(?![a-z])')
#: The longest column name that is interpreted, in characters.
_LONGEST = 200
_OF_TORQUE = ('expected time, t or stamp (s, ms, us, ns) and tx ty tz or torque_x torque_y '
              'torque_z (N m, mN m, uN m, kN m), with units as in "tx (mN m)" or "time_ms"')
_OF_MOTION = ('expected time (s, ms, us, ns), and qx qy qz qw or wx wy wz (rad/s, deg/s), with '
              'units as in "wx (deg/s)" or "time_ms"')


class TableColumn(NamedTuple):
    """Where a table contains a quantity, and the factor of the column's unit."""

    position: int
    #: The factor is None for a time without a unit.
    factor: Decimal | float | None


def columns_of(heading: Sequence[str], groups: Sequence[tuple[str, ...]], stem: str = '',
               chosen: Mapping[str, str] | None = None) -> dict[str, TableColumn]:
    """
    Find the columns of the time and of some quantities.

    Other columns are ignored, unless the table should contain torques and a name might refer to
    one.

    Parameters
    ----------
    heading : sequence of str
        The first line of the table.
    groups : sequence of tuple of str
        The quantities to find, such as `TORQUE`. At least one of them must be complete.
    stem : str
        The name of the file without its suffix, in lower case; it may tell what the columns x, y
        and z without units contain.
    chosen : mapping of str to str, optional
        For each quantity, with its unit as in a heading, the number of its column, which counts
        from 1, or the name of its column. Then the heading is not interpreted.

    Raises
    ------
    InputError
        A column is missing or occurs twice, or its unit is unknown.

    """
    try:
        return _found(heading, groups, '', chosen)
    except InputError:
        contexts = [name for name, word in _CALLED.items() if re.search(word, stem)]
        with suppress(InputError):
            if len(contexts) == 1:
                return _found(heading, groups, contexts[0], chosen)
        raise


def _found(heading: Sequence[str], groups: Sequence[tuple[str, ...]], context: str,
           chosen: Mapping[str, str] | None) -> dict[str, TableColumn]:
    columns: dict[str, TableColumn] = {}
    accepted = _OF_TORQUE if TORQUE in groups else _OF_MOTION
    for position, text in _chosen(heading, chosen) if chosen else enumerate(heading):
        name, factor = _meaning(text.lstrip('#') if position == 0 else text, groups, context)
        if name in columns:
            raise InputError(f'two columns for {name}: {quoted(heading[columns[name].position])} '
                             f'and {quoted(text)}; choose with --columns; {accepted}')
        if name:
            columns[name] = TableColumn(position, factor)
    given = [group for group in groups if any(name in columns for name in group)]
    for name in ('time', *(name for group in given or groups[:1] for name in group)):
        if name not in columns:
            raise InputError(f'no column for {name}; {accepted}, found '
                             f'{quoted(",".join(heading))}; choose with --columns')
    return columns


def has_any(chosen: Mapping[str, str], groups: Sequence[tuple[str, ...]]) -> bool:
    """Return whether any of `groups` is chosen; raise InputError for an unknown quantity."""
    return not {*map(_quantity, chosen)}.isdisjoint([name for group in groups for name in group])


def _quantity(text: str) -> str:
    """Return the name of a quantity, without its unit; raise InputError if it is not known."""
    for groups in ([TORQUE], [ATTITUDE, RATES]):
        with suppress(InputError):
            if name := _meaning(text, groups, '')[0]:
                return name
    raise InputError(f'--columns: {_OF_MOTION}, or tx ty tz (N m, mN m, uN m, kN m), found '
                     f'{quoted(text)}')


def _chosen(heading: Sequence[str], chosen: Mapping[str, str]) -> Iterator[tuple[int, str]]:
    """Generate the position and the meaning of each chosen column."""
    names = [text.strip() for text in heading]
    for meaning, column in chosen.items():
        if column in names:
            yield names.index(column), meaning
        elif column.isdecimal() and 1 <= int(column) <= len(heading):
            yield int(column) - 1, meaning
        else:
            raise InputError(f'--columns: {meaning}: expected a number from 1 to {len(heading)}, '
                             f'or one of {listed(names)}, found {quoted(column)}')


def _meaning(text: str, groups: Sequence[tuple[str, ...]],
             context: str) -> tuple[str, Decimal | float | None]:
    """Return the quantity in a column and the factor of its unit; '' if it is to be ignored."""
    is_torque = TORQUE in groups
    for name, unit in _splits(text.replace('[]', '').strip(), context):
        rate, attitude, torque = (pattern.fullmatch(name) for pattern in (
            _RATE, _ATTITUDE, _TORQUE))
        if is_torque and torque and (prefix := _TORQUE_UNIT.fullmatch(unit or 'Nm')):
            return f't{torque[1]}', Decimal(1).scaleb(_PREFIXES[prefix[1]])
        if not is_torque and attitude and not unit:
            return f'q{attitude[1]}', 1.0
        if not is_torque and rate:
            if unit not in _RATE_UNITS:
                raise InputError(f'column {quoted(text)}: unknown unit; {_OF_MOTION}')
            return f'w{rate[1]}', _RATE_UNITS[unit]
        if _TIME.fullmatch(name) and (not unit or unit in TIME_UNITS):
            return 'time', Decimal(TIME_UNITS[unit]) if unit else None
        if is_torque and (rate or attitude or name == 'timestamp_sample'):
            return '', None
    # Look only at the last two parts of a path: /torque/wrench/force/x is a force, even though
    # its topic is called torque.
    if is_torque and (len(text) > _LONGEST or _AMBIGUOUS.search(
            '.'.join(re.split('[/.]', text.lower())[-2:]))):
        raise InputError(f'column {quoted(text)}: unknown name or unit; {_OF_TORQUE}')
    return '', None


def _splits(text: str, context: str) -> Iterator[tuple[str, str]]:
    """
    Generate all ways to split a string into a name, in lower case, and a unit; it may be ''.

    A name that is just an axis belongs to the quantity that its unit or else the context tells.
    """
    if len(text) > _LONGEST:
        return
    splits = [(text, '')]
    if (brackets := _IN_BRACKETS.fullmatch(text)) and (unit := brackets[2] or brackets[3]):
        splits.append((brackets[1], unit.strip()))
    splits += [(text[:position], text[position + 1:]) for position, char in enumerate(text)
               if char in '_ ']
    for name, unit in splits:
        name = name.lower()
        if (numbered := _NUMBERED.fullmatch(name)) and (number := numbered[3] or numbered[4]):
            is_quaternion = numbered[2] == 'q'
            axis = ('wxyz' if is_quaternion else 'xyz*')[int(number)]
            name = numbered[1] + 'q' * is_quaternion + axis
        if name in ('x', 'y', 'z'):
            called = 'gyro' if unit and unit in _RATE_UNITS else \
                'torque' if _TORQUE_UNIT.fullmatch(unit) else context
            name = f'{called}/{name}' if called else name
        yield name, unit
