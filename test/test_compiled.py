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

"""The compiled kernels: their bits, their errors, and the files in an installation."""

from importlib import import_module
import os
from pkgutil import iter_modules
import random
import re
import shutil
from string import ascii_lowercase
import subprocess
import sys
from threading import Event, Thread
import time
from types import BuiltinFunctionType, UnionType
from typing import Annotated, get_args, get_origin, get_type_hints, Union

from conftest import PACKAGE
import numpy as np
import pytest
from rigid_body_ros import build_info, warm_up
from rigid_body_ros import kernels as package
from rigid_body_ros.engine import _compiled, binding, kernels
from rigid_body_ros.kernels.jit import WRITTEN

SCRIPT = """
import rigid_body_ros
from rigid_body_ros.engine.binding import LANES
from rigid_body_ros import (
    Actuator, BodyLog, euler, GravityGradient, Problem, RigidBody, so3, State, TorqueLog,
    UniformField)
body = RigidBody.from_moments(1.1, 2.0, 2.7, 0.15, -0.2, 0.05)
problem = Problem(body, State(
    0, angular_velocity=(0.5, -0.7, 0.9), rotor_momentum=(0.1, 0.0, 0.2)), TorqueLog(
        [0, 10 ** 7], [[0.1, 0.2, -0.1], [0.0, 0.3, 0.0]]), actuator=Actuator(time_constant=0.2),
    fields=[UniformField((0.3, -0.2, 0.5), (0.2, 0.4, -0.9), 'weight'), GravityGradient(0.3)],
    changes=BodyLog([2 * 10 ** 7], [RigidBody(0.7 * body.inertia)], 'momentum'))
found = problem.derivatives(['inertia', 'torque_gains', 'torque_delay', 'torque_lag', 'start',
                             'weight.moment'], at=[3 * 10 ** 7])
angles = [[0.3, 1.2, -0.4], [5.0, -1e-9, 2.0], [1e6, 3.0, 1e-300]]
turned = [so3.exp(angles), so3.log(so3.exp(angles))]
for sequence in ('ZXZ', 'xyz'):
    turned += [euler.to_quaternion(angles, sequence), euler.rates(angles, angles[::-1], sequence)]
print(rigid_body_ros.build_info())
print(LANES)
print(*(x.hex() for each in [*found[1:], *turned] for x in each.ravel().tolist()))
"""
#: The instruction levels of the module; tests skip levels that this processor does not support.
LEVELS = [pytest.param(level, marks=pytest.mark.skipif(
    level not in _compiled.LEVELS, reason=f'this processor lacks {level}'))
    for level in _compiled.LANES]


def run(script, cwd='/', **environment):
    return subprocess.run([sys.executable, '-c', script], env={**os.environ, **environment},
                          cwd=cwd, capture_output=True, text=True, check=False)


@pytest.fixture(scope='module')
def chosen():
    """Return what the script prints at the level that is chosen: build, lanes, results."""
    return run(SCRIPT, RIGID_BODY_ROS_KERNELS='').stdout.splitlines()


@pytest.mark.slow
@pytest.mark.parametrize('level', [*LEVELS, 'python'])
def test_every_level_and_plain_python_give_the_same_bits_and_are_named(level, chosen):
    # `test_vectors.py` compares motions.
    result = run(SCRIPT, RIGID_BODY_ROS_KERNELS=level)
    assert result.stderr == ''
    build, lanes, results = result.stdout.splitlines()
    assert results == chosen[2]
    assert build == str({**build_info(), 'level': level})
    expected = {'x86-64-v4': 8, 'x86-64-v3': 4, 'x86-64-v2': 4, 'aarch64': 4, 'python': 1}
    assert int(lanes) == expected[level]


@pytest.mark.slow
def test_the_best_level_of_the_processor_is_chosen(chosen):
    info = build_info()
    assert [*info] == ['version', 'kernels', 'level']
    assert re.fullmatch('[0-9a-f]{12}', info['kernels'])
    assert chosen[0] == str({**info, 'level': _compiled.LEVELS[0]})


