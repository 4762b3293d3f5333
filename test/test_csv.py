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

"""Torques as text: the first line must name columns and units, or the file is not read."""

from conftest import EPOCH_NS, SECOND
from hostile import outcome
import numpy as np
import pytest
from rigid_body_ros import messages, recording
from rigid_body_ros.scene import InputError


def read(folder, text):
    path = folder / 'torque.csv'
    path.write_text(text, encoding='utf-8')
    found = recording.read(path)
    return found.stamps_ns.tolist(), found.values[:, 3:].tolist()


@pytest.mark.parametrize(('heading', 'order'), [
    ('time,tx,ty,tz', '0123'), ('tx,ty,tz,time', '1230'), ('tz,t,ty,tx', '3021'),
    ('timestamp,torque_x,torque_y,torque_z', '0123'), ('stamp,torque.x,torque.y,torque.z', '0123'),
    ('Time,Torque X,Torque Y,Torque Z', '0123'), ('# time, tx, ty, tz', '0123'),
    ('\\ufefftime,tx,ty,tz', '0123'), ('"time","tx","ty","tz"', '0123'),
    ('__time,/torque/wrench/torque/x,/torque/wrench/torque/y,/torque/wrench/torque/z', '0123'),
    ('/t/header/stamp,/t/wrench/torque/z,/t/wrench/torque/y,/t/wrench/torque/x', '0321'),
    ('wrench.torque.x,wrench.torque.y,wrench.torque.z,header.stamp', '1230'),
    ('time,wrench_torque_x,wrench_torque_y,wrench_torque_z', '0123'),
    ('\\n\\ntime (s),tx (N m),ty [Nm],tz_Nm', '0123')])
def test_the_names_give_the_order(tmp_path, heading, order):
    numbers = '1.5', '0.25', '-3', '4e-3'
    line = ','.join(numbers[int(place)] for place in order)
    heading = heading.encode().decode('unicode_escape') if '\\' in heading else heading
    assert read(tmp_path, f'{heading}\n{line}\n') == ([1_500_000_000], [[0.25, -3.0, 0.004]])


@pytest.mark.parametrize(('name', 'nanoseconds'), [
    ('time_s', 10 ** 9), ('time (sec)', 10 ** 9), ('t[seconds]', 10 ** 9), ('time_ms', 10 ** 6),
    ('time (ms)', 10 ** 6), ('t_us', 1000), ('stamp [µs]', 1000), ('t_ns', 1), ('time ns', 1),
    ('timestamp_ns', 1), ('/torque/header/stamp (ns)', 1)])
def test_times_have_the_unit_that_is_named(tmp_path, name, nanoseconds):
    stamp_ns = EPOCH_NS // nanoseconds * nanoseconds
    stamps, _ = read(tmp_path, f'{name},tx,ty,tz\n{stamp_ns // nanoseconds},0,0,0\n')
    assert stamps == [stamp_ns]


@pytest.mark.parametrize(('unit', 'digits'), [('s', 9), ('ms', 6), ('us', 3), ('ns', 0)])
def test_every_nanosecond_is_kept_in_every_unit(tmp_path, unit, digits):
    stamps = EPOCH_NS + np.cumsum(np.random.default_rng(5).integers(1, SECOND, 500))
    lines = [f'{stamp // 10 ** digits}.{stamp % 10 ** digits:0{digits}},0,0,0' if digits else
             f'{stamp},0,0,0' for stamp in stamps.tolist()]
    found, _ = read(tmp_path, '\n'.join([f'time_{unit},tx,ty,tz', *lines]))
    assert found == stamps.tolist()


@pytest.mark.parametrize(('unit', 'exponent'), [
    ('N m', 0), ('Nm', 0), ('N*m', 0), ('N·m', 0), ('N.m', 0), ('N-m', 0), ('mN m', -3),
    ('mNm', -3), ('mN*m', -3), ('uN m', -6), ('µNm', -6), ('nNm', -9), ('kN m', 3), ('MNm', 6)])
@pytest.mark.parametrize('form', ['{} ({})', '{} [{}]', '{}({})', '{}_{}', '{} {}'])
def test_torques_have_the_unit_that_is_named(tmp_path, unit, exponent, form):
    heading = ','.join(['time', *(form.format(name, unit) for name in ('tx', 'ty', 'torque_z'))])
    numbers = '20.1', '-0.3', '0.07'
    _, torques = read(tmp_path, f'{heading}\n1,{",".join(numbers)}\n')
    # The double nearest to the decimal number, as if this were written in N m.
    assert torques == [[float(f'{text}e{exponent}') for text in numbers]]


