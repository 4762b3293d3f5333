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

"""Recordings of a node with several epochs: each is replayed and verified from its own start."""

from dataclasses import replace
import json

from conftest import at_night, CONFIG, memory_limit, ROOT, SECOND
from node_logs import attitudes, COMMITTED, epoch, motion_of, rows, save, WHEELS, without
import numpy as np
import pytest
from rigid_body_ros import messages, read, recording, scene, State
from rigid_body_ros.commands import main
from rigid_body_ros.common.errors import LONGEST
from rigid_body_ros.identification.recorded import read_experiments
from rigid_body_ros.recording import Reading, torques, writer
from rigid_body_ros.recording.account import Account
from rigid_body_ros.replay import replay
from rigid_body_ros.replay.many import replay_many
from rigid_body_ros.replay.verify import verify
from rigid_body_ros.scene import InputError

ACCEPTED, ACCEPTED_1 = '/node/accepted_torque', '/node/accepted_torque_1'
#: Commands that read a recording, and those that need one motion.
COMMANDS = {
    'replay': ['attitude_replay', '{log}', '-o', '{out}.mcap'],
    'verify': ['attitude_replay', '{log}', '--verify', '{log}'],
    'compare': ['attitude_compare', '{log}', '--measured', COMMITTED, '--json', '{out}.json'],
    'identify': ['attitude_identify', '{log}', '--measured', COMMITTED, '--json', '{out}.json'],
    'tradeoff': ['attitude_tradeoff', '--recording', '{log}', '--json', '{out}.json'],
    'ensemble': ['attitude_ensemble', '--recording', '{log}', '--runs', '4', '-o', '{out}',
                 '--vary', '{vary}']}
ONE_MOTION = [name for name in COMMANDS if name not in ('replay', 'verify')]
#: The starts of two epochs, and their torques. In the first, a torque acts from the start on.
FIRST = State(5 * SECOND, (0.1, 0.2, 0.3, 0.9), (0.15, 0.6, -0.1))
SECOND_START = State(20 * SECOND, (0.5, -0.5, 0.5, 0.5), (-0.2, 0.1, 0.3))
TORQUES = {ACCEPTED: rows(5.0 + 0.1 * np.arange(40), 0.01 * np.random.default_rng(1).normal(
    size=(40, 3)))}
MORE = {ACCEPTED: rows(20.0 + 0.05 * np.arange(1, 31), 0.01 * np.random.default_rng(2).normal(
    size=(30, 3)))}


REST, STILL = State(5 * SECOND), {ACCEPTED: rows([6.0, 7.0, 8.0], (0.0, 0.0, 0.0))}
#: An epoch that begins in a state of the epoch with this start.
AGAIN = State(7 * SECOND), {ACCEPTED: rows([7.5, 9.0], (0.0, 0.0, 0.1))}
BEFORE, AFTER = (4 * SECOND, (0.01, 0.0, 0.0)), (6 * SECOND, (0.0, 0.02, 0.0))


def moved(begin):
    """Return an epoch that begins at another time, s."""
    return replace(SECOND_START, time_ns=begin * SECOND), {
        ACCEPTED: rows(begin + 0.05 * np.arange(1, 31), (0.0, 0.01, 0.0))}


#: The starts and the torques of the epochs in each log.
LOGS = {
    'two': [(FIRST, TORQUES), (SECOND_START, MORE)],
    'no torques': [(FIRST, {ACCEPTED: []}), (SECOND_START, {ACCEPTED: []})],
    'a torque from before the start': [(FIRST, {ACCEPTED: [BEFORE]})],
    'torques from before the start on': [(FIRST, {ACCEPTED: [BEFORE, AFTER]})],
    'epochs that overlap': [(FIRST, TORQUES), moved(7), (FIRST, TORQUES)],
    'epochs that go back': [(FIRST, TORQUES), moved(3), (FIRST, TORQUES)],
    'equal starts': [(FIRST, TORQUES), (FIRST, TORQUES)],
    'a start in a state of the epoch before': [(REST, STILL), AGAIN],
    'more of them': [(REST, STILL), AGAIN, AGAIN, AGAIN]}


