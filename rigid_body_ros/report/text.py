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

"""Wording that the reports of several commands share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from rigid_body_ros.common.errors import printable


def lines(texts: Iterable[str]) -> str:
    """Return texts as one line each; a line break within one, as in a name, is escaped."""
    return '\n'.join(map(printable, texts))


def interpolation_row(interpolation: str, differences: Mapping[str, float | None]) -> str:
    """
    Return a line with the interpolation, and how far the others would move the final attitude.

    Parameters
    ----------
    interpolation : str
        The interpolation in use.
    differences : dict
        By interpolation, the angle between the final attitudes, rad; None if the body spins too
        fast to compute its motion.

    """
    others = [f'{name} would spin the body too fast' if angle is None else
              f'{name} would end {angle:.2g} rad away' for name, angle in differences.items()]
    return f'{interpolation} ({", ".join(others)})' if others else interpolation
