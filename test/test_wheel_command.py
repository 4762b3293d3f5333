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

"""attitude_node with named wheels: the topics wheel_command and wheel_states."""

from dataclasses import replace
import json
import sys

from conftest import at_night, ROOT, SECOND
import four_wheels
from geometry_msgs.msg import WrenchStamped
from live import commit, decoded, finished, late, options, PATIENT, Session
from live_session import RELIABLE
import numpy as np
from pyarrow import parquet
import pytest
from rigid_body_ros import EffortLog, messages, Propagator, read, recording, regress, scene, State
from rigid_body_ros.commands import main
from rigid_body_ros.replay import replay
from sensor_msgs.msg import JointState

pytestmark = pytest.mark.ros
SCENE = ROOT / 'examples' / 'four_wheels.yaml'
WHEELS = ('rw_x', 'rw_y', 'rw_z', 'rw_skewed')
TORQUES = '/attitude_node/accepted_torque', '/attitude_node/accepted_torque_1'
ACCEPTED = '/attitude_node/accepted_wheel_command'
COMMANDS, STATES = messages.joint_commands(WHEELS), messages.joint_states(WHEELS)
SOURCES = (*RELIABLE, *options(
    'torque_topics:=[torque,disturbance] '
    'qos_overrides./disturbance.subscription.reliability:=reliable '
    'qos_overrides./wheel_command.subscription.reliability:=reliable'))
#: Parameters of thrusters, in addition to the wheels.
ACTUATOR = options('actuator.topics:=[torque] actuator.delay:=0.011 '
                   'actuator.time_constant:=0.03 actuator.limit.x:=0.002')
LOCKSTEP = options('mode:=lockstep')
STEP_NS = SECOND // 50
STAMPS = SECOND + STEP_NS * np.arange(300)
NAN = np.nan


class Wheels(Session):
    """A session that commands wheels, and records their states and all logs."""

    def _connect(self):
        super()._connect()
        self.record(ACCEPTED, COMMANDS)
        self.record(TORQUES[1], messages.WRENCH)
        self.record('wheel_states', STATES, 10_000)
        self._motors = self.node.create_publisher(JointState, 'wheel_command', 10_000)
        self.wait_until(self._motors.get_subscription_count, 'the node to subscribe')

    def turn(self, stamp_ns, efforts, frame_id=''):
        """Publish efforts, N m, in the order of the wheels; a wheel with NaN is not listed."""
        self._motors.publish(COMMANDS.encode(stamp_ns, frame_id, efforts))

    def answer(self, stamp_ns, efforts):
        """Publish efforts, and return the speeds and efforts of the response, a step later."""
        self.turn(stamp_ns, efforts)
        self.wait_until(lambda: stamp_ns + STEP_NS in self.states(), 'a response')
        return self.states()[stamp_ns + STEP_NS]

    def counts(self, received):
        """Return the counts of commands once this many have been received."""
        self.wait_until(lambda: self.diagnosis('wheel commands')[0].get('received') == received,
                        'all commands')
        return self.diagnosis('wheel commands')[0]

    def commands(self):
        """Return the accepted commands, decoded, of all epochs."""
        return decoded(self, ACCEPTED)

    def states(self):
        """Return the speeds and the efforts that were published last for each stamp."""
        found = [messages.decoded_joints(data) for data in self.received['wheel_states']]
        return {one.stamp_ns: (one.velocity, one.effort) for one in found}


def checked(tmp_path, live, torques=TORQUES[:1]):
    """End a session, check that all epochs replay bit for bit, and return the run."""
    run = finished(tmp_path, live, recording.Topics(torques, wheel_command=ACCEPTED))
    assert not run.verified.pending
    # The parameters belong to the last epoch as well.
    np.testing.assert_array_equal([wheel.initial_speed for wheel in run.scene.named_wheels],
                                  run.problem.start.wheel_speeds)
    assert not run.scene.start.rotor_momentum.any()
    return run


