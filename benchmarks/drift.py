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
Measure how conserved quantities drift with time under fields.

    python benchmarks/drift.py [--turns N] [--seeds N]

The quantities are the energy including the potential of the fields, the momentum about their
direction, Kovalevskaya's integral, and Jacobi's integral in orbit. A drift is the largest
difference from the value at the start up to a time, relative to the size of the terms of the
quantity. The table contains medians over motions from random starts. The last column is the power
of time with which the drift grows: 0.5 for rounding errors with random signs, and 1 for rounding
errors with one sign.
"""

import argparse
from pathlib import Path
import sys

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / 'test'))
import fields  # noqa: E402, I100

ROWS = (('asymmetric top', fields.energy), ('asymmetric top', fields.momentum_along),
        ('Lagrange', fields.energy), ('Lagrange', fields.momentum_along),
        ('Kovalevskaya', fields.energy), ('Kovalevskaya', fields.momentum_along),
        ('Kovalevskaya', fields.kovalevskaya_integral),
        ('gyrostat', fields.energy), ('gyrostat', fields.momentum_along),
        ('satellite', fields.jacobi_integral),
        ('satellite with a wheel', fields.jacobi_integral))
#: Number of times, up to each power of ten, at which a quantity is computed.
TIMES = 100


def drifts(name, quantity, powers, seed):
    """Return the drift after each number of turns."""
    make = fields.in_orbit if name.startswith('satellite') else fields.under_one_field
    problem = make(name, seed)
    end_ns = fields.turns(problem, powers[-1])[-1]
    ends_ns = [end_ns * (count / powers[-1]) for count in powers]
    at = np.unique(np.linspace(0.0, ends_ns, TIMES).astype(np.int64))
    found = quantity(problem, problem.propagate(at=at))
    return [found._replace(values=found.values[at <= one]).drift() for one in ends_ns]


def main():
    """Print a row for each quantity."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--turns', type=int, default=10_000,
                        help='a power of ten; 10 000 by default')
    parser.add_argument('--seeds', type=int, default=9, help='starts; 9 by default')
    arguments = parser.parse_args()
    powers = [10 ** k for k in range(1, len(str(arguments.turns)))]
    print(f'{"turns":40}' + ''.join(f'{count:>10}' for count in powers) + '     power')
    for name, quantity in ROWS:
        found = np.median([drifts(name, quantity, powers, seed)
                           for seed in range(arguments.seeds)], axis=0)
        power = np.polyfit(np.log(powers[1:]), np.log(found[1:]), 1)[0]
        label = f'{name}, {quantity.__name__.replace("_", " ")}'
        print(f'{label:40}' + ''.join(f'{one:10.1e}' for one in found) + f'{power:10.2f}',
              flush=True)


if __name__ == '__main__':
    main()
