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

"""The step of the build that compiles the kernels into one extension module."""

from __future__ import annotations

from contextlib import suppress
import hashlib
from importlib import util
from importlib.metadata import version
import os
from pathlib import Path
import platform
import shutil
import subprocess
import sys
from tempfile import TemporaryDirectory

from levels import MACHINES
from setuptools import Extension
from setuptools.command.build_ext import build_ext
from setuptools.errors import CompileError

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
#: The generated code that a source archive carries.
CARRIED = HERE / 'generated'
#: A product and a sum of the boundary's own would be rounded once.
FLAGS = ['-std=c11', '-ffp-contract=off', '-fvisibility=hidden']
#: What the generated code depends on, besides the kernels.
_GENERATOR = ('four', 'generate', 'jit', 'lanes', 'levels', 'machine_code', 'modules',
              'signatures')
#: The versions of numba whose internals the build step knows, and what needs them unless the code
#: is there.
_TESTED = (0, 61), (0, 69)
NUMBA = 'numba>={}.{},<{}.{}'.format(*_TESTED[0], *_TESTED[1])


def kernels() -> Extension:
    """Return the extension module."""
    return Extension('rigid_body_ros.engine._compiled', [os.path.relpath(HERE / 'boundary.c')],
                     depends=[str(HERE / 'boundary.c')],
                     extra_compile_args=FLAGS, libraries=['m'])


def macros() -> list[tuple[str, str]]:
    """Return the hashes of the kernels' sources, as macros of the boundary."""
    return [('FILES', f'"{_sources().files_hash()}"'),
            ('SOURCES', f'"{_sources().sources_hash()}"')]


def generated(machine: str) -> Path:
    """Return the folder of the code that is generated for a kind of machine; it may not exist."""
    carried = CARRIED / _key() / machine
    return carried if carried.is_dir() else ROOT / 'build' / 'kernels' / _key() / machine


def generate(machine: str) -> Path:
    """Return the folder with the code for a kind of machine; generate it if it does not exist."""
    folder = generated(machine)
    if folder.is_dir():
        return folder
    if machine not in MACHINES:
        raise CompileError(f"expected a processor of {', '.join(MACHINES)}, found {machine}")
    found = version('numba') if util.find_spec('numba') else 'none'
    if found == 'none' or not _TESTED[0] <= tuple(map(int, found.split('.')[:2])) < _TESTED[1]:
        raise CompileError(f'generating the kernels takes numba, found {found}: '
                           f"pip install '{NUMBA}'")
    print('Generating the kernels: about a minute, once for each state of their sources',
          flush=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder.parent) as partial:
        written = Path(partial, machine)
        written.mkdir()
        if subprocess.run([sys.executable, HERE / 'generate.py', written,
                           *MACHINES[machine]]).returncode:
            raise CompileError('the kernels could not be generated; the error stands above')
        if not folder.is_dir():  # another build may have been faster
            shutil.move(written, folder)
    return folder


class BuildKernels(build_ext):
    """Build the extension module; first generate its machine code."""

    def build_extension(self, ext: Extension) -> None:
        """Build the module against numpy, and link it with the generated code."""
        import numpy
        folder = generate(platform.machine())
        ext.include_dirs = [numpy.get_include(), str(folder)]
        ext.extra_objects = sorted(map(str, folder.glob('*.o')))
        ext.depends += ext.extra_objects
        ext.define_macros = macros()
        # The times of files do not tell: the code of an earlier state may be used again.
        self.force = True
        try:
            super().build_extension(ext)
        except CompileError as error:
            raise CompileError(f'linking the kernels takes a C compiler and the headers of '
                               f'Python (apt install gcc python3-dev): {error}') from None
        # Tests run in the source folder, after `colcon build`, too.
        built, beside = Path(self.get_ext_fullpath(ext.name)), ROOT / 'rigid_body_ros' / 'engine'
        with suppress(OSError), TemporaryDirectory(dir=beside) as folder:
            # In one step: a process may run the code of the file that is replaced.
            os.replace(shutil.copy2(built, folder), beside / built.name)


def _sources():
    # Import one file of the package, which as a whole imports the module that is built here.
    spec = util.spec_from_file_location('sources', ROOT / 'rigid_body_ros/kernels/sources.py')
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _key() -> str:
    # Return a hash of all that the generated code depends on.
    digest = hashlib.sha256(_sources().sources_hash().encode())
    for name in _GENERATOR:
        digest.update((HERE / f'{name}.py').read_bytes())
    return digest.hexdigest()[:16]
