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

"""Measurements from text files: CSV files and TUM trajectories."""

import measurements
from measurements import torque_messages
import numpy as np
import pytest
from rigid_body_ros.commands import main
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.recording.measurements import read_measured

STAMPS = np.arange(1, 11) * 10_000_000 + 1_700_000_000_123_456_789
RATES = np.arange(30.0).reshape(10, 3) / 10.0
TURNS = np.stack([np.zeros(10), np.sin(np.arange(10) / 20), np.zeros(10),
                  np.cos(np.arange(10) / 20)], axis=1)


def seconds(stamp_ns):
    return f'{stamp_ns // 10 ** 9}.{stamp_ns % 10 ** 9:09}'


def lines(heading, *columns):
    return '\n'.join([heading, *(','.join(map(str, row)) for row in zip(*columns))])


def numbers(values):
    return [','.join(map(repr, row)) for row in values.tolist()]


@pytest.mark.parametrize(('heading', 'factor'), [
    ('time,wx,wy,wz', 1.0), ('stamp (s),angular_velocity.x,angular_velocity.y,angular_velocity.z',
                             1.0),
    ('t [s],gyro_x (deg/s),gyro_y (deg/s),gyro_z (deg/s)', np.radians(1.0)),
    ('#timestamp [s],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]', 1.0)])
def test_angular_velocities_of_a_csv_file(tmp_path, heading, factor):
    path = tmp_path / 'gyro.csv'
    path.write_text(lines(heading, map(seconds, STAMPS.tolist()), numbers(RATES)))
    found = read_measured(str(path))
    assert found.topic == 'gyro.csv'
    assert found.attitude is None
    np.testing.assert_array_equal(found.stamps_ns, STAMPS)
    np.testing.assert_allclose(found.angular_velocity, factor * RATES, rtol=1e-15)


def test_attitudes_and_rates_in_any_order_with_other_columns(tmp_path):
    path = tmp_path / 'log.csv'
    rows = np.column_stack([TURNS[:, 3], RATES, TURNS[:, :3], np.ones(10)])
    path.write_text(lines('time_ns,q.w,wx,wy,wz,q.x,q.y,q.z,battery', STAMPS.tolist()[::-1],
                          numbers(rows[::-1])))
    found = read_measured(str(path))
    np.testing.assert_array_equal(found.stamps_ns, STAMPS)
    np.testing.assert_allclose(found.attitude, TURNS, atol=1e-15)
    np.testing.assert_array_equal(found.angular_velocity, RATES)


def test_a_trajectory(tmp_path):
    path = tmp_path / 'poses.tum'
    path.write_text('# timestamp tx ty tz qx qy qz qw\n' + '\n'.join(
        f'{seconds(stamp)} 1 2 3 {" ".join(map(repr, q))}'
        for stamp, q in zip(STAMPS.tolist(), TURNS.tolist())))
    found = read_measured(str(path))
    np.testing.assert_array_equal(found.stamps_ns, STAMPS)
    np.testing.assert_allclose(found.attitude, TURNS, atol=1e-15)
    assert found.angular_velocity is None


@pytest.mark.parametrize(('name', 'text', 'message'), [
    ('a.csv', 'time,wx,wy\n1,2,3', 'line 1: no column for wz; expected time'),
    ('a.csv', 'wx,wy,wz\n1,2,3', 'line 1: no column for time'),
    ('a.csv', 'time,battery\n1,2', 'line 1: no column for qx'),
    ('a.csv', '', 'line 1: no column for time'),
    ('a.csv', 'time,wx,wx,wy,wz\n', "two columns for wx: 'wx' and 'wx'"),
    ('a.csv', 'time,wx (rpm),wy,wz\n', r"column 'wx \(rpm\)': unknown unit"),
    ('a.csv', 'time,wx,wy,wz\n1,2,3,x', 'line 2: expected numbers in the columns of time, wx'),
    ('a.csv', 'time,wx,wy,wz\n-1,2,3,4', 'line 2: expected a time from 0 to 2147483647 s'),
    ('a.csv', 'time,wx,wy,wz\n1,2,3', 'line 2: expected 4 columns as in the first line'),
    ('a.csv', 'time,wx,wy,wz\n1,nan,3,4\n', 'expected at least 4 messages with a finite '
     'attitude or angular velocity, found 0 among 1'),
    ('a.csv', 'time,wx,wy,wz\n', 'found 0 among 0'),
    ('a.tum', '1 2 3\n', 'line 1: expected numbers'),
    ('a.csv', '\xff', 'expected text in UTF-8')])
def test_a_bad_file_is_one_line(tmp_path, name, text, message):
    path = tmp_path / name
    path.write_bytes(text.encode('latin-1'))
    with pytest.raises(InputError, match=message) as raised:
        read_measured(str(path))
    assert str(raised.value).startswith(str(path))
    assert '\n' not in str(raised.value)


def test_a_file_that_is_missing_is_one_line(tmp_path):
    with pytest.raises(InputError, match='missing.csv: cannot read the measurements'):
        read_measured(str(tmp_path / 'missing.csv'))


@pytest.mark.slow
def test_an_inertia_from_text_alone(tmp_path, capsys):
    truth = measurements.truth()
    sensor = truth.measured(2e-3, 5e-3)
    measurements.write(tmp_path / 'torque.mcap', torque=torque_messages(truth))
    measurements.write_scene(tmp_path / 'scene.yaml', truth)
    gyro, poses = tmp_path / 'gyro.csv', tmp_path / 'poses.tum'
    gyro.write_text(lines('time_ns,wx,wy,wz', sensor.stamps_ns.tolist(),
                          numbers(sensor.angular_velocity)))
    poses.write_text('\n'.join(f'{seconds(stamp)} 0 0 0 {" ".join(map(repr, q))}' for stamp, q
                               in zip(sensor.stamps_ns.tolist(), sensor.attitude.tolist())))
    before = gyro.read_bytes()
    arguments = [str(tmp_path / 'torque.mcap'), '--scene', str(tmp_path / 'scene.yaml'),
                 '--measured', str(gyro), '--measured', str(poses), '--estimate',
                 'inertia,start,gyro_bias@gyro.csv']
    page = tmp_path / 'page.html'
    assert main.attitude_identify([*arguments, '--report', str(page)]) == 0
    assert str(tmp_path) not in page.read_text(encoding='utf-8')
    shown = capsys.readouterr().out
    assert 'poses.tum attitude' in shown
    assert 'gyro_bias.x@gyro.csv' in shown
    linked = tmp_path / 'same.json'
    linked.symlink_to(gyro)
    assert main.attitude_identify([*arguments, '--json', str(linked), '--overwrite']) == 2
    assert gyro.read_bytes() == before
