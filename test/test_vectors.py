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

"""Compiled kernels and plain Python reproduce every bit of the committed vectors."""

import os
import re
import subprocess
import sys

from conftest import at_night, ROOT
import pytest
from rigid_body_ros.engine._compiled import LEVELS
import vectors


@pytest.fixture(scope='module')
def motions():
    return vectors.read()


@pytest.mark.slow
def test_every_motion_has_the_committed_bits(motions):
    assert vectors.differences(motions) == []


@pytest.mark.slow
@pytest.mark.parametrize(('line', 'found', 'put', 'reported'), [
    ('state', 'p[-+][0-9]+$', 'p-60', [
        ': angular velocity z at 333333333 ns: expected',
        ', computed with its group: angular velocity z at 333333333 ns: expected']),
    ('euler', ' [^ ]+$', '', [': euler XZY at 3000000000 ns: expected 2 numbers, found 3']),
    ('state', '^.*\n', '', [', computed with its group: expected 1 outputs, found 2'])],
    ids=['a digit', 'an angle', 'a state'])
def test_what_the_file_has_changed_or_lacks_is_a_difference(tmp_path, line, found, put, reported):
    text = vectors.VECTORS.read_text(encoding='ascii')
    name = 'group one log, auto, 4'
    begin = text.index(f'\nmotion {name}\n')
    place = text.index(f'\n{line} ', begin) + 1
    changed = tmp_path / 'vectors.txt'
    changed.write_text(text[:place] + re.sub(found, put, text[place:], count=1, flags=re.M),
                       encoding='ascii')
    differences = vectors.differences(
        [motion for motion in vectors.read(changed) if motion.group == 'one log, auto'])
    assert len(differences) == len(reported)
    for difference, expected in zip(differences, reported):
        assert difference.startswith(name + expected)


@pytest.mark.slow
@pytest.mark.parametrize(('kernels', 'every', 'count'), [
    *((level, 1, 250) for level in LEVELS[1:]), ('python', 100, 3), *at_night(('python', 20, 13))])
def test_every_level_and_plain_python_give_the_same_bits(kernels, every, count):
    # The order of operations in BLAS, and its use of fused products, depend on the processor.
    environment = {'RIGID_BODY_ROS_KERNELS': kernels, 'OPENBLAS_CORETYPE': 'Prescott'}
    result = subprocess.run(
        [sys.executable, ROOT / 'benchmarks' / 'vectors.py', '--every', str(every)],
        env={**os.environ, **environment}, capture_output=True, text=True)
    assert (result.stdout, result.returncode) == (f'{count} motions: the same bits\n', 0)
