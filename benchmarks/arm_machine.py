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
A 64-bit ARM machine in a folder, for `arm.py`.

Python and its libraries come from Debian's arm64 packages, which are unpacked into the folder with
separate lists and cache of apt. The packages of the system do not change, and root is not needed.
numpy and the other dependencies come as wheels, in the versions that are installed here. QEMU runs
the programs.
"""

import hashlib
from importlib.metadata import version
import os
from pathlib import Path
import shutil
import subprocess
import sys

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / 'build_kernels'))
import extension  # noqa: E402

FOLDER = ROOT / '.arm'
SYSTEM, WHEELS = FOLDER / 'system', FOLDER / 'wheels'
PYTHON = f'python{sys.version_info.major}.{sys.version_info.minor}'
QEMU, COMPILER = 'qemu-aarch64-static', 'aarch64-linux-gnu-g++'
#: Required commands, and the Debian package of each.
COMMANDS = {QEMU: 'qemu-user-static', COMPILER: 'g++-aarch64-linux-gnu', 'apt-get': 'apt',
            'dpkg-deb': 'dpkg'}
#: The entries of `install_requires` except matplotlib and SciPy, which `arm.py` does not need.
REQUIRED = ('PyYAML', 'lz4', 'mcap', 'numpy', 'tqdm', 'zstandard')
#: Platforms of wheels up to glibc 2.36, the C library of Debian 12.
PLATFORMS = ('manylinux2014_aarch64', *(f'manylinux_2_{minor}_aarch64' for minor in range(17, 37)))


class UnavailableError(Exception):
    """The machine cannot be built. The text says what is missing and how to get it."""


def install() -> None:
    """
    Create the folder unless it already contains the same versions.

    Raises
    ------
    UnavailableError
        A command is missing, or a download failed.

    """
    absent = {name: package for name, package in COMMANDS.items() if not shutil.which(name)}
    if absent:
        raise UnavailableError(
            f'expected the commands {", ".join(COMMANDS)}, did not find {", ".join(absent)}; '
            f'on Debian: apt-get install {" ".join(absent.values())}')
    pins = [f'{name}=={version(name)}' for name in REQUIRED]
    for folder, content, install_into in ((SYSTEM, [PYTHON, f'lib{PYTHON}-dev', 'libstdc++6'],
                                           _install_system),
                                          (WHEELS, pins, _install_wheels)):
        try:
            _once(folder, content, install_into)
        except subprocess.CalledProcessError as error:
            raise UnavailableError(
                f'expected to install {", ".join(content)} for arm64, but {error.cmd[0]} ended '
                f'with status {error.returncode}; its message is above') from error
    _link_kernels()


def run(*arguments: object) -> None:
    """
    Run Python on the ARM machine, with a program of the checkout and its arguments.

    Raises
    ------
    subprocess.CalledProcessError
        The exit status is not 0.

    """
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join([str(ROOT), str(WHEELS)])}
    subprocess.run([QEMU, '-L', SYSTEM, SYSTEM / 'usr' / 'bin' / PYTHON, *arguments],
                   env=environment, check=True)


def _link_kernels() -> None:
    # Link the kernels for ARM, beside those for this machine.
    folder = extension.compiled('aarch64')
    suffix = f'cpython-{sys.version_info.major}{sys.version_info.minor}-aarch64-linux-gnu.so'
    subprocess.run([
        'aarch64-linux-gnu-gcc', '-shared', '-fPIC', '-O2', *extension.FLAGS,
        *(f'-D{name}={value}' for name, value in extension.macros()),
        '-I', SYSTEM / 'usr/include' / PYTHON, '-I', WHEELS / 'numpy/_core/include', '-I', folder,
        '-idirafter', SYSTEM / 'usr/include', extension.HERE / 'boundary.c', *folder.glob('*.o'),
        '-lm', '-o', ROOT / 'rigid_body_ros/engine' / f'_compiled.{suffix}'], check=True)


def _once(folder: Path, content: list[str], install_into) -> None:
    # A file beside the folder marks what was installed completely.
    done = folder.with_suffix('.' + hashlib.sha256(' '.join(content).encode()).hexdigest()[:16])
    if done.exists():
        return
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    print(f'Installing {" ".join(content)} for arm64 into {os.path.relpath(folder)}', flush=True)
    install_into(folder, content)
    done.touch()


def _install_system(folder: Path, packages: list[str]) -> None:
    apt = FOLDER / 'apt'
    for name in ('state/lists/partial', 'cache/archives/partial'):
        (apt / name).mkdir(parents=True, exist_ok=True)
    (apt / 'status').touch()  # empty, so apt downloads all dependencies
    command = ['apt-get', '--quiet=2', '-o', f'Dir::State={apt / "state"}',
               '-o', f'Dir::State::status={apt / "status"}', '-o', f'Dir::Cache={apt / "cache"}',
               '-o', 'APT::Architecture=arm64', '-o', 'APT::Architectures=arm64']
    subprocess.run([*command, 'update'], check=True)
    subprocess.run([*command, 'install', '--download-only', '--yes', '--no-install-recommends',
                    *packages], check=True, stdout=subprocess.DEVNULL)
    for package in sorted((apt / 'cache' / 'archives').glob('*.deb')):
        subprocess.run(['dpkg-deb', '--extract', package, folder], check=True)


def _install_wheels(folder: Path, pins: list[str]) -> None:
    platforms = [word for platform in PLATFORMS for word in ('--platform', platform)]
    subprocess.run([sys.executable, '-m', 'pip', 'install', '--quiet', '--no-deps',
                    '--disable-pip-version-check', '--only-binary=:all:', '--implementation', 'cp',
                    *platforms, '--python-version', PYTHON.removeprefix('python'),
                    '--target', folder, *pins], check=True)
