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
The common interface to the files of a recording, whatever their format.

A file may define its message types; the definitions are compared with those of ROS.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from functools import lru_cache
from itertools import zip_longest
from pathlib import Path
import re

from rigid_body_ros.common.errors import located, quoted, shortened
from rigid_body_ros.messages import MessageType, Px4Type
from rigid_body_ros.recording.bulk import Raw

#: Maps each message type to the types and names of its fields.
_Fields = dict[str, list[tuple[str, str]]]

#: Matches the start of a section: a line of `=` characters, then a line that names the type that
#: the section defines.
_SECTION = re.compile(r'^=+[ \t]*\n(?:MSG|IDL):[ \t]*(\S+)[ \t]*$', re.MULTILINE)
_MSG_COMMENT = re.compile(r'#.*')
#: Matches the type and the name of a field, but not a constant. A default value is ignored.
_MSG_FIELD = re.compile(r'^[ \t]*(\S+)[ \t]+(\w+)\b[ \t]*(?![ \t=])', re.MULTILINE)
#: Matches strings and comments. One pattern must match both, because a string may contain text
#: that looks like a comment, and vice versa.
_IDL_TEXT = re.compile(r'"(?:\\.|[^"\\])*"|//[^\n]*|/\*.*?\*/|^#[^\n]*', re.DOTALL | re.MULTILINE)
_IDL_ANNOTATION = re.compile(r'@\w+\s*(?:\([^()]*\))?')
_IDL_ARRAY = re.compile(r'typedef\s+([\w:]+)\s+(\w+)\s*(\[\w+\])')
_IDL_SEQUENCE = re.compile(r'sequence ?< ?([\w:]+) ?>')
#: The ROS names of the primitive IDL types.
_IDL_PRIMITIVES = {
    'double': 'float64', 'float': 'float32', 'boolean': 'bool', 'octet': 'byte',
    'short': 'int16', 'unsigned short': 'uint16', 'long': 'int32', 'unsigned long': 'uint32',
    'long long': 'int64', 'unsigned long long': 'uint64'}
#: The maximum length of a definition, in bytes, and the maximum number of fields in a type,
#: including the fields of nested types.
LONGEST, _MOST = 2 ** 16, 1000


class File(ABC):
    """
    One file of a recording.

    Parameters
    ----------
    path : Path
        The file as the user named it; error messages use this name.
    unpacked : Path, optional
        The decompressed copy to read, if the file is compressed.

    Attributes
    ----------
    path : Path
    types : dict
        The message type of each topic; '' if the file does not name the topic's type.
    damage : str
        What data was lost and where; '' if nothing was lost. This is not known until the messages
        have been read.
    notes : list of str
        What was assumed about the messages; not known until the messages have been read.
    encodings : dict
        The types of the topics that are being read in CDR, as the file defines them.

    Raises
    ------
    InputError
        The file cannot be read, or is not in the format that the class reads.

    """

    def __init__(self, path: Path, unpacked: Path | None = None) -> None:
        self.path, self._content = path, unpacked or path
        self.types: dict[str, str] = {}
        self.damage = ''
        self.notes: list[str] = []
        self.encodings: dict[str, MessageType] = {}

    def metadata(self, name: str) -> dict[str, str]:
        """Return the metadata record `name`, or {} if the format has no metadata records."""
        return {}

    def count(self, topic: str) -> int:
        """Return the number of messages on a topic, or 0 if the file does not store the number."""
        return 0

    @abstractmethod
    def read(self, topic: str, kind: MessageType) -> Iterator[Raw]:
        """
        Generate the messages of a topic in blocks, in file order.

        Raises
        ------
        InputError
            The messages are not encoded in CDR, or the file defines their type differently from
            ROS.

        """

    def _check_definition(self, topic: str, kind: MessageType, name: str, encoding: str,
                          definition: bytes) -> None:
        with located(f'{self.path}: {shortened(topic, 100)}'):
            self.encodings[topic] = checked(kind, name, encoding, definition)


def full_name(name: str) -> str:
    """Return the ROS 2 name of a type, such as std_msgs/msg/Header for std_msgs/Header."""
    return name.replace('/', '/msg/') if name.count('/') == 1 else name