def two_epochs(run):
    """Return the messages that a node publishes in two epochs."""
    return [*epoch(run, FIRST, TORQUES), *epoch(run, SECOND_START, MORE)]


@pytest.fixture
def run():
    return scene.load(CONFIG / 'tumbler.yaml')


@pytest.fixture
def two(run, tmp_path):
    """Return a recording of two epochs."""
    return save(tmp_path / 'two.mcap', two_epochs(run))


@pytest.fixture
def words_of(tmp_path, scene_with):
    """Return a function of a command, a recording and lines of a scene: the words to call it."""
    def words(name, log, *lines):
        vary = tmp_path / 'vary.yaml'
        vary.write_text('initial_angular_velocity.z: {normal: 0.01}\n')
        return [*(word.format(log=log, out=tmp_path / 'out', vary=vary)
                  for word in COMMANDS[name]), '--scene', scene_with(*lines)]
    return words


@pytest.fixture
def called(words_of):
    """Return a function that calls a command with a recording, and returns its status."""
    def call(*given):
        command, *arguments = words_of(*given)
        return getattr(main, command)(arguments)
    return call


@pytest.mark.parametrize(('name', 'options'), [
    *((name, {}) for name in LOGS), ('no torques', {'interpolation': 'cubic'}),
    *((name, {'until': 3.0}) for name in LOGS if 'torque' in name)], ids=str)
def test_each_epoch_has_the_motion_from_its_own_start(run, tmp_path, name, options):
    # The start of the scene is not that of any epoch.
    epochs, until = LOGS[name], options.get('until')
    log = save(tmp_path / 'log.mcap', [one for each in epochs for one in epoch(run, *each)])
    result = replay(log, run, tmp_path / 'out.mcap', **options)
    motions = [motion_of(
        run, start, torques, until and [start.time_ns + round(until * SECOND)])
        for start, torques in epochs]
    for found, motion in zip((*result.earlier, result), motions, strict=True):
        np.testing.assert_array_equal(found.last.attitude, motion.attitude[-1])
        assert found.last.time_ns == motion.times_ns[-1]
    if name == 'no torques':
        assert 'torques       0 on /node/accepted_torque, over 0 s\n' in result.text()
    written = attitudes(tmp_path / 'out.mcap')
    logged = recording.read(tmp_path / 'out.mcap', '/attitude', messages.QUATERNION,
                            time_source='log').stamps_ns
    assert np.all(np.diff(logged) >= 0)
    if not until:
        first, stamps = len(motions[0].times_ns), [one.times_ns for one in motions]
        np.testing.assert_array_equal(written.stamps_ns, np.hstack(stamps))
        np.testing.assert_array_equal(written.values, np.vstack([one.attitude for one in motions]))
        np.testing.assert_array_equal(logged[:first], written.stamps_ns[:first])
    for motion in (log, tmp_path / 'out.mcap'):
        compared = verify(log, run, motion, until=until)
        assert (compared.same.all(), compared.pending) == (True, 0)
        assert compared.epochs == compared.compared_epochs == len(epochs)
        assert until or len(compared.same) == len(written)


@pytest.mark.parametrize(('keep', 'block'), [(False, 2 ** 20), (True, 2 ** 12)])
def test_epochs_are_described_and_written_as_text(run, tmp_path, monkeypatch, keep, block):
    monkeypatch.setattr(writer, '_CHUNK', block)  # what is read at a time
    log = save(tmp_path / 'two.mcap', two_epochs(run))
    result = replay(log, run, tmp_path / 'out.csv', keep=keep)
    first, = result.earlier
    motions = [motion_of(run, *one) for one in LOGS['two']]
    table = np.loadtxt(tmp_path / 'out.csv', delimiter=',', skiprows=1, usecols=range(1, 5))
    np.testing.assert_array_equal(table, np.vstack([one.attitude for one in motions]))
    if keep:
        for found, motion in zip((first, result), motions):
            np.testing.assert_array_equal(found.trajectory.attitude, motion.attitude)
    assert (first.account.samples, result.account.samples) == (40, 30)
    words = result.text()
    assert 'epochs        2, each from its own start state' in words
    assert f'  epoch 1     from {FIRST.time_ns} ns on, over 3.9 s, to attitude ' in words


