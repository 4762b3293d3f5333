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

"""Names and texts from outside are printed on one line, whatever characters they contain."""

import json

from conftest import collect_ignore
from mcap.writer import Writer
import measurements
import pytest
from rigid_body_ros import messages, recording
from rigid_body_ros.commands import main
import yaml

FORGED = 'check         passed'
#: A name that clears the screen, sets a link, adds a line, changes the direction of the text, and
#: starts a formula.
NAME = (f'a\x1b[2J\x1b]8;;http://b\x07\n{FORGED}\r\t\x7f\x85\x9b2J\u2028\u2029\u202e\u2066<b>&'
        '$\\frac{$机器😀')
TOPIC, FILE = f'/{NAME}', NAME.replace('/', '')


def printed(capfdbinary):
    """Return everything that was printed, after checking each character."""
    text = b''.join(capfdbinary.readouterr()).decode()
    assert text.replace('\n', '').isprintable()
    assert FORGED not in text.split('\n')
    return text


@pytest.fixture
def flight(tmp_path):
    """Return a scene and a recording whose name and topics are hostile."""
    tumble = measurements.truth(seconds=3.0, rate=50.0)
    scene = measurements.write_scene(tmp_path / f'{FILE}.yaml', tumble)
    path = measurements.write(tmp_path / f'{FILE}.mcap', **{
        NAME: measurements.torque_messages(tumble),
        f'imu{NAME}': measurements.messages_of('Imu', tumble.measured(1e-3, 2e-3))})
    return scene, path


def run(command, scene, path, *options):
    return getattr(main, command)([*map(str, (path, '--scene', scene, *options))])


@pytest.mark.slow
@pytest.mark.parametrize(('command', 'outputs'), [
    ('attitude_replay', {'-o': '.mcap', '--plot': '.png', '--report': '.html'}),
    ('attitude_compare', {'--json': '.json', '--plot': '.png', '--report': '.html'}),
    ('attitude_identify', {'--json': '.json', '--plot': '.png', '--report': '.html'}),
    ('attitude_tradeoff', {'--plot': '.png', '--report': '.html'})])
@pytest.mark.usefixtures('short_trades')
def test_names_of_topics_and_files(flight, tmp_path, capfdbinary, command, outputs):
    outputs = {option: tmp_path / f'out{FILE}{suffix}'
               for option, suffix in outputs.items()}
    more = [word for pair in outputs.items() for word in pair]
    if command == 'attitude_identify':
        more += ['--estimate', 'inertia_diagonal,start']
    scene, path = flight
    given = ['--recording', path] if command == 'attitude_tradeoff' else [path]
    assert getattr(main, command)([*map(str, (*given, '--scene', scene, *more))]) == 0
    assert 'wrote' in printed(capfdbinary) or command == 'attitude_tradeoff'
    assert all(path.stat().st_size for path in outputs.values())
    page = outputs['--report'].read_text(encoding='utf-8')
    assert '<b>' not in page
    assert '&lt;b&gt;&amp;$\\frac{$机器😀' in page
    if '--json' in outputs:  # data files keep the names
        assert json.dumps(f'/imu{NAME}')[1:-1] in outputs['--json'].read_text()


@pytest.mark.slow
def test_names_of_many_files_and_of_a_motion_to_verify(flight, tmp_path, capfdbinary):
    scene, path = flight
    (tmp_path / 'b').mkdir()
    broken = tmp_path / 'b' / f'broken{FILE}.mcap'
    broken.write_bytes(b'nothing')
    assert main.attitude_replay([*map(str, (path, broken, '--scene', scene, '-o',
                                            tmp_path / FILE))]) == 2
    assert '1 of 2 written' in printed(capfdbinary)
    motion = tmp_path / 'motion.mcap'
    assert run('attitude_replay', scene, path, '-o', motion) == 0
    with recording.Writer(tmp_path / 'renamed.mcap') as writer:
        states = recording.read(motion, '/attitude', messages.QUATERNION)
        writer.add_topic(TOPIC, messages.QUATERNION)
        writer.write_columns(states.stamps_ns, [recording.Column(TOPIC, 'world', states.values)])
    assert run('attitude_replay', scene, path, '--verify', tmp_path / 'renamed.mcap') == 0
    assert 'same bits' in printed(capfdbinary)


def ensemble(scene, vary, *options):
    return main.attitude_ensemble([*map(str, ('--scene', scene, '--vary', vary, '--runs', 10,
                                              *options))])


