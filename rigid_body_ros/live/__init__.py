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
The part of the node that does not need ROS, so it can be type-checked and tested without ROS.

`inputs` turns received messages into torques and states, or rejects them. `events` defines the
causes of rejection and the names of everything that the node counts. `torque_queue` holds the
torques that are waiting to be applied, or waiting for the clock. `run` owns the current epoch, and
logs the accepted torques and the committed states. An `epoch` consists of one start state and the
torques applied since then. `checkpoint` saves the last committed state to a file. For lockstep
mode, `closed_loop` makes sure that the loop between the node and its controller neither stops nor
splits into several chains of messages.
"""
