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

from collections import Counter
import math
import os
import re
import subprocess
import sys

from conftest import at_night, ROOT
import numpy as np
import pytest
from rigid_body_ros import UniformField
from rigid_body_ros.engine._compiled import LANES, LEVELS
from rigid_body_ros.mechanics.torque import INTERPOLATIONS
from rigid_body_ros.propagation import SOLVERS
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
def test_they_cover_all_solvers_terms_and_interpolations(motions):
    assert len({motion.name for motion in motions}) == len(motions)
    problems = [motion.problem for motion in motions]
    assert {problem.options.solver for problem in problems} == {*SOLVERS}
    assert {log.interpolation for problem in problems for log in problem.logs} == {*INTERPOLATIONS}
    for has_term in (lambda problem: problem.body.is_damped, lambda problem: problem.wheels,
                     lambda problem: not problem.logs, lambda problem: len(problem.logs) > 1,
                     lambda problem: problem.options.torque_timeout,
                     lambda problem: problem.fields and problem.logs,
                     lambda problem: [*map(type, problem.fields)].count(UniformField) > 3,
                     lambda problem: {*map(type, problem.fields)} > {UniformField},
                     lambda problem: any(0 < log.in_space.mean() < 1 for log in problem.logs)):
        assert sum(map(bool, map(has_term, problems))) >= 5
    groups = Counter(motion.group for motion in motions if motion.group)
    assert min(groups.values()) > max(LANES.values())


@pytest.mark.slow
def test_fields_have_the_sums_and_directions_that_the_page_describes(motions):
    for problem in (motion.problem for motion in motions if motion.problem.fields):
        record, = problem._fields
        uniform = [field for field in problem.fields if isinstance(field, UniformField)]
        pairs = [(field.moment, field.field) for field in uniform]
        if len(uniform) > 3:
            pairs = [([sum(field.field[k] * moment for field, moment in zip(
                uniform, moments)) for moments in zip(*(field.moment for field in uniform))],
                np.eye(3)[k]) for k in range(3)]
        assert record['count'] == len(pairs)
        for name, vectors_of in (('moments', 0), ('fields', 1)):
            assert record[name][:3 * len(pairs)].tolist() == [
                number for pair in pairs for number in pair[vectors_of]]
        for orbit in {*problem.fields} - {*uniform}:
            (x, y, z), (u, v, w) = orbit.position.tolist(), orbit.normal.tolist()
            along = [v * z - w * y, w * x - u * z, u * y - v * x]
            for size in (max, length) if abs(length(along) - 1.0) > 2.0 ** -50 else ():
                divisor = size([*map(abs, along)])
                along = [one / divisor for one in along]
            assert (record['position'].tolist(), record['along'].tolist()) == ([x, y, z], along)


def length(vector):
    return math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])


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
