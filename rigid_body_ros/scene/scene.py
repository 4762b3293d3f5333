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

"""A scene: a body, its initial state and the options for a run, all of them checked."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
import math
from pathlib import Path
import re
from typing import Any

from rigid_body_ros.common.errors import InputError as InputError  # part of the interface
from rigid_body_ros.common.errors import listed, quoted
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.mechanics import euler
from rigid_body_ros.mechanics.actuator import Actuator
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.fields import Field
from rigid_body_ros.mechanics.frames import Frames
from rigid_body_ros.mechanics.imu import ImuErrors
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.wheels import Wheel, Wheels
from rigid_body_ros.propagation import Options, Problem
from rigid_body_ros.runtime.limits import read_yaml
from rigid_body_ros.runtime.parameters import checked, Parameter, parameters_of, Value
from rigid_body_ros.scene import parts
from rigid_body_ros.scene.parameters import (
    ARRIVAL,
    CLOCK,
    HEADER,
    LOCKSTEP,
    parameters_for,
    parameters_with,
    REALTIME,
    WHEEL_NAMES,
)
import yaml

#: The node whose parameters a scene file contains.
NODE = 'attitude_node'
#: Warn if the norm of a quaternion differs from 1 by more than this number. The limit allows for
#: components that were rounded to three digits.
UNIT = 1e-2
#: Matches the topic names that ROS accepts.
_TOPIC = re.compile(r'(~?/)?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*')
#: Matches a topic of which one quantity may be chosen.
_MEASURED = re.compile(_TOPIC.pattern + '(:attitude|:rates)?')


@dataclass(frozen=True)
class Scene:
    """
    All inputs of a motion except the torques, after validation.

    Most parameters are also available as attributes with the same name.

    Attributes
    ----------
    body : RigidBody
    start : State
        The initial state. The time of this state is 0 if the first torque or the clock determines
        when the motion starts.
    values : dict
        The values of all parameters, including defaults, keyed by full name.
    path : Path or None
        The absolute path of the scene file; None if the scene was not read from a file.
    links : Frames
        The frames in `robot_description` in which forces are accepted. Their names start with
        `frame_prefix`.
    ignored : tuple of str
        The names of given parameters that are ignored because they belong to other nodes.
    node : str
        The name, with namespace, of the node to which the file assigns these parameters.

    """

    body: RigidBody
    start: State
    values: Mapping[str, Any]
    path: Path | None = None
    links: Frames = field(default_factory=Frames)
    ignored: tuple[str, ...] = ()
    node: str = NODE

    mode, step, time_source = Value[str](), Value[float](), Value[str]()
    solver, tolerance, max_step = Value[str](), Value[float](), Value[float]()
    interpolation, torque_timeout = Value[str](), Value[float]()
    history, max_future, on_time_jump = Value[float](), Value[float](), Value[str]()
    max_past, stamp_offset_warning = Value[float](), Value[float]()
    real_time_factor = Value[float]()
    checkpoint, stale_after = Value[str](), Value[float]()
    publish_clock, publish_tf, publish_rate = Value[bool](), Value[bool](), Value[float]()
    euler_sequence, space_frame, wheels = Value[str](), Value[str](), Value[bool]()
    inertia_topic = Value[bool]()
    frame_prefix = Value[str]()

    def __repr__(self) -> str:
        source = self.path.name if self.path else 'no file'
        return f"Scene({source}: {self.body}, {self.start}, solver '{self.solver}')"

    @property
    def inertia_change(self) -> str:
        """Return the quantity that a change of inertia preserves; see `keep` of `BodyLog`."""
        return str(self.values['inertia_change']).removeprefix('keep_')

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Return all parameters, keyed by full name, with those of uniform fields and wheels."""
        return parameters_with(self.values)

    @property
    def fields(self) -> tuple[Field, ...]:
        """Return the fields; an orbit has its orbital position at `start_time`."""
        return parts.fields_of(self.values)

    @property
    def actuators(self) -> tuple[Actuator | None, ...] | None:
        """Return the actuator for each torque topic, or None if no topic has one."""
        return parts.actuators_of(self.values)

    def fields_from(self, start_ns: int) -> tuple[Field, ...]:
        """Return the fields; an orbit has its orbital position at the start time `start_ns`."""
        moved = parts.at_start(self.values, start_ns)
        return parts.fields_of({**self.values, **moved, 'start_time': start_ns}) \
            if moved else self.fields

    @property
    def imu(self) -> ImuErrors:
        """Return the errors of the IMU."""
        x, y, z = parts.numbers(self.values, 'imu.gyro_bias')
        names = 'gyro_noise_density', 'gyro_random_walk', 'attitude_noise', 'delay', 'seed'
        return ImuErrors(gyro_bias=(x, y, z), **{name: self.values[f'imu.{name}']
                                                 for name in names})

    @property
    def odometry_variances(self) -> tuple[float, float]:
        """Return the odometry variances of attitude, rad^2, and angular velocity, rad^2/s^2."""
        return self.values['odometry.attitude_variance'], self.values['odometry.rate_variance']

    @property
    def named_wheels(self) -> tuple[Wheel, ...]:
        """Return the named wheels."""
        return parts.wheels_of(self.values)

    @property
    def options(self) -> Options:
        """Return the solver and its options."""
        return Options(self.solver, self.tolerance, self.max_step or None, self.torque_timeout)

    def problem(self, start: State | None = None) -> Problem:
        """
        Return this scene as a problem without torques.

        The problem begins with the state `start` or, by default, with the scene's initial state.
        """
        start = start or self.start
        return Problem(self.body, start, wheels=self.named_wheels,
                       fields=self.fields_from(start.time_ns),
                       actuator=self.actuators, **asdict(self.options))

    def starting_at(self, first_ns: int, skip: float = 0.0) -> State:
        """
        Return the initial state for a recording whose first stamp is `first_ns`.

        The time of the state is `start_time` or, if that is 0, `first_ns`. If `skip` is positive,
        the time is instead `skip` seconds after `first_ns`, whatever the `start_time`.
        """
        time_ns = self.start.time_ns or first_ns
        return replace(self.start,
                       time_ns=first_ns + duration_ns(skip, 'start') if skip else time_ns)

    @property
    def body_frame(self) -> str:
        """Return the frame_id of the body axes."""
        return self.frame_prefix + str(self.values['body_frame'])

    @property
    def torque_topics(self) -> tuple[str, ...]:
        """Return the torque topics, in the order in which their torques are added up."""
        return tuple(self.values['torque_topics'])

    @property
    def has_rotors(self) -> bool:
        """Return whether the scene has rotors, driven by motors or with constant momentum."""
        return bool(self.wheels or self.values[WHEEL_NAMES] or self.start.rotor_momentum.any())

    @property
    def timeout_ns(self) -> int:
        """Return the torque timeout, ns; 0 if torques never time out."""
        return self.options.timeout_ns

    @property
    def warnings(self) -> list[str]:
        """Return a line of text for each value that is valid but probably a mistake."""
        return [*_other_node(self.node), *self._warnings()]

    @property
    def notes(self) -> list[str]:
        """
        Return lines of text for the log.

        They name given parameters that have no effect, and the links of `robot_description` whose
        masses belong to the body or do not.
        """
        ignored = f'parameters that are not those of a scene are ignored: {listed(self.ignored)}'
        return [*([ignored] if self.ignored else []),
                *(f'robot_description: {note}' for note in self.links.notes)]

    @classmethod
    def from_values(cls, given: Mapping[str, Any]) -> Scene:
        """
        Create a scene from parameter values.

        Parameters
        ----------
        given : mapping
            The values, keyed by full name, such as 'inertia.ixx'. Parameters that are not given
            have their default values. Parameters of other nodes are ignored, because nodes often
            share a parameter file.

        Raises
        ------
        InputError
            A required parameter is missing; an unknown parameter resembles a known one; a value
            has the wrong type or is out of range; or two values contradict each other.

        """
        table, ignored = parameters_for(given)
        specified = {**given, **parts.inertia_of_robot(given)}
        values = {name: checked(parameter, specified.get(name, parameter.default))
                  for name, parameter in table.items()}
        try:
            start = State(values['start_time'], *(parts.numbers(values, group) for group in (
                'initial_attitude', 'initial_angular_velocity', 'initial_rotor_momentum')))
            scene = cls(parts.body_of(values), start, values, links=parts.links_of(values),
                        ignored=ignored)
            scene._check()
        except ValueError as error:
            raise InputError(str(error)) from error
        return scene

    def _check(self) -> None:
        """Raise ValueError if any values contradict each other."""
        self.options.check_terms(self.body.is_damped, self.has_rotors, bool(self.fields))
        self._check_wheels()
        if self.checkpoint and self.values['orbit.mean_motion'] and not self.start.time_ns:
            raise InputError('start_time: expected the time of orbit.position, ns, because a '
                             'checkpoint does not keep it, found 0')
        if not self.torque_topics:
            raise InputError('torque_topics: expected at least one topic, found an empty list')
        for name in ('torque_topics', 'monitor.measured'):
            _check_topics(name, self.values[name])
        parts.actuators_of(self.values)
        euler.check_sequence(self.euler_sequence)
        for name in ('space_frame', 'body_frame', 'frame_prefix', 'checkpoint'):
            _check_text(name, self.values[name])
        if self.space_frame == self.body_frame:
            raise InputError('space_frame, body_frame: expected different names, found '
                             f'{quoted(self.space_frame)} twice')
        if self.inertia_topic and self.checkpoint:
            raise InputError('checkpoint: expected none with inertia_topic, because a checkpoint '
                             f'does not keep the inertia, found {quoted(self.checkpoint)}')
        if self.mode == LOCKSTEP and self.time_source == ARRIVAL:
            raise InputError(f'time_source: expected {HEADER!r}, because lockstep replies to '
                             f'stamps, found {ARRIVAL!r}')
        if self.publish_clock and self.mode == REALTIME:
            raise InputError(f'publish_clock: expected mode {LOCKSTEP!r} or {CLOCK!r}, in which '
                             f'the node sets the time, found {self.mode!r}')
        ahead_ns, behind_ns = (duration_ns(self.values[name], name)
                               for name in ('max_future', 'history'))
        if not ahead_ns < max(behind_ns, 1):
            raise InputError(f'max_future: expected less than history ({self.history} s), found '
                             f'{self.max_future} s')

    def _check_wheels(self) -> None:
        if not self.named_wheels:
            return
        if self.wheels:
            raise InputError(f'{WHEEL_NAMES}: expected none with wheels: true, found '
                             f'{listed(self.values[WHEEL_NAMES])}')
        if self.values['orbit.mean_motion']:
            raise InputError(f'orbit.mean_motion: expected 0 with {WHEEL_NAMES}, because the two '
                             'together are not supported yet, found '
                             f'{self.values["orbit.mean_motion"]} rad/s')
        wheels = Wheels(self.named_wheels)
        wheels.carrier(self.body)
        self.options.check_terms(False, True, coupled=wheels.is_coupled)

    def _warnings(self) -> Iterator[str]:
        if self.body.triangle_excess:
            yield ('inertia: the largest principal moment exceeds the sum of the other two by '
                   f'{100.0 * self.body.triangle_excess:.2g} %, which no body can have; are the '
                   'numbers rounded?')
        name, links = self.body_frame, self.links
        if name in links.others or (name in links and not links[name].is_aligned):
            link = quoted(links.link.removeprefix(self.frame_prefix))
            yield (f'body_frame: {quoted(name.removeprefix(self.frame_prefix))} is a link of '
                   f'robot_description, but its axes are not those of link {link}, whose axes '
                   f'are the body axes; expected {link}')
        norm = math.hypot(*parts.numbers(self.values, 'initial_attitude'))
        if abs(norm - 1.0) > UNIT:
            yield ('initial_attitude: expected a quaternion x y z w of norm 1, found norm '
                   f'{norm:.3g}; it is normalised; are the numbers angles?')
        rate = math.hypot(*parts.numbers(self.values, 'initial_angular_velocity'))
        if rate > self.values['plausible_speed']:
            yield (f'initial_angular_velocity: {rate:.4g} rad/s is {rate / (2.0 * math.pi):.3g} '
                   'turns per second; if the numbers are degrees per second, multiply them by '
                   'pi / 180 = 0.0174533')


