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
The types that a kernel takes and returns, from its annotations.

An array is annotated with its shape, and with WRITTEN if the kernel writes to it; see
`rigid_body_ros.kernels.jit.exported`. A named tuple stands for its fields, and `X | None` for two
signatures. With names in its annotation, a named tuple stands for the signatures in which just the
fields with these names are None.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
import re
from string import ascii_lowercase
from types import UnionType
from typing import Annotated, Any, get_args, get_origin, get_type_hints, Union

import numpy as np
from translate import element_type, short_name

#: Most dimensions of an array, as in boundary.c.
DIMENSIONS = 4
#: Of dimensions, in the order of boundary.c; L is the number of lanes of a level.
VARIABLES = f'{ascii_lowercase}L'
#: Kinds of numbers, in the arguments and in the results.
_NUMBERS = {int: 'I', float: 'F', bool: 'B', type(None): '-'}
_TERM = re.compile(r'(\d*)([a-zL]?)([+-]\d+)?')


@dataclass(frozen=True)
class Dimension:
    """A dimension of an array: `factor` times a variable, plus `offset`; or `other`."""

    factor: int
    variable: str
    offset: int
    other: int = -1

    @classmethod
    def read(cls, text: str) -> Dimension:
        """Return the dimension that a text stands for: '3', 'n', '2d+1', 'n+1', 'n|0'."""
        first, _, other = text.partition('|')
        found = _TERM.fullmatch(first)
        if not found or not first:
            raise ValueError(f"expected a dimension such as '2d+1', found {text!r}")
        number, variable, offset = found.groups()
        if not variable:
            return cls(0, '', int(number), int(other or -1))
        return cls(int(number or 1), variable, int(offset or 0), int(other or -1))


@dataclass(frozen=True)
class Part:
    """A part of the arguments: an array, a number, None, or a tuple of the parts that follow."""

    #: Of the array: 'f', 'i', 'u', 'b' or 'V', as numpy's `dtype.kind`. 'I', 'F' and 'B' are a
    #: number, '-' is None, and '(' a tuple.
    kind: str
    label: str
    text: str
    #: In C++: the type of the elements of an array, or of a named tuple.
    cpp_type: str = ''
    dimensions: tuple[Dimension, ...] = ()
    size: int = 0
    is_written: bool = False
    parts: tuple[Part, ...] = ()

    @property
    def flat(self) -> list[Part]:
        """Return this part and its parts, depth first."""
        return [self, *(inner for part in self.parts for inner in part.flat)]


def signatures(kernel: Any) -> list[tuple[Part, ...]]:
    """Return the arguments of each signature of a kernel."""
    hints = get_type_hints(kernel, include_extras=True)
    hints.pop('return', None)
    return list(product(*(_alternatives(hint, name) for name, hint in hints.items())))


def results(kernel: Any) -> str:
    """Return the kinds of the results of a kernel."""
    hint = get_type_hints(kernel)['return']
    return ''.join(_NUMBERS[each] for each in get_args(hint) or [hint])


def _alternatives(hint: Any, label: str) -> list[Part]:
    if get_origin(hint) in (Union, UnionType):
        return [part for each in get_args(hint) for part in _alternatives(each, label)]
    if hint in _NUMBERS:
        name = 'None' if hint is type(None) else hint.__name__
        return [Part(_NUMBERS[hint], label, name)]
    if get_origin(hint) is Annotated:
        kind, *marks = get_args(hint)
        if not hasattr(kind, '_fields'):
            return [_array(kind, *marks, label=label)]
        return [part for part in _named_tuples(kind, label) if {*marks} == {
            each.label.rpartition('.')[2] for each in part.flat if each.kind == '-'}]
    if isinstance(hint, type) and hasattr(hint, '_fields'):
        return _named_tuples(hint, label)
    raise TypeError(f'{label}: expected the annotation of an array, a number, None or a named '
                    f'tuple, found {hint}')


def _array(array: Any, shape: Any, *marks: Any, label: str) -> Part:
    records = [mark for mark in marks if isinstance(mark, np.dtype)]
    element = get_args(array)[-1]  # a type or, before numpy 2.5, a dtype of it
    dtype = records[0] if records else np.dtype((get_args(element) or (element,))[0])
    dimensions = tuple(map(Dimension.read, shape.split()))
    written = ', '.join(shape.split()) + (',' if len(dimensions) == 1 else '')
    name = 'record' if records else str(dtype)
    return Part(dtype.kind, label, f'{name} ({written})', element_type(dtype), dimensions,
                dtype.itemsize, 'written' in marks)


def _named_tuples(kind: Any, label: str) -> list[Part]:
    hints = get_type_hints(kind, include_extras=True)
    fields = [_alternatives(hint, f'{label}.{name}') for name, hint in hints.items()]
    known = getattr(kind, 'combinations', None)
    name = f'{short_name(kind.__module__)}::{kind.__name__}'
    return [Part('(', label, kind.__name__, name, parts=parts) for parts in product(*fields)
            if known is None or _given(parts, fields) in known]


def _given(parts: tuple[Part, ...], fields: list[list[Part]]) -> tuple[str, ...]:
    """Return the names of the optional fields that are not None."""
    return tuple(part.label.rpartition('.')[2] for part, alternatives in zip(parts, fields)
                 if len(alternatives) > 1 and part.kind != '-')
