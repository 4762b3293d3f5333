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

"""
The commands on the pages: each runs as shown on shipped files, or says what it needs.

The commands of a page run one after the other, in a folder that looks like the repository. If a
block of text follows a block of commands, it must be their output. A block that begins with
`# needs` does not run, with one exception: what a block with `# needs ROS 2` starts is started.
"""

from contextlib import redirect_stderr, redirect_stdout
import doctest
import io
import os
import re
import shlex
import subprocess
import sys

from conftest import ROOT
import pytest
from rigid_body_ros.commands import main
import test_docs

#: Lines that vary from run to run, or with the BLAS of the processor.
_VARIABLE = re.compile(r'^speed +\d.*\n|^fit +converged .*\n|^\* .*\n', re.MULTILINE)
_SHOWN = re.compile(r'^```bash\n(.*?)^```$(?:\n\n```text\n(.*?)^```$)?', re.DOTALL | re.MULTILINE)
_STATUS = re.compile(r'# exit status (\d)')
_COMMAND = re.compile(r'^(?:attitude_\w+ |ros2 |python3? |pip |make |\$ )', re.MULTILINE)
_FOLDERS = 'config', 'docs', 'examples', 'launch', 'test'
#: s; how long to wait for a command.
PATIENCE = 300


def blocks(page):
    """Return the language and the text of each fenced block of a page, except those of Sphinx."""
    found = test_docs._FENCE.finditer(page.read_text(encoding='utf-8'))
    return [(match[2], match[3]) for match in found if not match[0].startswith('```{')]


def outputs(page):
    """Return the blocks of commands, each with the text that follows immediately, or None."""
    text = page.read_text(encoding='utf-8')
    return [(match[1], match[2]) for match in _SHOWN.finditer(text)]


def commands(text):
    """Return the commands of a block, one line each."""
    return [line for line in text.replace('\\\n', ' ').splitlines()
            if line.strip() and not line.startswith('#')]


def needs(text):
    """Return what a block needs beyond the repository, or an empty text."""
    return text.partition('\n')[0].removeprefix('# needs ') if text.startswith('# needs ') else ''


def of(needed):
    """Return, as test parameters, the pages with a block of commands that needs this."""
    return pytest.mark.parametrize('page', [page for page in test_docs.PAGES if any(
        language == 'bash' and needs(text) == needed for language, text in blocks(page))],
        ids=lambda page: page.name)


def run(line):
    """Run a command, and return its output; its status must be the one in its comment."""
    expected = int(match[1]) if (match := _STATUS.search(line)) else 0
    name, *words = shlex.split(line, comments=True)
    printed = io.StringIO()
    if name.startswith('attitude_'):
        with redirect_stdout(printed), redirect_stderr(printed):
            status = getattr(main, name)(words)
    else:
        assert name in ('python', 'python3')
        result = subprocess.run([sys.executable, *words], check=False, text=True, timeout=PATIENCE,
                                stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        status = result.returncode
        printed.write(result.stdout)
    assert (status or 0) == expected, f'{line}\n{printed.getvalue()}'
    return printed.getvalue()


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """Work in a folder with the files of the repository."""
    for folder in _FOLDERS:
        (tmp_path / folder).symlink_to(ROOT / folder)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))  # as if commands were started in this folder
    return tmp_path


@pytest.mark.parametrize('page', test_docs.PAGES, ids=lambda page: page.name)
def test_every_block_has_a_language_and_commands_are_bash(page):
    assert [text for language, text in blocks(page) if not language] == []
    assert [text for language, text in blocks(page)
            if language == 'text' and _COMMAND.search(text)] == []


@pytest.mark.nightly
@of('')
def test_the_commands_of_a_page_run_and_print_what_it_shows(page, clone):
    for text, shown in outputs(page):
        if not needs(text):
            printed = [run(line) for line in commands(text)][-1]
            expected, found = (_VARIABLE.sub('', each) for each in (shown or '...', printed))
            flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
            assert doctest.OutputChecker().check_output(expected, found, flags), printed


@pytest.mark.ros
@pytest.mark.nightly
@of('ROS 2')
def test_what_a_page_starts_with_ros_starts(page, clone, domain, monkeypatch):
    rclpy = pytest.importorskip('rclpy', reason='ROS 2 (rclpy) is not installed')
    from rigid_body_ros.node import AttitudeNode
    from rigid_body_ros.node.attitude_monitor import AttitudeMonitor
    nodes = {'attitude_node': AttitudeNode, 'attitude_monitor': AttitudeMonitor}
    monkeypatch.setenv('PATH', os.path.dirname(sys.executable), os.pathsep)
    for line in [line for language, text in blocks(page)
                 if language == 'bash' and needs(text) == 'ROS 2' for line in commands(text)]:
        words = shlex.split(line, comments=True)
        if words[0] == 'attitude_regress':
            # On a busy machine a loop takes longer than the command allows by default.
            run(line.replace(' -- ', f' --timeout {PATIENCE} -- ', 1))
        elif words[:3] == ['ros2', 'run', 'rigid_body_ros'] and words[3] in nodes:
            context = rclpy.Context()
            rclpy.init(args=words[4:], context=context, domain_id=domain)
            node = nodes[words[3]](context=context)
            node.destroy_node()
            rclpy.try_shutdown(context=context)
