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

"""The launch files, run by `ros2 launch` from an installed package."""

from contextlib import contextmanager, suppress
from importlib.util import find_spec
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import time

from ament_index_python.packages import get_packages_with_prefixes
from conftest import at_night, CONFIG, NAME, RECORDINGS
from geometry_msgs.msg import QuaternionStamped, Vector3Stamped
from lifecycle_msgs.srv import GetState
import psutil
import pytest
from rcl_interfaces.srv import GetParameters
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import parameter_value_to_python
from rclpy.wait_for_message import wait_for_message
import yaml

pytestmark = [pytest.mark.ros, pytest.mark.skipif(
    find_spec('launch_ros') is None, reason='launch_ros is not installed, and PyPI does not have '
    'it; CONTRIBUTING.md lists what to install from source')]
#: s; how long to wait for anything.
PATIENCE = 300
ARGUMENTS = ('scene', 'namespace', 'name', 'torque', 'remappings', 'frame_prefix',
             'mode', 'publish_rate', 'checkpoint', 'lifecycle', 'autostart', 'use_sim_time',
             'log_level', 'respawn')
INDEX = 'share/ament_index/resource_index/packages'
#: A stand-in for `ros2` that logs its arguments. Its `bag play` ends once it is resumed, which is
#: all that matters to the launch file.
STAND_IN = """#!/bin/sh
echo "$@" >> {calls}
case "$*" in
    bag*) until grep -q resume {calls}; do sleep 0.1; done ;;
    *resume*) ;;
    *) exec {ros2} "$@" ;;
esac
"""


@pytest.fixture(autouse=True)
def _environment(installed, domain, tmp_path, monkeypatch):
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path))
    monkeypatch.setenv('PATH', os.path.dirname(sys.executable), os.pathsep)
    for prefix in (sys.prefix, installed):
        monkeypatch.setenv('AMENT_PREFIX_PATH', str(prefix), os.pathsep)


#: A launch file that prints its parameters twice: at its start, and after the others have ended.
SIBLING = """
import sys
import rclpy
rclpy.init(args=sys.argv)
node = rclpy.create_node('sibling', automatically_declare_parameters_from_overrides=True)
print('parameters: ' + ', '.join(
    f'{name}={node.get_parameter(name).value}' for name in sorted(node._parameters)), flush=True)
"""
#: A launch file that includes every launch file of the package twice, between two siblings.
INCLUDING = """
from launch import LaunchDescription
from launch.actions import (
    ExecuteProcess, IncludeLaunchDescription, LogInfo, OpaqueFunction, RegisterEventHandler)
from launch.event_handlers import OnProcessExit
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def include(name, **arguments):
    source = PathJoinSubstitution(
        [FindPackageShare('rigid_body_ros'), 'launch', name + '.launch.py'])
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(source),
        launch_arguments=dict(arguments, scene='tumbler').items())


def sibling():
    return Node(executable='{python}', arguments=['{sibling}'], output='screen')


def configurations(context):
    return [LogInfo(msg='configurations: ' + ' '.join(context.launch_configurations))]


def generate_launch_description():
    return LaunchDescription([
        sibling(),
        include('closed_loop', namespace='one', stop_after='20'),
        include('closed_loop', namespace='two', stop_after='20'),
        sibling(),
        OpaqueFunction(function=configurations),
    ])
"""


@contextmanager
def launched(*arguments):
    """Run a launch file within the context, and end all of its processes."""
    file = arguments[0] if os.path.isabs(arguments[0]) else f'{arguments[0]}.launch.py'
    package = [] if os.path.isabs(file) else [NAME]
    process = subprocess.Popen(
        [shutil.which('ros2'), 'launch', *package, file, *arguments[1:]], text=True,
        start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def run(name, *arguments):
    """Run a launch file to its end; return its output and exit status."""
    with launched(name, *arguments) as process:
        return process.communicate(timeout=PATIENCE)[0], process.returncode


def interrupt(process):
    """End a launch file as Ctrl-C does; return its output and exit status."""
    process.send_signal(signal.SIGINT)
    return process.communicate(timeout=PATIENCE)[0], process.returncode


@pytest.fixture
def listener():
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node('listener', context=context)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


def wait_for(condition):
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.05)


