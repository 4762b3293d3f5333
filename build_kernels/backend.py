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
The build of setuptools, which takes numba only to generate the kernels.

What a checkout has generated before, or a source archive carries, is linked without numba.
"""

import platform

from extension import generated, NUMBA
from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F401, F403


def get_requires_for_build_wheel(config_settings=None):
    """Return what building a wheel takes."""
    return build_meta.get_requires_for_build_wheel(config_settings) + _missing()


def get_requires_for_build_editable(config_settings=None):
    """Return what an editable installation takes."""
    return build_meta.get_requires_for_build_editable(config_settings) + _missing()


def _missing():
    return [] if generated(platform.machine()).is_dir() else [NUMBA]
