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

"""The package as pip and colcon install it, what it imports, and the rules for its files."""

import ast
from collections import Counter
from importlib import metadata
from importlib.util import find_spec
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import textwrap
import xml.etree.ElementTree as ElementTree

from conftest import at_night, CONFIG, NAME, NEEDS, program, RECORDINGS, ROOT
import pytest
import rigid_body_ros
from rigid_body_ros import messages, recording

NODES = ('attitude_controller', 'attitude_lifecycle_node', 'attitude_monitor', 'attitude_node')
OFFLINE = ('attitude_compare', 'attitude_design', 'attitude_ensemble', 'attitude_identify',
           'attitude_regress', 'attitude_replay', 'attitude_tradeoff')
REPLAY = [str(RECORDINGS / 'tumbler.mcap'), '--scene', str(CONFIG / 'tumbler.yaml')]
PYTHON = ['benchmarks', 'build_kernels', 'docs', 'examples', 'launch', 'rigid_body_ros',
          'setup.py', 'test']
NEEDS_ROS = pytest.mark.skipif(find_spec('rclpy') is None,
                               reason='ROS 2 (rclpy) is not installed')
#: A command that does what `ros2 run PACKAGE EXECUTABLE` does: it finds the prefix of the package
#: in the ament index, and there an executable file in lib/PACKAGE.
RUN = (f'prefix=$({sys.executable} -c "from ament_index_python.packages import '
       f'get_package_prefix; print(get_package_prefix(\'{NAME}\'))") && $prefix/lib/{NAME}/')


def python(script, *arguments, **options):
    """Run a script in a new process."""
    return subprocess.run([sys.executable, '-c', script, *map(str, arguments)], text=True,
                          capture_output=True, check=False, **options)


def output(*command, **options):
    """Return what a command prints; no package outside of this environment is found."""
    environment = {**os.environ, 'AMENT_PREFIX_PATH': sys.prefix, 'PYTHONPATH': ''}
    result = subprocess.run(command, text=True, env=environment, check=False, capture_output=True,
                            **options)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def shared_files():
    """Return the files that the package installs in its share folder."""
    return {str(path.relative_to(ROOT)) for folder in ('config', 'launch')
            for path in (ROOT / folder).rglob('*.*') if path.suffix != '.pyc'} | {'package.xml'}


@pytest.mark.slow
def test_a_pip_install_has_what_ros_and_type_checkers_look_for(installed):
    packages, = installed.glob('lib/python*/site-packages')
    assert (packages / NAME / 'py.typed').exists()
    modules = (path.relative_to(ROOT) for path in (ROOT / NAME).rglob('*.py'))
    assert all((packages / module).exists() for module in modules)
    assert (installed / 'share/ament_index/resource_index/packages' / NAME).exists()
    assert all((installed / 'share' / NAME / name).exists() for name in shared_files())
    assert all(os.access(installed / 'lib' / NAME / command, os.X_OK)
               for command in NODES + OFFLINE)
    version = ElementTree.parse(ROOT / 'package.xml').getroot().findtext('version')
    found, = metadata.distributions(name=NAME, path=[str(packages)])
    assert found.version == version
    assert f'\n{version} (' in (ROOT / 'CHANGELOG.rst').read_text()


def built(folder, *options):
    """Build the files of this checkout in a workspace, and return its folder."""
    source = folder / 'src' / NAME
    source.mkdir(parents=True)
    listed = output('git', 'ls-files', '--cached', '--others', '--exclude-standard', cwd=ROOT)
    files = [name for name in listed.splitlines() if (ROOT / name).exists()]
    if (ROOT / 'build' / 'kernels').exists():  # generating the kernels takes a minute
        files.append('build/kernels')
    output('cp', '-r', '--parents', '-t', source, *files, cwd=ROOT)
    colcon(folder, 'build', *options)
    return folder


def colcon(folder, *arguments):
    return output('env', f'COLCON_HOME={folder}', sys.executable, '-m', 'colcon', *arguments,
                  cwd=folder)


def sourced(folder, command, cwd):
    """Return the output of a command in a shell that has sourced the workspace."""
    setup = shlex.quote(str(folder / 'install' / 'setup.bash'))
    return output('bash', '-c', f'. {setup} && {command}', cwd=cwd)


@pytest.fixture(scope='module')
def workspace(tmp_path_factory):
    """Return a workspace in which the package is built."""
    for module in ('rclpy', 'colcon_ros'):
        pytest.importorskip(module, reason=f'{module} is not installed')
    return built(tmp_path_factory.mktemp('workspace'))


