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

"""No command overwrites its inputs: try every output on every input, under every name."""

import os
from pathlib import Path
import subprocess
import sys

from conftest import CONFIG, files_up_to, RECORDINGS, SECOND
import pytest
from rigid_body_ros import messages, recording, scene
from rigid_body_ros.commands import main
from rigid_body_ros.replay import replay
from rigid_body_ros.replay.many import replay_many
from rigid_body_ros.scene import InputError

#: Commands with an output option, and the suffix of the file that the option writes.
OUTPUTS = {'replay -o': '.mcap', 'replay --csv': '.csv', 'replay --plot': '.png',
           'many -o': '.mcap', 'tradeoff --json': '.json', 'tradeoff --plot': '.png',
           'tradeoff --report': '.html', 'library replay': '.mcap', 'library many': '.mcap'}
#: Inputs to attack: the recording that a command gets, and a file of it (or the scene).
VICTIMS = {'mcap': ('in/log.mcap', 'in/log.mcap'), 'csv': ('in/log.csv', 'in/log.csv'),
           'bag': ('in/bag', 'in/bag/bag_0.mcap'), 'folder': ('in/bag', 'in/bag'),
           'metadata': ('in/bag', 'in/bag/metadata.yaml'),
           'file of a bag': ('in/bag/bag_0.mcap', 'in/bag/bag_0.mcap'),
           'scene': ('in/log.mcap', 'in/scene.yaml')}


@pytest.fixture
def place(tmp_path, monkeypatch, short_trades):
    """Work in a folder that contains one input of each kind, and a folder `out` for aliases."""
    for folder in ('in', 'out', 'other'):
        (tmp_path / folder).mkdir()
    for path, kind in (('in/log.mcap', recording.Writer), ('in/bag', recording.FolderWriter)):
        with kind(tmp_path / path) as writer:
            writer.add_topic('/torque', messages.WRENCH)
            for stamp_ns in (SECOND, 2 * SECOND):
                writer.write('/torque', stamp_ns, messages.wrench(stamp_ns, '', [0.1, 0.0, 0.0]))
    for name in ('in/log.csv', 'other/second.csv', 'other/log.csv', 'other/bag_0.csv'):
        (tmp_path / name).write_text('1,0.1,0,0\n2,0.1,0,0\n')
    (tmp_path / 'in' / 'scene.yaml').write_text((CONFIG / 'tumbler.yaml').read_text())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def contents(folder):
    """Return everything below a folder: type, mode, link target or bytes, and inode."""
    found = {}
    for path in folder.rglob('*'):
        status = path.lstat()
        what = os.readlink(path) if path.is_symlink() else \
            path.read_bytes() if path.is_file() else None
        found[str(path)] = status.st_mode, status.st_ino, what
    return found


#: Functions that create another name of a file in an empty folder.
ALIASES = {
    'the same': lambda victim, alias: victim,
    'relative': lambda victim, alias: Path('other', '..', '.', *victim.parts),
    'absolute': lambda victim, alias: victim.absolute(),
    'symbolic link': lambda victim, alias: linked(victim, alias),
    'link to a link': lambda victim, alias: linked(linked(victim, alias.with_name('link')), alias),
    'hard link': lambda victim, alias: (alias.hardlink_to(victim), alias)[1],
    'linked folder': lambda victim, alias: linked(
        victim.parent, alias.with_name('folder')) / victim.name,
}


def linked(target, link):
    link.symlink_to(target.absolute())
    return link


def run(option, recorded, output, overwrite=('--overwrite',)):
    """Let an option write to a path; return the exit status."""
    command, option = option.split()
    arguments = ['--scene', 'in/scene.yaml', *overwrite]
    second = str(Path('other', output.with_suffix('.csv').name))
    if command == 'replay':
        return main.attitude_replay([recorded, *arguments, *(
            ['-o', 'other/motion.mcap'] * (option == '--plot')),
            option if option == '--plot' else '-o', str(output)])
    if command == 'many':
        return main.attitude_replay([recorded, second, *arguments, '-o', str(output.parent)])
    if command == 'tradeoff':
        return main.attitude_tradeoff(['--recording', recorded, *arguments, option, str(output)])
    with pytest.raises(InputError) as error:
        loaded = scene.load('in/scene.yaml')
        if option == 'replay':
            replay(recorded, loaded, output)
        else:
            replay_many([recorded, second], loaded, output.parent)
    print(error.value, file=sys.stderr)
    return 2


#: Every option attacks one input under each name, and one option attacks every input.
ATTACKS = [(option, 'scene') for option in OUTPUTS] + [('replay -o', name) for name in VICTIMS
                                                       if name != 'scene']


