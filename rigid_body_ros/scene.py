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
The scene: a body, its start and how to treat it, read from a ROS 2 parameter file.

The same table of parameters serves the node (declarations, descriptors) and the commands (scene
files), so that one file means one thing everywhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
import difflib
import math
from pathlib import Path
import re
from typing import Any, NamedTuple

from rigid_body_ros import euler
from rigid_body_ros.body import RigidBody, State
from rigid_body_ros.common.errors import InputError as InputError  # handed on
from rigid_body_ros.common.errors import listed, quoted, shortened
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.propagation import LONGEST, Options, SOLVERS, TOLERANCES
from rigid_body_ros.runtime.reading import read_yaml
from rigid_body_ros.torque import INTERPOLATIONS
import yaml

NODE = 'attitude_node'


class Parameter(NamedTuple):
    """One key of a scene; its type is that of the default, or float where there is none."""

    name: str
    default: bool | int | float | str | None
    unit: str
    description: str
    #: Closed interval; (lowest, highest) of a number.
    interval: tuple[float, float] | None = None
    choices: tuple[str, ...] = ()

    @property
    def value_type(self) -> type:
        """Return the Python type of the value."""
        return float if self.default is None else type(self.default)


_BIG = 1e300
_TINY = 1e-300
_MOMENT = 'moment of inertia about the centre of mass, body axes'
_PRODUCT = 'off-diagonal entry of the inertia tensor itself, as in URDF'
_QUATERNION = 'initial attitude quaternion, body to space'
_VELOCITY = 'initial angular velocity, body axes'
#: What a unit quaternion may be off, written with three digits.
_UNIT = 1e-2
#: rad/s; above are toy tops and flywheels, and vehicles whose rates are in degrees.
_FAST = 10.0
MODES = REALTIME, LOCKSTEP = 'realtime', 'lockstep'
TIME_SOURCES = HEADER, ARRIVAL = 'header', 'arrival'
TIME_JUMPS = RESET, REBASE, IGNORE = 'reset', 'rebase', 'ignore'

PARAMETERS = {parameter.name: parameter for parameter in (
    *(Parameter(f'inertia.{name}', None, 'kg m^2', _MOMENT, (_TINY, _BIG))
      for name in ('ixx', 'iyy', 'izz')),
    *(Parameter(f'inertia.{name}', 0.0, 'kg m^2', _PRODUCT, (-_BIG, _BIG))
      for name in ('ixy', 'ixz', 'iyz')),
    Parameter('robot_description', '', '', 'URDF to take the inertia from, instead of numbers'),
    Parameter('link', '', '', 'link of robot_description; empty: the only one with an inertia'),
    *(Parameter(f'initial_attitude.{name}', default, '', _QUATERNION, (-_BIG, _BIG))
      for name, default in zip('xyzw', (0.0, 0.0, 0.0, 1.0))),
    *(Parameter(f'initial_angular_velocity.{name}', 0.0, 'rad/s', _VELOCITY, (-1e9, 1e9))
      for name in 'xyz'),
    Parameter('start_time', 0, 'ns', 'when the initial state holds; 0: the first torque in a '
              'replay and in lockstep, else the first valid clock reading; a running node reports '
              'the value in use', (0, 2 ** 31 * 10 ** 9 - 1)),
    Parameter('mode', REALTIME, '', 'realtime: the clock asks for the motion; lockstep: each '
              'torque, stamped t, is answered with the state at t + step', choices=MODES),
    Parameter('step', 0.001, 's', 'how far ahead of a torque lockstep answers', (1e-9, LONGEST)),
    Parameter('time_source', HEADER, '', 'whether the node takes the time of a torque from its '
              'header or from its arrival (for bags played without --clock)',
              choices=TIME_SOURCES),
    Parameter('solver', Options.solver, '', 'how the motion is integrated', choices=SOLVERS),
    Parameter('tolerance', Options.tolerance, '', 'bound on the truncation error of the attitude '
              'per radian turned; rounding adds to it', TOLERANCES),
    Parameter('max_step', 0.0, 's', 'longest step, which the solvers of fixed step take; 0: none',
              (0.0, _BIG)),
    Parameter('interpolation', 'hold', '', 'what a torque does between its samples; the node, '
              'which does not know the next one, holds', choices=INTERPOLATIONS),
    Parameter('torque_timeout', Options.torque_timeout, 's', 'the torque is zero from this long '
              'after a sample on; 0: it is held for ever', (0.0, LONGEST)),
    Parameter('history', 1.0, 's', 'how much older than the newest stamp a torque may be',
              (0.0, 3600.0)),
    Parameter('max_future', 0.5, 's', 'a torque stamped further ahead of the clock is refused',
              (0.0, 3600.0)),
    Parameter('on_time_jump', RESET, '', 'what a clock that jumps back does: start again, go on '
              'from the present state, or nothing', choices=TIME_JUMPS),
    Parameter('publish_clock', False, '', 'lockstep: publish the time of each answer on /clock'),
    Parameter('publish_tf', False, '', 'publish the attitude on /tf, too (needs tf2_msgs)'),
    Parameter('publish_rate', 100.0, 'Hz', 'rate of the published attitude; may change while '
              'running', (1e-3, 2000.0)),
    Parameter('euler_sequence', 'ZXZ', '', 'axes of the Euler angles, upper case intrinsic, lower '
              'case extrinsic'),
    Parameter('space_frame', 'world', '', 'frame_id of the fixed axes'),
    Parameter('body_frame', 'base_link', '', 'frame_id of the body axes'),
)}
# What C's strtoll (base 0) and strtod take, which rcl asks.
_INTEGER = re.compile(r'[+-]?(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)')
_FLOAT = re.compile(r'[+-]?([0-9]+(\.[0-9]*)?([eE][+-]?[0-9]+)?|\.[0-9]+([eE][+-]?[0-9]+)?'
                    r'|\.?(inf|Inf|INF|nan|NaN|NAN))')
