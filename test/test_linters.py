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

"""The linters of ROS, with the settings of ROS, and rules that no linter checks."""

from collections import Counter
import re
import shutil
import subprocess
import sys

from conftest import at_night, ROOT
import pytest

PYTHON = ['benchmarks', 'build_kernels', 'docs', 'examples', 'launch', 'rigid_body_ros',
          'setup.py', 'test']


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
