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

"""Kernels compile wherever the package runs, and run where numba does not."""

import os
import shutil
import subprocess
import sys

from conftest import PACKAGE
import numpy as np
import pytest
from rigid_body_ros import propagate, RigidBody, State, TorqueLog, vector

SCRIPT = """
import sys
{before}
import numpy as np
from rigid_body_ros import RigidBody, State, TorqueLog, propagate
log = TorqueLog([0, 10 ** 9], [[0.1, 0.2, -0.1], [0.0, 0.3, 0.0]], ['body', 'space'])
body = RigidBody.from_moments(1.1, 2.0, 2.7, 0.15, -0.2, 0.05)
motion = propagate(body, State(0, angular_velocity=(0.5, -0.7, 0.9)), log, at=[3 * 10 ** 9])
print(*(x.hex() for x in motion.attitude[0].tolist()))
"""


def run(before='', **environment):
    result = subprocess.run([sys.executable, '-c', SCRIPT.format(before=before)],
                            env={**os.environ, **environment}, cwd='/', capture_output=True,
                            text=True, check=True)
    return np.array([float.fromhex(text) for text in result.stdout.split()]), result.stderr


def here():
    log = TorqueLog([0, 10 ** 9], [[0.1, 0.2, -0.1], [0.0, 0.3, 0.0]], ['body', 'space'])
    body = RigidBody.from_moments(1.1, 2.0, 2.7, 0.15, -0.2, 0.05)
    return propagate(body, State(0, angular_velocity=(0.5, -0.7, 0.9)), log,
                     at=[3 * 10 ** 9]).attitude[0]


def test_another_process_gives_the_same_bits():
    attitude, words = run()
    np.testing.assert_array_equal(attitude, here())
    assert words == ''


def test_without_numba_the_same_motion_comes_out():
    attitude, _ = run("sys.modules['numba'] = None")
    np.testing.assert_allclose(attitude, here(), rtol=0, atol=1e-15)


@pytest.mark.slow
def test_a_read_only_install_without_a_home_works_and_warns_once(read_only_package):
    nowhere = str(read_only_package / 'rigid_body_ros' / '__pycache__' / 'nowhere')
    attitude, words = run(PYTHONPATH=str(read_only_package), HOME=nowhere,
                          XDG_CACHE_HOME=nowhere, PYTHONDONTWRITEBYTECODE='1')
    np.testing.assert_array_equal(attitude, here())
    assert words.count('no folder for compiled kernels can be written') == 1


@pytest.mark.slow
def test_a_change_in_one_module_reaches_the_kernels_of_all(tmp_path):
    # The step is inlined into kernels of other files, whose cached code would go on.
    site = tmp_path / 'site'
    shutil.copytree(PACKAGE, site / 'rigid_body_ros', ignore=shutil.ignore_patterns('__pycache__'))
    environment = {'PYTHONPATH': str(site), 'NUMBA_CACHE_DIR': str(tmp_path / 'cache')}
    np.testing.assert_array_equal(run(**environment)[0], here())
    source = site / 'rigid_body_ros' / 'taylor.py'
    text = source.read_text()
    assert 'factor = 0.5 / (k + 1)' in text
    source.write_text(text.replace('factor = 0.5 / (k + 1)', 'factor = 1.0 / (k + 1)'))
    assert not np.allclose(run(**environment)[0], here())


def test_a_part_of_kernels_cannot_be_called_and_crash_the_interpreter():
    with pytest.raises(TypeError, match='cross is a part of kernels: Python cannot call it'):
        vector.cross((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
