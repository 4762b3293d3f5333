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
Declare parameters, read them from ROS 2 parameter files, and check their names and values.

Files are read by the rules of rcl_yaml_param_parser, which differ from PyYAML's. Numbers and
Booleans are recognized as in rcl: 1e-9 is a number, although PyYAML reads it as text. As in rcl, a
group of parameters that occurs twice is merged, and node names may contain wildcards and
namespaces. Unlike in rcl, a parameter must not be given twice. (rcl would use the last value. But
if one of the two occurrences is written as a name with a dot and the other is in a group, rcl
would use the value in the group.)

The nodes of a robot often share a parameter file, so a file may contain parameters that are meant
for other nodes. Such parameters are ignored. But an unknown name that resembles a known name is
probably a mistake, so it is rejected.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from difflib import SequenceMatcher
import re
from typing import Any, Generic, NamedTuple, TypeVar

from rigid_body_ros.common.errors import InputError, listed, quoted, shortened
import yaml

T = TypeVar('T')

#: The limits on the magnitude of parameters that do not have narrower limits.
BIG, TINY = 1e300, 1e-300
#: A name with fewer letters than this easily resembles other words: mode looks like model and
#: node.
_SHORT = 6
#: A misspelt name differs by at most this many inserted or deleted letters. A replaced letter
#: counts as one deletion and one insertion.
_EDITS = 2
#: Numbers that the C functions strtoll (base 0) and strtod accept. rcl calls these functions to
#: read numbers.
_INTEGER = re.compile(r'[+-]?(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)')
_FLOAT = re.compile(r'[+-]?([0-9]+(\.[0-9]*)?([eE][+-]?[0-9]+)?|\.[0-9]+([eE][+-]?[0-9]+)?'
                    r'|\.?(inf|Inf|INF|nan|NaN|NAN))')
_TRUE = ('y', 'Y', 'yes', 'Yes', 'YES', 'true', 'True', 'TRUE', 'on', 'On', 'ON')
_FALSE = ('n', 'N', 'no', 'No', 'NO', 'false', 'False', 'FALSE', 'off', 'Off', 'OFF')
_EXAMPLE = '/**: ros__parameters: inertia: ...'
#: The node name under which a file lists parameters that apply to all nodes.
_ANY_NODE = '**'
#: The full name of a parameter may have at most this many characters.
_LONGEST = 500


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
    given, edits = name.lower(), {}
    for candidate in known:
        other, allowed = candidate.lower(), 0 if len(candidate) < _SHORT else _EDITS
        # Each edit changes the length by one, and adds or removes at most one distinct letter.
        if (abs(len(given) - len(other)) <= allowed and len({*given} ^ {*other}) <= allowed
                and _digits(given) == _digits(other)):
            ratio = SequenceMatcher(None, given, other, autojunk=False).ratio()
            count = round((1.0 - ratio) * (len(given) + len(other)))
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


def parameters_of(root: yaml.Node | None, node: str) -> tuple[str, dict[str, Any]]:
    """
    Find the parameters of a node in a parameter file.

    Return the name under which the file lists the node's parameters, and the parameters, keyed by
    full name. Parameters of `/**` apply to every node, but the node's own parameters take
    precedence. A file that contains neither of these is still accepted if it contains the
    parameters of only one node, whatever the name of that node is.

    Parameters
    ----------
    root : yaml.Node or None
        The root node of the file; see `read_yaml`.
    node : str
        The name of the node, without a namespace.

    Raises
    ------
    InputError
        The YAML is not a parameter file, has parameters for several nodes with this name, or
        gives one of the node's parameters twice.

    """
    sections = [*_sections(root, '')]
    names = {name for name, _ in sections}
    ours = {name for name in names if name.split('/')[-1] == node}
    if not ours and _ANY_NODE not in names:
        ours = names
    if len(ours) > 1 or not names:
        nodes = listed(sorted(names)) if names else 'no node'
        raise InputError(f'expected parameters for /** or for one {node}, '
                         f'found parameters for {nodes}')
    values: dict[str, Any] = {}
    for name in (_ANY_NODE, *ours):
        values.update(_values([section for other, section in sections if other == name]))
    return next(iter(ours), _ANY_NODE), values


