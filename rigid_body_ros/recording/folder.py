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

"""A folder that rosbag2 takes for a recording: metadata.yaml beside an MCAP file."""

from __future__ import annotations

import os
from pathlib import Path
import shutil
from types import TracebackType
from typing import Any
import weakref

from rigid_body_ros.files import part_of
from rigid_body_ros.recording.writer import Writer
from rigid_body_ros.scene import InputError
import yaml

#: Of metadata.yaml: the newest that Humble reads.
_VERSION = 5


class FolderWriter(Writer):
    """
    Write a folder with an MCAP file and metadata.yaml, otherwise as `Writer` does.

    Raises
    ------
    InputError
        The folder is there already, or cannot be written.

    """

    def __init__(self, path: str | Path, keep_partial: bool = False) -> None:
        self._folder = Path(os.path.realpath(path))
        self._hidden = part_of(self._folder)
        super().__init__(self._hidden / f'{self._folder.name}_0.mcap', keep_partial)
        self._partial = self._folder.with_name(f'{self._folder.name}.partial.mcap')
        self._path = Path(path)  # what errors name

    def __enter__(self) -> FolderWriter:
        self._remove_folder = weakref.finalize(self, shutil.rmtree, self._hidden, True)
        try:
            if self._folder.exists():
                raise InputError(f'{self._path}: expected a name that ends in .mcap, or one of '
                                 'no file or folder yet, for a folder of rosbag2; found one that '
                                 'is taken')
            self._hidden.mkdir()
        except OSError as error:
            raise InputError(f'{self._path}: cannot write: {error.strerror}') from error
        super().__enter__()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        try:
            super().__exit__(kind, error, trace)
            if error is None:
                text = yaml.safe_dump({'rosbag2_bagfile_information': self._about()},
                                      sort_keys=False)
                (self._hidden / 'metadata.yaml').write_text(text, encoding='utf-8')
                os.replace(self._hidden, self._folder)
        except OSError as failure:
            raise InputError(f'{self._path}: cannot write: {failure.strerror}') from failure
        finally:
            self._remove_folder()

    def _about(self) -> dict[str, Any]:
        counts, first_ns, last_ns = self._container.counts, *self._container.span_ns
        span = {'starting_time': {'nanoseconds_since_epoch': first_ns},
                'duration': {'nanoseconds': last_ns - first_ns},
                'message_count': sum(counts.values())}
        name = f'{self._folder.name}_0.mcap'
        return {
            'version': _VERSION, 'storage_identifier': 'mcap', **span,
            'topics_with_message_count': [
                {'topic_metadata': {'name': channel.topic,
                                    'type': self._container.type_of(channel),
                                    'serialization_format': channel.message_encoding,
                                    'offered_qos_profiles':
                                        channel.metadata.get('offered_qos_profiles', '')},
                 'message_count': counts[channel.id]}
                for channel in self._container.channels],
            'compression_format': '', 'compression_mode': '', 'relative_file_paths': [name],
            'files': [{'path': name, **span}],
        }
