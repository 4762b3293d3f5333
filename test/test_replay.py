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

"""attitude_replay: the numbers of the library, a summary, a picture, and one-line errors."""

import os
import signal
import subprocess
import sys

import bags
from conftest import at_night, CONFIG, EPOCH_NS, program, RECORDINGS, SECOND, write_torques
import numpy as np
import pytest
from rigid_body_ros import messages, propagate, recording, scene
from rigid_body_ros.commands import main
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.recording import gaps
from rigid_body_ros.recording.measurements import read_measured
from rigid_body_ros.replay import replay
from rigid_body_ros.replay.check import energy_balance
from rigid_body_ros.scene import InputError
from rosbags.highlevel import AnyReader

ISS = (str(RECORDINGS / 'iss.mcap'), '--scene', str(CONFIG / 'iss.yaml'))
TORQUES, TUMBLER = RECORDINGS / 'tumbler.mcap', scene.load(CONFIG / 'tumbler.yaml')
COMMAND = program('attitude_replay')


@pytest.fixture
def output(tmp_path):
    return tmp_path / 'motion.mcap'


def attitudes(path):
    return recording.read(path, '/attitude', messages.QUATERNION)


@pytest.mark.parametrize(('options', 'seconds'), [
    ((), np.arange(0, 28801, 20)),
    (('--rate', '0.01'), np.arange(0, 28801, 100)),
    (('--rate', '3', '--until', '1'), [0, 1 / 3, 2 / 3, 1]),
    (('--until', '28830.5'), [*range(0, 28801, 20), 28830.5]),
    (('--from', '40'), [*range(40, 28801, 20)]),
    (('--start', '35', '--until', '85'), [40, 60, 80, 85]),
    (('--from', '35', '--duration', '85'), [40, 60, 80, 100, 120])])
def test_output_times(output, options, seconds):
    assert main.attitude_replay([*ISS, '-o', str(output), *options]) == 0
    stamps = attitudes(output).stamps_ns
    np.testing.assert_array_equal(stamps - EPOCH_NS, np.round(np.array(seconds) * 1e9))


#: The columns of every motion, and the scenes with further columns.
PLAIN = ('time_ns,qx,qy,qz,qw,phi (rad),theta (rad),psi (rad),'
         'wx (rad/s),wy (rad/s),wz (rad/s)')
WHEELS = {'wheel_names': ['rw_x', 't'], 'rw_x.axis.x': 1.0, 'rw_x.inertia': 1e-4,
          'rw_x.initial_speed': 30.0, 't.axis.y': 1.0, 't.inertia': 2e-4}


@pytest.mark.parametrize(('values', 'heading'), [
    ({}, PLAIN), ({'euler_sequence': 'zyx'}, PLAIN.replace('phi', 'z1').replace('theta', 'y2')
                  .replace('psi', 'x3')),
    ({'initial_rotor_momentum.z': 0.3, 'wheels': True},
     f'{PLAIN},hx (Nms),hy (Nms),hz (Nms)'),
    (WHEELS, f'{PLAIN},hx (Nms),hy (Nms),hz (Nms),speed_rw_x (rad/s),effort_rw_x (Nm),'
             'speed_t (rad/s),effort_t (Nm)')])
def test_a_motion_in_csv_has_all_bits(tmp_path, monkeypatch, values, heading):
    monkeypatch.setattr('rigid_body_ros.replay.batches._LARGEST', 4)
    tumbler = scene.Scene.from_values({**TUMBLER.values, **values})
    log = write_torques(tmp_path / 'log.mcap', [
        (EPOCH_NS + k * 7_000_001, '', (0.1 * k, 0.0, -0.2)) for k in range(10)])
    path = tmp_path / 'motion.CSV'
    motion = replay(log, tumbler, path, keep=True).trajectory
    expected = [motion.attitude, motion.euler_angles(tumbler.euler_sequence),
                motion.angular_velocity]
    if tumbler.has_rotors:
        expected.append(motion.rotor_momentum)
    for wheel in range(len(tumbler.named_wheels)):
        expected += [motion.wheel_speeds[:, [wheel]], motion.wheel_efforts[:, [wheel]]]
    assert path.read_text().splitlines()[0] == heading
    rows = np.genfromtxt(path, delimiter=',', names=True, dtype=None)
    assert rows['time_ns'].tolist() == motion.times_ns.tolist()
    np.testing.assert_array_equal([[*row][1:] for row in rows.tolist()], np.hstack(expected))
    measured = read_measured(str(path))
    np.testing.assert_array_equal(measured.stamps_ns, motion.times_ns)
    np.testing.assert_array_equal(measured.attitude, so3.normalize(motion.attitude))
    np.testing.assert_array_equal(measured.angular_velocity, motion.angular_velocity)


