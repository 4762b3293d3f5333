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

"""The help of the commands: its examples run as printed, on files of the repository."""

import json
import os
import re
import shlex
import sys
import xml.etree.ElementTree as ElementTree

from conftest import CONFIG, RECORDINGS, ROOT
import pytest
from rigid_body_ros import commands, identify, read
from rigid_body_ros.commands import main
from rigid_body_ros.comparison.comparison import compare_recording
from rigid_body_ros.identification.recorded import read_experiments
from rigid_body_ros.recording import Reading
from rigid_body_ros.replay import replay
from rigid_body_ros.scene import load

NODES = 'node', 'lifecycle', 'controller', 'monitor'
COMMANDS = [name for name in re.findall(r"'(attitude_\w+)'", (ROOT / 'setup.py').read_text())
            if name.split('_')[1] not in NODES]
#: Marks for commands whose examples take a quarter of a minute.
SLOWEST = {'attitude_regress': [pytest.mark.ros, pytest.mark.nightly],
           'attitude_design': pytest.mark.nightly, 'attitude_tradeoff': pytest.mark.nightly}


def printed(capsys, name, option):
    with pytest.raises(SystemExit) as ended:
        getattr(main, name)([option])
    assert not ended.value.code
    return capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize('name', [
    pytest.param(name, marks=SLOWEST.get(name, ())) for name in COMMANDS])
def test_the_examples_of_the_help_run(name, capsys, tmp_path, monkeypatch):
    if name == 'attitude_regress':  # starts another command of the package
        pytest.importorskip('rclpy', reason='ROS 2 (rclpy) is not installed')
        monkeypatch.setenv('PATH', os.path.dirname(sys.executable), os.pathsep)
    _, *examples = printed(capsys, name, '--help').split('examples, in a clone')[1].splitlines()
    assert len(examples) == 2
    for number, example in enumerate(examples):
        place = tmp_path / str(number)  # both examples may write the same names
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


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'result'), [
    ('attitude_replay', replay), ('attitude_compare', compare_recording),
    ('attitude_identify', lambda path, scene: identify(
        scene.body, read_experiments([path], scene, Reading(('/mocap',)))))])
def test_a_command_prints_its_result_as_python_does(name, result, capsys):
    path, scene = RECORDINGS / 'flight.mcap', CONFIG / 'tumbler.yaml'
    options = ['--measured', '/mocap'] if name == 'attitude_identify' else []
    assert getattr(main, name)([str(path), '--scene', str(scene), *options]) == 0
    expected = re.sub(r'\nspeed .*', '', str(result(path, load(scene))))
    assert re.sub(r'\nspeed .*', '', capsys.readouterr().out) == f'{expected}\n'


def test_the_command_of_the_design_is_complete(tmp_path, monkeypatch, capsys):
    page = (ROOT / 'docs' / 'design.md').read_text()
    code, = re.findall('```python\n("""The command.*?)```', page, re.DOTALL)
    (tmp_path / 'energy.py').write_text(code)
    monkeypatch.setattr(commands, '__path__', [*commands.__path__, str(tmp_path)])
    scene, recording = CONFIG / 'tumbler.yaml', RECORDINGS / 'tumbler.mcap'
    files = [tmp_path / 'energy.json', tmp_path / 'energy.html']
    arguments = [*map(str, (recording, '--scene', scene, '--json', files[0],
                            '--report', files[1]))]
    assert main.attitude_energy(arguments) == 0
    problem = read(recording, scene)
    energy, = problem.propagate(at=problem.stamps_ns[-1:]).kinetic_energy.tolist()
    assert capsys.readouterr().out == \
        f'energy        {energy} J\nwrote         {files[0]}, {files[1]}\n'
    assert json.loads(files[0].read_text()) == {'energy_J': energy}
    assert f'{energy} J' in files[1].read_text()
    assert main.attitude_energy(arguments) == 2
    assert 'output exists' in capsys.readouterr().err
    assert main.attitude_energy([*arguments[:4], str(scene), '--overwrite']) == 2
    assert 'would overwrite the scene' in capsys.readouterr().err
    assert 'attitude_energy' in printed(capsys, 'attitude_energy', '--help')
