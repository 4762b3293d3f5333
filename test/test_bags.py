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

"""Recordings of every form: torques are read to the last bit, or losses are reported."""

from io import BytesIO
import os
import re

import bags
from bags import FORMS, LOGGED, mcap, PUBLISHED, records, Torques, traffic, UNINDEXED
from hostile import limits, zeros
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader
from mcap.records import Chunk
from mcap.writer import CompressionType
import numpy as np
import pytest
from rigid_body_ros import recording
from rigid_body_ros.scene import InputError

ALONE = bags.torques()
MIXED = bags.torques(frames=['base_link', 'world'], seed=2)
SENT = {'alone': traffic(ALONE), 'others': traffic(MIXED, others=True)}
RECORDED = {'alone': ALONE, 'others': MIXED}
#: Number of examples; a nightly run sets 10 000.
EXAMPLES = int(os.environ.get('FUZZ_EXAMPLES', '160'))
#: Records that messages are read from.
WITH_MESSAGES = (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK)

#: Forms in which each message has two times.
MCAP = [form for form in FORMS if form.startswith('mcap')]


def read(path, **options):
    """Return the contents in a form that can be compared, and the report of damage."""
    found = recording.read(path, **options)
    assert found.stamps_ns.dtype == np.int64
    assert found.values.dtype == np.float64
    assert found.values.shape == (len(found.stamps_ns), 6)
    assert len(found.frame_ids) == len(found.stamps_ns)
    assert '\n' not in found.damage
    return Torques(found.stamps_ns, found.frame_ids, found.values), found.damage


def read_whole(path, **options):
    found, damage = read(path, **options)
    assert damage == ''
    return found


def outcome(path):
    """Return the error as one line, or '', and the rows that are read, within limits."""
    with limits(200e6):
        try:
            found, damage = read(path)
        except InputError as error:
            assert path.name in str(error)
            assert '\n' not in str(error)
            return str(error), []
    return damage, found.rows()


@pytest.mark.slow
@pytest.mark.parametrize(('form', 'sent'), [
    *((form, 'others') for form in FORMS), *((form, 'alone') for form in FORMS if form in MCAP),
    ('ours', 'alone'), ('bare-sqlite3', 'alone'), ('split-mcap-message', 'alone')])
def test_every_form_is_read_to_the_last_bit(tmp_path, form, sent):
    path, recorded = FORMS[form](tmp_path, SENT[sent]), RECORDED[sent]
    before = {file: file.read_bytes() for file in tmp_path.rglob('*') if file.is_file()}
    assert read_whole(path).rows() == recorded.rows()
    assert {file: file.read_bytes() for file in before} == before
    if sent == 'alone':
        return
    for source, later in (('log', LOGGED), *([('publish', PUBLISHED)] * (form in MCAP))):
        found = read_whole(path, time_source=source)
        np.testing.assert_array_equal(found.stamps_ns, recorded.stamps_ns + later)
        assert found.frame_ids == recorded.frame_ids
    if form in MCAP:
        assert bags.read_by_mcap(path).rows() == recorded.rows()
    if form not in bags.UNREAD:
        found, log_ns = bags.read_by_rosbags(path)
        assert found.rows() == recorded.rows()
        np.testing.assert_array_equal(log_ns, recorded.stamps_ns + LOGGED)


@pytest.mark.parametrize('form', ['mcap-zstd', 'mcap-none-unchunked-unindexed', 'mcap-big-endian',
                                  'mcap-dirty', 'rosbag2-mcap-message', 'bare-sqlite3'])
def test_topics_are_told_apart_in_the_order_of_the_file_whatever_their_frames(tmp_path, form):
    left = bags.torques(frames=bags.FRAMES, seed=3)
    left, right = left[np.random.default_rng(4).permutation(200)], MIXED
    both = zip(traffic(left, '/left'), traffic(right, '/right'))
    path = FORMS[form](tmp_path, [one for pair in both for one in pair])
    assert read_whole(path, topic='/left').rows() == left.rows()
    assert read_whole(path, topic='/right').rows() == right.rows()
    with pytest.raises(InputError, match=re.escape(
            'found /left (geometry_msgs/msg/WrenchStamped), /right '
            '(geometry_msgs/msg/WrenchStamped); choose one with --topic')):
        recording.read(path)


@pytest.mark.parametrize(('form', 'time_source', 'later'), [
    ('mcap-zstd', 'header', LOGGED), ('rosbag2-mcap-message', 'header', LOGGED),
    ('bare-sqlite3', 'log', LOGGED), ('mcap-none-unchunked-unindexed', 'log', LOGGED),
    ('mcap-idl', 'publish', PUBLISHED)])
def test_a_wrench_without_a_header_has_a_time_of_the_recording(tmp_path, form, time_source, later):
    path = FORMS[form](tmp_path, traffic(MIXED, others=True, header=False))
    expected = Torques(MIXED.stamps_ns + later, [''] * 200, MIXED.values)
    assert read_whole(path, time_source=time_source).rows() == expected.rows()


