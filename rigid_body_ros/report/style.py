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

"""Colours, dashes and names that figures and pages share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: The palette of Okabe and Ito, which is suitable for colour-blind readers. In greyscale, curves
#: can be told apart by their dashes.
COLOURS = ('#0072B2', '#D55E00', '#009E73', '#000000', '#CC79A7', '#56B4E9')
STYLES = ('-', '--', '-.', ':')
MARKERS = ('o', 's', '^', 'D', 'v', 'x')
#: The percentiles to mark in the histogram of an ensemble, and their names.
MARKED = (('p5', '5 %'), ('p50', 'median'), ('p95', '95 %'))
QUATERNION = ('x', 'y', 'z', 'w')
RATES, MOMENTA, TORQUES = ('ω₁', 'ω₂', 'ω₃'), ('h₁', 'h₂', 'h₃'), ('τ₁', 'τ₂', 'τ₃')
#: The label for the torque that the fields apply. This torque depends on the attitude.
FIELDS = 'torque of the fields'
SIGNED = ('e₁', 'e₂', 'e₃')


def euler_names(sequence: str) -> tuple[str, ...]:
    """Return the names of the three Euler angles of a sequence."""
    return ('φ', 'θ', 'ψ') if sequence == 'ZXZ' else \
        tuple(f'{axis}{number}' for number, axis in enumerate(sequence, 1))


def torque_names(count: int) -> list[str]:
    """Return names for `count` torques; the names are numbered unless there is only one torque."""
    return ['torque'] if count == 1 else [f'torque {number}' for number in range(1, count + 1)]


def axes_name(in_space: NDArray[np.bool_]) -> str:
    """Return a name for the axes of some torques: body axes, space axes or mixed axes."""
    return 'body axes' if not in_space.any() else 'space axes' if in_space.all() else 'mixed axes'