def test_the_start_time_of_the_scene_counts(output, scene_with, refusal):
    def late(seconds):
        return [ISS[0], '-o', str(output), '--scene', scene_with(
            f'start_time: {EPOCH_NS + seconds * SECOND}', base=CONFIG / 'iss.yaml')]
    assert main.attitude_replay(late(1010)) == 0
    assert attitudes(output).stamps_ns[0] == EPOCH_NS + 1020 * SECOND
    assert 'start_time' in refusal('attitude_replay', *late(30000), '--overwrite')


def test_interpolation_is_that_of_the_option_or_of_the_scene(scene_with):
    cubic = scene.load(scene_with('interpolation: cubic'))
    ends = {name: replay(TORQUES, loaded, interpolation=name, until=0.5).trajectory.attitude[-1]
            for loaded, name in ((TUMBLER, 'cubic'), (cubic, None), (cubic, 'hold'))}
    np.testing.assert_array_equal(ends['cubic'], ends[None])
    assert not np.array_equal(ends['cubic'], ends['hold'])


def test_the_summary_tells_what_happened_also_without_an_output(output, capsys, monkeypatch):
    monkeypatch.chdir(output.parent)
    printed = []
    for arguments in ((), ('-o', str(output))):
        assert main.attitude_replay([*ISS, *arguments]) == 0
        text = capsys.readouterr().out
        printed.append([line for line in text.splitlines() if not line.startswith('speed')])
    assert printed[1] == [*printed[0], f'wrote         {output}']
    assert [*output.parent.iterdir()] == [output]
    for part in ('1441 on /torque, over 28800 s', 'hold (attitude_tradeoff shows',
                 'asymmetric top', 'taylor (auto: ', '28800 s after the start',
                 'work and energy differ by', ', checked over all 28800 s\n', 'times real time'):
        assert part in text
    assert main.attitude_replay([
        str(RECORDINGS / 'torque_free_asymmetric.mcap'), '--scene',
        str(RECORDINGS / 'torque_free_asymmetric.yaml'), '-o', str(output),
        '--overwrite']) == 0
    text = capsys.readouterr().out
    assert 'drift of the space angular momentum' in text
    assert ', checked over all 100 s\n' in text


def replayed(name, output, **options):
    return replay(RECORDINGS / f'{name}.mcap', scene.load(RECORDINGS / f'{name}.yaml'), output,
                  **options)


def test_the_effect_of_the_last_digits_is_reported_where_it_is_large(output):
    # One unit in the last place of a rod's inertia moves this end by 1e-11 to 1e-10 rad.
    result = replayed('rod_full_tensor_body_torque', output)
    assert 1e-11 < result.last_digits.effect < 1e-9
    assert (f'\nlast digits   a change of the last digit of inertia, torque or start moves the '
            f'attitude by {result.last_digits.effect:.1e} rad: no solver guarantees a smaller '
            'error\n') in result.text()
    ordinary = replayed('thruster_pulses_irregular', output)
    assert 0.0 < ordinary.last_digits.effect < 1e-13
    assert 'last digits' not in ordinary.text()
    assert replayed('constant_space_torque', output).last_digits is None  # no length


@pytest.mark.parametrize(('name', 'limit'), [('_SAMPLES', 1), ('_ANGLE', 4.0)])
def test_the_effect_of_the_last_digits_covers_a_beginning(name, limit, output, monkeypatch):
    monkeypatch.setattr(f'rigid_body_ros.replay.check.{name}', limit)
    result = replayed('rod_full_tensor_body_torque', output)
    digits = result.last_digits
    assert 0.1 < digits.covered < 0.9 * digits.total
    assert digits.total == result.check.total
    assert f' rad in the first {digits.covered:.9g} s of {digits.total:.9g} s: ' in result.text()


def test_work_and_energy_agree_under_an_interpolated_torque():
    result = replayed('thruster_pulses_irregular', None, interpolation='cubic')
    imbalance, seconds = energy_balance(result.problem, result.trajectory)
    assert imbalance < 1e-9
    assert seconds == pytest.approx((result.last.time_ns - result.start.time_ns) * 1e-9)


