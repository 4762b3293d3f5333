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
import os
import shutil
import signal
import subprocess
import sys
import time

from ament_index_python.packages import get_packages_with_prefixes
from conftest import CONFIG, NAME, RECORDINGS
from geometry_msgs.msg import QuaternionStamped
import pytest
import rclpy
from rclpy.wait_for_message import wait_for_message

pytestmark = pytest.mark.ros
#: s; the first start on a machine compiles the kernels.
PATIENCE = 300
INDEX = 'share/ament_index/resource_index/packages'
#: Logs its arguments. `ros2 bag play` ends once it is resumed, which is all that matters to the
#: launch file.
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


@contextmanager
def launched(name, *arguments):
    """Run a launch file, and end all of its processes."""
    process = subprocess.Popen(
        [shutil.which('ros2'), 'launch', NAME, f'{name}.launch.py', *arguments], text=True,
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


def first_attitude(listener, topic):
    found, attitude = wait_for_message(QuaternionStamped, listener, topic, time_to_wait=PATIENCE)
    assert found
    return attitude


@pytest.mark.parametrize(('name', 'arguments'), [
    ('attitude_node', ()), ('closed_loop', ('stop_after',)), ('replay_into_node', ('bag', 'rate')),
    ('view', ('space_frame',))])
def test_every_launch_file_lists_its_arguments(name, arguments):
    words, status = run(name, '--show-args')
    assert status == 0, words
    for argument in ('scene', 'namespace', 'use_sim_time', 'torque', *arguments):
        assert f"'{argument}':" in words


def test_the_node_alone_uses_its_arguments(listener):
    with launched('attitude_node', f'scene:={CONFIG / "iss.yaml"}', 'namespace:=station',
                  'torque:=/wrench') as process:
        assert first_attitude(listener, '/station/attitude').header.frame_id == 'eci'
        until = time.monotonic() + PATIENCE
        while not listener.count_subscribers('/wrench') and time.monotonic() < until:
            time.sleep(0.05)
        assert listener.count_subscribers('/wrench') == 1
        words, status = interrupt(process)
    assert status == 0, words
    assert 'attitude_node-1]: process has finished cleanly' in words


@pytest.mark.parametrize('arguments', [
    (), pytest.param(('namespace:=sat', 'torque:=/wrench'), marks=pytest.mark.nightly)])
def test_a_closed_loop_settles_and_ends(arguments):
    words, status = run('closed_loop', 'stop_after:=20', *arguments)
    assert status == 0, words
    assert 'settled within 0.001 rad' in words
    assert words.count('process has finished cleanly') == 2


def test_a_closed_loop_ends_if_the_node_cannot_start(tmp_path):
    (tmp_path / 'scene.yaml').write_text('/**: {ros__parameters: {inertia: {ixx: -1.0}}}\n')
    words, _ = run('closed_loop', f'scene:={tmp_path / "scene.yaml"}')
    assert 'attitude_node: error: inertia.ixx: expected a finite number greater than 0' in words


def test_a_bag_plays_once_the_node_is_ready_and_ends_everything(tmp_path, monkeypatch):
    index, calls = tmp_path / INDEX, tmp_path / 'calls'
    index.mkdir(parents=True)
    (index / 'ros2bag').touch()
    ros2 = tmp_path / 'ros2'
    ros2.write_text(STAND_IN.format(calls=calls, ros2=shutil.which('ros2')))
    ros2.chmod(0o755)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path), os.pathsep)
    bag = RECORDINGS / 'tumbler.mcap'
    monkeypatch.setenv('PATH', str(tmp_path), os.pathsep)
    words, status = run('replay_into_node', f'bag:={bag}', 'namespace:=sat', 'torque:=/wrench')
    assert status == 0, words
    assert words.count('process has finished cleanly') == 4
    assert 'epoch' not in words  # it waits for /clock
    commands = calls.read_text()
    assert (f'bag play {bag} --topics /wrench --rate 1.0 --clock 100 --start-paused '
            '--disable-keyboard-controls\n') in commands
    assert commands.index('call /sat/attitude_node/get_parameters rcl_interfaces') \
        < commands.index('call /rosbag2_player/resume rosbag2_interfaces/srv/Resume')


def test_a_bag_needs_rosbag2():
    if 'ros2bag' in get_packages_with_prefixes():
        pytest.skip('ros2bag is installed')
    words, status = run('replay_into_node', 'bag:=some.mcap')
    assert status == 1
    assert "package 'ros2bag' not found" in words
    assert 'process started' not in words


def test_a_view_logs_what_is_not_installed(listener):
    installed = get_packages_with_prefixes()
    if 'rviz2' in installed:
        pytest.skip('rviz2 is installed, and would open a window')
    with launched('view') as process:
        first_attitude(listener, '/attitude')
        words, status = interrupt(process)
    assert status == 0, words
    for package in ('rviz2', 'foxglove_bridge', 'tf2_msgs'):
        assert (f'{package} is not installed' in words) == (package not in installed)
