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

from concurrent.futures import ThreadPoolExecutor
import os
import shutil
import subprocess
import sys
from zipfile import ZipFile, ZipInfo

from conftest import PACKAGE
import numpy as np
import pytest
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from rigid_body_ros.kernels import vector

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


@pytest.mark.slow
def test_another_process_gives_the_same_bits():
    attitude, words = run()
    np.testing.assert_array_equal(attitude, here())
    assert words == ''


@pytest.mark.slow
@pytest.mark.parametrize(('before', 'environment'), [
    ("sys.modules['numba'] = None", {}), ('', {'NUMBA_DISABLE_JIT': '1'})],
    ids=['absent', 'disabled'])
def test_without_numba_the_same_bits_come_out(before, environment):
    attitude, _ = run(before, **environment)
    np.testing.assert_array_equal(attitude, here())


@pytest.fixture
def few_kernels(tmp_path):
    """Return a package whose kernels, compiled as ours are, take less time than ours."""
    package = tmp_path / 'few'
    package.mkdir()
    shutil.copy(PACKAGE / 'kernels' / 'jit.py', package)
    (package / 'inner.py').write_text(
        'from few.jit import internal\n@internal\ndef twice(x):\n    return 2.0 * x\n')
    (package / 'outer.py').write_text(
        'from few.jit import njit\nfrom few.inner import twice\n'
        '@njit\ndef four_times(x):\n    return twice(twice(x))\n'
        '@njit\ndef eight_times(x):\n    return twice(four_times(x))\n')
    return package


def eight_times_three(package, **environment):
    without = {name: value for name, value in os.environ.items() if name != 'NUMBA_CACHE_DIR'}
    result = subprocess.run(
        [sys.executable, '-c', 'from few.outer import eight_times; print(eight_times(3.0))'],
        # Python's own cache overlooks a change that keeps the time and the size of a file.
        env={**without, 'PYTHONPATH': str(package.parent), 'PYTHONDONTWRITEBYTECODE': '1',
             **environment}, check=True, capture_output=True, text=True)
    return float(result.stdout), result.stderr


@pytest.mark.slow
def test_a_read_only_install_without_a_home_works_and_warns_once(few_kernels):
    (few_kernels / '__pycache__').touch()  # a file where the folder should be: even root stops
    nowhere = str(few_kernels / '__pycache__' / 'nowhere')
    value, words = eight_times_three(few_kernels, HOME=nowhere, XDG_CACHE_HOME=nowhere)
    assert value == 24.0
    assert words.count('no writable cache folder') == 1


@pytest.mark.slow
@pytest.mark.parametrize('cached', [True, False])
def test_other_threads_run_while_a_kernel_does_cached_or_not(few_kernels, cached):
    if not cached:
        (few_kernels / '__pycache__').touch()
    nowhere = str(few_kernels / '__pycache__' / 'nowhere')
    result = subprocess.run(
        [sys.executable, '-W', 'ignore', '-c', 'from few.outer import four_times as kernel; '
         'print(kernel.targetoptions["nogil"], kernel.stats.cache_path is not None)'],
        env={**os.environ, 'PYTHONPATH': str(few_kernels.parent), 'HOME': nowhere,
             'XDG_CACHE_HOME': nowhere, 'NUMBA_CACHE_DIR': ''}, capture_output=True, text=True,
        check=True)
    assert result.stdout.split() == ['True', str(cached)]


def change(source, time_ns):
    """Change a source as `rsync -a` and tar do, which keep the time of what they copy."""
    source.write_text(source.read_text().replace('2.0', '3.0'))
    os.utime(source, ns=(time_ns, time_ns))


@pytest.mark.slow
def test_a_change_in_one_module_reaches_the_kernels_of_all_whatever_its_time(few_kernels):
    # An internal function is compiled into kernels of other files, whose cache would stay valid.
    source = few_kernels / 'inner.py'
    before_ns = source.stat().st_mtime_ns
    assert eight_times_three(few_kernels) == (24.0, '')
    assert len([*(few_kernels / '__pycache__').glob('outer.*.nbi')]) == 2
    change(source, before_ns)
    assert eight_times_three(few_kernels) == (81.0, '')


@pytest.mark.nightly
def test_a_new_time_alone_does_not_compile_again(few_kernels):
    assert eight_times_three(few_kernels) == (24.0, '')
    written = {path: path.stat().st_mtime_ns for path in few_kernels.rglob('*.nb?')}
    for source in few_kernels.glob('*.py'):
        os.utime(source)
    assert eight_times_three(few_kernels) == (24.0, '')
    assert {path: path.stat().st_mtime_ns for path in few_kernels.rglob('*.nb?')} == written


