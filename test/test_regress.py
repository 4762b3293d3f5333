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

"""attitude_regress: equal bits from an equal controller, and one line about one that fails."""

from contextlib import suppress
from dataclasses import replace
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time

from conftest import at_night, program, RECORDINGS, ROOT, running, SECOND
import detumble
import numpy as np
import pytest
import rclpy
from rigid_body_ros import messages, Propagator, recording, scene
from rigid_body_ros.commands import main
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.regress import differences, read, Signal
from rigid_body_ros.regress.processes import private_domain
import unload_wheels

pytestmark = pytest.mark.ros
SCENE = """
/**:
  ros__parameters:
    inertia: {ixx: 0.045, iyy: 0.120, izz: 0.140, ixy: 0.002, ixz: -0.001, iyz: 0.003}
    initial_angular_velocity: {x: 0.15, y: 0.60, z: -0.10}
    step: 0.02
"""
STEP_NS, END_NS = SECOND // 50, 2 * SECOND
CONTROLLER = program('attitude_controller')
GAINS = {'proportional_gain': 0.05, 'derivative_gain': 0.12}
#: A controller that sends torques as fast as it can, in a given frame and with a given stamp.
NODE = """
import random
import sys
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
import rclpy
rclpy.init()
node = rclpy.create_node('other')
publisher = node.create_publisher(WrenchStamped, sys.argv[1], 10)
torque, drawn = WrenchStamped(), {}
"""
FLOOD = NODE + """
torque.header.frame_id = sys.argv[2]
torque.header.stamp.sec = 1
while True:
    publisher.publish(torque)
"""
RANDOM = NODE + """
def on_state(state):
    torque.header.stamp = stamp = state.header.stamp
    torque.wrench.torque.x = drawn.setdefault((stamp.sec, stamp.nanosec), 1e-6 * random.random())
    publisher.publish(torque)
node.create_subscription(Odometry, 'odometry', on_state, 10)
rclpy.spin(node)
"""
CONSTANT = RANDOM.replace('1e-6 * random.random()', '1e-3')
MARK = f'98765.{os.getpid()}'