@pytest.mark.slow
def test_a_workspace_is_sourced_found_and_run(workspace, tmp_path):
    imported = f'{sys.executable} -c "import {NAME}; print({NAME}.__file__)"'
    assert sourced(workspace, imported, tmp_path).startswith(str(workspace))
    share = (f'{sys.executable} -c "from ament_index_python.packages import '
             f'get_package_share_directory; print(get_package_share_directory(\'{NAME}\'))"')
    files = f'cd $({share}) && find package.xml config launch -type f'
    assert {*sourced(workspace, files, tmp_path).split()} == shared_files()
    assert 'usage: attitude_node' in sourced(workspace, f'{RUN}attitude_node --help', tmp_path)


@pytest.mark.nightly
def test_a_workspace_of_links_does_its_work_as_well(tmp_path):
    pytest.importorskip('colcon_ros', reason='colcon_ros is not installed')
    (tmp_path / 'log.csv').write_text('1.0,0,0,0\n2.0,0.1,0,0\n2.1,0,0,0\n')
    built(tmp_path, '--symlink-install')
    sourced(tmp_path, f'{RUN}attitude_replay log.csv --scene {CONFIG / "tumbler.yaml"} -o '
            'motion.mcap', tmp_path)
    assert len(recording.read(tmp_path / 'motion.mcap', '/attitude', messages.QUATERNION)) == 3


@pytest.mark.slow
def test_colcon_runs_the_tests_and_finds_no_failure(workspace):
    # Only the tests of one file, because running all tests would run this test again.
    colcon(workspace, 'test', '--pytest-args', 'test/test_euler.py')
    said = colcon(workspace, 'test-result')
    assert ' 0 errors, 0 failures' in said
    assert 'Summary: 0 tests' not in said


#: Run a command that signals itself when it imports numpy, which every module of the engine needs.
#: Then the import continues, waits for a slow disk, or fails, as it does if C code imports a
#: module and the exception of a signal handler arrives there.
INTERRUPTED = """
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
    ('attitude_replay', signal.SIGTERM, 'pass'),
    ('attitude_replay', signal.SIGINT, 'time.sleep(60)'),
    ('attitude_replay', signal.SIGINT, 'raise ImportError'),
    pytest.param('attitude_node', signal.SIGINT, 'pass', marks=NEEDS_ROS)])
def test_a_signal_during_the_imports_ends_a_command_in_one_line(command, number, then, tmp_path):
    options = [tmp_path / 'input.mcap', '--scene', tmp_path / 'scene.yaml']
    result = python(INTERRUPTED, int(number), then, command,
                    *options if command == 'attitude_replay' else ())
    assert result.stderr == f'{command}: interrupted; no partial output was left\n'
    assert result.returncode == 128 + number


@pytest.mark.slow
@pytest.mark.parametrize(('imported', 'unused'), [
    ('commands.main', ['numpy']),
    pytest.param(f'commands.main; rigid_body_ros.commands.main.attitude_replay({REPLAY})', [
        'matplotlib', *(f'rigid_body_ros.{name}' for name in (
            'report.charts', 'report.moving_body', 'report.page', 'report.thinning', 'ensemble'))],
        id='a replay without a page'),
    ('recording, rigid_body_ros.replay', ['rclpy', 'geometry_msgs', 'nav_msgs', 'rcl_interfaces']),
    pytest.param('commands.replay, rigid_body_ros.node.attitude_node', [
        'matplotlib', 'tqdm', 'mcap', 'zstandard', 'scipy.spatial', 'scipy.linalg',
        'rigid_body_ros.recording', 'rigid_body_ros.replay'], marks=NEEDS_ROS),
    pytest.param('node.attitude_controller', ['rigid_body_ros.propagation'], marks=NEEDS_ROS)])
def test_only_what_is_used_is_imported(imported, unused):
    result = python(f'import sys, rigid_body_ros.{imported}\n'
                    f'print([name for name in {unused} if name in sys.modules])')
    assert result.stdout.endswith('[]\n'), result.stderr


@pytest.mark.slow
def test_the_engine_is_imported_when_a_name_is_first_used():
    result = python("""