@pytest.mark.nightly
def test_processes_that_start_at_once_after_a_change_all_run_the_new_code(few_kernels):
    assert eight_times_three(few_kernels) == (24.0, '')
    change(few_kernels / 'inner.py', 0)
    with ThreadPoolExecutor(4) as pool:
        results = [*pool.map(lambda _: eight_times_three(few_kernels), range(4))]
    assert results == 4 * [(81.0, '')]


#: Print the result, how often the kernel was compiled, and what was announced.
ANNOUNCED = """
import sys
from few import jit, outer
with jit.announced(lambda: print('announced', flush=True)):
    value = outer.eight_times(3.0)
print(value, sum(outer.eight_times.stats.cache_misses.values()), 'scipy.linalg' in sys.modules)
"""


def start(package):
    return subprocess.Popen([sys.executable, '-c', ANNOUNCED], stdout=subprocess.PIPE, text=True,
                            env={**os.environ, 'PYTHONPATH': str(package.parent),
                                 'NUMBA_CACHE_DIR': ''})


@pytest.mark.slow
def test_of_processes_that_start_at_once_one_compiles(few_kernels):
    processes = [start(few_kernels) for _ in range(4)]
    results = [process.communicate()[0].splitlines()[-1].split() for process in processes]
    assert [value for value, _, _ in results] == 4 * ['24.0']
    assert sum(int(misses) for _, misses, _ in results) == 1


@pytest.mark.slow
def test_a_process_waits_for_one_that_compiles_and_compiles_itself_if_that_dies(few_kernels):
    cache = few_kernels / '__pycache__'
    cache.mkdir()
    assert start(few_kernels).communicate()[0] == 'announced\n24.0 1 True\n'
    lock, = cache.glob('outer.eight_times*.lock')
    for code in cache.glob('*.nb?'):
        code.unlink()
    holder = subprocess.Popen(
        [sys.executable, '-c', 'import fcntl, sys, time; lock = open(sys.argv[1]); '
         'fcntl.flock(lock, fcntl.LOCK_EX); print(flush=True); time.sleep(600)', lock],
        stdout=subprocess.PIPE, text=True)
    holder.stdout.readline()
    waiting = start(few_kernels)
    assert waiting.stdout.readline() == 'announced\n'
    with pytest.raises(subprocess.TimeoutExpired):
        waiting.wait(1.0)
    holder.kill()
    holder.communicate()
    assert waiting.communicate()[0] == '24.0 1 True\n'


@pytest.mark.slow
def test_code_from_the_cache_is_not_announced_and_loads_no_compiler(few_kernels):
    pytest.importorskip('scipy', reason='numba imports SciPy only for the compiler')
    for expected in ('announced\n24.0 1 True\n', '24.0 0 False\n'):
        assert start(few_kernels).communicate()[0] == expected


@pytest.mark.slow
def test_a_kernel_compiles_after_another_was_loaded(few_kernels):
    script = 'from few import outer; print(outer.four_times(3.0), end=" ")'
    for more in ('', '; print(outer.eight_times(3.0))'):
        result = subprocess.run([sys.executable, '-c', script + more], capture_output=True,
                                env={**os.environ, 'PYTHONPATH': str(few_kernels.parent),
                                     'NUMBA_CACHE_DIR': ''}, text=True, check=True)
    assert result.stdout.split() == ['12.0', '24.0']


@pytest.mark.nightly
def test_a_change_reaches_the_kernels_of_a_package_in_a_zip_file(few_kernels, tmp_path):
    # Python imports from a .zip; what is compiled goes where NUMBA_CACHE_DIR says.
    pytest.importorskip('numba', minversion='0.61', reason='older numba caches no code of a zip')
    (few_kernels / '__init__.py').touch()
    zipped, cache = tmp_path / 'few.zip', str(tmp_path / 'cache')
    for expected in (24.0, 81.0):
        with ZipFile(zipped, 'w') as archive:
            for source in few_kernels.glob('*.py'):
                archive.writestr(ZipInfo(f'few/{source.name}'), source.read_text())
        assert eight_times_three(zipped / 'few', NUMBA_CACHE_DIR=cache) == (expected, '')
        change(few_kernels / 'inner.py', 0)


def test_a_call_of_an_internal_function_does_not_crash_the_interpreter():
    with pytest.raises(TypeError, match='cross is internal to the kernels: it cannot be called'):
        vector.cross((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
