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

"""A replay piece by piece has the same bits as in one piece."""

from itertools import pairwise
import re

from conftest import at_night, CONFIG, EPOCH_NS, RECORDINGS, SECOND, write_torques
import numpy as np
import pytest
from rigid_body_ros import messages, recording, scene, TorqueLog
from rigid_body_ros.recording import torques, writer
from rigid_body_ros.replay import batches, replay, single
from rigid_body_ros.scene import InputError

FIELDS = {'fields': ['pivot'], 'pivot.moment.z': -0.02, 'pivot.field.z': -9.81,
          'orbit.mean_motion': 0.4}


@pytest.mark.slow
@pytest.mark.parametrize(('interpolation', 'options', 'fields'), [
    ('hold', {}, {}), ('linear', {'rate': 37.0}, {}), ('cubic', {'until': 7.3}, {}),
    ('cubic', {'rate': 37.0}, FIELDS), ('hold', {'until': 7.3}, FIELDS),
    ('hold', {'start': 20.005, 'until': 1.0, 'rate': 100.0}, {}),
    ('hold', {'start': 20.005, 'until': 1.0, 'rate': 100.0}, {'start_time': EPOCH_NS}),
    *at_night(('linear', {'until': 900.0}, FIELDS))], ids=str)
def test_a_recording_in_pieces_gives_the_bits_of_the_whole(tmp_path, monkeypatch, interpolation,
                                                           options, fields):
    loaded = scene.Scene.from_values({**scene.load(CONFIG / 'tumbler.yaml').values, **fields})
    whole = replay(RECORDINGS / 'tumbler.mcap', loaded, interpolation=interpolation, **options)
    monkeypatch.setattr(torques, '_SAMPLES', 100)
    monkeypatch.setattr(batches, '_LARGEST', 70)
    monkeypatch.delattr(single, '_whole')  # which would read the whole recording
    result = replay(RECORDINGS / 'tumbler.mcap', loaded, tmp_path / 'out.mcap',
                    interpolation=interpolation, **options)
    written = recording.read(tmp_path / 'out.mcap', '/attitude', messages.QUATERNION)
    np.testing.assert_array_equal(written.stamps_ns, whole.trajectory.times_ns)
    np.testing.assert_array_equal(written.values, whole.trajectory.attitude)
    assert result.account.samples == whole.account.samples
    assert result.last_ns == whole.last_ns


def written(path, order, torques=None, frames=('',)):
    """Write torques at 1 kHz in an order; each frame applies to one part of the time."""
    return write_torques(path, [
        (EPOCH_NS + row * SECOND // 1000, frames[row * len(frames) // len(order)],
         [row % 7, 0, 1] if torques is None else torques[place])
        for place, row in enumerate(order)])