@pytest.mark.parametrize('friction', [0.0, *at_night(2e-5)])
def test_live_is_replay_bit_for_bit_in_any_order_of_arrival(tmp_path, domain, friction):
    random = np.random.default_rng(38)
    with Wheels(SCENE, domain, *SOURCES, *PATIENT, *ACTUATOR, *options(
            f'torque_timeout:=0.05 rw_skewed.friction:={friction}')) as live:
        disturbance = live.node.create_publisher(WrenchStamped, 'disturbance', 1000)
        live.wait_until(disturbance.get_subscription_count, 'the node to subscribe')
        plan = []
        for due_ns, stamp_ns in late(random, live.now_ns(), 150, 150):
            efforts = random.normal(size=4) * 0.006
            efforts[random.random(4) < 0.4] = NAN
            efforts[random.integers(4)] = 0.003
            plan.append((due_ns, stamp_ns, efforts))
        for k, (due_ns, stamp_ns, efforts) in enumerate(sorted(plan, key=lambda row: row[0])):
            live.spin((due_ns - live.now_ns()) * 1e-9)
            live.turn(stamp_ns, efforts, ('', 'base_link', 'elsewhere')[k % 3])
            if k % 3 == 0:
                live.publish(stamp_ns, 'base_link', 0.002 * random.normal(size=3))
                disturbance.publish(messages.wrench(
                    stamp_ns - 1, 'world', 0.001 * random.normal(size=3)))
        live.wait_until(lambda: len(live.commands()) == 150, 'all commands')
        live.wait_until(lambda: [len(decoded(live, topic)) for topic in TORQUES] == [50, 50],
                        'all torques')
        arrived_ns = live.now_ns()
        commit(live, 1 + 150 + 50)
        counts = live.counts(150)
        run = checked(tmp_path, live, TORQUES)
    stamps = [message.stamp_ns for message in live.commands()]
    assert sorted(stamps) == sorted(stamp for _, stamp, _ in plan)
    assert np.any(np.diff(stamps) < 0)
    assert {*stamps} < {*run.verified.stamps_ns.tolist()}
    assert counts['applied'] == 150
    given = np.array([efforts for *_, efforts in plan])
    assert counts['clipped to max_torque'] == np.sum(np.abs(given) > 0.004)
    # States that were published after all commands had arrived agree with the motion.
    found = {stamp: values for stamp, values in live.states().items() if stamp > arrived_ns}
    assert found
    motion = run.problem.propagate(at=sorted(found))
    np.testing.assert_array_equal(motion.wheel_speeds, [found[t][0] for t in sorted(found)])
    np.testing.assert_array_equal(motion.wheel_efforts, [found[t][1] for t in sorted(found)])


