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

"""The table of all scene parameters, and what the parameters of actuators and wheels describe."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import math
import re
from typing import Any, NamedTuple

import numpy as np
from rigid_body_ros.common.arrays import written
from rigid_body_ros.common.errors import InputError, listed, located, quoted
from rigid_body_ros.mechanics.actuator import Actuator
from rigid_body_ros.mechanics.torque import INTERPOLATIONS
from rigid_body_ros.mechanics.wheels import Wheel
from rigid_body_ros.propagation import LONGEST, Options, SOLVERS, TOLERANCES
from rigid_body_ros.runtime.parameters import BIG, checked, Parameter, TINY
from rigid_body_ros.scene import fields
from rigid_body_ros.scene.quantities import QUANTITIES, RATE

_BODY, _DRAG, _ROTORS = (QUANTITIES[name] for name in ('inertia', 'damping', 'rotor_momentum'))
_MOMENT = 'moment of inertia about the centre of mass, body axes'
_PRODUCT = ('off-diagonal entry of the inertia tensor, including the minus sign as in URDF: ixy = '
            '- sum of m x y')
_DAMPING = 'entry of the damping tensor D, body axes; the damping torque is -D w'
MODES = REALTIME, LOCKSTEP, CLOCK = 'realtime', 'lockstep', 'clock'
TIME_SOURCES = HEADER, ARRIVAL = 'header', 'arrival'
#: The names of the quantities that can stay the same when the inertia changes; see `BodyLog`.
INERTIA_CHANGES = KEEP_RATE, KEEP_MOMENTUM = 'keep_rate', 'keep_momentum'
TIME_JUMPS = RESET, REBASE, IGNORE = 'reset', 'rebase', 'ignore'

_TOPICS, _DELAY, _LAG = 'actuator.topics', 'actuator.delay', 'actuator.time_constant'
_LIMITS = tuple(f'actuator.limit.{axis}' for axis in 'xyz')
ACTUATOR = (
    Parameter(_TOPICS, [], '', 'the torque_topics that carry actuator commands; an actuator has a '
              'delay, a limit and a lag'),
    Parameter(_DELAY, 0.0, 's', 'time from the stamp of an actuator command until the command '
              'takes effect', (0.0, LONGEST)),
    Parameter(_LAG, 0.0, 's', 'time constant of the first-order lag with which the actuator '
              'torque follows its command; 0 means no lag, and any other value must be at least '
              '1e-9',
              (0.0, LONGEST)),
    *(Parameter(name, 0.0, 'N m', 'largest torque about this axis, in the axes (body or space) of '
                'the command; larger commands are clipped; 0 means no limit', (0.0, BIG))
      for name in _LIMITS),
)
#: The parameter that lists the names of the wheels.
WHEEL_NAMES = 'wheel_names'
_WHEELS = (
    Parameter(WHEEL_NAMES, [], '', 'names of the wheels, in the order in which outputs list their '
              'speeds; each wheel has the parameters NAME.axis, NAME.inertia, NAME.initial_speed, '
              'NAME.friction, NAME.max_torque and NAME.max_speed'),
)
_AXIS = 'axis'
_INERTIA = Parameter('inertia', None, 'kg m^2', 'axial inertia of the wheel, which is included in '
                     'the inertia of the body', (TINY, BIG))
_OTHERS = (
    Parameter('initial_speed', 0.0, 'rad/s', 'initial speed of the wheel relative to the body',
              (-1e9, 1e9)),
    Parameter('friction', 0.0, 'N m s/rad', 'viscous friction of the wheel: a torque equal to '
              'friction times speed slows the wheel, and the opposite torque acts on the body',
              (0.0, BIG)),
    Parameter('max_torque', 0.0, 'N m', 'largest motor torque; larger commands are clipped to it; '
              '0 means no limit', (0.0, BIG)),
    Parameter('max_speed', 0.0, 'rad/s', 'at this speed or above, a command that would speed up '
              'the wheel acts as zero; the node checks the speed only when the command takes '
              'effect; 0 means no limit', (0.0, BIG)),
)
#: Matches the full names of all wheel parameters except the inertia, whether or not the wheel is
#: listed in `wheel_names`.
OF_WHEEL = re.compile('(.+)[.](axis[.][xyz]|initial_speed|friction|max_torque|max_speed)')
PARAMETERS = {parameter.name: parameter for parameter in (
    *(Parameter(name, None, _BODY.unit, _MOMENT, (TINY, BIG)) for name in _BODY.components[:3]),
    *(Parameter(name, 0.0, _BODY.unit, _PRODUCT, (-BIG, BIG)) for name in _BODY.components[3:]),
    Parameter('robot_description', '', '', 'URDF text, which gives the frames in which the node '
              'accepts forces and, in place of inertia.*, the inertia'),
    Parameter('link', '', '', 'link of robot_description that gives the body axes; fixed joints '
              'weld links to it; if empty, the root of the only body that has an inertia'),
    *(Parameter(name, 0.0, _DRAG.unit, _DAMPING, (0.0, BIG)) for name in _DRAG.components[:3]),
    *(Parameter(name, 0.0, _DRAG.unit, _DAMPING, (-BIG, BIG)) for name in _DRAG.components[3:]),
    *fields.along('initial_attitude', '', 'initial attitude quaternion, body to space',
                  default=(0.0, 0.0, 0.0, 1.0)),
    *fields.along('initial_angular_velocity', RATE.unit, 'initial angular velocity, body axes',
                  1e9),
    Parameter('plausible_speed', 10.0, 'rad/s', 'initial angular speed above which the node and '
              'the commands warn that the numbers may be degrees per second', (0.0, 1e10)),
    *fields.along('initial_rotor_momentum', _ROTORS.unit, 'initial momentum of the rotors '
                  'relative to the body, body axes'),
    Parameter('start_time', 0, 'ns', 'time of the initial state; 0 means the stamp of the first '
              'torque (replay, lockstep) or the first valid clock reading (realtime); a running '
              'node reports the actual time in this parameter', (0, 2 ** 31 * 10 ** 9 - 1)),
    Parameter('torque_topics', ['torque'], '', 'torque topics; the node and the commands add up '
              'the torques from all of them'),
    Parameter('wheels', False, '', 'whether the body has motor-driven rotors, which are described '
              'by their total momentum'),
    *_WHEELS,
    *ACTUATOR,
    *fields.PARAMETERS,
    Parameter('inertia_topic', False, '', 'whether messages on the topic inertia change the '
              'inertia of the body'),
    Parameter('inertia_change', KEEP_RATE, '', 'what is kept when the inertia changes: keep_rate '
              'keeps the angular velocity, and mass that leaves the body carries its momentum '
              'away; keep_momentum keeps the angular momentum, and the angular velocity jumps',
              choices=INERTIA_CHANGES),
    Parameter('mode', REALTIME, '', 'realtime publishes the motion at publish_rate; lockstep '
              'answers a torque stamped t with the state at t + step; clock publishes /clock, and '
              'the motion at publish_rate of this clock, for controllers that run on a timer',
              choices=MODES),
    Parameter('step', 0.001, 's', 'in lockstep, time from the stamp of a torque to the stamp of '
              'the state that answers it; in mode clock, the step of /clock', (1e-9, LONGEST)),
    Parameter('real_time_factor', 1.0, '', 'in mode clock, simulated seconds per second; 0 means '
              'as fast as the machine allows', (0.0, 1000.0)),
    Parameter('time_source', HEADER, '', 'when a torque takes effect: at the stamp in its header, '
              'or on arrival (for bags played without --clock)', choices=TIME_SOURCES),
    Parameter('solver', Options.solver, '', 'integration method', choices=SOLVERS),
    Parameter('tolerance', Options.tolerance, '', 'limit on the truncation error of the attitude, '
              'rad per radian of rotation; it does not cover rounding errors',
              TOLERANCES),
    Parameter('max_step', 0.0, 's', 'longest solver step; 0 means no limit, but the fixed-step '
              'solvers need a value above 0', (0.0, BIG)),
    Parameter('interpolation', 'hold', '', 'how the torque is interpolated between samples; the '
              'node accepts only hold, because it does not know the next sample',
              choices=INTERPOLATIONS),
    Parameter('torque_timeout', Options.torque_timeout, 's', 'how long a torque sample is held; '
              'after that, the torque is zero until the next sample; 0 means that each sample is '
              'held until the next', (0.0, LONGEST)),
    Parameter('history', 1.0, 's', 'how far the stamp of a torque may lag behind the newest '
              'stamp; the node rejects older torques', (0.0, 3600.0)),
    Parameter('max_future', 0.5, 's', 'how far the stamp of a torque may be ahead of the clock; '
              'the node rejects torques that are further ahead; in simulated time, it rejects '
              'them only after they have waited 0.5 s for the clock', (0.0, 3600.0)),
    Parameter('max_past', 0.0, 's', 'how far the stamp of a torque may be behind the clock; the '
              'node rejects older torques; 0 means as far as history permits', (0.0, LONGEST)),
    Parameter('stamp_offset_warning', 0.1, 's', 'diagnostics warn if the stamps of a source are '
              'off the clock by more than this (median), so that their torques act at the wrong '
              'time; 0 turns the warning off', (0.0, LONGEST)),
    Parameter('on_time_jump', RESET, '', 'what to do when the clock jumps: reset begins an epoch '
              'from the initial state, rebase begins one from the current state, and ignore '
              'continues the motion', choices=TIME_JUMPS),
    Parameter('checkpoint', '', '', 'file to which the node writes its last committed state, once '
              'a second and when it ends; if the file exists when a node starts, the node '
              'continues from the state in it; empty means no file'),
    Parameter('stale_after', 1.0, 's', 'if a source has sent no torque for longer than this and '
              'its last torque still acts, the diagnostics and the log warn; 0 turns the warning '
              'off',
              (0.0, LONGEST)),
    Parameter('monitor.measured', [], '', 'topics of measured attitudes and angular velocities '
              'that attitude_monitor reads'),
    Parameter('monitor.window', 5.0, 's', 'length of a window; in each window, attitude_monitor '
              'starts the model from the measurement at the beginning and compares it with the '
              'measurement at the end', (1e-3, LONGEST)),
    Parameter('monitor.attitude_noise', 0.0, 'rad', 'standard deviation of each component of '
              'the measured attitudes; attitude_monitor needs a value above 0', (0.0, BIG)),
    Parameter('monitor.rate_noise', 0.0, 'rad/s', 'standard deviation of each component of '
              'the measured angular velocities; attitude_monitor needs a value above 0',
              (0.0, BIG)),
    Parameter('monitor.false_alarms', 24.0, 'h', 'mean time between false alarms of '
              'attitude_monitor, which are alarms that it raises although the model is correct',
              (TINY, BIG)),
    Parameter('imu.gyro_noise_density', 0.0, 'rad/s/sqrt(Hz)', 'density of the white noise in the '
              'angular velocity of imu/data', (0.0, 1e9)),
    Parameter('imu.gyro_random_walk', 0.0, 'rad/s^2/sqrt(Hz)', 'density of the random walk of the '
              'gyro bias in imu/data', (0.0, 1e9)),
    *fields.along('imu.gyro_bias', QUANTITIES['gyro_bias'].unit, 'constant bias of the angular '
                  'velocity in imu/data, body axes', 1e9),
    Parameter('imu.attitude_noise', 0.0, 'rad', 'standard deviation of the attitude error in '
              'imu/data, about each body axis', (0.0, math.pi)),
    Parameter('imu.delay', 0.0, 's', 'delay of imu/data: each message contains the state from '
              'this long before its stamp, or the start state if that is before the start',
              (0.0, 3600.0)),
    Parameter('imu.seed', 0, '', 'seed of the noise in imu/data; the noise depends only on the '
              'seed and the stamp', (0, 2 ** 63 - 1)),
    Parameter('odometry.attitude_variance', 0.0, 'rad^2', 'attitude variance about each axis, for '
              'the covariance in odometry; 0 means unknown', (0.0, 1e9)),
    Parameter('odometry.rate_variance', 0.0, 'rad^2/s^2', 'variance of each component of the '
              'angular velocity, for the covariance in odometry; 0 means unknown', (0.0, 1e9)),
    Parameter('publish_clock', False, '', 'whether the node publishes the time of each state on '
              '/clock in lockstep; in mode clock it always does'),
    Parameter('publish_tf', False, '', 'whether the node also publishes the attitude on /tf, '
              'which needs the package tf2_msgs'),
    Parameter('publish_rate', 100.0, 'Hz', 'rate at which the node publishes the motion; you can '
              'change it while the node runs', (1e-3, 2000.0)),
    Parameter('euler_sequence', 'ZXZ', '', 'axes of the Euler angles: intrinsic in upper case, '
              'extrinsic in lower case'),
    Parameter('space_frame', 'world', '', 'frame_id of the space axes'),
    Parameter('body_frame', 'base_link', '', 'frame_id of the body axes, without frame_prefix'),
    Parameter('frame_prefix', '', '', 'prefix for the frame_ids of the body and of the links in '
              'robot_description, as in robot_state_publisher'),
)}
#: Parameters that ROS declares on every node or on every managed node. These parameters are
#: accepted because parameter dumps contain them.
OF_ROS, QOS = ('use_sim_time', 'start_type_description_service', 'autostart'), 'qos_overrides.'


class Names(NamedTuple):
    """The names of the uniform fields in a scene, and the names of the wheels in the scene."""

    fields: Sequence[str] = ()
    wheels: Sequence[str] = ()


def parameters_with(names: Names) -> dict[str, Parameter]:
    """Return all parameters, keyed by full name, including those of named fields and wheels."""
    return {**PARAMETERS, **wheel_parameters(names.wheels), **fields.of_names(names.fields)}


def checked_names(given: Mapping[str, Any]) -> Names:
    """Return the names of the fields and wheels; raise InputError if a name is not valid."""
    names = Names(*(checked(PARAMETERS[key], given.get(key))
                    for key in (fields.FIELDS, WHEEL_NAMES)))
    others = *PARAMETERS, *OF_ROS, QOS
    fields.check_names(names.fields, others)
    fields.check_names(names.wheels, (*others, *names.fields), WHEEL_NAMES)
    return names


def check_named(key: str, names: Names) -> None:
    """Raise InputError if an unknown parameter seems to belong to an unknown field or wheel."""
    for pattern, listing, known in ((fields.OF_FIELD, fields.FIELDS, names.fields),
                                    (OF_WHEEL, WHEEL_NAMES, names.wheels)):
        if member := pattern.fullmatch(key):
            raise InputError(f'{key}: expected {quoted(member[1])} among the names in {listing}, '
                             f'found {listed(known)}')


def actuators_of(values: Mapping[str, Any]) -> tuple[Actuator | None, ...] | None:
    """
    Return the actuator for each topic in `torque_topics`, or None if no topic has one.

    Raises
    ------
    InputError
        A topic in `actuator.topics` is not a torque topic, or is given twice; `actuator.topics`
        is empty although other `actuator` parameters are set; or the time constant is too short.

    """
    topics, given = values[_TOPICS], [name.removeprefix('/') if isinstance(name, str) else name
                                      for name in values[_TOPICS]]
    known = [str(name).removeprefix('/') for name in values['torque_topics']]
    for number, name in enumerate(given):
        if name not in known:
            raise InputError(f'{_TOPICS}: expected topics among torque_topics '
                             f'({listed(values["torque_topics"])}), found '
                             f'{quoted(topics[number])}')
        if name in given[:number]:
            raise InputError(f'{_TOPICS}: expected each topic once, found {topics[number]!r} '
                             'twice')
    for name in (_DELAY, _LAG, *_LIMITS):
        if values[name] and not given:
            raise InputError(f'{_TOPICS}: expected at least one topic, because {name} is '
                             f'{values[name]:g}, found an empty list')
    if not given:
        return None
    with located(_LAG):
        found = Actuator(values[_DELAY], values[_LAG], [values[name] for name in _LIMITS])
    return tuple(found if name in given else None for name in known)


def wheel_parameters(names: Iterable[str]) -> dict[str, Parameter]:
    """Return the parameters of the wheels with these names, keyed by full name."""
    return {parameter.name: parameter for name in names for parameter in (
        *fields.along(f'{name}.{_AXIS}', '', 'wheel axis, in body axes; the length of this vector '
                      'has no effect'),
        *(each._replace(name=f'{name}.{each.name}') for each in (_INERTIA, *_OTHERS)))}


def wheels_of(values: Mapping[str, Any]) -> tuple[Wheel, ...]:
    """Create the wheels from a scene's parameters; raise InputError if a wheel has no axis."""
    return tuple(Wheel(name, fields.vector(values, f'{name}.{_AXIS}'), *(
        values[f'{name}.{each.name}'] for each in (_INERTIA, *_OTHERS)))
        for name in values[WHEEL_NAMES])


def described_wheels(values: Mapping[str, Any]) -> list[str]:
    """Return a line of text for each wheel in a scene."""
    return [f'{wheel.name}: wheel of {wheel.inertia:.9g} kg m^2 about '
            f'{written(np.asarray(wheel.axis))}, initially at {wheel.initial_speed:.9g} rad/s'
            for wheel in wheels_of(values)]