def load(path: str | Path, **values: Any) -> Scene:
    """
    Read a scene from a ROS 2 parameter file, for example one written by `ros2 param dump`.

    Parameters
    ----------
    path : str or Path
        The parameter file. Its parameters of `/**` apply to every node, and its parameters of
        `attitude_node` override them. If the file has parameters of one other node only, these are
        used, and `Scene.warnings` contains a warning.
    **values
        Parameters that replace those of the file. Names that contain a dot need `**{'name.key':
        value}`.

    Returns
    -------
    Scene
        The scene, with the default of each parameter that is not given.

    Raises
    ------
    InputError
        The file cannot be read.
        The file is not a parameter file.
        The scene is not valid; the message names the parameter.

    """
    root, node = read_yaml(path, 'scene'), NODE
    try:
        node, given = parameters_of(root, NODE)
        return replace(Scene.from_values({**given, **values}), path=Path(path).absolute(),
                       node=node)
    except InputError as error:
        raise InputError('; '.join([f'{path}: {error}', *_other_node(node)])) from error


def text_of(scene: Scene, changed: Mapping[str, Any]) -> str:
    """
    Return a scene as the text of a scene file, with some parameters changed.

    The inertia is written with all digits. If the inertia is among the changed values,
    `robot_description` is left out, because it would specify the old inertia.
    """
    parameters = parameters_with({**scene.values, **changed})
    values = {name: value for name, value in scene.values.items()
              if value != parameters[name].default or name.startswith('inertia')}
    if any(name.startswith('inertia') for name in changed):
        values.pop('robot_description', None)
        values.pop('link', None)
    values.update(changed)
    tree: dict[str, Any] = {}
    for name in parameters:
        if name in values:
            group, _, key = name.rpartition('.')
            (tree.setdefault(group, {}) if group else tree)[key] = values[name]
    return yaml.safe_dump({'/**': {'ros__parameters': tree}}, sort_keys=False)


def _other_node(node: str) -> list[str]:
    """Return a warning if the parameters in a file are for another node."""
    if node.split('/')[-1] in (NODE, '*', '**'):
        return []
    return [f'expected parameters of /** or {NODE}, found those of {listed([node])} only, which '
            f'a node of that name alone receives']


def _check_text(name: str, text: str) -> None:
    if not text and name.endswith('_frame'):
        raise InputError(f'{name}: expected the name of a frame, found an empty text')
    if not text.isprintable():  # ROS accepts any text, but terminals act on control characters
        raise InputError(f'{name}: expected text without control characters, found '
                         f'{quoted(text)}')


def _check_topics(key: str, names: Sequence[Any]) -> None:
    for number, name in enumerate(names):
        pattern = _MEASURED if key == 'monitor.measured' else _TOPIC
        if not isinstance(name, str) or not pattern.fullmatch(name):
            raise InputError(f'{key}: expected names of topics (letters, digits, _ and /), '
                             f'found {quoted(name)}')
        if name in names[:number]:
            raise InputError(f'{key}: expected each topic once, found {name!r} twice')
