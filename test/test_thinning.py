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

"""Thinned series of a page contain every extreme value, and evenly spaced rows."""

import base64
import json

import numpy as np
import pytest
from rigid_body_ros.report.charts import Curves
from rigid_body_ros.report.page import embedded, html
from rigid_body_ros.report.report import Report
from rigid_body_ros.report.thinning import EveryNth, Extremes

#: Lengths of batches: equal ones, uneven and odd ones, single samples, and empty ones.
BATCHES = {'even': [64] * 16, 'odd': [1, 7, 0, 333, 2, 13, 5, 600, 63], 'single': [1] * 1024,
           'whole': [1000], 'growing': [*range(45)], 'one sample': [1]}


@pytest.mark.parametrize('lengths', BATCHES.values(), ids=BATCHES)
def test_the_extremes_are_those_of_equal_intervals_however_a_series_arrives(lengths, monkeypatch):
    monkeypatch.setattr('rigid_body_ros.report.thinning._INTERVALS', 16)
    count = sum(lengths)
    times = 10 ** 18 + np.cumsum(np.random.default_rng(1).integers(1, 9, count))
    values = np.random.default_rng(2).standard_normal((count, 3))
    extremes = Extremes(3)
    for stop, length in zip(np.cumsum(lengths), lengths):
        extremes.add(times[stop - length:stop], values[stop - length:stop])
    found, low, high = extremes.result()
    size = next(2 ** k for k in range(64) if count // 2 ** k <= 16)
    starts = np.arange(0, count, size)
    np.testing.assert_array_equal(found, times[starts])
    np.testing.assert_array_equal(low, np.minimum.reduceat(values, starts))
    np.testing.assert_array_equal(high, np.maximum.reduceat(values, starts))


@pytest.mark.parametrize('lengths', BATCHES.values(), ids=BATCHES)
def test_rows_at_equal_distances_have_the_first_and_the_last(lengths):
    count, kept = sum(lengths), EveryNth(16)
    rows = np.arange(count)
    for stop, length in zip(np.cumsum(lengths), lengths):
        batch = rows[stop - length:stop]
        chosen = batch[kept.chosen(length)]
        if length:
            kept.add(length, chosen, chosen[:, None] + 0.5)
    times, values = kept.result()
    step = next(2 ** k for k in range(64) if np.ceil(count / 2 ** k) <= 16)
    np.testing.assert_array_equal(times, np.union1d(rows[::step], rows[-1:]))
    np.testing.assert_array_equal(values[:, 0], times + 0.5)


def test_curves_keep_zeros_and_small_differences():
    steps = np.arange(1001)
    for values, error in ((0.3 * np.sin(steps), 2e-8), (np.where(steps < 500, 0.0, 0.1), 4e-9),
                          (0.7 + 1e-9 * np.sin(steps), 2e-16), (1e5 + 0.0 * steps, 0.0)):
        data = Curves.thinned(steps, values[:, None], ['value'], 0).as_data()
        shown = data['offsets'][0] + np.frombuffer(base64.b64decode(data['low']), '<f4').astype(
            float)
        np.testing.assert_allclose(shown, values, rtol=0.0, atol=error)
        np.testing.assert_array_equal(shown[values == 0.0], 0.0)


@pytest.mark.parametrize('text', ['</script><script>alert(1)</script>', '<!--<script>', ']]>',
                                  '&lt;/script&gt;', '\u2028\u2029\0', '"\'\\`${1}', 'ώ 姿勢 🛰'])
def test_what_is_embedded_stays_text(text):
    data = {text: [text, 1.5, None]}
    assert json.loads(embedded(data)) == data
    assert not set(embedded(data)) & set('<>&\u2028\u2029')
    page = html(Report(text, text, [(text, text)], warnings=[text], command=text))
    plain = html(Report('', '', [('', '')], warnings=[''], command='-'))
    for mark in ('<script', '</script', '<!--', '-->', '<p', '<d'):
        assert page.count(mark) == plain.count(mark)
