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

"""attitude_replay --verify compares every committed state of every epoch in a node's log."""

from dataclasses import replace

from conftest import CONFIG, RECORDINGS, SECOND
import node_logs
from node_logs import (
    ACCEPTED,
    attitudes,
    called,
    COMMITTED,
    epoch,
    FIRST,
    MORE,
    rows,
    save,
    SECOND_START,
    TORQUES,
    without,
)
import numpy as np
import pytest
from rigid_body_ros import messages, scene, State
from rigid_body_ros.commands import main
from rigid_body_ros.replay import replay
from rigid_body_ros.replay.verify import verify
from rigid_body_ros.scene import InputError

MS = 10 ** 6


@pytest.fixture
def run():
    return scene.load(CONFIG / 'tumbler.yaml')


@pytest.fixture
def two(run, tmp_path):
    """Return a recording of two epochs."""
    return save(tmp_path / 'two.mcap', [*epoch(run, FIRST, TORQUES),
                                        *epoch(run, SECOND_START, MORE)])


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
    sent = [*epoch(run, FIRST, TORQUES), *epoch(run, SECOND_START, MORE)]
    log = save(tmp_path / 'log.mcap', committed(sent, 17, nudged))
    assert called(tmp_path, 'verify', log) == 1
    words = capsys.readouterr().out
    assert 'same bits     70 of 71\n' in words
    stamp = node_logs.motion_of(run, FIRST, TORQUES).times_ns[17]
    assert f'first in state 18, at {stamp} ns: 0 rad' in words


def test_states_after_until_are_not_compared(run, tmp_path, capsys):
    sent = [*epoch(run, FIRST, TORQUES), *epoch(run, SECOND_START, MORE)]
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
    sent = [*epoch(run, FIRST, TORQUES), *epoch(run, SECOND_START, MORE)]
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
    sent = [*epoch(run, FIRST, TORQUES), *epoch(run, SECOND_START, MORE)]
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
