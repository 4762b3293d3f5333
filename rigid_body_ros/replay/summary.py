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

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.mechanics import euler
from rigid_body_ros.replay.check import LastDigits
from rigid_body_ros.replay.single import Replay
from rigid_body_ros.report.text import interpolation_row, lines
from rigid_body_ros.scene import fields, wheels

#: The effect of the last digits is reported if it exceeds the rounding error by this factor.
_REPORTED = 10.0


def summary(result: Replay) -> str:
    """Return a summary, one line per fact."""
    return lines(f'{name:14}{text}' for name, text in rows(result))


def rows(result: Replay) -> list[tuple[str, object]]:
    """Return the facts of a summary: names and texts."""
    last, epochs = result.last, (*result.earlier, result)
    sequence = result.scene.euler_sequence
    seconds = {name: sum(one.seconds[name] for one in epochs) for name in result.seconds}
    split = ', '.join(f'{name} {taken:.2g} s' for name, taken in seconds.items())
    speed = sum(map(_span, epochs)) / sum(seconds.values())
    return [
        *_earlier(result),
        ('torques', f'{result.messages} on {result.topic}, over '
                    f'{(result.last_ns - result.first_ns) * 1e-9:.9g} s'),
        *([('lost', result.damage)] if result.damage else []),
        *([('order', f'{result.unordered} of {result.messages} stamps were not later than the '
                     'previous one: sorted; of messages with equal stamps, the last is used')]
          if result.unordered else []),
        *_gaps(result),
        ('interpolation', interpolation_row(result.interpolation,
                                            result.interpolation_differences)),
        ('body', result.scene.body.symmetry),
        *(('fields', text) for text in fields.described(result.scene.values)),
        *(('wheels', text) for text in wheels.described(result.scene.values)),
        *([('rotors', result.wheel_source)] if result.scene.has_rotors else []),
        *(('solver', text) for text in _solvers(result)),
        ('final state', f'{_span(result):.9g} s after the start'),
        ('  attitude', f'{_numbers(last.attitude)}  (x y z w)'),
        (f'  {sequence}', f'{_numbers(euler.from_quaternion(last.attitude, sequence))}  rad'),
        ('  body rates', f'{_numbers(last.angular_velocity)}  rad/s'),
        *([('  rotors', f'{_numbers(last.rotor_momentum)}  N m s')]
          if result.scene.has_rotors else []),
        ('check', result.check),
        *([('last digits', result.last_digits)] if _is_reported(result.last_digits) else []),
        ('speed', f'{speed:.3g} times real time ({split})'),
    ]


def _earlier(result: Replay) -> list[tuple[str, object]]:
    """Return the facts of the earlier epochs, if there are any, a line for each."""
    if not result.earlier:
        return []
    return [('epochs', f'{len(result.earlier) + 1}, each from its own start state; the rows after '
                       'these, plots and pages are of the last one'),
            *((f'  epoch {number}', f'from {one.start.time_ns} ns on, over {_span(one):.9g} s, to '
               f'attitude {_numbers(one.last.attitude)} (x y z w) and body rates '
               f'{_numbers(one.last.angular_velocity)} rad/s')
              for number, one in enumerate(result.earlier, 1))]


def _gaps(result: Replay) -> list[tuple[str, object]]:
    """Return the longest gap in the log that has the longest one, and warnings about all logs."""
    gaps = [gaps for gaps in result.gaps if gaps.longest.length_ns]
    longest = sorted(gaps, key=lambda one: one.longest.length_ns)[-1:]
    return [*(('longest gap', str(one)) for one in longest),
            *(('warning', one.warning) for one in gaps if one.warning)]


def _span(result: Replay) -> float:
    return (result.last.time_ns - result.start.time_ns) * 1e-9


def _is_reported(digits: LastDigits | None) -> bool:
    return digits is not None and digits.effect > _REPORTED * digits.rounding


def _solvers(result: Replay) -> list[str]:
    if len(result.solvers) == 1:
        return [*result.solvers]
    return [f'{span_ns * 1e-9:.9g} s by {name}' for name, span_ns in result.solvers.items()]


def _numbers(values: Floats) -> str:
    return ' '.join(f'{value:.15g}' for value in values)