def first(kind, listener, topic):
    found, message = wait_for_message(kind, listener, topic, time_to_wait=PATIENCE)
    assert found
    return message


def first_attitude(listener, topic):
    return first(QuaternionStamped, listener, topic)


@pytest.mark.parametrize(('name', 'arguments'), [
    ('attitude_node', ()), ('closed_loop', ('stop_after',)), ('replay_into_node', ('bag', 'rate')),
    ('view', ('space_frame',)), ('monitor', ())])
def test_every_launch_file_lists_its_arguments(name, arguments):
    words, status = run(name, '--show-args')
    assert status == 0, words
    for argument in (*ARGUMENTS, *arguments):
        assert f"'{argument}':" in words


@pytest.mark.parametrize('name', ['attitude_node', 'closed_loop', 'view', 'fleet', 'monitor'])
def test_a_forgotten_scene_is_an_error(name):
    words, status = run(name)
    assert status == 1
    assert 'scene' in words
    assert 'process started' not in words


def test_the_live_check_runs_beside_a_robot(listener, tmp_path):
    scene = tmp_path / 'scene.yaml'
    monitor = 'monitor: {measured: [/imu], attitude_noise: 0.002, rate_noise: 0.005}'
    scene.write_text(f'{(CONFIG / "tumbler.yaml").read_text()}    {monitor}\n')
    with launched('monitor', f'scene:={scene}', 'namespace:=robot',
                  'torque:=/control') as process:
        wait_for(lambda: listener.count_subscribers('/control') == 1)
        assert listener.count_publishers('/robot/attitude_monitor/attitude_error') == 1
        words, status = interrupt(process)
    assert status == 0, words
    assert 'attitude_monitor-1]: process has finished cleanly' in words


@pytest.mark.parametrize(('name', 'arguments', 'error'), [
    ('attitude_node', ('scene:=tumblr',),
     'scene: expected a parameter file or the name of an example (cubesat, gimbal, iss, '
     "robot_stack, top, tumbler), found 'tumblr'"),
    ('attitude_node', ('publish_rate:=fast',),
     "publish_rate: expected a number, Hz, found 'fast'"),
    ('attitude_node', ('autostart:=false',),
     'autostart: expected no value without lifecycle:=true, because a plain node always starts by '
     "itself, found 'false'"),
    ('monitor', ('lifecycle:=true',),
     "lifecycle: expected false, because attitude_monitor has no life cycle, found 'true'"),
    ('closed_loop', ('mode:=realtime',), "mode: expected 'lockstep' or no value, because the "
     "controller waits for the reply to each torque, found 'realtime'"),
    *(('fleet', (f'bodies:={bodies}',),
       f'bodies: expected a whole number from 1 to 100, found {bodies!r}')
      for bodies in ('0', '2.5', '101')),
    ('fleet', ('checkpoint:=one.json',), 'checkpoint: expected no value, because each body needs '
     "a file of its own, found 'one.json'")])
def test_an_argument_that_makes_no_sense_is_an_error(name, arguments, error):
    words, status = run(name, 'scene:=tumbler', *arguments)  # the last of a name counts
    assert status == 1
    line, = (line for line in words.splitlines() if error in line)
    assert line.endswith(error)
    assert 'Traceback' not in words
    assert 'process started' not in words


