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

"""The result of a replay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from rigid_body_ros.mechanics import euler
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation import Problem, Trajectory
from rigid_body_ros.recording.account import Account
from rigid_body_ros.recording.gaps import Gaps
from rigid_body_ros.replay.batches import Collector, Saturation
from rigid_body_ros.replay.check import Check, LastDigits
from rigid_body_ros.report.text import lines, numbers
from rigid_body_ros.scene import Scene
from rigid_body_ros.scene.parts import described

#: The effect of the last digits is reported if it exceeds this many times the rounding error.
_REPORTED = 10.0


@dataclass(eq=False)
class Replay:
    """
    The result of replaying a recording.

    Attributes
    ----------
    scene : Scene
    interpolation : str
    topic : str
        The torque topics, separated by commas.
    wheel_source : str
        A phrase that says where the rotor torque comes from.
    account : Account
        What became of the torque messages.
    first_ns, last_ns : int
        The first and last stamps of the torques and wheel commands, ns. If there are no torques or
        wheel commands, both stamps are the start time.
    damage : str
        Which part of the recording was lost; '' if nothing was lost.
    start, last : State
        The first and last states of the motion.
    solvers : dict
        For each solver, the length of the part of the motion that the solver computed, ns. A key
        consists of the name of the solver and, in parentheses, the reason why it was chosen.
    check : Check, optional
        How much the motion violates the conservation laws, and which part of the motion was
        checked.
    last_digits : LastDigits, optional
        How far the motion moves if the last digits of the inertia, torques and start state change.
        The estimate may cover only the beginning of the motion. None if there is no estimate.
    gaps : tuple of Gaps
        The gaps in each torque log, in the order of the topics. The rotor torque is last.
    saturation : Saturation, optional
        The speeds and efforts that exceed the limits of named wheels; None if there are no named
        wheels.
    seconds : dict
        How long the steps 'read', 'propagate' and 'write' took, s of wall time.
    problem, trajectory : Problem, Trajectory, optional
        The problem with all torques, and the whole motion. Both are None if `replay` did not keep
        them; see its parameter `keep`.
    collected : optional
        The object that the argument `collect` of `replay` returned.
    earlier : tuple of Replay
        If the recording contains several epochs of a node, this object is the result of the last
        epoch, and `earlier` contains the results of the others.
    uncertain : sequence of (str, object)
        Rows of the summary about the band around the motion, if parameters are uncertain.

    """

    scene: Scene
    interpolation: str
    topic: str
    wheel_source: str = ''
    account: Account = field(default_factory=Account)
    first_ns: int = 0
    last_ns: int = 0
    damage: str = ''
    start: State = field(default_factory=State)
    last: State = field(default_factory=State)
    solvers: dict[str, int] = field(default_factory=dict)
    check: Check | None = None
    last_digits: LastDigits | None = None
    gaps: tuple[Gaps, ...] = ()
    saturation: Saturation | None = None
    seconds: dict[str, float] = field(
        default_factory=lambda: {'read': 0.0, 'propagate': 0.0, 'write': 0.0})
    problem: Problem | None = None
    trajectory: Trajectory | None = None
    collected: Collector | None = None
    earlier: tuple[Replay, ...] = ()
    uncertain: Sequence[tuple[str, object]] = ()

    def text(self) -> str:
        """Return a summary of the replay as text, with one fact per line."""
        return lines(f'{name:14}{text}' for name, text in self.rows())

    __str__ = text

    @property
    def warnings(self) -> list[str]:
        """Return the warnings about lost torques, gaps between torques, and limits of wheels."""
        return [*self.account.faults, *(gaps.warning for gaps in self.gaps if gaps.warning),
                *(self.saturation.warnings if self.saturation else [])]

    def rows(self, digits: int = 15) -> list[tuple[str, object]]:
        """Return the rows of the summary; numbers in states have `digits` significant digits."""
        last, moved, epochs = self.last, self.last_digits, (*self.earlier, self)
        sequence = self.scene.euler_sequence
        angles = euler.from_quaternion(last.attitude, sequence)
        seconds = {name: sum(epoch.seconds[name] for epoch in epochs) for name in self.seconds}
        split = ', '.join(f'{name} {taken:.2g} s' for name, taken in seconds.items())
        longest = sorted(self.gaps, key=lambda gaps: gaps.longest[1])
        speed = sum(map(_span, epochs)) / sum(seconds.values())
        return [
            *_earlier(self, digits),
            ('torques', f'{self.account.samples} on {self.topic}, over '
                        f'{(self.last_ns - self.first_ns) * 1e-9:.9g} s'),
            *([('lost', self.damage)] if self.damage else []),
            *([('account', self.account.counted)] if self.account.counted else []),
            *(('note', text) for text in self.account.notes),
            *(('longest gap', str(gaps)) for gaps in longest[-1:] if gaps.longest[1]),
            *(('warning', text) for text in self.warnings),
            ('interpolation', f'{self.interpolation} (attitude_tradeoff shows what another would '
                              'change)'),
            ('body', self.scene.body.symmetry),
            *described(self.scene.values),
            *([('rotors', self.wheel_source)] if self.scene.has_rotors else []),
            *(('solver', name if len(self.solvers) == 1 else f'{span_ns * 1e-9:.9g} s by {name}')
              for name, span_ns in self.solvers.items()),
            ('final state', f'{_span(self):.9g} s after the start'),
            ('  attitude', f'{numbers(last.attitude, digits)}  (x y z w)'),
            (f'  {sequence}', f'{numbers(angles, digits)}  rad'),
            ('  body rates', f'{numbers(last.angular_velocity, digits)}  rad/s'),
            *([('  rotors', f'{numbers(last.rotor_momentum, digits)}  N m s')]
              if self.scene.has_rotors else []),
            *self.uncertain,
            ('check', self.check),
            *([('last digits', moved)] if moved and
              moved.effect > _REPORTED * moved.rounding else []),
            ('speed', f'{speed:.3g} times real time ({split})'),
        ]


def _earlier(result: Replay, digits: int) -> list[tuple[str, object]]:
    """Return the summary's rows about earlier epochs; none if there is only one epoch."""
    if not result.earlier:
        return []
    return [('epochs', f'{len(result.earlier) + 1}, each from its own start state; the rows '
                       'below, plots and pages describe the last one'),
            *((f'  epoch {number}',
               f'from {epoch.start.time_ns} ns on, over {_span(epoch):.9g} s, to attitude '
               f'{numbers(epoch.last.attitude, digits)} (x y z w) and body rates '
               f'{numbers(epoch.last.angular_velocity, digits)} rad/s')
              for number, epoch in enumerate(result.earlier, 1))]


def _span(result: Replay) -> float:
    return (result.last.time_ns - result.start.time_ns) * 1e-9