@pytest.mark.parametrize('friction', [2e-5, *at_night(0.0)])
def test_a_loop_of_wheels_alone_is_answered_in_lockstep_and_stops_at_max_speed(tmp_path, domain,
                                                                               friction):
    run = scene.load(SCENE)
    with Wheels(SCENE, domain, *LOCKSTEP, *options(
            'history:=0.1 max_future:=0.05 rw_x.max_speed:=2.0 '
            f'rw_skewed.friction:={friction}')) as live:
        # Only the controller of the wheels sends commands.
        live.disconnect()
        first, *others = run.named_wheels
        others[-1] = replace(others[-1], friction=friction)
        judge = Propagator(run.body, replace(run.start, time_ns=SECOND), history=10.0,
                           wheels=[replace(first, max_speed=2.0), *others])
        for number in range(40):
            stamp_ns = SECOND + number * STEP_NS
            efforts = [0.003, 0.001 * np.sin(0.3 * number), NAN, -0.01 if number % 2 else NAN]
            speeds, acting = live.answer(stamp_ns, efforts)
            judge.apply_efforts(stamp_ns, {name: effort for name, effort in zip(WHEELS, efforts)
                                           if effort == effort})
            state = judge.at(stamp_ns + STEP_NS)
            np.testing.assert_array_equal(speeds, state.wheel_speeds)
            np.testing.assert_array_equal(acting, state.wheel_efforts)
        assert abs(speeds[0] - 2.0) < 1e-12
        counts = live.counts(40)
        # Counted only for states that late commands can no longer change.
        assert 0 < counts['limited at max_speed'] < 40
        assert counts['clipped to max_torque'] == 20
        # A repeated command counts as the same, even though NaN does not equal NaN.
        live.turn(stamp_ns, efforts)
        encoded, stamp_ns = messages.encoded_joints, stamp_ns + STEP_NS // 2
        for data in (encoded(stamp_ns, '', ['rw_x', 'rw_w'], effort=[0.001, 0.001]),
                     encoded(stamp_ns, '', ['rw_x', 'rw_x'], effort=[0.001, 0.001]),
                     encoded(stamp_ns, '', ['rw_x', 'rw_y'], velocity=[1.0, 2.0]),
                     encoded(stamp_ns, '', ['rw_x', 'rw_y'], effort=[0.001, NAN]),
                     encoded(stamp_ns, '', []), messages.epoch_marker(State(stamp_ns), COMMANDS),
                     COMMANDS.encode(stamp_ns, '', [1e300, 0.0, 0.0, 0.0])):
            live._motors.publish(data)
        counts = live.counts(48)
        assert counts['applied'] == 41
        assert {name.removeprefix('rejected: '): count for name, count in counts.items()
                if name.startswith('rejected') and count} == {
                    'malformed': 5, 'too large': 1, 'unknown frame': 1}
        assert ('command on wheel_command rejected (1 so far): malformed: name: expected some of '
                "'rw_x', 'rw_y', 'rw_z', 'rw_skewed', found 'rw_w'") in live.words()
        assert len(checked(tmp_path, live).verified.stamps_ns) == 40


def test_epochs_and_checkpoints_keep_the_speeds_of_the_wheels_and_a_reset_does_not(tmp_path,
                                                                                   domain):
    options = (*LOCKSTEP, '-p', f'checkpoint:={tmp_path / "checkpoint.json"}')
    with Wheels(SCENE, domain, *options) as live:
        def ask(number):
            stamp_ns = SECOND + number * STEP_NS
            live.publish(stamp_ns, '', [0.0, 0.001, 0.0])
            return live.answer(stamp_ns, [0.002, NAN, -0.003, 0.001])
        for number in range(20):
            speeds, _ = ask(number)
        begin_ns = SECOND + 20 * STEP_NS + 5
        live.set_state(State(begin_ns, (0.0, 0.6, 0.0, 0.8), (0.1, 0.2, 0.3)))
        live.wait_until(lambda: begin_ns in live.states(), 'the new epoch')
        kept, acting = live.states()[begin_ns]
        np.testing.assert_allclose(kept, speeds, rtol=1e-6)
        assert acting.tolist() == [0.002, 0.0, -0.003, 0.001]
        for number in range(21, 25):
            ask(number)
        live.reset()
        for number in range(31, 35):
            ask(number)
        # The parameters belong to the last epoch, whose initial speeds differ from the first ones.
        live.set_state(State(SECOND + 40 * STEP_NS + 5, (0.0, 0.6, 0.0, 0.8)))
        before, _ = ask(41)
        ask(42)
        assert checked(tmp_path, live).verified.epochs == 4
    starts = [messages.epoch_start(one.stamp_ns, one.frame_id) for one in (
        COMMANDS.decode(data) for data in live.received[ACCEPTED])
        if messages.is_epoch_marker(one.frame_id)]
    assert starts[0].wheel_speeds.tolist() == starts[2].wheel_speeds.tolist() \
        == [0.0, 0.0, 0.0, 100.0]
    np.testing.assert_allclose(starts[1].wheel_speeds, kept, rtol=1e-13, atol=1e-13)
    with Wheels(SCENE, domain, *options) as live:
        live.disconnect()
        stamp_ns = SECOND + 42 * STEP_NS
        live.wait_until(lambda: stamp_ns in live.states(), 'the state of the checkpoint')
        np.testing.assert_array_equal(live.states()[stamp_ns][0], before)
        live.answer(stamp_ns + STEP_NS, [0.004, NAN, NAN, NAN])
        checked(tmp_path, live)


