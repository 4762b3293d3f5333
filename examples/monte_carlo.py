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
What becomes of an attitude where the moments of inertia are known to 5 % only.

A thousand bodies are drawn, and each is put under the same recorded torques from the same start.
It prints how far from the nominal body's they end. But for the times taken, the numbers are the
same in every run.

    python examples/monte_carlo.py

The very first run takes some seconds more: it compiles the package's kernels.
"""

from pathlib import Path
import time

import numpy as np
from rigid_body_ros import propagate, replay, RigidBody, scene, so3

ROOT = Path(__file__).resolve().parent.parent
BODIES, SPREAD = 1000, 0.05


def draw(nominal):
    """
    Return bodies with other principal moments about the same principal axes.

    Parameters
    ----------
    nominal : RigidBody
        Whose largest moment is less than the sum of the others by more than the spread makes up
        for: otherwise RigidBody refuses what no distribution of mass can have.

    """
    factors = np.random.default_rng(1).uniform(1.0 - SPREAD, 1.0 + SPREAD, (BODIES, 3))
    axes = nominal.principal_axes
    return [RigidBody(axes * moments @ axes.T) for moments in nominal.principal_moments * factors]


def main():
    cubesat = scene.load(ROOT / 'config' / 'tumbler.yaml')
    _, log, start = replay.read(ROOT / 'test' / 'recordings' / 'tumbler.mcap', cubesat)
    end_ns = log.times_ns[-1:]
    # The first run compiles the kernels, and is not among those that are timed.
    nominal = propagate(cubesat.body, start, log, at=end_ns, **cubesat.options).attitude[0]

    began = time.perf_counter()
    bodies = draw(cubesat.body)
    drawn = time.perf_counter()
    ends = [propagate(body, start, log, at=end_ns, **cubesat.options).attitude[0]
            for body in bodies]
    done = time.perf_counter()
    distances = so3.angle_between(ends, nominal)

    print('torques             ', f'{len(log)} over {(end_ns[0] - start.time_ns) * 1e-9:.9g} s')
    print('nominal end         ', *nominal, '(x y z w)')
    print('median distance     ', f'{np.median(distances):.6g} rad')
    print('95th percentile     ', f'{np.percentile(distances, 95):.6g} rad')
    print('time per body drawn ', f'{(drawn - began) / BODIES * 1e3:.3g} ms')
    print('time per run        ', f'{(done - drawn) / BODIES * 1e3:.3g} ms')


if __name__ == '__main__':
    main()