def test_pieces_are_those_of_the_sorted_log(monkeypatch):
    monkeypatch.setattr(torques, '_SAMPLES', 50)
    random, count = np.random.default_rng(6), 1000
    rows = np.arange(count).reshape(-1, 40)
    stamps = EPOCH_NS + random.permuted(
        np.cumsum(random.integers(0, 3, count))[rows], axis=1).ravel()
    late = [200 + int(stamps[200:240].argmin()), 270]  # one comes a block too late
    stamps[late] = stamps[late[::-1]]
    values, frames = random.normal(size=(count, 6)), random.integers(0, 2, count)
    pieces = [*torques.torque_pieces('here', [recording.Messages(
        '/torque', stamps[block], frames[block], ['', 'world'], values[block])
        for block in rows], 'base_link', 'world')]
    parts = [pieces[0].rows(slice(pieces[0].stop))]
    for before, piece in pairwise(pieces):
        # A piece ends three samples after `stop`, and the next begins three samples before.
        assert 50 <= before.stop == len(before.times_ns) - 4
        np.testing.assert_array_equal(piece.times_ns[:7], before.times_ns[-7:])
        parts.append(piece.rows(slice(3, piece.stop)))
    assert len(parts) > 5
    whole = TorqueLog(stamps, values[:, 3:], frames == 1)
    for name in ('times_ns', 'torques', 'in_space'):
        np.testing.assert_array_equal(np.concatenate([getattr(part, name) for part in parts]),
                                      getattr(whole, name))


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['far', 'descending', 'any'])
def test_stamps_out_of_order_are_put_in_order_and_told(tmp_path, monkeypatch, kind):
    monkeypatch.setattr(torques, '_SAMPLES', 100)
    if kind == 'far':  # some stamps come many blocks too late
        monkeypatch.setattr(writer, '_CHUNK', 2 ** 12)  # what is read at a time
    count, random = 8_000, np.random.default_rng(6)
    rows = np.arange(count) if kind != 'any' else np.sort(random.integers(0, count, count))
    blocks = rows.reshape(-1, 40)  # with 'any', some stamps are equal
    order = {'far': blocks, 'descending': blocks[:, ::-1],
             'any': random.permuted(blocks, axis=1)}[kind].ravel()
    late = [1000, 7000 if kind == 'far' else 1050]  # two rows of different blocks change places
    order[late] = order[late[::-1]]
    path, loaded = tmp_path / 'in.mcap', scene.load(CONFIG / 'tumbler.yaml')
    written(path, order.tolist(), random.normal(scale=1e-3, size=(count, 3)))
    whole, result = replay(path, loaded), replay(path, loaded, tmp_path / 'motion.mcap')
    np.testing.assert_array_equal(result.last.attitude, whole.last.attitude)
    assert (result.account.counted, result.account.faults) == (
        whole.account.counted, whole.account.faults)
    assert kind != 'far' or '8000 of 8000 samples are used: 6000 late and sorted' in result.text()
    assert bool(result.account.faults) == (kind != 'far')


@pytest.mark.parametrize('config', ['tumbler', 'free'])
def test_a_check_says_what_beginning_of_the_motion_it_covers(tmp_path, monkeypatch, config):
    monkeypatch.setattr(torques, '_SAMPLES', 100)
    path, loaded = RECORDINGS / 'tumbler.mcap', scene.load(CONFIG / 'tumbler.yaml')
    if config == 'free':
        path = written(tmp_path / 'in.mcap', range(1000), np.zeros((1000, 3)))
    with monkeypatch.context() as patch:
        patch.setattr(batches, '_LARGEST', 70)
        result = replay(path, loaded, tmp_path / 'out.mcap')
    text = result.text()
    span = (result.last.time_ns - result.start.time_ns) * 1e-9
    assert re.search(rf', checked over the first [0-9.]+ s of {span:.9g} s\n', text)
    assert 0.0 < result.check.covered < 0.3 * span
    whole = replay(path, loaded)
    assert f', checked over all {span:.9g} s\n' in whole.text()


@pytest.mark.parametrize(('offset_ns', 'rate'), [(0, 3.0), (SECOND // 2, None)])
def test_a_piece_may_have_no_output_and_the_motion_may_begin_after_the_first(
        tmp_path, monkeypatch, offset_ns, rate):
    monkeypatch.setattr(torques, '_SAMPLES', 100)
    monkeypatch.setattr(writer, '_CHUNK', 2 ** 12)  # what is read at a time
    path = written(tmp_path / 'in.mcap', range(1000),
                   np.random.default_rng(4).normal(scale=1e-3, size=(1000, 3)))
    values = scene.load(CONFIG / 'tumbler.yaml').values
    loaded = scene.Scene.from_values({**values, 'start_time': EPOCH_NS + offset_ns})
    result = replay(path, loaded, tmp_path / 'out.mcap', rate=rate)
    whole = replay(path, loaded, rate=rate)
    np.testing.assert_array_equal(result.last.attitude, whole.last.attitude)
    assert (result.first_ns, result.check.total) == (whole.first_ns, whole.check.total)


def test_frames_that_change_late_are_refused_between_samples_as_well(tmp_path, monkeypatch):
    monkeypatch.setattr(torques, '_SAMPLES', 100)
    path = written(tmp_path / 'in.mcap', range(1000), frames=('base_link', 'world'))
    loaded = scene.load(CONFIG / 'tumbler.yaml')
    replay(path, loaded, tmp_path / 'motion.mcap')
    with pytest.raises(InputError, match='interpolation linear: expected torques in one frame'):
        replay(path, loaded, tmp_path / 'motion.mcap', interpolation='linear')
