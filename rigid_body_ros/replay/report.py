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

"""Summarize a replay as text."""

from __future__ import annotations

from rigid_body_ros import euler
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.replay.check import LastDigits
from rigid_body_ros.replay.single import Replay
from rigid_body_ros.report.text import interpolation_row

#: The effect of the last digits is reported if it exceeds the rounding error by this factor.
_REPORTED = 10.0


def summary(result: Replay) -> str:
    """Return a summary, one line per fact."""
    return '\n'.join(f'{name:14}{text}' for name, text in rows(result))


def rows(result: Replay) -> list[tuple[str, object]]:
    """Return the facts of a summary: names and texts."""
    last = result.last
    sequence = result.scene.values['euler_sequence']
    span = (last.time_ns - result.start.time_ns) * 1e-9
    total = sum(result.seconds.values())
    split = ', '.join(f'{name} {seconds:.2g} s' for name, seconds in result.seconds.items())
    return [
        ('torques', f'{result.messages} on {result.topic}, over '
                    f'{(result.last_ns - result.first_ns) * 1e-9:.9g} s'
                    + (f'; the last of {result.logs} epochs' if result.logs > 1 else '')),
        *([('lost', result.damage)] if result.damage else []),
        *([('order', f'{result.unordered} of {result.messages} stamps were not later than the '
                     'previous one: sorted; of messages with equal stamps, the last is used')]
          if result.unordered else []),
        ('interpolation', interpolation_row(result.interpolation,
                                            result.interpolation_differences)),
        ('body', result.scene.body.symmetry),
        *([('rotors', result.wheel_source)] if result.scene.has_rotors else []),
        *(('solver', text) for text in _solvers(result)),
        ('final state', f'{span:.9g} s after the start'),
        ('  attitude', f'{_numbers(last.attitude)}  (x y z w)'),
        (f'  {sequence}', f'{_numbers(euler.from_quaternion(last.attitude, sequence))}  rad'),
        ('  body rates', f'{_numbers(last.angular_velocity)}  rad/s'),
        *([('  rotors', f'{_numbers(last.rotor_momentum)}  N m s')]
          if result.scene.has_rotors else []),
        ('check', result.check),
        *([('last digits', result.last_digits)] if _is_reported(result.last_digits) else []),
        ('speed', f'{span / total:.3g} times real time ({split})'),
    ]


def _is_reported(digits: LastDigits | None) -> bool:
    return digits is not None and digits.effect > _REPORTED * digits.rounding


def _solvers(result: Replay) -> list[str]:
    if len(result.solvers) == 1:
        return [*result.solvers]
    return [f'{span_ns * 1e-9:.9g} s by {name}' for name, span_ns in result.solvers.items()]


def _numbers(values: Floats) -> str:
    return ' '.join(f'{value:.15g}' for value in values)
