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
Print docs/nodes.md, the node with its topics and parameters, or docs/commands.md.

    python docs/nodes.py > docs/nodes.md
    python docs/nodes.py commands > docs/commands.md

Parameters and options are those that the code declares; a test compares the topics with those of a
running node.
"""

import argparse
import sys
from typing import NamedTuple

from rigid_body_ros import scene
from rigid_body_ros.commands.compare import attitude_compare
from rigid_body_ros.commands.ensemble import attitude_ensemble
from rigid_body_ros.commands.identify import attitude_identify
from rigid_body_ros.commands.regress import attitude_regress
from rigid_body_ros.commands.replay import attitude_replay
from rigid_body_ros.commands.tradeoff import attitude_tradeoff
from rigid_body_ros.runtime.parameters import limits
from rigid_body_ros.scene import fields, wheels

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
          'The default of `torque_topics`; every topic listed there is read in the same way. '
          'Torque, N m, and force, N, that act from its stamp on. `header.frame_id` empty or the '
          'body frame: body axes; the space frame: space axes; a link that fixed joints of '
          '`robot_description` connect to the body: its axes and origin; the child link of a '
          'continuous joint: the same, along the axis of the joint; any other is rejected. '
          'Stamp 0: acts on arrival. A force without a lever arm is ignored, counted, and logged '
          'once.'),
    Topic('initial_state', ODOMETRY, STATE,
          'Attitude and body rates at its stamp, from which a new epoch begins. Position and '
          'linear velocity are ignored. The rotors keep the momentum that they have at that '
          'time, and wheels with names their speeds.'),
]
SUBSCRIBED_IF_ENABLED = [
    Topic('wheel_torque', WRENCH, TORQUE,
          'If `wheels` is true: torque of the motors on the rotors, N m, body axes, that acts '
          'from its stamp on; the body feels the opposite torque. `header.frame_id` empty or the '
          'body frame; any other is rejected. If `wheels` is false, the node does not subscribe '
          'to it.'),
    Topic('wheel_command', JOINTS, TORQUE,
          'If there are `wheel_names`: efforts, N m, of the wheels that `name` lists, each held '
          'until the next one of its wheel; others keep theirs. `header.frame_id`, positions and '
          'velocities have no meaning. A message with an unknown or repeated name, or without a '
          'finite effort for each, is rejected as a whole.'),
    Topic('inertia', INERTIA, 'reliable, keep last 1000',
          'If `inertia_topic` is true: inertia about the centre of mass, kg m^2, body axes, of '
          'the body from its stamp on. The mass and `com` are ignored, logged once. '
          '`header.frame_id` empty or the body frame; any other is rejected. The damping stays '
          'that of the scene. `inertia_change` says what goes on.'),
    Topic('robot_description', 'std_msgs/msg/String', 'reliable, transient local, keep last 1',
          'If the parameters have neither an inertia nor a URDF: the URDF, of which the first is '
          'used.'),
    Topic('/clock', 'rosgraph_msgs/msg/Clock', 'best effort, keep last 1',
          'If `use_sim_time` is true: the time.'),
]
PUBLISHED = [
    Topic('attitude', 'geometry_msgs/msg/QuaternionStamped', STATE,
          'x y z w, body to space; in the space frame.'),
    Topic('euler_angles', VECTOR3, STATE,
          'rad; x, y, z are the three angles in the order of `euler_sequence`; in the space '
          'frame.'),
    Topic('angular_velocity', VECTOR3, STATE, 'rad/s, body axes; in the body frame.'),
    Topic('imu/data', 'sensor_msgs/msg/Imu', STATE,
          'Attitude and angular velocity with one stamp, with the errors that `imu.*` states; no '
          'acceleration (`linear_acceleration_covariance[0]` is -1); in the body frame.'),
    Topic('odometry', ODOMETRY, STATE,
          'Attitude and angular velocity, at position zero, for rviz and controllers, with the '
          'covariances that `odometry.*` states; space frame to body frame.'),
    Topic('~/accepted_torque', WRENCH, LOG,
          'Every accepted torque, about the centre of mass, with the stamp from which it acts. '
          'Together with the scene it is the log of the run. Each epoch, the first of a process '
          'included, begins with a marker: a wrench of zeros whose `frame_id` has the numbers of '
          'the start state.'),
    Topic('~/committed', ODOMETRY, LOG,
          'The start state of every epoch, then the final state at each stamp of an accepted '
          'torque, once for all topics: when the stamp is older than `history`, or at the end of '
          'the epoch.'),
    Topic('~/initial_state_result', 'diagnostic_msgs/msg/DiagnosticStatus',
          'reliable, transient local, keep last 10',
          'The result of each message on `initial_state`: level OK and when the new epoch begins, '
          'or level ERROR and why the state is rejected. `values` has the `stamp` of the message, '
          'ns.'),
    Topic('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray', STATE,
          'Once a second, and when a source falls silent or sends again: counts of torques '
          'received, applied, waiting, lost, and rejected by cause; the age of the newest torque '
          'of each source; which nodes are not connected, and why. Names and hardware_id have '
          'the name of the node with its namespace.'),
]
OPTIONAL = [
    Topic('rotor_momentum', VECTOR3, STATE,
          'If `wheels` is true: N m s, body axes, momentum of the rotors relative to the body; in '
          'the body frame.'),
    Topic('applied_torque', WRENCH, STATE,
          'If `actuator.topics` is not empty: N m, the sum of the torques that act, after delay, '
          'limit and lag; in the body frame.'),
    Topic('wheel_states', JOINTS, STATE,
          'If there are `wheel_names`: the speed of each wheel relative to the body, rad/s, and '
          'the effort that acts on it, N m; no positions.'),
    Topic('~/accepted_torque_1', WRENCH, LOG,
          'As `~/accepted_torque`, for the second topic of `torque_topics`; `_2` for the third, '
          'and so on.'),
    Topic('~/accepted_wheel_torque', WRENCH, LOG,
          'If `wheels` is true: every accepted torque on the rotors.'),
    Topic('~/accepted_wheel_command', JOINTS, LOG,
          'If there are `wheel_names`: every accepted command, not clipped, with the markers of '
          'epochs.'),
    Topic('~/accepted_inertia', INERTIA, LOG,
          'If `inertia_topic` is true: every accepted inertia, with the markers of epochs.'),
    Topic('/tf', 'tf2_msgs/msg/TFMessage', STATE,
          'Space frame to body frame, if `publish_tf` is true (needs tf2_msgs).'),
    Topic('/clock', 'rosgraph_msgs/msg/Clock', STATE,
          'In lockstep, if `publish_clock` is true: the time of each response.'),
]
#: The causes of rejection of a torque, and their meanings.
CAUSES = {
    'malformed': 'The bytes are not a WrenchStamped, or its stamp is invalid; on `wheel_command`: '
                 'a name is unknown or repeated, there is none, or an effort is missing or not '
                 'finite.',
    'unknown frame': '`header.frame_id` is neither empty nor the body frame (`frame_prefix` and '
                     '`body_frame`) nor `space_frame`, nor a link fixed to the body or turned by '
                     'a continuous joint; or the wrench is not along the axis of that joint; on '
                     '`wheel_torque`: neither empty nor the body frame; on `wheel_command`: the '
                     'marker of an epoch.',
    'not finite': 'A component of the torque is NaN or infinite.',
    'too large': 'The torque would accelerate this inertia beyond 1e9 rad/s^2.',
    'no clock': 'With `use_sim_time`: no time was received on `/clock` yet.',
    'future': 'The stamp is ahead of the clock by more than `max_future`; in lockstep: the '
              'stamp of the response, later by `step`, would not be valid.',
    'late': 'The stamp is older than the newest torque by `history` or more, or more than an hour '
            'behind the clock.',
    'overload': 'Too many torques wait.',
    'state not computable': 'The body is too fast for the state at the stamp to be computed.',
    'epoch ended': 'A new epoch began before the torque was applied.',
    'duplicate, differs (same stamp)': 'In lockstep: a different torque was accepted before for '
                                       'the same state.',
    'before the reset': 'In lockstep: the torque responds to a state from before the reset.',
    'no body has this inertia': 'The tensor on `inertia` is not finite, not that of a body, or '
                                'less than that of the wheels with names.',
}
PAGE = """\
<!-- printed by docs/nodes.py: edit that file instead -->
# Node reference: topics, services, parameters