@pytest.mark.nightly
def test_a_jump_of_the_clock_keeps_speeds_and_efforts(tmp_path, domain):
    start_ns, later_ns = 100 * SECOND, 500 * SECOND
    with Wheels(SCENE, domain, *SOURCES, *options(
            'use_sim_time:=true history:=2.0 on_time_jump:=rebase '
            f'start_time:={start_ns}')) as live:
        live.start_clock(start_ns)
        live.turn(start_ns, [0.003, NAN, NAN, -0.002])
        live.hold_clock(start_ns, live.commands, 'the command')
        live.run_clock(start_ns, start_ns + 2 * SECOND)
        # The command comes into force after the jump, together with those from before.
        live.hold_clock(later_ns, lambda: len(live.commands()) == 2, 'a new epoch')
        live.turn(later_ns + 1, [NAN, 0.001, NAN, NAN])
        live.run_clock(later_ns, later_ns + 2 * SECOND)
        live.wait_until(lambda: len(live.commands()) == 3, 'the commands of both epochs')
        run = checked(tmp_path, live)
    assert run.verified.epochs == 2
    found = live.states()
    before, after = (found[max(t for t in found if t < 200 * SECOND)],
                     found[min(t for t in found if t >= later_ns)])
    # 0.003 N m speeds up a wheel of 1e-4 kg m^2 by 0.3 rad/s in 10 ms.
    np.testing.assert_allclose(before[0], after[0], atol=2.0)
    assert before[0][0] > 50.0
    assert after[1].tolist() == [0.003, 0.0, 0.0, -0.002]
    assert found[max(found)][1].tolist() == [0.003, 0.001, 0.0, -0.002]
    np.testing.assert_array_equal(
        run.problem.propagate(at=[max(found)]).wheel_speeds[0], found[max(found)][0])


@pytest.fixture
def flight(tmp_path):
    """Return a recording with commands of wheels, in any order, and with the measured motion."""
    path, run, random = tmp_path / 'flight.mcap', scene.load(SCENE), np.random.default_rng(5)
    efforts = 0.003 * random.normal(size=(300, 4))
    efforts[random.random((300, 4)) < 0.3] = NAN
    efforts[:, 2] = 0.001
    motion = run.problem(replace(run.start, time_ns=SECOND)).replaced(
        efforts=EffortLog(STAMPS, efforts)).propagate(at=STAMPS)
    with recording.Writer(path) as writer:
        writer.add_topic('/wheel_command', COMMANDS)
        writer.add_topic('/measured', messages.ODOMETRY)
        for row in random.permutation(300):
            stamp_ns = int(STAMPS[row])
            state = State(stamp_ns, motion.attitude[row], motion.angular_velocity[row])
            writer.write('/wheel_command', stamp_ns, COMMANDS.encode(stamp_ns, '', efforts[row]))
            writer.write('/measured', stamp_ns, messages.odometry(state, 'world', 'base_link'))
    return path


