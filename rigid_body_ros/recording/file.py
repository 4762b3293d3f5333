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

"""The common interface to the files of a recording, whatever their format."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path

from rigid_body_ros.common.errors import located, shortened
from rigid_body_ros.messages import MessageType
from rigid_body_ros.recording.bulk import Raw
from rigid_body_ros.recording.definitions import checked


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
