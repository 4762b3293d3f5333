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

"""Installation; the name, the version and who to ask are in package.xml."""

from glob import glob
from pathlib import Path
import sys
import xml.etree.ElementTree as ElementTree

from setuptools import find_packages, setup

HERE = Path(__file__).resolve().parent  # colcon --symlink-install runs this through a link
PACKAGE = ElementTree.parse(HERE / 'package.xml').getroot()
sys.path.insert(0, str(HERE / 'build_kernels'))
from distutils.command.install_data import install_data  # noqa: E402, I100, from setuptools

from extension import BuildKernels, kernels  # noqa: E402, I100

NAME = PACKAGE.findtext('name')
ROS_PACKAGES = ('rclpy', 'rmw-fastrtps-cpp', 'geometry-msgs', 'sensor-msgs', 'nav-msgs',
                'std-msgs', 'std-srvs', 'diagnostic-msgs', 'rcl-interfaces', 'rosgraph-msgs')
COMMANDS = ('attitude_compare', 'attitude_controller', 'attitude_design', 'attitude_ensemble',
            'attitude_identify', 'attitude_lifecycle_node', 'attitude_monitor', 'attitude_node',
            'attitude_regress', 'attitude_replay', 'attitude_tradeoff')
SCRIPT = """#!/usr/bin/env python3
import sys

from {package}.commands.main import {command}

if __name__ == '__main__':  # not in worker processes, which import this file
    sys.exit({command}())
"""


class InstallData(install_data):
    """Install the commands where `ros2 run` looks, too; pip puts entry points into bin only."""

    def run(self):
        """Copy the data files, and write a script for each command."""
        super().run()
        folder = Path(self.install_dir, 'lib', NAME)
        folder.mkdir(parents=True, exist_ok=True)
        for command in COMMANDS:
            script = folder / command
            script.write_text(SCRIPT.format(package=NAME, command=command), encoding='utf-8')
            script.chmod(0o755)
            self.outfiles.append(str(script))


setup(
    name=NAME,
    version=PACKAGE.findtext('version'),
    description=PACKAGE.findtext('description'),
    long_description=(HERE / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    maintainer=PACKAGE.findtext('maintainer'),
    maintainer_email=PACKAGE.find('maintainer').get('email'),
    license=PACKAGE.findtext('license'),
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed', 'engine/*.pyi', 'report/web/*']},
    ext_modules=[kernels()],
    cmdclass={'build_ext': BuildKernels, 'install_data': InstallData},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', sorted(glob('config/*.*'))),
        (f'share/{NAME}/config/security', sorted(glob('config/security/*'))),
        (f'share/{NAME}/launch', sorted(glob('launch/*.launch.py'))),
    ],
    entry_points={'console_scripts': [f'{name} = {NAME}.commands.main:{name}'
                                      for name in COMMANDS]},
    python_requires='>=3.10',
    # The oldest versions that pass the tests, see test/lowest.txt.
    install_requires=['PyYAML>=5.4', 'lz4>=3.1', 'matplotlib>=3.5', 'mcap>=1.1',
                      'numpy>=1.21', 'scipy>=1.8', 'tqdm>=4.57', 'zstandard>=0.15'],
    extras_require={
        # ROS 2 with Fast DDS, as wheels: Kilted, or Jazzy in an environment of its own.
        'ros': [f'ros-{package}' for package in ROS_PACKAGES],
        'jazzy': [f'ros-jazzy-{package}' for package in ROS_PACKAGES],
        'ensemble': ['dask>=2022.12', 'distributed>=2022.12', 'pyarrow>=13',
                     'zarr>=3.1.3; python_version >= "3.11"'],
        'px4': ['pyulog>=1.0'],
        'jax': ['jax>=0.4.35'],
        'torch': ['torch'],
        'test': ['colcon-bash', 'colcon-core', 'colcon-recursive-crawl', 'colcon-ros',
                 'colcon-test-result', 'dask', 'distributed', 'hypothesis', 'import-linter',
                 'mcap-ros2-support', 'mpmath', 'mypy', 'playwright', 'psutil', 'pyarrow',
                 'pytest', 'pytest-xdist', 'pyulog', 'rosbags', 'ruff', 'setuptools>=70',
                 'types-PyYAML', 'types-tqdm', 'xarray', 'zarr>=3.1.3; python_version >= "3.11"',
                 # The linters of ROS that PyPI has, and what they run.
                 'ros-ament-flake8', 'ros-ament-pep257', 'flake8', 'flake8-blind-except',
                 'flake8-builtins', 'flake8-class-newline', 'flake8-comprehensions',
                 'flake8-deprecated', 'flake8-docstrings', 'flake8-import-order', 'flake8-quotes',
                 'pydocstyle'],
        'docs': ['latex2mathml', 'myst-parser', 'sphinx', 'sphinx-rtd-theme'],
        'bench': ['bsk', 'cyrk', 'drake', 'heyoka', 'mpmath', 'mujoco', 'psutil'],
    },
    zip_safe=False,
)
