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

"""Outputs are complete or unchanged, and never replace protected files."""

import errno
import os
from pathlib import Path
import socket
import stat
import subprocess
import sys

from conftest import CONFIG, files_up_to, program, RECORDINGS, SECOND, write_torques
import pytest
from rigid_body_ros import messages, recording, scene
from rigid_body_ros.commands import main
from rigid_body_ros.comparison import read_measured
from rigid_body_ros.comparison.comparison import compare_recording, read_motion
from rigid_body_ros.replay import replay
from rigid_body_ros.replay.many import replay_many
from rigid_body_ros.runtime import files
from rigid_body_ros.runtime.limits import read_json
from rigid_body_ros.scene import InputError

TUMBLER = scene.load(CONFIG / 'tumbler.yaml')
TORQUES = [(stamp_ns, '', [0.1, 0.0, 0.0]) for stamp_ns in (SECOND, 2 * SECOND)]


def write(path, text='new'):
    with files.atomic_output(path, '.json') as part:
        part.write_text(text)


@pytest.fixture
def umask():
    """Set an unusual umask."""
    before = os.umask(0o027)
    yield
    os.umask(before)


@pytest.mark.parametrize('name', ['file', 'link', 'hard link'])
def test_an_existing_file_is_kept_unless_it_may_be_overwritten(tmp_path, name):
    file = tmp_path / 'file'
    file.write_text('old')
    (tmp_path / 'link').symlink_to(file)
    (tmp_path / 'hard link').hardlink_to(file)
    message = f'{name}: output exists; choose another name, or add --overwrite'
    with files.overwriting(False):
        with pytest.raises(InputError, match=message):
            files.check((tmp_path / name, '.json'))
        with pytest.raises(InputError, match=message):
            write(tmp_path / name)
        write(tmp_path / 'new')
    assert file.read_text() == 'old'
    assert len(list(tmp_path.iterdir())) == 4
    write(tmp_path / name)
    assert (tmp_path / name).read_text() == 'new'
    assert (tmp_path / 'link').is_symlink()
    assert file.read_text() == ('old' if name == 'hard link' else 'new')
    assert len(list(tmp_path.iterdir())) == 4


def without_links(*_):
    raise PermissionError(errno.EPERM, 'Operation not permitted')  # as on FAT


@pytest.mark.parametrize('link', [os.link, without_links])
def test_a_file_that_appears_after_the_last_check_is_kept(tmp_path, monkeypatch, link):
    path = tmp_path / 'file'

    def after_another(function):
        def call(*names):
            if not path.exists():
                path.write_text('old')
            return function(*names)
        return call
    monkeypatch.setattr(os, 'link', after_another(link))
    monkeypatch.setattr(os, 'replace', after_another(os.replace))
    with pytest.raises(InputError, match='file: output exists'), files.overwriting(False):
        write(path)
    assert path.read_text() == 'old'
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize('link', [os.link, without_links])
def test_an_output_that_cannot_get_its_name_leaves_no_file_of_that_name(tmp_path, monkeypatch,
                                                                        link):
    def fails(*_):
        raise OSError(errno.EIO, 'Input/output error')

    monkeypatch.setattr(os, 'link', link)
    monkeypatch.setattr(os, 'replace', fails)
    with pytest.raises(InputError, match='file: cannot write: Input/output error'), \
            files.overwriting(False):
        write(tmp_path / 'file')
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize('link', [os.link, without_links])
@pytest.mark.parametrize('overwrite', [False, True])
def test_a_complete_output_has_one_name(tmp_path, monkeypatch, link, overwrite):
    monkeypatch.setattr(os, 'link', link)
    with files.overwriting(overwrite):
        part = files.Part(tmp_path / 'file', '.json')
        part.path.write_text('new')
        part.complete()
    file, = tmp_path.iterdir()
    assert (file.read_text(), file.stat().st_nlink) == ('new', 1)


