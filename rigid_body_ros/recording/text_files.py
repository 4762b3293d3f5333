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

"""
Read torques, attitudes and angular velocities from CSV files and TUM trajectories.

`csv_lines` formats the rows of a CSV file so that these readers get the same bits back.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
import csv
from decimal import Decimal, DecimalException
from io import TextIOWrapper
from itertools import chain, islice
import math
from pathlib import Path
import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.common.errors import InputError, listed, quoted, reason
from rigid_body_ros.messages import MessageType
from rigid_body_ros.recording.bulk import Raw
from rigid_body_ros.recording.file import File
from rigid_body_ros.runtime.limits import open_file

#: The name of the only topic in a CSV file of torques.
_TOPIC = '/torque'
#: Suffixes of CSV files and of TUM trajectories.
_CSV, _TUM = ('.csv',), ('.tum', '.txt')
#: The number of lines in a block, and the longest line that is accepted, in characters.
_BLOCK, _LONGEST = 8192, 2 ** 16
#: The most digits before the decimal point of a time.
_MOST_DIGITS = 30
#: The earliest time, ns since 1970, that a large number is taken for: September 2001.
_RECENT_NS = 10 ** 18
#: The unit of whole numbers without a unit is judged in at least this many lines. No other unit
#: than seconds is assumed if samples would then be further apart than `_FARTHEST_S`; without
#: angular velocities, seconds are assumed unless samples would be `_SELDOM_S` apart.
_FEWEST, _FARTHEST_S, _SELDOM_S = 20, 1.0, 1000.0
#: The columns of each quantity. Angular velocities are in body axes.
TORQUE = tuple(f't{axis}' for axis in 'xyz')
ATTITUDE = tuple(f'q{axis}' for axis in 'xyzw')
RATES = tuple(f'w{axis}' for axis in 'xyz')
#: The recognized units of time, each in ns.
_TIME_UNITS = {**dict.fromkeys(('s', 'sec', 'secs', 'second', 'seconds'), 10 ** 9),
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
_LONGEST_NAME = 200
_OF_TORQUE = ('expected time, t or stamp (s, ms, us, ns) and tx ty tz or torque_x torque_y '
              'torque_z (N m, mN m, uN m, kN m), with units as in "tx (mN m)" or "time_ms"')
_OF_MOTION = ('expected time (s, ms, us, ns), and qx qy qz qw or wx wy wz (rad/s, deg/s), with '
              'units as in "wx (deg/s)" or "time_ms"')


class TableColumn(NamedTuple):
    """Where a table contains a quantity, and the factor of the column's unit."""

    position: int
    #: The factor is None for a time without a unit.
    factor: Decimal | float | None


#: The columns of a file without a heading.
_TRAJECTORY = 8, {'time': TableColumn(0, Decimal(10 ** 9)),
                  **{name: TableColumn(4 + k, 1.0) for k, name in enumerate(ATTITUDE)}}
_TORQUES = 4, {name: TableColumn(k, Decimal(1) if k else None) for k, name in enumerate(
    ('time', *TORQUE))}


def csv_lines(times_ns: Ints, values: Floats) -> Iterator[str]:
    """Generate the lines of a CSV file: a time, ns, and the values, shape (n, k), of each row."""
    line = '%d' + ',%r' * values.shape[1] + '\n'
    return map(line.__mod__, zip(times_ns.tolist(), *values.T.tolist()))


def is_text_file(name: str) -> bool:
    """Return whether the name of a measured topic has the suffix of a text file."""
    return Path(name).suffix.lower() in (*_CSV, *_TUM)


