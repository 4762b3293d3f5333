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

"""Files that have their name only once they are whole."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import os
from pathlib import Path

from rigid_body_ros.scene import InputError


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """
    Yield the place to write what then takes the name of a file, unless something goes wrong.

    Raises
    ------
    InputError
        The file cannot be written; one of that name stays as it was.

    """
    # Where a link leads to, so that the link stays one.
    target = Path(os.path.realpath(path))
    part = target.with_name(f'.{target.name[:100]}.{os.getpid()}.part')
    if target.exists() and not target.is_file():
        part = target  # a device or a pipe is what it is, and a folder refuses
    try:
        yield part
        if part != target:
            os.replace(part, target)
    except OSError as error:
        raise InputError(f'{path}: cannot write: {error.strerror}') from error
    finally:
        if part != target:
            with suppress(OSError):
                part.unlink()