def test_on_a_full_disk_a_file_is_what_it_was(tmp_path):
    path = tmp_path / 'file'
    path.write_text('old')
    with files_up_to(512), pytest.raises(InputError,
                                         match='file: cannot write: File too large'):
        write(path, 1000 * 'x')
    assert [part.read_text() for part in tmp_path.iterdir()] == ['old']


def test_what_goes_wrong_while_writing_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt), files.atomic_output(tmp_path / 'file', '.json') as part:
        part.write_text('half')
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


def test_a_new_file_has_the_mode_of_the_umask_and_a_replaced_one_keeps_its_own(tmp_path, umask):
    path = tmp_path / 'file'
    for mode in (0o640, 0o600, 0o666):
        if path.exists():
            path.chmod(mode)
        write(path)
        assert stat.S_IMODE(path.stat().st_mode) == mode
    files.Part(tmp_path / 'folder', files.FOLDER).complete()
    assert stat.S_IMODE((tmp_path / 'folder').stat().st_mode) == 0o750


def test_a_file_that_is_replaced_stays_private_while_it_is_written(tmp_path):
    path = tmp_path / 'file'
    path.touch(0o600)
    with files.atomic_output(path, '.json') as part:
        assert stat.S_IMODE(part.stat().st_mode) == 0o600


def test_a_temporary_file_never_replaces_another(tmp_path, monkeypatch):
    # An attacker who guesses the name could place a link to somebody's file there.
    monkeypatch.setattr('secrets.token_hex', lambda size: 'guessed')
    other = tmp_path / 'other'
    other.write_text('unchanged')
    guessed = tmp_path / f'.file.guessed.{os.getpid()}.part'
    guessed.symlink_to(other)
    with pytest.raises(InputError, match='file: cannot write: File exists'):
        write(tmp_path / 'file')
    assert other.read_text() == 'unchanged'
    assert guessed.is_symlink()


@pytest.mark.parametrize('kind', ['file', 'folder'])
def test_contents_are_on_the_disk_before_the_name(tmp_path, monkeypatch, kind):
    # In this order, a crash leaves either the old file or the new one.
    done = []

    def noted(name, path_of=lambda argument: argument):
        function = getattr(os, name)

        def call(*arguments):
            done.append((name, path_of(arguments[0])))
            return function(*arguments)
        monkeypatch.setattr(os, name, call)
    noted('fsync', lambda handle: os.readlink(f'/proc/self/fd/{handle}'))
    noted('replace', str)
    part = files.Part(tmp_path / 'out', files.FOLDER if kind == 'folder' else '.json')
    inside = [part.path / 'inside'] if kind == 'folder' else []
    for path in inside or [part.path]:
        path.write_text('new')
    part.complete()
    assert done == [*(('fsync', str(path)) for path in (*inside, part.path)),
                    ('replace', str(part.path)), ('fsync', str(tmp_path))]


def make_device(path):
    # Never a device in /dev: as root, broken code would replace it for the whole machine.
    try:
        os.mknod(path, stat.S_IFCHR | 0o666, os.makedev(1, 3))
    except PermissionError:
        pytest.skip('only root may make a device')


def make_socket(path):
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))


@pytest.mark.parametrize('make', [make_device, os.mkfifo, make_socket])
def test_a_device_a_pipe_and_a_socket_are_refused_without_waiting(tmp_path, make):
    path = tmp_path / 'special'
    make(path)
    before = path.stat()
    with pytest.raises(InputError, match='special: expected a regular file, found a device, pipe'):
        write(path)
    assert (path.stat().st_mode, path.stat().st_ino) == (before.st_mode, before.st_ino)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize('folder', ['', '/', '.'])
def test_a_folder_is_refused(tmp_path, folder):
    with pytest.raises(InputError, match='expected a regular file, found a folder'):
        write(folder or tmp_path)


def test_a_read_only_file_is_refused(tmp_path):
    path = tmp_path / 'file'
    path.write_text('old')
    path.chmod(0o444)
    with pytest.raises(InputError, match='file: expected a writable file, found a read-only one'):
        write(path)
    assert path.read_text() == 'old'


