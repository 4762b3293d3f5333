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

"""Error messages for users: always one line of limited length, whatever the input is."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from itertools import islice
from reprlib import Repr

#: Maximum length of an error line, in characters.
LONGEST = 500
#: Maximum length of a reason that comes from another library, and of each name in a list of names.
_REASON, _NAME = 200, 60
#: Maximum number of names in a list.
_NAMES = 6
#: Replaces the middle of a string that is too long.
CUT = ' ... '

_repr = Repr()
_repr.maxstring = _repr.maxother = _repr.maxlong = 80
_repr.maxlevel, _repr.maxdict = 3, 4


class InputError(ValueError):
    """
    Raised if there is a mistake in the user's input.

    The message is a single line that says where the mistake is, what was expected there, and what
    was found instead.
    """

    def __init__(self, message: str) -> None:
        super().__init__(shortened(message))


@contextmanager
def located(where: object, kind: type[ValueError] = ValueError) -> Iterator[None]:
    """Report an error of the given kind as an `InputError` whose message begins with `where`."""
    try:
        yield
    except kind as error:
        raise InputError(f'{where}: {error}') from error


def shortened(text: str, longest: int = LONGEST) -> str:
    """Turn a string into one printable line; cut out the middle if the line exceeds `longest`."""
    return _cut(printable(_cut(text, longest)), longest)


def printable(text: str) -> str:
    """
    Escape nonprintable characters in a string, so that a terminal does not interpret them.

    Nonprintable characters are control characters, line breaks of any kind, and characters that
    change the direction of the text.
    """
    if text.isprintable():
        return text
    return ''.join(char if char.isprintable() else char.encode('unicode_escape').decode()
                   for char in text)


def quoted(value: object) -> str:
    """Return the repr of a user's value, cut to about 80 characters."""
    return _repr.repr(value)


def listed(names: Collection[str]) -> str:
    """
    List the first few names, and say how many more there are.

    The text is 'none' if there are no names.
    """
    shown = ', '.join(shortened(name, _NAME) for name in islice(names, _NAMES))
    return (f'{shown} and {len(names) - _NAMES} more' if len(names) > _NAMES else shown) or 'none'


def reason(error: Exception) -> str:
    """Return the message of an error as one line, or the error's type if it has no message."""
    text = getattr(error, 'strerror', None) or ' '.join(str(error).split())
    return shortened(text or type(error).__name__, _REASON)


def _cut(text: str, longest: int) -> str:
    if len(text) <= longest:
        return text
    tail = (longest - len(CUT)) // 3
    return text[:longest - len(CUT) - tail] + CUT + text[-tail:]