def test_other_threads_run_while_a_kernel_does():
    kernel = _compiled.kernels(_compiled.LEVELS[0])['fill_exponentials']
    numbers, results = np.linspace(-1.0, 1.0, 200_000), np.empty(200_000)
    ticks, done = [], Event()

    def tick():
        while not done.is_set():
            ticks.append(time.perf_counter())
            time.sleep(1e-3)

    def ticks_meanwhile():
        begin = time.perf_counter()
        kernel(numbers, results)
        share = 0.25 * (time.perf_counter() - begin)
        return any(begin + share < moment < begin + 3.0 * share for moment in ticks)
    thread = Thread(target=tick)
    thread.start()
    try:  # on a busy machine the thread may have to wait for a processor
        assert any(ticks_meanwhile() for _ in range(50))
    finally:
        done.set()
        thread.join()


@pytest.mark.parametrize('level', LEVELS)
def test_all_kernels_that_python_calls_are_compiled(level):
    # Without `bind`, a kernel would run as plain Python.
    called = {name for name, value in vars(kernels).items()
              if callable(value) and value is not binding.bind}
    assert called == set(_compiled.kernels(level))
    if binding.LEVEL != 'python':
        assert {type(getattr(kernels, name)) for name in called} == {BuiltinFunctionType}


def sources():
    """Return the sources of the compiled kernels by name."""
    modules = [import_module(f'{package.__name__}.{module.name}')
               for module in iter_modules(package.__path__)]
    return {name: getattr(module, name) for name in _compiled.kernels(_compiled.LEVELS[0])
            for module in modules
            if getattr(getattr(module, name, None), '__module__', '') == module.__name__}


UNIONS = Union, UnionType


class Good:
    """
    Random valid arguments for a kernel, made from its annotations.

    `leaves` maps the label of each argument, and of each part of a named tuple, to its kind, a
    type or the dimensions of an array as texts, and its value. Values by label may be replaced.
    """

    def __init__(self, hints, seed, lanes, replaced=()):
        self._choose, self._replaced = random.Random(seed), dict(replaced)
        #: Values of dimensions, at least 2, so that none equals the alternative after a '|'.
        self.variables = {letter: self._choose.randint(2, 4) for letter in ascii_lowercase}
        self.variables['L'] = lanes
        self.leaves, self.written, self.optional = {}, set(), set()
        self.arguments = [self._value(hint, name) for name, hint in hints.items()]

    def _value(self, hint, label, absent=()):
        if get_origin(hint) in UNIONS:
            self.optional.add(label)
            hint = self._choose.choice(get_args(hint))
        if get_origin(hint) is Annotated and hasattr(get_args(hint)[0], '_fields'):
            hint, *absent = get_args(hint)
        if get_origin(hint) is Annotated:
            self.leaves[label] = self._array(label, *get_args(hint))
        elif hasattr(hint, '_fields'):
            self.leaves[label] = hint, hint(*(self._value(part, f'{label}.{name}', absent)
                                              for name, part in self._fields(hint, label, absent)))
        else:
            self.leaves[label] = hint, None if hint is type(None) else hint(0)
        return self._replaced.get(label, self.leaves[label][1])

    def _fields(self, hint, label, absent):
        """Return the annotations of a named tuple; of those that are combined, choose some."""
        hints, given = get_type_hints(hint, include_extras=True), getattr(hint, 'combinations', ())
        optional = {name for name, part in hints.items() if get_origin(part) in UNIONS}
        # Without one of its parts, a combination may be another one.
        self.optional |= {f'{label}.{name}' for name in optional}
        if absent or given:
            kept = optional - {*absent} if absent else self._choose.choice(given)
            for name in optional:
                hints[name] = get_args(hints[name])[0] if name in kept else type(None)
        return hints.items()

    def _array(self, label, array, shape, *marks):
        if WRITTEN in marks:
            self.written.add(label)
        element = get_args(array)[-1]  # a type or, before numpy 2.5, a dtype of it
        dtype, = [mark for mark in marks if isinstance(mark, np.dtype)] or [
            (get_args(element) or (element,))[0]]
        return shape.split(), np.zeros([*map(self._size, shape.split())], dtype)

    def _size(self, text):
        factor, variable, offset = re.fullmatch(
            r'(\d*)([a-zL]?)([+-]\d+)?', text.partition('|')[0]).groups()
        if not variable:
            return int(factor)
        return int(factor or 1) * self.variables[variable] + int(offset or 0)

    def sharing(self, text):
        """Return the labels of the arrays with a dimension that uses the variable in a text."""
        variable = re.sub('[^a-z]', '', text)
        return [label for label, (kind, _) in self.leaves.items() if isinstance(kind, list)
                for other in kind if variable and variable in other]


