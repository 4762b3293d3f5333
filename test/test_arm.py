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

from io import BytesIO
import pickle
import subprocess
import sys

import arm
import arm_machine
import bits
from conftest import ROOT
import numpy as np
import portable
import pytest
from rigid_body_ros import Problem, RigidBody
from rigid_body_ros.engine import _compiled


def test_every_kind_of_difference_is_named():
    here = {'same': np.array([1.0, np.nan]), 'ulp': np.ones(2), 'sign': np.zeros(1),
            'rejected': np.ones(2)}
    there = {'same': np.array([1.0, np.nan]), 'ulp': np.nextafter([1.0, 1.0], [1.0, 2.0]),
             'sign': np.array([-0.0]), 'rejected': portable.REJECTED}
    assert arm.differing(there, here) == ['ulp', 'sign', 'rejected']


@pytest.mark.parametrize('number', range(6))
def test_motions_are_written_without_rounding(number):
    motion, file = bits.random_motion(number), BytesIO()
    portable.Writer(file).dump(motion)
    read = pickle.loads(file.getvalue())
    pairs = [(motion.body.inertia, read.body.inertia), (motion.at, read.at),
             (motion.start._packed, read.start._packed), (motion.log.torques, read.log.torques),
             (motion.log.times_ns, read.log.times_ns), (motion.log.in_space, read.log.in_space),
             [Problem(one.body, one.start, fields=one.fields)._fields for one in (motion, read)]]
    assert all(a.tobytes() == b.tobytes() for a, b in pairs)
    assert (read.start.time_ns, read.log.interpolation, read.options, read.max_step) == (
        motion.start.time_ns, motion.log.interpolation, motion.options, motion.max_step)


def test_another_machine_computes_the_constants_of_a_body_itself(monkeypatch):
    file = BytesIO()
    portable.Writer(file).dump(bits.random_motion(0).body)
    monkeypatch.setattr(RigidBody, '_computed', None)
    with pytest.raises(TypeError):
        pickle.loads(file.getvalue())


def test_the_emulated_machine_has_what_the_package_requires():
    setup = (ROOT / 'setup.py').read_text()
    text = setup[setup.index('install_requires=['):]
    required = {name.split('>')[0] for name in text[:text.index(']')].split("'")[1::2]}
    # matplotlib and SciPy are imported only where they are used.
    assert required - {'matplotlib', 'scipy'} <= set(arm_machine.REQUIRED)


@pytest.mark.nightly
@pytest.mark.skipif(arm.OLD not in _compiled.LEVELS, reason='its kernels are not compiled')
def test_an_old_processor_gives_the_same_bits(tmp_path):
    motions = tmp_path / 'motions.pickle'
    with motions.open('wb') as file:
        portable.Writer(file).dump(arm.motions(3))
    found = []
    for machine in (arm.HERE, arm.OLD):
        subprocess.run([sys.executable, ROOT / 'benchmarks' / 'portable.py', motions,
                        tmp_path / f'{machine}.npz'], env=arm.environment(machine), check=True)
        with np.load(tmp_path / f'{machine}.npz') as file:
            found.append(dict(file))
    assert arm.differing(*found) == []
