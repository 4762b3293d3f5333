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
Write the motions of `test/conformance`: inputs, and the truth with 30 digits.

    python benchmarks/make_conformance.py [MOTION ...]

`test/conformance/README.md` describes the files. The truth comes from `test/truth.py`, which
shares no code with the package; only `rounding` comes from the package itself.
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
SECOND = 10 ** 9
DIGITS, OUTPUTS = 30, 10


def motion(about, inertia, rates, seconds, torques=(), frame='body', **others):
    """Return the inputs of a motion; each torque is held until the next one."""
    xx, yy, zz, *products = inertia
    return {'about': about, 'inertia_xx_yy_zz_xy_xz_yz': [xx, yy, zz, *(products or [0.0] * 3)],
            'attitude_xyzw': [0.0, 0.0, 0.0, 1.0], 'angular_velocity': list(rates),
            'end_ns': seconds * SECOND, 'torque_frame': frame,
            'torques_t_ns_x_y_z': [*torques], **others}


def commands(seed, count, period_ns, size):
    """Return torques with short numbers, one a period."""
    rows = np.round(np.random.default_rng(seed).normal(size=(count, 3)) * 64.0) / 64.0 * size
    return [[k * period_ns, *row] for k, row in enumerate(rows.tolist())]


FULL = (2.0, 3.0, 4.0, 0.125, -0.25, 0.0625)
MOTIONS = {
    'free_asymmetric': motion('no torque', (1.0, 2.0, 3.0), (1.0, 0.4, 2.0), 100),
    'free_flips': motion('no torque, about the intermediate axis: the body flips',
                         (1.0, 2.0, 3.0), (0.01, 1.0, 0.02), 100),
    'free_full_tensor': motion('no torque, axes that are not principal', FULL, (0.5, -1.0, 0.75),
                               60),
    'symmetric_top': motion('no torque, two equal moments', (2.0, 2.0, 1.0), (0.3, 0.1, 5.0), 60),
    'sphere': motion('no torque, three equal moments', (0.7, 0.7, 0.7), (1.0, -2.0, 0.5), 60),
    'thin_rod': motion('no torque, moments 1e-6 : 1 : 1.0000005', (1e-6, 1.0, 1.0000005),
                       (50.0, 1.0, 1.0), 10),
    'nearly_a_sphere': motion('no torque, moments 1e-9 apart',
                              (1.0, 1.0 + 1e-9, 1.0 + 2e-9), (1.0, 0.4, 2.0), 60),
    'constant_torque': motion('a constant torque in body axes', (1.0, 2.0, 3.0),
                              (0.1, 0.2, -0.1), 60, [[0, 0.02, -0.01, 0.03]]),
    'spin_up_from_rest': motion('a constant torque on a body at rest', FULL, (0.0, 0.0, 0.0), 30,
                                [[0, 0.25, 0.5, -0.125]]),
    'held_at_10_hz': motion('torques in body axes, each held for 0.1 s', FULL, (0.3, -0.2, 0.5),
                            20, commands(1, 200, SECOND // 10, 1.0)),
    'held_in_space': motion('torques in space axes, each held for 0.5 s', FULL, (0.3, -0.2, 0.5),
                            20, commands(2, 40, SECOND // 2, 1.0), 'space'),
    'damped': motion('viscous damping', FULL, (2.0, -1.0, 3.0), 30,
                     damping_xx_yy_zz_xy_xz_yz=[0.125, 0.25, 0.0625, 0.03125, 0.0, -0.03125]),
    'momentum_wheel': motion('a rotor of constant momentum', (1.0, 2.0, 3.0), (0.1, 0.2, 0.3), 60,
                             rotor_momentum=[0.5, -0.25, 2.0]),
    'hanging_top': motion('weight times lever arm, fixed in the body, in a uniform field',
                          (2.0, 2.5, 1.0), (0.1, 0.2, 6.0), 20,
                          uniform_field={'moment_body': [0.0, 0.0, 0.25],
                                         'field_space': [0.0, 0.0, -9.81]}),
    'gravity_gradient': motion(
        'a tenth of an orbit', (10.0, 8.0, 5.0), (0.02, 0.01, -0.005), 600,
        orbit={'rate': 0.00113, 'position_space': [1.0, 0.0, 0.0],
               'normal_space': [0.0, 0.0, 1.0]}),
}


def true_rows(values):
    """Return the times, ns, and the true attitudes and angular velocities."""
    rows, end_ns = values['torques_t_ns_x_y_z'], values['end_ns']
    times_ns = sorted({end_ns * k // OUTPUTS for k in range(1, OUTPUTS + 1)})
    marks = sorted({0, *times_ns, *(row[0] for row in rows)})
    stamps = np.array([row[0] for row in rows], np.int64)
    torques = []
    for begin_ns, end in pairwise(marks):
        before = int(np.searchsorted(stamps, begin_ns, 'right')) - 1
        torques.append((end - begin_ns, rows[before][1:] if before >= 0 else [0.0] * 3,
                        values['torque_frame'] == 'space'))
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
    """Write the named motions, or all."""
    FOLDER.mkdir(exist_ok=True)
    for name, values in MOTIONS.items():
        if names and name not in names:
            continue
        inputs = {key: value for key, value in values.items() if key != 'about'}
        rows = true_rows(values)
        written = {'name': name, 'about': values['about'], 'inputs': inputs,
                   'inputs_in_hexadecimal': hexadecimal(inputs),
                   'truth_t_ns_attitude_xyzw_angular_velocity': rows,
                   'truth_error': 10.0 ** (1 - DIGITS),
                   'rounding': last_digit_effect(problem(values), [row[0] for row in rows])}
        (FOLDER / f'{name}.json').write_text(json.dumps(written, indent=1) + '\n')
        print(f"{name}: a last digit of the inputs turns it by {written['rounding']:.1e} rad",
              flush=True)


if __name__ == '__main__':
    main(sys.argv[1:])
