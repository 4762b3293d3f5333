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

"""Reference motions under several sources, rotors, damping and fields, with fifty digits."""

from functools import cached_property
import json
from pathlib import Path

from conftest import bound_at
import numpy as np
from rigid_body_ros import (
    Actuator,
    BodyLog,
    EffortLog,
    GravityGradient,
    Problem,
    Propagator,
    RigidBody,
    State,
    TorqueLog,
    UniformField,
    Wheel,
)
from rigid_body_ros.mechanics import so3
import truth

_HERE = Path(__file__).resolve().parent
TRUTH, TRUTH_OF_FIELDS, TRUTH_OF_LOOPS = (
    _HERE / f'truth_{name}' for name in ('terms', 'fields', 'loop'))
NAMES, NAMES_OF_FIELDS = (sorted(path.stem for path in folder.glob('*.json'))
                          for folder in (TRUTH, TRUTH_OF_FIELDS))
SECOND = 10 ** 9
#: Change of the start, rad, with which `magnification` measures the sensitivity. The motions stay
#: close even if it is magnified by 1e9, and rounding is at most a ten-thousandth of it.
_CHANGE = 1e-11


def problem_of(values, **options):
    """Return the problem of a file: a start at time 0, and all that acts on the body."""
    tensors = [values.get(name) and _tensor(values[name]) for name in (
        'inertia_ixx_iyy_izz_ixy_ixz_iyz', 'damping_xx_yy_zz_xy_xz_yz')]
    sources = [(values.get('torque_t_ns_x_y_z'), values.get('torque_frame'), None),
               *((rows, frame, None)
                 for frame, rows in values.get('other_torques_frame_rows', ())),
               *((one['t_ns_x_y_z'], one['frame'], one.get('actuator'))
                 for one in values.get('sources', ()))]
    logs = [TorqueLog(*_columns(rows), frame or 'body') for rows, frame, _ in sources if rows]
    actuators = [actuator and Actuator(**actuator) for rows, _, actuator in sources if rows]
    fields = [UniformField(*pair) for pair in values.get('fields_moment_body_field_space', ())]
    if 'orbit_rate_direction_normal' in values:
        fields.append(GravityGradient(*values['orbit_rate_direction_normal']))
    wheels, efforts, changes = values.get('wheels'), None, values.get('bodies_t_ns_six')
    if wheels:
        efforts = EffortLog(*_columns(values['efforts_t_ns_each']))
        wheels = [Wheel(**wheel) for wheel in wheels]
    elif 'wheel_torque_t_ns_x_y_z' in values:
        wheels = TorqueLog(*_columns(values['wheel_torque_t_ns_x_y_z']))
    if changes:
        changes = BodyLog([row[0] for row in changes], [
            RigidBody.from_moments(*row[1:]) for row in changes], values['keep'])
    start = State(0, values['initial_attitude_xyzw'], values['initial_angular_velocity'],
                  values.get('rotor_momentum', (0, 0, 0)))
    return Problem(RigidBody(*tensors), start, logs, wheels=wheels, efforts=efforts, fields=fields,
                   changes=changes, actuator=actuators if any(actuators) else None, **options)


class Reference:
    """A problem and its motion with 24 digits, read from a file of a folder."""

    def __init__(self, name, folder=TRUTH):
        values = json.loads((folder / f'{name}.json').read_text())
        self.problem, self._rows = problem_of(values), values['truth']
        self.start = self.problem.start
        self.times_ns = np.array([row['t_ns'] for row in self._rows])

    def propagate(self, at, start=None):
        return self.problem.replaced(start=start or self.start).propagate(at=at)

    def truth(self, key):
        """Return the rows of a quantity, shape (m, n), in 24 digits."""
        return truth.exact([row.get(key, ['0.0'] * 3) for row in self._rows])

    @cached_property
    def bound(self):
        """Return the bound on the errors at each time, rad or relative, shape (m,)."""
        return bound_at(self.times_ns, self.propagate, 0)


