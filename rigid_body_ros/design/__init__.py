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
Design a maneuver that tells what an identification asks, before it is flown.

`maneuver` turns a few numbers into a motion and into the torques that cause it, and scales both
to the limits of a vehicle. `information` computes the intervals that a fit to a flight will have,
from the derivatives of that fit. `search` varies the numbers until these intervals are narrow, and
returns the design with its text, its JSON data, its report and its files.
"""
