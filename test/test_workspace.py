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

"""The package in a ROS workspace is built, sourced, found, run and tested with colcon."""

import os
import shlex
import subprocess
import sys

from conftest import at_night, CONFIG, NAME, ROOT
import pytest
from rigid_body_ros import messages, recording

pytestmark = pytest.mark.slow
#: A command that does what `ros2 run PACKAGE EXECUTABLE` does: it finds the prefix of the package
#: in the ament index, and there an executable file in lib/PACKAGE.
RUN = (f'prefix=$({sys.executable} -c "from ament_index_python.packages import '
       f'get_package_prefix; print(get_package_prefix(\'{NAME}\'))") && $prefix/lib/{NAME}/')


@pytest.fixture(scope='module')
def workspace(tmp_path_factory):
    """Return a workspace in which the package is built."""
    return built(tmp_path_factory.mktemp('workspace'))


def built(folder, *options):
    """Build the files of this checkout in a workspace."""
    source = folder / 'src' / NAME
    source.mkdir(parents=True)
    listed = subprocess.run(['git', 'ls-files', '--cached', '--others', '--exclude-standard'],
                            cwd=ROOT, check=True, capture_output=True, text=True)
    files = [name for name in listed.stdout.splitlines() if (ROOT / name).exists()]
    if (ROOT / 'build' / 'kernels').exists():  # generating the kernels takes a minute
        files.append('build/kernels')
    subprocess.run(['cp', '-r', '--parents', '-t', source, *files], cwd=ROOT, check=True)
    colcon(folder, 'build', *options)
    return folder


def colcon(folder, *arguments):
    # No other package on this machine must be found.
    environment = {**os.environ, 'AMENT_PREFIX_PATH': sys.prefix, 'PYTHONPATH': '',
                   'COLCON_HOME': str(folder)}
    result = subprocess.run([sys.executable, '-m', 'colcon', *arguments], cwd=folder, text=True,
                            env=environment, check=False, capture_output=True)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def sourced(folder, command, cwd):
    """Return the output of a command in a shell that has sourced the workspace."""
    return subprocess.run(
        ['bash', '-c', f'. {shlex.quote(str(folder))}/install/setup.bash && {command}'], cwd=cwd,
        env={**os.environ, 'AMENT_PREFIX_PATH': sys.prefix, 'PYTHONPATH': ''}, check=False,
        capture_output=True, text=True)


def test_what_python_imports_is_the_workspace(workspace, tmp_path):
    result = sourced(workspace, f'{sys.executable} -c "import {NAME}; print({NAME}.__file__)"',
                     tmp_path)
    assert result.stdout.startswith(str(workspace)), result.stderr


def test_the_ament_index_has_what_launch_files_look_for(workspace, tmp_path):
    share = (f'{sys.executable} -c "from ament_index_python.packages import '
             f'get_package_share_directory; print(get_package_share_directory(\'{NAME}\'))"')
    files = 'find package.xml config launch -type f'
    result = sourced(workspace, f'cd $({share}) && {files}', tmp_path)
    assert result.returncode == 0, result.stderr
    listed = {str(path.relative_to(ROOT)) for folder in ('config', 'launch')
              for path in (ROOT / folder).rglob('*.*') if path.suffix != '.pyc'}
    assert set(result.stdout.split()) == {'package.xml', *listed}


@pytest.mark.parametrize('command', [
    'attitude_node', *at_night('attitude_replay', 'attitude_tradeoff')])
def test_ros2_run_finds_and_starts_a_command(workspace, tmp_path, command):
    result = sourced(workspace, f'{RUN}{command} --help', tmp_path)
    assert result.returncode == 0, result.stderr
    assert f'usage: {command}' in result.stdout


@pytest.mark.nightly
def test_a_workspace_of_links_is_found_as_well(tmp_path):
    built(tmp_path, '--symlink-install')
    result = sourced(tmp_path, f'{RUN}attitude_replay --help', tmp_path)
    assert 'usage: attitude_replay' in result.stdout, result.stderr


@pytest.mark.nightly
def test_a_command_of_the_workspace_does_its_work(workspace, tmp_path):
    (tmp_path / 'log.csv').write_text('1.0,0,0,0\n2.0,0.1,0,0\n2.1,0,0,0\n')
    result = sourced(workspace, f'{RUN}attitude_replay log.csv --scene '
                     f'{CONFIG / "tumbler.yaml"} -o motion.mcap', tmp_path)
    assert result.returncode == 0, result.stderr
    motion = recording.read(tmp_path / 'motion.mcap', '/attitude', messages.QUATERNION)
    assert len(motion) == 3


def test_colcon_runs_the_tests_and_finds_no_failure(workspace):
    # Only the tests of one file, because running all tests would run this test again.
    colcon(workspace, 'test', '--pytest-args', 'test/test_euler.py')
    said = colcon(workspace, 'test-result')
    assert ' 0 errors, 0 failures' in said
    assert 'Summary: 0 tests' not in said
