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
Recordings: torques in, motion out.

`source` finds a topic in a recording of any kind; `mcap_file`, `sqlite_file` and `csv_file` read
the files it is made of, `unpack` what is compressed in them, `csv_columns` the first line of text,
`bulk` what their messages say, and `torques` makes a log of it. `writer`
writes MCAP files, `container` their bytes, and `folder` what rosbag2 wants beside them.
"""

from rigid_body_ros.recording.folder import FolderWriter
from rigid_body_ros.recording.source import (
    joined,
    Messages,
    read,
    Source,
    TIME_SOURCES,
    TORQUES,
    Track,
)
from rigid_body_ros.recording.torques import (
    new_logs,
    NotInOrderError,
    Piece,
    torque_log,
    torque_pieces,
)
from rigid_body_ros.recording.writer import Column, Writer

__all__ = ['TIME_SOURCES', 'TORQUES', 'Column', 'FolderWriter', 'Messages', 'NotInOrderError',
           'Piece', 'Source', 'Track', 'Writer', 'joined', 'new_logs', 'read', 'torque_log',
           'torque_pieces']
