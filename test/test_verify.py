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

"""attitude_replay --verify reproduces a motion to the last bit, or reports the differences."""

import ast
from dataclasses import replace
import json
import os
import subprocess
import sys

from conftest import CONFIG, RECORDINGS, SECOND
import node_logs
from node_logs import (
    ACCEPTED,
    attitudes,
    called,
    COMMITTED,
    epoch,
    FIRST,
    rows,
    run,
    save,
    SECOND_START,
    TORQUES,
    two,
    two_epochs,
    without,
)
import numpy as np
import pytest
from rigid_body_ros import messages, recording, scene, State
from rigid_body_ros.commands import main
from rigid_body_ros.replay import replay
from rigid_body_ros.replay.verify import verify
from rigid_body_ros.runtime.fingerprint import fingerprint
from rigid_body_ros.scene import InputError
from rosbags.highlevel import AnyReader
import yaml

run, two = run, two  # fixtures, used by their names
TUMBLER, SCENE = RECORDINGS / 'tumbler.mcap', CONFIG / 'tumbler.yaml'


def rewritten(source, target, change=lambda values: values, metadata=None):
    """Write a copy of the attitude of a replay with a change."""
    read = recording.read(source, '/attitude', messages.QUATERNION)
    with recording.Writer(target) as writer:
        writer.add_topic('/attitude', messages.QUATERNION)
        writer.write_columns(read.stamps_ns, [
            recording.Column('/attitude', 'world', change(read.values.copy()))])
        if metadata:
            writer.add_metadata('rigid_body_ros', metadata)
    return target


@pytest.mark.parametrize(('name', 'options'), [
    ('motion.mcap', []), ('motion', ['--rate', '37']),
    ('motion.mcap', ['--interpolation', 'cubic'])])
def test_a_replay_comes_out_again(tmp_path, capsys, name, options):
    arguments = [str(TUMBLER), '--scene', str(SCENE)]
    assert main.attitude_replay([*arguments, '-o', str(tmp_path / name), *options]) == 0
    capsys.readouterr()
    again = [] if options[:1] == ['--rate'] else options
    assert main.attitude_replay([*arguments, '--verify', str(tmp_path / name), *again]) == 0
    lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    count = len(recording.read(tmp_path / name, '/attitude', messages.QUATERNION))
    assert lines['compared'] == f'{count} states of /attitude'
    assert f'{count} of {count}' in lines['same']
    assert lines['difference'] == 'at most 0 rad'
    assert 'made' not in lines


def test_an_old_recording_that_names_a_compiler_and_a_processor_can_be_verified(tmp_path):
    replay(TUMBLER, scene.load(SCENE), tmp_path / 'motion.mcap')
    old = {**fingerprint(), 'compiler': '12.2', 'processor': 'arm64 cortex-a72'}
    del old['kernels']
    path = rewritten(tmp_path / 'motion.mcap', tmp_path / 'old.mcap',
                     metadata={'fingerprint': json.dumps(old)})
    result = verify(TUMBLER, scene.load(SCENE), path)
    assert result.same.all()
    assert result.versions == {}


@pytest.mark.slow
def test_kernels_that_are_not_compiled_have_the_same_fingerprint():
    program = 'from rigid_body_ros.runtime.fingerprint import fingerprint; print(fingerprint())'
    printed = subprocess.run([sys.executable, '-c', program], check=True, capture_output=True,
                             env={**os.environ, 'RIGID_BODY_ROS_KERNELS': 'python'},
                             text=True).stdout
    assert ast.literal_eval(printed) == fingerprint()


@pytest.mark.slow
def test_a_fingerprint_that_is_damaged_is_unknown(tmp_path):
    replay(TUMBLER, scene.load(SCENE), tmp_path / 'motion.mcap', until=1.0)
    for text in ['[1, 2]', 'null', '{', '[' * 100_000, '']:
        path = rewritten(tmp_path / 'motion.mcap', tmp_path / 'other.mcap',
                         metadata={'fingerprint': text})
        result = verify(TUMBLER, scene.load(SCENE), path)
        assert result.versions == {
            name: ('unknown', version) for name, version in fingerprint().items()}