@pytest.mark.parametrize(('name', 'message'), [
    ('none/file', 'No such file or directory'), ('file/file', 'Not a directory'),
    (300 * 'x', 'File name too long'), ('loop', 'Too many levels of symbolic links'),
    ('/proc/file', 'No such file or directory')])
def test_a_place_where_nothing_can_be_written_is_reported_before_any_work(tmp_path, name, message):
    (tmp_path / 'file').touch()
    (tmp_path / 'loop').symlink_to('loop')
    before = set(tmp_path.iterdir())
    with pytest.raises(InputError, match=message):
        files.check((tmp_path / name, '.json'))
    assert set(tmp_path.iterdir()) == before


def test_a_name_may_be_as_long_as_names_can_be(tmp_path):
    write(tmp_path / (85 * '\u4e2d'))
    assert [path.read_text() for path in tmp_path.iterdir()] == ['new']


@pytest.mark.parametrize('name', ['motion', 'run.1', 'run.1.mcap', '2024.11.22', 'a.MCAP', '.x'])
def test_a_name_with_dots_is_a_name(tmp_path, name):
    files.check((tmp_path / name, '.mcap' if name.lower().endswith('mcap') else files.FOLDER))


@pytest.mark.parametrize('suffix', ['.csv', '.db3', '.PNG'])
@pytest.mark.parametrize('expected', ['.mcap', files.FOLDER])
def test_a_name_that_promises_another_format_is_refused(tmp_path, suffix, expected):
    with pytest.raises(InputError, match=f'expected a name ending .* found {suffix.lower()}'):
        files.check((tmp_path / f'motion{suffix}', expected))


def test_what_changes_while_a_file_is_written_is_checked_again(tmp_path):
    # The input takes the name of the output.
    source, output = tmp_path / 'source', tmp_path / 'output'
    source.write_text('input')
    with pytest.raises(InputError, match='output: would overwrite the input .*source'), \
            files.reading(source), files.atomic_output(output, '.json') as part:
        part.write_text('new')
        source.rename(output)
    assert [path.read_text() for path in tmp_path.iterdir()] == ['input']


def test_what_is_read_with_its_journals_is_protected_as_long_as_it_is_read(tmp_path):
    for name in ('bag', 'bag-wal'):
        path = tmp_path / name
        path.write_text('old')
        with files.reading(tmp_path / 'bag'), \
                pytest.raises(InputError, match='overwrite the in'):
            write(path)
        write(path)
        assert path.read_text() == 'new'


def test_an_incomplete_file_gets_a_free_name(tmp_path):
    taken = tmp_path / 'out.partial.mcap'
    taken.symlink_to('missing')
    for number in (2, 3):
        part = files.Part(tmp_path / 'out.mcap', '.mcap')
        part.path.write_text(str(number))
        assert part.keep(part.path, '.mcap') == tmp_path / f'out.partial.{number}.mcap'
        assert (tmp_path / f'out.partial.{number}.mcap').read_text() == str(number)
        part.discard()
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize('use', [
    recording.read, lambda path: recording.topics(path, recording.TORQUES), read_measured,
    scene.load, lambda path: replay(path, TUMBLER), lambda path: read_motion(path, TUMBLER),
    lambda path: compare_recording(path, TUMBLER), lambda path: read_json(path, 'fit'),
    lambda path: replay(RECORDINGS / 'tumbler.mcap', TUMBLER, path),
    lambda path: recording.Writer(path).__enter__(),
    lambda path: recording.FolderWriter(path).__enter__(),
    lambda path: files.check((path, '.png')),
    lambda path: files.protected('scene', path).__enter__()])
def test_a_path_with_a_null_byte_is_one_line(tmp_path, use):
    words = r'a\\x00b.*: .*null (byte|character)|expected a name ending in'
    for suffix in ('', '.mcap', '.db3', '.mcap.zst', '.yaml'):
        with pytest.raises(InputError, match=words):
            use(tmp_path / f'a\0b{suffix}')


