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

"""Collect a replayed motion batch by batch, and report it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.replay.batches import Batch
from rigid_body_ros.replay.result import Replay
from rigid_body_ros.report import moving_body
from rigid_body_ros.report.charts import Curves, FIELDS, MOMENTA, Panel, QUATERNION, RATES, TORQUES
from rigid_body_ros.report.panels import panels_of, ThinnedTorque
from rigid_body_ros.report.report import Report
from rigid_body_ros.report.text import euler_names, numbers
from rigid_body_ros.report.thinning import EveryNth, Extremes
from rigid_body_ros.scene import Scene

#: How many significant digits the report shows. The output and the terminal show all digits.
_DIGITS = 4
#: Two speeds count as equal if the larger is at most this many times the smaller.
_SAME = 1.05


class ReportCollector:
    """
    Collect the data for a report about a motion, thinning the data while the motion is computed.

    Parameters
    ----------
    scene : Scene

    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._motion = Extremes(13 if scene.has_rotors else 10)
        self._keys = EveryNth(moving_body.MOST)
        self._torques: list[ThinnedTorque] = []
        self._field_torque = Extremes(3) if scene.fields else None
        self._start_ns: int | None = None

    def add(self, batch: Batch) -> None:
        """Add a part of the motion."""
        motion, scene = batch.trajectory, self._scene
        if not motion.times_ns.size:
            return
        problem = batch.problem
        if self._start_ns is None:
            self._start_ns = int(motion.times_ns[0])
            self._torques = [ThinnedTorque(scene.timeout_ns) for _ in problem.logs]
        columns = [motion.euler_angles(scene.euler_sequence), motion.attitude,
                   motion.angular_velocity]
        if scene.has_rotors:
            columns.append(motion.rotor_momentum)
        self._motion.add(motion.times_ns, np.hstack(columns))
        for torque, log in zip(self._torques, problem.logs):
            torque.add(log, motion.times_ns)
        if self._field_torque:
            self._field_torque.add(motion.times_ns, problem.field_torque(motion.times_ns,
                                                                         motion.attitude))
        chosen = self._keys.chosen(len(motion.times_ns))
        times_ns, attitude = motion.times_ns[chosen], motion.attitude[chosen]
        torques = problem.torque(times_ns, attitude)
        self._keys.add(len(motion.times_ns), times_ns, np.hstack([
            attitude, motion.angular_velocity[chosen], torques, motion.rotor_momentum[chosen]]))

    def report(self, result: Replay, name: str,
               shown: Callable[[list[Panel]], list[Panel]] = list) -> Report:
        """Return the report of the replay of the recording `name`, with the panels `shown`."""
        times_ns, keys = self._keys.result()
        body = result.scene.body
        story = [('recording', name), *result.rows(_DIGITS),
                 ('start', f'attitude {numbers(result.start.attitude, _DIGITS)} (x y z w), body '
                           f'rates {numbers(result.start.angular_velocity, _DIGITS)} rad/s'),
                 ('moments', f'{numbers(body.principal_moments, _DIGITS)} kg m^2')]
        return Report(f'{name}: {result.topic}', _headline(times_ns, keys), story,
                      shown(self._panels()), moving_body.as_data(body, times_ns, keys))

    def _panels(self) -> list[Panel]:
        start_ns, sequence = self._start_ns or 0, self._scene.euler_sequence
        times, low, high = self._motion.result()
        seconds = np.asarray((times - start_ns) * 1e-9, np.float64)

        def curves(first: int, names: Sequence[str]) -> list[Curves]:
            part = slice(first, first + len(names))
            return [Curves(seconds, low[:, part], high[:, part], names)]
        panels = [Panel(f'Euler angles {sequence}', 'rad',
                        curves(0, euler_names(sequence)), kind='angle'),
                  Panel('quaternion', '', curves(3, QUATERNION)),
                  Panel('angular velocity, body axes', 'rad/s', curves(7, RATES))]
        if self._scene.has_rotors:
            panels.append(Panel('rotor momentum, body axes', 'N m s', curves(10, MOMENTA)))
        if self._field_torque:
            panels.append(Panel(f'{FIELDS}, body axes', 'N m', [Curves.of(
                self._field_torque, TORQUES, start_ns)]))
        return panels + panels_of(self._torques, start_ns)


def _headline(times_ns: NDArray[np.int64], keys: Floats) -> str:
    """Return a sentence that says how far the body turns and how its speed changes."""
    seconds = 1e-9 * (times_ns - times_ns[0])
    speeds = np.linalg.norm(keys[:, moving_body.RATE], axis=1)
    angle = float(np.sum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(seconds)))
    turns = angle / (2.0 * np.pi)
    far = f'by {angle:.2g} rad' if turns < 0.5 else \
        f'{turns:.1f} times' if turns < 9.95 else f'{turns:.0f} times'
    start, end, least, most = speeds[0], speeds[-1], speeds.min(), speeds.max()
    if most <= _SAME * least:
        how = f' at {start:.2g} rad/s'
    elif max(start, end) <= _SAME * min(start, end):
        how = f' at {least:.2g} to {most:.2g} rad/s'
    else:
        peaks = most > _SAME * max(start, end)
        change = 'spins up' if peaks or end > start else 'slows down'
        how = f', {change} from {start:.2g} to {most if peaks else end:.2g} rad/s' \
              + (f' and ends at {end:.2g} rad/s' if peaks else '')
    return f'the body turns {far} in {seconds[-1]:.4g} s{how}'
