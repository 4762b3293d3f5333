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

"""Panels that plot a residual torque in body axes, in space axes, and as a spectrum."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.report import style
from rigid_body_ros.report.charts import Curves, Panel
from rigid_body_ros.report.panels import limits, SINCE_FIRST
from rigid_body_ros.sensing.residual_torque import ResidualTorque
from rigid_body_ros.sensing.spectrum import spectrum


def residual_panels(torque: ResidualTorque, sensors: Sequence[Measured],
                    start_ns: int) -> Iterator[Panel]:
    """
    Generate the panels that plot a residual torque.

    Parameters
    ----------
    torque : ResidualTorque
        The residual torque with its noise.
    sensors : sequence of Measured
        Measurements in body axes. The panel in space axes is drawn only if the measurements
        include attitudes.
    start_ns : int
        The time at which the time axis of the panels begins.

    """
    noise = np.stack([torque.noise, torque.noise])
    shown = [('body', torque.torques, noise)]
    shown += [('space', *torque.in_space(sensor)) for sensor in sensors
              if sensor.attitude is not None and len(sensor) > 1][:1]
    for axes, torques, sigma in shown:
        label = f'residual torque, {axes} axes, averaged over {torque.window_s:.2g} s'
        yield Panel(label, 'N m', [
            Curves.thinned(torque.times_ns, torques, style.TORQUES, start_ns),
            limits(torque.times_ns, 2.0 * sigma, '±2 sigma of the noise', start_ns)], SINCE_FIRST)
    found = spectrum(torque)
    if found:
        names = ['99 % limit of white noise', '', '']
        yield Panel('amplitude of the residual torque, body axes', 'N m', [
            Curves(found.hertz, found.amplitudes, found.amplitudes, style.TORQUES),
            Curves(found.hertz, found.limits, found.limits, names, style='limits')],
            'frequency (Hz)', 'log')
