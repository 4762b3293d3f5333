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

from conftest import CONFIG, RECORDINGS, SECOND, write_torques
from node_logs import attitudes, COMMITTED, epoch, rows, save, without
import numpy as np
import pytest
from rigid_body_ros import messages, recording, scene
from rigid_body_ros.commands import main
from rigid_body_ros.replay import replay
from rigid_body_ros.replay.verify import verify
from rigid_body_ros.runtime.fingerprint import fingerprint
from rigid_body_ros.scene import InputError
from rosbags.highlevel import AnyReader
import yaml

TUMBLER, SCENE = RECORDINGS / 'tumbler.mcap', CONFIG / 'tumbler.yaml'
RUN = scene.load(SCENE)


def rewritten(source, target, change=lambda values: values, metadata=None):
    """Write a copy of the attitude of a replay with a change."""
    read = attitudes(source)
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
    count = len(attitudes(tmp_path / name))
    assert lines['compared'] == f'{count} states of /attitude'
    assert f'{count} of {count}' in lines['same']
    assert lines['difference'] == 'at most 0 rad'
    assert 'made' not in lines


@pytest.mark.slow
def test_kernels_that_are_not_compiled_have_the_same_fingerprint():
    program = 'from rigid_body_ros.runtime.fingerprint import fingerprint; print(fingerprint())'
    printed = subprocess.run([sys.executable, '-c', program], check=True, capture_output=True,
                             env={**os.environ, 'RIGID_BODY_ROS_KERNELS': 'python'},
                             text=True).stdout
    assert ast.literal_eval(printed) == fingerprint()


#: The fingerprint of an old recording.
OLD = {'numpy': fingerprint()['numpy'], 'rigid_body_ros': fingerprint()['rigid_body_ros'],
       'compiler': '12.2', 'processor': 'arm64 cortex-a72'}
UNKNOWN = {name: ('unknown', version) for name, version in fingerprint().items()}


@pytest.mark.slow
@pytest.mark.parametrize(('text', 'versions'), [(json.dumps(OLD), {}), *(
    (text, UNKNOWN) for text in ('[1, 2]', 'null', '{', '[' * 100_000, ''))], ids=range(6))
def test_a_recording_with_an_old_or_damaged_fingerprint_can_be_verified(tmp_path, text, versions):
    replay(TUMBLER, RUN, tmp_path / 'motion.mcap', until=1.0)
    path = rewritten(tmp_path / 'motion.mcap', tmp_path / 'other.mcap',
                     metadata={'fingerprint': text})
    result = verify(TUMBLER, RUN, path)
    assert (result.same.all(), result.versions) == (True, versions)


def test_differing_bits_end_with_status_1(tmp_path, capsys):
    replay(TUMBLER, RUN, tmp_path / 'motion.mcap')
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
    config = folder / 'run.yaml'
    config.write_text(f'{SCENE.read_text()}    start_time: {start_time}\n')
    torques = rows(STAMPS / SECOND, 0.01 * np.random.default_rng(3).normal(size=(50, 3)))
    _, *sent = epoch(RUN, replace(RUN.start, time_ns=START_NS), {'/torque': torques})
    sent = without(without(sent, '/torque', *lost), COMMITTED, *unseen)
    return save(folder / 'run.mcap', sent, '/torque'), str(config)


def test_the_torques_that_a_node_received_give_its_states_again(tmp_path, capsys):
    log, config = node_log(tmp_path)
    assert main.attitude_replay([log, '--scene', config, '--verify', log]) == 0
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
def test_a_log_that_is_not_complete_is_recognized(tmp_path, refusal, missing, message):
    log, config = node_log(tmp_path, **missing)
    assert f'run.mcap: /node/committed: {message}' in refusal(
        'attitude_replay', log, '--scene', config, '--verify', log)


def test_torques_that_begin_after_a_motion_are_recognized(tmp_path, refusal):
    replay(TUMBLER, RUN, tmp_path / 'motion.mcap')
    read = recording.read(TUMBLER)
    late = write_torques(tmp_path / 'late.mcap', zip(read.stamps_ns[100:], read.frame_ids[100:],
                                                     read.values[100:, 3:]))
    line = refusal('attitude_replay', late, '--scene', SCENE, '--verify', tmp_path / 'motion.mcap')
    assert ('expected the first state at or after the first torque, '
            f'{read.stamps_ns[100]} ns, found it at {read.stamps_ns[0]} ns: the beginning of the '
            'torque log or the start_time of the scene is missing') in line


def test_a_recording_says_how_it_was_made(tmp_path):
    replay(TUMBLER, RUN, tmp_path / 'motion.mcap')
    with recording.Source(tmp_path / 'motion.mcap', '/attitude', [messages.QUATERNION]) as source:
        about = source.metadata('rigid_body_ros')
    assert json.loads(about['fingerprint']) == fingerprint()
    assert json.loads(about['scene']) == dict(RUN.values)
    assert about['torques'] == 'tumbler.mcap'


@pytest.mark.slow
def test_a_folder_is_what_rosbag2_wants(tmp_path):
    folder = tmp_path / 'motion'
    replay(TUMBLER, RUN, folder)
    assert sorted(path.name for path in folder.iterdir()) == ['metadata.yaml', 'motion_0.mcap']
    about = yaml.safe_load((folder / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    ours = attitudes(folder)
    assert about['message_count'] == 3 * len(ours)
    assert about['starting_time']['nanoseconds_since_epoch'] == ours.stamps_ns[0]
    with AnyReader([folder]) as reader:
        assert {each.topic: each.msgcount for each in reader.connections} == dict.fromkeys(
            ['/attitude', '/euler_angles', '/angular_velocity'], len(ours))
        theirs = [reader.deserialize(data, each.msgtype).quaternion
                  for each, _, data in reader.messages() if each.topic == '/attitude']
    np.testing.assert_array_equal([[q.x, q.y, q.z, q.w] for q in theirs], ours.values)


def test_until_holds_for_ordinary_recordings_too(tmp_path):
    output = tmp_path / 'out.mcap'
    replay(TUMBLER, RUN, output)
    first = int(attitudes(output).stamps_ns[0])
    result = verify(TUMBLER, RUN, output, until=1.0)
    assert result.same.all()
    assert first < result.stamps_ns[-1] <= first + SECOND
    replay(TUMBLER, replace(RUN, start=replace(RUN.start, time_ns=first + 2 * SECOND)), output)
    with pytest.raises(InputError, match='/attitude: expected states up to --until, at '):
        verify(TUMBLER, RUN, output, until=1.0)