def number(text: str) -> float | None:
    """Return the number that rcl would read from unquoted text, or None if it is not a number."""
    return float(text.lower().replace('.inf', 'inf').replace('.nan', 'nan')) \
        if _FLOAT.fullmatch(text) else None


def _sections(node: yaml.Node | None, prefix: str) -> Iterator[tuple[str, yaml.Node]]:
    """Generate the node names in a parameter file, each with the parameters below it."""
    for key, value in entries(node, prefix or 'the file'):
        if key.value == 'ros__parameters' and prefix:
            yield prefix, value
        elif prefix and isinstance(value, yaml.ScalarNode):
            raise InputError(f'{prefix}: expected /**: and ros__parameters: above the parameters '
                             f'of a node, found {shortened(f"{key.value}: {value.value}", 100)}')
        else:  # a node, or a namespace
            yield from _sections(value, f'{prefix}/{key.value.strip("/")}'.strip('/'))


def entries(node: yaml.Node | None, where: str,
            example: str = _EXAMPLE) -> list[tuple[yaml.ScalarNode, yaml.Node]]:
    """
    Return the keys and values of a mapping, in order and including repeated keys.

    Raises
    ------
    InputError
        The node is not a mapping, or a key is too long or is not a name.

    """
    if not isinstance(node, yaml.MappingNode):
        raise InputError(f'{where}: expected keys and values ({example}), '
                         f'found {described(node)}')
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise InputError(f'{where}: expected names as keys, found {described(key)} as a key '
                             f'in line {key.start_mark.line + 1}')
        if len(where) + len(key.value) > _LONGEST:
            raise InputError(f'{shortened(where, 60)}: expected full names of at most {_LONGEST} '
                             f'characters, found {quoted(key.value)}')
    return list(node.value)


def described(node: yaml.Node | None) -> str:
    """Describe a YAML node in an error message."""
    if isinstance(node, yaml.ScalarNode):
        return quoted(node.value)
    return 'nothing' if node is None else \
        'a list' if isinstance(node, yaml.SequenceNode) else 'a group'


def _values(sections: list[yaml.Node]) -> dict[str, Any]:
    """Return the parameters in all sections of one node, keyed by full name."""
    values, lines = {}, dict[str, int]()
    for section in sections:
        for name, key, value in _flattened(section, ''):
            line = key.start_mark.line + 1
            if name in lines:
                raise InputError(f'{shortened(name, 60)}: expected each parameter once, found it '
                                 f'in line {lines[name]} and in line {line}')
            values[name], lines[name] = _value(value), line
    return values


def _flattened(node: yaml.Node, prefix: str) -> Iterator[tuple[str, yaml.Node, yaml.Node]]:
    """Yield the full name, the key and the value of each parameter."""
    for key, value in entries(node, prefix.rstrip('.') or 'ros__parameters'):
        if isinstance(value, yaml.MappingNode):
            yield from _flattened(value, f'{prefix}{key.value}.')
        else:
            yield f'{prefix}{key.value}', key, value


def _value(node: yaml.Node) -> Any:
    if isinstance(node, yaml.SequenceNode):
        return [_value(item) for item in node.value]
    text = str(node.value)
    if isinstance(node, yaml.ScalarNode) and node.style in ('"', "'"):
        return text
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if _INTEGER.fullmatch(text) and len(text) < 100:
        integer = _integer(text)
        if -2 ** 63 <= integer < 2 ** 63:
            return integer
    value = number(text)
    return text if value is None else value


def _integer(text: str) -> int:
    digits = text.lstrip('+-')
    base = 16 if digits[:2] in ('0x', '0X') else 8 if digits[0] == '0' else 10
    return int(text, base)