@pytest.mark.slow
def test_work_and_energy_are_compared_over_what_memory_allows(monkeypatch):
    result = replay(RECORDINGS / 'fast_spin.mcap', scene.load(RECORDINGS / 'fast_spin.yaml'))
    motion = result.problem, result.trajectory
    whole, seconds = energy_balance(*motion)
    monkeypatch.setattr('rigid_body_ros.replay.check._MOST_INTERVALS', 1000)
    part, first = energy_balance(*motion)
    assert (seconds, 0.0 < first < 0.02) == (1.0, True)
    assert max(whole, part) < 1e-14


@pytest.mark.parametrize(('rows', 'more', 'message'), [
    (None, '', 'bad.mcap: cannot read the recording: No such file or directory'),
    ([(EPOCH_NS, '', [1e300, 0, 0]), (EPOCH_NS + SECOND, '', [0, 0, 0])], '',
     'bad.mcap: /torque: at '),
    ([(EPOCH_NS, 'map', [1, 0, 0])], '',
     "bad.mcap: /torque: message 1: frame_id: expected 'base_link'"),
    ([(EPOCH_NS, '', [1, 0, 0])], 'inertias: {ixx: 1.0}',
     'scene.yaml: inertias.ixx: unknown key; did you mean inertia.ixx?'),
    ([(EPOCH_NS, '', [1, 0, 0])], None, 'scene.yaml: cannot read the scene: No such file')])
def test_a_mistake_is_answered_by_one_line(rows, more, message, tmp_path, output, scene_with,
                                           refusal):
    path, config = tmp_path / 'bad.mcap', tmp_path / 'scene.yaml'
    if rows is not None:
        write_torques(path, rows)
    if more is not None:
        scene_with(more)
    assert message in refusal('attitude_replay', path, '--scene', config, '-o', output)
    assert not output.exists()


@pytest.mark.parametrize(('arguments', 'message'), [
    (('-o', 'none/motion.mcap'), 'none/motion.mcap: cannot write: No such file or directory'),
    (('-o', '.'), '.: output exists; choose a new folder, or a name ending in .mcap'),
    (('-o', 'motion.json'), 'motion.json: expected a name ending in .mcap, or a folder name'),
    (('-o', 'motion.csv', '--also', 'tf'), '--also: expected an MCAP file or a rosbag2 folder as '
     'output, because a CSV file has no topics, found motion.csv'),
    (('-o', 'motion.mcap', '--plot', 'p.pdf'), 'p.pdf: expected a name ending in .png, found'),
    (('--also', 'imu'), '--also: expected an output file or folder (-o), found none'),
    (('--until', '1e9'), '--until: expected an end at or before the latest'),
    (('--rate', '1e9', '-o', 'motion.mcap'), '--rate: expected at most 100000000 outputs'),
    (('--from', '5', '--until', '5'), '--until: expected more than --from, 5 s, found 5 s'),
    (('--from', '28801'), 'iss.mcap: expected the last torque at or after the start of the motion '
     '(--from or start_time), '),
    (('-o', 'a.mcap', '-o', 'b.mcap'),
     "-o: expected the option at most once, found 'a.mcap' and 'b.mcap'"),
    (('--also', 'imu', '--also', 'tf'), '--also: expected the option at most once, found '),
    ((f'--scene={ISS[2]}',), '--scene: expected the option at most once, found ')])
def test_a_mistake_in_the_options_is_one_line(arguments, message, tmp_path, monkeypatch, refusal):
    monkeypatch.chdir(tmp_path)
    assert message in refusal('attitude_replay', *ISS, *arguments)
    assert not [*tmp_path.iterdir()]


def test_torques_logged_after_the_latest_stamp_are_rejected(tmp_path, output):
    with recording.Writer(tmp_path / 'late.mcap') as writer:
        writer.add_topic('/torque', messages.WRENCH)
        writer.write('/torque', 2 ** 62, messages.wrench(EPOCH_NS, '', (1.0, 0.0, 0.0)))
    with pytest.raises(InputError, match='late.mcap: expected an end at or before the latest ROS '
                       f'stamp, {messages.LAST_NS} ns, found {2 ** 62} ns'):
        replay(tmp_path / 'late.mcap', TUMBLER, output, time_source='log')