# Every output of every command, on every input under every name

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
    write_torques(tmp_path / 'in/log.mcap', TORQUES)
    write_torques(tmp_path / 'in/bag', TORQUES, kind=recording.FolderWriter)
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


@pytest.fixture
def refused(place, capsys):
    """Return a function that lets an option write to a path; expect one line, and return it."""
    def attack(*arguments, **options):
        before = contents(place)
        assert run(*arguments, **options) == 2
        captured = capsys.readouterr()
        line, = captured.err.splitlines()
        assert captured.out == ''
        assert contents(place) == before
        return line
    return attack


#: Every option attacks one input under each name, and one option attacks every input.
ATTACKS = [(option, 'scene') for option in OUTPUTS] + [('replay -o', name) for name in VICTIMS
                                                       if name != 'scene']


@pytest.mark.slow
@pytest.mark.parametrize(('option', 'victim'), [*ATTACKS, ('many -o', 'mcap')])
def test_an_output_never_replaces_an_input(refused, option, victim):
    recorded, attacked = VICTIMS[victim]
    attacked = Path(attacked)
    # --many always appends the suffix .mcap to the name.
    links = [name for name in ALIASES if 'many' not in option or attacked.suffix == '.mcap'
             or ('link' in name and name != 'linked folder')]
    for name in [name for name in links if name != 'hard link' or attacked.is_file()]:
        folder = Path('out', name)
        folder.mkdir()
        output = ALIASES[name](attacked, folder / f'second{OUTPUTS[option]}')
        line = refused(option, recorded, output)
        assert ': would overwrite the ' in line or ': would be written into the folder ' in line


@pytest.mark.slow
@pytest.mark.parametrize('option', ['replay -o', 'replay --csv', 'many -o', 'tradeoff --json'])
def test_a_command_keeps_an_existing_output_unless_told_to_overwrite(refused, option):
    output = Path('out', f'second{OUTPUTS[option]}')
    output.write_text('old')
    assert refused(option, 'in/log.mcap', output, overwrite=()).endswith(
        f': error: {output}: output exists; choose another name, or add --overwrite')
    assert run(option, 'in/log.mcap', output) == 0
    assert output.read_bytes() != b'old'


@pytest.mark.parametrize('option', OUTPUTS)
def test_nothing_new_is_written_into_a_bag_that_is_read(refused, option):
    Path('in/bag/deeper').mkdir()
    linked(Path('in/bag'), Path('out/folder'))
    linked(Path('in/bag'), Path('other/link'))
    linked(Path('in/bag/bag_0.mcap'), Path('other/file'))
    recordings, folders = ['in/bag'], ['in/bag/deeper']
    if option == 'replay -o':
        recordings += ['in/bag/bag_0.mcap', 'other/link', 'other/file']
        folders += ['in/bag', 'out/folder']
    for recorded in recordings:
        for folder in folders:
            assert ': would ' in refused(option, recorded,
                                         Path(folder, f'second{OUTPUTS[option]}'))


@pytest.mark.parametrize(('first', 'second'), [
    ('out/x.mcap', 'out/x.mcap'), ('out/x.mcap', 'out/../out/x.mcap'), ('out/x.mcap', 'out/x.png'),
    ('out/x.png', 'out/x.mcap')])
def test_two_outputs_never_have_one_name(place, refusal, first, second):
    Path('out/x.png').symlink_to('x.mcap')
    before = contents(place)
    refusal('attitude_replay', 'in/log.mcap', '--scene', 'in/scene.yaml', '-o', first, '--plot',
            second, '--overwrite')
    assert contents(place) == before


@pytest.mark.parametrize('option', OUTPUTS)
def test_outputs_are_checked_before_anything_is_read(refused, option):
    Path('in/log.mcap').write_text('no recording')
    if 'library' not in option:  # the library gets a scene that was already read
        Path('in/scene.yaml').write_text('no scene')
    assert 'in/log.mcap: would overwrite the input in/log.mcap' in refused(
        option, 'in/log.mcap', Path('in/log.mcap'))