@lru_cache
def checked(kind: MessageType, name: str, encoding: str, definition: bytes) -> MessageType:
    """
    Return a type as a recording defines it, which is the standard type unless PX4 defines it.

    Comments, spacing, constants, default values and the order of nested definitions do not
    matter. If the definition of a nested type is missing, the type is assumed to be standard.

    Parameters
    ----------
    kind : MessageType
        The message type that the caller expects.
    name, encoding : str
        The name that the recording gives the type, with or without msg, and the encoding of its
        definition: 'ros2msg' or 'ros2idl'.
    definition : bytes
        The definition in the recording; empty if there is none.

    Raises
    ------
    ValueError
        The definition differs from the standard. The error describes the first difference.

    """
    if full_name(name) != kind.name:
        raise ValueError(f'expected the type {kind.name}, found {quoted(name)}')
    text = definition.decode(errors='replace').replace('\r', '')
    if not text.strip():
        return kind
    if len(definition) > LONGEST:
        raise ValueError(f'expected a definition of at most {LONGEST} bytes, found more')
    if encoding not in ('ros2msg', 'ros2idl'):
        raise ValueError(f'expected a definition in ros2msg or ros2idl, found {quoted(encoding)}')
    root = name.replace('/msg/', '/')
    recorded = _sections(root, text, is_idl=encoding == 'ros2idl')
    if isinstance(kind, Px4Type):
        return kind.defined(tuple(_flat(recorded, root)))
    standard = _sections(root, kind.definition, is_idl=False)
    for expected, field in zip_longest(_flat(standard, root), _flat(standard | recorded, root)):
        if expected != field:
            raise ValueError(f'expected {expected or "no more fields"} in the definition of {name}'
                             f', found {quoted(field) if field else "no more fields"}')
    return kind


def _sections(root: str, text: str, is_idl: bool) -> _Fields:
    """Return the fields of every type in a definition, starting with the root type."""
    first, *others = _SECTION.split(text)
    sections = [*([(root, first)] if first.strip() else []), *zip(others[::2], others[1::2])]
    parsed = _idl_fields if is_idl else _msg_fields
    fields: _Fields = {}
    for name, body in sections:
        name = name.replace('/msg/', '/')
        fields.setdefault(name, parsed(name, body))
    return fields


def _msg_fields(name: str, body: str) -> list[tuple[str, str]]:
    fields = []
    for kind, field in _MSG_FIELD.findall(_MSG_COMMENT.sub('', body)):
        base, bracket, size = kind.replace('/msg/', '/').partition('[')
        if base == 'Header':
            base = 'std_msgs/Header'
        elif base[:1].isupper():  # a type from the same package
            base = f'{name.split("/")[0]}/{base}'
        fields.append((base + bracket + size, field))
    return fields


def _idl_fields(name: str, body: str) -> list[tuple[str, str]]:
    text = _IDL_ANNOTATION.sub('', _IDL_TEXT.sub('', body))
    arrays = {alias: base + size for base, alias, size in _IDL_ARRAY.findall(text)}
    struct = re.search(rf'struct\s+{re.escape(name.split("/")[-1])}\s*{{([^}}]*)}}', text)
    fields = []
    for member in struct.group(1).split(';')[:-1] if struct else ():
        kind, _, field = ' '.join(member.split()).rpartition(' ')
        field, bracket, size = field.partition('[')
        kind = _IDL_SEQUENCE.sub(r'\1[]', arrays.get(kind, kind)).replace('::msg::', '/')
        base, *rest = kind.partition('[')
        fields.append((''.join([_IDL_PRIMITIVES.get(base, base), *rest, bracket, size]), field))
    return fields


def _flat(fields: _Fields, root: str) -> Iterator[str]:
    """Generate the type and path of every primitive field in a type, in order."""
    waiting, count = [(root, '')], 0
    while waiting and count < _MOST:
        kind, path = waiting.pop()
        base, bracket, size = kind.partition('[')
        count += 1
        if base in fields:
            prefix = f'{path}{bracket}{size}.' if path else ''
            waiting += [(part, prefix + field) for part, field in reversed(fields[base])]
        else:
            yield f'{kind} {path}'
