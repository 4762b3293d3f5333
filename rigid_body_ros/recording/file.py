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

"""What every file of a recording tells, whatever its format."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path

from rigid_body_ros.recording.bulk import Raw


class File(ABC):
    """
    A file of a recording.

    Parameters
    ----------
    path : Path
    unpacked : Path, optional
        Where it lies, if the path is that of a compressed file.

    Attributes
    ----------
    path : Path
    types : dict
        The type of each topic, '' if it is not told.
    damage : str
        What was lost and where, once the messages were read; '' if nothing.

    Raises
    ------
    InputError
        The file cannot be read, or is none of its format.

    """

    def __init__(self, path: Path, unpacked: Path | None = None) -> None:
        self.path, self._place = path, unpacked or path
        self.types: dict[str, str] = {}
        self.damage = ''

    def metadata(self, name: str) -> dict[str, str]:
        """Return what the file says under a name, if its format has a place for that."""
        return {}

    @abstractmethod
    def count(self, topic: str) -> int:
        """Return how many messages a topic has, as far as the file tells."""

    @abstractmethod
    def read(self, topic: str) -> Iterator[Raw]:
        """Generate the messages of a topic, in the order of the file."""
