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

"""Errors are one line of bounded length, whatever they quote."""

from rigid_body_ros.common.errors import InputError, listed, LONGEST, quoted, reason, shortened


def test_an_error_is_one_line_of_bounded_length():
    found = str(InputError('here: ' + 'a\n\x1b\ud800' * 10_000 + ' there'))
    assert len(found) == LONGEST
    assert found.isprintable()
    assert found.startswith(r'here: a\n\x1b\ud800a')
    assert found.endswith(' there')
    assert str(InputError(found)) == found
    assert str(InputError('Flügel/機体: 3 µN m')) == 'Flügel/機体: 3 µN m'


def test_of_many_names_the_first_are_listed():
    assert listed([]) == 'none'
    assert listed(['/a', '/b']) == '/a, /b'
    assert listed([f'/{k}' for k in range(100)]) == '/0, /1, /2, /3, /4, /5 and 94 more'
    assert len(listed(['x' * 10 ** 6] * 100)) < LONGEST


def test_what_is_quoted_and_a_reason_are_short_lines():
    for value in ('x' * 10 ** 7, ['x' * 10 ** 6] * 1000, {str(k): 'x' * 999 for k in range(999)}):
        assert len(quoted(value)) < 1000
    assert len(shortened('x' * 999, 99)) == 99
    assert [*map(reason, (ValueError('a\n  b'), ValueError(), OSError(2, 'No such file')))] \
        == ['a b', 'ValueError', 'No such file']
