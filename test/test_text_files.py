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

"""Text files: torques and measurements whose first line names columns and units, and TUM files."""

from conftest import EPOCH_NS, SECOND
from hostile import outcome
import measurements
from measurements import seconds, table, torque_messages
import numpy as np
import pytest
from rigid_body_ros import messages, recording
from rigid_body_ros.commands import main
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.recording.measurements import read_measured

STAMPS = np.arange(1, 11) * 10_000_000 + 1_700_000_000_123_456_789
RATES = np.arange(30.0).reshape(10, 3) / 10.0
TURNS = np.stack([np.zeros(10), np.sin(np.arange(10) / 20), np.zeros(10),
                  np.cos(np.arange(10) / 20)], axis=1)


def read(folder, text):
    path = folder / 'torque.csv'
    path.write_text(text, encoding='utf-8')
    found = recording.read(path)
    return found.stamps_ns.tolist(), found.values[:, 3:].tolist()


@pytest.mark.parametrize(('heading', 'order'), [
    ('time,tx,ty,tz', '0123'), ('tx,ty,tz,time', '1230'), ('tz,t,ty,tx', '3021'),
    ('timestamp,torque.x,torque.y,torque.z', '0123'),
    ('Time,Torque X,Torque Y,Torque Z', '0123'), ('# time, tx, ty, tz', '0123'),
    ('\\ufefftime,tx,ty,tz', '0123'), ('"time","tx","ty","tz"', '0123'),
    ('__time,/t/wrench/torque/z,/t/wrench/torque/y,/t/wrench/torque/x', '0321'),
    ('wrench.torque.x,wrench.torque.y,wrench.torque.z,header.stamp', '1230'),
    ('time,wrench_torque_x,wrench_torque_y,wrench_torque_z', '0123'),
    ('\\n\\ntime (s),tx (N m),ty [Nm],tz_Nm', '0123')])
def test_the_names_give_the_order(tmp_path, heading, order):
    numbers = '1.5', '0.25', '-3', '4e-3'
    line = ','.join(numbers[int(place)] for place in order)
    heading = heading.encode().decode('unicode_escape') if '\\' in heading else heading
    assert read(tmp_path, f'{heading}\n{line}\n') == ([1_500_000_000], [[0.25, -3.0, 0.004]])


@pytest.mark.parametrize(('name', 'digits'), [
    ('time_s', 9), ('time (sec)', 9), ('t[seconds]', 9), ('time (ms)', 6), ('t_us', 3),
    ('stamp [µs]', 3), ('time ns', 0), ('timestamp_ns', 0), ('/torque/header/stamp (ns)', 0)])
def test_times_have_the_unit_that_is_named_and_every_nanosecond(tmp_path, name, digits):
    stamps = EPOCH_NS + np.cumsum(np.random.default_rng(5).integers(1, SECOND, 100))
    lines = [f'{stamp // 10 ** digits}.{stamp % 10 ** digits:0{digits}},0,0,0' if digits else
             f'{stamp},0,0,0' for stamp in stamps.tolist()]
    found, _ = read(tmp_path, '\n'.join([f'{name},tx,ty,tz', *lines]))
    assert found == stamps.tolist()


@pytest.mark.parametrize(('unit', 'exponent'), [
    ('N m', 0), ('Nm', 0), ('N*m', 0), ('N·m', 0), ('N.m', 0), ('N-m', 0), ('mN m', -3),
    ('mNm', -3), ('mN*m', -3), ('uN m', -6), ('µNm', -6), ('nNm', -9), ('kN m', 3), ('MNm', 6)])
def test_torques_have_the_unit_that_is_named(tmp_path, unit, exponent):
    heading = f'time,tx ({unit}),ty_{unit},torque_z [{unit}]'
    numbers = '20.1', '-0.3', '0.07'
    _, torques = read(tmp_path, f'{heading}\n1,{",".join(numbers)}\n')
    # The double nearest to the decimal number, as if this were written in N m.
    assert torques == [[float(f'{text}e{exponent}') for text in numbers]]


