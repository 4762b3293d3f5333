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

"""Read torques from CSV files: one sample per line."""

from __future__ import annotations

from collections.abc import Iterator
import csv
from decimal import DecimalException
from io import TextIOWrapper
from itertools import islice
from pathlib import Path

import numpy as np
from rigid_body_ros import messages
from rigid_body_ros.common.errors import InputError, quoted, reason
from rigid_body_ros.messages import MessageType
from rigid_body_ros.recording.bulk import Raw
from rigid_body_ros.recording.csv_columns import Columns, columns
from rigid_body_ros.recording.file import File
from rigid_body_ros.runtime.limits import open_file

#: The name of the only topic in a CSV file.
_TOPIC = '/torque'
#: The number of lines that are read as one block.
_BLOCK = 8192
#: The longest line that is accepted, in characters.
_LONGEST = 2 ** 16


class CsvFile(File):
    """
    A CSV file of torques.

    Each line is read as a WrenchStamped message in body axes. The first line may name the columns;
    otherwise the columns are time (s), tx, ty, tz (N m). Reading raises InputError at the first
    invalid line.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.types = {_TOPIC: messages.WRENCH.name}

    def count(self, topic: str) -> int:
        """Return 0, because the lines cannot be counted without reading the file."""
        return 0

    def read(self, topic: str, kind: MessageType) -> Iterator[Raw]:
        """Generate the torques in blocks, in file order."""
        try:
            with TextIOWrapper(open_file(self.path, 'recording'), 'utf-8-sig',
                               newline='') as text:
                rows = self._rows(text)
                while block := list(islice(rows, _BLOCK)):
                    yield _raw(block)
        except OSError as error:
            raise InputError(f'{self.path}: cannot read the recording: {reason(error)}') from error
        except (UnicodeDecodeError, csv.Error) as error:
            raise InputError(f'{self.path}: expected CSV in UTF-8 ({reason(error)})') from error

    def _rows(self, text: TextIOWrapper) -> Iterator[tuple[int, list[float]]]:
        found = None
        lines = csv.reader(self._lines(text))
        for line in filter(None, lines):
            where = f'{self.path}: line {lines.line_num}'
            if found is None and not _is_number(line[0]):
                found = _columns_of(where, line)
                continue
            found = found or Columns()
            yield _sample(where, line, found)

    def _lines(self, text: TextIOWrapper) -> Iterator[str]:
        for number, line in enumerate(iter(lambda: text.readline(_LONGEST), ''), 1):
            if len(line) == _LONGEST:
                raise InputError(f'{self.path}: line {number}: expected fewer than {_LONGEST} '
                                 f'characters, found {quoted(line)}')
            yield line


def _columns_of(where: str, line: list[str]) -> Columns:
    try:
        return columns(line)
    except InputError as error:
        raise InputError(f'{where}: {error}') from error


def _sample(where: str, line: list[str], found: Columns) -> tuple[int, list[float]]:
    try:
        if len(line) == found.width:
            return found.stamp_ns(line, messages.LAST_NS), found.torque(line)
    except (ValueError, OverflowError, DecimalException):
        pass
    expected = 'time (s), tx, ty, tz (N m)' if found == Columns() else \
        f'{found.width} columns as in the first line'
    raise InputError(f'{where}: expected {expected}, found {quoted(",".join(line))}')


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _raw(rows: list[tuple[int, list[float]]]) -> Raw:
    stamps_ns = np.array([stamp_ns for stamp_ns, _ in rows], np.int64)
    values = np.zeros((len(rows), 6))
    values[:, 3:] = [torque for _, torque in rows]
    return Raw.from_values(messages.WRENCH, stamps_ns, values)
