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

"""A replay piece by piece has the same bits as in one piece, whatever the pieces are."""

from itertools import pairwise
import re

from conftest import at_night, CONFIG, EPOCH_NS, RECORDINGS, SECOND
import numpy as np
import pytest
from rigid_body_ros import messages, propagate, recording, RigidBody, scene, State, TorqueLog
from rigid_body_ros.propagation import Integration, Problem
from rigid_body_ros.recording import torques, writer
from rigid_body_ros.replay import batches, replay
from rigid_body_ros.scene import InputError

BODY = RigidBody.from_moments(1.1, 2.0, 2.7, 0.15, -0.2, 0.05)
TOPICS = {'/attitude': messages.QUATERNION, '/euler_angles': messages.VECTOR3,
          '/angular_velocity': messages.VECTOR3}


def some_torques(random, count=400):
    """Return irregular stamps and torques; some stretches of the torques are zero."""
    stamps = EPOCH_NS + np.cumsum(random.integers(1, SECOND // 5, count))
    values = random.normal(size=(count, 3))
    values[np.repeat(random.uniform(size=count // 10) < 0.4, 10)] = 0.0
    return stamps, values


@pytest.mark.parametrize('options', [
    {}, {'solver': 'taylor'}, {'torque_timeout': 0.05}, {'solver': 'rk4', 'max_step': 0.01},
    {'tolerance': 1e-6, 'torque_timeout': 0.12}], ids=str)
@pytest.mark.parametrize('interpolation', ['hold', 'linear', 'cubic'])
def test_a_run_in_pieces_has_the_bits_of_the_whole(interpolation, options):
    random = np.random.default_rng(8)
    for trial in range(4):
        stamps, values = some_torques(random)
        cuts = [*np.sort(random.choice(np.arange(6, 390), 8, replace=False)).tolist(), None]
        frames = random.choice(['body', 'space'], len(stamps)).tolist() \
            if interpolation == 'hold' else 'space'
        start_ns = int(stamps[cuts[1]]) if trial % 2 else EPOCH_NS + SECOND
        start = State(start_ns, angular_velocity=(2.0, -0.1, 1.0))
        times = np.sort(np.append(random.integers(start_ns, int(stamps[-1]), 300), start_ns))
        whole = propagate(BODY, start, TorqueLog(stamps, values, frames, interpolation),
                          at=times, **options)
        log = TorqueLog(stamps, values, frames, interpolation)
        pieces = [log.rows(slice(max(begin - 3, 0), None if end is None else end + 4))
                  for begin, end in pairwise([0, *cuts])]
        run, attitudes = Integration(Problem(BODY, start, pieces[0], **options)), []
        run.advance([])  # changes nothing
        for number, (piece, cut) in enumerate(zip(pieces, cuts)):
            if number:
                run.extend(Problem(BODY, start, piece, **options))
            end = None if cut is None else int(stamps[cut])
            asked = times[:np.searchsorted(times, stamps[-1] if end is None else end, 'right')]
            attitudes.append(run.advance(asked, end).attitude)
            times = times[len(asked):]
        np.testing.assert_array_equal(np.concatenate(attitudes), whole.attitude)


@pytest.mark.parametrize('options', [
    {}, {'torque_timeout': 0.05}, {'solver': 'rk4', 'max_step': 0.01}], ids=str)
@pytest.mark.parametrize('interpolation', ['hold', 'linear', 'cubic'])
@pytest.mark.parametrize('rotors', ['none', 'constant', 'motors'])
def test_several_sources_in_pieces_have_the_bits_of_the_whole(interpolation, options, rotors):
    random = np.random.default_rng(11)
    for trial in range(3):
        logs = [TorqueLog(*some_torques(random, count), frame, interpolation)
                for count, frame in ((300, 'body'), (200, 'space' if trial else 'body'))]
        wheels = TorqueLog(*some_torques(random, 250)) if rotors == 'motors' else None
        start = State(EPOCH_NS + SECOND, angular_velocity=(2.0, -0.1, 1.0),
                      rotor_momentum=(0.1, 0.2, 0.0) if rotors != 'none' else (0, 0, 0))
        whole = Problem(BODY, start, logs, wheels=wheels, **options)
        ends = np.sort(random.choice(np.concatenate([log.times_ns for log in whole.sources]), 6))
        ends = [int(end) for end in ends if start.time_ns < end < logs[0].times_ns[-1]]
        at = np.sort(random.integers(start.time_ns, ends[-1] + SECOND, 200))
        run, found, begin = None, [], start.time_ns
        for end in [*ends, None]:
            pieces = [log.between(begin, at[-1] if end is None else end) for log in logs]
            motors = wheels and wheels.between(begin, at[-1] if end is None else end)
            problem = Problem(BODY, start, pieces, wheels=motors, **options)
            if run:
                run.extend(problem)
            else:
                run = Integration(problem)
            asked = at if end is None else at[(at <= end)]
            found.append(run.advance(asked, end))
            at, begin = at[len(asked):], end
        times = np.concatenate([motion.times_ns for motion in found])
        motion = whole.propagate(at=times)
        for name in ('attitude', 'angular_velocity', 'rotor_momentum'):
            np.testing.assert_array_equal(
                np.concatenate([getattr(each, name) for each in found]), getattr(motion, name))


@pytest.mark.parametrize('zero', [False, True], ids=['torque', 'coast'])
def test_the_end_of_a_piece_may_be_asked_for_more_than_once(zero):
    stamps = EPOCH_NS + np.arange(6) * SECOND
    log = TorqueLog(stamps, np.random.default_rng(9).normal(size=(6, 3)) * (not zero))
    start = State(EPOCH_NS, angular_velocity=(2.0, -0.1, 1.0))
    expected = propagate(BODY, start, log, at=[stamps[3]])
    run = Integration(Problem(BODY, start, log))
    for asked in ([stamps[3], stamps[1], stamps[3], stamps[3]], [stamps[3]]):
        motion = run.advance(asked, int(stamps[3]))
        for row in np.flatnonzero(np.equal(asked, stamps[3])):
            np.testing.assert_array_equal(motion.attitude[row], expected.attitude[0])
            np.testing.assert_array_equal(motion.angular_velocity[row],
                                          expected.angular_velocity[0])


@pytest.mark.slow
@pytest.mark.parametrize('interpolation', ['hold', 'linear', 'cubic'])
@pytest.mark.parametrize('options', [{}, {'rate': 37.0}, {'until': 7.3}, *at_night(
    {'until': 900.0})], ids=str)
@pytest.mark.parametrize('fields', [{}, {
    'fields': ['pivot'], 'pivot.moment.z': -0.02, 'pivot.field.z': -9.81,
    'orbit.mean_motion': 0.4}], ids=['plain', 'fields'])
def test_a_recording_in_pieces_gives_the_bits_of_the_whole(tmp_path, monkeypatch, interpolation,
                                                           options, fields):
    loaded = scene.load(CONFIG / 'tumbler.yaml')
    if fields:
        loaded = scene.Scene.from_values({**loaded.values, **fields})
    whole = replay(RECORDINGS / 'tumbler.mcap', loaded, interpolation=interpolation, **options)
    monkeypatch.setattr(torques, '_SAMPLES', 100)
    monkeypatch.setattr(batches, '_LARGEST', 70)
    result = replay(RECORDINGS / 'tumbler.mcap', loaded, tmp_path / 'out.mcap',
                    interpolation=interpolation, **options)
    written = recording.read(tmp_path / 'out.mcap', '/attitude', messages.QUATERNION)
    np.testing.assert_array_equal(written.stamps_ns, whole.trajectory.times_ns)
    np.testing.assert_array_equal(written.values, whole.trajectory.attitude)
    assert result.account.samples == whole.account.samples
    assert result.last_ns == whole.last_ns


def written(path, values):
    """Write torques at 1 kHz."""
    with recording.Writer(path) as writer:
        writer.add_topic('/torque', messages.WRENCH)
        for stamp_ns, torque in zip(range(EPOCH_NS, 2 ** 63, SECOND // 1000), values):
            writer.write('/torque', stamp_ns, messages.wrench(stamp_ns, '', 1e-3 * torque))
    return path


def shuffled(path, order, frames=('',)):
    """Write torques at 1 kHz in another order; each frame applies to one part of the time."""
    with recording.Writer(path) as writer:
        writer.add_topic('/torque', messages.WRENCH)
        for row in order:
            stamp_ns = EPOCH_NS + int(row) * SECOND // 1000
            frame = frames[int(row) * len(frames) // len(order)]
            writer.write('/torque', stamp_ns, messages.wrench(stamp_ns, frame, [row % 7, 0, 1]))
    return path


@pytest.mark.parametrize('order', ['ascending', 'descending', 'any'])
def test_pieces_are_those_of_the_sorted_log(monkeypatch, order):
    monkeypatch.setattr(torques, '_SAMPLES', 50)
    random, count, size = np.random.default_rng(6), 1000, 40
    # Equal stamps do not count as descending.
    stamps = EPOCH_NS + np.cumsum(random.integers(order == 'descending', 3, count))
    for begin in range(0, count, size):
        block = stamps[begin:begin + size]
        block[:] = {'ascending': block, 'descending': block[::-1].copy(),
                    'any': random.permutation(block)}[order]
    late = [int(stamps[200:240].argmin()) + 200, 270]  # one comes a block too late
    stamps[late] = stamps[late[::-1]]
    values, frames = random.normal(size=(count, 6)), random.integers(0, 2, count)
    blocks = [recording.Messages('/torque', stamps[rows], frames[rows], ['', 'world'],
                                 values[rows])
              for rows in (slice(begin, begin + size) for begin in range(0, count, size))]
    only, = torques.torque_pieces('here', blocks[:1], 'base_link', 'world')
    assert np.all(np.diff(only.times_ns) > 0)
    first, *others = torques.torque_pieces('here', blocks, 'base_link', 'world')
    assert len(others) > 5
    before, parts = first, [first.rows(slice(first.stop))]
    for piece in others:
        # The previous piece ends three samples after `stop`, and this begins three samples before.
        assert 50 <= before.stop == len(before.times_ns) - 4
        np.testing.assert_array_equal(piece.times_ns[:7], before.times_ns[-7:])
        parts.append(piece.rows(slice(3, piece.stop)))
        before = piece
    assert before.stop is None
    whole = TorqueLog(stamps, values[:, 3:], frames == 1)
    for name in ('times_ns', 'torques', 'in_space'):
        np.testing.assert_array_equal(np.concatenate([getattr(part, name) for part in parts]),
                                      getattr(whole, name))


@pytest.mark.slow
@pytest.mark.parametrize('distance', [30_000, *at_night(3)])
def test_stamps_out_of_order_are_put_in_order_and_told(tmp_path, monkeypatch, distance):
    monkeypatch.setattr(torques, '_SAMPLES', 100)
    count, loaded = 40_000, scene.load(CONFIG / 'tumbler.yaml')
    order = np.arange(count)
    order[[5000, 5000 + distance]] = order[[5000 + distance, 5000]]
    whole = replay(shuffled(tmp_path / 'in.mcap', np.arange(count)), loaded)
    result = replay(shuffled(tmp_path / 'out.mcap', order), loaded, tmp_path / 'motion.mcap')
    np.testing.assert_array_equal(result.last.attitude, whole.last.attitude)
    assert (whole.account.counted, whole.account.faults, result.account.faults) == ('', [], [])
    assert (f'account       40000 of 40000 samples are used: {distance} late and sorted'
            in result.text())


@pytest.mark.parametrize('config', ['tumbler', 'free'])
def test_a_check_says_what_beginning_of_the_motion_it_covers(tmp_path, monkeypatch, config):
    monkeypatch.setattr(torques, '_SAMPLES', 100)
    path, loaded = RECORDINGS / 'tumbler.mcap', scene.load(CONFIG / 'tumbler.yaml')
    if config == 'free':
        path = written(tmp_path / 'in.mcap', np.zeros((1000, 3)))
    with monkeypatch.context() as patch:
        patch.setattr(batches, '_LARGEST', 70)
        result = replay(path, loaded, tmp_path / 'out.mcap')
    text = result.text()
    span = (result.last.time_ns - result.start.time_ns) * 1e-9
    assert re.search(rf', checked over the first [0-9.]+ s of {span:.9g} s\n', text)
    assert 0.0 < result.check.covered < 0.3 * span
    whole = replay(path, loaded)
    assert f', checked over all {span:.9g} s\n' in whole.text()


def test_a_motion_may_begin_after_the_first_piece(tmp_path, monkeypatch):
    monkeypatch.setattr(torques, '_SAMPLES', 100)
    monkeypatch.setattr(writer, '_CHUNK', 2 ** 12)  # what is read at a time
    path = written(tmp_path / 'in.mcap', np.random.default_rng(4).normal(size=(1000, 3)))
    text = (CONFIG / 'tumbler.yaml').read_text().replace(
        'ros__parameters:', f'ros__parameters:\n    start_time: {EPOCH_NS + SECOND // 2}')
    (tmp_path / 'late.yaml').write_text(text)
    loaded = scene.load(tmp_path / 'late.yaml')
    result, whole = replay(path, loaded, tmp_path / 'out.mcap'), replay(path, loaded)
    np.testing.assert_array_equal(result.last.attitude, whole.last.attitude)
    assert (result.first_ns, result.check.total) == (whole.first_ns, whole.check.total)


def test_the_last_piece_may_have_no_output(tmp_path, monkeypatch):
    stamps = EPOCH_NS + np.arange(400) * SECOND // 1000
    with recording.Writer(tmp_path / 'in.mcap') as log:
        log.add_topic('/torque', messages.WRENCH)
        for row, stamp in enumerate(stamps.tolist()):
            log.write('/torque', stamp, messages.wrench(stamp, '', (0.01 * (row % 5), 0.0, 0.01)))
    loaded = scene.load(CONFIG / 'tumbler.yaml')
    whole = replay(tmp_path / 'in.mcap', loaded, rate=3.0)
    monkeypatch.setattr(writer, '_CHUNK', 2 ** 12)
    monkeypatch.setattr(torques, '_SAMPLES', 50)
    result = replay(tmp_path / 'in.mcap', loaded, tmp_path / 'out.mcap', rate=3.0)
    assert result.last.attitude.tolist() == whole.last.attitude.tolist()


def test_frames_that_change_late_are_refused_between_samples_as_well(tmp_path, monkeypatch):
    monkeypatch.setattr(torques, '_SAMPLES', 100)
    path = shuffled(tmp_path / 'in.mcap', np.arange(1000), ('base_link', 'world'))
    loaded = scene.load(CONFIG / 'tumbler.yaml')
    replay(path, loaded, tmp_path / 'motion.mcap')
    with pytest.raises(InputError, match='interpolation linear: expected torques in one frame'):
        replay(path, loaded, tmp_path / 'motion.mcap', interpolation='linear')
