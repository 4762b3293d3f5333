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

"""Identify the software versions on which the last bits of a motion depend."""

from __future__ import annotations

from collections.abc import Mapping
import hashlib
from importlib.metadata import PackageNotFoundError, version
import json
from pathlib import Path

from rigid_body_ros.common.errors import shortened
from rigid_body_ros.engine.binding import kernels_hash, LEVEL

NAME = 'rigid_body_ros'


def fingerprint() -> dict[str, str]:
    """
    Return the versions of the relevant packages, by package name, and the hash of the kernels.

    If the versions and the hash are equal, the same inputs give motions that are equal to the last
    bit, whatever the processor and the compiler.
    """
    return {**{package: _version(package) for package in (NAME, 'numpy')},
            'kernels': kernels_hash()[:12]}


def other_versions(made_by: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """
    Return the packages whose versions differ from those that made a recording.

    `made_by` is the metadata of the recording. Each value of the result is a pair: the version
    that made the recording, and the version in use now.
    """
    here = fingerprint()
    try:
        there = json.loads(made_by.get('fingerprint', '{}'))
    except (ValueError, RecursionError):
        there = None
    if not isinstance(there, dict):
        return {name: ('unknown', version) for name, version in here.items()}
    return {name: (shortened(str(there[name]), 100), version) for name, version in here.items()
            if name in there and there[name] != version}


def build_info() -> dict[str, str]:
    """
    Return the version of the package, and the hash and level of its kernels.

    The level is the processor level for which the kernels were compiled, such as x86-64-v3, or
    `python` if they run without being compiled.
    """
    return {'version': _version(NAME), 'kernels': kernels_hash()[:12], 'level': LEVEL}


def package_hash() -> str:
    """Return a hash of the source files of the package."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).resolve().parents[1].rglob('*.py')):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # the package runs from its source folder
        return 'none'
