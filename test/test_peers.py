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

"""The tables of peers: all numbers of a table are from one measurement."""

from functools import partial
import re
from types import SimpleNamespace

from conftest import ROOT
import numpy as np
import pairs
import peers
import pytest

PAGE = (ROOT / 'docs' / 'tradeoff.md').read_text(encoding='utf-8')
TABLES = [block.splitlines() for block in re.findall(r'^\| us \|.*?(?=\n\n)', PAGE,
                                                     re.DOTALL | re.MULTILINE)]


def cells(line):
    return [cell.strip() for cell in line.strip('|').split('|')]


def numbers(line):
    """Return the times of a table row by problem; NaN where there is none."""
    return np.array([float('nan' if cell == '-' else cell) for cell in cells(line)[1:]])


def check_ratios(lines):
    """Check that the last row is the ratio of the fastest peer's printed time to ours."""
    ours, *others, last = lines[2:]
    ours, others = numbers(ours), np.array([numbers(line) for line in others])
    best = np.fmin.reduce(others)
    for own, peer, cell in zip(ours, best, cells(last)[1:], strict=True):
        if np.isnan(own) or np.isnan(peer):
            assert cell == ('-' if np.isnan(own) else 'alone')
            continue
        value, _, word = cell.partition(' ')
        # Allow for the rounding to three printed digits.
        np.testing.assert_allclose(float(value), peer / own, rtol=0.016)
        assert word in ('', '(level)', '(behind)')


def test_a_duel_is_level_only_if_the_interval_of_its_rounds_has_1_in_it():
    random = np.random.default_rng(3)
    ours = 1e-5 * random.uniform(0.99, 1.01, pairs.ROUNDS)
    for factor, word in ((1.001, ' (level)'), (1.1, ''), (0.9, ' (behind)')):
        theirs = factor * 1e-5 * random.uniform(0.9, 1.1, pairs.ROUNDS)
        rungs = {who: [peers.Rung(None, 'setting', 1e-9, 1e-5, times)]
                 for who, times in ((peers.US, ours), ('peer', theirs))}
        ratio = np.median(theirs) / np.median(ours)
        assert peers.verdict(rungs, 1e-6) == f'{ratio:.3g}{word}'
        assert peers.verdict(rungs, 1e-12) == '-'


def test_contenders_run_in_turns_and_slow_ones_sit_rounds_out():
    log = []
    contenders = [SimpleNamespace(name=name, reset=lambda: None, run=partial(log.append, name))
                  for name in 'abc']
    times = pairs.in_turns(contenders, [2e-3, 2e-3, 2.0], patience=3.0)
    ran = np.isfinite(times).sum(axis=0).tolist()
    assert ran == [pairs.ROUNDS, pairs.ROUNDS, 7]
    assert np.isfinite(times[0]).all()
    # Rounds alternate between forward and reverse order. An untimed run precedes each short run.
    assert ''.join(log[:14]) == 'cbbaa' + 'aabb' + 'bbaa' + 'a'


@pytest.mark.parametrize('lines', TABLES, ids=[f'table {k}' for k in range(len(TABLES))])
def test_the_page_does_not_contradict_itself(lines):
    check_ratios(lines)


def test_the_page_has_a_table_for_every_level_and_a_column_for_every_problem():
    assert len(TABLES) == len(peers.SHOWN)
    assert cells(TABLES[0][0]) == ['us', *peers.TITLES]
