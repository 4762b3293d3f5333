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

"""Format the numbers and texts in the reports of several commands."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
import math

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import printable

#: For each unit with radians, the factor that converts to degrees, and the unit with degrees.
_ANGLES = {'rad': (math.degrees(1.0), 'deg'), 'rad/s': (math.degrees(1.0), 'deg/s')}
#: Maximum number of digits in a value, and the range of decimal exponents for which a number is
#: written without an exponent.
_DIGITS, _PLAIN = 15, range(-4, 7)


def scaled(unit: str, degrees: bool) -> tuple[float, str]:
    """Return the factor that converts a value from `unit` to the displayed unit, and that unit."""
    return _ANGLES.get(unit, (1.0, unit)) if degrees else (1.0, unit)


def numbers(values: Floats, digits: int, between: str = ' ') -> str:
    """Format the numbers in an array, rounded to `digits` significant digits."""
    return between.join(f'{value:.{digits}g}' for value in values)


def rounded(value: float, sigma: float) -> str:
    """
    Format a value, rounded to the second significant digit of its standard deviation.

    See JCGM 100 (GUM), 7.2.6. If the standard deviation is not finite or not positive, the value
    is rounded to seven digits.
    """
    if not (0.0 < sigma < math.inf):
        return f'{value:.7g}'
    place = int(f'{sigma:.1e}'.partition('e')[2]) - 1
    value = round(value, -place) + 0.0  # + 0.0 turns -0 into 0
    if place > 0 and abs(value) < 10.0 ** _PLAIN.stop:
        return f'{value:.0f}'
    first = int(f'{value:.{_DIGITS}e}'.partition('e')[2]) if value else place
    digits = min(max(first - place, 0), _DIGITS)
    if max(first, place + 1) not in _PLAIN:
        return f'{value:.{digits}e}'
    return f'{value:.{min(max(-place, 0), _DIGITS)}f}'


def euler_names(sequence: str) -> tuple[str, ...]:
    """Return the names of the three Euler angles of a sequence."""
    return ('φ', 'θ', 'ψ') if sequence == 'ZXZ' else \
        tuple(f'{axis}{number}' for number, axis in enumerate(sequence, 1))


def aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Generate the rows of a table as lines: names, columns aligned at the right, and units."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    for row in rows:
        name, *middle = (f'{cell:>{width}}' if column else f'{cell:{width}}'
                         for column, (cell, width) in enumerate(zip(row[:-1], widths)))
        yield '  '.join([name, *middle, row[-1]])


def lines(texts: Iterable[str]) -> str:
    """Join texts, one per line. A line break inside a text, for example in a name, is escaped."""
    return '\n'.join(map(printable, texts))
