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

"""Write rosbag2 bags: folders that contain an MCAP file and metadata.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rigid_body_ros.recording.writer import Writer
from rigid_body_ros.runtime.files import FOLDER, Part
import yaml

#: Format version of metadata.yaml. ROS 2 Humble cannot read newer versions.
_VERSION = 5


def suffix_of(output: str | Path) -> str:
    """Return the format of an output: '.mcap', or `files.FOLDER` for a rosbag2 folder."""
    name = Path(output).name.lower()  # ignore case, like rosbag2
    return '.mcap' if name.endswith('.mcap') else FOLDER


def writer_of(output: str | Path) -> Writer:
    """Return a writer for an output, in the format that its name implies."""
    kind = FolderWriter if suffix_of(output) == FOLDER else Writer
    return kind(output, keep_partial=True)


class FolderWriter(Writer):
    """
    Write a rosbag2 bag: a folder that contains an MCAP file and metadata.yaml.

    The methods and parameters are the same as for `Writer`, except that `path` is the folder.

    Raises
    ------
    InputError
        A file or folder with that name already exists, or the folder cannot be written.

    """

    _suffix = FOLDER

    def _file_of(self, part: Part) -> Path:
        return part.path / f'{part.target.name}_0.mcap'

    def _finish(self) -> None:
        super()._finish()
        text = yaml.safe_dump({'rosbag2_bagfile_information': self._about()}, sort_keys=False)
        self._file.with_name('metadata.yaml').write_text(text, encoding='utf-8')

    def _about(self) -> dict[str, Any]:
        counts, first_ns, last_ns = self._container.counts, *self._container.span_ns
        span = {'starting_time': {'nanoseconds_since_epoch': first_ns},
                'duration': {'nanoseconds': last_ns - first_ns},
                'message_count': sum(counts.values())}
        name = self._file.name
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
