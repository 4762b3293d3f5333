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
Write the truth of the motions of `test/conformance` with 30 digits.

    python benchmarks/make_conformance.py [MOTION ...]

`test/conformance/README.md` describes the files. The truth comes from `test/truth.py`, which
shares no code with the package; only `rounding` comes from the package itself. To add a motion,
write a file with its `about` and `inputs`.
"""

from itertools import pairwise
import json
from pathlib import Path
import sys

from mpmath import mp
import numpy as np
from rigid_body_ros import GravityGradient, Problem, RigidBody, State, TorqueLog, UniformField
from rigid_body_ros.common.arrays import symmetric
from rigid_body_ros.propagation.sensitivity import last_digit_effect

TESTS = Path(__file__).resolve().parents[1] / 'test'
sys.path.insert(0, str(TESTS))
import truth  # noqa: E402, I100

FOLDER = TESTS / 'conformance' / 'motions'
DIGITS, OUTPUTS = 30, 10


def true_rows(values):
    """Return the times, ns, and the true attitudes and angular velocities."""
    rows, end_ns = values['torques_t_ns_x_y_z'], values['end_ns']
    times_ns = sorted({end_ns * k // OUTPUTS for k in range(1, OUTPUTS + 1)})
    given, torque, torques = {row[0]: row[1:] for row in rows}, [0.0] * 3, []
    marks = sorted({0, *times_ns, *given})
    for begin_ns, next_ns in pairwise(marks):
        torque = given.get(begin_ns, torque)
        torques.append((next_ns - begin_ns, torque, values['torque_frame'] == 'space'))
    field, orbit = values.get('uniform_field'), values.get('orbit')
    states = truth.series(
        symmetric(values['inertia_xx_yy_zz_xy_xz_yz']), values['attitude_xyzw'],
        values['angular_velocity'], torques, 40, values.get('rotor_momentum', [0.0] * 3),
        symmetric(values.get('damping_xx_yy_zz_xy_xz_yz', [0.0] * 6)),
        fields=[(field['moment_body'], field['field_space'])] if field else [],
        orbit=(orbit['rate'], orbit['position_space'],
               np.cross(orbit['normal_space'], orbit['position_space'])) if orbit else
        (0, (1, 0, 0), (0, 1, 0)))
    at = dict(zip(marks[1:], states))
    return [[time_ns, *([mp.nstr(x, DIGITS) for x in part] for part in at[time_ns])]
            for time_ns in times_ns]


def problem(values):
    """Return a motion as a problem of this package."""
    rows, field, orbit = (values.get(name) for name in (
        'torques_t_ns_x_y_z', 'uniform_field', 'orbit'))
    fields = [UniformField(*field.values())] if field else []
    fields += [GravityGradient(*orbit.values(), 0)] if orbit else []
    log = TorqueLog([row[0] for row in rows], [row[1:] for row in rows],
                    values['torque_frame']) if rows else None
    return Problem(
        RigidBody(symmetric(values['inertia_xx_yy_zz_xy_xz_yz']),
                  symmetric(values.get('damping_xx_yy_zz_xy_xz_yz', [0.0] * 6))),
        State(0, values['attitude_xyzw'], values['angular_velocity'],
              values.get('rotor_momentum', [0.0] * 3)), log, fields=fields)


def hexadecimal(value):
    """Return a copy of inputs in which each double is written in hexadecimal notation."""
    if isinstance(value, float):
        return value.hex()
    if isinstance(value, list):
        return [hexadecimal(each) for each in value]
    return {name: hexadecimal(each) for name, each in value.items()} \
        if isinstance(value, dict) else value


def main(names):
    """Complete the files of the named motions, or of all."""
    for path in sorted(FOLDER.glob('*.json')):
        if names and path.stem not in names:
            continue
        given = json.loads(path.read_text())
        inputs = given['inputs']
        rows = true_rows(inputs)
        written = {'name': path.stem, 'about': given['about'], 'inputs': inputs,
                   'inputs_in_hexadecimal': hexadecimal(inputs),
                   'truth_t_ns_attitude_xyzw_angular_velocity': rows,
                   'truth_error': 10.0 ** (1 - DIGITS),
                   'rounding': last_digit_effect(problem(inputs), [row[0] for row in rows])}
        path.write_text(json.dumps(written, indent=1) + '\n')
        print(f"{path.stem}: a last digit of the inputs turns it by {written['rounding']:.1e} rad",
              flush=True)


if __name__ == '__main__':
    main(sys.argv[1:])