def test_each_column_has_its_own_unit_and_columns_of_something_else_are_ignored(tmp_path):
    others = 'status', '', 'temperature (K)', 'wheel_speed', '/torque/wrench/force/x', 'x', 'dt'
    text = f'tx (mN m),{",".join(others)},ty,tz [kNm],time_us\n1,{7 * "much,"}2,3,4\n'
    assert read(tmp_path, text) == ([4000], [[0.001, 2.0, 3000.0]])


@pytest.mark.parametrize(('heading', 'message'), [
    ('tx,ty,tz', 'no column for time'), ('time,fx,fy,fz', 'no column for tx'),
    ('time,tx,tx,ty,tz', "two columns for tx: 'tx' and 'tx'"),
    ('time,stamp,tx,ty,tz', "two columns for time: 'time' and 'stamp'"),
    ('time_min,tx,ty,tz', "column 'time_min': unknown name or unit"),
    ('%time,tx,ty,tz', "column '%time'"), ('time (h),tx,ty,tz', r"column 'time \(h\)'"),
    ('time (Nm),tx,ty,tz', r"column 'time \(Nm\)'"), ('time,tx (s),ty,tz', r"column 'tx \(s\)'"),
    ('time,tx (nm),ty,tz', r"column 'tx \(nm\)'"), ('time,tx,ty,tz,mx', "column 'mx'"),
    ('time,tx,ty,tz,frame_id', "column 'frame_id'"), ('sec,nanosec,tx,ty,tz', "column 'sec'"),
    ('time,tx,ty,tz,torque_x_filtered', "column 'torque_x_filtered'"),
    ('time tx ty tz', "column 'time tx ty tz'"),
    ('time,tx,ty,tz,' + '_' * 60_000, "column '_+..._+'")])
def test_a_heading_that_is_in_doubt_is_refused_by_column(tmp_path, heading, message):
    with pytest.raises(InputError, match=f'torque.csv: line 1: {message}') as error:
        read(tmp_path, f'{heading}\n1,2,3,4,5\n')
    assert ('expected time, t or stamp (s, ms, us, ns) and tx ty tz or torque_x torque_y torque_z '
            '(N m, mN m, uN m, kN m), with units as in "tx (mN m)" or "time_ms"') in str(
                error.value)


@pytest.mark.parametrize('text', [
    '1e9999999,0,0,0', '-1e99999999999999999999,0,0,0', 'snan,0,0,0',
    'time,tx (mNm),ty,tz\n1,snan,0,0', 'time,tx (kNm),ty,tz\n1,1e9999999,0,0',
    'time,tx,ty,tz\n1,0,0', 'time,tx,ty,tz\n1,0,0,0,0', '1,0,0,0\n1,0,0,0,0', '2147483648,0,0,0',
    '1' * 10 ** 6, '1,' * 10 ** 6, '"1,0,0,0\n' * 10 ** 5, '\0' * 10 ** 6])
def test_a_line_that_is_none_is_refused(tmp_path, text):
    path = tmp_path / 'torque.csv'
    path.write_text(text)
    assert 'torque.csv: ' in outcome(path)


@pytest.mark.slow
@pytest.mark.parametrize('line', ['1e-9999999,0,0,0', '0e9999999,0,0,0'])
def test_an_exponent_costs_nothing(tmp_path, line):
    path = tmp_path / 'torque.csv'
    path.write_text(f'{line}\n' * 10_000 + '1,0,0,0')
    assert outcome(path) == ''


def test_the_last_stamp_is_the_last_of_ros(tmp_path):
    assert read(tmp_path, '2147483647.999999999,0,0,0') == ([messages.LAST_NS], [[0.0, 0.0, 0.0]])


# Measurements

