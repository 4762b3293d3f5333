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

"""The table of all scene parameters, including those of named fields and wheels."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import math
import re
from typing import Any

from rigid_body_ros.common.errors import InputError, listed, quoted
from rigid_body_ros.mechanics.torque import INTERPOLATIONS
from rigid_body_ros.propagation import LONGEST, Options, SOLVERS, TOLERANCES
from rigid_body_ros.runtime.parameters import BIG, checked, is_foreign, Parameter, TINY
from rigid_body_ros.scene.quantities import FIELD, FIELD_MOMENT, MOMENT, QUANTITIES, RATE

_BODY, _DRAG, _ROTORS = (QUANTITIES[name] for name in ('inertia', 'damping', 'rotor_momentum'))
_MOMENT = 'moment of inertia about the centre of mass, body axes'
_PRODUCT = 'off-diagonal entry of the inertia tensor, signed as in URDF: ixy = - sum of m x y'
_DAMPING = 'entry of the damping tensor D, body axes; the torque is -D w'
MODES = REALTIME, LOCKSTEP, CLOCK = 'realtime', 'lockstep', 'clock'
TIME_SOURCES = HEADER, ARRIVAL = 'header', 'arrival'
#: The names of the quantities that can stay the same when the inertia changes; see `BodyLog`.
INERTIA_CHANGES = KEEP_RATE, KEEP_MOMENTUM = 'keep_rate', 'keep_momentum'
TIME_JUMPS = RESET, REBASE, IGNORE = 'reset', 'rebase', 'ignore'
#: The parameters that list the names of the uniform fields and of the wheels.
FIELDS, WHEEL_NAMES = 'fields', 'wheel_names'


def _vector(name: str, unit: str, text: str, largest: float = BIG,
            default: Sequence[float] = (0.0, 0.0, 0.0)) -> list[Parameter]:
    """Return the parameters of the components of a vector or a quaternion."""
    return [Parameter(f'{name}.{axis}', value, unit, text, (-largest, largest))
            for axis, value in zip('xyzw', default)]


ACTUATOR = (
    Parameter('actuator.topics', [], '', 'the torque_topics that carry actuator commands'),
    Parameter('actuator.delay', 0.0, 's', 'time from the stamp of a command until it takes effect',
              (0.0, LONGEST)),
    Parameter('actuator.time_constant', 0.0, 's', 'first-order lag of the torque behind the '
              'command; 0 means none, any other value must be at least 1e-9', (0.0, LONGEST)),
    *(Parameter(f'actuator.limit.{axis}', 0.0, 'N m', 'commands are clipped to this torque, in '
                'their own axes (body or space); 0 means no limit', (0.0, BIG)) for axis in 'xyz'),
)
#: The parameters of each uniform field and of each wheel, whose names begin with the name of the
#: field or wheel.
NAMED = {
    FIELDS: (
        *_vector(MOMENT, FIELD_MOMENT.unit, 'moment on which the field acts, body axes; for a '
                 'weight, mass times the vector from the pivot to the centre of mass'),
        *_vector(FIELD, 'm/s^2 or T', 'the field, space axes')),
    WHEEL_NAMES: (
        *_vector('axis', '', 'wheel axis, body axes; the length has no effect'),
        Parameter('inertia', None, 'kg m^2', 'axial inertia of the wheel, included in the '
                  'inertia of the body', (TINY, BIG)),
        Parameter('initial_speed', 0.0, 'rad/s', 'initial speed relative to the body',
                  (-1e9, 1e9)),
        Parameter('friction', 0.0, 'N m s/rad', 'viscous friction: friction times speed slows the '
                  'wheel, and the opposite torque acts on the body',
                  (0.0, BIG)),
        Parameter('max_torque', 0.0, 'N m', 'commands are clipped to this torque; 0 means no '
                  'limit', (0.0, BIG)),
        Parameter('max_speed', 0.0, 'rad/s', 'commands drive the wheel to at most this speed, at '
                  'which the motor gives only what holds it; 0 means no limit',
                  (0.0, BIG))),
}
PARAMETERS = {parameter.name: parameter for parameter in (
    *(Parameter(name, None, _BODY.unit, _MOMENT, (TINY, BIG)) for name in _BODY.components[:3]),
    *(Parameter(name, 0.0, _BODY.unit, _PRODUCT, (-BIG, BIG)) for name in _BODY.components[3:]),
    Parameter('robot_description', '', '', 'URDF text: the links in whose frames forces may be '
              'given and, in place of inertia.*, the inertia'),
    Parameter('link', '', '', 'link of robot_description that gives the body axes; empty means '
              'the root of the only body with an inertia'),
    *(Parameter(name, 0.0, _DRAG.unit, _DAMPING, (0.0, BIG)) for name in _DRAG.components[:3]),
    *(Parameter(name, 0.0, _DRAG.unit, _DAMPING, (-BIG, BIG)) for name in _DRAG.components[3:]),
    *_vector('initial_attitude', '', 'initial attitude quaternion, body to space',
             default=(0.0, 0.0, 0.0, 1.0)),
    *_vector('initial_angular_velocity', RATE.unit, 'initial angular velocity, body axes', 1e9),
    Parameter('plausible_speed', 10.0, 'rad/s', 'initial speed above which a warning says that '
              'the numbers may be degrees per second', (0.0, 1e10)),
    *_vector('initial_rotor_momentum', _ROTORS.unit, 'initial momentum of the rotors relative to '
             'the body, body axes'),
    Parameter('start_time', 0, 'ns', 'time of the initial state; 0 means the stamp of the first '
              'torque (replay, lockstep) or the first clock reading (realtime); a running node '
              'reports the actual time here', (0, 2 ** 31 * 10 ** 9 - 1)),
    Parameter('torque_topics', ['torque'], '', 'torque topics, whose torques add up'),
    Parameter('wheels', False, '', 'whether the body has motor-driven rotors, described by their '
              'total momentum'),
    Parameter(WHEEL_NAMES, [], '', 'names of the wheels, in the order of the outputs; each has '
              'the parameters NAME.axis to NAME.max_speed'),
    *ACTUATOR,
    Parameter(FIELDS, [], '', 'names of uniform fields; each exerts the torque NAME.moment x '
              'NAME.field (cross product)'),
    Parameter('orbit.mean_motion', 0.0, 'rad/s', 'mean motion of a circular orbit with gravity '
              'gradient; 0 means no orbit', (0.0, BIG)),
    *_vector('orbit.position', '', 'direction from the planet to the body, space axes, at '
             'start_time or, if that is 0, at the start of each epoch',
             default=(1.0, 0.0, 0.0)),
    *_vector('orbit.normal', '', 'orbit normal, about which the body revolves, space axes',
             default=(0.0, 0.0, 1.0)),
    Parameter('inertia_topic', False, '', 'whether messages on the topic inertia change the '
              'inertia'),
    Parameter('inertia_change', KEEP_RATE, '', 'what stays the same when the inertia changes: the '
              'angular velocity (mass that leaves takes its momentum along), or the angular '
              'momentum (the angular velocity jumps)',
              choices=INERTIA_CHANGES),
    Parameter('mode', REALTIME, '', 'realtime publishes the motion at publish_rate; lockstep '
              'answers a torque stamped t with the state at t + step; clock publishes /clock too, '
              'for controllers that run on a timer',
              choices=MODES),
    Parameter('step', 0.001, 's', 'in lockstep, time from a torque to the state that answers it; '
              'in mode clock, step of /clock', (1e-9, LONGEST)),
    Parameter('real_time_factor', 1.0, '', 'in mode clock, simulated seconds per second; 0 means '
              'as fast as possible', (0.0, 1000.0)),
    Parameter('time_source', HEADER, '', 'when a torque takes effect: at its stamp, or on arrival '
              '(for bags played without --clock)', choices=TIME_SOURCES),
    Parameter('solver', Options.solver, '', 'integration method', choices=SOLVERS),
    Parameter('tolerance', Options.tolerance, '', 'limit on the truncation error of the attitude, '
              'rad per radian of rotation, without rounding errors',
              TOLERANCES),
    Parameter('max_step', 0.0, 's', 'longest solver step; 0 means no limit; fixed-step solvers '
              'need a value above 0', (0.0, BIG)),
    Parameter('interpolation', 'hold', '', 'torque between samples; the node accepts only hold',
              choices=INTERPOLATIONS),
    Parameter('torque_timeout', Options.torque_timeout, 's', 'how long a torque is held before it '
              'becomes zero; 0 means until the next torque', (0.0, LONGEST)),
    Parameter('history', 1.0, 's', 'how far the stamp of a torque may be behind the newest stamp',
              (0.0, 3600.0)),
    Parameter('max_future', 0.5, 's', 'how far the stamp of a torque may be ahead of the clock; '
              'in simulated time, torques further ahead first wait 0.5 s for the clock',
              (0.0, 3600.0)),
    Parameter('max_past', 0.0, 's', 'how far the stamp of a torque may be behind the clock; 0 '
              'means as far as history permits', (0.0, LONGEST)),
    Parameter('stamp_offset_warning', 0.1, 's', 'diagnostics warn if the stamps of a source are '
              'off the clock by more than this (median); 0 turns this off', (0.0, LONGEST)),
    Parameter('on_time_jump', RESET, '', 'when the clock jumps, reset begins an epoch from the '
              'initial state, rebase from the current state; ignore continues the motion',
              choices=TIME_JUMPS),
    Parameter('checkpoint', '', '', 'file to which the node writes its last committed state, once '
              'a second and when it ends, and from which a new node continues'),
    Parameter('stale_after', 1.0, 's', 'diagnostics and log warn if the last torque of a silent '
              'source still acts after this time; 0 turns this off', (0.0, LONGEST)),
    Parameter('monitor.measured', [], '', 'topics of measured attitudes and angular velocities '
              'for attitude_monitor'),
    Parameter('monitor.window', 5.0, 's', 'length of the windows in which attitude_monitor '
              'compares the model with the measurement', (1e-3, LONGEST)),
    Parameter('monitor.attitude_noise', 0.0, 'rad', 'standard deviation of each component of '
              'a measured attitude; attitude_monitor needs a value above 0', (0.0, BIG)),
    Parameter('monitor.rate_noise', 0.0, 'rad/s', 'standard deviation of each component of '
              'a measured angular velocity; attitude_monitor needs a value above 0',
              (0.0, BIG)),
    Parameter('monitor.false_alarms', 24.0, 'h', 'mean time between alarms of '
              'attitude_monitor while the model is correct',
              (TINY, BIG)),
    Parameter('imu.gyro_noise_density', 0.0, 'rad/s/sqrt(Hz)', 'white noise of the angular '
              'velocity in imu/data', (0.0, 1e9)),
    Parameter('imu.gyro_random_walk', 0.0, 'rad/s^2/sqrt(Hz)', 'random walk of the gyro bias in '
              'imu/data', (0.0, 1e9)),
    *_vector('imu.gyro_bias', QUANTITIES['gyro_bias'].unit, 'constant gyro bias in imu/data, '
             'body axes', 1e9),
    Parameter('imu.attitude_noise', 0.0, 'rad', 'standard deviation of the attitude error in '
              'imu/data, about each body axis', (0.0, math.pi)),
    Parameter('imu.delay', 0.0, 's', 'delay of imu/data: a message stamped t contains the state '
              'at t - delay', (0.0, 3600.0)),
    Parameter('imu.seed', 0, '', 'seed of the noise in imu/data, which depends only on seed and '
              'stamp', (0, 2 ** 63 - 1)),
    Parameter('odometry.attitude_variance', 0.0, 'rad^2', 'variance of the attitude about each '
              'axis, in the covariance of odometry; 0 means unknown', (0.0, 1e9)),
    Parameter('odometry.rate_variance', 0.0, 'rad^2/s^2', 'variance of each component of the '
              'angular velocity, in the covariance of odometry; 0 means unknown', (0.0, 1e9)),
    Parameter('publish_clock', False, '', 'whether to publish the time of each state on /clock in '
              'lockstep; in mode clock the node always does'),
    Parameter('publish_tf', False, '', 'whether to publish the attitude on /tf, which needs '
              'tf2_msgs'),
    Parameter('publish_rate', 100.0, 'Hz', 'rate of the published motion; you can change it while '
              'the node runs', (1e-3, 2000.0)),
    Parameter('euler_sequence', 'ZXZ', '', 'axes of the Euler angles: intrinsic in upper case, '
              'extrinsic in lower case'),
    Parameter('space_frame', 'world', '', 'frame_id of the space axes'),
    Parameter('body_frame', 'base_link', '', 'frame_id of the body axes, without frame_prefix'),
    Parameter('frame_prefix', '', '', 'prefix of the frame_ids of the body and of the links in '
              'robot_description, as in robot_state_publisher'),
)}
#: Parameters that ROS declares on every node or on every managed node. These parameters are
#: accepted because parameter dumps contain them.
OF_ROS, QOS = ('use_sim_time', 'start_type_description_service', 'autostart'), 'qos_overrides.'
_NAME = re.compile('[A-Za-z_][A-Za-z0-9_]*')
#: Matches the full names of the parameters of any field or wheel, except the inertia of a wheel.
_OF_NAMED = {key: re.compile('(.+)[.](' + '|'.join(
    re.escape(parameter.name) for parameter in parameters if parameter.name != 'inertia') + ')')
    for key, parameters in NAMED.items()}


def of_names(key: str, names: Iterable[str]) -> dict[str, Parameter]:
    """Return the parameters of the fields or wheels with these names, keyed by full name."""
    return {f'{name}.{parameter.name}': parameter._replace(name=f'{name}.{parameter.name}')
            for name in names for parameter in NAMED[key]}


def parameters_with(names: Mapping[str, Any]) -> dict[str, Parameter]:
    """Return all parameters, keyed by full name, with those of the named fields and wheels."""
    return {**PARAMETERS, **of_names(WHEEL_NAMES, names[WHEEL_NAMES]),
            **of_names(FIELDS, names[FIELDS])}


def checked_names(given: Mapping[str, Any]) -> dict[str, list[str]]:
    """
    Return the names of the fields and wheels, by the parameter that lists them.

    Raises
    ------
    InputError
        A name is not an identifier, is given twice, or is the first part of another parameter's
        name.

    """
    names: dict[str, list[str]] = {key: checked(PARAMETERS[key], given.get(key)) for key in NAMED}
    taken = {name.split('.')[0] for name in (*PARAMETERS, *OF_ROS, QOS)}
    for key, own in names.items():
        for number, name in enumerate(own):
            if not isinstance(name, str) or not _NAME.fullmatch(name):
                raise InputError(f'{key}: expected names of letters, digits and _, found '
                                 f'{quoted(name)}')
            if name in taken:
                raise InputError(f'{key}: expected a name with which no other parameter begins, '
                                 f'found {name!r}')
            if name in own[:number]:
                raise InputError(f'{key}: expected each name once, found {name!r} twice')
        taken.update(own)
    return names


def parameters_for(given: Mapping[str, Any]) -> tuple[dict[str, Parameter], tuple[str, ...]]:
    """
    Return all parameters of the scene with the given values, keyed by full name.

    The second result are the names of given parameters that belong to other nodes.

    Raises
    ------
    InputError
        A name of a field or wheel is not valid (see `checked_names`), or an unknown parameter
        resembles a known one or seems to belong to an unknown field or wheel.

    """
    names = checked_names(given)
    table = parameters_with(names)
    accepted = (*table, *OF_ROS)
    foreign = tuple(name for name, value in given.items()
                    if not name.startswith(QOS) and is_foreign(name, value, accepted))
    for name in foreign:
        for listing, pattern in _OF_NAMED.items():
            if member := pattern.fullmatch(name):
                raise InputError(f'{name}: expected {quoted(member[1])} among the names in '
                                 f'{listing}, found {listed(names[listing])}')
    return table, foreign