This page lists what there is. [Node behaviour](node_behaviour.md) explains it, and [node
how-tos](node_howto.md) has tasks. To print the page again: `python docs/nodes.py > docs/nodes.md`.

## attitude_node

```bash
# needs ROS 2
ros2 run rigid_body_ros attitude_node --ros-args --params-file config/tumbler.yaml
```

Without the `ros2` command, as after `pip install '.[ros]'`, type
`attitude_node --ros-args --params-file config/tumbler.yaml`. `attitude_lifecycle_node` is
[the same as a managed node](node_howto.md#attitude_lifecycle_node).

Names without a leading slash are relative: they take the namespace of the node, and can be
remapped (`-r torque:=/wrench`). History, depth and reliability of the torques and the states can
be overridden, under the full name of the topic: `qos_overrides./torque.subscription.depth`.

### Subscribes

{subscribed}

### Subscribes if enabled

{subscribed_if_enabled}

### Publishes

{published}

All outputs for one instant carry that instant as their stamp. Values are always finite: NaN and
infinity are never published.

### Publishes if enabled

{optional}

### Services

`~/reset` (std_srvs/srv/Trigger): begins a new epoch with the initial state of the scene, its
`initial_rotor_momentum` included. In `realtime` the torques that act at that time continue to act.

`~/pause` (std_srvs/srv/SetBool), in `lockstep` only: after `data: true` torques wait, so that the
loop stands still, and with `publish_clock` everything that follows its clock; after `data: false`
it continues. The responses have the bits that they would have without the pause. In `realtime` the
motion is a function of the clock and pauses exactly when the clock does: with `use_sim_time`,
pause the program that publishes `/clock`.

### Why is a torque rejected?

The log names the cause, what was expected and what was found. `/diagnostics` counts each cause
under the key `rejected: CAUSE`.

{causes}

## Parameters

The node and every command (`--scene`) read the same file. In a running node all parameters but
`publish_rate` are read-only. [The scene file](scene.md) describes how it is read. Parameters of
ROS are not listed: `use_sim_time`, `qos_overrides`, and `autostart` of `attitude_lifecycle_node`.

{parameters}

Either the three moments or a `robot_description` are required, but a node can
[wait for the latter](node_howto.md#inertia-from-robot_state_publisher). The inertia is checked as
one tensor: positive definite, no principal moment greater than the sum of the other two by more
than 3 %. The damping is checked as one tensor, too: no negative eigenvalue. `torque_topics` names
at least one topic, each of them once. The solvers `exact` and `strang` take neither rotors nor
damping, and `exact` takes no fields.
"""
COMMANDS = """\
<!-- printed by docs/nodes.py: edit that file instead -->
# Commands: options and exit status

The commands read and write files and need no ROS, except `attitude_regress`. Each `--help` ends
with two examples that run in a clone of the repository. [The scene file](scene.md) says which
command takes which scene. To print this page again:
`python docs/nodes.py commands > docs/commands.md`.

## attitude_replay

```text
usage: attitude_replay INPUT [INPUT ...] --scene FILE [-o OUTPUT | --verify MOTION] [--plot PNG]
```

{replay}

[Recordings](recordings.md) describes inputs and outputs in detail.

## attitude_compare

```text
usage: attitude_compare RECORDING --scene FILE [--measured TOPIC]... [--align NAMES] [-o RESIDUALS]
```

{compare}

[Is my model right?](compare.md) explains the results.

## attitude_tradeoff

```text
usage: attitude_tradeoff --scene FILE
```

{tradeoff}

[What does an error cost?](tradeoff.md) explains the results and how they are measured.

## attitude_identify

```text
usage: attitude_identify RECORDING [RECORDING ...] --scene FILE [--measured TOPIC] [-o FITTED]
```

{identify}

[Which inertia does my vehicle have?](identify.md) is a tutorial, and describes the results.

## attitude_ensemble

```text
usage: attitude_ensemble --scene FILE --vary FILE --runs N [--recording IN]
    [--controller MODULE:FUNCTION] [--require EXPRESSION] -o FOLDER
```

{ensemble}

[How sure is my motion?](ensemble.md) describes the file of dispersions and the results.

## attitude_regress

```text
usage: attitude_regress REFERENCE --scene FILE [--update] -- COMMAND [ARGUMENT ...]
```

{regress}

[Has my controller changed?](regress.md) explains the results, and has a workflow to copy.

## Exit status

{exits}

While Python itself starts, for about 0.1 s, a signal ends a command as it ends any Python
program.
"""

#: Exit statuses and their meanings.
EXITS = [
    ('0', 'success'),
    ('1', '`--verify` found states whose bits differ; the summary has the difference in radians. '
          '`attitude_regress`: the closed loops differ'),
    ('2', 'wrong arguments, an input that cannot be read, or an output that cannot be written; '
          'one line names it. `attitude_ensemble`: all '
          'runs failed, too. `attitude_regress`: the controller died, sent no torques, or took '
          'too long'),
    ('3', '`attitude_identify`: the data does not determine all estimates, or the fit did not '
          'converge; no scene was written, unless with `--force`'),
    ('4', '`attitude_identify`: the fit is rejected; no scene was written, unless with '
          '`--force`. `attitude_compare --check`: the model does not explain the measurements'),
    ('128 + n', 'signal n ended the command: 130 after Ctrl-C, 143 after SIGTERM (`attitude_node` '
                'ends with 0 once it has started); 141, without a message, if the reader of the '
                'output has ended, as in `attitude_replay ... | head`'),
]


def main():
    """Print the page that the command line asks for."""
    print(commands() if sys.argv[1:] == ['commands'] else nodes(), end='')


def nodes():
    """Return the page of the node."""
    return PAGE.format(
        subscribed=topics(SUBSCRIBED),
        subscribed_if_enabled=topics(SUBSCRIBED_IF_ENABLED),
        published=topics(PUBLISHED), optional=topics(OPTIONAL),
        causes=table(('cause', 'meaning'),
                     [(f'`{cause}`', meaning) for cause, meaning in CAUSES.items()]),
        parameters=table(('parameter', 'unit', 'default', 'values', 'meaning'), [
            (f'`{parameter.name}`', parameter.unit, default(parameter), values(parameter),
             parameter.description) for parameter in parameters()]))


def commands():
    """Return the page of the commands."""
    return COMMANDS.format(
        replay=options(attitude_replay.parser()),
        compare=options(attitude_compare.parser()),
        tradeoff=options(attitude_tradeoff.parser()),
        identify=options(attitude_identify.parser()),
        ensemble=options(attitude_ensemble.parser()),
        regress=options(attitude_regress.parser()),
        exits=table(('status', 'meaning'), EXITS))


def parameters():
    """Return the parameters; those of a uniform field or wheel follow the one that names it."""
    named = {fields.FIELDS: fields.of_names(['NAME']), wheels.WHEEL_NAMES: wheels.of_names(
        ['NAME'])}
    return [one for parameter in scene.PARAMETERS.values() for one in (
        parameter, *named.get(parameter.name, {}).values())]


def topics(listed):
    """Return topics as a table in Markdown."""
    return table(('topic', 'type', 'quality of service', 'meaning'), [
        (f'`{topic.name}`', topic.kind.replace('/msg/', '/'), topic.qos, topic.meaning)
        for topic in listed])


def options(parser):
    """Return the arguments of a command as a table in Markdown."""
    return table(('argument', 'meaning'), [
        (argument(action), action.help) for action in parser._actions if action.dest != 'help'])


def argument(action):
    """Return the names of an argument, and the form of its value."""
    names = ', '.join(f'`{name}`' for name in action.option_strings)
    if action.nargs == 0:
        return names
    takes = ' '.join(action.metavar) if isinstance(action.metavar, tuple) \
        else action.metavar or '|'.join(action.choices or ()) or action.dest.upper()
    more = ' ...' if action.nargs == argparse.ONE_OR_MORE else ''
    return f'{names} `{takes}`{more}'.strip()


def default(parameter):
    """Return the default of a parameter as in YAML."""
    if parameter.default is None:
        return 'none'
    if isinstance(parameter.default, bool):
        return str(parameter.default).lower()
    if isinstance(parameter.default, list):
        return str(parameter.default)
    return f'{parameter.default:g}' if isinstance(parameter.default, float) \
        else str(parameter.default) or 'empty'


def values(parameter):
    """Return the values that a parameter accepts."""
    if parameter.choices:
        return ', '.join(parameter.choices)
    if not parameter.interval:
        return {bool: 'true, false', str: 'text', list: 'list of text'}[parameter.value_type]
    return limits(*parameter.interval)


def table(head, rows):
    """Return a table in Markdown."""
    lines = [head, ['---'] * len(head), *rows]
    return '\n'.join('| ' + ' | '.join(cell.replace('|', '\\|') for cell in line) + ' |'
                     for line in lines)


if __name__ == '__main__':
    main()
