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
Write a source archive that carries the generated code of the kernels for all kinds of machines.

An installation from it takes a C compiler, but neither numba nor a minute. The archive is
dist/rigid_body_ros-VERSION.tar.gz and has what is committed.
"""

from __future__ import annotations

import io
from pathlib import Path
import subprocess
import sys
import tarfile
import xml.etree.ElementTree as ElementTree

from extension import CARRIED, generate, ROOT
from levels import MACHINES


def main() -> None:
    """Write the archive; exit with a message if files differ from what is committed."""
    if subprocess.run(['git', 'diff', '--quiet', 'HEAD'], cwd=ROOT).returncode:
        sys.exit('release: expected no changes since the last commit: git status lists them')
    folders = [generate(machine) for machine in MACHINES]
    version = ElementTree.parse(ROOT / 'package.xml').findtext('version')
    name = f'rigid_body_ros-{version}'
    committed = subprocess.run(['git', 'archive', f'--prefix={name}/', 'HEAD'], cwd=ROOT,
                               check=True, capture_output=True).stdout
    path = ROOT / 'dist' / f'{name}.tar.gz'
    path.parent.mkdir(exist_ok=True)
    with tarfile.open(path, 'w:gz') as archive, tarfile.open(fileobj=io.BytesIO(committed)) as old:
        for member in old:
            archive.addfile(member, old.extractfile(member) if member.isfile() else None)
        for folder in folders:
            archive.add(folder, Path(name, CARRIED.relative_to(ROOT), *folder.parts[-2:]))
    print(path)


if __name__ == '__main__':
    main()