#: Characters of a full name.
_LONGEST = 500
#: What ROS itself declares on every node; a parameter dump has them.
_ROS, _QOS = ('use_sim_time', 'start_type_description_service'), 'qos_overrides.'


@dataclass(frozen=True)
class Scene:
    """
    What a motion depends on besides its torques, checked.

    Attributes
    ----------
    body : RigidBody
    start : State
        Its time is 0 where the scene leaves it to the first torque or clock reading.
    values : dict
        Every parameter by name, given or default.
    path : Path or None
        The file that the scene was read from, absolute.

    """

    body: RigidBody
    start: State
    values: Mapping[str, Any]
    path: Path | None = None

    @property
    def options(self) -> dict[str, Any]:
        """Return the keyword arguments of `propagate`."""
        return _options(self.values)

    @property
    def timeout_ns(self) -> int:
        """Return the torque timeout, ns; 0 where a torque is held for ever."""
        return duration_ns(self.values['torque_timeout'], 'torque_timeout')

    @property
    def doubts(self) -> list[str]:
        """Return lines for the user about what is allowed, but rarely meant."""
        return [*_doubts(self.values, self.body)]

    @classmethod
    def from_values(cls, given: Mapping[str, Any]) -> Scene:
        """
        Check the values of a scene as one whole.

        Parameters
        ----------
        given : mapping
            Values by full name, such as 'inertia.ixx'.

        Raises
        ------
        InputError
            A key is unknown or missing, a value has another type or is out of range, or the
            values do not fit together.

        """
        for name, value in given.items():
            if name not in PARAMETERS and name not in _ROS and not name.startswith(_QOS):
                raise InputError(_unknown(name, value))
        given = {**given, **_inertia_of_robot(given)}
        values = {name: checked(parameter, given.get(name, parameter.default))
                  for name, parameter in PARAMETERS.items()}
        try:
            _check_together(values)
            Options(**_options(values))
            body = RigidBody.from_moments(**_group(values, 'inertia'))
            start = State(values['start_time'], [*_group(values, 'initial_attitude').values()],
                          [*_group(values, 'initial_angular_velocity').values()])
        except ValueError as error:
            raise InputError(str(error)) from error
        return cls(body, start, values)


def load(path: str | Path) -> Scene:
    """
    Read a scene from a ROS 2 parameter file, such as `ros2 param dump` writes.

    Parameters of `/**` hold for every node, those of `attitude_node` come on top; where neither
    name is there, a single other node's are taken.

    Raises
    ------
    InputError
        The file cannot be read, is no parameter file, or the scene is not valid.

    """
    root = read_yaml(path, 'scene')
    try:
        return replace(Scene.from_values(_parameters(root)), path=Path(path).absolute())
    except InputError as error:
        raise InputError(f'{path}: {error}') from error


def _options(values: Mapping[str, Any]) -> dict[str, Any]:
    return {'solver': values['solver'], 'tolerance': values['tolerance'],
            'max_step': values['max_step'] or None, 'torque_timeout': values['torque_timeout']}


