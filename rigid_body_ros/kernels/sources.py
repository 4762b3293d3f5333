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

"""Compute hashes of the kernel sources, to be compared with the hashes in the compiled kernels."""

from __future__ import annotations

import ast
from collections.abc import Iterator
import hashlib
from pathlib import Path
from typing import Any

_PACKAGE = Path(__file__).resolve().parents[1]
#: Fields of the syntax tree that do not contribute to the hash. Either some versions of Python
#: lack the field, or the field does not change a kernel.
_SKIPPED = ('kind', 'type_comment', 'type_params')


def files_hash() -> str:
    """Return a hash of the source files, including comments and docstrings."""
    digest = hashlib.sha256()
    for path in _sources():
        digest.update(path.read_bytes())
    return digest.hexdigest()


def sources_hash() -> str:
    """
    Return a hash of the source code that ignores comments and docstrings.

    The hash is the same in every version of Python. Computing it takes a hundred times as long as
    computing `files_hash`.
    """
    digest = hashlib.sha256()
    for path in _sources():
        for word in _words(ast.parse(path.read_bytes())):
            digest.update(f'{word}\n'.encode())
    return digest.hexdigest()


def _words(node: Any) -> Iterator[str]:
    # Yield the type names and the values in the syntax tree below a node, one by one.
    if isinstance(node, ast.AST):
        yield type(node).__name__
        for name, value in ast.iter_fields(node):
            if name not in _SKIPPED:
                yield from _words(value)
    elif isinstance(node, list):
        for item in node:
            if not (isinstance(item, ast.Expr) and isinstance(item.value, ast.Constant)):
                yield from _words(item)
        yield 'end'
    else:
        yield repr(node)


def _sources() -> Iterator[Path]:
    # Include common/, because the kernels take constants from it.
    for folder in ('common', 'kernels'):
        yield from sorted((_PACKAGE / folder).glob('*.py'))
