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
Measure ensembles with a controller: processor time of a run, and of its parts.

    python benchmarks/controllers.py [--runs 100] [--step 0.01]

Each run is the example of docs/ensemble.md over a minute, in this process, without the command.
The time of the controller includes only its calls. The time of a replay is that of `propagate`
under the torques of the last run, which computes the same motion without the controller.
"""

import argparse
from pathlib import Path
import sys
import time

from rigid_body_ros import scene
from rigid_body_ros.ensemble import dispersions
from rigid_body_ros.ensemble.controller import Controller
from rigid_body_ros.ensemble.runs import Ensemble

ROOT = Path(__file__).resolve().parent.parent
SECONDS = 60


def timed(function, *arguments):
    """Return the processor time of a call, s, and its result."""
    began = time.process_time()
    result = function(*arguments)
    return time.process_time() - began, result


def main():
    """Measure, and print a line for each part."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--runs', type=int, default=100)
    parser.add_argument('--step', type=float, default=0.01, help='of the controller, s')
    options = parser.parse_args()
    sys.path.insert(0, str(ROOT))
    loop = Controller.load('examples.damp_rates:damp', round(options.step * 1e9))
    problem = scene.load(ROOT / 'examples' / 'damp_rates.yaml').problem()
    end_ns, steps = SECONDS * 10 ** 9, round(SECONDS / options.step)
    ensemble = Ensemble(problem, end_ns, dispersions.load(
        ROOT / 'examples' / 'damp_rates_vary.yaml'), 0, controller=loop)
    ensemble.rows(0, 1)
    used, _ = timed(ensemble.rows, 0, options.runs)
    print(f'run         {used / options.runs:.3f} s, {options.runs / used:.2f} runs/s')
    print(f'step        {1e6 * used / options.runs / steps:.1f} us')
    law = loop.begin()
    used, _ = timed(lambda: [loop.torque(law, problem.start, 0.0) for _ in range(steps)])
    print(f'controller  {1e6 * used / steps:.1f} us')
    last, _ = ensemble.replayed(options.runs - 1)
    used, _ = timed(lambda: last.propagate(at=[end_ns]))
    print(f'replay      {1e6 * used / steps:.1f} us')


if __name__ == '__main__':
    main()
