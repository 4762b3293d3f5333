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

"""The README: every command in it is run as it stands, with the scene that it shows."""

from contextlib import contextmanager
import os
from pathlib import Path
import re
import shlex
import shutil
import signal
import subprocess
import sys

from conftest import NAME, RECORDINGS, ROOT
import measurements
import pytest
from rigid_body_ros import scene

TEXT = (ROOT / 'README.md').read_text(encoding='utf-8')
FENCED = re.findall(r'^```(\w*)\n(.*?)^```$', TEXT, re.DOTALL | re.MULTILINE)
BLOCKS = [[line.partition('   #')[0].strip() for line in block.splitlines()]
          for language, block in FENCED if not language]
COMMANDS = [line for block in BLOCKS for line in block]
SCENE, = (block for language, block in FENCED if language == 'yaml')
#: s.
PATIENCE = 300


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Work in a folder with the files that the README names, and the commands on the path."""
    (tmp_path / 'scene.yaml').write_text(SCENE)
    shutil.copy(RECORDINGS / 'tumbler.mcap', tmp_path / 'log.mcap')
    described = scene.load(tmp_path / 'scene.yaml')
    flight = measurements.truth(rates=tuple(described.start.angular_velocity.tolist()),
                                inertia=tuple(map(tuple, described.body.inertia.tolist())))
    measured = measurements.messages_of('Imu', flight.measured(2e-3, 5e-3))
    measurements.write(tmp_path / 'flight.mcap', imu=measured,
                       torque=measurements.torque_messages(flight))
    measurements.write_scene(tmp_path / 'guess.yaml', flight)
    (tmp_path / 'vary.yaml').write_text(re.search(r'`vary.yaml`.*?`([^`]+)`', TEXT, re.DOTALL)[1])
    monkeypatch.chdir(tmp_path)
    return tmp_path


def starting(*words):
    return [command for command in COMMANDS if command.startswith(words)]


def test_no_command_is_left_out():
    # `make demo` is run by test_node, `make test` right now.
    run = starting('attitude_', 'ros2 run', 'ros2 topic echo')
    assert set(COMMANDS) - set(run) == {'make demo', 'make test'}
    targets = re.findall(r'^(\w+):', (ROOT / 'Makefile').read_text(), re.MULTILINE)
    assert {'demo', 'test'} <= set(targets)


def test_what_is_launched_is_there():
    names = re.findall(r'`(\w+\.launch\.py)', TEXT)
    assert {path.name for path in (ROOT / 'launch').iterdir() if path.is_file()} == set(names)


@pytest.mark.slow
def test_the_commands_without_ros_do_what_they_say(place, installed):
    for command in starting('attitude_'):
        name, *arguments = shlex.split(command)
        result = subprocess.run([installed / 'lib' / NAME / name, *arguments], check=False,
                                capture_output=True, text=True, env=environment(installed))
        assert result.returncode == 0, result.stderr
        written = {arguments[k + 1] for k, word in enumerate(arguments)
                   if word in ('-o', '--plot', '--report', '--json')}
        assert written <= {path.name for path in place.iterdir()}


def environment(installed):
    packages, = installed.glob('lib/python*/site-packages')
    return {**os.environ, 'PYTHONPATH': str(packages),
            'PATH': os.path.dirname(sys.executable) + os.pathsep + os.environ['PATH']}


@contextmanager
def run(command, installed, domain):
    """Do what `ros2 run PACKAGE EXECUTABLE ...` does, and leave nothing of it behind."""
    package, executable, *arguments = shlex.split(command)[2:]
    process = subprocess.Popen(
        [installed / 'lib' / package / executable, *arguments], text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        env={**environment(installed), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
             'ROS_DOMAIN_ID': str(domain), 'ROS_LOG_DIR': str(Path.cwd())})
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.ros
def test_the_node_of_the_readme_listens_and_is_heard(place, installed, domain):
    rclpy = pytest.importorskip('rclpy', reason='ROS 2 (rclpy) is not installed')
    from geometry_msgs.msg import QuaternionStamped
    from rclpy.wait_for_message import wait_for_message
    (command, echo), = (block for block in BLOCKS if 'ros2 topic echo' in block[-1])
    with run(command, installed, domain) as process:
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain)
        try:
            listener = rclpy.create_node('listener', context=context)
            heard, attitude = wait_for_message(QuaternionStamped, listener, echo.split()[-1],
                                               time_to_wait=PATIENCE)
            assert heard
            assert attitude.header.frame_id == 'world'
            assert listener.count_subscribers('/wrench') == 1
        finally:
            rclpy.shutdown(context=context)
        process.send_signal(signal.SIGINT)
        words, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, words


@pytest.mark.ros
def test_the_closed_loop_of_the_readme_settles(place, installed, domain):
    pytest.importorskip('rclpy', reason='ROS 2 (rclpy) is not installed')
    (node, controller), = (block for block in BLOCKS if 'attitude_controller' in block[-1])
    with run(node, installed, domain), run(controller, installed, domain) as process:
        words, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, words
    assert 'settled within' in words
