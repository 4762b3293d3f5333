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
Make test/truth_derivatives.json: derivatives of motions, from motions with fifty digits.

A difference of two motions, divided by a change of a parameter by 1e-22, has more correct digits
than a double.
"""

import json
from pathlib import Path
import sys

from mpmath import mp
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'test'))
import derivatives_truth as cases  # noqa: E402, I100
import truth  # noqa: E402, I100

CHANGE = mp.mpf(10) ** -22


def motion(case, component='', change=0):
    """Return attitude and rates at the end of a case, with a component of a parameter changed."""
    kind, _, entry = component.partition('.')
    values = {name: truth.exact(value) for name, value in case.parameters().items()}
    if kind == 'initial_attitude':
        turn = truth.exact(np.zeros(4))
        turn['xyz'.index(entry)], turn[3] = mp.sin(change / 2), mp.cos(change / 2)
        values['attitude'] = truth.times(values['attitude'], turn)
    elif kind in ('inertia', 'damping'):
        row, column = cases.ENTRIES[entry[1:]]
        for place in {(row, column), (column, row)}:
            values[kind][place] += change
    elif kind:
        values[kind]['xyz'.index(entry)] += change
    torques = [(span_ns, values['torque_gains'] * row + values['torque_bias'], case.in_space)
               for span_ns, row in case.torques]
    if case.is_free:
        return truth.free(values['inertia'], values['attitude'],
                          values['initial_angular_velocity'], case.end_ns)
    return truth.series(values['inertia'], values['attitude'], values['initial_angular_velocity'],
                        torques, 50, values['initial_rotor_momentum'], values['damping'])[-1]


def derivative(case, component, attitude):
    """Return the derivative of the attitude, as a rotation vector, and that of the rates."""
    before, after = (motion(case, component, sign * CHANGE) for sign in (-1, 1))
    change = (after[0] - before[0]) / (2 * CHANGE)
    turn = 2 * truth.times(attitude * np.array([-1, -1, -1, 1]), change)[:3]
    return [[mp.nstr(x, 20) for x in values]
            for values in (turn, (after[1] - before[1]) / (2 * CHANGE))]


def main():
    """Write the file."""
    found = {}
    with mp.workdps(75):
        for name, case in cases.CASES.items():
            attitude, _ = motion(case)
            found[name] = {component: derivative(case, component, attitude)
                           for component in case.components()}
            print(name, flush=True)
    (ROOT / 'test/truth_derivatives.json').write_text(json.dumps(found, indent=0) + '\n')


if __name__ == '__main__':
    main()
