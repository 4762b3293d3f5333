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
Declare parameters, and check their names and values.

The nodes of a robot often share a parameter file, so a file may contain parameters that are meant
for other nodes. Such parameters are ignored. But an unknown name that resembles a known name is
probably a mistake, so it is rejected.
"""

from __future__ import annotations

from collections.abc import Collection
from difflib import SequenceMatcher
import re
from typing import Any, Generic, NamedTuple, TypeVar

from rigid_body_ros.common.errors import InputError, quoted
from rigid_body_ros.runtime.parameter_file import number

T = TypeVar('T')

#: The limits on the magnitude of parameters that do not have narrower limits.
BIG, TINY = 1e300, 1e-300
#: A name with fewer letters than this easily resembles other words: mode looks like model and
#: node.
_SHORT = 6
#: A misspelt name differs by at most this many inserted or deleted letters. A replaced letter
#: counts as one deletion and one insertion.
_EDITS = 2


class Value(Generic[T]):
    """An attribute that returns the parameter with the same name from the object's `values`."""

    def __set_name__(self, kind: type, name: str) -> None:
        self._name = name

    def __get__(self, owner: Any, kind: type) -> T:
        value: T = owner.values[self._name]
        return value


class Parameter(NamedTuple):
    """A parameter. A parameter whose `default` is None is a float and must be given."""

    name: str
    default: bool | int | float | str | list[str] | None
    unit: str
    description: str
    #: The lowest and highest values that a number may have.
    interval: tuple[float, float] | None = None
    choices: tuple[str, ...] = ()

    @property
    def value_type(self) -> type:
        """Return the Python type of the value."""
        return float if self.default is None else type(self.default)


def is_foreign(name: str, value: Any, known: Collection[str]) -> bool:
    """
    Return whether a parameter has an unknown name, and therefore belongs to another node.

    Raises
    ------
    InputError
        The name is unknown but resembles a known name; or it is the name of a group of known
        names, or of a member of such a group.

    """
    if name in known:
        return False
    if members := _members(name, known):
        raise InputError(f'{name}: expected a group of {", ".join(members)}, '
                         f'found {quoted(value)}')
    if close := resembled(name, known):
        raise InputError(f'{name}: unknown key; did you mean {close}?')
    group = name.rpartition('.')[0]
    if members := _members(group, known):
        raise InputError(f'{name}: unknown key; expected a member of {group}: '
                         f'{", ".join(members)}')
    return True


def resembled(name: str, known: Collection[str]) -> str | None:
    """
    Return the known name that a misspelt name resembles; None if it resembles no known name.

    Two names resemble each other if they differ only in capitalization, in one letter, in the
    order of two letters, or by two missing or additional letters. Short names resemble each other
    only if nothing but the capitalization differs. Names with different digits, such as those of
    two topics, never resemble each other.
    """
    one, edits = name.lower(), {}
    for candidate in known:
        other, allowed = candidate.lower(), 0 if len(candidate) < _SHORT else _EDITS
        # Each edit changes the length by one, and adds or removes at most one distinct letter.
        if (abs(len(one) - len(other)) <= allowed and len({*one} ^ {*other}) <= allowed
                and _digits(one) == _digits(other)):
            ratio = SequenceMatcher(None, one, other, autojunk=False).ratio()
            count = round((1.0 - ratio) * (len(one) + len(other)))
            if count <= allowed:
                edits[candidate] = count
    return min(edits, key=edits.__getitem__, default=None)


def _digits(name: str) -> list[str]:
    return re.findall('[0-9]', name)


def _members(group: str, known: Collection[str]) -> list[str]:
    return [name.removeprefix(f'{group}.') for name in known if name.startswith(f'{group}.')]


def checked(parameter: Parameter, given: Any) -> Any:
    """Convert a value to the type of its parameter; raise InputError if the value is invalid."""
    name, unit = parameter.name, f' ({parameter.unit})' if parameter.unit else ''
    kind = {float: 'a number', int: 'an integer', str: 'text',
            bool: 'true or false', list: 'a list of text'}[parameter.value_type]
    if given is None and parameter.default == []:
        return []
    if given is None:  # rclpy turns an empty list into None, too
        raise InputError(f'{name}: expected {kind}{unit}, found none: {parameter.description}')
    value = float(given) if parameter.value_type is float and type(given) is int else given
    # In Python, a bool is an int.
    wrong = (isinstance(value, bool) is not (parameter.value_type is bool)
             or not isinstance(value, parameter.value_type))
    if wrong:
        in_quotes = isinstance(value, str) and number(value) is not None
        hint = '; remove the quotes' if in_quotes else f': {parameter.description}'
        raise InputError(f'{name}: expected {kind}{unit}, found {quoted(value)}{hint}')
    if parameter.choices and value not in parameter.choices:
        choices = ', '.join(parameter.choices)
        raise InputError(f'{name}: expected one of {choices}, found {quoted(value)}')
    if parameter.interval and not parameter.interval[0] <= value <= parameter.interval[1]:
        raise InputError(f'{name}: expected {limits(*parameter.interval)}{unit}, found {value}')
    return value


def limits(low: float, high: float) -> str:
    """Describe the range of allowed values in words."""
    if high < BIG:
        return f'{low:g} to {high:g}'
    return 'a finite number' + {-BIG: '', 0.0: ' not less than 0', TINY: ' greater than 0'}[low]