@pytest.mark.slow
@pytest.mark.parametrize('options', [{}, UNINDEXED], ids=['indexed', 'unindexed'])
@pytest.mark.parametrize('chunked', [True, False], ids=['chunked', 'unchunked'])
def test_of_a_truncated_file_all_whole_chunks_or_messages_are_read(tmp_path, chunked, options):
    path = mcap(tmp_path, SENT['others'], use_chunking=chunked, compression=CompressionType.ZSTD,
                **options)
    data = path.read_bytes()
    code = Opcode.CHUNK if chunked else Opcode.MESSAGE
    ends = [end for opcode, _, end in records(data) if opcode == code]
    whole = ends[len(ends) * 2 // 3]
    for end in (*(len(data) * part // 16 for part in range(1, 16, 2)),
                *(whole + beyond for beyond in (-1, 0, 1, 8, 9, 10, 40))):
        check_truncated(path, data, end, MIXED)


@pytest.mark.slow
@pytest.mark.parametrize('form', ['mcap-zstd', 'mcap-none-unchunked'])
@pytest.mark.parametrize('share', [0.2, 0.99])
def test_zeros_that_a_crash_left_at_the_end_are_damage(tmp_path, form, share):
    path = FORMS[form](tmp_path, SENT['others'])
    data = path.read_bytes()
    ends = [end for *_, end in records(data)]
    check_truncated(path, data, ends[int(len(ends) * share)], MIXED, zeros=2 ** 26)


def check_truncated(path, data, end, recorded, zeros=0):
    """Read the first bytes of a file: expect the contents of complete records, or one error."""
    expected = held(data, [place for place in records(data) if place[2] <= end])
    path.write_bytes(data[:end])
    os.truncate(path, end + zeros)
    told, found = outcome(path)
    assert told
    assert found == recorded.rows()[:expected]


def held(data, places):
    """Return how many torques the records contain according to mcap's own reader."""
    whole = data[:8] + b''.join(data[start:end] for code, start, end in places
                                if code in WITH_MESSAGES)
    footer = bytes([Opcode.FOOTER]) + (20).to_bytes(8, 'little') + bytes(20)
    reader = NonSeekingReader(BytesIO(whole + footer + data[:8]), validate_crcs=True)
    return len([*reader.iter_messages(['/torque'], log_time_order=False)])


@pytest.mark.parametrize('options', [{}, {'use_chunking': False}, {'enable_data_crcs': True}],
                         ids=['chunked', 'unchunked', 'data-crc'])
@pytest.mark.parametrize('lost', ['data-end', 'summary', 'half-summary', 'footer', 'last-byte'])
def test_a_file_that_lost_its_summary_only_has_all_messages(tmp_path, options, lost):
    path = mcap(tmp_path, SENT['others'], **options)
    data = path.read_bytes()
    places = {code: (start, end) for code, start, end in records(data)}
    begin, after = places[Opcode.DATA_END]
    footer, _ = places[Opcode.FOOTER]
    end = {'data-end': begin, 'summary': after, 'half-summary': (after + footer) // 2,
           'footer': footer, 'last-byte': len(data) - 1}[lost]
    path.write_bytes(data[:end])
    found, damage = read(path)
    assert found.rows() == MIXED.rows()
    assert re.search('summary|index|end|cut', damage)


@pytest.mark.parametrize('compression', list(CompressionType), ids=lambda kind: kind.name.lower())
@pytest.mark.parametrize('options', [{}, UNINDEXED], ids=['indexed', 'unindexed'])
def test_of_a_damaged_chunk_nothing_is_used_but_all_before_it(tmp_path, compression, options):
    path = mcap(tmp_path, SENT['alone'], compression=compression, **options)
    data = bytearray(path.read_bytes())
    chunks = [place for place in records(data) if place[0] == Opcode.CHUNK]
    _, start, end = chunks[2]
    before, within = (held(data, chunks[:count]) for count in (2, 3))
    data[(start + end) // 2] ^= 0x10
    path.write_bytes(data)
    found, damage = read(path)
    assert damage
    assert found.rows() in (ALONE.rows()[:before], ALONE.rows()[:before] + ALONE.rows()[within:])


def test_a_schema_that_cannot_be_read_is_damage(tmp_path):
    path = mcap(tmp_path, SENT['alone'], use_chunking=False, **UNINDEXED)
    data = path.read_bytes()
    start = next(start for code, start, _ in records(data) if code == Opcode.SCHEMA)
    path.write_bytes(data[:start + 11] + b'\xff' * 4 + data[start + 15:])  # the size of its name
    told, rows = outcome(path)
    assert f'damaged at byte {start}: ' in told
    assert not rows


@pytest.mark.slow
@pytest.mark.parametrize(('storage', 'compression', 'harm'), [
    ('MCAP', 'NONE', 'cut'), ('MCAP', 'MESSAGE', 'emptied'), ('MCAP', 'FILE', 'removed'),
    ('SQLITE3', 'NONE', 'removed'), ('SQLITE3', 'MESSAGE', 'cut'), ('SQLITE3', 'FILE', 'emptied'),
    ('MCAP', 'FILE', 'cut'), ('SQLITE3', 'FILE', 'cut')])
def test_of_split_files_those_before_the_damage_are_read(tmp_path, storage, compression, harm):
    bag = bags.split(tmp_path, SENT['alone'], storage=storage, compression=compression, parts=4)
    part, = bag.glob('bag_2.*')
    if harm == 'removed':
        part.unlink()
    else:
        part.write_bytes(part.read_bytes()[:500 if harm == 'cut' else 0])
    told, rows = outcome(bag)
    assert part.name in told
    assert rows in (ALONE.rows()[:100], ALONE.rows()[:100] + ALONE.rows()[150:]) or (
        harm == 'removed' and not rows)


@pytest.mark.parametrize('form', ['mcap-zstd-unindexed', 'mcap-none-unchunked-unindexed'])
@pytest.mark.parametrize('begun', [False, True])
def test_a_file_may_grow_while_it_is_read(tmp_path, form, begun):
    path = FORMS[form](tmp_path, SENT['alone'])
    data = path.read_bytes()
    path.write_bytes(data[:len(data) // 2])
    with recording.source.Source(path, None, recording.TORQUES) as source:
        blocks = iter(source)
        found = [next(blocks)] if begun else []
        path.write_bytes(data[:-len(data) // 3])
        found += blocks
        assert re.search(r'cut off (or damaged )?at byte \d+', source.damage)
        assert 'found -' not in source.damage
    stamps = np.concatenate([block.stamps_ns for block in found])
    assert stamps.tolist() == ALONE.stamps_ns[:len(stamps)].tolist()
    assert begun or len(stamps) > len(ALONE.stamps_ns) // 2


@pytest.mark.parametrize('storage', ['MCAP', 'SQLITE3'])
def test_compressed_messages_without_their_description_are_read_or_told(tmp_path, storage):
    path = bags.bare(tmp_path, SENT['alone'], storage=storage, compression='MESSAGE')
    told, rows = outcome(path)
    assert told or rows == ALONE.rows()


@pytest.mark.slow
@pytest.mark.parametrize(('compression', 'claimed', 'says_its_size'), [
    ('zstd', 1000, False), ('zstd', 2 ** 60, True), ('lz4', 2 ** 60, False), ('lz4', 1000, True)])
def test_a_chunk_that_would_fill_the_memory_is_damage(tmp_path, compression, claimed,
                                                      says_its_size):
    path = mcap(tmp_path, SENT['alone'], **UNINDEXED)
    data = path.read_bytes()
    read_whole(path)
    end, = (start for code, start, _ in records(data) if code == Opcode.DATA_END)
    builder = RecordBuilder()
    Chunk(compression, zeros(2 ** 28, compression, says_its_size), 0, 1, 0, claimed).write(builder)
    path.write_bytes(data[:end] + builder.end() + data[end:])
    told, rows = outcome(path)
    assert told
    assert rows == ALONE.rows()


#: Forms, and the file of each that is damaged.
FUZZED = {
    'mcap-zstd': 'recording.mcap',
    'mcap-zstd-unindexed': 'recording.mcap',
    'mcap-lz4': 'recording.mcap',
    'mcap-none-unchunked': 'recording.mcap',
    'sqlite3-humble': 'bag_0.db3',
    'rosbag2-sqlite3-message': 'bag/bag.db3',
    'rosbag2-mcap-file': 'bag/bag.mcap.zstd',
    'rosbag2-mcap-none': 'bag/metadata.yaml',
}
#: Bags whose messages have checksums.
CHECKED = ('mcap-zstd', 'mcap-zstd-unindexed', 'mcap-lz4')


def harms(data):
    """Return a strategy of ways to damage bytes, often at places where something begins."""
    begins = [start for _, start, _ in records(data)] if data.startswith(b'\x89MCAP') \
        else range(0, len(data), 4096)
    near = st.builds(lambda begin, more: min(begin + more, len(data) - 1),
                     st.sampled_from(begins), st.integers(0, 60))
    place = st.integers(0, len(data) - 1) | near
    return st.one_of(
        st.tuples(st.just('flip'), st.lists(st.tuples(place, st.integers(1, 255)), min_size=1,
                                            max_size=8)),
        st.tuples(st.just('cut'), place),
        st.tuples(st.just('repeat'), st.tuples(place, place).map(sorted)))


def harmed(data, harm):
    match harm:
        case 'cut', end:
            return data[:end]
        case 'repeat', (start, end):
            return data[:end] + data[start:]
    flipped = bytearray(data)
    for place, bits in harm[1]:
        flipped[place] ^= bits
    return bytes(flipped)


@pytest.mark.slow
@pytest.mark.parametrize('form', FUZZED)
def test_harmed_files_give_genuine_messages_or_a_line(tmp_path, form):
    path = FORMS[form](tmp_path, SENT['others'])
    genuine = set(read_whole(path).rows())
    target = tmp_path / FUZZED[form]
    data = target.read_bytes()

    @settings(max_examples=max(1, EXAMPLES // len(FUZZED)), database=None)
    @given(harms(data))
    def check(harm):
        target.write_bytes(harmed(data, harm))
        _, rows = outcome(path)
        assert form not in CHECKED or genuine.issuperset(rows)
    check()
