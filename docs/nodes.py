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
Print docs/nodes.md: the node, its topics and parameters, and the options of the commands.

    python docs/nodes.py > docs/nodes.md

Parameters and options are those that the code declares; a test holds the topics against a node
that runs.
"""

import argparse
from typing import NamedTuple

from rigid_body_ros import cli, scene

WRENCH, ODOMETRY = 'geometry_msgs/msg/WrenchStamped', 'nav_msgs/msg/Odometry'
VECTOR3 = 'geometry_msgs/msg/Vector3Stamped'
STATE, LOG = 'reliable, keep last 10', 'reliable, transient local, keep last 10 000'


class Topic(NamedTuple):
    """A topic of the node, its quality of service, and what it says."""

    name: str
    kind: str
    qos: str
    meaning: str


SUBSCRIBED = [
    Topic('torque', WRENCH, 'best effort, keep last 1000; in lockstep reliable',
          'Torque about the centre of mass, N m, from its stamp on. `header.frame_id` empty or '
          'the body frame: body axes; the space frame: space axes; any other is rejected. Stamp '
          '0: on arrival. A force is ignored, counted, and logged once.'),
    Topic('initial_state', ODOMETRY, STATE,
          'Attitude and body rates that hold at its stamp: a new epoch. Position and velocity are '
          'not looked at.'),
]
PUBLISHED = [
    Topic('attitude', 'geometry_msgs/msg/QuaternionStamped', STATE,
          'x y z w, body to space; in the space frame.'),
    Topic('euler_angles', VECTOR3, STATE,
          'rad; x, y, z are the three angles in the order of `euler_sequence`; in the space '
          'frame.'),
    Topic('angular_velocity', VECTOR3, STATE, 'rad/s, body axes; in the body frame.'),
    Topic('imu/data', 'sensor_msgs/msg/Imu', STATE,
          'Attitude and angular velocity with one stamp; no acceleration '
          '(`linear_acceleration_covariance[0]` is -1); in the body frame.'),
    Topic('odometry', ODOMETRY, STATE,
          'The same at position zero, for rviz and controllers; space frame to body frame.'),
    Topic('~/accepted_torque', WRENCH, LOG,
          'Every torque taken, at the stamp it took effect: with the scene, the log of the run. '
          'One of zero without stamp and frame says that a new epoch begins.'),
    Topic('~/committed', ODOMETRY, LOG,
          'The state at each of those stamps once it is older than `history`, all of them at the '
          'end; the start of every epoch first.'),
    Topic('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray', STATE,
          'Once a second: every torque received, applied, waiting, lost or rejected, by cause; '
          'who is not connected, and why.'),
]
ON_REQUEST = [
    Topic('/tf', 'tf2_msgs/msg/TFMessage', STATE,
          'Space frame to body frame, where `publish_tf` is true (needs tf2_msgs).'),
    Topic('/clock', 'rosgraph_msgs/msg/Clock', STATE,
          'Where `publish_clock` is true, in lockstep: the time of each answer.'),
]
PAGE = """\
<!-- printed by docs/nodes.py: change that -->
# Node, commands, parameters

## attitude_node

```
ros2 run rigid_body_ros attitude_node --ros-args --params-file SCENE
```

Without the `ros2` command, as after `pip install '.[ros]'`, type
`attitude_node --ros-args --params-file SCENE`.

Names without a slash are relative: a namespace goes before them, and `-r torque:=/wrench` connects
them to others. Quality of service can be overridden (`qos_overrides./torque.subscription.depth`).

### Subscribes

{subscribed}

### Publishes

{published}

All outputs of one instant carry that instant as their stamp. Nothing that is not finite is ever
published.

### On request

{on_request}

### Service

`~/reset` (std_srvs/srv/Trigger): back to the start of the scene, a new epoch.

### What becomes of a torque

A torque fixes the state at its stamp, under the torque before it. What is published between stamps
is a prediction that nothing later is built on. So a torque may be late, by less than `history`,
and they may come in any order: the committed states are the same bits, and a replay of
`~/accepted_torque` gives them again. Of equal stamps the one that arrives later counts. A message
that is not finite, in an unknown frame, too old, or stamped impossibly is refused whole, counted,
and reported at most every 5 s.

Every torque sent is counted once: applied, waiting, rejected by cause, lost on the way, or lost in
the queue of the subscription, because it came faster than the machine can take it. While more
than 5000 torques wait in `realtime`, the first for longer than 2 s, new ones are rejected
(`overload`): the motion is soon back in real time.

Without a stamp, or with `time_source:=arrival`, a torque takes effect when it arrives. Each has a
stamp of its own; between two ticks of simulated time, time goes on as fast as before.

With `use_sim_time` the node waits for `/clock`, and `on_time_jump` says what a clock that runs
back does. For a bag that is played without `--clock` there is `time_source:=arrival`.