def with_gains(**gains):
    """Return the command of the controller with other gains."""
    return [*CONTROLLER, '--ros-args', *(word for name, gain in gains.items()
                                         for word in ('-p', f'{name}:={gain!r}'))]


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder with a scene, and the reference of the controller."""
    folder = tmp_path_factory.mktemp('regress')
    (folder / 'scene.yaml').write_text(SCENE)
    assert run(folder, '--update', '--duration', '2', command=CONTROLLER) == 0
    return folder


def arguments(folder, *options, command):
    return [str(folder / 'reference.mcap'), '--scene', str(folder / 'scene.yaml'),
            *map(str, options), '--', *command]


def run(folder, *options, command=CONTROLLER):
    return main.attitude_regress(arguments(folder, *options, command=command))


def loop(folder, **gains):
    """Close the loop without ROS, and return its torques."""
    gains, run = {**GAINS, **gains}, scene.load(folder / 'scene.yaml')
    propagator, torques = Propagator(run.body, run.start), []
    for stamp_ns in range(0, END_NS + 1, STEP_NS):
        state = propagator.at(stamp_ns)
        *error, real = state.attitude.tolist()
        towards = -math.copysign(2.0 * gains['proportional_gain'], real)
        torques.append([towards * angle - gains['derivative_gain'] * rate
                        for angle, rate in zip(error, state.angular_velocity.tolist())])
        propagator.apply(stamp_ns, torques[-1])
    return np.array(torques)


def test_a_reference_is_the_loop_that_a_controller_closes(folder):
    found = read(folder / 'reference.mcap')
    samples = found.torques['accepted_torque']
    assert samples.times_ns.tolist() == [*range(0, END_NS + 1, STEP_NS)]
    assert found.states.times_ns.tolist() == samples.times_ns.tolist()
    np.testing.assert_array_equal(samples.values, loop(folder))
    # The reference is a recording of a node like any other.
    assert main.attitude_replay([*arguments(folder, command=())[:-1], '--topic',
                                 '/attitude_node/accepted_torque', '--verify',
                                 str(folder / 'reference.mcap')]) == 0


def test_equal_loops_are_equal_whatever_clock_and_mode_a_scene_has(folder, tmp_path, capsys):
    shutil.copy(folder / 'reference.mcap', tmp_path)
    (tmp_path / 'scene.yaml').write_text(SCENE + '    publish_clock: true\n    mode: clock\n')
    outputs = '--json', tmp_path / 'result.json', '--report', tmp_path / 'page.html'
    assert run(tmp_path, *outputs) == 0
    assert json.loads((tmp_path / 'result.json').read_text()) == {
        'equal': True, 'torques': 101, 'states': 101, 'first_difference_ns': None,
        'largest': {'torque_N_m': 0.0, 'attitude_rad': 0.0, 'rate_rad_s': 0.0}}
    assert 'the loop has the same bits' in capsys.readouterr().out
    page = (tmp_path / 'page.html').read_text()
    assert 'difference: attitude, body axes' in page
    assert str(tmp_path) not in page


@pytest.mark.parametrize('name', ['proportional_gain', *at_night('derivative_gain')])
def test_a_gain_that_is_off_by_one_unit_in_the_last_place_is_found(folder, tmp_path, capsys, name):
    changed = {name: math.nextafter(GAINS[name], 1.0)}
    assert run(folder, '--json', tmp_path / 'result.json', command=with_gains(**changed)) == 1
    result = json.loads((tmp_path / 'result.json').read_text())
    first = int(np.argmax((loop(folder) != loop(folder, **changed)).any(axis=1)))
    assert result['first_difference_ns'] == first * STEP_NS
    assert not result['equal']
    assert 0.0 < result['largest']['attitude_rad'] < 1e-14
    out, error = capsys.readouterr()
    assert 'the torque at equal states, so the controller differs' in out
    assert 'second run    has the same bits as the first' in out
    assert error.splitlines() == ['attitude_regress: the loop differs from the reference']


@pytest.mark.nightly
def test_a_tolerance_accepts_what_differs_by_less(folder, tmp_path, capsys):
    changed = with_gains(proportional_gain=0.05 + 1e-9)
    assert run(folder, '--tolerance', '1e-6', '--json', tmp_path / 'a.json', command=changed) == 0
    result = json.loads((tmp_path / 'a.json').read_text())
    assert result['equal']
    assert result['first_difference_ns'] is not None
    assert 'the loop is the same within 1e-06 rad' in capsys.readouterr().out
    assert run(folder, '--tolerance', '1e-12', command=changed) == 1


@pytest.mark.parametrize(('command', 'line'), [
    (['no-such-command'], 'no-such-command: cannot be started: No such file or directory'),
    (['sh', '-c', 'echo about; echo to fail >&2; exit 3'],
     'sh: expected a controller that runs to the end of the loop, found that it ended with exit '
     'status 3; the node has accepted no torque'),
    *at_night(
        (['sh', '-c', 'kill -9 $$'], 'found that it was ended by SIGKILL'),
        (['true'], 'found that it ended with exit status 0'),
        ([*CONTROLLER, '--ros-args', '-p', 'stop_after:=1.0'],
         'exit status 0; its torques reach 0.98 s of the loop'))])
def test_a_controller_that_dies_is_one_line(folder, capsys, command, line):
    assert run(folder, command=command) == 2
    *output, last = capsys.readouterr().err.splitlines()
    assert last.startswith('attitude_regress: error: ')
    assert line in last
    assert [text.strip() for text in output] == (['about', 'to fail'] if 'about' in command[-1]
                                                 else [])


@pytest.mark.parametrize(('command', 'line'), [
    (['sleep', MARK], 'the node has accepted no torque'),
    *at_night(([sys.executable, '-c', FLOOD, 'torque', ''], 'its torques reach 0 s of the loop'),
              ([sys.executable, '-c', FLOOD, 'torque', 'nowhere'],
               'the node has accepted no torque'))])
def test_a_controller_that_is_silent_or_floods_is_one_line(folder, capsys, command, line):
    seconds = '20' if FLOOD in command else '2'  # a node may start slowly
    assert run(folder, '--timeout', seconds, command=command) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert f'expected the loop to end within --timeout {seconds} s, found that' in last
    assert line in last
    assert not running(MARK)


def test_ctrl_c_ends_all_that_was_started(folder, tmp_path):
    # Like `ros2 launch`, the command starts other processes; none of them reacts to Ctrl-C.
    started = tmp_path / 'started'
    command = ['sh', '-c', f'trap "" INT; sleep {MARK} & touch {started}; sleep {MARK}']
    process = subprocess.Popen([*program('attitude_regress'),
                                *arguments(folder, command=command)], stderr=subprocess.PIPE,
                               text=True)
    until = time.monotonic() + 60.0
    while not started.exists():
        assert time.monotonic() < until
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGINT
    assert error == 'attitude_regress: interrupted; no partial output was left\n'
    assert not running(MARK)


@pytest.mark.nightly
def test_a_controller_that_starts_from_another_program_is_ended_with_it(folder):
    command = ['sh', '-c', '"$@" & sleep ' + MARK, 'launch', *CONTROLLER]
    assert run(folder, command=command) == 0
    assert not running(MARK)


@pytest.mark.nightly
def test_a_loop_begins_when_all_controllers_are_there(tmp_path):
    (tmp_path / 'scene.yaml').write_text(f'{SCENE}    wheels: true\n')
    command = ['sh', '-c', '"$@" torque & sleep 2; exec "$@" wheel_torque', 'launch',
               sys.executable, '-c', CONSTANT]
    assert run(tmp_path, '--update', '--duration', '1', command=command) == 0
    logs = read(tmp_path / 'reference.mcap').torques
    assert [*logs] == ['accepted_torque', 'accepted_wheel_torque']
    for samples in logs.values():
        assert samples.times_ns.tolist() == [*range(0, SECOND + 1, STEP_NS)]
    assert run(tmp_path, command=command) == 0


@pytest.mark.nightly
def test_a_controller_that_is_not_reproducible_is_called_so(folder, tmp_path, capsys):
    command = [sys.executable, '-c', RANDOM, 'torque']
    assert run(folder, command=command) == 1
    assert 'the controller is not reproducible: two runs differ from' in capsys.readouterr().err
    (tmp_path / 'scene.yaml').write_text(SCENE)
    assert run(tmp_path, '--update', '--duration', '1', command=command) == 1
    assert not (tmp_path / 'reference.mcap').exists()
    assert run(tmp_path, '--update', '--duration', '1', '--tolerance', '0.1', command=command) == 0
    assert 'within the tolerance, but the controller is not reproducible' \
        in capsys.readouterr().out
    assert (tmp_path / 'reference.mcap').exists()


@pytest.mark.nightly
def test_an_update_takes_the_time_of_the_reference_or_the_end_of_the_controller(tmp_path):
    (tmp_path / 'scene.yaml').write_text(SCENE)
    short = [*CONTROLLER, '--ros-args', '-p', 'stop_after:=0.5']
    assert run(tmp_path, '--update', '--duration', '1', command=short) == 0
    assert read(tmp_path / 'reference.mcap').spans_ns == {'accepted_torque': 24 * STEP_NS}
    assert run(tmp_path, command=short) == 0
    assert run(tmp_path, '--update') == 0
    assert read(tmp_path / 'reference.mcap').spans_ns == {'accepted_torque': 24 * STEP_NS}


@pytest.mark.nightly
def test_a_second_node_is_refused(folder, capsys):
    node = [*program('attitude_node'), '--ros-args', '--params-file', str(folder / 'scene.yaml')]
    assert run(folder, '--timeout', '30', command=node) == 2
    assert 'starts a node that publishes odometry, too' in capsys.readouterr().err


@pytest.mark.parametrize(('name', 'command', 'options'), [
    ('slew', CONTROLLER, []),
    *at_night(*((name, [sys.executable, str(ROOT / 'examples' / f'{name}.py')],
                 # The sine of another C library may differ in the last bit.
                 ['--tolerance', '1e-9']) for name in ('detumble', 'unload_wheels')))])
def test_the_examples_close_the_loops_of_their_references(capsys, name, command, options):
    paths = [str(ROOT / 'examples' / f'{name}.{suffix}') for suffix in ('mcap', 'yaml')]
    assert main.attitude_regress([paths[0], '--scene', paths[1], *options, '--', *command]) == 0
    assert 'the loop ' in capsys.readouterr().out


def test_rods_stop_a_satellite_that_tumbles():
    found = scene.load(ROOT / 'examples' / 'detumble.yaml')
    propagator, law = Propagator(found.body, found.start), detumble.BDot()
    for seconds in range(4000):
        state = propagator.at(seconds * SECOND)
        propagator.apply(seconds * SECOND, law.torque(float(seconds), state.attitude))
    # The remaining rate is about that of the rotating field.
    assert np.linalg.norm(state.angular_velocity) < 3.0 * 1.1068e-3
    assert np.linalg.norm(found.start.angular_velocity) > 0.1


def test_rods_take_the_momentum_of_the_wheels():
    found = scene.load(ROOT / 'examples' / 'unload_wheels.yaml')
    propagator = Propagator(found.body, found.start)
    for number in range(4000):
        seconds, time_ns = 0.5 * number, number * SECOND // 2
        state = propagator.at(time_ns)
        propagator.apply(time_ns, unload_wheels.of_rods(seconds, state.attitude,
                                                        state.rotor_momentum))
        propagator.apply_wheels(time_ns, unload_wheels.of_wheels(state.attitude,
                                                                 state.angular_velocity))
    assert np.linalg.norm(state.rotor_momentum) \
        < 0.2 * np.linalg.norm(found.start.rotor_momentum)
    assert 2.0 * np.linalg.norm(state.attitude[:3]) < 5e-3


@pytest.mark.nightly
def test_runs_side_by_side_do_not_disturb_each_other(folder, tmp_path):
    changed = with_gains(proportional_gain=math.nextafter(0.05, 1.0))
    processes = [subprocess.Popen([*program('attitude_regress'), *arguments(
        folder, '--json', tmp_path / f'{number}.json', '--timeout', '300', command=command)],
        stdout=subprocess.DEVNULL) for number, command in enumerate(2 * [CONTROLLER, changed])]
    assert [process.wait() for process in processes] == [0, 1, 0, 1]
    same, other, *again = ((tmp_path / f'{number}.json').read_text() for number in range(4))
    assert again == [same, other]


def test_domains_are_apart_and_the_environment_is_left_alone(monkeypatch):
    monkeypatch.setenv('ROS_STATIC_PEERS', '192.0.2.1')
    before = dict(os.environ)
    with private_domain() as first, private_domain() as second:
        assert first != second
        assert os.environ['ROS_DOMAIN_ID'] == str(second)
        assert 'ROS_STATIC_PEERS' not in os.environ
    assert dict(os.environ) == before
    with private_domain() as again:
        assert again == first


def test_a_domain_with_a_node_is_not_taken():
    with private_domain() as free:
        pass
    busy = rclpy.Context()
    rclpy.init(context=busy, domain_id=free)
    node = rclpy.create_node('resident', context=busy)
    try:
        with private_domain() as taken:
            assert taken != free
    finally:
        node.destroy_node()
        rclpy.shutdown(context=busy)


def test_a_loop_that_lacks_a_torque_differs_at_its_stamp(folder):
    reference = read(folder / 'reference.mcap')
    samples = reference.torques['accepted_torque']
    rows = np.arange(len(samples)) != 7
    other = replace(reference, torques={'accepted_torque': Signal(
        samples.times_ns[rows], samples.values[rows], samples.frames[rows])})
    found = differences(reference, other)
    assert (found.first_ns, found.first, found.missing) == (7 * STEP_NS, 'stamp', 1)
    assert not found.within(1.0)
    assert found.torques == 100


def test_a_log_that_only_one_loop_has_lacks_its_stamps(folder):
    reference = read(folder / 'reference.mcap')
    commands = Signal(np.array([STEP_NS]), np.zeros((1, 4)), np.array(['']))
    for torques, missing in (({'accepted_wheel_command': commands}, 1),
                             ({'accepted_inertia': commands.until(0)}, 0)):
        other = replace(reference, torques={**reference.torques, **torques})
        for found in (differences(reference, other), differences(other, reference)):
            assert (found.torques, found.missing) == (101, missing)
            assert found.first_ns == (STEP_NS if missing else None)


def test_a_reference_of_other_wheels_is_one_line(tmp_path):
    kind, path = messages.joint_commands(('rw_x', 'rw_y')), tmp_path / 'reference.mcap'
    with recording.Writer(path) as writer:
        writer.add_topic('/node/committed', messages.ODOMETRY)
        writer.add_topic('/node/accepted_wheel_command', kind)
        writer.write('/node/accepted_wheel_command', 1, kind.encode(1, '', [0.1, 0.2]))
    with pytest.raises(InputError, match='expected wheel_names in the scene, found none'):
        read(path)
    with pytest.raises(InputError, match="expected some of 'rw_x', 'rw_z', found 'rw_y'"):
        read(path, ('rw_x', 'rw_z'))


@pytest.mark.parametrize(('options', 'line'), [
    (['a.mcap', '--scene', 'b', '--update'], "expected the command of a controller after '--'"),
    (['a.mcap', '--scene', 'b', '--duration', '1', '--', 'c'], '--duration: expected --update'),
    (['a.mcap', '--scene', 'b', '--tolerance', '7', '--', 'c'], 'expected a number from 0 to'),
    (['a.txt', '--scene', 'b', '--update', '--', 'c'], 'expected a name ending in .mcap'),
    (['a.mcap', '--', 'c'], 'expected --scene or --open-loop, found neither'),
    (['a.mcap', '--scene', 'b', '--tolerance', 'a=1', '--', 'c'],
     '--tolerance: expected an angle without --open-loop, found FIELD=VALUE,...'),
    (['a.mcap', '--scene', 'b', '--step', '1', '--', 'c'],
     '--step: expected --open-loop, found none'),
])
def test_mistakes(tmp_path, monkeypatch, capsys, options, line):
    monkeypatch.chdir(tmp_path)
    with suppress(SystemExit):
        assert main.attitude_regress(options) == 2
    assert line in capsys.readouterr().err.splitlines()[-1]
    assert not [*tmp_path.iterdir()]


def test_what_is_no_reference(folder, tmp_path, refusal):
    path, other = tmp_path / 'reference.mcap', RECORDINGS / 'tumbler.mcap'
    shutil.copy(folder / 'scene.yaml', tmp_path)
    shutil.copy(other, path)
    for options in ((), ('--update', '--duration', '1')):
        assert 'expected the log of one node, with its topics accepted_torque and committed' \
            in refusal('attitude_regress', *arguments(tmp_path, *options, command=CONTROLLER))
    assert path.read_bytes() == other.read_bytes()
    path.unlink()
    assert '--duration, found neither' in refusal(
        'attitude_regress', *arguments(tmp_path, '--update', command=CONTROLLER))
