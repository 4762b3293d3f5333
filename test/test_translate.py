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

"""
The step that compiles the kernels.

The arithmetic of the translator is that of Python, and it rejects all else.
"""

import ctypes
import importlib.util
import platform
import shutil
import subprocess
import sys

from conftest import ROOT
import pytest
from setuptools.errors import CompileError

sys.path.insert(0, str(ROOT / 'build_kernels'))
import extension  # noqa: E402, I100
import generate  # noqa: E402, I100
import levels  # noqa: E402, I100
import translate  # noqa: E402, I100

HEADER = """import math

from rigid_body_ros.kernels.jit import inlined, internal

TABLE = (1.5, 2.5)


"""
#: Functions of two integers and two doubles.
FUNCTIONS = """
@internal
def quotients(i: int, j: int, x: float, y: float) -> float:
    return float(10 * (i // j) + i % j) + x % y + i / j


@internal
def constants(i: int, j: int, x: float, y: float) -> float:
    return 2.0 ** -3 + TABLE[1] * x - 7 // 2


@internal
def swapped(i: int, j: int, x: float, y: float) -> float:
    x, y = y, x
    (i, j), k = (j, i), i
    return 4.0 * x + y + float(8 * i + j + k)


@internal
def bounds(i: int, j: int, x: float, y: float) -> float:
    count, same = 0, True
    for k in range(8 if same else 0):
        same = k < 3
        count += k
    for k in range(5, -1, -2):
        count = 2 * count + k
    return float(count)


@internal
def conditions(i: int, j: int, x: float, y: float) -> float:
    if -2 <= i < j or not x < y:
        found = 1.0
    elif x == y:
        found = 2.0
    else:
        found = x if i > 0 else y
    while abs(found) < 100.0:
        found = 3.0 * found + 2.5
        if found > 50.0 and i < 0:
            break
    return found


@internal
def tuples(i: int, j: int, x: float, y: float) -> float:
    numbers = (x, y, 2.0, 3.0)
    a, b = numbers[1:3]
    return numbers[abs(i) % 4] + (a + b) * len(numbers[:-1])


@internal
def extremes(i: int, j: int, x: float, y: float) -> float:
    total = max(x, y, 0.5) - min(x, abs(y)) + float(round(x) + round(y + 0.5) + math.floor(y))
    for weight, value in ((2.0, x), (3.0, y)):
        total += weight * value
    for part in (x, y, 1.0)[:2]:
        total += part
    return total + float(len((x, y)))
"""
NUMBERS = [(i, j, x, y) for i in (-7, -3, 0, 5) for j in (-2, 3, 4)
           for x, y in ((1.25, 0.5), (-2.5, 1.5), (3.5, -1.0), (0.5, 0.5), (1e9, 7.0))]


def module_of(tmp_path, text):
    """Return a module of kernels with a text."""
    path = tmp_path / 'sample.py'
    path.write_text(HEADER + text)
    spec = importlib.util.spec_from_file_location('rigid_body_ros.kernels.sample', path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which('g++'), reason='g++ is not installed')
def test_translated_functions_return_what_python_does(tmp_path):
    module = module_of(tmp_path, FUNCTIONS)
    names = [name for name, value in vars(module).items()
             if getattr(value, '__module__', '') == module.__name__]
    assert len(names) == 7
    (tmp_path / 'kernels.hpp').write_text(translate.translated([module]))
    (tmp_path / 'sample.cpp').write_text('#include "kernels.hpp"\n' + '\n'.join(
        f'extern "C" [[gnu::visibility("default")]] double {name}_(int64_t i, int64_t j, double x,'
        f' double y) {{ return sample::{name}(i, j, x, y); }}' for name in names))
    subprocess.run(['g++', *generate.OPTIONS, '-DLANES=4', f"-I{ROOT / 'build_kernels'}",
                    '-shared', tmp_path / 'sample.cpp', '-lm', '-o', tmp_path / 'sample.so'],
                   check=True)
    library = ctypes.CDLL(str(tmp_path / 'sample.so'))
    for name in names:
        compiled = getattr(library, f'{name}_')
        compiled.restype = ctypes.c_double
        compiled.argtypes = [ctypes.c_int64, ctypes.c_int64, ctypes.c_double, ctypes.c_double]
        for numbers in NUMBERS:
            assert compiled(*numbers).hex() == getattr(module, name)(*numbers).hex(), name