def test_what_a_recording_has_is_replayed_and_its_wheels_written(tmp_path, flight):
    out, run = tmp_path / 'motion.mcap', scene.load(SCENE)
    result = replay(flight, run, out)
    assert result.wheel_source == 'efforts on /wheel_command'
    motion = read(flight, run).propagate(at=STAMPS)
    written = recording.read(out, '/wheel_states', STATES)
    np.testing.assert_array_equal(written.stamps_ns, STAMPS)
    np.testing.assert_array_equal(written.values[:, :4], motion.wheel_speeds)
    np.testing.assert_array_equal(written.values[:, 5:], motion.wheel_efforts)
    attitude = recording.read(out, '/attitude', messages.QUATERNION)
    np.testing.assert_array_equal(attitude.values, motion.attitude)
    drift = float(result.check.finding.rpartition(' ')[2])
    assert drift < 1e-14


@pytest.fixture
def limited(tmp_path):
    """Return a recording whose commands drive wheels to their largest speed, and its scene."""
    path, scene_path = tmp_path / 'commands.mcap', tmp_path / 'limited.yaml'
    scene_path.write_text(SCENE.read_text().replace('600.0', '60.0'))
    with recording.Writer(path) as writer:
        writer.add_topic('/wheel_command', COMMANDS)
        for second, efforts in ((1, [0.003, 0.003, NAN, NAN]), (3, [NAN, NAN, -0.02, NAN]),
                                (4, [NAN, 0.002, 0.01, NAN]), (9, [NAN, NAN, -0.01, NAN])):
            writer.write('/wheel_command', second * SECOND,
                         COMMANDS.encode(second * SECOND, '', efforts))
    return path, scene.load(scene_path)


def test_a_motion_in_batches_has_the_wheels_of_one_in_a_piece(limited, monkeypatch):
    whole = replay(*limited, rate=20.0, until=7.0)
    monkeypatch.setattr('rigid_body_ros.replay.batches._LARGEST', 7)
    parts = replay(*limited, rate=20.0, until=7.0)
    for name in ('times_ns', 'attitude', 'wheel_speeds', 'wheel_efforts', 'rotor_momentum'):
        np.testing.assert_array_equal(getattr(parts.trajectory, name),
                                      getattr(whole.trajectory, name))
    assert parts.trajectory.at_limit == whole.trajectory.at_limit
    assert parts.warnings == whole.warnings
    # No batch keeps the events of all earlier ones.
    counts, (every,) = ([sum(map(len, part.events)) for part in result.trajectory._parts]
                        for result in (parts, whole))
    assert max(counts) < every


def test_a_replay_reports_what_exceeds_the_limits_of_wheels(limited):
    result = replay(*limited, until=7.0)
    # The body turns, so it drives three wheels a little further; rw_skewed starts above the limit.
    speeds = abs(result.trajectory.wheel_speeds).max(axis=0)
    assert (abs(speeds[:3] - 60.0) < 0.05).all()
    spans = result.trajectory.at_limit
    assert result.warnings == [
        *(f'{wheel}: the motion of the body drove the wheel to {speed:.6g} rad/s, beyond its '
          'max_speed of 60 rad/s' for wheel, speed in zip(WHEELS, speeds.tolist())),
        *(f'{wheel}: at its max_speed of 60 rad/s for '
          f'{sum(span.seconds for span in own):.9g} s, first at {own[0].begin_ns} ns, last until '
          f'{own[-1].end_ns} ns' for wheel in WHEELS
          if (own := [span for span in spans if span.wheel == wheel])),
        'efforts clipped to max_torque: 2']
    assert {span.wheel for span in spans} >= {WHEELS[0], WHEELS[1]}
    assert f'warning       {result.warnings[0]}' in result.text()


