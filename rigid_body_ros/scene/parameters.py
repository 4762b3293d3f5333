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

"""The parameters of a scene, except those of each of its uniform fields and wheels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from rigid_body_ros.mechanics.torque import INTERPOLATIONS
from rigid_body_ros.propagation import LONGEST, Options, SOLVERS, TOLERANCES
from rigid_body_ros.runtime.parameters import BIG, checked, Parameter, TINY
from rigid_body_ros.scene import actuator, fields, sensors, wheels

_MOMENT = 'moment of inertia about the centre of mass, body axes'
_PRODUCT = 'off-diagonal entry of the inertia tensor, with the sign of the matrix as in URDF'
_QUATERNION = 'initial attitude quaternion, body to space'
_DAMPING = 'entry of the damping tensor D, body axes; the torque of the damping is -D w'
_ROTORS = 'initial momentum of the rotors relative to the body, body axes'
_VELOCITY = 'initial angular velocity, body axes'
MODES = REALTIME, LOCKSTEP = 'realtime', 'lockstep'
TIME_SOURCES = HEADER, ARRIVAL = 'header', 'arrival'
#: The quantity that is kept when the inertia changes, see `BodyLog`.
INERTIA_CHANGES = KEEP_RATE, KEEP_MOMENTUM = 'keep_rate', 'keep_momentum'
TIME_JUMPS = RESET, REBASE, IGNORE = 'reset', 'rebase', 'ignore'

PARAMETERS = {parameter.name: parameter for parameter in (
    *(Parameter(f'inertia.{name}', None, 'kg m^2', _MOMENT, (TINY, BIG))
      for name in ('ixx', 'iyy', 'izz')),
    *(Parameter(f'inertia.{name}', 0.0, 'kg m^2', _PRODUCT, (-BIG, BIG))
      for name in ('ixy', 'ixz', 'iyz')),
    Parameter('robot_description', '', '', 'URDF text to read the inertia from, instead of '
              'inertia.*, and the frames of forces'),
    Parameter('link', '', '', 'link of robot_description whose inertia is used; empty: the only '
              'link with an inertia'),
    *(Parameter(f'damping.{name}', 0.0, 'N m s/rad', _DAMPING, (0.0, BIG))
      for name in ('dxx', 'dyy', 'dzz')),
    *(Parameter(f'damping.{name}', 0.0, 'N m s/rad', _DAMPING, (-BIG, BIG))
      for name in ('dxy', 'dxz', 'dyz')),
    *(Parameter(f'initial_attitude.{name}', default, '', _QUATERNION, (-BIG, BIG))
      for name, default in zip('xyzw', (0.0, 0.0, 0.0, 1.0))),
    *(Parameter(f'initial_angular_velocity.{name}', 0.0, 'rad/s', _VELOCITY, (-1e9, 1e9))
      for name in 'xyz'),
    *(Parameter(f'initial_rotor_momentum.{name}', 0.0, 'N m s', _ROTORS, (-BIG, BIG))
      for name in 'xyz'),
    Parameter('start_time', 0, 'ns', 'time of the initial state; 0: the stamp of the first torque '
              '(replay, lockstep) or the first valid clock reading (realtime); a running node '
              'reports the value in use', (0, 2 ** 31 * 10 ** 9 - 1)),
    Parameter('torque_topics', ['torque'], '', 'topics of the torques; the torques of several '
              'topics add up'),
    Parameter('wheels', False, '', 'whether the body has rotors with motors'),
    *wheels.PARAMETERS,
    *actuator.PARAMETERS,
    *fields.PARAMETERS,
    Parameter('inertia_topic', False, '', 'whether the topic inertia changes the inertia of the '
              'body'),
    Parameter('inertia_change', KEEP_RATE, '', 'what goes on when the inertia changes: keep_rate '
              '(what leaves takes its momentum along) or keep_momentum (the rate jumps)',
              choices=INERTIA_CHANGES),
    Parameter('mode', REALTIME, '', 'realtime: publish the motion at publish_rate; lockstep: '
              'reply to each torque, stamped t, with the state at t + step', choices=MODES),
    Parameter('step', 0.001, 's', 'lockstep: time from the stamp of a torque to the state that '
              'replies to it', (1e-9, LONGEST)),
    Parameter('time_source', HEADER, '', 'when a torque takes effect: at the stamp in its header, '
              'or on arrival (for bags played without --clock)', choices=TIME_SOURCES),
    Parameter('solver', Options.solver, '', 'integration method', choices=SOLVERS),
    Parameter('tolerance', Options.tolerance, '', 'bound on the truncation error of the attitude '
              'per radian turned; rounding adds to it', TOLERANCES),
    Parameter('max_step', 0.0, 's', 'longest step; required by the fixed-step solvers; 0: no '
              'limit', (0.0, BIG)),
    Parameter('interpolation', 'hold', '', 'torque between two samples; the node accepts only '
              'hold, because it does not know the next sample', choices=INTERPOLATIONS),
    Parameter('torque_timeout', Options.torque_timeout, 's', 'how long a sample is held; then the '
              'torque is zero until the next sample; 0: hold for ever', (0.0, LONGEST)),
    Parameter('history', 1.0, 's', 'how far the stamp of a torque may lie before the newest one; '
              'older torques are rejected', (0.0, 3600.0)),
    Parameter('max_future', 0.5, 's', 'how far the stamp of a torque may lie ahead of the clock; '
              'torques further ahead are rejected; with simulated time they first wait 0.5 s for '
              'the clock', (0.0, 3600.0)),
    Parameter('on_time_jump', RESET, '', 'what to do when the clock jumps back, or ahead by more '
              'than history: reset (start again), rebase (continue from the current state) or '
              'ignore', choices=TIME_JUMPS),
    Parameter('checkpoint', '', '', 'file in which the node keeps its last committed state, '
              'written once a second and at the end; a node that finds it goes on from there; '
              'empty: none'),
    Parameter('stale_after', 1.0, 's', 'a source whose torque acts, and that has sent none for '
              'longer, is a warning in diagnostics and in the log; 0: never', (0.0, LONGEST)),
    Parameter('monitor.measured', [], '', 'attitude_monitor: topics of measured attitudes and '
              'angular velocities'),
    Parameter('monitor.window', 5.0, 's', 'attitude_monitor: time from a restart at the '
              'measurement to the error, and to the next restart', (1e-3, LONGEST)),
    Parameter('monitor.attitude_noise', 0.0, 'rad', 'attitude_monitor: standard deviation of a '
              'component of the measured attitudes; required', (0.0, BIG)),
    Parameter('monitor.rate_noise', 0.0, 'rad/s', 'attitude_monitor: standard deviation of a '
              'component of the measured angular velocities; required', (0.0, BIG)),
    Parameter('monitor.false_alarms', 24.0, 'h', 'attitude_monitor: time in which a right model '
              'gives one alarm', (TINY, BIG)),
    *sensors.PARAMETERS,
    Parameter('publish_clock', False, '', 'lockstep: publish the time of each state on /clock'),
    Parameter('publish_tf', False, '', 'publish the attitude on /tf as well (needs tf2_msgs)'),
    Parameter('publish_rate', 100.0, 'Hz', 'rate at which the motion is published; may change '
              'while the node runs', (1e-3, 2000.0)),
    Parameter('euler_sequence', 'ZXZ', '', 'axes of the Euler angles; upper case: intrinsic, '
              'lower case: extrinsic'),
    Parameter('space_frame', 'world', '', 'frame_id of the space axes'),
    Parameter('body_frame', 'base_link', '', 'frame_id of the body axes, after frame_prefix'),
    Parameter('frame_prefix', '', '', 'text before the frame_ids of the body and of the links of '
              'robot_description, as of robot_state_publisher'),
)}
#: Parameters that ROS declares on every node, and one of managed nodes; a dump contains them.
OF_ROS, QOS = ('use_sim_time', 'start_type_description_service', 'autostart'), 'qos_overrides.'


class Names(NamedTuple):
    """The names in a scene of items with parameters of their own: uniform fields and wheels."""

    fields: Sequence[str] = ()
    wheels: Sequence[str] = ()


def parameters_with(names: Names) -> dict[str, Parameter]:
    """Return all parameters by full name, including those of named fields and wheels."""
    return {**PARAMETERS, **wheels.of_names(names.wheels), **fields.of_names(names.fields)}


def checked_names(given: Mapping[str, Any]) -> Names:
    """Return the names among given values; raise InputError as `checked`."""
    names = Names(*(checked(PARAMETERS[key], given.get(key))
                    for key in (fields.FIELDS, wheels.WHEEL_NAMES)))
    others = *PARAMETERS, *OF_ROS, QOS
    fields.check_names(names.fields, others)
    fields.check_names(names.wheels, (*others, *names.fields), wheels.WHEEL_NAMES)
    return names