class Table:
    """
    The lines of a CSV file or a TUM trajectory, as numbers.

    Iterate over the table to get blocks of lines: the stamps, ns, shape (n,), and the quantities,
    shape (n, k), with NaN where a cell is empty.

    Parameters
    ----------
    path : str or Path
        The first line of a CSV file contains the column names and may begin with #; a file of
        torques may lack it. The columns are separated by commas, semicolons or tabs; with the
        latter two, the decimal separator may be a comma. Each line of a trajectory (.tum, .txt)
        contains the time (s), x, y, z, qx, qy, qz and qw, separated by spaces. Other lines that
        begin with # are ignored.
    groups : sequence of tuple of str
        The quantities to read, such as `TORQUE`.
    chosen : mapping of str to str, optional
        The columns; see `_columns_of`. They are ignored if they contain none of the quantities.

    Attributes
    ----------
    names : list of str
        The quantities in the table, once iteration has begun.
    notes : list of str
        What was assumed about units.
    width : int
        The number of columns in a line.

    Raises
    ------
    InputError
        The file cannot be read, or a line is invalid.

    """

    def __init__(self, path: str | Path, groups: Sequence[tuple[str, ...]],
                 chosen: Mapping[str, str] | None = None) -> None:
        self._path, self._groups = path, groups
        wanted = {name for group in groups for name in group}
        self._chosen = chosen if chosen and wanted.intersection(map(_quantity, chosen)) else None
        self._is_csv = Path(path).suffix.lower() in _CSV
        self.width, self._columns = _TORQUES if self._is_csv else _TRAJECTORY
        self._rates: list[TableColumn] = []
        self.names: list[str] = []
        self.notes: list[str] = []

    def __iter__(self) -> Iterator[tuple[NDArray[np.int64], Floats]]:
        what = 'recording' if TORQUE in self._groups else 'measurements'
        try:
            with TextIOWrapper(open_file(self._path, what), 'utf-8-sig', newline='') as text:
                lines = self._begun(self._lines(text))
                while block := list(islice(lines, _BLOCK)):
                    yield self._numbers(block)
        except OSError as error:
            raise InputError(f'{self._path}: cannot read the {what}: {reason(error)}') from error
        except (UnicodeDecodeError, csv.Error) as error:
            raise InputError(f'{self._path}: expected text in UTF-8 ({reason(error)})') from error

    def _lines(self, text: TextIOWrapper) -> Iterator[tuple[int, list[str]]]:
        """Generate the line number and the cells of each line that is not empty."""
        number, delimiter = 0, ''

        def checked() -> Iterator[str]:
            nonlocal number, delimiter
            while line := text.readline(_LONGEST):
                number += 1
                if len(line) == _LONGEST:
                    raise InputError(f'{self._path}: line {number}: expected fewer than '
                                     f'{_LONGEST} characters, found {quoted(line)}')
                if line.strip():
                    delimiter = delimiter or max(',;\t', key=line.count)
                    yield line
        if not self._is_csv:
            yield from ((number, cells) for line in checked() if (cells := line.split()))
            return
        source = checked()
        first = next(source, '')
        for cells in csv.reader(chain([first], source), delimiter=delimiter or ','):
            if cells:
                yield number, cells if delimiter == ',' else [
                    cell.replace(',', '.') for cell in cells]

    def _begun(self, lines: Iterator[tuple[int, list[str]]]) -> Iterator[tuple[int, list[str]]]:
        """Interpret the heading, and return the lines of numbers."""
        (number, first), has_numbers = next(lines, (1, [''])), False
        with suppress(ValueError):
            float(first[0])
            has_numbers = True
        if self._is_csv and (self._chosen or TORQUE not in self._groups or not has_numbers):
            stem = Path(self._path).stem.lower()
            try:
                self._columns = _columns_of(first, self._groups, stem, self._chosen)
            except InputError as error:
                raise InputError(f'{self._path}: line {number}: {error}') from error
            self.width = len(first)
            with suppress(InputError):  # the rates tell whether whole numbers can be seconds
                columns = _columns_of(first, [RATES], stem, self._chosen)
                self._rates = [columns[name] for name in RATES]
        self.names = [name for group in self._groups for name in group if name in self._columns]
        kept = [(number, first)] if has_numbers else []
        return (line for line in chain(kept, lines) if not line[1][0].startswith('#'))

    def _numbers(self, block: list[tuple[int, list[str]]]) -> tuple[NDArray[np.int64], Floats]:
        columns = [self._columns[name] for name in self.names]
        position, factor = self._columns['time']
        stamps, rows = [], []
        for number, line in block:
            try:
                if len(line) != self.width:
                    raise ValueError
                stamps.append(_finite(line[position]))
                rows.append([_number(line[column.position], column.factor) for column in columns])
            except (ValueError, OverflowError, DecimalException):
                raise InputError(f'{self._path}: line {number}: expected {self._expected(line)}, '
                                 f'found {quoted(",".join(line))}') from None
        if factor is None:
            factor = self._assumed_unit(stamps, [line for _, line in block])
            self._columns = {**self._columns, 'time': TableColumn(position, factor)}
        values = np.array(rows, float).reshape(len(rows), len(columns))
        return self._stamps_ns(block, stamps, int(factor)), values

    def _expected(self, line: Sequence[str]) -> str:
        if not self._is_csv:
            matrix = ', as in a pose matrix of 3 x 4: convert it to a TUM trajectory' \
                if len(line) == 12 else ''
            return f'numbers: time (s), x, y, z, qx, qy, qz, qw, found {len(line)} columns{matrix}'
        if (self.width, self._columns.keys()) == (_TORQUES[0], _TORQUES[1].keys()):
            return 'time (s), tx, ty, tz (N m)'
        return f'{self.width} columns as in the first line' if len(line) != self.width else \
            f'numbers in the columns of time, {", ".join(self.names)}'

    def _stamps_ns(self, block: list[tuple[int, list[str]]], stamps: list[Decimal],
                   unit_ns: int) -> NDArray[np.int64]:
        stamps_ns = []
        for (number, _), stamp in zip(block, stamps):
            time_ns = (stamp * unit_ns).to_integral_value()
            if not 0 <= time_ns <= messages.LAST_NS:
                raise InputError(
                    f'{self._path}: line {number}: expected a time from 0 to '
                    f'{messages.LAST_NS // unit_ns} {_name_of(unit_ns)}, found '
                    f'{quoted(str(stamp))}; name another unit as in "time_ns" or "time (ms)"')
            stamps_ns.append(int(time_ns))
        return np.array(stamps_ns, np.int64)

    def _assumed_unit(self, stamps: Sequence[Decimal], lines: Sequence[Sequence[str]]) -> Decimal:
        """Return the unit of times without a unit, ns, and note what was assumed."""
        first = stamps[0]
        for unit_ns in (10 ** 6, 10 ** 3, 1):
            if _RECENT_NS <= first * unit_ns <= messages.LAST_NS:
                return self._noted(unit_ns, f'because {first} is then a time since 1970')
        if len(stamps) < _FEWEST or any(stamp != stamp.to_integral_value() for stamp in stamps):
            return Decimal(10 ** 9)
        return self._plausible_unit(np.array([*map(float, stamps)]), lines)

    def _noted(self, unit_ns: int, why: str) -> Decimal:
        """Return a unit of time, and note that it was assumed."""
        self.notes.append(f'the times have no unit: {_name_of(unit_ns)} is assumed, {why}; a '
                          'heading such as "time_ms" names the unit')
        return Decimal(unit_ns)

    def _plausible_unit(self, stamps: Floats, lines: Sequence[Sequence[str]]) -> Decimal:
        """
        Return the unit of whole numbers, ns: seconds, unless they cannot be seconds.

        They cannot be seconds if the body would turn by more than half a turn between samples, or
        if no angular velocity is known and samples would be very far apart.
        """
        steps = np.diff(stamps)
        step = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
        rates = np.array([[_number(line[column.position], column.factor) for column in self._rates]
                          for line in lines])
        rates = rates[np.isfinite(rates).all(axis=1)]
        rate = float(np.median(np.linalg.norm(rates, axis=1))) if rates.size else 0.0
        if step * rate <= math.pi and step < _SELDOM_S:
            return Decimal(10 ** 9) if step <= 1.0 else \
                self._noted(10 ** 9, f'so samples are {step:g} s apart')
        unit_ns = next((unit_ns for unit_ns in (10 ** 6, 10 ** 3) if step * unit_ns
                        < _FARTHEST_S * 1e9 and step * rate * unit_ns <= math.pi * 1e9), 1)
        return self._noted(unit_ns, f'because samples {step:g} s apart could not follow the '
                           'motion')