def test_differing_bits_end_with_status_1(tmp_path, capsys):
    replay(TUMBLER, scene.load(SCENE), tmp_path / 'motion.mcap')
    assert sorted(fingerprint()) == ['kernels', 'numpy', 'rigid_body_ros']  # no processor
    other = {**fingerprint(), 'kernels': '0123456789ab'}

    def nudged(values):
        values[1:] = np.nextafter(values[1:], 2.0)
        return values
    path = rewritten(tmp_path / 'motion.mcap', tmp_path / 'nudged.mcap', nudged,
                     {'fingerprint': json.dumps(other)})
    arguments = [str(TUMBLER), '--scene', str(SCENE), '--verify', str(path)]
    assert main.attitude_replay(arguments) == 1
    captured = capsys.readouterr()
    assert 'same bits     1 of 3001' in captured.out
    assert 'rad\nmade by       kernels 0123456789ab, here ' in captured.out
    assert not captured.err


STAMPS = 1_000_000_000 + np.arange(50) * 20_000_000
START_NS = 900_000_000


def node_log(folder, lost=(), unseen=(), start_time=START_NS):
    """
    Write the torques that a node received, without those that are lost, and its committed states.

    Return the path of the recording, and the path of a scene with a start time.
    """
    config, run = folder / 'run.yaml', scene.load(SCENE)
    config.write_text(f'{SCENE.read_text()}    start_time: {start_time}\n')
    torques = rows(STAMPS / SECOND, 0.01 * np.random.default_rng(3).normal(size=(50, 3)))
    _, *sent = epoch(run, replace(run.start, time_ns=START_NS), {'/torque': torques})
    sent = without(without(sent, '/torque', *lost), COMMITTED, *unseen)
    return save(folder / 'run.mcap', sent, ['/torque']), str(config)


def verified(log, config):
    return main.attitude_replay([log, '--scene', config, '--verify', log])


def test_the_torques_that_a_node_received_give_its_states_again(tmp_path, capsys):
    assert verified(*node_log(tmp_path)) == 0
    words = capsys.readouterr().out
    assert 'compared      51 states of /node/committed\n' in words
    assert 'same bits     51 of 51' in words


@pytest.mark.parametrize(('missing', 'message'), [
    # The recorder of the torques started late.
    ({'lost': range(7)}, 'expected a torque at the stamp of each state, found none for 7 of '
     f'51 states, the first at {STAMPS[0]} ns: the beginning of the torque log is missing'),
    ({'lost': range(7), 'start_time': 0},
     f'expected the initial attitude of the scene at {STAMPS[7]} ns, found an attitude 0.15 rad '
     'away: the recorder started late, or the scene or its start_time is not that of the run'),
    ({'lost': (20, 21)}, 'expected a torque at the stamp of each state, found none for 2 of '
     f'51 states, the first at {STAMPS[20]} ns: a part of the torque log is missing'),
    # The recorder of both started late.
    ({'lost': range(7), 'unseen': range(8)}, 'expected the first state at the start of the '
     f'motion, {START_NS} ns, found it at {STAMPS[7]} ns: the recorder started late, or'),
    ({'unseen': range(51)}, 'expected states, found no messages'),
    ({'start_time': START_NS + 5}, 'expected the first state at or after the start_time of the '
     f'scene, {START_NS + 5} ns, found it at {START_NS} ns')
], ids=str)
def test_a_log_that_is_not_complete_is_recognized(tmp_path, capsys, missing, message):
    assert verified(*node_log(tmp_path, **missing)) == 2
    captured = capsys.readouterr()
    line, = captured.err.splitlines()
    assert f'run.mcap: /node/committed: {message}' in line
    assert not captured.out


def test_torques_that_begin_after_a_motion_are_recognized(tmp_path, capsys):
    replay(TUMBLER, scene.load(SCENE), tmp_path / 'motion.mcap')
    read = recording.read(TUMBLER)
    with recording.Writer(tmp_path / 'late.mcap') as writer:
        writer.add_topic('/torque', messages.WRENCH)
        for stamp_ns, values in zip(read.stamps_ns[100:].tolist(), read.values[100:]):
            writer.write('/torque', stamp_ns, messages.wrench(stamp_ns, '', values[3:]))
    assert main.attitude_replay([str(tmp_path / 'late.mcap'), '--scene', str(SCENE), '--verify',
                                str(tmp_path / 'motion.mcap')]) == 2
    line, = capsys.readouterr().err.splitlines()
    assert ('expected the first state at or after the first torque, '
            f'{read.stamps_ns[100]} ns, found it at {read.stamps_ns[0]} ns: the beginning of the '
            'torque log or the start_time of the scene is missing') in line