@pytest.mark.parametrize('arguments', [('--verify', 'x'), ('--rate', '0'), ('--until', '1e300'),
                                       ('--until', '-1'), ('--interpolation', 'spline')])
def test_wrong_arguments_are_answered_by_the_usage(arguments, output, capsys):
    with pytest.raises(SystemExit) as end:
        main.attitude_replay([*ISS, '-o', str(output), *arguments])
    assert end.value.code == 2
    assert 'usage: attitude_replay' in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(('number', 'more'), [
    (signal.SIGINT, 'solver: taylor'), *at_night(
        (signal.SIGTERM, 'solver: taylor'),
        (signal.SIGTERM, 'initial_rotor_momentum: {z: 0.03}'))])
def test_a_signal_is_heard_while_the_motion_is_worked_out(tmp_path, output, number, more):
    spin = RECORDINGS / 'fast_spin'  # for a day at 6000 rad/s, the series takes an hour
    config = tmp_path / 'spin.yaml'
    config.write_text(f'{spin.with_suffix(".yaml").read_text()}    {more}\n')
    process = subprocess.Popen([*COMMAND, f'{spin}.mcap', '--scene', str(config), '-o',
                                str(output), '--until', '86400'], stderr=subprocess.PIPE,
                               text=True, start_new_session=True)
    warning, announced = process.stderr.readline(), process.stderr.readline()
    with pytest.raises(subprocess.TimeoutExpired):
        process.communicate(timeout=1)
    os.kill(process.pid, number)
    _, last = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert 'fast_spin.mcap: /torque: computing the motion takes about ' in announced
    assert warning.startswith(
        f'attitude_replay: warning: {config}: initial_angular_velocity: 6000 rad/s is 955')
    assert last == 'attitude_replay: interrupted; no partial output was left\n'
    assert not output.exists()


@pytest.mark.slow
@pytest.mark.parametrize('where', ['weakref.finalize(thing, work)',
                                   *at_night('Thing.__del__ = work')])
def test_a_signal_is_heard_where_python_drops_exceptions(where):
    script = f"""
import os, signal, sys, time, weakref
from rigid_body_ros.commands import main
class Thing:
    pass
def work(*_):
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(1.5)  # until what was noted comes as an exception, which is dropped here
def command():
    thing = Thing()
    {where}
    del thing
    time.sleep(60.0)
sys.exit(main._guarded('command', command, None))
"""
    result = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                            timeout=50, check=False)
    assert result.returncode == 128 + signal.SIGTERM
    assert result.stderr == 'command: interrupted; no partial output was left\n'


def test_a_command_that_is_called_leaves_signals_to_its_caller(output):
    def state():
        numbers = signal.SIGINT, signal.SIGTERM, signal.SIGALRM
        return [signal.getsignal(number) for number in numbers], sys.unraisablehook

    before = state()
    signal.setitimer(signal.ITIMER_REAL, 1000.0)
    try:
        assert main.attitude_replay([*ISS, '-o', str(output)]) == 0
        assert signal.getitimer(signal.ITIMER_REAL)[0] > 900.0
        assert state() == before
        status = main._guarded('command', lambda: os.kill(os.getpid(), signal.SIGTERM), [])
        assert status == 128 + signal.SIGTERM
        assert state() == before
        assert main._guarded('command', lambda: 0, []) == 0
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


@pytest.mark.slow
def test_imu_and_tf_are_written_on_request(tmp_path, output):
    replay(TORQUES, TUMBLER, output, also=('imu', 'tf'))
    attitude, imu, transform = (recording.read(output, topic, kind) for topic, kind in (
        ('/attitude', messages.QUATERNION), ('/imu/data', messages.IMU),
        ('/tf', messages.TRANSFORM)))
    rates = recording.read(output, '/angular_velocity', messages.VECTOR3)
    for found in (imu, transform):
        np.testing.assert_array_equal(found.stamps_ns, attitude.stamps_ns)
    np.testing.assert_array_equal(imu.values[:, :4], attitude.values)
    np.testing.assert_array_equal(imu.values[:, 13:16], rates.values)
    np.testing.assert_array_equal(transform.values[:, 3:], attitude.values)


@pytest.mark.parametrize(('options', 'message'), [
    ({'start': -1.0}, 'expected seconds from 0 to 1e'),
    ({'until': -1.0}, 'expected seconds from 0 to 1e'),
    ({'also': ('imu', 'x')}, "also: expected some of imu, tf, .*found 'x'")])