class CsvFile(File):
    """
    A CSV file of torques.

    Each line is read as a WrenchStamped message in body axes; see `Table`. Without a heading, the
    columns are time (s), tx, ty, tz (N m).
    """

    def __init__(self, path: Path, columns: Mapping[str, str] | None = None) -> None:
        super().__init__(path)
        self.types = {_TOPIC: messages.WRENCH.name}
        self._table = Table(path, [TORQUE], columns)
        self.notes = self._table.notes

    def read(self, topic: str, kind: MessageType) -> Iterator[Raw]:
        """Generate the torques in blocks, in file order."""
        for stamps_ns, torques in self._table:
            rows = is_sample(torques, self._table.width)
            values = np.pad(torques[rows], ((0, 0), (3, 0)))
            yield Raw.from_values(messages.WRENCH, stamps_ns[rows], values)


def is_sample(values: Floats, width: int) -> NDArray[np.bool_]:
    """
    Return a mask of the lines that contain a sample of a quantity.

    A table of several quantities with different rates has empty cells, often written as nan.

    Parameters
    ----------
    values : array, shape (n, k)
        The columns of the quantity.
    width : int
        The number of columns of the table.

    """
    is_joined = width > 1 + values.shape[1]
    return ~(np.isnan(values).all(axis=1) & is_joined)


