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
Print docs/nodes.md (topics and parameters of the node) or docs/commands.md (options).

    python docs/nodes.py > docs/nodes.md
    python docs/nodes.py commands > docs/commands.md

The parameters and options are read from the code. The topics are listed in this file, and a test
compares them with the topics of a running node.
"""

import argparse
import itertools
import sys
import textwrap
from typing import NamedTuple

from rigid_body_ros import scene
from rigid_body_ros.commands.compare import attitude_compare
from rigid_body_ros.commands.design import attitude_design
from rigid_body_ros.commands.ensemble import attitude_ensemble
from rigid_body_ros.commands.identify import attitude_identify
from rigid_body_ros.commands.regress import attitude_regress
from rigid_body_ros.commands.replay import attitude_replay
from rigid_body_ros.commands.tradeoff import attitude_tradeoff
from rigid_body_ros.propagation import LONGEST
from rigid_body_ros.runtime.parameters import TINY
from rigid_body_ros.scene.parameters import NAMED, of_names

WRENCH, ODOMETRY = 'geometry_msgs/msg/WrenchStamped', 'nav_msgs/msg/Odometry'
INERTIA = 'geometry_msgs/msg/InertiaStamped'
JOINTS = 'sensor_msgs/msg/JointState'
VECTOR3 = 'geometry_msgs/msg/Vector3Stamped'
TORQUE = 'best effort, keep last 1000; in lockstep reliable'
STATE, LOG = 'reliable, keep last 10', 'reliable, transient local, keep last 10 000'


class Topic(NamedTuple):
    """A topic of the node, its quality of service, and its meaning."""

    name: str
    kind: str
    qos: str
    meaning: str


SUBSCRIBED = [
    Topic('torque', WRENCH, TORQUE,
          'A torque, N m, and a force, N, which act from the stamp of the message on; in '
          '`realtime`, the stamp 0 means on arrival. `header.frame_id` selects the axes: body '
          'axes if it is empty or the body frame, space axes if it is the space frame, or the '
          'axes of a [link of `robot_description`](node_howto.md#forces-and-frames), at whose '
          'origin the force acts. A force without a [lever arm](conventions.md#force) is ignored '
          'and counted. The same holds for all `torque_topics`, which may have [other '
          'types](node_behaviour.md#which-types-can-torques-have).'),
    Topic('initial_state', ODOMETRY, STATE,
          'Begins a new epoch at its stamp, with its attitude and angular velocity. Position and '
          'linear velocity are ignored. Rotor momentum and wheel speeds stay the same.'),
]
SUBSCRIBED_IF_ENABLED = [
    Topic('wheel_torque', WRENCH, TORQUE,
          'With `wheels`: motor torque on the rotors, N m, body axes, from the stamp on; the '
          'opposite torque acts on the body. The frame must be empty or the body frame.'),
    Topic('wheel_command', JOINTS, TORQUE,
          'With `wheel_names`: efforts, N m, of the wheels in `name`. A wheel keeps its effort '
          'until a message lists it again. Frame, positions and velocities are ignored.'),
    Topic('inertia', INERTIA, 'reliable, keep last 1000',
          'With `inertia_topic`: the inertia from the stamp on, about the centre of mass, kg m^2, '
          'body axes. `m` and `com` are ignored. The frame must be empty or the body frame. The '
          'damping does not change; see `inertia_change`.'),
    Topic('robot_description', 'std_msgs/msg/String', 'reliable, transient local, keep last 1',
          'The URDF, if the parameters contain neither an inertia nor a URDF. Only the first '
          'message counts.'),
    Topic('/clock', 'rosgraph_msgs/msg/Clock', 'best effort, keep last 1',
          'With `use_sim_time`: simulated time, which the node follows.'),
]
PUBLISHED = [
    Topic('attitude', 'geometry_msgs/msg/QuaternionStamped', STATE,
          'Quaternion x y z w, body to space; space frame.'),
    Topic('euler_angles', VECTOR3, STATE,
          'Euler angles of `euler_sequence`, rad, in this order; space frame.'),
    Topic('angular_velocity', VECTOR3, STATE, 'Angular velocity, rad/s, body axes; body frame.'),
    Topic('imu/data', 'sensor_msgs/msg/Imu', STATE,
          'Attitude and angular velocity with the errors of `imu.*`; body frame. There is no '
          'acceleration (`linear_acceleration_covariance[0]` is -1).'),
    Topic('odometry', ODOMETRY, STATE,
          'Attitude and angular velocity with the covariances of `odometry.*`; space frame, and '
          'body frame as child. The position is zero.'),
    Topic('~/accepted_torque', WRENCH, LOG,
          'Every accepted torque, about the centre of mass, with its stamp or time of arrival. '
          'With the scene, this is the complete log of the run. Each epoch begins with a marker, '
          'a wrench of zeros whose `frame_id` contains the start state as text.'),
    Topic('~/committed', ODOMETRY, LOG,
          'The start state of every epoch, and the final state at each stamp of an accepted '
          'torque, once the newest stamp is `history` later or the epoch ends.'),
    Topic('~/initial_state_result', 'diagnostic_msgs/msg/DiagnosticStatus',
          'reliable, transient local, keep last 10',
          'The response to each `initial_state`: OK and the start of the epoch, or ERROR and the '
          'reason. `values` has the `stamp` of the message, ns.'),
    Topic('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray', STATE,
          'The [statuses](node_behaviour.md#what-does-diagnostics-report) of the sources and of '
          'the motion, once a second, and when a source falls silent or sends again. '
          '`hardware_id` is the name of the node with its namespace; status names begin with it.'),
]
OPTIONAL = [
    Topic('rotor_momentum', VECTOR3, STATE,
          'With `wheels`: momentum of the rotors relative to the body, N m s, body axes.'),
    Topic('applied_torque', WRENCH, STATE,
          'With `actuator.topics`: total torque on the body, N m, after delay, limit and lag; '
          'body frame.'),
    Topic('wheel_states', JOINTS, STATE,
          'With `wheel_names`: speed relative to the body, rad/s, and acting effort, N m, of each '
          'wheel; no positions.'),
    Topic('~/accepted_torque_1', WRENCH, LOG,
          'The log of the second topic of `torque_topics`; `~/accepted_torque_2` of the third, '
          'and so on.'),
    Topic('~/accepted_wheel_torque', WRENCH, LOG,
          'With `wheels`: every accepted torque on the rotors, and the markers.'),
    Topic('~/accepted_wheel_command', JOINTS, LOG,
          'With `wheel_names`: every accepted command as it was sent, and the markers.'),
    Topic('~/accepted_inertia', INERTIA, LOG,
          'With `inertia_topic`: every accepted inertia, and the markers.'),
    Topic('/tf', 'tf2_msgs/msg/TFMessage', STATE,
          'With `publish_tf` (needs tf2_msgs): transform from the space frame to the body frame, '
          'with zero translation.'),
    Topic('/clock', 'rosgraph_msgs/msg/Clock', STATE,
          'With `publish_clock` in lockstep: the stamp of each response. In `mode: clock`: the '
          'simulated time.'),
]
#: The names under which the page lists the profiles that several topics share.
PROFILES = {TORQUE: '; *torque*', STATE: '', LOG: '; *log*'}
#: The causes of rejection of a torque, and their meanings.
CAUSES = {
    'malformed': 'The bytes are not a message of the type, or the stamp is invalid. On '
                 '`wheel_command`, a name is missing, unknown or repeated, or an effort is '
                 'missing or not finite.',
    'unknown frame': 'The frame is neither empty nor the body frame (`frame_prefix` followed by '
                     '`body_frame`), the space frame, or [an allowed '
                     'link](node_howto.md#forces-and-frames). For `wheel_torque` and `inertia`, '
                     'it must be empty or the body frame; `wheel_command` allows any.',
    'not finite': 'A component of the torque is NaN or infinite.',
    'too large': 'The torque or effort is above 1e9 rad/s^2 times the smallest principal moment '
                 'of the body in the scene.',
    'no clock': 'With `use_sim_time`, no message has arrived on `/clock` yet.',
    'future': 'In `realtime`, the stamp is more than `max_future` ahead of the clock. In '
              '`lockstep`, the stamp of the response would be too large.',
    'late': 'The stamp is `history` or more behind the newest stamp, or more than `max_past` or '
            'an hour behind the clock.',
    'overload': 'Too many torques are [waiting](node_behaviour.md#what-happens-to-a-torque).',
    'state not computable': 'The body rotates too fast to compute the state at the stamp.',
    'epoch ended': 'A new epoch began before the torque was applied.',
    'duplicate, differs (same stamp)': 'In `lockstep`, a different torque for the same state has '
                                       'been accepted, from another publisher or for an earlier '
                                       'copy of the state.',
    'before the reset': 'In `lockstep`, the torque responds to a state from before the reset.',
    'no body has this inertia': 'The tensor on `inertia` is not finite, is not possible for a '
                                'rigid body, or is less than the inertia of the named wheels.',
}
PAGE = """\
<!-- printed by docs/nodes.py: edit that file instead -->
# Node reference: topics, services, parameters

