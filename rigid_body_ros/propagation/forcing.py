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

"""Torques by which a motion changes with the gains, the delay and the lag of its logs."""

from __future__ import annotations

from math import factorial

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import Rows
from rigid_body_ros.propagation.lags import LaggingSources

#: What a torque of a log depends on: a gain for each axis, a delay, and a lag.
GAINS, DELAY, LAG, SIZE = 0, 3, 4, 5


def forcing(rows: Rows, lagging: LaggingSources | None, bias: Floats,
            seeds: Floats) -> tuple[Floats, Floats, Floats]:
    """
    Return the derivatives of the torques in rows, as `tangents.Forcing` takes them.

    Parameters
    ----------
    rows : Rows
        The n rows, with torques on rotors and in space axes, and with lags.
    lagging : LaggingSources or None
        The sources that lag. For all others, a lag acts like a delay.
    bias : array, shape (3,), N m, body axes
        The part of the torque that belongs to no log.
    seeds : array, shape (p, SIZE)
        The gains, the delay and the lag by which the torques are differentiated.

    Returns
    -------
    vectors : array, shape (p, n, v, 3)
    impulses : array, shape (p or 0, n, 2, 3), N m s
    links : array, shape (v, 3)

    """
    assert rows.terms is not None
    assert rows.terms.lags is not None
    torques, constants = _polynomials(rows, bias), rows.terms.lags.time_constants
    excess, impulses = np.moveaxis(rows.terms.lags.excess, 2, 1), np.empty((0, len(torques), 2, 3))
    axes = 1 + int(torques[:, 1].any() or excess[:, 1].any())
    vectors = seeds[:, None, None, GAINS:DELAY] * _joined(axes, torques, excess)
    if seeds[:, DELAY:].any():
        delayed = np.zeros_like(torques)
        delayed[:, :, :-1] = -torques[:, :, 1:]
        moving = slopes = excess
        if lagging:
            moving, slopes = (np.moveaxis(torque, 2, 1) for torque in (
                lagging.moving_excess(rows.times_ns), lagging.slopes(rows.times_ns)))
        vectors += np.multiply.outer(seeds[:, DELAY], _joined(
            axes, delayed, moving / constants[:, None]))
        vectors += np.multiply.outer(seeds[:, LAG], _joined(axes, delayed, slopes, excess))
        impulses = np.multiply.outer(seeds[:, DELAY:].sum(axis=1), _jumps(
            rows, torques, excess, constants))
    return vectors, impulses, _links(axes, torques.shape[2], 1.0 / constants)


def _joined(axes: int, torques: Floats, first: Floats, second: Floats | None = None) -> Floats:
    """Return polynomials and decaying torques as vectors in some axes, shape (n, v, 3)."""
    pairs = np.stack([first, np.zeros_like(first) if second is None else second], axis=3)
    series = np.concatenate([torques, pairs.reshape(*pairs.shape[:2], -1, 3)], axis=2)[:, :axes]
    return series.reshape(len(series), -1, 3)


def _links(axes: int, count: int, rates: Floats) -> Floats:
    links = [(0.0, float(k < count - 1)) for k in range(count)]
    for rate in rates.tolist():
        links += [(-rate, rate * rate), (-rate, 0.0)]
    return np.array([(*link, float(k)) for k in range(axes) for link in links])


def _polynomials(rows: Rows, bias: Floats) -> Floats:
    """Return the torques of the logs and their derivatives by time, shape (n, 2, d + 1, 3)."""
    assert rows.terms is not None
    assert rows.terms.motors is not None
    count = rows.torques.shape[1] // 2 + 1
    result = np.zeros((len(rows.torques), 2, count, 3))
    result[:, 0] = rows.torques[:, :count] + rows.terms.motors
    result[:, 0, 0] -= bias
    result[:, 1] = rows.terms.space
    result[rows.in_space, 1] += rows.torques[rows.in_space, :count]
    result[rows.in_space, 0] = 0.0
    if count > 1:
        orders = np.arange(count)
        result *= ([*map(factorial, orders)] / rows.spans[:, None] ** orders)[:, None, :, None]
    return result


def _jumps(rows: Rows, torques: Floats, excess: Floats, constants: Floats) -> Floats:
    """Return by how much the torque is larger before each row than in it, shape (n, 2, 3)."""
    result, seconds = -torques[:, :, 0] - excess.sum(axis=2), np.diff(rows.times_ns) / 1e9
    factors = np.exp(-seconds[:, None] / constants)
    result[1:] += np.einsum('nalx,nl->nax', excess[:-1], factors)
    for k in range(torques.shape[2]):
        result[1:] += torques[:-1, :, k] * (seconds ** k / factorial(k))[:, None, None]
    return result