def checked(parameter: Parameter, given: Any) -> Any:
    """Return a value of a parameter as its type, or raise InputError."""
    name, unit = parameter.name, f' ({parameter.unit})' if parameter.unit else ''
    if given is None:
        raise InputError(f'{name}: missing; expected a number{unit}: {parameter.description}')
    value = float(given) if parameter.value_type is float and type(given) is int else given
    # A bool is an int to Python.
    wrong = (isinstance(value, bool) is not (parameter.value_type is bool)
             or not isinstance(value, parameter.value_type))
    if wrong:
        kind = {float: 'a number', int: 'an integer', str: 'a text',
                bool: 'true or false'}[parameter.value_type]
        in_quotes = isinstance(value, str) and _FLOAT.fullmatch(value)
        hint = '; leave out the quotes' if in_quotes else f': {parameter.description}'
        raise InputError(f'{name}: expected {kind}{unit}, found {quoted(value)}{hint}')
    if parameter.choices and value not in parameter.choices:
        choices = ', '.join(parameter.choices)
        raise InputError(f'{name}: expected one of {choices}, found {quoted(value)}')
    if parameter.interval and not parameter.interval[0] <= value <= parameter.interval[1]:
        raise InputError(f'{name}: expected {limits(*parameter.interval)}{unit}, found {value}')
    return value


def _inertia_of_robot(given: Mapping[str, Any]) -> dict[str, float]:
    """Return the tensor's entries where a URDF has them; numbers beside it have to agree."""
    text, link = (checked(PARAMETERS[name], given.get(name, ''))
                  for name in ('robot_description', 'link'))
    if not text:
        if link:
            raise InputError(f'link: expected a robot_description to find {quoted(link)} in, '
                             'found none')
        return {}
    try:
        tensor = RigidBody.from_urdf(text, link).inertia
    except ValueError as error:
        raise InputError(f'robot_description: {error}') from error
    entries = {f'inertia.i{"xyz"[i]}{"xyz"[j]}': float(tensor[i, j])
               for i in range(3) for j in range(i, 3)}
    for name, entry in entries.items():
        # A dump of a running node has both.
        if given.get(name, 0.0) not in (0.0, entry):
            raise InputError(f'{name}: expected {entry!r}, as robot_description says, or none, '
                             f'found {quoted(given[name])}')
    return entries


def limits(low: float, high: float) -> str:
    """Return the range of a parameter in words."""
    if high < _BIG:
        return f'{low:g} to {high:g}'
    return 'a finite number' + {-_BIG: '', 0.0: ' from 0 on', _TINY: ' greater than 0'}[low]


def _check_together(values: Mapping[str, Any]) -> None:
    euler.check_sequence(values['euler_sequence'])
    for name in ('space_frame', 'body_frame'):
        if not values[name]:
            raise InputError(f'{name}: expected a name, found none')
        if '\0' in values[name] or values[name].encode(errors='ignore').decode() != values[name]:
            raise InputError(f'{name}: expected text in UTF-8, found {quoted(values[name])}')
    if values['space_frame'] == values['body_frame']:
        found = quoted(values['body_frame'])
        raise InputError(f'space_frame, body_frame: expected two names, found {found} twice')
    if values['mode'] == LOCKSTEP and values['time_source'] == ARRIVAL:
        raise InputError('time_source: expected header in lockstep, which goes by stamps, '
                         f'found {ARRIVAL!r}')
    if values['publish_clock'] and values['mode'] != LOCKSTEP:
        raise InputError('publish_clock: expected mode lockstep, where torques make the time, '
                         f'found {values["mode"]!r}')
    if not duration_ns(values['max_future'], 'max_future') < max(
            duration_ns(values['history'], 'history'), 1):
        raise InputError('max_future: expected less than history '
                         f'({values["history"]} s), found {values["max_future"]}')


def _doubts(values: Mapping[str, Any], body: RigidBody) -> Iterator[str]:
    if body.triangle_excess:
        yield ('inertia: the largest principal moment exceeds the sum of the others by '
               f'{body.triangle_excess:.2g} of it, which no body has: rounded numbers?')
    norm = math.hypot(*_group(values, 'initial_attitude').values())
    if abs(norm - 1.0) > _UNIT:
        yield ('initial_attitude: expected a unit quaternion x y z w, found one of norm '
               f'{norm:.3g}, and made it 1: are these angles?')
    rate = math.hypot(*_group(values, 'initial_angular_velocity').values())
    if rate > _FAST:
        yield (f'initial_angular_velocity: {rate:.4g} rad/s are {rate / (2.0 * math.pi):.3g} '
               'turns a second: if these are degrees, multiply by pi / 180 = 0.0174533')


