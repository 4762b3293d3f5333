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

"""Torques as text: lines of time (s), tx, ty, tz (N m)."""

from __future__ import annotations

from collections.abc import Iterator
import csv
from decimal import Decimal, InvalidOperation
from itertools import islice
from pathlib import Path

import numpy as np
from rigid_body_ros import messages
from rigid_body_ros.recording import bulk
from rigid_body_ros.recording.bulk import Raw
from rigid_body_ros.recording.file import File
from rigid_body_ros.scene import InputError

#: What its only topic is called.
_TOPIC = '/torque'
#: Lines of a block.
_BLOCK = 8192


class CsvFile(File):
    """
    The torques of a text file, as WrenchStamped in body axes; the first line may name columns.

    A wrong line is refused, with InputError, when it is read.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.types = {_TOPIC: messages.WRENCH.name}

    def count(self, topic: str) -> int:
        """Return 0: only reading tells."""
        return 0

    def read(self, topic: str) -> Iterator[Raw]:
        """Generate the torques, in the order of the file."""
        try:
            with open(self.path, newline='', encoding='utf-8-sig') as stream:
                lines = ((number, line) for number, line in enumerate(csv.reader(stream), 1)
                         if line and not (number == 1 and _is_heading(line)))
                while block := list(islice(lines, _BLOCK)):
                    yield _raw([self._parsed(number, line) for number, line in block])
        except OSError as error:
            raise InputError(f'{self.path}: cannot read the recording: {error.strerror}') \
                from error
        except (UnicodeDecodeError, csv.Error) as error:
            raise InputError(f'{self.path}: expected lines of text ({bulk.one_line(error)})') \
                from error

    def _parsed(self, number: int, line: list[str]) -> tuple[int, list[float]]:
        try:
            seconds, *torque = line
            # As a decimal: a double has no nanoseconds left in this century.
            stamp_ns = int((Decimal(seconds) * 10 ** 9).to_integral_value())
            if len(torque) == 3 and 0 <= stamp_ns <= messages.LAST_NS:
                return stamp_ns, [float(text) for text in torque]
        except (ValueError, InvalidOperation, OverflowError):
            pass
        raise InputError(f'{self.path}: line {number}: expected time (s), tx, ty, tz (N m), '
                         f'found {",".join(line)[:80]!r}')


def _is_heading(line: list[str]) -> bool:
    try:
        float(line[0])
    except ValueError:
        return True
    return False


def _raw(rows: list[tuple[int, list[float]]]) -> Raw:
    stamps = np.array([stamp_ns for stamp_ns, _ in rows], np.int64)
    values = np.zeros((len(rows), 6))
    values[:, 3:] = [torque for _, torque in rows]
    filled = np.empty(len(rows), messages.WRENCH.layout(''))
    messages.WRENCH.fill(filled, stamps, values, '')
    size = filled.dtype.itemsize
    return Raw(np.frombuffer(filled.tobytes(), np.uint8), np.arange(len(rows)) * size,
               np.full(len(rows), size), stamps, stamps)