def _number(text: str, factor: Decimal | float | None) -> float:
    if not text or text.isspace():
        return math.nan
    if isinstance(factor, Decimal) and factor != 1:
        return float(Decimal(text) * factor)
    return float(text) * float(factor or 1.0)


def _finite(text: str) -> Decimal:
    """Return a time. A double could not resolve nanoseconds in a time since 1970."""
    time = Decimal(text)
    if not time.is_finite() or (time and time.adjusted() > _MOST_DIGITS):
        raise ValueError
    return time or Decimal(0)  # without an exponent that `int` would expand


def _name_of(unit_ns: int) -> str:
    """Return the name of a unit of time."""
    return next(name for name, size in _TIME_UNITS.items() if size == unit_ns)


def _columns_of(heading: Sequence[str], groups: Sequence[tuple[str, ...]], stem: str = '',
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
        return _columns_in(heading, groups, '', chosen)
    except InputError:
        contexts = [name for name, word in _CALLED.items() if re.search(word, stem)]
        with suppress(InputError):
            if len(contexts) == 1:
                return _columns_in(heading, groups, contexts[0], chosen)
        raise


def _columns_in(heading: Sequence[str], groups: Sequence[tuple[str, ...]], context: str,
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
    present = [group for group in groups if any(name in columns for name in group)]
    for name in ('time', *(name for group in present or groups[:1] for name in group)):
        if name not in columns:
            raise InputError(f'no column for {name}; {accepted}, found '
                             f'{quoted(",".join(heading))}; choose with --columns')
    return columns


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
        if _TIME.fullmatch(name) and (not unit or unit in _TIME_UNITS):
            return 'time', Decimal(_TIME_UNITS[unit]) if unit else None
        if is_torque and (rate or attitude or name == 'timestamp_sample'):
            return '', None
    # Look only at the last two parts of a path: /torque/wrench/force/x is a force, even though
    # its topic is called torque.
    if is_torque and (len(text) > _LONGEST_NAME or _AMBIGUOUS.search(
            '.'.join(re.split('[/.]', text.lower())[-2:]))):
        raise InputError(f'column {quoted(text)}: unknown name or unit; {_OF_TORQUE}')
    return '', None


def _splits(text: str, context: str) -> Iterator[tuple[str, str]]:
    """
    Generate all ways to split a string into a name, in lower case, and a unit; it may be ''.

    A name that is just an axis belongs to the quantity that its unit or else the context tells.
    """
    if len(text) > _LONGEST_NAME:
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
