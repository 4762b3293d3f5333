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

"""The long run and the overload of benchmarks/soak.py and benchmarks/overload.py, shortened."""

import overload
import pytest
import soak

pytestmark = [pytest.mark.ros, pytest.mark.nightly]


def test_every_torque_is_accounted_for_memory_is_flat_and_live_is_replay(domain):
    # The guarantees do not depend on the rate, but a busy machine may not keep up with it.
    lines = soak.soak(20.0, domain, soak.RATE // 2)
    assert not [line for line in lines if not (line.holds or line.name == soak.PROCESSOR_TIME)]


def test_an_overloaded_node_accounts_for_every_torque_and_catches_up(domain):
    lines = overload.overload(rate=5000, seconds=5.0, domain=domain)
    # Durations are not checked, because they depend on other load of the machine.
    assert not [line for line in lines if not (line.holds or line.name.endswith(', s'))]
