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

"""Tables with common faults and headings: the right value, or a line that names the fault."""

from functools import partial

from conftest import SECOND
from field_data import (
    ATTITUDE,
    BOTH,
    called,
    COUNT,
    GYRO,
    is_clean,
    is_noise,
    RATES,
    ROWS,
    seconds,
    STAMPS,
    START_NS,
    table,
    TORQUES,
)
import numpy as np
import pytest
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.recording.measurements import read_measured

UNIT = '; a heading such as "time_ms" names the unit\n'
TIMES = seconds(STAMPS)
WXYZ, DEGREES = ATTITUDE[:, [3, 0, 1, 2]], np.degrees(RATES)


@pytest.fixture
def run(capsys, tmp_path):
    return partial(called, capsys, tmp_path)


BOOT_NS = STAMPS - START_NS + 100 * SECOND
SINCE_1970 = 'because {} is then a time since 1970'
TOO_FAST = 'because samples {} s apart could not follow the motion'


@pytest.mark.slow
@pytest.mark.parametrize(('times', 'note'), [
    (STAMPS, 'ns is assumed, ' + SINCE_1970.format(START_NS)),
    (STAMPS // 10 ** 3, 'us is assumed, ' + SINCE_1970.format(START_NS // 10 ** 3)),
    (STAMPS // 10 ** 6, 'ms is assumed, ' + SINCE_1970.format(START_NS // 10 ** 6)),
    ([f'{time}.000' for time in STAMPS // 10 ** 6], 'ms is assumed, ' + SINCE_1970.format(
        f'{START_NS // 10 ** 6}.000')),
    (seconds(STAMPS), ''), (seconds(BOOT_NS), ''),
    (BOOT_NS, 'ns is assumed, ' + TOO_FAST.format('1e+07')),
    (BOOT_NS // 10 ** 3, 'us is assumed, ' + TOO_FAST.format('10000')),
    (BOOT_NS // 10 ** 6, 'ms is assumed, ' + TOO_FAST.format('10'))])
def test_the_unit_of_times_is_recognized_and_noted(run, tmp_path, times, note):
    path = table(tmp_path / 'it.csv', 'time,tx,ty,tz,wx,wy,wz', times, TORQUES, RATES)
    status, _, error, found = run('compare', path, '--measured', path)
    assert (status, error) == (0, ''.join(
        f'attitude_compare: note: {path}: {name}: the times have no unit: {note}{UNIT}'
        for name in ('it.csv', 'torques') if note))
    is_noise(found, GYRO)


@pytest.mark.parametrize(('heading', 'unit_ns'), [
    ('time (s)', SECOND), ('time_ms', 10 ** 6), ('t [us]', 1000), ('time', SECOND)])
def test_a_unit_in_the_heading_wins_and_a_slow_body_is_sampled_each_second(tmp_path, heading,
                                                                           unit_ns):
    slow = RATES * (1.0 if heading != 'time' else 1e-3)
    found = read_measured(table(tmp_path / 'it.csv', f'{heading},wx,wy,wz', 10 * ROWS if
                                heading != 'time' else ROWS, slow))
    assert found.stamps_ns.tolist() == (ROWS * unit_ns * (10 if heading != 'time' else 1)).tolist()
    assert found.account.notes == []


def test_a_unit_that_cannot_be_is_named_and_so_is_an_assumed_one(run, tmp_path):
    path = table(tmp_path / 'it.csv', 'time (s),tx,ty,tz', STAMPS, TORQUES)
    assert f'expected a time from 0 to 2147483647 s, found {str(START_NS)!r}; name another unit' \
        in run('replay', path).error
    table(path, 'time,tx,ty,tz', ROWS * 10, TORQUES)
    shown = run('replay', path, '--until', '1').shown
    assert 'no unit: s is assumed, so samples are 10 s apart' in shown


def test_a_matrix_is_not_a_trajectory(tmp_path):
    (tmp_path / 'it.txt').write_text('\n'.join([' '.join(12 * ['0.5'])] * 9))
    with pytest.raises(InputError, match='found 12 columns, as in a pose matrix of 3 x 4'):
        read_measured(tmp_path / 'it.txt')


JOINED = ('__time,/torque/wrench/torque/x,/torque/wrench/torque/y,/torque/wrench/torque/z,'
          '/imu/angular_velocity/x,/imu/angular_velocity/y,/imu/angular_velocity/z,'
          '/att/quaternion/x,/att/quaternion/y,/att/quaternion/z,/att/quaternion/w')


@pytest.mark.slow
@pytest.mark.parametrize('is_apart', [False, True])
@pytest.mark.parametrize('blank', ['', 'nan', 'NaN', ' '])
def test_a_joined_table_has_empty_cells_and_several_rates(run, tmp_path, blank, is_apart):
    lines = [JOINED]
    for row, time in enumerate(TIMES):
        samples = [','.join(map(repr, values[row].tolist()) if row % step == 0 else
                            values.shape[1] * [blank])
                   for values, step in ((TORQUES, 1), (RATES, 2), (ATTITUDE, 3))]
        blanks = [','.join(count * [blank]) for count in (3, 3, 4)]
        parts = [[*blanks[:k], sample, *blanks[k + 1:]] for k, sample in enumerate(samples)]
        lines += [','.join([time, *part]) for part in (parts if is_apart else [samples])]
    path = tmp_path / 'it.csv'
    path.write_text('\n'.join(lines))
    result = run('compare', path, '--measured', path)
    is_clean(result, *BOTH)
    assert {name: account['samples'] for name, account in result.found['accounts'].items()} == {
        'it.csv:attitude': 101, 'it.csv:rates': 151, 'torques': COUNT}
    _, shown, _, _ = run('replay', path)
    assert shown.startswith('torques       301 on /torque, over 3 s\n')
    assert 'account' not in shown


@pytest.mark.slow
@pytest.mark.parametrize(('separator', 'point'), [(';', ','), (';', '.'), ('\t', '.'),
                                                  ('\t', ','), (',', '.')])
@pytest.mark.parametrize('quote', ['', '"'])
def test_columns_are_separated_as_tables_of_any_country_are(run, tmp_path, separator, point,
                                                            quote):
    paths = []
    for name, heading, values in (('torque.csv', 'time tx ty tz', TORQUES),
                                  ('gyro.csv', 'time wx wy wz', RATES)):
        columns = [TIMES, *([repr(cell) for cell in column] for column in values.T.tolist())]
        paths.append(table(tmp_path / name, heading.replace(' ', separator), *(
            [f'{quote}{cell.replace(".", point)}{quote}' for cell in column]
            for column in columns), separator=separator))
    is_clean(run('compare', paths[0], '--measured', paths[1]), GYRO)


def axes(name, unit='', names='xyz'):
    return ','.join(name.format(axis) + unit for axis in names)


@pytest.mark.parametrize(('heading', 'values'), [
    ('"Time (s)",' + axes('"Gyroscope {} (rad/s)"') + ',"Absolute (rad/s)"',
     np.column_stack([RATES, np.linalg.norm(RATES, axis=1)])),
    *((f'time,{axes("gyro_{}", unit)}', DEGREES) for unit in (
        ' (°/s)', '_dps', ' (dps)', ' [deg/s]')),
    *((f'timestamp,{axes(name)}', RATES) for name in (
        'ang_vel_{}', 'angular_velocity.{}', 'rotationRate.{}', 'gyroRotation{}(rad/s)',
        'omega_{}', '{} (rad/s)')),
    (f'#timestamp [s],{axes("w_RS_S_{} [rad s^-1]")}', RATES),
    *((f'time,{axes(name, names="0123")}', WXYZ) for name in (
        'q{}', 'q[{}]', 'vehicle_attitude/q.0{}')),
    *((f'time,{axes(name, names="xyzw")}', ATTITUDE) for name in (
        'q{}', 'orientation.{}', 'field.orientation.{}', 'pose.orientation.{}'))])
def test_headings_of_other_programs_are_known(tmp_path, heading, values):
    path = tmp_path / 'it.csv'
    for bom, end in (('', '\n'), ('\ufeff', '\r\n')):
        text = table(path, heading, TIMES, values).read_text()
        path.write_bytes((bom + text.replace('\n', end)).encode())
        found = read_measured(path)
        assert found.stamps_ns.tolist() == STAMPS.tolist()
        assert found.account.notes == []
        if values is WXYZ or values is ATTITUDE:
            np.testing.assert_allclose(found.attitude, ATTITUDE, atol=1e-15)
        else:
            np.testing.assert_allclose(found.angular_velocity, RATES, rtol=1e-14)


XYZ = 'xyz[0],xyz[1],xyz[2]'


@pytest.mark.parametrize(('name', 'is_gyro'), [
    ('Gyroscope', True), ('2_gyro', True), ('log_vehicle_angular_velocity_0', True),
    ('it', False), ('Accelerometer', False), ('log_vehicle_acceleration_0', False),
    ('vehicle_angular_acceleration_setpoint_0', False), ('gyro_and_torque', False)])
@pytest.mark.parametrize('heading', ['time,x,y,z', f'time,{XYZ}'])
def test_bare_axes_are_rates_only_in_a_file_of_that_name(tmp_path, name, is_gyro, heading):
    path = table(tmp_path / f'{name}.csv', heading, TIMES, RATES)
    if is_gyro:
        np.testing.assert_array_equal(read_measured(path).angular_velocity, RATES)
    else:
        with pytest.raises(InputError, match='line 1: no column for q.*; choose with --columns'):
            read_measured(path)


def test_names_of_files_tell_what_their_axes_are(run, tmp_path):
    gyro = table(tmp_path / 'Gyroscope.csv', 'time,seconds_elapsed,z,y,x', STAMPS,
                 seconds(STAMPS - START_NS), RATES[:, ::-1])
    np.testing.assert_array_equal(read_measured(gyro).angular_velocity, RATES)
    boot_us = BOOT_NS // 1000
    stamps = boot_us, boot_us - 40
    path = table(tmp_path / 'vehicle_torque_setpoint_0.csv', f'timestamp,timestamp_sample,{XYZ}',
                 *stamps, TORQUES)
    gyro = table(tmp_path / 'vehicle_angular_velocity_0.csv', 'timestamp,timestamp_sample,'
                 f'{XYZ},xyz_derivative[0],xyz_derivative[1],xyz_derivative[2]', *stamps, RATES,
                 np.zeros((COUNT, 3)))
    attitude = table(tmp_path / 'vehicle_attitude_0.csv', 'timestamp,timestamp_sample,q[0],q[1],'
                     'q[2],q[3],delta_q_reset[0],quat_reset_counter', *stamps, WXYZ,
                     np.zeros((COUNT, 2)))
    status, _, error, found = run('compare', path, '--measured', gyro, '--measured', attitude)
    assert (status, error.count('us is assumed'), error.count('\n')) == (0, 3, 3)
    is_noise(found, *BOTH)


@pytest.mark.parametrize(('columns', 'factor'), [
    ('time=1,wx=4,wy=3,wz=2', 1.0), ('time_s=A,wx (rad/s)=D,wy=C,wz=B', 1.0),
    ('time=A,wx (deg/s)=4,wy (deg/s)=C,wz (deg/s)=2', np.radians(1.0))])
def test_columns_are_chosen_by_number_or_name(run, tmp_path, columns, factor):
    torques = table(tmp_path / 'torque.csv', 'A,B,C,D', TIMES, 1000.0 * TORQUES)
    gyro = table(tmp_path / 'gyro.csv', 'A,B,C,D', TIMES, RATES[:, ::-1] / factor)
    is_clean(run('compare', torques, '--measured', gyro, '--columns',
                 f'tx (mN m)=2,ty (mN m)=C,tz (mN m)=4,{columns}'), GYRO)


KNOWN = '--columns: expected time (s, ms, us, ns), and qx qy qz qw or wx wy wz (rad/s, deg/s)'


@pytest.mark.parametrize(('columns', 'message'), [
    ('time=5,wx=4,wy=3,wz=2',
     "--columns: time: expected a number from 1 to 4, or one of A, B, C, D, found '5'"),
    ('time=0,wx=4,wy=3,wz=2', "or one of A, B, C, D, found '0'"),
    ('time=E,wx=4,wy=3,wz=2', "or one of A, B, C, D, found 'E'"),
    ('time=1,wx=4,wy=3', 'line 1: no column for wz; '), ('wx=4,wy=3,wz=2', 'no column for time; '),
    ('time=1,wx (rpm)=4,wy=3,wz=2', KNOWN), ('time=1,wx=4,wy=3,wz=2,speed=2', KNOWN)])
def test_a_wrong_choice_of_columns_is_a_line_that_names_it(run, tmp_path, columns, message):
    torques = table(tmp_path / 'torque.csv', 'time,tx,ty,tz', TIMES, TORQUES)
    gyro = table(tmp_path / 'gyro.csv', 'A,B,C,D', TIMES, RATES)
    status, _, error, _ = run('compare', torques, '--measured', gyro, '--columns', columns)
    assert (status, error.count('\n')) == (2, 1)
    assert message in error


@pytest.mark.parametrize('columns', ['time=1,wx=2,wx=3', 'time', 'time=', '=1', ''])
def test_a_choice_of_columns_has_each_name_once(run, tmp_path, capsys, columns):
    with pytest.raises(SystemExit) as raised:
        run('replay', tmp_path / 'it.csv', '--columns', columns)
    assert raised.value.code == 2
    assert f'expected NAME=COLUMN,..., each once, found {columns!r}' in capsys.readouterr().err
