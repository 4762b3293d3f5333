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

"""Read measured attitudes and angular velocities from CSV files and TUM trajectories."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import csv
from decimal import Decimal, DecimalException
from io import TextIOWrapper
import math
from pathlib import Path
import re

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, quoted, reason
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation.options import FASTEST
from rigid_body_ros.recording.csv_columns import splits, time_scale
from rigid_body_ros.recording.measured import FEWEST, Measured
from rigid_body_ros.runtime.limits import open_file

#: Suffixes of CSV files and of TUM trajectories.
_CSV, _TUM = ('.csv',), ('.tum', '.txt')
#: Column names without units, such as qx, orientation.x or angular_velocity/x. The names used in
#: EuRoC files are included.
_ATTITUDE = re.compile(r'(?:.*[/.])?(?:q|quat|quaternion|orientation|attitude|q_rs)[/._ ]?'
                       r'([xyzw])')
_RATE = re.compile(r'(?:.*[/.])?(?:w|omega|gyro|angular_velocity|w_rs_s)[/._ ]?([xyz])')
#: The size of each unit of angular velocity in rad/s, keyed by the unit.
_RATE_UNITS = {**dict.fromkeys(('', 'rad/s', 'rad s^-1', 'rads'), 1.0),
               **dict.fromkeys(('deg/s', 'deg s^-1', 'degs'), math.radians(1.0))}
_QUANTITIES = tuple(f'q{axis}' for axis in 'xyzw'), tuple(f'w{axis}' for axis in 'xyz')
_ACCEPTED = ('expected time (s, ms, us, ns), and qx qy qz qw or wx wy wz (rad/s, deg/s), with '
             'units as in "wx (deg/s)" or "time_ms"')
#: Maximum length of a line, in characters.
_LONGEST = 2 ** 16


#: For each quantity, keyed by its name: the position in a line, and the factor of the unit.
_Columns = dict[str, tuple[int, float]]
_TRAJECTORY: _Columns = {'time': (0, 1e9),
                         **{name: (4 + k, 1.0) for k, name in enumerate(_QUANTITIES[0])}}


def is_text_file(name: str) -> bool:
    """Return whether the name of a measured topic has the suffix of a text file."""
    return Path(name).suffix.lower() in (*_CSV, *_TUM)


def read_text_file(path: str) -> Measured:
    """
    Read a CSV file or a TUM trajectory.

    Parameters
    ----------
    path : str
        A CSV file or a trajectory. The first line of a CSV file contains the column names and may
        begin with #. Each line of a trajectory (.tum, .txt) contains the time (s), x, y, z, qx,
        qy, qz and qw, separated by spaces. Apart from the column names, lines that begin with #
        are ignored. Angular velocities must be in body axes.

    Returns
    -------
    Measured
        The samples, sorted by stamp. If several samples have the same stamp, the last one is used.
        The topic is the name of the file.

    Raises
    ------
    InputError
        The file cannot be read, a line is invalid, or fewer than four samples are finite.

    """
    try:
        with TextIOWrapper(open_file(path, 'measurements'), 'utf-8-sig', newline='') as text:
            return _measured(path, text)
    except OSError as error:
        raise InputError(f'{path}: cannot read the measurements: {reason(error)}') from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f'{path}: expected text in UTF-8 ({reason(error)})') from error


def _measured(path: str, text: TextIOWrapper) -> Measured:
    lines = _lines(path, text)
    found = _TRAJECTORY
    if Path(path).suffix.lower() in _CSV:
        number, heading = next(lines, (1, []))
        found = _columns_of(f'{path}: line {number}', heading)
    groups = [names for names in _QUANTITIES if names[0] in found]
    stamps_ns, rows = [], []
    for number, line in lines:
        if line[0].startswith('#'):
            continue
        try:
            stamps_ns.append(_stamp_ns(line, found))
            rows.append([float(line[position]) * scale for names in groups
                         for position, scale in (found[name] for name in names)])
        except (ValueError, OverflowError, IndexError, DecimalException):
            raise InputError(f'{path}: line {number}: expected numbers in the columns of '
                             f'{", ".join(found)}, found {quoted(",".join(line))}'
                             ) from None
    values = np.array(rows, float).reshape(len(rows), sum(map(len, groups)))
    return _sorted(path, np.array(stamps_ns, np.int64), values, groups)


def _sorted(path: str, stamps_ns: NDArray[np.int64], values: Floats,
            groups: Sequence[Sequence[str]]) -> Measured:
    usable = np.isfinite(values).all(axis=1) & (np.abs(values) <= FASTEST).all(axis=1)
    has_attitude = groups[0] == _QUANTITIES[0]
    if has_attitude:
        usable &= values[:, :4].any(axis=1)
    order = np.flatnonzero(usable)
    order = order[np.argsort(stamps_ns[order], kind='stable')]
    order = order[np.append(np.diff(stamps_ns[order]) != 0, True)[:len(order)]]
    if len(order) < FEWEST:
        raise InputError(f'{path}: expected at least {FEWEST} samples with finite values, found '
                         f'{len(order)} among {len(stamps_ns)}')
    chosen = values[order]
    return Measured(Path(path).name, stamps_ns[order],
                    so3.normalize(chosen[:, :4]) if has_attitude else None,
                    chosen[:, -3:] if groups[-1] == _QUANTITIES[1] else None,
                    rejected=int(np.sum(~usable)))


def _stamp_ns(line: Sequence[str], found: _Columns) -> int:
    position, scale = found['time']
    # Use Decimal, because a double cannot resolve nanoseconds in a time since 1970.
    time_ns = (Decimal(line[position]) * int(scale)).to_integral_value()
    if not 0 <= time_ns <= messages.LAST_NS:
        raise ValueError
    return int(time_ns)


def _lines(path: str, text: TextIOWrapper) -> Iterator[tuple[int, list[str]]]:
    """Generate the line number and the columns of each line that is not empty."""
    is_csv = Path(path).suffix.lower() in _CSV
    for number, line in enumerate(iter(lambda: text.readline(_LONGEST), ''), 1):
        if len(line) == _LONGEST:
            raise InputError(f'{path}: line {number}: expected fewer than {_LONGEST} characters, '
                             f'found {quoted(line)}')
        columns = next(csv.reader([line]), []) if is_csv else line.split()
        if columns:
            yield number, columns


def _columns_of(where: str, heading: Sequence[str]) -> _Columns:
    """Find the columns with known names in a heading, and ignore all others."""
    found: _Columns = {}
    for position, text in enumerate(heading):
        name, scale = _meaning(where, text.lstrip('#').strip())
        if name in found:
            raise InputError(f'{where}: two columns for {name}: '
                             f'{quoted(heading[found[name][0]])} and {quoted(text)}; {_ACCEPTED}')
        if name:
            found[name] = position, scale
    given = [names for names in _QUANTITIES if any(name in found for name in names)]
    missing = [name for names in [('time',), *(given or _QUANTITIES)] for name in names
               if name not in found]
    if missing:
        raise InputError(f'{where}: no column for {missing[0]}; {_ACCEPTED}, found '
                         f'{quoted(",".join(heading))}')
    return found


def _meaning(where: str, text: str) -> tuple[str, float]:
    """
    Return the quantity that a column contains, and the factor of the column's unit.

    The quantity is an empty string if the column name is unknown.
    """
    for name, unit in splits(text.replace('[]', '').strip()):
        attitude, rate = _ATTITUDE.fullmatch(name.lower()), _RATE.fullmatch(name.lower())
        if attitude and not unit:
            return f'q{attitude[1]}', 1.0
        if rate and unit not in _RATE_UNITS:
            raise InputError(f'{where}: column {quoted(text)}: unknown unit; {_ACCEPTED}')
        if rate:
            return f'w{rate[1]}', _RATE_UNITS[unit]
        if scale := time_scale(name, unit):
            return 'time', float(scale)
    return '', 0.0
