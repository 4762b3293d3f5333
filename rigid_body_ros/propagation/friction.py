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

"""Convert wheels with friction to the form that the kernels need."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import Friction, FrictionTerms, Lags, Rows
from rigid_body_ros.mechanics.wheels import Wheels
from rigid_body_ros.propagation.lags import lag_terms


def friction_of(wheels: Wheels, efforts: Floats) -> Friction:
    """
    Pack wheels with friction into a record that has room for one output.

    `efforts`, N m, has one row for each row of the record and one column for each wheel.
    """
    padded = wheels.padded(efforts)
    return Friction(padded, wheels.constants, np.empty((1, padded.shape[1])))


def with_momenta(rows: Rows, count: int) -> tuple[Rows, Floats]:
    """Add to rows an array for the wheel momenta at `count` outputs; return rows and array."""
    terms = rows.terms
    assert terms
    assert terms.friction
    momenta = np.empty((count, terms.friction.efforts.shape[1]))
    friction = terms.friction._replace(momenta=momenta)
    return rows._replace(terms=terms._replace(friction=friction)), momenta


def friction_key(friction: Friction, row: int = 0) -> Floats:
    """Return an array of all numbers that determine the friction in a row, for use as a key."""
    return np.concatenate([friction.efforts[row], friction.wheels])


def friction_terms(momentum: Floats, motors: Floats, space: Floats, fields: NDArray[Any] | None,
                   lags: Lags | None, friction: Friction) -> FrictionTerms:
    """Return the terms for rows with friction, including fields and lags if there are any."""
    lags = lags or Lags(np.zeros((len(friction.efforts), 0, 2, 3)), np.empty(0))
    return FrictionTerms(*lag_terms(momentum, motors, space, fields, lags)[:5], friction)
