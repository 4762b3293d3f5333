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

"""Signals that arrive at the start of a command, while the engine is imported."""

from importlib.util import find_spec
import signal
import subprocess
import sys

import pytest
import rigid_body_ros

#: Run a command that signals itself when it imports numpy, which every module of the engine needs.
#: Then the import continues, waits for a slow disk, or fails, as it does if C code imports a
#: module and the exception of a signal handler arrives there.
PROGRAM = """
import os, sys, time
_, number, then, *sys.argv = sys.argv

class Finder:
    def find_spec(name, path=None, target=None):
        if name == 'numpy':
            sys.meta_path.remove(Finder)
            os.kill(os.getpid(), int(number))
            exec(then)

sys.meta_path.insert(0, Finder)
from rigid_body_ros.commands import main
sys.exit(getattr(main, sys.argv[0])())
"""


@pytest.mark.slow
@pytest.mark.parametrize(('command', 'number', 'then'), [
    ('attitude_replay', signal.SIGINT, 'pass'), ('attitude_replay', signal.SIGTERM, 'pass'),
    ('attitude_replay', signal.SIGINT, 'time.sleep(60)'),
    ('attitude_replay', signal.SIGINT, 'raise ImportError'),
    ('attitude_tradeoff', signal.SIGINT, 'pass'),
    pytest.param('attitude_node', signal.SIGINT, 'pass', marks=pytest.mark.skipif(
        find_spec('rclpy') is None, reason='rclpy is not installed'))])
def test_a_signal_during_the_imports_ends_a_command_in_one_line(command, number, then, tmp_path):
    options = {'attitude_replay': [tmp_path / 'input.mcap', '--scene', tmp_path / 'scene.yaml'],
               'attitude_tradeoff': ['--scene', tmp_path / 'scene.yaml'], 'attitude_node': []}
    result = subprocess.run(
        [sys.executable, '-c', PROGRAM, str(int(number)), then, command,
         *options[command]], capture_output=True, text=True, timeout=50, check=False)
    assert result.stderr == f'{command}: interrupted; no partial output was left\n'
    assert result.returncode == 128 + number


@pytest.mark.slow
def test_the_engine_is_imported_when_a_name_is_first_used():
    script = """
import sys
import rigid_body_ros, rigid_body_ros.commands.main
assert 'numpy' not in sys.modules
assert set(rigid_body_ros.__all__) < set(dir(rigid_body_ros))
assert rigid_body_ros.so3 is sys.modules['rigid_body_ros.mechanics.so3']
from rigid_body_ros import *
assert propagate is rigid_body_ros.propagation.propagate
assert RigidBody is rigid_body_ros.RigidBody is vars(rigid_body_ros)['RigidBody']
"""
    result = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                            check=False)
    assert result.stderr == ''


@pytest.mark.slow
@pytest.mark.skipif(find_spec('rclpy') is None, reason='rclpy is not installed')
@pytest.mark.parametrize(('module', 'unused'), [
    ('attitude_node', ['matplotlib', 'tqdm', 'mcap', 'zstandard', 'scipy.spatial', 'scipy.linalg',
                       'rigid_body_ros.recording', 'rigid_body_ros.replay']),
    ('attitude_controller', ['rigid_body_ros.propagation'])])
def test_a_node_does_not_import_what_it_does_not_use(module, unused):
    script = f"""
import sys
import rigid_body_ros.commands.main, rigid_body_ros.commands.replay
import rigid_body_ros.node.{module}
print([name for name in {unused} if name in sys.modules])
"""
    result = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                            check=True)
    assert result.stdout == '[]\n'


def test_a_name_that_the_package_does_not_have_is_reported_as_for_any_module():
    with pytest.raises(AttributeError, match="^module 'rigid_body_ros' has no attribute 'spin'$"):
        _ = rigid_body_ros.spin
    with pytest.raises(ImportError, match="cannot import name 'spin' from 'rigid_body_ros'"):
        from rigid_body_ros import spin  # noqa: F401
