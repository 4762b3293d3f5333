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
          'A torque, N m, and a force, N. Both take effect at the stamp of the message; in '
          '`realtime`, a message with the stamp 0 takes effect when it arrives. `header.frame_id` '
          'selects the axes: an empty text or the body frame stands for the body axes, and the '
          'space frame for the space axes. You can also name a link that fixed joints of '
          '`robot_description` connect to the body. The axes are then those of the link, and the '
          'force acts at the origin of the link. The same holds for the child link of a '
          'continuous joint, except that the force and the torque must point along the joint '
          'axis. The node rejects a message in any other frame, because it does not read `/tf`. '
          'If a force has [no lever arm](conventions.md#force) about the centre of mass, the node '
          'ignores the force; it counts such forces and logs the first. `torque` is the default '
          'of `torque_topics`, and the node reads every topic of `torque_topics` in the same '
          'way. Torques may have [other types]'
          '(node_behaviour.md#which-types-can-torques-have), too.'),
    Topic('initial_state', ODOMETRY, STATE,
          'A message begins a new epoch: the motion starts again at the stamp of the message, '
          'with the attitude and the angular velocity in the message. The node ignores the '
          'position and the linear velocity. The rotor momentum and the speeds of named wheels '
          'carry over into the new epoch.'),
]
SUBSCRIBED_IF_ENABLED = [
    Topic('wheel_torque', WRENCH, TORQUE,
          'Subscribed if `wheels` is true: the motor torque on the rotors, N m, body axes. The '
          'torque takes effect at its stamp, and the opposite torque acts on the body. '
          '`header.frame_id` must be empty or the body frame; otherwise the node rejects the '
          'message.'),
    Topic('wheel_command', JOINTS, TORQUE,
          'Subscribed if the scene sets `wheel_names`: the efforts, N m, of the wheels listed in '
          '`name`. A wheel keeps its effort until a message lists this wheel again. The node '
          'ignores `header.frame_id`, positions and velocities. It rejects the message if a name '
          'in it is unknown or repeated, or if an effort is missing or not finite.'),
    Topic('inertia', INERTIA, 'reliable, keep last 1000',
          'Subscribed if `inertia_topic` is true: the inertia that the body has from the stamp of '
          'the message onward, about the centre of mass, kg m^2, body axes. The node ignores the '
          'fields `m` and `com`, and logs once that it does. `header.frame_id` must be empty or '
          'the body frame; otherwise the node rejects the message. The damping in the scene does '
          'not change. The parameter `inertia_change` selects whether the angular velocity or the '
          'angular momentum stays the same.'),
    Topic('robot_description', 'std_msgs/msg/String', 'reliable, transient local, keep last 1',
          'Subscribed if the parameters contain neither an inertia nor a URDF: the text of the '
          'URDF. The node uses only the first message.'),
    Topic('/clock', 'rosgraph_msgs/msg/Clock', 'best effort, keep last 1',
          'Subscribed if `use_sim_time` is true: the simulated time, which the node follows.'),
]
PUBLISHED = [
    Topic('attitude', 'geometry_msgs/msg/QuaternionStamped', STATE,
          'Quaternion x y z w, body to space. `frame_id` is the space frame.'),
    Topic('euler_angles', VECTOR3, STATE,
          'Euler angles, rad. The fields x, y and z contain the first, second and third angle of '
          '`euler_sequence`. `frame_id` is the space frame.'),
    Topic('angular_velocity', VECTOR3, STATE,
          'Angular velocity, rad/s, body axes. `frame_id` is the body frame.'),
    Topic('imu/data', 'sensor_msgs/msg/Imu', STATE,
          'Attitude and angular velocity, with the errors that the parameters `imu.*` add. The '
          'message contains no acceleration (`linear_acceleration_covariance[0]` is -1). '
          '`frame_id` is the body frame.'),
    Topic('odometry', ODOMETRY, STATE,
          'Attitude and angular velocity for rviz and controllers, with the covariances given by '
          'the parameters `odometry.*`. The position is zero. `frame_id` is the space frame, and '
          '`child_frame_id` is the body frame.'),
    Topic('~/accepted_torque', WRENCH, LOG,
          'Every accepted torque, about the centre of mass, with its own stamp or with the stamp '
          'that the node gave it on arrival. Together with the scene, these messages are the '
          'complete log of the run. Each epoch, including the first after the node starts, begins '
          'with a marker: a wrench of zeros whose `frame_id` contains the start state as text.'),
    Topic('~/committed', ODOMETRY, LOG,
          'The start state of every epoch, and the final state at each stamp of an accepted '
          'torque. A state becomes final when its stamp is `history` behind the newest stamp, or '
          'when the epoch ends. If torques on several topics have the same stamp, there is one '
          'state for all of them.'),
    Topic('~/initial_state_result', 'diagnostic_msgs/msg/DiagnosticStatus',
          'reliable, transient local, keep last 10',
          "The node's answer to each message on `initial_state`. If the node accepts the state, "
          'the level is OK, and the text says when the new epoch begins. If the node rejects the '
          'state, the level is ERROR, and the text gives the reason. `values` contains the '
          '`stamp` of the message on `initial_state`, ns.'),
    Topic('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray', STATE,
          'The [statuses](node_behaviour.md#what-does-diagnostics-report) of the sources and of '
          'the motion, published once a second, and whenever a source falls silent or sends '
          "again. Each source's status counts the torques that were received, applied, lost or "
          'rejected (by cause), and those that are waiting. It also reports the age of the '
          "source's newest torque, and which nodes are not connected, with the reason. "
          '`hardware_id` is the name of the node with its namespace, and the name of each status '
          'begins with it.'),
]
OPTIONAL = [
    Topic('rotor_momentum', VECTOR3, STATE,
          'Published if `wheels` is true: the momentum of the rotors relative to the body, N m s, '
          'body axes. `frame_id` is the body frame.'),
    Topic('applied_torque', WRENCH, STATE,
          'Published if `actuator.topics` is not empty: the total torque on the body, N m, after '
          'delay, limit and lag. `frame_id` is the body frame.'),
    Topic('wheel_states', JOINTS, STATE,
          'Published if the scene sets `wheel_names`: the speed of each wheel relative to the '
          'body, rad/s, and the effort acting on the wheel, N m. The message contains no '
          'positions.'),
    Topic('~/accepted_torque_1', WRENCH, LOG,
          'The same as `~/accepted_torque`, for the second topic of `torque_topics`. The log of '
          'the third topic is `~/accepted_torque_2`, and so on.'),
    Topic('~/accepted_wheel_torque', WRENCH, LOG,
          'Published if `wheels` is true: every accepted torque on the rotors, along with the '
          'epoch markers.'),
    Topic('~/accepted_wheel_command', JOINTS, LOG,
          'Published if the scene sets `wheel_names`: every accepted command, with the efforts as '
          'they were sent (not clipped), along with the epoch markers.'),
    Topic('~/accepted_inertia', INERTIA, LOG,
          'Published if `inertia_topic` is true: every accepted inertia, along with the epoch '
          'markers.'),
    Topic('/tf', 'tf2_msgs/msg/TFMessage', STATE,
          'Published if `publish_tf` is true, which needs the package tf2_msgs: the transform '
          'from the space frame to the body frame. Its translation is zero.'),
    Topic('/clock', 'rosgraph_msgs/msg/Clock', STATE,
          'Published in lockstep if `publish_clock` is true: the stamp of each response. '
          'Published in `mode: clock`: the simulated time.'),
]
#: The causes of rejection of a torque, and their meanings.
CAUSES = {
    'malformed': "The bytes are not a message of the topic's type, or the stamp is invalid. A "
                 'message on `wheel_command` is also malformed if it contains no name, if a name '
                 'is unknown or repeated, or if an effort is missing or not finite.',
    'unknown frame': 'The frame is not one that the node accepts: an empty `header.frame_id`, the '
                     'body frame (`frame_prefix` followed by `body_frame`), `space_frame`, a link '
                     'fixed to the body, or a link turned by a continuous joint. In a link turned '
                     'by a continuous joint, the wrench must point along the joint axis. On '
                     '`wheel_torque` and `inertia`, the node accepts only an empty frame and the '
                     'body frame. On `wheel_command`, it accepts every frame, and rejects only an '
                     'epoch marker, which comes from the log of a node.',
    'not finite': 'A component of the torque is NaN or infinite.',
    'too large': 'The torque, or an effort on `wheel_command`, is larger than 1e9 rad/s^2 times '
                 'the smallest principal moment of the body in the scene.',
    'no clock': 'With `use_sim_time`, the node has not yet received a message on `/clock`.',
    'future': 'In `realtime`, the stamp is ahead of the clock by more than `max_future`. In '
              '`lockstep`, the stamp of the response, which is `step` later, would exceed the '
              'largest possible stamp.',
    'late': 'The stamp is behind the newest stamp by `history` or more, or behind the clock by '
            'more than `max_past` or an hour.',
    'overload': 'Too many torques are [waiting](node_behaviour.md#what-happens-to-a-torque).',
    'state not computable': 'The state at the stamp cannot be computed, because the body turns '
                            'too fast.',
    'epoch ended': 'A new epoch began before the node applied the torque.',
    'duplicate, differs (same stamp)': 'In `lockstep`, the node has already accepted a different '
                                       'torque for the same state, either from another publisher '
                                       'or for an earlier copy of the state.',
    'before the reset': 'In `lockstep`, the torque answers a state that was published before the '
                        'reset.',
    'no body has this inertia': 'The tensor on `inertia` is not finite, is not the inertia of any '
                                'rigid body, or is less than the inertia of the named wheels.',
}
PAGE = """\
<!-- printed by docs/nodes.py: edit that file instead -->
# Node reference: topics, services, parameters

This page lists the node's topics, services and parameters. [Node behaviour](node_behaviour.md)
explains what the node does with torques, restarts and clocks, and the [node
how-tos](node_howto.md) show how to do particular tasks. To regenerate this page, run
`python docs/nodes.py > docs/nodes.md`.

## attitude_node

```bash
# needs ROS 2
ros2 run rigid_body_ros attitude_node --ros-args --params-file config/tumbler.yaml
```

If you have no `ros2` command, for example after `pip install '.[ros]'`, run
`attitude_node --ros-args --params-file config/tumbler.yaml`. `attitude_lifecycle_node` is
[the same node with a managed lifecycle](node_howto.md#attitude_lifecycle_node).

Topic names without a leading slash are relative to the node's namespace. You can remap topics
(`-r torque:=/wrench`). To override the history, depth or reliability of an input, state or log
topic, set a parameter whose name contains the full topic name, such as
`qos_overrides./torque.subscription.depth` (see [quality of
service](robot_stack.md#how-do-i-change-the-quality-of-service)).

### Subscribes

{subscribed}

### Subscribes if enabled

{subscribed_if_enabled}

### Publishes

{published}

The stamp of a message that describes a state is the time of that state. Values are always finite:
the node never publishes NaN or infinity.

### Publishes if enabled

{optional}

### Services

`~/reset` (std_srvs/srv/Trigger) begins a new epoch with the initial state of the scene, including
`initial_rotor_momentum`. In `realtime`, torques that are acting at that moment continue to act.

`~/pause` (std_srvs/srv/SetBool) does not exist in `realtime`. In `mode: clock`, it stops the
clock, and `~/step` (std_srvs/srv/Trigger) advances a paused clock by one step. In `lockstep`,
after a call with `data: true`, torques wait, so the loop is paused. With `publish_clock`, this
also pauses every program that follows the clock. A call with `data: false` lets the loop continue.
A pause does not change a single bit of the responses. In `realtime`, the motion follows the clock,
so to pause the motion, set `use_sim_time` and pause the program that publishes `/clock`.

### Why is a torque rejected?

The node's log names the cause, and says what the node expected and what it found. `/diagnostics`
counts the rejected torques for each cause under the key `rejected: CAUSE`.

{causes}

## Parameters

The node and all commands (`--scene`) read the same scene file, whose format is described in [The
scene file](scene.md). While the node runs, all parameters except `publish_rate` are read-only. The
table leaves out `use_sim_time` and `qos_overrides`, which belong to ROS, and `autostart`, which
belongs to `attitude_lifecycle_node`.

{parameters}

A scene needs either the three moments of inertia or a `robot_description`. If it contains neither,
the node [waits for a URDF](node_howto.md#inertia-from-robot_state_publisher). The inertia tensor
must be positive definite, and no principal moment may exceed the sum of the other two by more than
3 %. The damping tensor must not have a negative eigenvalue. `torque_topics` must name at least one
topic, and may name each topic only once. The solvers `exact` and `strang` do not support rotors or
damping, and `exact` does not support torques or fields either. `max_future` must be less than
`history`, unless both are 0. If the parameters are not a valid scene, `attitude_node` prints one
line that names the wrong parameter, and ends with exit status 2.
"""
COMMANDS = """\
<!-- printed by docs/nodes.py: edit that file instead -->
# Commands: options and exit status

The commands read and write files, and only `attitude_regress` needs ROS. The help text of each
command (`--help`) ends with two examples that you can run in a clone of the repository. [The scene
file](scene.md#which-command-takes-which-scene) says which commands accept which scenes. To
regenerate this page, run `python docs/nodes.py commands > docs/commands.md`.

## attitude_replay

```text
usage: attitude_replay INPUT [INPUT ...] --scene FILE [-o OUTPUT | --verify MOTION] [--plot PNG]
```

{replay}

[Recordings](recordings.md) describes the inputs and outputs in detail.

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

[What does an error cost?](tradeoff.md) explains the results and how the command measures them.

## attitude_identify

```text
usage: attitude_identify RECORDING [RECORDING ...] --scene FILE [--measured TOPIC] [-o FITTED]
```

{identify}

[Which inertia does my vehicle have?](identify.md) is a tutorial that also explains the results.

## attitude_ensemble

```text
usage: attitude_ensemble --scene FILE --vary FILE --runs N [--recording IN]
    [--controller MODULE:FUNCTION] [--require EXPRESSION] -o FOLDER
```

{ensemble}

[How sure is my motion?](ensemble.md) describes the dispersion file and the results.

## attitude_regress

```text
usage: attitude_regress REFERENCE --scene FILE [--update] -- COMMAND [ARGUMENT ...]
       attitude_regress RECORDING --open-loop [--tolerance FIELD=VALUE] -- COMMAND [ARGUMENT ...]
```

{regress}

[Has my controller changed?](regress.md) explains the results, and has a workflow that you can
copy.

## Exit status

{exits}

During the first 0.1 s, while Python is still starting, a signal ends a command just as it ends any
other Python program.
"""