@pytest.mark.slow
@pytest.mark.parametrize(('option', 'victim'), [*ATTACKS, ('many -o', 'mcap')])
def test_an_output_never_replaces_an_input(place, capsys, option, victim):
    recorded, attacked = VICTIMS[victim]
    attacked = Path(attacked)
    # --many always appends the suffix .mcap to the name.
    links = [name for name in ALIASES if 'many' not in option or attacked.suffix == '.mcap'
             or ('link' in name and name != 'linked folder')]
    for name in [name for name in links if name != 'hard link' or attacked.is_file()]:
        folder = Path('out', name)
        folder.mkdir()
        output = ALIASES[name](attacked, folder / f'second{OUTPUTS[option]}')
        before = contents(place)
        assert run(option, recorded, output) == 2, name
        captured = capsys.readouterr()
        line, = captured.err.splitlines()
        assert ': would overwrite the ' in line or ': would be written into the folder ' in line
        assert not captured.out
        assert contents(place) == before, name


@pytest.mark.slow
@pytest.mark.parametrize('option', ['replay -o', 'replay --csv', 'many -o', 'tradeoff --json'])
def test_a_command_keeps_an_existing_output_unless_told_to_overwrite(place, capsys, option):
    output = Path('out', f'second{OUTPUTS[option]}')
    output.write_text('old')
    before = contents(place)
    assert run(option, 'in/log.mcap', output, overwrite=()) == 2
    captured = capsys.readouterr()
    assert captured.err.endswith(
        f': error: {output}: output exists; choose another name, or add --overwrite\n')
    assert not captured.out
    assert contents(place) == before
    assert run(option, 'in/log.mcap', output) == 0
    assert output.read_bytes() != b'old'


@pytest.mark.parametrize('option', OUTPUTS)
def test_nothing_new_is_written_into_a_bag_that_is_read(place, capsys, option):
    Path('in/bag/deeper').mkdir()
    linked(Path('in/bag'), Path('out/folder'))
    linked(Path('in/bag'), Path('other/link'))
    linked(Path('in/bag/bag_0.mcap'), Path('other/file'))
    before = contents(place)
    recordings, folders = ['in/bag'], ['in/bag/deeper']
    if option == 'replay -o':
        recordings += ['in/bag/bag_0.mcap', 'other/link', 'other/file']
        folders += ['in/bag', 'out/folder']
    for recorded in recordings:
        for folder in folders:
            assert run(option, recorded, Path(folder, f'second{OUTPUTS[option]}')) == 2
            line, = capsys.readouterr().err.splitlines()
            assert ': would ' in line
            assert contents(place) == before


@pytest.mark.parametrize(('first', 'second'), [
    ('out/x.mcap', 'out/x.mcap'), ('out/x.mcap', 'out/../out/x.mcap'), ('out/x.mcap', 'out/x.png'),
    ('out/x.png', 'out/x.mcap')])
def test_two_outputs_never_have_one_name(place, capsys, first, second):
    Path('out/x.png').symlink_to('x.mcap')
    before = contents(place)
    assert main.attitude_replay(['in/log.mcap', '--scene', 'in/scene.yaml', '-o', first,
                                '--plot', second, '--overwrite']) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert contents(place) == before


def test_two_recordings_never_go_to_one_file(place, capsys):
    Path('out/second.mcap').symlink_to('log.mcap')
    before = contents(place)
    assert main.attitude_replay(['in/log.mcap', 'other/second.csv', '--scene', 'in/scene.yaml',
                                '-o', 'out']) == 2
    line, = capsys.readouterr().err.splitlines()
    assert 'out/second.mcap: would overwrite the output out/log.mcap' in line
    assert contents(place) == before


@pytest.mark.parametrize('option', OUTPUTS)
def test_outputs_are_checked_before_anything_is_read(place, capsys, option):
    Path('in/log.mcap').write_text('no recording')
    if 'library' not in option:  # the library gets a scene that was already read
        Path('in/scene.yaml').write_text('no scene')
    assert run(option, 'in/log.mcap', Path('in/log.mcap')) == 2
    line, = capsys.readouterr().err.splitlines()
    assert 'in/log.mcap: would overwrite the input in/log.mcap' in line


@pytest.mark.parametrize(('recorded', 'motion'), [('in/bag', 'motion.mcap'),
                                                  ('in/log.csv', 'motion')])
def test_verify_writes_nothing(place, recorded, motion):
    arguments = [recorded, '--scene', 'in/scene.yaml']
    assert main.attitude_replay([*arguments, '-o', f'out/{motion}']) == 0
    before = contents(place)
    assert main.attitude_replay([*arguments, '--verify', f'out/{motion}']) == 0
    assert contents(place) == before


def test_an_incomplete_output_leaves_an_input_with_the_name_of_its_partial_file(place, capsys):
    source = Path('out/motion.partial.mcap')
    source.write_bytes((RECORDINGS / 'tumbler.mcap').read_bytes())
    before = contents(place)
    with files_up_to(2_000_000):
        assert main.attitude_replay([str(source), '--scene', 'in/scene.yaml', '--rate', '1000',
                                    '-o', 'out/motion.mcap']) == 2
    line, = capsys.readouterr().err.splitlines()
    after = contents(place)
    kept = str(place / 'out' / 'motion.partial.2.mcap')
    assert f'what was written so far is in {kept}' in line
    assert after.pop(kept)
    assert after == before


