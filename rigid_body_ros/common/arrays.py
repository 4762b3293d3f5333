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

"""Array types, and functions to convert arrays to text and JSON, and to and from tensors."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
#: The row and column of each entry of a symmetric tensor, in the order used by scene files.
ENTRIES = {'xx': (0, 0), 'yy': (1, 1), 'zz': (2, 2), 'xy': (0, 1), 'xz': (0, 2), 'yz': (1, 2)}
ROWS, COLUMNS = zip(*ENTRIES.values())


def written(values: Floats) -> str:
    """
    Format a short array as text such as '(0.5, 1e-06, 2)'.

    Each number is rounded to six significant digits.
    """
    return f"({', '.join(f'{value:.6g}' for value in values)})"


def as_json(values: ArrayLike) -> Any:
    """Convert an array or a number to JSON types; numbers that are not finite become None."""
    return np.where(np.isfinite(values), values, None).tolist()  # type: ignore[call-overload]


def entries(tensor: ArrayLike) -> Floats:
    """Return the six entries of a symmetric tensor, in the order of `ENTRIES`."""
    return np.asarray(tensor, float)[ROWS, COLUMNS]


def symmetric(values: ArrayLike) -> Floats:
    """Build a symmetric tensor from its six entries, in the order of `ENTRIES`."""
    tensor = np.empty((3, 3))
    tensor[ROWS, COLUMNS] = tensor[COLUMNS, ROWS] = values
    return tensor