### Lockstep

In `realtime` the clock asks for the motion at `publish_rate`. In `lockstep` each torque stamped t
is answered at once with the state at t + `step`. A controller that answers each state with a
torque at the state's stamp closes a loop, and the loop is one chain: one torque for each state.

- The latest state is published again at 10 Hz while no node publishes torques. A controller that
  starts, or is restarted, receives it once, half a second after it is connected.
- A controller may take its time. Only after 2 s of silence is the state published again, then
  after 4 s, and so on: a controller that works for longer receives it twice, and the torque it
  sends for the second copy has no effect.
- A torque that the same controller repeats later than 0.1 s after its answer is answered again,
  because the answer may have been lost. So is another torque at the same stamp: it replaces the
  first.
- Torques of a second controller are rejected (`answered already`), and diagnostics name both.
- `~/reset` begins again with the initial state. The torque that answers the state before the reset
  is rejected (`before the reset`), so that time goes back.

Silence, and an answer that takes long, are warnings in diagnostics.

## Parameters

One file serves the node, `attitude_replay` and `attitude_tradeoff` (`--scene`). An integer is
taken where a number is meant; a key that is not known is refused. In a running node all are
read-only but `publish_rate`. `ros2 param describe` says the same as this table, and
`ros2 param dump` writes a file that is a scene.

{parameters}

The moments have to be given, or a `robot_description`. The inertia is checked as one tensor:
positive definite, no principal moment greater than the sum of the other two.

## attitude_replay

```
attitude_replay INPUT [INPUT ...] --scene FILE [-o OUTPUT | --verify MOTION] [--plot PNG]
```

{replay}

[Recordings](recordings.md) has more of what goes in and comes out.

## attitude_tradeoff

```
attitude_tradeoff --scene FILE
```

{tradeoff}

[What does an error cost?](tradeoff.md) explains the results and how they are measured.

## Exit status

{exits}
"""

#: By exit status, its meaning.
EXITS = [
    ('0', 'success'),
    ('1', '`--verify` found states whose bits differ; the summary has by how many radians'),
    ('2', 'wrong arguments, an input that cannot be read, or an output that cannot be written, '
          'with one line that names it'),
    ('128 + n', 'signal n ended the command: 130 after Ctrl-C, 143 after SIGTERM (`attitude_node` '
                'ends with 0); 141, without a message, if the reader of the output is gone, as in '
                '`attitude_replay ... | head`'),
]


def main():
    """Print the page."""
    print(PAGE.format(
        subscribed=topics(SUBSCRIBED), published=topics(PUBLISHED), on_request=topics(ON_REQUEST),
        parameters=table(('parameter', 'unit', 'default', 'values', 'meaning'), [
            (f'`{parameter.name}`', parameter.unit, default(parameter), values(parameter),
             parameter.description) for parameter in scene.PARAMETERS.values()]),
        replay=options(cli.replay_parser()), tradeoff=options(cli.tradeoff_parser()),
        exits=table(('status', 'meaning'), EXITS)), end='')


def topics(listed):
    """Return topics as a table."""
    return table(('topic', 'type', 'quality of service', 'meaning'), [
        (f'`{topic.name}`', topic.kind.replace('/msg/', '/'), topic.qos, topic.meaning)
        for topic in listed])


def options(parser):
    """Return the arguments of a command as a table."""
    return table(('argument', 'meaning'), [
        (argument(action), action.help) for action in parser._actions if action.dest != 'help'])


def argument(action):
    """Return the names of an argument, and what it takes."""
    names = ', '.join(f'`{name}`' for name in action.option_strings)
    if action.nargs == 0:
        return names
    takes = action.metavar or '|'.join(action.choices or ()) or action.dest.upper()
    more = ' ...' if action.nargs == argparse.ONE_OR_MORE else ''
    return f'{names} `{takes}`{more}'.strip()


def default(parameter):
    """Return the default of a parameter as YAML has it."""
    if parameter.default is None:
        return 'none'
    if isinstance(parameter.default, bool):
        return str(parameter.default).lower()
    return f'{parameter.default:g}' if isinstance(parameter.default, float) \
        else str(parameter.default) or 'empty'


def values(parameter):
    """Return what values a parameter takes."""
    if parameter.choices:
        return ', '.join(parameter.choices)
    if not parameter.interval:
        return {bool: 'true, false', str: 'text'}[parameter.value_type]
    return scene.limits(*parameter.interval)


def table(head, rows):
    """Return a table in Markdown."""
    lines = [head, ['---'] * len(head), *rows]
    return '\n'.join('| ' + ' | '.join(cell.replace('|', '\\|') for cell in line) + ' |'
                     for line in lines)


if __name__ == '__main__':
    main()
