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
Uncertainty of the final attitude if the moments of inertia are known only to 5 %.

The example draws a thousand bodies and propagates each from the same start under the same recorded
torques. It prints how far their final attitudes are from the final attitude of the nominal body.
All printed numbers except the wall times are the same in every run.

    python examples/monte_carlo.py
"""

from dataclasses import asdict
from pathlib import Path
import time

import numpy as np
from rigid_body_ros import propagate_many, read, RigidBodies, so3, States

ROOT = Path(__file__).resolve().parent.parent
BODIES, SPREAD = 1000, 0.05


def draw(nominal):
    """
    Return bodies with random principal moments and the same principal axes.

    Parameters
    ----------
    nominal : RigidBody
        Its largest moment must be clearly smaller than the sum of the other two, so that every
        drawn body is physical.

    """
    factors = np.random.default_rng(1).uniform(1.0 - SPREAD, 1.0 + SPREAD, (BODIES, 3))
    axes = nominal.principal_axes
    return RigidBodies([axes * moments @ axes.T
                        for moments in nominal.principal_moments * factors])


def main():
    problem = read(ROOT / 'test' / 'recordings' / 'tumbler.mcap',
                   ROOT / 'config' / 'tumbler.yaml')
    start, (log,), options = problem.start, problem.logs, asdict(problem.options)
    end_ns = log.times_ns[-1:]
    starts = States(np.full(BODIES, start.time_ns), start.attitude, start.angular_velocity)
    nominal = problem.propagate(at=end_ns).attitude[0]

    began = time.perf_counter()
    bodies = draw(problem.body)
    drawn = time.perf_counter()
    motions = propagate_many(bodies, starts, log, at=end_ns, **options)
    done = time.perf_counter()
    distances = so3.angle_between(motions.attitude[:, 0], nominal)

    print('torques             ', f'{len(log)} over {(end_ns[0] - start.time_ns) * 1e-9:.9g} s')
    print('nominal end         ', *nominal, '(x y z w)')
    print('median distance     ', f'{np.median(distances):.6g} rad')
    print('95th percentile     ', f'{np.percentile(distances, 95):.6g} rad')
    print('time per body drawn ', f'{(drawn - began) / BODIES * 1e3:.3g} ms')
    print('time per run        ', f'{(done - drawn) / BODIES * 1e3:.3g} ms')


if __name__ == '__main__':
    main()
