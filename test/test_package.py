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

"""The package: installed files are in the right places, and there is only one version number."""

import ast
from contextlib import contextmanager
from importlib import metadata
import os
from pathlib import Path
import re
import subprocess
import sys
from tempfile import TemporaryDirectory
import textwrap
import xml.etree.ElementTree as ElementTree

from conftest import at_night, CONFIG, locked, NAME, NEEDS, RECORDINGS, ROOT
import pytest

NODES = ('attitude_controller', 'attitude_lifecycle_node', 'attitude_monitor', 'attitude_node')
#: Commands that test_readme.py also runs, as pip installs them.
OFFLINE = ('attitude_compare', 'attitude_design', 'attitude_ensemble', 'attitude_identify',
           'attitude_regress', 'attitude_replay', 'attitude_tradeoff')


@pytest.mark.slow
@pytest.mark.parametrize('command', [*NODES, *at_night(*OFFLINE)])
def test_ros2_run_finds_the_commands_of_a_pip_install(installed, command):
    # As `ros2 run` does: find the package's prefix in the ament index, then an executable file in
    # lib/<package>.
    assert (installed / 'share/ament_index/resource_index/packages' / NAME).exists()
    assert (installed / 'share' / NAME / 'package.xml').exists()
    executable = installed / 'lib' / NAME / command
    assert os.access(executable, os.X_OK)
    packages, = installed.glob('lib/python*/site-packages')
    environment = {**os.environ, 'PYTHONPATH': str(packages),
                   'PATH': os.path.dirname(sys.executable) + os.pathsep + os.environ['PATH']}
    if command in NODES:
        pytest.importorskip('rclpy', reason='ROS 2 (rclpy) is not installed')
    result = subprocess.run([executable, '--help'], env=environment, cwd='/', check=True,
                            capture_output=True, text=True)
    assert f'usage: {command}' in result.stdout


@pytest.mark.slow
def test_what_else_is_installed(installed):
    packages, = installed.glob('lib/python*/site-packages')
    assert (packages / NAME / 'py.typed').exists()
    share = installed / 'share' / NAME
    assert (share / 'config' / 'iss.yaml').exists()
    assert (share / 'config' / 'security' / 'rigid_body_ros.policy.xml').exists()
    assert {path.name for path in (share / 'launch').glob('*.py')} \
        == {path.name for path in (ROOT / 'launch').glob('*.py')}


@pytest.mark.parametrize('path', [*sorted((ROOT / 'launch').glob('*.py')),
                                  ROOT / NAME / 'launching.py'], ids=lambda p: p.name)
def test_no_launch_file_hands_its_arguments_to_a_shell(path):
    # In a shell a namespace such as "a; rm -r b" is a command.
    tree = ast.parse(path.read_text())
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import)
                for alias in node.names} | \
        {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not imported & {'os', 'subprocess'}
    assert not [node.arg for node in ast.walk(tree)
                if isinstance(node, ast.keyword) and node.arg in ('shell', None)]
    assert not {'sh', 'bash', '-c', '&&', '||', '|', ';'} & {
        node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)}


@pytest.mark.slow
def test_the_version_is_that_of_package_xml(installed):
    version = ElementTree.parse(ROOT / 'package.xml').getroot().findtext('version')
    packages, = installed.glob('lib/python*/site-packages')
    found, = metadata.distributions(name=NAME, path=[str(packages)])
    assert found.version == version
    assert f'\n{version} (' in (ROOT / 'CHANGELOG.rst').read_text()


def test_the_lowest_versions_are_those_of_the_tested_environment():
    pins = dict(re.findall(r'^([\w-]+)==(.*)$', (ROOT / 'test' / 'lowest.txt').read_text(), re.M))
    text = (ROOT / 'setup.py').read_text()
    lists = re.findall(r"(?:install_requires=|'ensemble': )(\[.*?\])", text, re.S)
    required = [one.split(';')[0] for found in lists for one in ast.literal_eval(found)]
    assert len(lists) == 2
    for requirement in required:
        name, bound = re.fullmatch('([A-Za-z0-9]+)>=([0-9.]+).*', requirement).groups()
        if name != 'zarr':  # zarr needs a later Python than the others
            assert f'{pins.pop(name)}.'.startswith(f'{bound}.'), requirement
    assert {*pins} == {'pillow', 'pyparsing'}
    for depend in ElementTree.parse(ROOT / 'package.xml').getroot().iter('exec_depend'):
        name = depend.text.removeprefix('python3-')
        if bound := depend.get('version_gte'):
            name = {'yaml': 'PyYAML'}.get(name, name)
            assert any(one.startswith(f'{name}>={bound}') for one in required), name


