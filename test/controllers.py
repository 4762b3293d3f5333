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

"""Controllers for the tests of closed-loop ensembles, good and bad."""

import multiprocessing
import os
import random
import sys

import numpy as np
import pid_controller


class Pid(pid_controller.Pid):
    """The controller that the tests of lockstep use."""

    def __call__(self, state, time):
        """Return the torque, N m."""
        return self.torque(state.attitude[:3].tolist(), state.angular_velocity.tolist())


def damp(state, time):
    """Return a torque against the rotation."""
    return -0.02 * state.angular_velocity


def vandal(state, time):
    """Return the same torque, but overwrite everything in the state."""
    torque = damp(state, time)
    for array in (state._packed, state.attitude, state.angular_velocity, state.rotor_momentum,
                  state._rotors):
        array.flags.writeable = True
        array[...] = 7.0
    return torque


def late(state, time):
    """Fail after a while, in runs that begin with a positive rate."""
    if time > 0.15 and state.angular_velocity[0] > 0.0:
        return 1.0 / 0.0
    return np.zeros(3)


def exits(state, time):
    """Call `exit`, which must not end other runs."""
    if state.angular_velocity[0] > 0.0:
        sys.exit('enough')
    return np.zeros(3)


def not_a_number(state, time):
    """Return NaN for some runs."""
    return [np.nan if state.angular_velocity[0] > 0.0 else 0.0, 0.0, 0.0]


def huge(state, time):
    """Return too large a torque for some runs."""
    return [1e300 if state.angular_velocity[0] > 0.0 else 0.0, 0.0, 0.0]


def killed(state, time):
    """Kill the worker process."""
    if multiprocessing.parent_process():
        os._exit(3)
    print('alive')
    return np.zeros(3)


def two(state, time):
    """Return too few numbers."""
    return [0.0, 0.0]


def words(state, time):
    """Return words instead of numbers."""
    return 'none at all'


def guess(state, time):
    """Return a random torque."""
    return [random.random(), 0.0, 0.0]


class Shared:
    """A controller whose runs share their memory."""

    calls = 0

    def __call__(self, state, time):
        """Return a torque that depends on earlier runs."""
        Shared.calls += 1
        return [1e-6 * Shared.calls, 0.0, 0.0]


class Deaf:
    """A class that cannot be called."""


NUMBER = 7