def test_attitudes_and_rates_in_any_order_with_other_columns(tmp_path):
    found = read_measured(table(
        tmp_path / 'log.csv', 'time_ns,q.w,wx,wy,wz,q.x,q.y,q.z,battery', STAMPS[::-1],
        TURNS[::-1, 3], RATES[::-1], TURNS[::-1, :3], np.ones(10)))
    assert found.topic == 'log.csv'
    np.testing.assert_array_equal(found.stamps_ns, STAMPS)
    np.testing.assert_allclose(found.attitude, TURNS, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(found.angular_velocity, RATES)


def test_a_trajectory(tmp_path):
    found = read_measured(table(tmp_path / 'poses.tum', '# timestamp tx ty tz qx qy qz qw',
                                seconds(STAMPS), np.ones((10, 3)), TURNS, separator=' '))
    np.testing.assert_array_equal(found.stamps_ns, STAMPS)
    np.testing.assert_allclose(found.attitude, TURNS, rtol=0, atol=1e-15)
    assert found.angular_velocity is None


@pytest.mark.parametrize(('name', 'text', 'message'), [
    ('a.csv', 'time,wx,wy\n1,2,3', 'line 1: no column for wz; expected time'),
    ('a.csv', 'time,battery\n1,2', 'line 1: no column for qx'),
    ('a.csv', '', 'line 1: no column for time'),
    ('a.csv', 'time,wx (rpm),wy,wz\n', r"column 'wx \(rpm\)': unknown unit"),
    ('a.csv', 'time,wx,wy,wz\n1,2,3,x', 'line 2: expected numbers in the columns of time, wx'),
    ('a.csv', 'time,wx,wy,wz\n-1,2,3,4', 'line 2: expected a time from 0 to 2147483647 s'),
    ('a.csv', 'time,wx,wy,wz\n1,2,3', 'line 2: expected 4 columns as in the first line'),
    ('a.csv', 'time,wx,wy,wz\n1,nan,3,4\n', 'expected at least 4 messages with a finite '
     'attitude or angular velocity, found 0 among 1'),
    ('a.csv', 'time,wx,wy,wz\n', 'found 0 among 0'),
    ('a.tum', '1 2 3\n', 'line 1: expected numbers'),
    ('a.csv', '\xff', 'expected text in UTF-8'),
    ('a.csv', None, 'cannot read the measurements')])
def test_a_bad_file_is_one_line(tmp_path, name, text, message):
    path = tmp_path / name
    if text is not None:
        path.write_bytes(text.encode('latin-1'))
    with pytest.raises(InputError, match=message) as raised:
        read_measured(str(path))
    assert str(raised.value).startswith(str(path))
    assert '\n' not in str(raised.value)


@pytest.mark.slow
def test_an_inertia_from_text_alone(tmp_path, capsys):
    truth = measurements.truth(seconds=5.0)
    sensor = truth.measured(2e-3, 5e-3)
    measurements.write(tmp_path / 'torque.mcap', torque=torque_messages(truth))
    measurements.write_scene(tmp_path / 'scene.yaml', truth)
    gyro = table(tmp_path / 'gyro.csv', 'time_ns,wx,wy,wz', sensor.stamps_ns,
                 sensor.angular_velocity)
    poses = table(tmp_path / 'poses.tum', '#', seconds(sensor.stamps_ns),
                  np.zeros((len(sensor), 3)), sensor.attitude, separator=' ')
    arguments = [str(tmp_path / 'torque.mcap'), '--scene', str(tmp_path / 'scene.yaml'),
                 '--measured', str(gyro), '--measured', str(poses), '--estimate',
                 'inertia,start,gyro_bias@gyro.csv']
    page = tmp_path / 'page.html'
    assert main.attitude_identify([*arguments, '--report', str(page)]) == 0
    assert str(tmp_path) not in page.read_text(encoding='utf-8')
    shown = capsys.readouterr().out
    assert 'poses.tum attitude' in shown
    assert 'gyro_bias.x@gyro.csv' in shown