def test_a_recording_says_how_it_was_made(tmp_path):
    replay(TUMBLER, scene.load(SCENE), tmp_path / 'motion.mcap')
    with recording.Source(tmp_path / 'motion.mcap', '/attitude', [messages.QUATERNION]) as source:
        about = source.metadata('rigid_body_ros')
    assert json.loads(about['fingerprint']) == fingerprint()
    assert json.loads(about['scene']) == dict(scene.load(SCENE).values)
    assert about['torques'] == 'tumbler.mcap'


@pytest.mark.slow
def test_a_folder_is_what_rosbag2_wants(tmp_path):
    folder = tmp_path / 'motion'
    replay(TUMBLER, scene.load(SCENE), folder)
    assert sorted(path.name for path in folder.iterdir()) == ['metadata.yaml', 'motion_0.mcap']
    about = yaml.safe_load((folder / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    ours = recording.read(folder, '/attitude', messages.QUATERNION)
    assert about['message_count'] == 3 * len(ours)
    assert about['starting_time']['nanoseconds_since_epoch'] == ours.stamps_ns[0]
    with AnyReader([folder]) as reader:
        assert {each.topic: each.msgcount for each in reader.connections} == dict.fromkeys(
            ['/attitude', '/euler_angles', '/angular_velocity'], len(ours))
        theirs = [reader.deserialize(data, each.msgtype).quaternion
                  for each, _, data in reader.messages() if each.topic == '/attitude']
    np.testing.assert_array_equal([[q.x, q.y, q.z, q.w] for q in theirs], ours.values)


# Every committed state of every epoch in the log of a node

MS = 10 ** 6


@pytest.mark.parametrize('start_time', [0, SECOND_START.time_ns, 3])
def test_the_start_of_the_scene_does_not_matter(two, tmp_path, capsys, start_time):
    assert called(tmp_path, 'verify', two, f'start_time: {start_time}') == 0
    assert 'compared      71 states of /node/committed in 2 epochs\nsame bits     71 of 71\n' \
        in capsys.readouterr().out


def committed(sent, number, change):
    """Return messages in which one committed state is changed."""
    place = [place for place, (topic, _) in enumerate(sent) if topic == COMMITTED][number]
    found = messages.ODOMETRY.decode(sent[place][1])
    stamp, values = change(found.stamp_ns, found.values.copy())
    data = messages.ODOMETRY.encode(stamp, 'world', values, 'base_link')
    return [*sent[:place], (COMMITTED, data), *sent[place + 1:]]


def nudged(stamp, values):
    values[48] = np.nextafter(values[48], 1.0)
    return stamp, values


def test_a_bit_that_differs_in_the_first_epoch_is_found(run, tmp_path, capsys):
    sent = two_epochs(run)
    log = save(tmp_path / 'log.mcap', committed(sent, 17, nudged))
    assert called(tmp_path, 'verify', log) == 1
    words = capsys.readouterr().out
    assert 'same bits     70 of 71\n' in words
    stamp = node_logs.motion_of(run, FIRST, TORQUES).times_ns[17]
    assert f'first in state 18, at {stamp} ns: 0 rad' in words


def test_states_after_until_are_not_compared(run, tmp_path, capsys):
    sent = two_epochs(run)
    log = save(tmp_path / 'log.mcap', committed(committed(sent, 17, nudged), 70, nudged))
    arguments = [log, '--scene', str(CONFIG / 'tumbler.yaml'), '--verify', log, '--until']
    assert main.attitude_replay([*arguments, '1']) == 0
    # 11 states of the first epoch, every 0.1 s, and 21 of the second, every 0.05 s.
    assert 'compared      32 states of /node/committed in 2 epochs\n' in capsys.readouterr().out
    assert main.attitude_replay([*arguments, '1.8']) == 1


def test_until_holds_for_ordinary_recordings_too(run, tmp_path):
    torques, output = str(RECORDINGS / 'tumbler.mcap'), tmp_path / 'out.mcap'
    replay(torques, run, output)
    first = int(attitudes(output).stamps_ns[0])
    result = verify(torques, run, output, until=1.0)
    assert result.same.all()
    assert first < result.stamps_ns[-1] <= first + SECOND
    replay(torques, replace(run, start=replace(run.start, time_ns=first + 2 * SECOND)), output)
    with pytest.raises(InputError, match='/attitude: expected states up to --until, at '):
        verify(torques, run, output, until=1.0)


def test_torques_without_a_committed_state_are_counted(run, tmp_path, capsys):
    sent = two_epochs(run)
    killed = without(sent, COMMITTED, *range(32, 40), *range(69, 71))
    assert called(tmp_path, 'verify', save(tmp_path / 'log.mcap', killed)) == 0
    assert ('compared      61 states of /node/committed in 2 epochs; 10 torques have no committed '
            'state\n') in capsys.readouterr().out
    killed = without(sent, COMMITTED, *range(40, 71))
    assert called(tmp_path, 'verify', save(tmp_path / 'log.mcap', killed)) == 0
    assert ('compared      40 states of /node/committed in 1 of 2 epochs; 30 torques have no '
            'committed state\n') in capsys.readouterr().out


@pytest.mark.parametrize(('change', 'message'), [
    # A state has no torque at its stamp, and is not the start of an epoch.
    (lambda sent: without(sent, ACCEPTED, 20), 'expected a torque at the stamp of each state, '
     f'found none for 1 of 40 states, the first at {7 * SECOND - 100 * MS} ns'),
    (lambda sent: committed(sent, 30, lambda stamp, values: (stamp + 1, values)), 'found none'),
    # The recording of the states began late.
    (lambda sent: without(sent, COMMITTED, 0), 'expected the start state of an epoch of the '
     f'torque log in message 1, found another state, at {5 * SECOND + 100 * MS} ns: the recording '
     'began in the middle of an epoch, or is not that of this log'),
    # The start of the second epoch is missing.
    (lambda sent: without(sent, COMMITTED, 40), 'found none for 30 of 70 states'),
    (lambda sent: committed(sent, 40, nudged), 'found none for 31 of 71 states'),
    (lambda sent: without(sent, COMMITTED, *range(71)), 'expected states, found no messages')],
    ids=range(6))
def test_states_without_a_counterpart_are_refused(run, tmp_path, capsys, change, message):
    sent = two_epochs(run)
    assert called(tmp_path, 'verify', save(tmp_path / 'log.mcap', change(sent))) == 2
    captured = capsys.readouterr()
    line, = captured.err.splitlines()
    assert f'log.mcap: {COMMITTED}: ' in line
    assert message in line
    assert not captured.out


def test_states_whose_stamps_go_back_need_a_start(run, tmp_path):
    sent = [*epoch(run, FIRST, TORQUES), *epoch(run, FIRST, TORQUES)]
    log = save(tmp_path / 'log.mcap', sent)
    assert verify(log, run, log).epochs == 2
    log = save(tmp_path / 'log.mcap', without(sent, COMMITTED, 40))
    with pytest.raises(InputError, match='in message 41, because its stamp, 5100000000 ns, is not '
                                         'later than the one before, 8900000000 ns'):
        verify(log, run, log)


@pytest.mark.parametrize('count', [1, 3])
def test_a_state_may_be_the_start_of_the_next_epoch(run, tmp_path, count):
    rest = State(5 * SECOND)
    still = {ACCEPTED: rows([6.0, 7.0, 8.0], (0.0, 0.0, 0.0))}
    again = State(7 * SECOND)  # as the state of the first epoch at this time
    later = epoch(run, again, {ACCEPTED: rows([7.5, 9.0], (0.0, 0.0, 0.1))})
    log = save(tmp_path / 'log.mcap', epoch(run, rest, still) + count * later)
    result = verify(log, run, log)
    assert (len(result.same), result.same.all(), result.pending) == (4 + 3 * count, True, 0)
    assert f'states of /node/committed in {count + 1} epochs\n' in result.text()


@pytest.mark.parametrize('options', [{}, {'rate': 37.0}, {'until': 1.2}], ids=str)
def test_the_attitude_of_a_replay_comes_out_again_in_every_epoch(run, two, tmp_path, options):
    replay(two, run, tmp_path / 'out.mcap', **options)
    result = verify(two, run, tmp_path / 'out.mcap')
    assert result.same.all()
    assert len(result.same) == len(attitudes(tmp_path / 'out.mcap'))
    assert (result.epochs, result.compared_epochs, result.pending) == (2, 2, 0)