def test_wrong_values_are_rejected(output, options, message):
    with pytest.raises(ValueError, match=message):
        replay(TORQUES, TUMBLER, output, **options)


@pytest.mark.parametrize(('keep', 'interpolation'), [
    (False, 'hold'), (True, 'linear'), (False, 'cubic')])
def test_a_motion_from_a_time_on_is_under_the_torque_of_this_time(output, keep, interpolation):
    source = recording.read(TORQUES)
    result = replay(TORQUES, TUMBLER, output, start=1.2512, until=2.0, keep=keep,
                    interpolation=interpolation)
    assert result.start.time_ns == source.stamps_ns[0] + 1_251_200_000
    assert result.start.time_ns not in source.stamps_ns
    assert result.last.time_ns == result.start.time_ns + 2 * SECOND
    motion = propagate(result.scene.body, result.start, recording.torque_log(
        '', source, 'base_link', 'world', interpolation), at=[result.last.time_ns])
    np.testing.assert_array_equal(motion.attitude[0], result.last.attitude)


@pytest.mark.slow
@pytest.mark.parametrize('name', ['motion.mcap', 'motion'])
def test_the_input_is_copied_byte_for_byte_on_request(tmp_path, name):
    replay(RECORDINGS / 'iss.mcap', scene.load(CONFIG / 'iss.yaml'), tmp_path / name,
           also=('input',))

    def messages_of(path):
        with AnyReader([path]) as reader:
            return [(connection.topic, connection.msgtype, time_ns, bytes(data))
                    for connection, time_ns, data in reader.messages()]
    written, source = messages_of(tmp_path / name), messages_of(RECORDINGS / 'iss.mcap')
    topics = {topic for topic, *_ in source}
    assert sorted(row for row in written if row[0] in topics) == sorted(source)
    assert {topic for topic, *_ in written} - topics == {
        '/attitude', '/euler_angles', '/angular_velocity'}


@pytest.mark.slow
def test_messages_compressed_one_by_one_are_copied_as_they_were(tmp_path):
    sent = bags.torques()
    sent.values[:6] = 0.0  # no motion follows from it
    source = bags.FORMS['rosbag2-mcap-message'](tmp_path, bags.traffic(sent))
    replay(source, TUMBLER, tmp_path / 'motion.mcap', also=('input',))
    read = [recording.read(path) for path in (source, tmp_path / 'motion.mcap')]
    np.testing.assert_array_equal(read[0].values, read[1].values)


def test_what_cannot_be_copied_is_told_before_anything_is_worked_out(tmp_path, output, refusal):
    path, again = tmp_path / 'log.csv', tmp_path / 'again.mcap'
    path.write_text('1,0,0,0\n2,0.1,0,0\n')
    assert 'log.csv: expected an MCAP file, because only its messages' in refusal(
        'attitude_replay', path, *ISS[1:], '-o', output, '--also', 'input')
    assert [*tmp_path.iterdir()] == [path]
    assert main.attitude_replay([*ISS, '-o', str(output), '--also', 'input']) == 0
    assert 'cannot copy topics that are also written: ' in refusal(
        'attitude_replay', output, *ISS[1:], '-o', again, '--also', 'input')
    assert not again.exists()


