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

"""A short load beyond the capacity of the node: benchmarks/overload.py."""

import overload
import pytest

pytestmark = [pytest.mark.ros, pytest.mark.nightly]


def test_an_overloaded_node_accounts_for_every_torque_and_catches_up(domain):
    lines = overload.overload(rate=5000.0, seconds=5.0, domain=domain)
    # Durations are not checked, because they depend on other load of the machine.
    assert not [line for line in lines if not (line.holds or line.name.endswith(', s'))]