def magnification(run, start, times_ns):
    """
    Return by how much a motion magnifies a change of its start, at least 1, by time, shape (m,).

    Each coordinate of the start is changed by 1e-11 in both directions. The coordinates are a
    rotation about each body axis, rad, and each component of the angular velocity, relative to the
    largest rate of the motion. The differences of the changed motions, divided by the differences
    of their starts, form a 6 by 6 matrix for each time. The result is its largest singular value.

    Parameters
    ----------
    run : callable
        Returns the motion from a start at times, ns.
    start : State
        The start that is changed.
    times_ns : array of int, shape (m,)
        The times of the result.

    """
    speed = np.linalg.norm(run(start, times_ns).angular_velocity, axis=1).max()
    columns = []
    for change in _CHANGE * np.eye(6):
        one, other = (run(_moved(start, sign * change, speed), times_ns) for sign in (1.0, -1.0))
        turned = so3.log(so3.multiply(so3.conjugate(other.attitude), one.attitude))
        rates = (one.angular_velocity - other.angular_velocity) / speed
        columns.append(np.hstack([turned, rates]) / (2.0 * _CHANGE))
    return np.maximum(1.0, np.linalg.norm(np.stack(columns, axis=-1), 2, axis=(1, 2)))


def _moved(start, change, speed):
    return State(start.time_ns, so3.multiply(start.attitude, so3.exp(change[:3])),
                 start.angular_velocity + speed * change[3:], start.rotor_momentum)


def relative(found, expected):
    """Return errors relative to the largest expected vector; zero vectors must be exact."""
    size = np.linalg.norm(expected.astype(float), axis=1).max()
    return np.linalg.norm((found - expected).astype(float), axis=1) / (size or 1.0)


def assert_agrees(problem, values):
    """Assert that a motion is that of a file, up to rounding as the motion magnifies it."""
    rows = values['truth']
    times_ns = np.array([row['t_ns'] for row in rows])
    limits = values['magnification'] * bound_at(
        times_ns, lambda at: problem.propagate(at=at), problem.start.time_ns)
    motion = problem.propagate(at=times_ns)
    for k, (row, limit) in enumerate(zip(rows, limits)):
        assert truth.chord(truth.exact(row['q']), motion.attitude[k]) <= limit
        assert np.max(abs(truth.exact(row['w']) - motion.angular_velocity[k])) <= limit
        if problem.named_wheels:
            speeds = motion.wheel_speeds[k]
            assert np.max(abs(truth.exact(row['wheel_speeds']) - speeds)) <= limit * max(
                1.0, np.max(abs(speeds)))


def calls(problem):
    """Return what applies the torques, commands and bodies of a problem: (method, *arguments)."""
    found = [('apply', int(time_ns), torque, 'space' if in_space else 'body', source)
             for source, log in enumerate(problem.logs)
             for time_ns, torque, in_space in zip(log.times_ns, log.torques, log.in_space)]
    if problem.wheels:
        found += [('apply_wheels', int(time_ns), torque)
                  for time_ns, torque in zip(problem.wheels.times_ns, problem.wheels.torques)]
    if problem.efforts:
        found += [('apply_efforts', int(time_ns), {
            name: effort for name, effort in zip(problem.named_wheels.names, row)
            if effort == effort})
            for time_ns, row in zip(problem.efforts.times_ns, problem.efforts.efforts)]
    if problem.changes:
        found += [('apply_body', int(time_ns), body, problem.changes.keep)
                  for time_ns, body in zip(problem.changes.times_ns, problem.changes.bodies)]
    return found


def live(problem, start=None, history=100.0):
    """Return a propagator to which the calls of a problem can be applied."""
    options = problem.options
    return Propagator(
        problem.body, start or problem.start, wheels=problem.named_wheels
        and problem.named_wheels.wheels, fields=problem.fields, actuator=problem.actuators or None,
        solver=options.solver, tolerance=options.tolerance, max_step=options.max_step,
        torque_timeout=options.torque_timeout, history=history)


def applied(propagator, call):
    """Apply a call to a propagator; return whether the propagator accepted it."""
    name, *arguments = call
    return getattr(propagator, name)(*arguments)


def numbers(motion):
    """Return all numbers of a trajectory, shape (m, n), or of a state, shape (n,)."""
    names = 'attitude', 'angular_velocity', 'rotor_momentum', 'wheel_speeds', 'wheel_efforts'
    return np.concatenate([getattr(motion, name) for name in names], axis=-1)


def _tensor(values):
    xx, yy, zz, xy, xz, yz = values
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _columns(rows):
    return [row[0] for row in rows], [row[1:] for row in rows]
