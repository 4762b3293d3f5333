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

"""What the contenders of `peers.py` share: equations of motion, ladders of steps, labels."""

import numpy as np

STEPS = (200, 500, 1_000, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000, 200_000, 500_000,
         1_000_000, 2_000_000)


def ladder(fewest, most):
    """Return the settings of a contender that divides a motion into steps of equal length."""
    return [{'steps': steps} for steps in STEPS if fewest <= steps <= most]


def per_sample(substeps):
    """Return the label of a setting with this many steps for each torque."""
    return 'one step per sample' if substeps == 1 else f'{substeps} steps per sample'


def derivative(state, coupling, acceleration):
    """Return the derivatives of rates and attitude; see `Problem` for the other arguments."""
    a, b, c, x, y, z, w = state
    (k1, k2, k3), (t1, t2, t3) = coupling, acceleration
    return (k1 * b * c + t1, k2 * c * a + t2, k3 * a * b + t3,
            0.5 * (w * a + y * c - z * b), 0.5 * (w * b + z * a - x * c),
            0.5 * (w * c + x * b - y * a), -0.5 * (x * a + y * b + z * c))


class Equations:
    """A contender that solves the equations of rates and attitude, in each run from the start."""

    def reset(self):
        """Do nothing: each run begins at the start."""

    def attitude(self):
        """Return x y z w."""
        return np.array(self._state[3:])


class FixedSteps(Equations):
    """A contender with steps of equal length: a number of them in all, or for each torque."""

    def __init__(self, problem, steps=0, substeps=1):
        """Take one step per torque by default, which reaches the level of rounding errors."""
        self.label = f'{steps} steps' if steps else per_sample(substeps)
        count = steps or substeps
        accelerations = problem.accelerations if len(problem.torques) else np.zeros((1, 3))
        self._accelerations = np.repeat(accelerations, count, axis=0)
        self._step = problem.hold_ns / 10 ** 9 / count
        self._coupling, self._start = problem.coupling, problem.start_vector