import sys
import rigid_body_ros, rigid_body_ros.commands.main
assert 'numpy' not in sys.modules
assert set(rigid_body_ros.__all__) < set(dir(rigid_body_ros))
assert rigid_body_ros.so3 is sys.modules['rigid_body_ros.mechanics.so3']
from rigid_body_ros import *
assert propagate is rigid_body_ros.propagation.propagate
assert RigidBody is rigid_body_ros.RigidBody is vars(rigid_body_ros)['RigidBody']
""")
    assert result.stderr == ''


def test_a_name_that_the_package_does_not_have_is_reported_as_for_any_module():
    with pytest.raises(AttributeError, match="^module 'rigid_body_ros' has no attribute 'spin'$"):
        _ = rigid_body_ros.spin
    with pytest.raises(ImportError, match="cannot import name 'spin' from 'rigid_body_ros'"):
        from rigid_body_ros import spin  # noqa: F401


def without(module, then):
    """Return a script for an environment without a module."""
    return f'import sys; sys.modules[{module!r}] = None; {then}'


@pytest.mark.slow
def test_the_node_says_what_it_needs_where_ros_is_not():
    result = python(without('rclpy', program('attitude_node')[-1]))
    assert result.returncode == 2
    line, = result.stderr.splitlines()
    assert line.startswith('attitude_node: error: attitude_node needs ROS 2')
    assert "pip install '.[ros]' in a clone of rigid_body_ros" in line


@pytest.mark.slow
@pytest.mark.parametrize('module', ['mcap', *at_night('zstandard', 'lz4', 'matplotlib', 'tqdm')])
def test_a_module_that_is_missing_is_named_with_how_to_get_it(module, tmp_path):
    result = python(without(module, program('attitude_replay')[-1]),
                    *REPLAY, '-o', tmp_path / 'o.mcap', '--plot', tmp_path / 'o.png')
    assert result.returncode == 2
    assert result.stderr == (f"attitude_replay: error: Python module '{module}' is not "
                             f'installed; run python3 -m pip install {module}\n')


@pytest.mark.slow
def test_without_ros_the_tests_of_the_node_are_left_out_and_the_report_says_so():
    result = python(without('rclpy', 'import pytest; sys.exit(pytest.main())'), cwd=ROOT, env={
        **os.environ,
        'PYTEST_ADDOPTS': '--ignore-glob=*/test_no[!d]*.py --ignore-glob=*/test_[!n]*.py'})
    assert result.returncode == pytest.ExitCode.NO_TESTS_COLLECTED, result.stdout
    line, = re.findall('^rclpy is not installed.*', result.stdout, re.MULTILINE)
    assert 'test_node.py' in line


@pytest.mark.nightly
@pytest.mark.parametrize('module', NEEDS)
def test_without_an_optional_module_all_other_tests_are_collected(module):
    # zarr has a plugin: without the last two options, pytest would fail to import it.
    result = python(without(module, 'import pytest; sys.exit(pytest.main(sys.argv[1:]))'),
                    '--collect-only', '--quiet', '--assert=plain', '-p', f'no:{module}', cwd=ROOT)
    assert result.returncode == pytest.ExitCode.OK, result.stdout[-3000:]


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
    listed = output('git', 'ls-files', '*.py', cwd=ROOT).splitlines()
    assert len(listed) > 100
    for name in listed:
        assert (ROOT / name).read_text().startswith(header), name


@pytest.mark.slow
@pytest.mark.filterwarnings('ignore')  # those about the linters themselves
@pytest.mark.parametrize(('linter', 'paths'), [
    ('ament_copyright', [*PYTHON, 'CONTRIBUTING.md', 'LICENSE']),
    # These take a minute, and ruff checks most of the same rules.
    *at_night(('ament_flake8', PYTHON), ('ament_pep257', PYTHON)),
    ('ament_xmllint', ['package.xml', 'config/security'])])
def test_the_linters_of_ros_find_no_problem(linter, paths):
    pytest.importorskip(f'{linter}.main', reason=f'{linter} is not installed as a whole')
    if linter == 'ament_xmllint' and not shutil.which('xmllint'):
        pytest.skip('xmllint is not installed')
    # In a new process, because flake8 forks, and a fork of a process with ROS nodes crashes.
    subprocess.run([sys.executable, '-W', 'ignore', '-c', 'import sys; from '
                    f'{linter}.main import main; sys.exit(main(sys.argv[1:]))', *paths],
                   cwd=ROOT, check=True)


def test_a_class_name_is_defined_once():
    names = Counter()
    for path in (ROOT / 'rigid_body_ros').rglob('*.py'):
        names.update(re.findall(r'^ *class (\w+)[(:]', path.read_text(encoding='utf-8'),
                                re.MULTILINE))
    assert sorted(name for name, count in names.items() if count > 1) == []
