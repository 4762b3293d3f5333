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

"""Find gaps in a torque log, and reject gaps in which the motion takes too long to compute."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import timedelta
import math

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation.options import FASTEST
from rigid_body_ros.runtime.terminal import report
from rigid_body_ros.scene import Scene

#: Warn about a torque that acts for longer than _LONG seconds and for longer than _TIMES times the
#: usual spacing of the samples.
_LONG, _TIMES = 1.0, 100
#: The spacings are counted in a histogram with a logarithmic scale and this many bins per factor
#: of two.
_CLASSES = 16
#: Largest number of steps in a gap, and the approximate computing time per step, s. The largest
#: number of steps takes about 11 hours.
_MOST_STEPS, _STEP = 1e10, 4e-6
#: A smaller divisor is replaced by this number, so that nothing is divided by zero.
_TINY = 1e-250
#: If a computation takes longer than this many seconds, the user is told in advance.
_PATIENCE = 10.0


#: The begin and the length, ns, of an interval between two neighbouring samples.
Gap = tuple[int, int]


class Gaps:
    """
    Find the gaps between the samples of a torque log; the log is added piece by piece.

    Parameters
    ----------
    start_ns, end_ns : int
        The start and end of the motion, ns. Only the part of a gap between these times counts.
    timeout_ns : int
        The longest time for which a torque acts, ns; 0 if there is no limit.

    Attributes
    ----------
    longest : Gap
    acted : Gap
        The longest gap during which the torque is not zero and does not time out.

    """

    def __init__(self, start_ns: int, end_ns: int, timeout_ns: int) -> None:
        self._span, self._timeout_ns = (start_ns, end_ns), timeout_ns
        self.longest: Gap = (0, 0)
        self.acted: Gap = (0, 0)
        self._counts = np.zeros(64 * _CLASSES, np.int64)
        self._last_ns = -2 ** 63

    def add(self, log: TorqueLog) -> None:
        """Add a piece of the log. The piece may overlap the previous one."""
        times = np.clip(log.times_ns, *self._span)
        first = int(np.searchsorted(times, self._last_ns))
        times, acts = times[first:], np.any(log.torques[first:] != 0.0, axis=1)
        if times.size < 2:
            return
        acts = acts[:-1] if log.interpolation == 'hold' else acts[:-1] | acts[1:]
        lengths = np.diff(times)
        classes = (np.log2(lengths[lengths > 0]) * _CLASSES).astype(np.int64)
        self._counts += np.bincount(classes, minlength=len(self._counts))
        self.longest = _longer(self.longest, times, lengths)
        if self._timeout_ns:
            acts = acts & (lengths <= self._timeout_ns)
        self.acted = _longer(self.acted, times, np.where(acts, lengths, 0))
        self._last_ns = int(times[-1])

    @property
    def usual(self) -> float:
        """
        Return the median spacing of the samples, s, to within a few percent.

        The result is 0 if there are fewer than two samples.
        """
        total = np.cumsum(self._counts)
        middle = int(np.searchsorted(total, (total[-1] + 1) // 2))
        return float(2.0 ** ((middle + 0.5) / _CLASSES)) * 1e-9 if total[-1] else 0.0

    @property
    def warning(self) -> str:
        """Return a warning if a torque acts for much longer than usual; otherwise ''."""
        seconds = self.acted[1] * 1e-9
        if seconds <= max(_LONG, _TIMES * self.usual):
            return ''
        begin = (self.acted[0] - self._span[0]) * 1e-9
        return (f'a torque acts for {seconds:.9g} s until the next one, from '
                f'{begin:.9g} s after the start, although torques are usually '
                f'{self.usual:.2g} s apart: check the clock that set the stamps, or set '
                'torque_timeout')

    def __str__(self) -> str:
        begin_ns, length_ns = self.longest
        return (f'{length_ns * 1e-9:.9g} s between torques, from '
                f'{(begin_ns - self._span[0]) * 1e-9:.9g} s after the start')


def announce(where: str, logs: Sequence[TorqueLog], span_ns: tuple[int, int], speed: float,
             scene: Scene) -> None:
    """
    Tell the user how long the motion takes to compute, if that is longer than `_PATIENCE`.

    The motion is that for one piece of each log; see `computing_time`.
    """
    seconds = max((computing_time(log, span_ns, speed, scene) for log in logs), default=0.0)
    if seconds > _PATIENCE:
        report(f'{where}: computing the motion takes about {timedelta(seconds=round(seconds))} '
               '(h:min:s)')


def computing_time(log: TorqueLog, span_ns: tuple[int, int], speed: float,
                   scene: Scene) -> float:
    """
    Estimate the time that it takes to compute the motion for one piece of a log, s.

    Parameters
    ----------
    log : TorqueLog
        The piece.
    span_ns : tuple of int
        Start and end of the motion, ns.
    speed : float, rad/s
        How fast the body rotates at the start of the piece.
    scene : Scene
        The body and the solver.

    Raises
    ------
    ValueError
        A torque acts for so long that the computation would practically never end.

    """
    if not len(log):
        return 0.0
    # Try a quick upper bound first: assume that the largest torque acts over one long interval.
    most = _steps(np.array([math.sqrt(3.0) * np.abs(log.torques).max()]),
                  np.array([(span_ns[1] - span_ns[0]) * 1e-9]), speed, scene)
    if most.max() * _STEP <= _PATIENCE:
        return float(most.max()) * _STEP
    edges = np.append(np.clip(log.times_ns, *span_ns), span_ns[1])
    seconds = np.diff(edges) * 1e-9
    with np.errstate(over='ignore'):
        sizes = np.linalg.norm(log.torques, axis=1)
    if log.interpolation != 'hold':  # the larger of the torques at both ends
        sizes = np.maximum(sizes, np.append(sizes[1:], 0.0))
    steps = _steps(sizes, seconds, speed, scene)
    if steps.max(initial=0.0) > _MOST_STEPS:
        row = int(np.argmax(steps))
        torque = log.torques[row].tolist()
        raise ValueError(
            f'the torque {torque} N m at {log.times_ns[row]} ns acts until {edges[row + 1]} ns, '
            f'for {seconds[row]:.9g} s: expected at most {_MOST_STEPS:.0e} steps to compute this, '
            f'found about {steps[row]:.0e}; check the clock that set the stamps, or set '
            'torque_timeout or --until')
    return float(steps.sum()) * _STEP


def _steps(sizes: Floats, seconds: Floats, speed: float, scene: Scene) -> Floats:
    """Estimate how many steps the solver takes while each torque, N m, acts: one per radian."""
    options, body = scene.options, scene.body
    is_closed = options.record.closed_form_beyond < np.inf and not (
        scene.has_rotors or body.is_damped or scene.fields)
    moment, rate = body.principal_moments[0], speed
    rate += sum(float(field.speed(moment, body.principal_moments[2])) for field in scene.fields)
    with np.errstate(over='ignore'):
        gain = np.clip(sizes / moment, _TINY, 1.0 / _TINY)
        if not body.is_damped:  # beyond the largest speed, the motion ends in an error
            seconds = np.minimum(seconds, FASTEST / gain)
        acting = np.minimum(seconds, options.timeout_ns * 1e-9) if options.timeout_ns else seconds
        stepped = acting if is_closed else seconds
        gained = gain * acting
        if body.is_damped:
            weakest, _, strongest = np.linalg.eigvalsh(body.damping)
            gained = np.minimum(gained, sizes / max(weakest, _TINY))
            rate += strongest / moment
        angles = (rate + 0.5 * gained) * stepped
    steps = np.zeros(len(seconds)) if options.record.fixed_step else angles
    if options.max_step is not None:
        steps = steps + stepped / options.max_step
    return np.where(sizes > 0.0, steps, 0.0) if is_closed else steps


def _longer(longest: Gap, times: NDArray[np.int64], lengths: NDArray[np.int64]) -> Gap:
    row = int(np.argmax(lengths))
    return longest if lengths[row] <= longest[1] else (int(times[row]), int(lengths[row]))