The node takes torques on `torque`, and publishes the motion on `attitude`, `angular_velocity` and
other topics. [Node behaviour](node_behaviour.md) says what it does with late torques, restarts and
clock jumps, and [node how-tos](node_howto.md) show single tasks.

## attitude_node

```bash
# needs ROS 2
ros2 run rigid_body_ros attitude_node --ros-args --params-file config/tumbler.yaml
```

`attitude_lifecycle_node` is [the managed version](node_howto.md#attitude_lifecycle_node).

Names without a leading slash are relative to the namespace, and can be remapped
(`-r torque:=/wrench`). Where a topic lists no quality of service (QoS), the QoS is
{state}. You can [override
it](robot_stack.md#how-do-i-change-the-quality-of-service). The lists abbreviate two others:

- *torque*: {torque}
- *log*: {log}

### Subscribes

{subscribed}

### Subscribes if enabled

{subscribed_if_enabled}

### Publishes

The stamp of a message is the time of its state. Values are always finite.

{published}

### Publishes if enabled

{optional}

### Services

- `~/reset` (std_srvs/Trigger) begins an epoch with the initial state of the scene, including the
  rotors. In `realtime`, torques that act at this time continue to act.
- `~/pause` (std_srvs/SetBool) stops the clock in `mode: clock`. In `lockstep`, torques wait, and
  no bit of the later responses changes. In `realtime`, the service does not exist: set
  `use_sim_time`, and pause the source of `/clock`.
- `~/step` (std_srvs/Trigger), in `mode: clock`, advances a paused clock by one step.

### Why is a torque rejected?

The log names the cause, what was expected and what was found. `/diagnostics` counts the torques
rejected for each of these causes:

{causes}

## Parameters

The node and all commands read these parameters from [the scene file](scene.md). While the node
runs, only `publish_rate` can change. The parentheses contain the default, the unit, and the limits
or other values. Times, speeds and variances are at most 1e9.

{parameters}

A scene needs the three moments of inertia or a `robot_description`. With neither, the node [waits
for a URDF](node_howto.md#inertia-from-robot_state_publisher). [Some parameters exclude each
other](scene.md#which-parameters-exclude-each-other). If a parameter is wrong, `attitude_node`
prints one line that names it, and exits with status 2.
"""
#: The commands, their usage, and the pages that explain their results.
COMMANDS = [
    (attitude_replay, 'INPUT [INPUT ...] --scene FILE [-o OUTPUT | --verify MOTION]',
     '[Recordings](recordings.md)'),
    (attitude_compare, 'RECORDING --scene FILE [--measured TOPIC]... [--align NAMES]',
     '[Model check](compare.md)'),
    (attitude_identify, 'RECORDING [RECORDING ...] --scene FILE [--estimate NAMES] [-o FITTED]',
     '[Identification](identify.md)'),
    (attitude_design, '--scene FILE --limit NAME=VALUE [--limit NAME=VALUE]...\n'
     '    --duration SECONDS --sensors TOPIC:NOISE,... [--estimate NAMES] [-o PROFILE]',
     '[Maneuvers](design_maneuver.md)'),
    (attitude_ensemble, '--scene FILE --vary FILE --runs N [--recording IN]\n'
     '    [--controller MODULE:FUNCTION] [--require EXPRESSION] -o FOLDER',
     '[Monte Carlo](ensemble.md)'),
    (attitude_regress, 'REFERENCE --scene FILE [--update] -- COMMAND [ARGUMENT ...]\n'
     '       attitude_regress RECORDING --open-loop [--update] -- COMMAND [ARGUMENT ...]',
     '[Regression tests](regress.md)'),
    (attitude_tradeoff, '--scene FILE [--recording IN] [--target RAD]',
     '[Solver speed and accuracy](tradeoff.md)'),
]
COMMANDS_PAGE = """\
<!-- printed by docs/nodes.py: edit that file instead -->
# Commands: options and exit status

Each command takes a scene and recordings, prints a summary, and writes what you ask for:

```bash
attitude_replay test/recordings/tumbler.mcap --scene config/tumbler.yaml --report motion.html
```

`--help` ends with two examples that run in a clone of the repository. Only `attitude_regress`
needs ROS. See also [which command takes which scene](scene.md#which-command-takes-which-scene)
and [which files are replaced](recordings.md#which-files-are-replaced).

## Options of several commands

{shared}

{commands}

## Exit status

{exits}

With status 3 or 4, `attitude_identify` writes no scene, unless you pass `--force`.
"""

#: Exit statuses and their meanings.
EXITS = [
    ('0', 'The command succeeded.'),
    ('1', '`attitude_replay --verify` found states that differ in at least one bit, or '
          '`attitude_regress` found loops or outputs that differ. If there is a traceback, the '
          'package has a bug.'),
    ('2', 'An argument is wrong, an input cannot be read, or an output cannot be written; one '
          'line names it. All runs of `attitude_ensemble` failed. The command of '
          '`attitude_regress` ended too early, sent nothing, or took too long.'),
    ('3', 'The data of `attitude_identify` does not determine all estimates, or the fit did not '
          'converge. No maneuver of `attitude_design` determines all estimates.'),
    ('4', 'The fit of `attitude_identify` is rejected, or the model of `attitude_compare --check` '
          'does not explain the measurements.'),
    ('128 + n', 'Signal n ended the command: 130 after Ctrl-C, 143 after SIGTERM. A node that has '
                'started exits with 0 instead. The status is 141 if the program that reads the '
                'output has ended, as `head` does.'),
]


def main():
    """Print the page that the command line asks for."""
    print(commands() if sys.argv[1:] == ['commands'] else nodes(), end='')


def nodes():
    """Return the page of the node."""
    return PAGE.format(
        torque=TORQUE, state=STATE, log=LOG,
        subscribed=topics(SUBSCRIBED),
        subscribed_if_enabled=topics(SUBSCRIBED_IF_ENABLED),
        published=topics(PUBLISHED), optional=topics(OPTIONAL),
        causes='\n'.join(wrapped(f'- `{cause}`: {meaning}', 2)
                         for cause, meaning in CAUSES.items()),
        parameters='\n'.join(parameters()))


def commands():
    """Return the page of the commands; an option of several commands stands in the first list."""
    options = {command.name: [wrapped(f'- {argument(action)}: {action.help}', 2)
                              for action in command.parser()._actions
                              if action.dest not in ('help', 'version')]
               for command, _, _ in COMMANDS}
    users = {}
    for name, lines in options.items():
        for line in lines:
            users.setdefault(line, []).append(name)
    shared = {}
    for line, names in users.items():
        if len(names) > 1:
            shared.setdefault(users_of(names), []).append(line)
    return COMMANDS_PAGE.format(
        shared='\n\n'.join('\n'.join((wrapped(f'{names}:'), '', *lines))
                           for names, lines in shared.items()),
        commands='\n\n'.join('\n'.join((
            f'## {command.name}\n', f'See {page}.',
            f'\n```text\nusage: {command.name} {usage}\n```\n',
            *(line for line in options[command.name] if len(users[line]) == 1)))
            for command, usage, page in COMMANDS),
        exits='\n'.join(wrapped(f'- {status}: {meaning}', 2) for status, meaning in EXITS))


def users_of(names):
    """Return a text that names the commands with an option."""
    others = [command.name for command, _, _ in COMMANDS if command.name not in names]
    if not others:
        return 'All commands'
    named = names if len(others) > 2 else others
    listed = ', '.join(f'`{name}`' for name in named)
    return listed if named is names else f'All but {listed}'


def wrapped(text, indent=0):
    """Return text in lines of the length that the pages have."""
    return textwrap.fill(text, 99, subsequent_indent=' ' * indent, break_long_words=False,
                         break_on_hyphens=False)


def parameters():
    """
    Return a line for each parameter; those of a field or wheel follow the one with its name.

    The components of a vector or tensor share a line if they share their meaning.
    """
    named = {key: of_names(key, ['NAME']) for key in NAMED}
    listed = [one for parameter in scene.PARAMETERS.values() for one in (
        parameter, *named.get(parameter.name, {}).values())]
    return [line_of([*group]) for _, group in itertools.groupby(
        listed, lambda one: (one.name.rpartition('.')[0], one.description, one.interval))]


def line_of(group):
    """Return the line of parameters that share a meaning."""
    first, *others = (parameter.name for parameter in group)
    names = [first, *(name[name.rindex('.'):] for name in others)]
    defaults = [default(parameter) for parameter in group]
    if len({*defaults}) == 1:
        defaults = defaults[:1]
    given = [f'{" ".join(defaults)} {group[0].unit}'.strip(), *filter(None, [values(group[0])])]
    return wrapped(f'- `{", ".join(names)}` ({"; ".join(given)}): {group[0].description}', 2)


def topics(listed):
    """Return a list of topics in Markdown."""
    return '\n'.join(wrapped(f'- `{topic.name}` ({topic.kind.replace("/msg/", "/")}'
                             f'{PROFILES.get(topic.qos, f"; {topic.qos}")}): {topic.meaning}', 2)
                     for topic in listed)


def argument(action):
    """Return the names of an argument and a placeholder for its value."""
    names = ', '.join(action.option_strings)
    if action.nargs == 0:
        return f'`{names}`'
    takes = ' '.join(action.metavar) if isinstance(action.metavar, tuple) \
        else action.metavar or '|'.join(action.choices or ()) or action.dest.upper()
    more = ' ...' if action.nargs == argparse.ONE_OR_MORE else ''
    return f'`{f"{names} {takes}".strip()}{more}`'


def default(parameter):
    """Return the default of a parameter as it is written in YAML."""
    if parameter.default is None:
        return 'no default,'
    if isinstance(parameter.default, bool):
        return str(parameter.default).lower()
    if isinstance(parameter.default, list):
        return str(parameter.default)
    return f'{parameter.default:g}' if isinstance(parameter.default, float) \
        else str(parameter.default) or 'empty'


def values(parameter):
    """Return the other values that a parameter accepts, or '' if its type says it all."""
    if parameter.choices:
        return ', '.join(value for value in parameter.choices if value != parameter.default)
    if not parameter.interval:
        return ''
    low, high = parameter.interval
    if high < LONGEST:
        return f'{low:g} to {high:g}'
    return {0: '>= 0', TINY: '> 0'}.get(low, f'>= {low:g}' if low > 0 else '')


if __name__ == '__main__':
    main()