def test_every_source_file_begins_with_the_license():
    if not (ROOT / '.git').exists():
        pytest.skip('not a clone: only git tells which files are ours')
    _, notice = (ROOT / 'LICENSE').read_text().split('[name of copyright owner]\n')
    lines = ['Copyright 2026 The rigid_body_ros developers', *textwrap.dedent(notice).splitlines()]
    header = ''.join(f'# {line}'.rstrip() + '\n' for line in lines) + '\n'
    listed = subprocess.run(['git', 'ls-files', '*.py'], cwd=ROOT, check=True,
                            capture_output=True, text=True).stdout.splitlines()
    assert len(listed) > 100
    for name in listed:
        assert (ROOT / name).read_text().startswith(header), name


@pytest.mark.slow
def test_the_node_says_what_it_needs_where_ros_is_not():
    script = ("import sys; sys.modules['rclpy'] = None; "
              'from rigid_body_ros.commands import main; sys.exit(main.attitude_node())')
    result = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                            check=False)
    assert result.returncode == 2
    line, = result.stderr.splitlines()
    assert line.startswith('attitude_node: error: attitude_node needs ROS 2')
    assert "pip install '.[ros]' in a clone of rigid_body_ros" in line


@pytest.mark.slow
@pytest.mark.parametrize('module', ['mcap', *at_night('zstandard', 'lz4', 'matplotlib', 'tqdm')])
def test_a_module_that_is_missing_is_named_with_how_to_get_it(module, tmp_path):
    script = (f"import sys; sys.modules['{module}'] = None; "
              'from rigid_body_ros.commands import main; sys.exit(main.attitude_replay())')
    result = subprocess.run(
        [sys.executable, '-c', script, RECORDINGS / 'tumbler.mcap', '--scene',
         CONFIG / 'tumbler.yaml', '-o', tmp_path / 'o.mcap', '--plot', tmp_path / 'o.png'],
        capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert result.stderr == (f"attitude_replay: error: Python module '{module}' is not "
                             f'installed; run python3 -m pip install {module}\n')


@pytest.mark.slow
def test_the_library_and_the_offline_commands_need_no_ros():
    script = ('import sys, rigid_body_ros, rigid_body_ros.recording, rigid_body_ros.replay; '
              "print([name for name in sys.modules if name.split('.')[0] in "
              "('rclpy', 'geometry_msgs', 'nav_msgs', 'rcl_interfaces')])")
    result = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                            check=True)
    assert result.stdout.strip() == '[]'


@pytest.mark.slow
def test_scipy_is_not_imported_with_the_library():
    script = "import sys; import rigid_body_ros; print('scipy.spatial' in sys.modules)"
    result = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                            check=True)
    assert result.stdout.strip() == 'False'


@pytest.mark.slow
def test_without_ros_the_tests_of_the_node_are_left_out_and_the_report_says_so():
    script = "import sys; sys.modules['rclpy'] = None; import pytest; sys.exit(pytest.main())"
    result = subprocess.run([sys.executable, '-c', script], cwd=ROOT, capture_output=True,
                            text=True, check=False, env={
                                **os.environ, 'PYTEST_ADDOPTS': '--ignore-glob=*/test_[!n]*.py'})
    assert result.returncode == pytest.ExitCode.NO_TESTS_COLLECTED, result.stdout
    line, = re.findall('^rclpy is not installed.*', result.stdout, re.MULTILINE)
    assert 'test_node.py' in line


@pytest.mark.nightly
@pytest.mark.parametrize('module', NEEDS)
def test_without_an_optional_module_all_other_tests_are_collected(module):
    # zarr has a plugin: without the last two options, pytest would fail to import it.
    script = (f"import sys; sys.modules['{module}'] = None; import pytest; sys.exit(pytest.main("
              f"['--collect-only', '--quiet', '--assert=plain', '-p', 'no:{module}']))")
    result = subprocess.run([sys.executable, '-c', script], cwd=ROOT, capture_output=True,
                            text=True, check=False)
    assert result.returncode == pytest.ExitCode.OK, result.stdout[-3000:]


@pytest.mark.skipif(os.geteuid() != 0, reason='only root can be another user')
@pytest.mark.parametrize('first', [0, 65534])
def test_users_of_one_machine_lock_the_same_domains(first):
    with TemporaryDirectory() as folder:
        os.chmod(folder, 0o1777)
        path = Path(folder) / 'rigid_body_ros.1.lock'
        with user(first), locked(path):
            pass
        with user(65534 - first), locked(path), user(first), pytest.raises(BlockingIOError), \
                locked(path):
            pass


@contextmanager
def user(number):
    """Act as another user within the context."""
    before, mask = os.geteuid(), os.umask(0o077)
    os.seteuid(0)
    os.seteuid(number)
    try:
        yield
    finally:
        os.seteuid(0)
        os.seteuid(before)
        os.umask(mask)
