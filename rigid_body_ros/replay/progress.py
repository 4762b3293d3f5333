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

"""Show the progress of an iteration."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
import sys
from typing import Any

from rigid_body_ros.recording import Track
from rigid_body_ros.runtime import interrupts
from tqdm import tqdm


def progress(label: str, unit: str = ' stamps',
             size: Callable[[Any], int] = lambda item: 1) -> Track:
    """Return a function that shows the progress of an iteration, if stderr is a terminal."""
    def track(items: Iterable[Any], total: int) -> Iterator[Any]:
        # disable=None: no bar if standard error is not a terminal.
        with tqdm(None, label, total, unit=unit, unit_scale=True, leave=False,
                  disable=True if sys.stderr is None else None) as shown:
            for item in items:
                yield item
                shown.update(size(item))
                interrupts.check()
    return track
