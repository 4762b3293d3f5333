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

"""The comparison of machines, `make arm`: its inputs are exact, and it misses no difference."""

import json
import subprocess
import sys

import arm
import arm_machine
import bits
from conftest import ROOT
import numpy as np
import portable
import pytest
from rigid_body_ros import Problem
from rigid_body_ros.engine import _compiled


def test_differences_are_counted_in_ulps():
    here = np.array([1.0, -1.0, 0.0, 5e-324, -2.0, np.inf])
    there = np.array([np.nextafter(1.0, 2.0), -1.0, -0.0, -5e-324, np.nextafter(-2.0, 0.0),
                      np.finfo(float).max])
    assert arm.differences(here, here) == (0, 0.0)
    assert arm.differences(there, here) == (5, 2.0)
    assert arm.differences(here[1:2], here[1:2]) == (0, 0.0)
    assert arm.differences(portable.REJECTED, here) == (6, np.inf)


def test_the_table_names_the_worst_motion():
    here = {'euler/a': np.ones(3), 'euler/b': np.ones(3), 'auto/a': np.ones(2)}
    there = {**here, 'euler/a': np.nextafter([1.0, 1.0, 1.0], 2.0),
             'euler/b': np.array([1.0, 1.0 + 2.0 ** -50, 1.0])}
    lines = arm.table(here, {'arm64': arm.compared(there, here)})
    assert [line.split() for line in lines[1:3]] == [
        ['euler', '6', '4', 'differ'], ['auto', '2', 'same', 'bits']]
    assert lines[3:] == ["arm64, euler: 4 differ, by up to 4 ulp in 'b'"]


@pytest.mark.parametrize('number', range(6))
def test_motions_are_written_without_rounding(number):
    motion = bits.random_motion(number)
    read = portable.motion_of(json.loads(json.dumps(portable.plain(motion, portable.RANDOM))))
    pairs = [(motion.body.inertia, read.body.inertia), (motion.at, read.at),
             (motion.start._packed, read.start._packed), (motion.log.torques, read.log.torques),
             (motion.log.times_ns, read.log.times_ns), (motion.log.in_space, read.log.in_space),
             [Problem(one.body, one.start, fields=one.fields)._fields for one in (motion, read)]]
    assert all(a.tobytes() == b.tobytes() for a, b in pairs)
    assert (read.start.time_ns, read.log.interpolation, read.options, read.max_step) == (
        motion.start.time_ns, motion.log.interpolation, motion.options, motion.max_step)


def test_missing_commands_are_one_line(monkeypatch, capsys):
    monkeypatch.setenv('PATH', '')
    monkeypatch.setattr(sys, 'argv', ['arm.py'])
    assert arm.main() == 2
    assert capsys.readouterr().err == (
        'arm: expected the commands qemu-aarch64-static, aarch64-linux-gnu-g++, apt-get, '
        'dpkg-deb, did not find qemu-aarch64-static, aarch64-linux-gnu-g++, apt-get, dpkg-deb; '
        'on Debian: apt-get install qemu-user-static g++-aarch64-linux-gnu apt dpkg\n')


def test_the_emulated_machine_has_what_the_package_requires():
    setup = (ROOT / 'setup.py').read_text()
    text = setup[setup.index('install_requires=['):]
    required = {name.split('>')[0] for name in text[:text.index(']')].split("'")[1::2]}
    # matplotlib and SciPy are imported only where they are used.
    assert required - {'matplotlib', 'scipy'} <= set(arm_machine.REQUIRED)


@pytest.mark.nightly
@pytest.mark.skipif(arm.OLD not in _compiled.LEVELS, reason='its kernels are not compiled')
def test_an_old_processor_gives_the_same_bits(tmp_path):
    motions = tmp_path / 'motions.json'
    motions.write_text(json.dumps(arm.motions(3)))
    found = []
    for machine in (arm.HERE, arm.OLD):
        subprocess.run([sys.executable, ROOT / 'benchmarks' / 'portable.py', motions,
                        tmp_path / f'{machine}.npz'], env=arm.environment(machine), check=True)
        with np.load(tmp_path / f'{machine}.npz') as file:
            found.append(dict(file))
    assert {name: count for name, (count, *_) in arm.compared(*found).items() if count} == {}