@pytest.mark.slow
@pytest.mark.skipif('test_ensemble.py' in collect_ignore, reason='needs pyarrow')
def test_names_of_an_ensemble(flight, tmp_path, capfdbinary):
    scene, path = flight
    vary = tmp_path / f'vary{FILE}.yaml'
    vary.write_text('inertia.ixx: {normal: 0.001}\n')
    assert ensemble(scene, vary, '--recording', path, '-o', tmp_path / FILE, '--report',
                    tmp_path / f'out{FILE}.html') == 0
    assert '10' in printed(capfdbinary)
    assert (tmp_path / FILE / 'bands.png').stat().st_size
    for text in (json.dumps({NAME: {'normal': 1.0}}), json.dumps({'inertia.ixx': {NAME: 1.0}}),
                 json.dumps({'inertia.ixx': NAME}), json.dumps({'inertia.ixx': {'normal': NAME}})):
        vary.write_text(text)
        assert ensemble(scene, vary, '--recording', path, '-o', tmp_path / 'other') == 2
        assert 'expected' in printed(capfdbinary)
    fitted = tmp_path / f'fitted{FILE}.json'
    for text in (json.dumps({NAME: 1}), json.dumps({'estimates': {NAME: NAME}}), NAME):
        fitted.write_text(text)
        assert ensemble(scene, fitted, '-o', tmp_path / 'other') == 2
        printed(capfdbinary)


def with_type(path):
    """Write a recording with a hostile schema name."""
    with open(path, 'wb') as stream:
        writer = Writer(stream)
        writer.start('ros2', 'test')
        schema = writer.register_schema(NAME, 'ros2msg', b'')
        writer.add_message(writer.register_channel(TOPIC, 'cdr', schema), 1, b'', 1)
        writer.finish()


def with_frames(path, kind):
    """Write a recording with hostile frame names."""
    tumble = measurements.truth(seconds=1.0, rate=50.0)
    torques = measurements.torque_messages(tumble, NAME if kind == 'torque' else 'base_link')
    sensor = tumble.measured()
    measured = measurements.messages_of('Vector3Stamped', sensor, frame=NAME)
    if kind == 'transform':
        measured = [(stamp, measurements.transform(stamp, measurements.Quaternion(*q), NAME, NAME))
                    for stamp, q in zip(sensor.stamps_ns.tolist(), sensor.attitude.tolist())]
    measurements.write(path, torque=torques, it=measured)


def with_keys(folder, scene, more):
    """Write a copy of a scene with further keys."""
    path, tree = folder / 'keyed.yaml', yaml.safe_load(scene.read_text())
    tree['/**']['ros__parameters'] |= more
    path.write_text(yaml.safe_dump(tree, width=1000))
    return path


COMMANDS = ['attitude_replay', 'attitude_compare', 'attitude_identify']


@pytest.mark.slow
@pytest.mark.parametrize('command', COMMANDS)
def test_names_of_types_frames_and_keys(flight, tmp_path, capfdbinary, command):
    scene, path = flight
    measured = [] if command == 'attitude_replay' else ['--measured', '/it']
    if command == 'attitude_identify':
        measured += ['--estimate', 'start']
    with_type(tmp_path / 'type.mcap')
    assert run(command, scene, tmp_path / 'type.mcap') == 2
    assert run(command, scene, tmp_path / 'type.mcap', '--topic', TOPIC) == 2
    for kind in ('torque', 'transform', 'rate'):
        with_frames(tmp_path / 'frames.mcap', kind)
        run(command, scene, tmp_path / 'frames.mcap', *measured)
    if measured:
        assert run(command, scene, path, '--measured', NAME) == 2
    for more in ({NAME: 1}, {'body_frame': NAME}, {'space_frame': NAME}, {'solver': NAME},
                 {'torque_topics': [NAME]}, {'inertia.ixx': NAME}, {f'inertia.{NAME}': 1.0}):
        run(command, with_keys(tmp_path, scene, more), path, *measured)
    assert run(command, tmp_path / f'no{FILE}', path) == 2
    assert 'error: ' in printed(capfdbinary)


@pytest.mark.parametrize(('command', 'required'), [
    *((command, ['in']) for command in COMMANDS), ('attitude_tradeoff', []),
    ('attitude_ensemble', ['--vary', 'in', '--runs', '1', '-o', 'out'])])
@pytest.mark.parametrize('arguments', [['--' + NAME.replace(' ', '')], ['--time-source', NAME],
                                       ['--rate', NAME], ['--estimate', NAME], ['--align', NAME]])
def test_arguments(capfdbinary, command, required, arguments):
    with pytest.raises(SystemExit) as ended:
        getattr(main, command)(['--scene', 'scene.yaml', *required, *arguments])
    assert ended.value.code == 2
    assert 'error: ' in printed(capfdbinary)


def test_the_copied_messages_keep_the_name_of_their_topic(flight, tmp_path):
    scene, path = flight
    torques = [*measurements.torque_messages(measurements.truth(seconds=1.0, rate=50.0))]
    measurements.write(path, **{NAME: torques})
    assert run('attitude_replay', scene, path, '-o', tmp_path / 'out.mcap', '--also', 'input') == 0
    assert len(recording.read(tmp_path / 'out.mcap', TOPIC)) == len(torques)
