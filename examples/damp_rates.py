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
Two controllers that stop a tumbling CubeSat: a function, and a class with memory.

How often do they succeed if rates, inertia and thrust are uncertain? To find out, run this in the
folder of this repository:

    attitude_ensemble --scene examples/damp_rates.yaml --vary examples/damp_rates_vary.yaml
        --controller examples.damp_rates:damp --until 60 --runs 200 --require 'rate < 0.05' -o runs
"""

import numpy as np

#: N m s/rad, N m, s.
GAIN, LIMIT, TIME_CONSTANT, STEP = 0.02, 0.002, 0.5, 0.1


def damp(state, time):
    """
    Return a torque against the rotation, limited to what the thrusters can exert.

    Parameters
    ----------
    state : State
        The present state of the body.
    time : float, s
        Since the start.

    Returns
    -------
    array, shape (3,), N m, body axes

    """
    return np.clip(-GAIN * state.angular_velocity, -LIMIT, LIMIT)


class FilteredDamping:
    """The same law with low-pass-filtered rates; each run gets an instance of its own."""

    def __init__(self):
        self.rates = None

    def __call__(self, state, time):
        """Return the torque, N m, body axes, shape (3,)."""
        if self.rates is None:
            self.rates = state.angular_velocity
        self.rates = self.rates + STEP / TIME_CONSTANT * (state.angular_velocity - self.rates)
        return np.clip(-GAIN * self.rates, -LIMIT, LIMIT)
