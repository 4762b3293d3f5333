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
Read torques and other messages from recordings, and write motions.

Reading: `source` opens the files of a recording, whatever its format, and reads one topic from
them. `mcap_file`, `sqlite_file`, `text_files` and `ulog_file` each read some file formats, and all
of them implement the interface in `file`. `unpack` decompresses files and messages. `bulk` decodes
messages. `selection` says what to read, and how. `torques` turns messages into a torque log and
splits a node's log into epochs. `problem` combines torque logs with a scene. `measurements` reads
attitudes and angular velocities, and `quantities` extracts them from messages and tables; the
result is a `measured.Measured`. `observed` reads torques and measurements together. `account` says
what became of the messages, and `gaps` finds gaps between torques.

Writing: `writer` writes MCAP files and rosbag2 bags, using `container` for the individual records.
"""

from rigid_body_ros.recording.problem import chosen, Logged, read_epochs, same_bits
from rigid_body_ros.recording.problem import read as read_problem
from rigid_body_ros.recording.selection import Reading, Topics
from rigid_body_ros.recording.source import joined, Messages, read, Source, topics, TORQUES
from rigid_body_ros.recording.torques import epochs, NotInOrderError, torque_log, torque_pieces
from rigid_body_ros.recording.ulog_file import is_ulog
from rigid_body_ros.recording.writer import Column, FolderWriter, suffix_of, Writer, writer_of

__all__ = ['TORQUES', 'Column', 'FolderWriter', 'Logged', 'Messages', 'NotInOrderError', 'Reading',
           'Source', 'Topics', 'Writer', 'chosen', 'epochs', 'is_ulog', 'joined', 'read',
           'read_epochs', 'read_problem', 'same_bits', 'suffix_of', 'topics', 'torque_log',
           'torque_pieces', 'writer_of']
