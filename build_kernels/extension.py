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
import os
from pathlib import Path
import platform
import shlex
import shutil
import subprocess
import sys
from tempfile import TemporaryDirectory

from levels import MACHINES, wanted
from setuptools import Extension
from setuptools.command.build_ext import build_ext
from setuptools.errors import CompileError

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
#: A product and a sum of the boundary's own would be rounded once.
FLAGS = ['-std=c11', '-ffp-contract=off', '-fvisibility=hidden']
#: Keep the sources in C++, to read them.
_KEEP = 'RIGID_BODY_ROS_KEEP'
#: What compiling takes on Debian and Ubuntu.
_TAKES = 'takes GCC 11 or Clang 19 and the headers of Python (apt install g++ python3-dev)'


def kernels() -> Extension:
    """Return the extension module."""
    return Extension('rigid_body_ros.engine._compiled', [os.path.relpath(HERE / 'boundary.c')],
                     depends=[str(HERE / 'boundary.c')],
                     extra_compile_args=FLAGS, libraries=['m'])


def macros() -> list[tuple[str, str]]:
    """Return the hashes of the kernels' sources, as macros of the boundary."""
    return [('FILES', f'"{_sources().files_hash()}"'),
            ('SOURCES', f'"{_sources().sources_hash()}"')]


def compiler(machine: str) -> list[str]:
    """Return the command of the C++ compiler for a kind of machine, and options of the user."""
    command = os.environ.get('CXX', 'g++') if machine == platform.machine() else \
        f'{machine}-linux-gnu-g++'
    if not shutil.which(shlex.split(command)[0]):
        raise CompileError(f'compiling the kernels {_TAKES}, found no {command}')
    return shlex.split(f"{command} {os.environ.get('CXXFLAGS', '')}")


def compiled(machine: str) -> Path:
    """Return the folder with the objects of the kernels; compile them if it does not exist."""
    if machine not in MACHINES:
        raise CompileError(f"expected a processor of {', '.join(MACHINES)}, found {machine}")
    command, levels = compiler(machine), wanted(machine)
    folder = ROOT / 'build' / 'kernels' / _key(command, levels)
    if folder.is_dir():
        return folder
    print(f"Compiling the kernels for {', '.join(levels)}: about a minute, once for each state of "
          'their sources', flush=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder.parent) as partial:
        written = Path(partial, machine)
        written.mkdir()
        if subprocess.run([sys.executable, HERE / 'generate.py', written, *levels, '--',
                           *command]).returncode:
            raise CompileError(f'compiling the kernels {_TAKES}; the error stands above')
        if not os.environ.get(_KEEP):
            for source in written.glob('*.[ch]pp'):
                source.unlink()
        if not folder.is_dir():  # another build may have been faster
            shutil.move(written, folder)
    return folder


class BuildKernels(build_ext):
    """Build the extension module; first compile the kernels."""

    def build_extension(self, ext: Extension) -> None:
        """Build the module against numpy, and link it with the kernels."""
        import numpy
        folder = compiled(platform.machine())
        ext.include_dirs = [numpy.get_include(), str(folder)]
        ext.extra_objects = sorted(map(str, folder.glob('*.o')))
        ext.depends += ext.extra_objects
        ext.define_macros = macros()
        # Through a link, colcon --symlink-install builds outside this folder, and the path of the
        # object begins with build_temp/.., which older setuptools do not create.
        os.makedirs(self.build_temp, exist_ok=True)
        # The times of files do not tell: the code of an earlier state may be used again.
        self.force = True
        try:
            super().build_extension(ext)
        except CompileError as error:
            raise CompileError(f'linking the kernels {_TAKES}: {error}') from None
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


def _key(command: list[str], levels: list[str]) -> str:
    # Return a hash of all that the objects depend on.
    version = subprocess.run([*command, '--version'], capture_output=True, text=True)
    settings = [*command, *levels, version.stdout, os.environ.get(_KEEP, '')]
    digest = hashlib.sha256('\n'.join([_sources().sources_hash(), *settings]).encode())
    for path in sorted(HERE.glob('*.[hp]*')):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
