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
Measure the time from the first import to the first results, in a new process.

    python benchmarks/start.py

The script computes one motion under torque and one without, and prints the time, s.
"""

import time

began = time.perf_counter()

from rigid_body_ros import propagate, RigidBody, State, TorqueLog  # noqa: E402

body = RigidBody.from_moments(1.0, 2.0, 3.0)
start = State(0, angular_velocity=(0.3, -0.2, 0.5))
log = TorqueLog([0, 1_000_000], [[0.1, 0.2, 0.3], [0.3, 0.2, 0.1]])
propagate(body, start, log, at=[3_000_000])
propagate(body, start, at=[3_000_000])
print(time.perf_counter() - began)
