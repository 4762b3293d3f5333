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
Read ROS 2 parameter files by the rules of rcl_yaml_param_parser, which differ from PyYAML's.

Numbers and Booleans are recognized as in rcl: 1e-9 is a number, although PyYAML reads it as text.
As in rcl, a group of parameters that occurs twice is merged, and node names may contain wildcards
and namespaces. Unlike in rcl, a parameter must not be given twice. (rcl would use the last value.
But if one of the two occurrences is written as a name with a dot and the other is in a group, rcl
would use the value in the group.)
"""

from __future__ import annotations

from collections.abc import Iterator
import re
from typing import Any

from rigid_body_ros.common.errors import InputError, listed, quoted, shortened
import yaml

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


def node_parameters(root: yaml.Node | None, node: str) -> tuple[str, dict[str, Any]]:
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
    sections = _sections(root, '')
    names = {name for name, _ in sections}
    ours = {name for name in names if name.split('/')[-1] == node}
    if not ours and _ANY_NODE not in names:
        ours = names
    if len(ours) > 1 or not names:
        found = listed(sorted(names)) if names else 'no node'
        raise InputError(f'expected parameters for /** or for one {node}, '
                         f'found parameters for {found}')
    values: dict[str, Any] = {}
    for name in (_ANY_NODE, *ours):
        values.update(_values([section for other, section in sections if other == name]))
    return next(iter(ours), _ANY_NODE), values


def number(text: str) -> float | None:
    """Return the number that rcl would read from unquoted text, or None if it is not a number."""
    return float(text.lower().replace('.inf', 'inf').replace('.nan', 'nan')) \
        if _FLOAT.fullmatch(text) else None


def _sections(node: yaml.Node | None, prefix: str) -> list[tuple[str, yaml.Node]]:
    """Return the node names in a parameter file, each with the parameters below it."""
    found = []
    for key, value in entries(node, prefix or 'the file'):
        if key.value == 'ros__parameters' and prefix:
            found.append((prefix, value))
        elif prefix and isinstance(value, yaml.ScalarNode):
            raise InputError(f'{prefix}: expected /**: and ros__parameters: above the parameters '
                             f'of a node, found {shortened(f"{key.value}: {value.value}", 100)}')
        else:  # a node, or a namespace
            found += _sections(value, f'{prefix}/{key.value.strip("/")}'.strip('/'))
    return found


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
    found = number(text)
    return text if found is None else found


def _integer(text: str) -> int:
    digits = text.lstrip('+-')
    base = 16 if digits[:2] in ('0x', '0X') else 8 if digits[0] == '0' else 10
    return int(text, base)
