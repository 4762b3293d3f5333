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

from itertools import pairwise
import json
from pathlib import Path
import sys

from mpmath import mp
import numpy as np
from rigid_body_ros.common.arrays import ENTRIES

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'test'))
import derivatives_truth as cases  # noqa: E402, I100
import truth  # noqa: E402, I100

CHANGE = mp.mpf(10) ** -22


def motion(case, component='', change=0):
    """Return attitude and rates at the end of a case, with a component of a parameter changed."""
    name, _, entry = component.rpartition('.')
    values = {each: truth.exact(value) for each, value in case.parameters().items()}
    if name == 'initial_attitude':
        turn = truth.exact(np.zeros(4))
        turn['xyz'.index(entry)], turn[3] = mp.sin(change / 2), mp.cos(change / 2)
        values['attitude'] = truth.times(values['attitude'], turn)
    elif name in ('inertia', 'damping'):
        row, column = ENTRIES[entry[1:]]
        for place in {(row, column), (column, row)}:
            values[name][place] += change
    elif name:
        values[name]['xyz'.index(entry)] += change
    elif component:
        values[component][0] += change
    if case.is_free:
        return truth.free(values['inertia'], values['attitude'],
                          values['initial_angular_velocity'], case.end_ns)
    return _under_torques(case, values)


def _under_torques(case, values):
    tensor, momentum, motor = _carrier(case, values)
    fields = [(values['weight.moment'], case.gravity)] if any(case.moment) else []
    orbit = case.mean_motion, (1, 0, 0), (0, 1, 0)
    torques, middle = _torques(case, values)
    bodies = [(tensor, values['damping'], torques[:middle])]
    if case.keep:
        bodies.append((cases.NEXT.inertia, cases.NEXT.damping, torques[middle:]))
    state = values['attitude'], values['initial_angular_velocity']
    for body, damping, acting in bodies:
        if case.keep == 'momentum':
            state = state[0], _solve(truth.exact(body), tensor @ state[1])
        state = truth.series(body, *state, [one for one in acting if one[0]], 50, momentum,
                             damping, motor, fields, orbit, values['torque_lag'][0])[-1]
    return state


def _carrier(case, values):
    # Return the inertia without the wheels, the momentum of all rotors, and the torque on them.
    tensor, momentum = values['inertia'], values['initial_rotor_momentum']
    motor, rates = truth.exact(case.motor), values['initial_angular_velocity']
    for wheel, effort in zip(case.wheels, case.efforts):
        axis, inertia = truth.exact(wheel.axis), mp.mpf(wheel.inertia)
        tensor = tensor - inertia * np.multiply.outer(axis, axis)
        momentum = momentum + inertia * (mp.mpf(wheel.initial_speed) + axis @ rates) * axis
        motor = motor + mp.mpf(effort) * axis
    return tensor, momentum, motor


def _torques(case, values):
    # Return the torques, and how many of them end before the body changes. A change of the delay
    # may end a torque before it begins: the motion then goes back, so it stays differentiable.
    delay, half = values['torque_delay'][0] * cases.SECOND, case.end_ns // 2
    rows = truth.polynomials(case.times_ns, case.torques, case.interpolation) if case.count else []
    begins = [(0, truth.exact(np.zeros((1, 3))))] + [
        (time_ns + delay if time_ns >= 0 else 0, values['torque_gains'] * row)
        for time_ns, row in zip(case.times_ns.tolist(), rows)]
    middle = len(begins)
    if case.keep:
        middle = 1 + int(case.times_ns.searchsorted(half))
        begins.insert(middle, (half, begins[middle - 1][1]))
    return [(end - begin, [torque[0] + values['torque_bias'], *torque[1:]], case.in_space)
            for (begin, torque), (end, _) in pairwise([*begins, (case.end_ns, None)])], middle


def _solve(matrix, vector):
    return np.array([*mp.lu_solve(mp.matrix(matrix.tolist()), mp.matrix(vector.tolist()))])


def derivative(case, component, attitude):
    """Return the derivative of the attitude, as a rotation vector, and that of the rates."""
    before, after = (motion(case, component, sign * CHANGE) for sign in (-1, 1))
    change = (after[0] - before[0]) / (2 * CHANGE)
    turn = 2 * truth.times(attitude * np.array([-1, -1, -1, 1]), change)[:3]
    return [[mp.nstr(x, 20) for x in values]
            for values in (turn, (after[1] - before[1]) / (2 * CHANGE))]


def main(names):
    """Write the file, with new derivatives for the named cases, or for all."""
    for name in names or cases.CASES:
        case = cases.CASES[name]
        with mp.workdps(75):
            attitude, _ = motion(case)
            components = case.problem().derivatives(case.names(), at=[0]).names
            cases.TRUTH[name] = {component: derivative(case, component, attitude)
                                 for component in components}
        print(name, flush=True)
        (ROOT / 'test/truth_derivatives.json').write_text(json.dumps(cases.TRUTH, indent=0) + '\n')


if __name__ == '__main__':
    main(sys.argv[1:])
