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

"""Wording that the reports of several commands share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import math

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import printable

#: Units of angles: number of units per radian, and names.
_ANGLES = {'rad': (math.degrees(1.0), 'deg'), 'rad/s': (math.degrees(1.0), 'deg/s')}
#: Largest number of digits of a value, and the exponents between which it is written without one.
_DIGITS, _PLAIN = 15, range(-4, 7)


def scaled(unit: str, degrees: bool) -> tuple[float, str]:
    """Return the factor to the unit that is shown, and its name; angles may be in degrees."""
    return _ANGLES.get(unit, (1.0, unit)) if degrees else (1.0, unit)


def numbers(values: Floats, digits: int, between: str = ' ') -> str:
    """Return the numbers of an array as text, rounded to some significant digits."""
    return between.join(f'{value:.{digits}g}' for value in values)


def rounded(value: float, sigma: float) -> str:
    """
    Return a value to the place of the second digit of its standard deviation.

    See JCGM 100 (GUM), 7.2.6. Without a finite positive deviation there are seven digits.
    """
    if not (0.0 < sigma < math.inf):
        return f'{value:.7g}'
    place = int(f'{sigma:.1e}'.partition('e')[2]) - 1
    value = round(value, -place) + 0.0  # without negative zeros
    if place > 0 and abs(value) < 10.0 ** _PLAIN.stop:
        return f'{value:.0f}'
    first = int(f'{value:.{_DIGITS}e}'.partition('e')[2]) if value else place
    digits = min(max(first - place, 0), _DIGITS)
    if max(first, place + 1) not in _PLAIN:
        return f'{value:.{digits}e}'
    return f'{value:.{min(max(-place, 0), _DIGITS)}f}'


def lines(texts: Iterable[str]) -> str:
    """Return texts as one line each; a line break within one, as in a name, is escaped."""
    return '\n'.join(map(printable, texts))


def interpolation_row(interpolation: str, differences: Mapping[str, float | None]) -> str:
    """
    Return a line with the interpolation, and the changes of the final attitude with the others.

    Parameters
    ----------
    interpolation : str
        The interpolation in use.
    differences : dict
        By interpolation, the angle between the final attitudes, rad; None if the body spins too
        fast to compute its motion.

    """
    others = [f'{name} would spin the body too fast' if angle is None else
              f'{name} would end {angle:.2g} rad away' for name, angle in differences.items()]
    return f'{interpolation} ({", ".join(others)})' if others else interpolation