def _group(values: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    return {name.split('.')[1]: value for name, value in values.items()
            if name.startswith(prefix + '.')}


def _unknown(name: str, value: Any) -> str:
    if parts := [*_group(PARAMETERS, name)]:
        return f'{name}: expected {", ".join(parts)} below it, found {quoted(value)}'
    for close in difflib.get_close_matches(name, PARAMETERS, 1):
        return f'{name}: unknown key; did you mean {close}?'
    return f'{name}: unknown key; expected one of {listed(PARAMETERS)}'


def _parameters(root: yaml.Node | None) -> dict[str, Any]:
    """Return the flat values that a parameter file has for the node."""
    nodes = _nodes(root, '')
    names = {name for name, _ in nodes}
    ours = {name for name in names if name.split('/')[-1] == NODE}
    if not ours and '**' not in names:
        ours = names  # of a renamed node
    if len(ours) > 1 or not names:
        found = listed(sorted(names)) if names else 'no node'
        raise InputError(f'expected parameters of /** or of one {NODE}, found those of {found}')
    values: dict[str, Any] = {}
    for name, entry in sorted(nodes, key=lambda node: node[0] != '**'):
        if name == '**' or name in ours:
            values.update(_flat(entry, ''))
    return values


def _nodes(node: yaml.Node | None, prefix: str) -> list[tuple[str, yaml.Node]]:
    """Return the names of the nodes of a parameter file, and what stands below each."""
    found = []
    for key, value in _entries(node, prefix or 'the file'):
        if key == 'ros__parameters' and prefix:
            found.append((prefix, value))
        elif prefix and isinstance(value, yaml.ScalarNode):
            raise InputError(f'{prefix}: expected /**: and ros__parameters: above what is for a '
                             f'node, found {shortened(f"{key}: {value.value}", 100)}')
        else:  # a node, or a namespace
            found += _nodes(value, f'{prefix}/{key.strip("/")}'.strip('/'))
    return found


def _entries(node: yaml.Node | None, what: str) -> list[tuple[str, yaml.Node]]:
    # Pairs, not a dictionary: of a key that stands twice, rcl merges what is below.
    if not isinstance(node, yaml.MappingNode):
        raise InputError(f'{what}: expected keys and values (/**: ros__parameters: inertia: ...)')
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode):
            line = key.start_mark.line + 1
            raise InputError(f'{what}: expected names as keys, found a group at line {line}')
        if len(what) + len(key.value) > _LONGEST:
            raise InputError(f'{shortened(what, 60)}: expected names of at most {_LONGEST} '
                             f'characters in all, found {quoted(key.value)}')
    return [(str(key.value), value) for key, value in node.value]


def _flat(node: yaml.Node, prefix: str) -> dict[str, Any]:
    values = {}
    for key, value in _entries(node, prefix.rstrip('.') or 'ros__parameters'):
        if isinstance(value, yaml.MappingNode):
            values.update(_flat(value, f'{prefix}{key}.'))
        else:
            values[prefix + key] = _value(value)
    return values


def _value(node: yaml.Node) -> Any:
    # As rcl_yaml_param_parser reads a scalar, which is not as PyYAML does: 1e-9 is a number.
    if isinstance(node, yaml.SequenceNode):
        return [_value(item) for item in node.value]
    text = str(node.value)
    if isinstance(node, yaml.ScalarNode) and node.style in ('"', "'"):
        return text
    if text in ('y', 'Y', 'yes', 'Yes', 'YES', 'true', 'True', 'TRUE', 'on', 'On', 'ON'):
        return True
    if text in ('n', 'N', 'no', 'No', 'NO', 'false', 'False', 'FALSE', 'off', 'Off', 'OFF'):
        return False
    if _INTEGER.fullmatch(text) and len(text) < 100:
        number = _integer(text)
        if -2 ** 63 <= number < 2 ** 63:
            return number
    if _FLOAT.fullmatch(text):
        return float(text.lower().replace('.inf', 'inf').replace('.nan', 'nan'))
    return text


def _integer(text: str) -> int:
    digits = text.lstrip('+-')
    base = 16 if digits[:2] in ('0x', '0X') else 8 if digits[0] == '0' else 10
    return int(text, base)