@pytest.mark.parametrize(('kind', 'name'), [(recording.Writer, 'motion.mcap'),
                                            (recording.FolderWriter, 'motion')])
def test_a_folder_that_takes_the_name_meanwhile_is_not_replaced(place, kind, name):
    path, kept = Path('out', name), place / 'out' / 'motion.partial.mcap'
    left = f'what was written so far is in {kept}'
    with pytest.raises(InputError, match=f'found a folder; {left}|exists; .*; {left}'), \
            kind(path, keep_partial=True) as writer:
        writer.add_topic('/torque', messages.WRENCH)
        writer.write('/torque', SECOND, messages.wrench(SECOND, '', [0.1, 0.0, 0.0]))
        path.mkdir()
    assert sorted(Path('out').rglob('*')) == sorted([path, kept.relative_to(place)])
    assert recording.read(kept).stamps_ns.tolist() == [SECOND]


def test_a_copy_of_an_input_may_be_replaced(place):
    # Only the file itself is refused, not another one with the same content.
    Path('out/log.mcap').write_bytes(Path('in/log.mcap').read_bytes())
    assert main.attitude_replay(['in/log.mcap', '--scene', 'in/scene.yaml', '-o',
                                'out/log.mcap', '--overwrite']) == 0
    assert recording.read('out/log.mcap', '/attitude', messages.QUATERNION).stamps_ns.size == 2


COMMAND = [sys.executable, '-c', 'import sys; from rigid_body_ros.commands import main; '
           'sys.exit(getattr(main, sys.argv.pop(1))())']
REPLAY = ['attitude_replay', 'in/log.mcap', '--scene', 'in/scene.yaml', '-o', 'out/motion.mcap']
PRINTING = [pytest.param(REPLAY, id='replay'),
            pytest.param(['attitude_tradeoff', '--help'], id='help', marks=pytest.mark.nightly)]


@pytest.mark.slow
@pytest.mark.parametrize('arguments', PRINTING)
def test_a_reader_that_is_gone_ends_a_command_quietly(place, arguments):
    reading, writing = os.pipe()
    os.close(reading)
    result = subprocess.run([*COMMAND, *arguments], stdout=writing, stderr=subprocess.PIPE,
                            text=True, check=False)
    os.close(writing)
    assert (result.returncode, result.stderr) == (141, '')
    assert all(path.name == 'motion.mcap' for path in Path('out').iterdir())


@pytest.mark.slow
def test_a_reader_that_leaves_in_the_middle_is_no_error():
    # More than a pipe and Python's buffer can hold; Python keeps the rest until its exit.
    script = ('import sys; from rigid_body_ros.commands import main; '
              'from rigid_body_ros.runtime import '
              "terminal; sys.exit(main._guarded('', lambda: terminal.show(2 ** 20 * 'x') or 0, "
              'None))')
    with subprocess.Popen([sys.executable, '-c', script], stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE, text=True) as process:
        process.stdout.read(10)
        process.stdout.close()
        assert process.stderr.read() == ''
        assert process.wait() == 141


@pytest.mark.slow
@pytest.mark.parametrize('arguments', PRINTING)
def test_a_full_standard_output_is_reported_in_one_line(place, arguments):
    with open('/dev/full', 'w') as full:
        result = subprocess.run([*COMMAND, *arguments], stdout=full, stderr=subprocess.PIPE,
                                text=True, check=False)
    assert result.returncode == 2
    assert result.stderr == (f'{arguments[0]}: error: cannot write to standard output: No space '
                             'left on device\n')


@pytest.mark.slow
@pytest.mark.parametrize('arguments', PRINTING)
def test_a_closed_standard_output_is_reported_before_any_work(place, arguments):
    before = contents(place)
    result = subprocess.run(['sh', '-c', '"$@" >&-', 'sh', *COMMAND, *arguments], check=False,
                            stderr=subprocess.PIPE, text=True)
    assert result.returncode == 2
    assert result.stderr == (f'{arguments[0]}: error: cannot write to standard output: it is '
                             'closed\n')
    assert contents(place) == before


@pytest.mark.slow
def test_a_closed_standard_error_changes_nothing(place):
    result = subprocess.run(['sh', '-c', '"$@" 2>&-', 'sh', *COMMAND, *REPLAY], check=False,
                            stdout=subprocess.PIPE, text=True)
    assert result.returncode == 0
    assert 'wrote         out/motion.mcap' in result.stdout


@pytest.mark.slow
def test_a_name_that_is_no_text_is_printed(place):
    output = os.fsencode('out/motion') + b'\xff.mcap'
    result = subprocess.run([*COMMAND, *REPLAY[:-1], output], check=False, capture_output=True,
                            env={**os.environ, 'PYTHONIOENCODING': 'utf-8:strict'})
    assert (result.returncode, result.stderr) == (0, b'')  # also without a progress bar
    assert result.stdout.splitlines()[-1] == rb'wrote         out/motion\udcff.mcap'
    assert os.path.isfile(output)
