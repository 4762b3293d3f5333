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

"""Open input files if they are regular files, and read YAML and JSON files of limited size."""

from __future__ import annotations

from collections import Counter
import json
import os
from pathlib import Path
import re
import stat
from typing import Any, BinaryIO

from rigid_body_ros.common.errors import InputError, located, quoted, reason
import yaml
from yaml.composer import Composer
from yaml.resolver import BaseResolver

try:
    from yaml.cyaml import CParser  # type: ignore[attr-defined]
except ImportError:  # PyYAML was built without libyaml
    _EventLoader = yaml.BaseLoader  # does the same, but ten times slower
else:
    class _EventLoader(Composer, CParser, BaseResolver):  # type: ignore[no-redef]
        """Parse with libyaml, but compose nodes in Python, where recursion is limited."""

        def __init__(self, text: str) -> None:
            CParser.__init__(self, text)
            Composer.__init__(self)
            BaseResolver.__init__(self)

#: The largest size of a file, in bytes, and the largest number of values and of nesting levels in
#: a YAML file. The metadata of a bag with 2000 files takes 0.5 MB and contains 30 000 values.
_MAX_BYTES, _MAX_VALUES, _MAX_LEVELS = 2 ** 22, 100_000, 50
#: JSON integers with this many digits or more are read as floats.
_DIGITS = 300
_TAGS = re.compile('^%TAG', re.MULTILINE)


def open_file(path: str | Path, what: str) -> BinaryIO:
    """
    Open a regular file for reading bytes.

    Parameters
    ----------
    path : str or Path
        The file, or a link to it.
    what : str
        What the file contains, for the error message, such as 'scene'.

    Raises
    ------
    InputError
        The file cannot be opened, or it is a folder, a pipe or a device. Pipes and devices are
        rejected because reading from them may never end.

    """
    try:
        mode = os.stat(path).st_mode
        if stat.S_ISREG(mode):
            return open(path, 'rb')
    except (OSError, ValueError) as error:  # ValueError: the name contains NUL
        raise InputError(f'{path}: cannot read the {what}: {reason(error)}') from error
    kind = ('a folder' if stat.S_ISDIR(mode) else 'a pipe' if stat.S_ISFIFO(mode) else
            'a device or a socket')
    raise InputError(f'{path}: cannot read the {what}: expected a regular file, found {kind}')


def read_yaml(path: str | Path, what: str, aliases: bool = False) -> yaml.Node | None:
    """
    Return the root node of a YAML file, or None if the file is empty.

    Tags are ignored. Values are not converted, so no conversion can fail.

    Parameters
    ----------
    path : str or Path
        The file, or a link to it.
    what : str
        What the file contains, for the error message, such as 'scene'.
    aliases : bool
        Whether anchors and aliases are allowed. PyYAML writes an anchor and an alias for an object
        that occurs twice. Each time an alias is used, all the values that it stands for count
        toward the limit on values. An alias must not contain another alias, because 1 kB could
        then expand to gigabytes. If aliases are not allowed, merge keys are not allowed either: a
        merge key refers to an alias, and rcl would read the merge key as the name of a group.

    Raises
    ------
    InputError
        The file cannot be read, is not YAML in UTF-8, has aliases or merge keys that are not
        allowed, or exceeds a limit on its bytes, values or nesting levels.

    """
    text = _text(path, what, 'YAML')
    with located(path, InputError):
        if _TAGS.search(text):
            raise InputError('expected YAML without %TAG directives, found one')
        try:
            return _Loader(text, aliases).get_single_node()
        except yaml.YAMLError as error:
            raise InputError(f'expected YAML, found an error: {_problem(error)}') from error


def read_json(path: str | Path, what: str) -> Any:
    """
    Read the data in a JSON file.

    Parameters
    ----------
    path : str or Path
        The file, or a link to it.
    what : str
        What the file contains, for the error message.

    Raises
    ------
    InputError
        The file cannot be read, is not JSON in UTF-8, is too long, or repeats a key.

    """
    text = _text(path, what, 'JSON')
    with located(path, InputError):
        try:
            return json.loads(text, object_pairs_hook=_object, parse_int=_integer)
        except RecursionError as error:
            raise InputError('expected JSON with fewer levels, found more') from error
        except json.JSONDecodeError as error:
            raise InputError(f'expected JSON, found an error: {reason(error)}') from error


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    data = dict(pairs)
    if len(data) < len(pairs):
        (twice, _), = Counter(key for key, _ in pairs).most_common(1)
        raise InputError(f'expected JSON with each key once, found {quoted(twice)} twice')
    return data


def _integer(digits: str) -> int | float:
    # Python is slow to convert a million digits, or refuses to do so.
    return int(digits) if len(digits) < _DIGITS else float(digits)


def _text(path: str | Path, what: str, syntax: str) -> str:
    with open_file(path, what) as stream:
        try:
            content = stream.read(_MAX_BYTES + 1)
        except OSError as error:
            raise InputError(f'{path}: cannot read the {what}: {reason(error)}') from error
    if len(content) > _MAX_BYTES:
        raise InputError(f'{path}: expected at most {_MAX_BYTES} bytes of {syntax}, found more')
    try:
        return content.decode('utf-8')
    except UnicodeDecodeError as error:
        raise InputError(f'{path}: expected {syntax} in UTF-8 ({reason(error)})') from error


class _Loader(_EventLoader):
    """Compose YAML nodes, and reject files that exceed the limits."""

    def __init__(self, text: str, aliases: bool) -> None:
        super().__init__(text)
        self._aliases = aliases
        self._values = self._level = self._repeated = 0
        #: For each anchor whose content has no alias, the number of values in the content.
        self._sizes: dict[str, int] = {}

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        values, repeated, anchor = self._values, self._repeated, event.anchor
        if isinstance(event, yaml.AliasEvent):
            self._repeated += 1
            self._values += self._sizes.get(anchor, 0)
        self._values += 1
        self._check(event, anchor, index is None)
        self._level += 1
        node = super().compose_node(parent, index)
        self._level -= 1
        if repeated == self._repeated:
            self._sizes[anchor] = self._values - values
        return node

    def _check(self, event: yaml.Event, anchor: str | None, is_key: bool) -> None:
        line = f'line {event.start_mark.line + 1}' if event.start_mark else 'the file'
        merges = is_key and getattr(event, 'value', None) == '<<'
        if (anchor is not None or merges) and not self._aliases:
            raise InputError('expected YAML without aliases (*name), anchors (&name) and merge '
                             'keys (<<), which ROS parameter files do not have, found one in '
                             f'{line}')
        if isinstance(event, yaml.AliasEvent) and anchor not in self._sizes:
            raise InputError('expected aliases (*name) of earlier values that contain no aliases, '
                             f'found another in {line}')
        if self._values > _MAX_VALUES:
            raise InputError(f'expected YAML with at most {_MAX_VALUES} values, found more '
                             f'in {line}')
        if self._level == _MAX_LEVELS:
            raise InputError(f'expected YAML with at most {_MAX_LEVELS} levels, found more '
                             f'in {line}')


def _problem(error: yaml.YAMLError) -> str:
    mark = getattr(error, 'problem_mark', None)
    where = f' in line {mark.line + 1}' if mark else ''
    return f'{getattr(error, "problem", None) or reason(error)}{where}'