@pytest.mark.slow
def test_compare_and_identify_know_the_wheels(tmp_path, flight, scene_with, capsys):
    arguments = [str(flight), '--scene', str(SCENE)]
    assert main.attitude_compare([*arguments, '--json', str(tmp_path / 'found.json')]) == 0
    found = json.loads((tmp_path / 'found.json').read_text())
    # A restarted part of the motion also begins with the momenta of the wheels.
    assert found['attitude_error_rad']['max'] < 1e-15
    assert found['horizons'][-1]['attitude_p95_rad'] < 1e-11
    fitted = tmp_path / 'fitted.yaml'
    assert main.attitude_identify([*arguments, '-o', str(fitted)]) == 0
    again = scene.load(fitted)
    np.testing.assert_allclose(again.body.inertia, scene.load(SCENE).body.inertia, rtol=0,
                               atol=1e-11)
    assert [wheel.name for wheel in again.named_wheels] == [*WHEELS]
    slowed = scene_with('rw_x.friction: 1.0e-5', base=SCENE)
    for command, option in ((main.attitude_compare, []), (main.attitude_identify, []),
                            (main.attitude_tradeoff, ['--recording'])):
        assert command([*option, str(flight), '--scene', slowed]) == 2
        assert 'wheels: expected none with friction, which only a propagation computes, found ' \
            'rw_x' in capsys.readouterr().err


@pytest.mark.slow
def test_an_ensemble_knows_the_commands_of_wheels(tmp_path, flight, monkeypatch):
    monkeypatch.setattr('rigid_body_ros.commands.ensemble._draw', lambda *given: None)
    vary, out = tmp_path / 'vary.yaml', tmp_path / 'out'
    vary.write_text('inertia.ixx: {normal: 0.001}\nclock_offset: {normal: 0.01}\n')
    assert main.attitude_ensemble([
        '--recording', str(flight), '--scene', str(SCENE), '--vary', str(vary), '--runs', '8',
        '--seed', '1', '--workers', '1', '-o', str(out)]) == 0
    rows = parquet.read_table(out / 'runs.parquet').to_pylist()
    assert len(rows) == 8
    given = read(flight, SCENE)
    for row in rows:
        entries = np.array([row['inertia.ixx'], *given.body.entries[1:]])
        log = EffortLog(given.efforts.times_ns + round(row['clock_offset'] * SECOND),
                        given.efforts.efforts)
        motion = given.replaced(body=given.body.with_entries(entries), efforts=log).propagate(
            at=STAMPS[-1:])
        assert [row[f'attitude.{axis}'] for axis in 'xyzw'] == motion.attitude[0].tolist()


@pytest.mark.nightly
def test_a_tradeoff_knows_the_commands_of_wheels(flight, capsys):
    assert main.attitude_tradeoff(['--recording', str(flight), '--scene', str(SCENE)]) == 0
    assert '300 torque samples (hold)' in capsys.readouterr().out


@pytest.mark.nightly
def test_a_loop_of_wheels_is_held_by_attitude_regress(tmp_path):
    reference, page = tmp_path / 'reference.mcap', tmp_path / 'page.html'
    arguments = [str(reference), '--scene', str(SCENE)]
    controller = ['--', sys.executable, str(ROOT / 'examples' / 'four_wheels.py')]
    assert main.attitude_regress([*arguments, '--update', '--duration', '4', *controller]) == 0
    assert main.attitude_regress([*arguments, '--report', str(page), *controller]) == 0
    loop, run = regress.read(reference, WHEELS), scene.load(SCENE)
    commands = loop.torques['accepted_wheel_command']
    assert (loop.wheels, commands.values.shape) == (WHEELS, (201, 4))
    judge = Propagator(run.body, run.start, wheels=run.named_wheels)
    for stamp_ns, found in zip(commands.times_ns.tolist(), commands.values):
        state = judge.at(stamp_ns)
        expected = four_wheels.efforts(state.attitude, state.angular_velocity)
        np.testing.assert_array_equal(found, expected)
        # The sum of the wheel torques is the torque of the control law.
        np.testing.assert_allclose(four_wheels.AXES @ found, np.copysign(
            0.01, state.attitude[3]) * state.attitude[:3] + 0.04 * state.angular_velocity,
            rtol=0, atol=1e-17)
        judge.apply_efforts(stamp_ns, dict(zip(WHEELS, found.tolist())))
    assert 'rw_skewed' in page.read_text()