def test_each_column_has_its_own_unit(tmp_path):
    text = 'tx (mN m),time_us,ty,tz [kNm]\n2,5,3,4\n'
    assert read(tmp_path, text) == ([5000], [[0.002, 3.0, 4000.0]])


@pytest.mark.parametrize('extra', [
    'status', '', 'temperature (K)', 'wheel_speed', '/torque/wrench/force/x', 'x', 'dt', 'q_w'])
def test_columns_of_something_else_are_ignored(tmp_path, extra):
    text = f'tx,{extra},ty,tz,time\n1,much,2,3,4\n'
    assert read(tmp_path, text) == ([4 * SECOND], [[1.0, 2.0, 3.0]])


@pytest.mark.parametrize(('heading', 'message'), [
    ('tx,ty,tz', 'no column for time'), ('time,tx,ty', 'no column for tz'),
    ('a,b,c,d', 'no column for time'), ('time,fx,fy,fz', 'no column for tx'),
    ('time,tx,tx,ty,tz', "two columns for tx: 'tx' and 'tx'"),
    ('time,stamp,tx,ty,tz', "two columns for time: 'time' and 'stamp'"),
    ('time,tx,ty,tz,torque_x', "two columns for tx: 'tx' and 'torque_x'"),
    ('time_min,tx,ty,tz', "column 'time_min': unknown name or unit"),
    ('%time,tx,ty,tz', "column '%time'"), ('time (h),tx,ty,tz', r"column 'time \(h\)'"),
    ('time (Nm),tx,ty,tz', r"column 'time \(Nm\)'"), ('time,tx (s),ty,tz', r"column 'tx \(s\)'"),
    ('time,tx (lbf ft),ty,tz', r"column 'tx \(lbf ft\)'"),
    ('time,tx (nm),ty,tz', r"column 'tx \(nm\)'"), ('time,tx,ty,tz,mx', "column 'mx'"),
    ('time,tx,ty,tz,frame_id', "column 'frame_id'"), ('sec,nanosec,tx,ty,tz', "column 'sec'"),
    ('time,tx,ty,tz,torque_x_filtered', "column 'torque_x_filtered'"),
    ('time tx ty tz', "column 'time tx ty tz'"),
    ('time,tx,ty,tz,' + 'x' * 60_000, "column 'x+...x+'"),
    ('time,tx,ty,tz,' + '_' * 60_000, "column '_+..._+'")])
def test_a_heading_that_is_in_doubt_is_refused_by_column(tmp_path, heading, message):
    with pytest.raises(InputError, match=f'torque.csv: line 1: {message}') as error:
        read(tmp_path, f'{heading}\n1,2,3,4,5\n')
    assert ('expected time, t or stamp (s, ms, us, ns) and tx ty tz or torque_x torque_y torque_z '
            '(N m, mN m, uN m, kN m), with units as in "tx (mN m)" or "time_ms"') in str(
                error.value)


@pytest.mark.parametrize('text', [
    '1e9999999,0,0,0', '-1e9999999,0,0,0', '1e999990,0,0,0', '1e99999999999999999999,0,0,0',
    'snan,0,0,0', 'time,tx (mNm),ty,tz\n1,snan,0,0', 'time,tx (kNm),ty,tz\n1,1e9999999,0,0',
    'time,tx,ty,tz\n1,0,0', 'time,tx,ty,tz\n1,0,0,0,0', '1,0,0,0\n1,0,0,0,0', '2147483648,0,0,0',
    '1' * 10 ** 6, '1,' * 10 ** 6, '"1,0,0,0\n' * 10 ** 5, '\0' * 10 ** 6])
def test_a_line_that_is_none_is_refused(tmp_path, text):
    path = tmp_path / 'torque.csv'
    path.write_text(text)
    assert 'torque.csv: ' in outcome(path)


@pytest.mark.slow
@pytest.mark.parametrize('line', ['1e-9999999,0,0,0', '0e9999999,0,0,0', '0e-9999999,0,0,0'])
def test_an_exponent_costs_nothing(tmp_path, line):
    path = tmp_path / 'torque.csv'
    path.write_text(f'{line}\n' * 10_000 + '1,0,0,0')
    assert outcome(path) == ''


def test_the_last_stamp_is_the_last_of_ros(tmp_path):
    assert read(tmp_path, '2147483647.999999999,0,0,0') == ([messages.LAST_NS], [[0.0, 0.0, 0.0]])
