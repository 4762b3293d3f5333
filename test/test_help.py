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

"""The help of the commands: its examples run as they stand, on files of the repository."""

import os
import shlex
import sys
import xml.etree.ElementTree as ElementTree

from conftest import ROOT
import pytest
from rigid_body_ros.commands import main

NODES = 'node', 'lifecycle', 'controller', 'monitor'
COMMANDS = [name for name in vars(main) if name.startswith('attitude_')
            and name.split('_')[1] not in NODES]


def printed(capsys, name, option):
    with pytest.raises(SystemExit) as ended:
        getattr(main, name)([option])
    assert not ended.value.code
    return capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize('name', [
    pytest.param(name, marks=pytest.mark.ros) if name == 'attitude_regress' else name
    for name in COMMANDS])
def test_the_examples_of_the_help_run(name, capsys, tmp_path, monkeypatch):
    if name == 'attitude_regress':  # it starts another of the commands
        pytest.importorskip('rclpy', reason='ROS 2 (rclpy) is not installed')
        monkeypatch.setenv('PATH', os.path.dirname(sys.executable), os.pathsep)
    _, *examples = printed(capsys, name, '--help').split('examples, in a clone')[1].splitlines()
    assert len(examples) == 2
    for number, example in enumerate(examples):
        place = tmp_path / str(number)  # both may write the same names
        place.mkdir()
        for folder in ('config', 'examples', 'test'):
            (place / folder).symlink_to(ROOT / folder)
        monkeypatch.chdir(place)
        command, *arguments = shlex.split(example)
        assert command == name
        assert getattr(main, name)(arguments) == 0, capsys.readouterr().err


def test_the_version_is_that_of_the_package(capsys):
    version = ElementTree.parse(ROOT / 'package.xml').findtext('version')
    for name in COMMANDS:
        assert printed(capsys, name, '--version') == f'{name} {version}\n'
