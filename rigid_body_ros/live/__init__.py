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
The part of the node that does not need ROS; it can be type-checked and tested without ROS.

`inputs` turns received messages into torques and states, or rejects them; `events` defines the
causes of rejection, and the names of all counts. `torque_queue` holds torques that wait to be
applied, or wait for the clock. `run` owns the current epoch, and logs what it accepts and commits;
an `epoch` is one start state and the torques since then. `checkpoint` keeps the last committed
state in a file. `closed_loop` keeps the loop of a node in lockstep and its controller from
stopping, and from splitting into several chains of messages.
"""