@pytest.mark.parametrize(('recorded', 'motion'), [('in/bag', 'motion.mcap'),
                                                  ('in/log.csv', 'motion')])
def test_verify_writes_nothing(place, recorded, motion):
    arguments = [recorded, '--scene', 'in/scene.yaml']
    assert main.attitude_replay([*arguments, '-o', f'out/{motion}']) == 0
    before = contents(place)
    assert main.attitude_replay([*arguments, '--verify', f'out/{motion}']) == 0
    assert contents(place) == before


def test_an_incomplete_output_leaves_an_input_with_the_name_of_its_partial_file(place, refusal):
    source = Path('out/motion.partial.mcap')
    source.write_bytes((RECORDINGS / 'tumbler.mcap').read_bytes())
    before = contents(place)
    with files_up_to(2_000_000):
        line = refusal('attitude_replay', source, '--scene', 'in/scene.yaml', '--rate', '1000',
                       '-o', 'out/motion.mcap')
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
        writer.write('/torque', SECOND, messages.wrench(*TORQUES[0]))
        path.mkdir()
    assert sorted(Path('out').rglob('*')) == sorted([path, kept.relative_to(place)])
    assert recording.read(kept).stamps_ns.tolist() == [SECOND]


REPLAY = [*program('attitude_replay'), 'in/log.mcap', '--scene', 'in/scene.yaml', '-o',
          'out/motion.mcap']
PRINTING = [pytest.param('replay', REPLAY, id='replay'), pytest.param(
    'tradeoff', [*program('attitude_tradeoff'), '--help'], id='help', marks=pytest.mark.nightly)]


def redirected(words, command):
    """Run a command with a redirection of the shell."""
    return subprocess.run(['sh', '-c', f'"$@" {words}', 'sh', *command], check=False,
                          capture_output=True, text=True)


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'command'), PRINTING)
def test_a_reader_that_is_gone_ends_a_command_quietly(place, name, command):
    reading, writing = os.pipe()
    os.close(reading)
    result = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True,
                            check=False)
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
@pytest.mark.parametrize(('name', 'command'), PRINTING)
@pytest.mark.parametrize(('words', 'reason'), [
    ('>/dev/full', 'No space left on device'), ('>&-', 'it is closed')])
def test_a_standard_output_that_fails_is_reported_in_one_line(place, name, command, words, reason):
    before = contents(place)
    result = redirected(words, command)
    assert result.returncode == 2
    assert result.stderr == (
        f'attitude_{name}: error: cannot write to standard output: {reason}\n')
    if words == '>&-':  # which is known before any work
        assert contents(place) == before


@pytest.mark.slow
def test_a_closed_standard_error_changes_nothing(place):
    result = redirected('2>&-', REPLAY)
    assert result.returncode == 0
    assert 'wrote         out/motion.mcap' in result.stdout


@pytest.mark.slow
def test_names_that_are_no_text_are_printed_and_drawn(place):
    recorded = b'in/$\\frac$ _{{ \xff.mcap'  # no formula: the title of the picture is literal
    outputs = b'out/motion\xff.mcap', b'out/picture\xff.png'
    os.link('in/log.mcap', recorded)
    result = subprocess.run(
        [*program('attitude_replay'), recorded, '--scene', 'in/scene.yaml', '-o', outputs[0],
         '--plot', outputs[1]], check=False, capture_output=True,
        env={**os.environ, 'PYTHONIOENCODING': 'utf-8:strict'})
    assert (result.returncode, result.stderr) == (0, b'')  # also without a progress bar
    *_, wrote = result.stdout.splitlines()
    assert wrote == b'wrote         ' + b', '.join(outputs).replace(b'\xff', rb'\udcff')
    assert all(map(os.path.isfile, outputs))
