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

#: Factors from units in radians to units in degrees, and the names of the units in degrees.
_ANGLES = {'rad': (math.degrees(1.0), 'deg'), 'rad/s': (math.degrees(1.0), 'deg/s')}
#: Maximum number of digits of a value, and the powers of ten of the numbers that are written
#: without an exponent.
_DIGITS, _PLAIN = 15, range(-4, 7)


def scaled(unit: str, degrees: bool) -> tuple[float, str]:
    """Return the factor that converts to the displayed unit, and the name of this unit."""
    return _ANGLES.get(unit, (1.0, unit)) if degrees else (1.0, unit)


def numbers(values: Floats, digits: int, between: str = ' ') -> str:
    """Return the numbers of an array as text, rounded to `digits` significant digits."""
    return between.join(f'{value:.{digits}g}' for value in values)


def rounded(value: float, sigma: float) -> str:
    """
    Return a value as text, rounded to the second digit of its standard deviation.

    See JCGM 100 (GUM), 7.2.6. If the standard deviation is not finite and positive, the text
    contains seven digits.
    """
    if not (0.0 < sigma < math.inf):
        return f'{value:.7g}'
    place = int(f'{sigma:.1e}'.partition('e')[2]) - 1
    value = round(value, -place) + 0.0  # + 0.0 removes negative zeros
    if place > 0 and abs(value) < 10.0 ** _PLAIN.stop:
        return f'{value:.0f}'
    first = int(f'{value:.{_DIGITS}e}'.partition('e')[2]) if value else place
    digits = min(max(first - place, 0), _DIGITS)
    if max(first, place + 1) not in _PLAIN:
        return f'{value:.{digits}e}'
    return f'{value:.{min(max(-place, 0), _DIGITS)}f}'


def lines(texts: Iterable[str]) -> str:
    """Join texts, one per line; escape line breaks in a text, which a name may contain."""
    return '\n'.join(map(printable, texts))


def interpolation_row(interpolation: str, differences: Mapping[str, float | None]) -> str:
    """
    Describe the interpolation, and how far each alternative would move the final attitude.

    Parameters
    ----------
    interpolation : str
        The interpolation in use.
    differences : dict
        For each other interpolation, the angle between the final attitudes, rad. None if the body
        would spin too fast to compute its motion.

    """
    others = [f'{name} would spin the body too fast' if angle is None else
              f'{name} would end {angle:.2g} rad away' for name, angle in differences.items()]
    return f'{interpolation} ({", ".join(others)})' if others else interpolation