def other_type(array, good, label, choose):
    other = choose.choice([kind for kind in TYPES if array.dtype != kind])
    return TypeError, [label], np.zeros(array.shape, other)


def other_dimensions(array, good, label, choose):
    return TypeError, [label], choose.choice([array[None], array[0]])


def other_shape(array, good, label, choose):
    place = choose.randrange(array.ndim)
    text = good.leaves[label][0][place]
    shared = good.sharing(text) or 2 * [label]
    if len(shared) == 1 and not text[0].isdigit():
        return None  # any size is right
    shape = [size + (k == place) for k, size in enumerate(array.shape)]
    return ValueError, [*shared], np.zeros(shape, array.dtype)


def other_strides(array, good, label, choose):
    wide = np.zeros([2 * size for size in array.shape], array.dtype)
    found = choose.choice([wide[tuple(slice(None, None, 2) for _ in array.shape)], array[::-1],
                           np.asfortranarray(array)])
    return None if found.flags.c_contiguous else (TypeError, [label], found)


def misaligned(array, good, label, choose):
    if array.dtype.alignment == 1:
        return None
    data = np.zeros(array.nbytes + 1, np.uint8)[1:]
    return TypeError, [label], data.view(array.dtype).reshape(array.shape)


def read_only(array, good, label, choose):
    if label not in good.written:
        return None
    array.flags.writeable = False
    return TypeError, [label], array


def no_array(array, good, label, choose):
    others = [1.0, 'text', (), array.tolist(), np.float64()]
    return TypeError, [label], choose.choice(others + [None] * (label not in good.optional))


TYPES = ('f4', 'f8', '>f8', 'i4', 'i8', '>i8', 'u8', 'u1', '?', 'c16', 'O', 'U1', 'V5')
SPOILT = [other_type, other_dimensions, other_shape, other_strides, misaligned, read_only,
          no_array]
#: Values that are not numbers of each type.
NUMBERS = {int: [1.5, None, '1', 2 ** 63, (), np.zeros(2)],
           float: [None, '1.0', 1j, (), np.zeros(2)], bool: [1, None, 'yes', np.zeros(2, bool)],
           type(None): [0, (), np.zeros(2)]}


def spoilt(good, label, choose):
    """Return the expected error, the labels that it may name, and a wrong value; None if none."""
    kind, value = good.leaves[label]
    if isinstance(kind, list):
        return choose.choice(SPOILT)(value, good, label, choose)
    options = NUMBERS.get(kind) or [[*value], value[:-1], (*value, None), 1.0]
    return TypeError, [label], choose.choice(options)


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'source'), sources().items(), ids=[*sources()])
def test_an_argument_of_the_wrong_kind_is_named(name, source):
    # One boundary in C checks the arguments for all levels.
    level, choose = _compiled.LEVELS[0], random.Random(name)
    kernel, lanes = _compiled.kernels(level)[name], _compiled.LANES[level]
    hints = get_type_hints(source, include_extras=True)
    del hints['return']
    tried = set()
    for number in range(200):
        good = Good(hints, number, lanes)
        label = choose.choice([*good.leaves])
        if case := spoilt(good, label, choose):
            error, labels, wrong = case
            with pytest.raises(error) as raised:
                kernel(*Good(hints, number, lanes, {label: wrong}).arguments)
            place, = re.findall(rf'^{name}: expected ([\w.]+): .+, found .+', str(raised.value))
            # There are several kinds of terms, and the kernel cannot know which was meant.
            assert place in labels or {place[:10], label[:10]} == {'rows.terms'}
            tried.add(label.split('.')[0])
    assert tried == set(hints)


@pytest.mark.parametrize('level', LEVELS)
def test_another_number_of_arguments_is_refused(level):
    for name, kernel in _compiled.kernels(level).items():
        count = len(get_type_hints(sources()[name])) - 1
        for wrong in {0, count - 1, count + 1, 99} - {count}:
            with pytest.raises(TypeError, match=f'^{name}: expected {count} arguments, found '
                                                f'{wrong}$'):
                kernel(*wrong * [None])
        with pytest.raises(TypeError, match='takes no keyword arguments'):
            kernel(*count * [None], more=None)


