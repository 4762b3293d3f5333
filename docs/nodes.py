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

Parameters and options are those that the code declares; a test compares the topics with those of a
running node.
"""

import argparse
from typing import NamedTuple

from rigid_body_ros import scene
from rigid_body_ros.commands.compare import compare_parser
from rigid_body_ros.commands.ensemble import ensemble_parser
from rigid_body_ros.commands.identify import identify_parser
from rigid_body_ros.commands.regress import regress_parser
from rigid_body_ros.commands.replay import replay_parser
from rigid_body_ros.commands.tradeoff import tradeoff_parser
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
# Node, commands, parameters

## attitude_node

```
ros2 run rigid_body_ros attitude_node --ros-args --params-file SCENE
```

Without the `ros2` command, as after `pip install '.[ros]'`, type
`attitude_node --ros-args --params-file SCENE`.

Names without a leading slash are relative: they take the namespace of the node, and can be
remapped (`-r torque:=/wrench`). Quality of service can be overridden
(`qos_overrides./torque.subscription.depth`).

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

### What happens to a torque

The state at the stamp of a torque depends only on the torques before it. States published between
stamps are predictions, and nothing later is computed from them. Torques may therefore arrive in
any order, and late by less than `history`: the committed states have the same bits, and a replay
of `~/accepted_torque` reproduces them. If two torques have the same stamp, the one that arrives
later replaces the other. A message is rejected as a whole if its values are not finite, its frame
is unknown, or its stamp is too old or impossible. Rejected messages are counted, and logged at
most every 5 s.

`/diagnostics` counts every torque sent exactly once: as applied, waiting, rejected by cause (see
[below](#why-is-a-torque-rejected)), or lost, in transit or because the queue of the subscription
was full. Losses show as gaps in the numbers of a publisher's messages, so the node
cannot know of those before the first message that it receives from a publisher. Torques that still
wait when their epoch ends are rejected (`epoch ended`).

If torques arrive faster than the node can apply them, they wait in a queue. Meanwhile the node
publishes the present state under the torques that it has applied, at a lower rate. The torques
that wait change the committed states afterwards, as late ones always do. In `realtime`,
while more than 5000 torques wait and the first of them has waited for more than 2 s, new torques
are rejected (`overload`), so that the motion catches up with real time.

A torque without a stamp, or with `time_source:=arrival`, acts from its arrival on. Each such
torque gets its own stamp. Between two ticks of simulated time these stamps advance at the rate of
the previous ticks.

With `use_sim_time` the node waits for `/clock`. For a bag that is played without `--clock`, use
`time_source:=arrival`.

The torques of `actuator.topics` are commands: they act after `actuator.delay`, within
`actuator.limit`, and with a lag; see [conventions](conventions.md#actuators). `~/accepted_torque`
has them as they were sent, with their stamps, and a replay applies the same actuator.

### What if a controller falls silent?

A source holds its last torque. If that torque is not zero and its source has sent none for longer
than `stale_after` (1 s), diagnostics warn, and the log says so once, with the torque that still
acts. The next torque ends the warning. Raise `stale_after` for a source that sends at a slow rate
on purpose, or set it to 0. To end the torque itself, set `torque_timeout`. In `lockstep` the age
of a torque is in the time of the loop.

### What if the node is killed?

Every epoch of every process begins with a marker in the logs of torques. A replay of a recording
with several lives of a node computes each of them from its own start state, as
[Recordings](recordings.md#a-recording-with-several-runs-of-a-node) explains.

Without more, a node that is started again begins from the initial state of the scene; the first
line of its log says from which state, and when. With `checkpoint:=FILE` it goes on instead: once a
second and at the end, the node writes the last state that it has published on `~/committed`, which
no later torque can change, to this file. The file is replaced as a whole. A node that finds it at
the start begins an epoch with exactly this state at its stamp, and warns how long it was away; the
motion in between is that without torques. In `lockstep` the loop goes on at that stamp.

A file that is damaged, that was written under another scene or by another node, or whose stamp is
ahead of the clock, is an error that names the file; the node ends, and leaves the file as it is.
Remove the file to begin from the initial state. Nodes of a fleet need a file each. If another
program changes the file while the node runs, the node no longer writes it, and diagnostics report
an error. `~/reset` begins with the initial state, as without a checkpoint.

After a process was killed, the shared memory of Fast DDS may delay messages to other processes by
seconds. `FASTDDS_BUILTIN_TRANSPORTS=UDPv4` in the environment of all of them avoids it.

### When does the clock jump?

`on_time_jump` decides what happens then: `reset` begins an epoch with the initial state, `rebase`
with the present state, and `ignore` continues, so that after a jump ahead the node first computes
the motion of all the time between.

- Simulated time jumps if it is set back at all, or if it is ahead by more than `history`, and by
  more than ten times the time for which it stood (at most 3 s) or the node could not read it. The
  second condition is for programs that could not run for a moment.
- The wall clock jumps if it is set back, or ahead of the steady clock, by more than `history`. A
  pause of the node is not a jump.
- In `lockstep` there is none, because the stamps of the torques are the time.

### Forces and frames

A thruster publishes its force in its own frame: it acts at the origin of that frame. If fixed
joints of `robot_description` connect the frame to the body, the node rotates force and torque into
body axes, and adds the torque of the force about the centre of mass, which is at the `xyz` of the
`<inertial>` of the body. A scene with two thrusters, one of them turned:

```yaml
/**:
  ros__parameters:
    link: base_link
    robot_description: |
      <robot name="drone">
        <link name="base_link">
          <inertial>
            <origin xyz="0 0 0.03"/>
            <mass value="1.2"/>
            <inertia ixx="0.010" iyy="0.012" izz="0.020" ixy="0" ixz="0" iyz="0"/>
          </inertial>
        </link>
        <link name="left_thruster"/>
        <joint name="left_mount" type="fixed">
          <parent link="base_link"/><child link="left_thruster"/>
          <origin xyz="0 0.2 0.03"/>
        </joint>
        <link name="tail_thruster"/>
        <joint name="tail_mount" type="fixed">
          <parent link="base_link"/><child link="tail_thruster"/>
          <origin xyz="-0.3 0 0.03" rpy="0 0 1.5707963267948966"/>
        </joint>
      </robot>
```

A force of 3 N along x in the frame `left_thruster` is a torque of -0.6 N m about z, and in
`tail_thruster`, whose x axis is the y axis of the body, of -0.9 N m. `~/accepted_torque` has these
torques, in body axes and without a force, so that it is the log of the run. A replay of the
original messages computes the same bits.

A propeller publishes thrust and drag in the frame of its link, the child of a `continuous` joint.
Forces at the origin of a continuous joint, along its axis, are accepted like those of fixed
joints. A message with a force or torque across the axis is rejected (`unknown frame`), because the
angle of the propeller is unknown. So is one in a frame that any other joint moves relative to the
body. The log names the joint. [Conventions](conventions.md#force) has the formula and all cases.

### Which torques add up?

Each topic of `torque_topics`, `wheel_torque` and `wheel_command` is a source of its own. A source
holds its last torque until the next one, and times out on its own. The torques of different
sources add up, in the order of `torque_topics`. The order in which they arrive changes no bit of
the committed states. Only torques of the same topic replace each other if their stamps are equal.
So two publishers on one topic overwrite each other, and diagnostics name both: give each publisher
a topic of its own. `late` refers to the newest torque of all topics.

To replay such a run, record all logs of what the node accepts, and pass those of torques in the
order of `torque_topics`; those of rotors, wheels and inertia are found beside them:

```
attitude_replay RECORDING --scene DUMP --topic /attitude_node/accepted_torque \\
    --topic /attitude_node/accepted_torque_1
```

`/diagnostics` has a status for each source: `torques` for the first topic, `torques_1`,
`torques_2` and so on for the others, `wheel torques` and `wheel commands`.

### Wheels with names

A scene with [`wheel_names`](satellite.md#wheels-with-names) has the topics `wheel_command` and
`wheel_states`, which have the form of a `joint_state_broadcaster` and of an effort controller. A
command is like a torque: it may come late, wait for the clock, and be replaced by one with the
same stamp, wheel by wheel. A new epoch on `initial_state` and a jump of the clock keep the speeds
of the wheels, as a checkpoint does; `~/reset` returns to their initial speeds. In lockstep a
command gets a response, so a controller that only commands wheels closes a loop; of several
messages with one stamp the first is used, so one message has to list all wheels that it commands.

The status `wheel commands` on `/diagnostics` counts two things more, by wheel: `clipped to
max_torque`, and `zero at max_speed`, a warning: commands that would have sped up a wheel which was
too fast. These are counted when their states are committed, because a late torque may change
whether the wheel is too fast.

### An IMU with errors

By default `imu/data` is exact. The parameters `imu.*` give it errors; all other topics stay exact:

* `imu.gyro_noise_density` N: white noise of the angular velocity. At 100 Hz these are independent
  numbers with the standard deviation N * sqrt(100 Hz) on each axis.
* `imu.gyro_random_walk` K: a bias that wanders. After T seconds it has moved by K * sqrt(T)
  (standard deviation).
* `imu.gyro_bias`: a constant bias.
* `imu.attitude_noise`: a small rotation, another one every millisecond. Each component of its
  rotation vector in body axes has this standard deviation.
* `imu.delay`: the motion from this long before the stamp, as of a driver that stamps on arrival;
  in the first moments, the start state. [attitude_identify](identify.md) finds it, as a negative
  `clock_offset`.

N and K are the numbers of data sheets. The Allan deviation of the angular velocity is N / sqrt(T)
for short and K * sqrt(T / 3) for long averaging times T.

**The noise is a function of `imu.seed` and of the stamp, and of nothing else.** A live node, a
lockstep loop and `attitude_replay --also imu` write the same bits at the same stamps, on every
machine, in whatever order torques arrive. Two rates of publication have the same noise at common
stamps, and an epoch that begins again at the same stamps repeats it. To achieve this

* the gyro takes 1000 samples a second, and an output is the mean of the last ten: its noise is
  white up to 100 Hz, whatever `publish_rate`, `step` or `--rate` is. At higher rates neighbours
  share samples, and the density stays the same. At lower rates the outputs are every second, or
  every tenth, of a sensor at 100 Hz: their standard deviation stays the same, so their density is
  higher, as with every sensor that is read more slowly than its bandwidth;
* the bias is zero at the stamp 0, and again every 2^25 ms (9.3 hours). In between it is a random
  walk, conditional on that. With stamps of simulated time it begins at `imu.gyro_bias`. With those
  of a wall clock it is on its way, as in a sensor that was switched on hours ago: 75 K in rad/s
  (root mean square).

The covariances of `imu/data` are those of the noise: on the diagonals `imu.attitude_noise`^2 and
N^2 * 100 Hz. The bias is not in them, because it is no noise: estimators have a state for it.
Without noise they are zero, which means unknown.

`odometry` is exact. For estimators, which need covariances, `odometry.attitude_variance` and
`odometry.rate_variance` put a variance on the diagonals: of the attitude, in the pose, and of the
angular velocity, in the twist (body axes). Position and linear velocity, which are always zero,
then have the variance 1e6 (m^2, m^2/s^2), so that no estimator trusts them. `~/committed` has no
covariances.

### Inertia from robot_state_publisher

If the parameters have neither an `inertia` nor a `robot_description`, the node waits for a URDF on
the topic `robot_description` (std_msgs/String, transient local), which robot_state_publisher
publishes. The log says so at once, and every 10 s what is missing. The node reports any other
mistake in the parameters before it waits. The first URDF defines the motion: the node then ends
the subscription, and reports the text as its parameter `robot_description`, so that a parameter
dump is a complete scene, for the commands, too. An `inertia` or `robot_description` among the
parameters comes first, and the node ignores the topic.

### Several bodies

Start a node for each body, each in a namespace of its own (`-r __ns:=/one`) and with a
`frame_prefix` of its own (`-p frame_prefix:=one/`). Their topics, frames and diagnostics then
differ, and `/tf` contains all of them in one space frame. The names of the statuses on
`/diagnostics` are `/one/attitude_node: torques` and `/one/attitude_node: motion`, and the
`hardware_id` is `/one/attitude_node`: the same form as that of diagnostic_updater with
`diagnostic_updater.use_fqn`. An analyzer of diagnostic_aggregator selects the statuses of a body
with `startswith: [/one/]`.

### Why is a torque rejected?

The log names the cause, what was expected and what was found. `/diagnostics` counts each cause
under the key `rejected: CAUSE`.

{causes}

### In a process of your own

`from rigid_body_ros.node import AttitudeNode` imports an ordinary node, whose arguments are those
of `rclpy.node.Node`: `node_name`, `namespace`, `parameter_overrides`, `context` and so on. A name,
a parameter or a scene that is not valid raises an `InputError` of one line. Any executor may spin
it, alone or beside other nodes. A callback of another node that blocks delays what is published,
but changes no bit of it. Before `destroy_node` destroys the node, it publishes the states that are
pending, for which it takes at most 0.8 s. ROS must not be shut down yet: rclpy's own signal
handlers do that, so replace them as `examples/two_bodies.py` does.

- `EventsExecutor` is what the command uses, because it takes the least time per torque. In the
  wheels of PyPI its `spin()` hangs; `spin_once(timeout_sec=0.1)` in a loop works.
- `SingleThreadedExecutor` and `rclpy.spin` take twice the processor time per torque.
- `MultiThreadedExecutor` is no faster, because the callbacks of the node exclude each other.

### Lockstep

In `realtime` a timer publishes the state at `publish_rate`. In `lockstep` the node responds to
each torque stamped t immediately, with the state at t + `step`. A controller that responds to
each state with a torque at the stamp of that state closes a loop. The loop is a single chain with
one torque for each state.

- If several topics have publishers, `wheel_torque` and `wheel_command` included, the response to a
  stamp waits until each of these topics has a torque with exactly this stamp. So the order in
  which the torques arrive does not change the response, and the loop has the same bits every time.
  A topic without a publisher is not waited for. Each publisher must therefore respond to every
  state; diagnostics name a topic that does not. Start all publishers before the first torque,
  because the loop waits for a publisher only from when it is connected.
- A message on `inertia` gets no response, and no response waits for it. For the same bits every
  time, publish it before the torque of its stamp, and wait until it is on `~/accepted_inertia`.
- While no node publishes torques, the latest state is published again at 10 Hz. A controller that
  starts or restarts receives it once, half a second after it connects.
- A controller may be slow. The state is published again only after 4 s without a torque, then
  after 8 s, and so on. A controller that takes longer than that receives the state twice, and the
  torque that it sends for the second copy has no effect. The time is that long because Fast DDS
  may deliver a message only after its next heartbeat, whose period is 3 s.
- If the same controller repeats a torque more than 0.1 s after the response, the node responds
  again, because the response may have been lost. If it sends a different torque with the same
  stamp, that replaces the first and also gets a response.
- If a second controller sends a different torque for the same state, that torque is rejected
  (`duplicate, differs (same stamp)`), and diagnostics name both controllers.
- `~/reset` restarts the loop with the initial state. A torque that responds to a state published
  before the reset is rejected (`before the reset`).

Diagnostics warn if no torques arrive, and if a response takes long to compute.

## attitude_lifecycle_node

```
ros2 run rigid_body_ros attitude_lifecycle_node --ros-args --params-file SCENE
```

The same node, with the same name, topics, services and parameters, but managed: a lifecycle
manager or `ros2 lifecycle set /attitude_node configure` controls it. In a process of your own, use
`from rigid_body_ros.node.lifecycle import AttitudeLifecycleNode`.

- *configure* reads the scene and creates the publishers. If the scene is not valid, the
  log has the reason, and the node stays unconfigured.
- *activate* subscribes, publishes and offers the services. The first activation begins the motion.
- *deactivate* unsubscribes and stops publishing, but keeps the motion: at the next *activate* the
  body has turned on under the last torques. Torques that are sent in between are not received.
- *cleanup* publishes the end of the log on `~/committed`, and forgets the motion. Parameters have
  the values that they had before *configure*, and all can be changed until the next, except
  `mode`. Until they are set, those that were not given have no value.
- *shutdown*, and a signal, publish the end of the log, too.

For launch files without a manager, `autostart:=true` configures and activates the node when it
starts; then a scene that is not valid ends it with exit status 2. An executor of your own must not
be a `MultiThreadedExecutor`, because that of rclpy fails if a callback destroys a subscription.

## Parameters

The node and every command (`--scene`) read the same file. Integers are
accepted for floating-point parameters. In a running node all parameters but `publish_rate` are
read-only. `ros2 param describe` prints the descriptions of this table, and `ros2 param dump`
writes a file that is a scene.

The file may be one that several nodes share. Parameters of other nodes, under `/**:` or under
`/attitude_node:`, are ignored. The node logs their names once, and a command prints them in a
line that begins with `note:`. The node does not declare them. A key that resembles one of this
table is an error that names the key it resembles: it differs in capitals, in one letter, in the
order of two letters, or in two missing or additional letters (`torque_timout`, `Inertia.ixx`).
Keys of less than six letters, such as `mode`, resemble another only if they differ in capitals. A
group of this table has no members but those listed, so `inertia.mass` is an error, too. The same
holds for `qos_overrides`: those of other topics are logged once and ignored, but
`qos_overrides./torque.subscription.depht` is an error.

A command rejects a file that has a parameter twice for the same node, such as `inertia.ixx` and
`ixx` in the group `inertia`; with `--params-file`, ROS takes one of the values without a message.
Anchors, aliases and merge keys (`<<`) are rejected, because ROS parameter files do not have them.
If a file has the parameters of a single node of another name, and none for `/**:`, a command uses
these and warns. Names of frames and of the checkpoint must not contain control characters.

{parameters}

Either the three moments or a `robot_description` are required, but a node can
[wait for the latter](#inertia-from-robot_state_publisher). The inertia is checked as one
tensor: positive definite, no principal moment greater than the sum of the other two. The damping
is checked as one tensor, too: no negative eigenvalue. `torque_topics` names at least one topic,
each of them once. The solvers `exact` and `strang` take neither rotors nor damping.

## attitude_replay

```
attitude_replay INPUT [INPUT ...] --scene FILE [-o OUTPUT | --verify MOTION] [--plot PNG]
```

{replay}

[Recordings](recordings.md) describes inputs and outputs in detail.

## attitude_compare

```
attitude_compare RECORDING --scene FILE [--measured TOPIC]... [--align NAMES] [-o RESIDUALS]
```

{compare}

[Is my model right?](compare.md) explains the results.

## attitude_tradeoff

```
attitude_tradeoff --scene FILE
```

{tradeoff}

[What does an error cost?](tradeoff.md) explains the results and how they are measured.

## attitude_identify

```
attitude_identify RECORDING [RECORDING ...] --scene FILE [--measured TOPIC] [-o FITTED]
```

{identify}

[Which inertia does my vehicle have?](identify.md) is a tutorial, and describes the results.

## attitude_ensemble

```
attitude_ensemble --scene FILE --vary FILE --runs N [--recording IN] [--controller MODULE:FUNCTION]
    [--require EXPRESSION] -o FOLDER
```

{ensemble}

[How sure is my motion?](ensemble.md) describes the file of dispersions and the results.

## attitude_regress

```
attitude_regress REFERENCE --scene FILE [--update] -- COMMAND [ARGUMENT ...]
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
    """Print the page."""
    print(PAGE.format(
        subscribed=topics(SUBSCRIBED),
        subscribed_if_enabled=topics(SUBSCRIBED_IF_ENABLED),
        published=topics(PUBLISHED), optional=topics(OPTIONAL),
        causes=table(('cause', 'meaning'),
                     [(f'`{cause}`', meaning) for cause, meaning in CAUSES.items()]),
        parameters=table(('parameter', 'unit', 'default', 'values', 'meaning'), [
            (f'`{parameter.name}`', parameter.unit, default(parameter), values(parameter),
             parameter.description) for parameter in parameters()]),
        replay=options(replay_parser()),
        compare=options(compare_parser()),
        tradeoff=options(tradeoff_parser()),
        identify=options(identify_parser()),
        ensemble=options(ensemble_parser()),
        regress=options(regress_parser()),
        exits=table(('status', 'meaning'), EXITS)), end='')


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