def test_until_and_rate_are_those_of_each_epoch(run, two, tmp_path):
    result = replay(two, run, tmp_path / 'out.mcap', until=2.0, rate=8.0)
    assert attitudes(tmp_path / 'out.mcap').stamps_ns.tolist() == [
        start.time_ns + k * SECOND // 8 for start in (FIRST, SECOND_START) for k in range(17)]
    # The second epoch lasts 1.5 s; like a single recording, it is continued.
    assert result.last.time_ns == SECOND_START.time_ns + 2 * SECOND
    result = verify(two, run, tmp_path / 'out.mcap')
    assert (len(result.same), result.same.all()) == (34, True)
    assert (result.epochs, result.compared_epochs, result.pending) == (2, 2, 0)


@pytest.mark.parametrize(('name', 'defect'), [
    *((name, 'middle') for name in COMMANDS), ('replay', 'older')])
def test_a_log_without_its_start_is_refused_by_every_command(run, tmp_path, words_of, refusal,
                                                             name, defect):
    sent = two_epochs(run)
    if defect == 'older':  # a marker without a start state, in later epochs only
        sent = without(sent, ACCEPTED, 0)
        sent[sent.index((ACCEPTED, messages.epoch_marker(SECOND_START)))] = (
            ACCEPTED, messages.wrench(0, '', np.zeros(3)))
        found = 'found no marker'
    else:
        sent = without(sent, ACCEPTED, 0, 1, 2)
        found = 'found the first marker in message 39'
    line = refusal(*words_of(name, save(tmp_path / 'log.mcap', sent)))
    assert (f'log.mcap: {ACCEPTED}: expected the log of a node to begin with the marker and the '
            f'start state of an epoch, {found}: the recording began in the middle') in line
    assert not [*tmp_path.glob('out*')]


@pytest.mark.parametrize(('name', 'is_log'), [
    ('/accepted_torque', True), ('/a/accepted_torque_12', True), ('accepted_wheel_torque', True),
    ('/accepted_torques', False), ('/not_accepted_torque', False),
    ('/accepted_torque/raw', False)])
def test_the_log_of_a_node_is_known_by_its_name(run, tmp_path, name, is_log):
    log = save(tmp_path / 'log.mcap', [(name, messages.wrench(5, '', np.ones(3)))])
    if is_log:
        with pytest.raises(InputError, match=f'{name}: expected the log of a node to begin'):
            replay(log, run, topic=name)
    else:
        assert replay(log, run, topic=name).start.time_ns == 5


@pytest.mark.parametrize('count', [1000, *at_night(20_000)])
def test_one_epoch_is_replayed_in_pieces(run, tmp_path, monkeypatch, count):
    monkeypatch.setattr(torques, '_SAMPLES', 100)
    monkeypatch.setattr(writer, '_CHUNK', 2 ** 12)  # what is read at a time
    begin = FIRST.time_ns / SECOND
    values = 1e-3 * np.random.default_rng(5).normal(size=(count, 3))
    log = save(tmp_path / 'log.mcap', epoch(run, FIRST, {
        ACCEPTED: rows(begin + 1e-3 * np.arange(1, count + 1), values)}))
    with memory_limit(1.5e6):
        result = replay(log, run, tmp_path / 'out.mcap')
    whole = replay(log, run)
    np.testing.assert_array_equal(attitudes(tmp_path / 'out.mcap').values,
                                  whole.trajectory.attitude)
    assert result.account.as_dict() == whole.account.as_dict()
    assert (whole.account.samples, whole.account.counted) == (count, '')


def sources(run, start, count, first=0.1):
    """Return torques on two topics and on the rotors, after the start."""
    begin = start.time_ns / SECOND
    values = 0.01 * np.random.default_rng(count).normal(size=(3, count, 3))
    return {topic: rows(begin + first * (k + 1) + 0.1 * np.arange(count), values[k])
            for k, topic in enumerate((ACCEPTED, ACCEPTED_1, WHEELS))}


TOPICS = {'topic': [ACCEPTED, ACCEPTED_1], 'wheel_torque': WHEELS}


@pytest.fixture
def wheeled(scene_with):
    return scene.load(scene_with('torque_topics: [a, b]', 'wheels: true'))


def four_wheels():
    """Return a scene with wheels and an inertia topic, and the types of a node's logs."""
    run = scene.load(ROOT / 'examples' / 'four_wheels.yaml')
    return scene.Scene.from_values({**run.values, 'inertia_topic': True}), {
        ACCEPTED: messages.WRENCH, '/node/accepted_inertia': messages.INERTIA,
        '/node/accepted_wheel_command': messages.joint_commands(
            [wheel.name for wheel in run.named_wheels])}


@pytest.mark.parametrize(('torque', 'raw'), [(None, False), (ACCEPTED, False), (ACCEPTED, True)])
def test_what_a_node_has_logged_is_found_beside_its_torques(tmp_path, torque, raw):
    # Without the logged inertia and commands, the motion would differ without any message.
    run, kinds = four_wheels()
    bigger = 1.1 * run.body.entries
    path, stamp = tmp_path / 'log.mcap', FIRST.time_ns + SECOND
    with recording.Writer(path) as writer:
        for (topic, kind), data in zip(kinds.items(), (
                messages.wrench(stamp, '', (0.0, 1e-3, 0.0)), messages.inertia(stamp, '', bigger),
                [*kinds.values()][2].encode(stamp, '', [0.003] * 4))):
            writer.add_topic(topic, kind)
            writer.write(topic, FIRST.time_ns, messages.epoch_marker(FIRST, kind))
            writer.write(topic, stamp, data)
            if raw:
                other = topic.replace('/node/accepted_', '/')
                writer.add_topic(other, kind)
                writer.write(other, stamp, data)
    problem = read(path, run, topic=torque)
    assert problem.efforts.efforts.tolist() == [[0.003] * 4]
    assert [body.entries.tolist() for body in problem.changes.bodies] == [bigger.tolist()]
    assert len(problem.logs) == 1


@pytest.mark.parametrize('torques', [(), ('/a/accepted_torque', '/b/accepted_torque')])
def test_of_two_nodes_that_logged_an_inertia_neither_is_taken_in_silence(tmp_path, torques):
    run, path = scene.load(CONFIG / 'tumbler.yaml'), tmp_path / 'log.mcap'
    run = scene.Scene.from_values({**run.values, 'inertia_topic': True})
    with recording.Writer(path) as writer:
        for node in 'ab':
            for name, kind in (('torque', messages.WRENCH), ('inertia', messages.INERTIA)):
                writer.add_topic(f'/{node}/accepted_{name}', kind)
                writer.write(f'/{node}/accepted_{name}', FIRST.time_ns,
                             messages.epoch_marker(FIRST, kind))
    with pytest.raises(InputError, match='^expected the inertia of one node, found '
                       '/a/accepted_inertia, /b/accepted_inertia; choose one with --inertia$'):
        read(path, run, topic=torques)
    assert read(path, run, topic='/b/accepted_torque').start.time_ns == FIRST.time_ns


@pytest.mark.parametrize('killed', [1, 2])
def test_a_process_may_be_killed_before_it_marks_inertia_and_wheels(tmp_path, killed):
    run, kinds = four_wheels()
    with recording.Writer(tmp_path / 'log.mcap') as writer:
        for number, (topic, kind) in enumerate(kinds.items()):
            writer.add_topic(topic, kind)
            for start in (FIRST, SECOND_START)[:1 + (number < killed)]:
                writer.write(topic, SECOND, messages.epoch_marker(start, kind))
    result = replay(tmp_path / 'log.mcap', run)
    assert [one.last.time_ns for one in (*result.earlier, result)] \
        == [FIRST.time_ns, SECOND_START.time_ns]


def with_rotors(start):
    return State(start.time_ns, start.attitude, start.angular_velocity, (0.01, -0.02, 0.03))


def test_several_topics_have_the_same_epochs(wheeled, tmp_path, monkeypatch):
    monkeypatch.setattr(writer, '_CHUNK', 2 ** 12)  # what is read at a time
    starts = with_rotors(FIRST), SECOND_START
    given = [sources(wheeled, start, 20 + k) for k, start in enumerate(starts)]
    log = save(tmp_path / 'log.mcap', [one for each in zip(starts, given)
                                       for one in epoch(wheeled, *each)])
    result = replay(log, wheeled, tmp_path / 'out.mcap', **TOPICS)
    for found, start, one in zip((*result.earlier, result), starts, given):
        motion = motion_of(wheeled, start, one)
        np.testing.assert_array_equal(found.last.attitude, motion.attitude[-1])
        np.testing.assert_array_equal(found.last.rotor_momentum, motion.rotor_momentum[-1])
    for motion in (log, tmp_path / 'out.mcap'):
        compared = verify(log, wheeled, motion, recording.Topics.given(**TOPICS))
        assert (compared.same.all(), compared.compared_epochs, compared.pending) == (True, 2, 0)


def test_a_process_may_be_killed_between_the_markers_of_two_topics(wheeled, tmp_path):
    given = sources(wheeled, FIRST, 20)
    log = save(tmp_path / 'log.mcap', [
        *epoch(wheeled, FIRST, given), (ACCEPTED, messages.epoch_marker(SECOND_START)),
        (ACCEPTED, messages.wrench(21 * SECOND, '', (0.01, 0.0, 0.0)))])
    result = replay(log, wheeled, **TOPICS)
    motion = motion_of(wheeled, SECOND_START, {ACCEPTED: rows([21.0], (0.01, 0, 0))})
    np.testing.assert_array_equal(result.last.attitude, motion.attitude[-1])
    compared = verify(log, wheeled, log, recording.Topics.given(**TOPICS))
    assert (compared.same.all(), compared.compared_epochs, compared.pending) == (True, 1, 1)


def marked(frame_id, values=(0.0,) * 6):
    """Return messages whose last is to be the marker of an epoch."""
    return lambda run: [*epoch(run, FIRST, TORQUES), (
        ACCEPTED, messages.WRENCH.encode(5 * SECOND, frame_id, values))]


def started(topic, start, found):
    """Return messages on several topics, of which one has another start of an epoch."""
    def sent(run):
        both = [one for begin, count in ((FIRST, 20), (SECOND_START, 10))
                for one in epoch(run, begin, sources(run, begin, count))]
        place = both.index((topic, messages.epoch_marker(start)))
        return [*both[:place], (topic, messages.epoch_marker(found)), *both[place + 1:]]
    return sent


ZEROS = 'attitude 0 0 0 1 rates 0 0 0 rotors 0 0 0'
INVALID = f'log.mcap: {ACCEPTED}: message 42: marker of an epoch: .*'
OTHER = f'expected the epoch that begins at .* ns, with the same start state as on {ACCEPTED}, '


@pytest.mark.parametrize(('sent', 'options', 'message'), [
    (lambda run: [(topic.replace(ACCEPTED, '/torque'), data)
                  for topic, data in without(two_epochs(run), ACCEPTED, 0)], {},
     '/torque: expected the log of a node to begin .* marker in message 41: '),
    (marked('/epoch attitude 0 0 0 1'), {}, INVALID + 'frame_id: expected the start state of an'),
    (marked('/epoch ' + ZEROS.replace('1', 'x')), {}, INVALID + 'could not convert'),
    (marked('/epoch ' + ZEROS.replace('rates 0', 'rates nan')), {}, INVALID + 'expected 3 finite'),
    (marked('/epoch ' + ZEROS, (1.0,) * 6), {}, INVALID + 'expected zeros'),
    (marked('/epoch ' + 9999 * 'x'), {}, INVALID + 'frame_id: expected the start state of an'),
    (lambda run: [*marked('/epoch ' + ZEROS)(run), (
        ACCEPTED, messages.wrench(21 * SECOND, 'map', np.ones(3)))], {},
     "message 43: frame_id: expected .* found 'map'"),
    (lambda run: [*epoch(run, FIRST, TORQUES), (
        '/torque', messages.wrench(6 * SECOND, '', np.ones(3)))], {'topic': [ACCEPTED, '/torque']},
     f'/torque: expected the epoch that begins at {FIRST.time_ns} ns, .* found torques without'),
    (lambda run: [*two_epochs(run), ('/h', messages.VECTOR3.encode(SECOND, '', (0.0, 0.0, 0.1)))],
     {'topic': ACCEPTED, 'wheel_momentum': '/h'}, '--wheel-momentum: expected one epoch, found 2'),
    (started(ACCEPTED_1, FIRST, replace(FIRST, angular_velocity=(1.0, 0.0, 0.0))), TOPICS,
     f'log.mcap: {ACCEPTED_1}: {OTHER}'),
    (started(WHEELS, SECOND_START, replace(SECOND_START, time_ns=SECOND)), TOPICS,
     f'log.mcap: {WHEELS}: {OTHER}'),
    (started(ACCEPTED, FIRST, with_rotors(FIRST)), TOPICS, f'log.mcap: {ACCEPTED_1}: {OTHER}')],
    ids=['late marker', 'short marker', 'text', 'nan', 'marker with a torque', 'long marker',
         'frame', 'no epochs', 'momentum', 'rates', 'stamp', 'rotors'])
def test_what_is_no_log_of_epochs_is_refused(run, wheeled, tmp_path, sent, options, message):
    run = wheeled if options else run
    log = save(tmp_path / 'log.mcap', sent(run))
    with pytest.raises(InputError, match=message) as error:
        replay(log, run, tmp_path / 'out.mcap', **options)
    assert len(str(error.value)) <= LONGEST


def test_a_topic_without_messages_has_no_torques_in_any_epoch(run, tmp_path):
    log = save(tmp_path / 'log.mcap', two_epochs(run), ACCEPTED_1)
    result = replay(log, run, topic=[ACCEPTED, ACCEPTED_1])
    motion = motion_of(run, SECOND_START, MORE)
    np.testing.assert_array_equal(result.last.attitude, motion.attitude[-1])


def test_of_equal_starts_the_last_epoch_is_meant():
    run = scene.load(CONFIG / 'tumbler.yaml')
    same = [recording.Logged(run.problem(start=State(begin_ns)), Account(), True, '', ())
            for begin_ns in (5, 7, 5, 9)]
    assert recording.chosen('', replace(run, start=State(5)), same) is same[2]
    assert recording.chosen('', replace(run, start=State(1)), same[:1]) is same[0]


@pytest.mark.slow
@pytest.mark.parametrize('name', [*at_night('tradeoff'), *(
    name for name in ONE_MOTION if name != 'tradeoff')])
def test_commands_that_need_one_motion_ask_for_its_start(two, words_of, refusal, called, name):
    line = refusal(*words_of(name, two))
    assert (f'two.mcap: expected one epoch, or the start_time of one, found 2 epochs, which begin '
            f'at {FIRST.time_ns}, {SECOND_START.time_ns} ns, and start_time 0; set start_time in '
            'the scene') in line
    assert called(name, two, f'start_time: {SECOND_START.time_ns}') in (0, 3)


@pytest.mark.parametrize(('start', 'count'), [(FIRST, 40), (SECOND_START, 31)])
def test_measurements_of_other_epochs_are_left_out(two, tmp_path, called, start, count):
    assert called('compare', two, f'start_time: {start.time_ns}') == 0
    found = json.loads((tmp_path / 'out.json').read_text())
    assert (found['samples'], found['left_out']) == (count, 71 - count)
    assert found['attitude_error_rad']['max'] < 1e-15
    (_, observed), = read_experiments([two], scene.load(tmp_path / 'scene.yaml'),
                                      Reading((COMMITTED,)))
    sensor, = observed.sensors
    assert np.sum(sensor.stamps_ns >= start.time_ns) == count


def test_the_part_of_an_epoch_ends_after_its_start_and_begins_with_it(two, called, tmp_path):
    assert called('compare', two, f'start_time: {SECOND_START.time_ns}') == 0
    run = scene.load(tmp_path / 'scene.yaml')
    (_, observed), = read_experiments([two], run, Reading((COMMITTED,), until=0.5))
    sensor, = observed.sensors
    assert sensor.stamps_ns[-1] == SECOND_START.time_ns + SECOND // 2
    with pytest.raises(InputError, match='two.mcap: --from: expected no time to skip, because '
                                         'the log of a node begins at its start state'):
        read_experiments([two], run, Reading((COMMITTED,), start=0.5))


@pytest.mark.slow
def test_a_table_of_recordings_says_how_many_epochs_there_are(run, two, tmp_path):
    outcome, = replay_many([two], run, tmp_path / 'out')
    assert outcome.summary.startswith('2 epochs, the last: 30 torques, 1.5 s -> ')
    assert len(attitudes(outcome.output)) == 71


# Every committed state of every epoch in the log of a node

@pytest.mark.parametrize('start_time', [0, SECOND_START.time_ns, 3])
def test_the_start_of_the_scene_does_not_matter(two, called, capsys, start_time):
    assert called('verify', two, f'start_time: {start_time}') == 0
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


def test_a_bit_that_differs_in_the_first_epoch_is_found(run, tmp_path, called, capsys):
    sent = two_epochs(run)
    log = save(tmp_path / 'log.mcap', committed(sent, 17, nudged))
    assert called('verify', log) == 1
    words = capsys.readouterr().out
    assert 'same bits     70 of 71\n' in words
    stamp = motion_of(run, FIRST, TORQUES).times_ns[17]
    assert f'first in state 18, at {stamp} ns: 0 rad' in words


def test_states_after_until_are_not_compared(run, tmp_path, capsys):
    sent = two_epochs(run)
    log = save(tmp_path / 'log.mcap', committed(committed(sent, 17, nudged), 70, nudged))
    arguments = [log, '--scene', str(CONFIG / 'tumbler.yaml'), '--verify', log, '--until']
    assert main.attitude_replay([*arguments, '1']) == 0
    # 11 states of the first epoch, every 0.1 s, and 21 of the second, every 0.05 s.
    assert 'compared      32 states of /node/committed in 2 epochs\n' in capsys.readouterr().out
    assert main.attitude_replay([*arguments, '1.8']) == 1


def test_torques_without_a_committed_state_are_counted(run, tmp_path, called, capsys):
    sent = two_epochs(run)
    killed = without(sent, COMMITTED, *range(32, 40), *range(69, 71))
    assert called('verify', save(tmp_path / 'log.mcap', killed)) == 0
    assert ('compared      61 states of /node/committed in 2 epochs; 10 torques have no committed '
            'state\n') in capsys.readouterr().out
    killed = without(sent, COMMITTED, *range(40, 71))
    assert called('verify', save(tmp_path / 'log.mcap', killed)) == 0
    assert ('compared      40 states of /node/committed in 1 of 2 epochs; 30 torques have no '
            'committed state\n') in capsys.readouterr().out


@pytest.mark.parametrize(('change', 'message'), [
    # A state has no torque at its stamp, and is not the start of an epoch.
    (lambda sent: without(sent, ACCEPTED, 20), 'expected a torque at the stamp of each state, '
     f'found none for 1 of 40 states, the first at {69 * SECOND // 10} ns'),
    (lambda sent: committed(sent, 30, lambda stamp, values: (stamp + 1, values)), 'found none'),
    # The recording of the states began late.
    (lambda sent: without(sent, COMMITTED, 0), 'expected the start state of an epoch of the '
     f'torque log in message 1, found another state, at {51 * SECOND // 10} ns: the recording '
     'began in the middle of an epoch, or is not that of this log'),
    # The start of the second epoch is missing.
    (lambda sent: without(sent, COMMITTED, 40), 'found none for 30 of 70 states'),
    (lambda sent: committed(sent, 40, nudged), 'found none for 31 of 71 states'),
    (lambda sent: without(sent, COMMITTED, *range(71)), 'expected states, found no messages'),
    # The first epoch twice.
    (lambda sent: without(2 * sent[:81], COMMITTED, 40), 'in message 41, because its stamp, '
     '5100000000 ns, is not later than the one before, 8900000000 ns')], ids=range(7))
def test_states_without_a_counterpart_are_refused(run, tmp_path, words_of, refusal, change,
                                                  message):
    log = save(tmp_path / 'log.mcap', change(two_epochs(run)))
    line = refusal(*words_of('verify', log))
    assert f'log.mcap: {COMMITTED}: ' in line
    assert message in line
