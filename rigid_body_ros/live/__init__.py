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
The half of the node that needs no ROS, so that it can be type-checked and tested without it.

`inputs` turns received messages into torques and states, or rejects them; `events` has the causes,
and the names of all counts. `torque_queue` holds torques until they are applied, in order or
early. `run` owns the present epoch, and logs what it accepts and commits; `epoch` is one start
state and the torques since. `checkpoint` keeps the last committed state in a file. `closed_loop`
keeps a loop in lockstep from stopping and from splitting.
"""
