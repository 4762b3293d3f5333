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

"""The installed package does what the README says; `test_doc_commands` runs its commands."""

import os
import re
import shlex
import signal
import subprocess
import sys

from conftest import NAME, ROOT
import pytest

TEXT = (ROOT / 'README.md').read_text(encoding='utf-8')
FENCED = re.findall(r'^```(\w+)\n(.*?)^```$', TEXT, re.DOTALL | re.MULTILINE)
BLOCKS = [[line for line in block.replace('\\\n', '').splitlines() if not line.startswith('#')]
          for language, block in FENCED if language == 'bash']
#: s; how long to wait for anything.
PATIENCE = 300


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Work in a folder with the repository files that the README names."""
    for folder in ('config', 'test'):
        (tmp_path / folder).symlink_to(ROOT / folder)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_make_has_the_demo():
    assert re.search(r'^demo:', (ROOT / 'Makefile').read_text(), re.MULTILINE)


def test_what_is_launched_is_there():
    names = re.findall(r'`(\w+\.launch\.py)', (ROOT / 'docs' / 'launch.md').read_text())
    assert {path.name for path in (ROOT / 'launch').iterdir() if path.is_file()} == set(names)


@pytest.mark.slow
def test_a_command_that_is_installed_writes_the_page(place, installed):
    command = next(line for block in BLOCKS for line in block if '--report' in line)
    name, *arguments = shlex.split(command)
    result = subprocess.run([installed / 'lib' / NAME / name, *arguments], check=False,
                            capture_output=True, text=True, env=environment(installed))
    assert result.returncode == 0, result.stderr
    assert (place / arguments[arguments.index('--report') + 1]).is_file()


def environment(installed):
    packages, = installed.glob('lib/python*/site-packages')
    return {**os.environ, 'PYTHONPATH': str(packages),
            'PATH': os.path.dirname(sys.executable) + os.pathsep + os.environ['PATH']}


@pytest.mark.ros
def test_the_node_of_the_readme_listens_and_is_heard(place, installed, domain, request):
    pytest.importorskip('rclpy', reason='ROS 2 (rclpy) is not installed')
    from geometry_msgs.msg import QuaternionStamped
    from rclpy.wait_for_message import wait_for_message
    (command, echo), = (block for block in BLOCKS if 'ros2 topic echo' in block[-1])
    package, executable, *arguments = shlex.split(command)[2:]  # after `ros2 run`
    listener = request.getfixturevalue('stranger')
    process = subprocess.Popen(
        [installed / 'lib' / package / executable, *arguments], text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        env={**environment(installed), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
             'ROS_DOMAIN_ID': str(domain), 'ROS_LOG_DIR': str(place)})
    try:
        heard, attitude = wait_for_message(QuaternionStamped, listener, echo.split()[-1],
                                           time_to_wait=PATIENCE)
        assert heard
        assert attitude.header.frame_id == 'world'
        assert listener.count_subscribers('/wrench') == 1
        process.send_signal(signal.SIGINT)
        words, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, words
    finally:
        process.kill()
        process.communicate()