#: Exit statuses and their meanings.
EXITS = [
    ('0', 'The command succeeded.'),
    ('1', 'With `attitude_replay --verify`, some states differ in at least one bit; the summary '
          'gives the difference in radians. With `attitude_regress`, the loops or outputs differ. '
          'With any command, a traceback and the status 1 mean that there is a bug in the '
          'package.'),
    ('2', 'An argument is wrong, an input cannot be read, or an output cannot be written. A '
          'one-line message names the argument or the file. `attitude_ensemble` also exits with 2 '
          'if all runs failed. `attitude_regress` also exits with 2 if the command ended too '
          'early, sent nothing, or took too long.'),
    ('3', 'With `attitude_identify`, the data does not determine all estimates, or the fit did '
          'not converge. The command has not written a scene unless you passed `--force`.'),
    ('4', 'With `attitude_identify`, the fit was rejected; the command has not written a scene '
          'unless you passed `--force`. With `attitude_compare --check`, the model does not '
          'explain the measurements.'),
    ('128 + n', 'Signal n ended the command. The status is 130 after Ctrl-C and 143 after '
                'SIGTERM. A node that has started is an exception: it exits with 0 after either '
                'of these two signals. A node that is still waiting for a URDF has not started. '
                'The status 141, without a message, means that the program reading the output has '
                'ended, as in `attitude_replay ... | head`.'),
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
    """Return all parameters; those of a field or wheel follow the parameter with its name."""
    named = {key: of_names(key, ['NAME']) for key in NAMED}
    return [one for parameter in scene.PARAMETERS.values() for one in (
        parameter, *named.get(parameter.name, {}).values())]


def topics(listed):
    """Return a table of topics in Markdown."""
    return table(('topic', 'type', 'quality of service', 'meaning'), [
        (f'`{topic.name}`', topic.kind.replace('/msg/', '/'), topic.qos, topic.meaning)
        for topic in listed])


def options(parser):
    """Return a table of the arguments of a command in Markdown."""
    return table(('argument', 'meaning'), [
        (argument(action), action.help) for action in parser._actions if action.dest != 'help'])


def argument(action):
    """Return the names of an argument and a placeholder for its value."""
    names = ', '.join(f'`{name}`' for name in action.option_strings)
    if action.nargs == 0:
        return names
    takes = ' '.join(action.metavar) if isinstance(action.metavar, tuple) \
        else action.metavar or '|'.join(action.choices or ()) or action.dest.upper()
    more = ' ...' if action.nargs == argparse.ONE_OR_MORE else ''
    return f'{names} `{takes}`{more}'.strip()


def default(parameter):
    """Return the default of a parameter as it is written in YAML."""
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
