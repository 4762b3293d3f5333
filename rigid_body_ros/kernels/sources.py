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

"""Hashes of the sources of the kernels; the compiled kernels carry those that they come from."""

from __future__ import annotations

from collections.abc import Iterator
import hashlib
from pathlib import Path
import tokenize

_PACKAGE = Path(__file__).resolve().parents[1]
#: Tokens that change no kernel, and those of which only the kind counts.
_SKIPPED, _SPACE = ('COMMENT', 'NL', 'ENCODING'), ('NEWLINE', 'DEDENT', 'ENDMARKER')


def files_hash() -> str:
    """Return a hash of the sources as they are."""
    digest = hashlib.sha256()
    for path in _sources():
        digest.update(path.read_bytes())
    return digest.hexdigest()


def sources_hash() -> str:
    """Return a hash of the sources without comments and docstrings, which takes far longer."""
    digest = hashlib.sha256()
    for path in _sources():
        before = 'NEWLINE'
        with path.open('rb') as file:
            for token in tokenize.tokenize(file.readline):
                kind = tokenize.tok_name[token.type]
                if kind in _SKIPPED:
                    continue
                if kind != 'STRING' or before not in ('NEWLINE', 'INDENT', 'DEDENT'):
                    text = '' if kind in _SPACE else token.string
                    digest.update(f'{kind} {text}\0'.encode())
                before = kind
    return digest.hexdigest()


def _sources() -> Iterator[Path]:
    # The kernels take constants from common/.
    for folder in ('common', 'kernels'):
        yield from sorted((_PACKAGE / folder).glob('*.py'))