def response(listener, kind, service, **request):
    """Call a service, and return its response."""
    client = listener.create_client(kind, service)
    assert client.wait_for_service(PATIENCE)
    executor = SingleThreadedExecutor(context=listener.context)
    for _ in range(PATIENCE // 5):  # DDS may lose a response to a client that is just discovered
        future = client.call_async(kind.Request(**request))
        rclpy.spin_until_future_complete(listener, future, executor, 5)
        if future.done():
            break
    executor.shutdown()
    return future.result()


def values_of(listener, node, *names):
    """Return the values of parameters of a node."""
    values = response(listener, GetParameters, f'{node}/get_parameters', names=names).values
    return [parameter_value_to_python(value) for value in values]


def state_of(listener):
    """Return the state of a managed node."""
    return response(listener, GetState, '/attitude_node/get_state').current_state.label


@pytest.mark.parametrize('mode', ['clock', *at_night('lockstep', 'realtime')])
def test_the_node_alone_uses_its_arguments(listener, mode):
    with launched('attitude_node', f'scene:={CONFIG / "iss.yaml"}', 'namespace:=station',
                  'name:=attitude', 'torque:=/wrench', 'remappings:=attitude:=q odometry:=odom',
                  'log_level:=error', f'mode:={mode}', 'publish_rate:=7',
                  'frame_prefix:=1') as process:
        assert first_attitude(listener, '/station/q').header.frame_id == 'eci'
        wait_for(lambda: listener.count_subscribers('/wrench') == 1)
        wait_for(lambda: ('attitude', '/station') in listener.get_node_names_and_namespaces())
        assert listener.count_publishers('/station/odom') == 1
        assert values_of(listener, '/station/attitude', 'mode', 'publish_rate',
                         'frame_prefix') == [mode, 7.0, '1']
        words, status = interrupt(process)
    assert status == 0, words
    assert 'attitude_node-1]: process has finished cleanly' in words
    assert '[INFO] [1' not in words.replace('[INFO] [launch', '')  # log level


def test_a_checkpoint_is_a_parameter(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with launched('attitude_node', 'scene:=tumbler', 'checkpoint:=2026') as process:
        def files():
            words = [word for child in psutil.Process(process.pid).children()
                     for word in child.cmdline()]
            return [word for word, before in zip(words[1:], words) if before == '--params-file']
        wait_for(files)
        given, = yaml.safe_load(Path(files()[-1]).read_text()).values()
    assert given == {'ros__parameters': {'checkpoint': '2026'}}


@pytest.mark.parametrize(('arguments', 'state'), [
    ((), 'unconfigured'), (('autostart:=true',), 'active')])
def test_a_managed_node_waits_for_its_manager_or_starts_by_itself(listener, arguments, state):
    with launched('attitude_node', 'scene:=tumbler', 'lifecycle:=true', *arguments) as process:
        wait_for(lambda: state_of(listener) == state)
        words, status = interrupt(process)
    assert status == 0, words
    assert 'attitude_lifecycle_node-1]: process has finished cleanly' in words


def test_a_node_that_ends_starts_again_if_it_shall(listener):
    with launched('attitude_node', 'scene:=tumbler', 'respawn:=true') as process:
        first_attitude(listener, '/attitude')
        first, = psutil.Process(process.pid).children()
        first.kill()
        wait_for(lambda: {*psutil.Process(process.pid).children()} - {first})


@pytest.mark.parametrize('arguments', [
    (), pytest.param(('namespace:=sat', 'torque:=/wrench'), marks=pytest.mark.nightly)])
def test_a_closed_loop_settles_and_ends(arguments):
    words, status = run('closed_loop', 'scene:=tumbler', 'stop_after:=20', *arguments)
    assert status == 0, words
    assert 'settled within 0.001 rad' in words
    assert words.count('process has finished cleanly') == 2


def test_a_closed_loop_ends_if_the_node_cannot_start(tmp_path):
    (tmp_path / 'scene.yaml').write_text('/**: {ros__parameters: {inertia: {ixx: -1.0}}}\n')
    words, _ = run('closed_loop', f'scene:={tmp_path / "scene.yaml"}')
    assert 'attitude_node: error: inertia.ixx: expected a finite number greater than 0' in words


def test_launch_files_included_twice_leave_nothing_to_the_file_that_includes_them(tmp_path):
    # The sibling prints its parameters, and only its own exit ends the launch.
    (tmp_path / 'sibling.py').write_text(SIBLING)
    including = tmp_path / 'including.launch.py'
    including.write_text(INCLUDING.format(python=sys.executable, sibling=tmp_path / 'sibling.py'))
    words, status = run(str(including))
    assert status == 0, words
    assert words.count('settled within 0.001 rad') == 2
    printed = [line.partition('parameters: ')[2] for line in words.splitlines()
               if 'parameters: ' in line]
    assert printed == ['start_type_description_service=True, use_sim_time=False'] * 2
    configurations, = (line.partition('configurations: ')[2] for line in words.splitlines()
                       if 'configurations: ' in line)
    # Only what the including file passes remains in its configurations.
    assert set(configurations.split()) <= {'scene', 'namespace', 'stop_after'}


@pytest.mark.parametrize(('arguments', 'count'), [
    (('bodies:=2', 'publish_rate:=7'), 2), at_night(((), 8))[0]])
def test_each_body_of_a_fleet_has_its_own_topics(listener, arguments, count):
    with launched('fleet', 'scene:=tumbler', *arguments) as process:
        for number in range(1, count + 1):
            frame = first(Vector3Stamped, listener, f'/body_{number}/angular_velocity')
            assert frame.header.frame_id == f'body_{number}/base_link'
            assert listener.count_publishers(f'/body_{number}/attitude') == 1
        assert listener.count_publishers('/tf') == 0
        assert listener.count_publishers(f'/body_{count + 1}/attitude') == 0
        if arguments:
            assert values_of(listener, '/body_2/attitude_node', 'publish_rate') == [7.0]
        words, status = interrupt(process)
    assert status == 0, words


def test_a_bag_plays_once_the_node_is_ready_and_ends_the_node(tmp_path, monkeypatch):
    index, calls = tmp_path / INDEX, tmp_path / 'calls'
    index.mkdir(parents=True)
    (index / 'ros2bag').touch()
    ros2 = tmp_path / 'ros2'
    ros2.write_text(STAND_IN.format(calls=calls, ros2=shutil.which('ros2')))
    ros2.chmod(0o755)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path), os.pathsep)
    bag = RECORDINGS / 'tumbler.mcap'
    monkeypatch.setenv('PATH', str(tmp_path), os.pathsep)
    words, status = run('replay_into_node', f'bag:={bag}', 'scene:=tumbler', 'namespace:=sat',
                        'torque:=/wrench')
    assert status == 0, words
    assert words.count('process has finished cleanly') == 4, words
    assert 'epoch' not in words  # the node waits for /clock
    commands = calls.read_text()
    assert (f'bag play {bag} --topics /wrench --rate 1.0 --clock 100 --start-paused '
            '--disable-keyboard-controls\n') in commands
    assert commands.index('call /sat/attitude_node/get_parameters rcl_interfaces') \
        < commands.index('call /rosbag2_player/resume rosbag2_interfaces/srv/Resume')


def test_a_bag_needs_rosbag2():
    if 'ros2bag' in get_packages_with_prefixes():
        pytest.skip('ros2bag is installed')
    words, status = run('replay_into_node', 'bag:=some.mcap', 'scene:=tumbler')
    assert status == 1
    assert "package 'ros2bag' not found" in words
    assert 'process started' not in words


def test_a_view_logs_what_is_not_installed(listener):
    installed = get_packages_with_prefixes()
    if 'rviz2' in installed:
        pytest.skip('rviz2 is installed, and would open a window')
    with launched('view', 'scene:=tumbler') as process:
        first_attitude(listener, '/attitude')
        words, status = interrupt(process)
    assert status == 0, words
    for package in ('rviz2', 'foxglove_bridge', 'tf2_msgs'):
        assert (f'{package} is not installed' in words) == (package not in installed)
