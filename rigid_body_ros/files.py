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


def part_of(target: Path) -> Path:
    """Return where something is written until it is whole."""
    name = os.fsdecode(os.fsencode(target.name)[:100])  # names of 255 bytes are the longest
    return target.with_name(f'.{name}.{os.getpid()}.part')


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """
    Yield the place to write what then takes the name of a file, unless something goes wrong.

    Raises
    ------
    InputError
        The file cannot be written; one of that name stays as it was.

    """
    # A device or a pipe takes what is written to it, and a folder refuses.
    is_file = os.path.isfile(path) or not os.path.exists(path)
    # Where a link leads to, so that the link stays one.
    target = Path(os.path.realpath(path) if is_file else path)
    part = part_of(target) if is_file else target
    try:
        yield part
        if is_file:
            os.replace(part, target)
    except OSError as error:
        raise InputError(f'{path}: cannot write: {error.strerror}') from error
    finally:
        if is_file:
            with suppress(OSError):
                part.unlink()