@pytest.mark.parametrize('name', ['motion.mcap', 'motion.csv'])
def test_a_motion_that_cannot_go_on_leaves_nothing(tmp_path, monkeypatch, refusal, name):
    monkeypatch.setattr('rigid_body_ros.replay.batches._LARGEST', 4)
    monkeypatch.setattr('rigid_body_ros.recording.torques._SAMPLES', 4)
    torques = write_torques(tmp_path / 'wild.mcap', [
        (EPOCH_NS + k * SECOND // 1000, '', [0.0 if k < 90 else 1e30, 0.0, 0.0])
        for k in range(100)])
    assert 'turns faster than' in refusal('attitude_replay', torques, *ISS[1:], '-o',
                                          tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ['wild.mcap']


@pytest.fixture
def stopped(tmp_path, scene_with):
    """Return a function that writes torques every 10 ms with a gap, s, and returns arguments."""
    def write(gap, torque=(0.1, 0.05, 0.02), *lines, name='gap.csv'):
        seconds = 1000.0 + np.arange(100) * 0.01
        seconds[50:] += gap
        (tmp_path / name).write_text(''.join(
            f'{t:.3f},{",".join(map(str, torque))}\n' for t in seconds))
        return [str(tmp_path / name), '--scene', scene_with(*lines)]
    return write


@pytest.mark.slow
def test_a_torque_over_a_long_gap_is_warned_of(tmp_path, capsys, stopped):
    arguments = stopped(20.0)
    assert main.attitude_replay(arguments) == 0
    shown = capsys.readouterr().out
    assert 'longest gap   20.01 s between torques, from 0.49 s after the start\n' in shown
    assert ('warning       a torque acts for 20.01 s until the next one, from 0.49 s after the '
            'start, although torques are usually 0.01 s apart: ') in shown
    second, *_ = stopped(20.0, name='second.csv')
    assert main.attitude_replay([second, *arguments, '-o', str(tmp_path / 'out')]) == 0
    assert capsys.readouterr().out.count('; warning: a torque acts for 20.01 s') == 2


@pytest.mark.parametrize(('gap', 'options', 'longest'), [
    ((0.9,), [], '0.91 s between torques, from 0.49 s'),
    ((20.0, (0.0, 0.0, 0.0)), [], '20.01 s'),
    ((20.0, (0.1, 0.0, 0.0), 'torque_timeout: 0.5'), [], '20.01 s'),
    ((20.0,), ['--until', '0.9'], '0.41 s'), ((20.0,), ['--from', '20.6'], '0.01 s')])
def test_a_gap_without_consequence_is_only_named(capsys, stopped, gap, options, longest):
    assert main.attitude_replay([*stopped(*gap), *options]) == 0
    shown = capsys.readouterr().out
    assert f'longest gap   {longest}' in shown
    assert 'warning' not in shown


@pytest.mark.parametrize('lines', [(), ('damping: {dxx: 1e-9, dyy: 1e-9, dzz: 1e-9}',)])
def test_a_torque_that_acts_for_ten_years_is_refused(stopped, refusal, lines):
    line = refusal('attitude_replay', *stopped(3.2e8, (0.1, 0.05, 0.02), *lines))
    assert 'at 1000490000000 ns acts until 320001000500000000 ns, for 320000000 s: ' in line
    assert 'check the clock that set the stamps, or set torque_timeout' in line


@pytest.mark.slow
def test_a_body_without_torque_may_turn_for_ten_years(tmp_path, stopped):
    arguments, path = stopped(3.2e8, (0.0, 0.0, 0.0)), tmp_path / 'gap.csv'
    path.write_text(path.read_text().replace('320001000.500,0.0,', '320001000.500,0.1,'))
    assert main.attitude_replay(arguments) == 0


@pytest.mark.parametrize('seed', range(2))
def test_gaps_do_not_depend_on_the_pieces(seed):
    random = np.random.default_rng(seed)
    stamps = np.cumsum(random.integers(1, 10 ** 9, 300))
    stamps[200:] += 10 ** 12
    torques = random.normal(size=(300, 3))
    whole, pieces = (gaps.Gaps(int(stamps[3]), int(stamps[-4]), 0) for _ in range(2))
    whole.add(TorqueLog(stamps, torques))
    for first in range(0, 300, 10):
        log = TorqueLog(stamps[first:first + 15], torques[first:first + 15])
        pieces.add(log)
        pieces.add(log)
    assert (str(pieces), pieces.warning, pieces.usual) == (str(whole), whole.warning, whole.usual)
    assert whole.warning
    assert whole.usual == pytest.approx(np.median(np.diff(stamps[3:-3])) * 1e-9, rel=0.05)


@pytest.mark.nightly
def test_home_time_zone_and_assertions_have_no_effect(tmp_path):
    def run(folder, *options, **environment):
        (tmp_path / folder).mkdir()
        result = subprocess.run(
            [sys.executable, *options, *COMMAND[1:], str(TORQUES), '--scene',
             str(CONFIG / 'tumbler.yaml'), '-o', 'm.mcap', '--plot', 'm.png'],
            cwd=tmp_path / folder, env={**os.environ, **environment}, capture_output=True,
            text=True, check=False)
        assert (result.returncode, result.stderr) == (0, '')
        facts = [line for line in result.stdout.splitlines() if not line.startswith('speed')]
        return facts, *((tmp_path / folder / name).read_bytes() for name in ('m.mcap', 'm.png'))
    assert run('there', '-O', HOME='/proc/none', TZ='Asia/Kathmandu', LC_ALL='tr_TR.UTF-8') \
        == run('here', TZ='UTC')