def test_a_module_without_a_level_of_this_processor_says_how_to_build_one(monkeypatch):
    monkeypatch.setattr(_compiled, 'LEVELS', ())
    monkeypatch.delenv('RIGID_BODY_ROS_KERNELS', raising=False)
    with pytest.raises(binding.KernelsError, match=(
            '^the kernels of rigid_body_ros are compiled for other processors, .*: in the folder '
            'of its source, run pip install . or colcon build$')):
        binding._loaded()


@pytest.mark.slow
def test_a_command_reports_an_unknown_level_in_one_line(tmp_path):
    result = run('import sys; from rigid_body_ros.commands.main import attitude_replay; '
                 "sys.exit(attitude_replay(['log.csv', '--scene', 'scene.yaml']))", tmp_path,
                 RIGID_BODY_ROS_KERNELS='x86-64-v9', PYTHONPATH=str(PACKAGE.parent))
    assert result.stderr == ('attitude_replay: error: RIGID_BODY_ROS_KERNELS: expected python or '
                             f"{' or '.join(_compiled.LEVELS)}, found 'x86-64-v9'\n")
    assert result.returncode == 2


@pytest.fixture
def copied(tmp_path):
    """Return a copy of the package in a new folder."""
    return shutil.copytree(PACKAGE, tmp_path / 'site' / 'rigid_body_ros',
                           ignore=shutil.ignore_patterns('__pycache__'))


def change(file, before, after):
    text = file.read_text()
    assert text.count(before) == 1
    file.write_text(text.replace(before, after))


@pytest.mark.slow
def test_kernels_that_changed_since_they_were_compiled_are_refused(copied):
    change(copied / 'kernels' / 'elementary.py', '2.0 ** 20', '2.0 ** 19')
    site, script = str(copied.parent), 'import rigid_body_ros.engine.kernels'
    result = run(script, site, PYTHONPATH=site)
    last = result.stderr.splitlines()[-1]
    assert last.endswith(
        'the kernels of rigid_body_ros have changed since they were compiled: in the folder of '
        'its source, run pip install . or colcon build, or set RIGID_BODY_ROS_KERNELS=python')
    assert result.returncode == 1
    result = run(script, site, PYTHONPATH=site, RIGID_BODY_ROS_KERNELS='python')
    assert (result.stderr, result.returncode) == ('', 0)


@pytest.mark.slow
def test_kernels_of_which_comments_changed_are_those_that_were_compiled(copied):
    change(copied / 'kernels' / 'elementary.py', '2.0 ** 20', '2.0 ** 20  # rad')
    site = str(copied.parent)
    script = 'import rigid_body_ros as r; print(r.__file__); print(r.build_info())'
    result = run(script, site, PYTHONPATH=site)
    path, info = result.stdout.splitlines()
    assert path.startswith(site)
    assert info == str(build_info())


@pytest.mark.slow
def test_an_installation_that_is_not_compiled_says_how_it_is(copied):
    for module in (copied / 'engine').glob('_compiled*'):
        module.unlink()
    result = run(SCRIPT, str(copied.parent), PYTHONPATH=str(copied.parent))
    assert ('the kernels of rigid_body_ros are not compiled: in the folder of its source, run '
            'pip install . or colcon build (') in result.stderr.splitlines()[-1]
    assert result.returncode == 1


@pytest.mark.slow
def test_the_first_motion_of_a_user_writes_no_file(tmp_path):
    result = run(SCRIPT, tmp_path, HOME=str(tmp_path), TMPDIR=str(tmp_path),
                 XDG_CACHE_HOME=str(tmp_path), PYTHONPATH=str(PACKAGE.parent))
    assert (result.stderr, result.returncode) == ('', 0)
    assert [*tmp_path.iterdir()] == []


def test_the_warm_up_warns_that_it_goes():
    with pytest.warns(DeprecationWarning, match='rigid_body_ros.warm_up does nothing') as caught:
        warm_up()
    assert caught[0].filename == __file__