#: A kernel with an effect on its argument.
CHANGED = """

@internal
def changed(values: object) -> float:
    values[0] = 2.0
    return values[1]
"""


@pytest.mark.parametrize(('statement', 'expected'), [
    ('with x: pass', 'With is not in the subset of Python for kernels: with x:'),
    ('return [k for k in (x, y)]', 'ListComp is not in the subset'),
    ('return "text"', "Constant is not in the subset of Python for kernels: 'text'"),
    ('return x ** y', 'BinOp is not in the subset of Python for kernels: x ** y'),
    ('return ~i', 'UnaryOp is not in the subset'),
    ('return x in (x, y)', 'Compare is not in the subset'),
    ('return x is y', 'expected a comparison with None: x is y'),
    ('return print(x)', 'expected a kernel, a number, numbers or an array: print'),
    ('return math.exp(x)', 'expected a kernel, a number, numbers or an array: math.exp'),
    ('return x.hex()', 'Call is not in the subset of Python for kernels: x.hex()'),
    ('return max(x, y, key=abs)', 'Call is not in the subset'),
    ('return x < abs(y) < 2.0', 'expected no call in the middle of a comparison'),
    ('return (x, y)[-1]', 'expected an index from the start'),
    ('return (x, y)[::2]', 'Slice is not in the subset'),
    ('for k in range(i): k = 2', 'expected a loop without else'),
    ('a, b = x, y, x', 'expected 3 targets'),
    ('if x is None and y > 0.0: return x\n    else: return y', 'expected what is known'),
    ('if x > 0.0 and y is None: return x', 'expected what is known'),
    ('if x > 0.0:\n        a = x\n        b = a\n    return b', 'expected b to be assigned'),
    ('for k in range(i): pass\n    return k', 'expected k to be assigned before'),
    ('return values[0] + changed(values)', 'expected a statement of its own: changed(values)'),
])
def test_what_is_outside_the_subset_is_rejected_with_its_line(tmp_path, statement, expected):
    arguments = 'i: int, x: float, y: float, values: object'
    module = module_of(tmp_path, f'@internal\ndef function({arguments}) -> float:\n'
                                 f'    first = x\n    {statement}\n{CHANGED}')
    with pytest.raises(translate.RejectedError) as raised:
        translate.translated([module])
    text = str(raised.value)
    assert '\n' not in text
    assert expected in text
    path, line, _ = text.split(':', 2)
    assert path == str(tmp_path / 'sample.py')
    begin = HEADER.count('\n') + 4
    assert begin <= int(line) <= begin + statement.count('\n')


def test_the_code_names_the_lines_of_its_source(tmp_path):
    module = module_of(tmp_path, FUNCTIONS)
    text = translate.translated([module])
    number = (HEADER + FUNCTIONS).splitlines().index('    x, y = y, x') + 1
    assert f'#line {number} "{tmp_path / "sample.py"}"\n' in text


def test_a_missing_compiler_is_named_with_how_to_get_one(monkeypatch):
    monkeypatch.setenv('CXX', 'no-such-compiler')
    with pytest.raises(CompileError, match=r'apt install g\+\+.*, found no no-such-compiler$'):
        extension.compiler(platform.machine())


@pytest.mark.parametrize(('variable', 'value'), [
    ('RIGID_BODY_ROS_LEVELS', 'all'), ('SOURCE_DATE_EPOCH', '1')])
def test_a_package_for_other_machines_has_all_levels(monkeypatch, variable, value):
    monkeypatch.delenv('RIGID_BODY_ROS_LEVELS', raising=False)
    monkeypatch.setenv(variable, value)
    assert levels.wanted(platform.machine()) == levels.MACHINES[platform.machine()]


def test_levels_that_do_not_exist_are_rejected(monkeypatch):
    monkeypatch.setenv('RIGID_BODY_ROS_LEVELS', 'v3')
    with pytest.raises(CompileError, match="^RIGID_BODY_ROS_LEVELS: expected all, found 'v3'$"):
        levels.wanted(platform.machine())
