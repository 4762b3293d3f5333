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
When a function of a motion crosses a level, and how large it becomes.

The span between two changes of the torque is divided into pieces. In each piece, a polynomial
interpolates the function, and its last coefficients bound the error. The coefficients then show
which pieces can contain a crossing or the maximum. These pieces are divided again, until their
polynomials are exact to rounding and have at most one extremum each. The signs at this extremum
and at the ends of the piece then show every crossing. The values at the ends are those of the
function, not those of the polynomials, so no crossing is lost between two pieces.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebval, chebvander
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats, Ints

#: Takes a `Trajectory`, and returns a number for each of its times.
Function = Callable[[Any], ArrayLike]
#: Begins to compute a motion, and returns the `Integration` that does so.
Restart = Callable[[], Any]

#: The degree of the polynomials. Their nodes are the extrema of a Chebyshev polynomial, computed
#: from square roots, which have the same bits on every machine.
_DEGREE = 8
_COSINES = np.sqrt([0.5 + 0.25 * math.sqrt(2.0), 0.5, 0.5 - 0.25 * math.sqrt(2.0)])
_NODES = np.array([-1.0, *-_COSINES, 0.0, *_COSINES[::-1], 1.0])
_HALVES = np.array([0.5, *[1.0] * (_DEGREE - 1), 0.5])
#: Row j contains the Chebyshev coefficients of the polynomial that is 1 at node j and 0 at the
#: other nodes.
_FIT = 2.0 / _DEGREE * _HALVES[:, None] * _HALVES * chebvander(_NODES, _DEGREE)
#: What counts as zero, relative to the largest magnitude of the function.
_ROUNDING = 2.0 ** -46
#: The largest angle by which the body turns in a piece, rad, and the number of parts into which a
#: piece is divided that must be smaller for another reason.
_ANGLE, _PARTS = 1.0, 4
#: Limits for the number of pieces, for the number of parts of one, and for those sampled at once.
_MOST, _MOST_PARTS, _BLOCK = 2 ** 21, 2 ** 10, 2 ** 14
#: How often the polynomials are corrected because their nodes are rounded to nanoseconds, and the
#: most steps of the search for a root.
_CORRECTIONS, _STEPS = 3, 100


class Crossings(NamedTuple):
    """
    The times at which a function of a motion crosses a level, in ascending order.

    Attributes
    ----------
    times_ns : array of int64, shape (k,), ns
        The times, rounded down.
    fractions : array, shape (k,), ns
        The parts of a nanosecond to add to `times_ns`, from 0 to 1.
    directions : array of int64, shape (k,)
        1 where the function rises through the level, -1 where it falls through the level, and 0
        where it touches the level.

    """

    times_ns: Ints
    fractions: Floats
    directions: Ints


class _Pieces(NamedTuple):
    """Pieces of a motion. The last axis of each array is that of the pieces."""

    begins_ns: NDArray[Any]
    ends_ns: NDArray[Any]
    #: The values of the function at the nodes, and the coefficients of the polynomial.
    values: NDArray[Any]
    terms: NDArray[Any]

    def select(self, rows: NDArray[Any]) -> _Pieces:
        """Return some of the pieces."""
        return _Pieces(*(part[..., rows] for part in self))


def crossings(restart: Restart, function: Function, breaks_ns: Ints, level: float,
              period: float) -> Crossings:
    """
    Return where a function of a motion crosses a level.

    Parameters
    ----------
    restart, function
        The motion and the function.
    breaks_ns : array of int64, ns
        The begin, the end, and the times between them at which the motion is not smooth.
    level, period : float
        See `Trajectory.crossings`.

    """
    if not math.isfinite(level):
        raise ValueError(f'level: expected a finite number, found {level!r}')
    if not period > 0.0:
        raise ValueError(f'period: expected a number above 0, found {period!r}')

    def relative(motion: Any) -> Floats:
        values = np.asarray(function(motion), float) - level
        return values - period * np.rint(values / period) if period < math.inf else values

    pieces, tiny = _divided(restart, relative, breaks_ns, abs(level),
                            lambda middle, slack, _: np.abs(middle) <= slack)
    places, values = _extrema(pieces)
    signs = np.where(np.abs(values) <= tiny, 0.0, np.sign(values))
    marks, found = np.flatnonzero(signs), list[tuple[float, ...]]()
    for first, last in zip(marks.tolist(), marks[1:].tolist()):
        if signs[first] != signs[last]:
            k = first + int((signs[first] * values[first + 1:last + 1] <= 0.0).argmax())
            if abs(values[k + 1] - values[k]) <= 0.5 * period:
                found.append((k // 3, places[k], places[k + 1], signs[last]))
        elif last > first + 1:
            k = first + 1 + int(np.abs(values[first + 1:last]).argmin())
            found.append((k // 3, places[k], places[k], 0.0))
    rows, low, high, directions = np.array(found).reshape(-1, 4).T
    pieces = pieces.select(rows.astype(np.int64))
    offsets = 0.5 * (pieces.ends_ns - pieces.begins_ns) * (1.0 + _roots(pieces.terms, low, high))
    return Crossings(pieces.begins_ns + offsets.astype(np.int64), offsets % 1.0,
                     directions.astype(np.int64))


def maximum(restart: Restart, function: Function, breaks_ns: Ints) -> float:
    """Return the largest value of a function of a motion; see `crossings`."""
    pieces, _ = _divided(restart, function, breaks_ns, 0.0,
                         lambda middle, slack, best: middle + slack >= best)
    return float(_extrema(pieces)[1].max())


def _divided(restart: Restart, function: Function, breaks_ns: Ints, size: float,
             matters: Callable[[Floats, Floats, float], NDArray[np.bool_]]
             ) -> tuple[_Pieces, float]:
    """
    Return the pieces that matter, resolved, and what counts as zero.

    The function `matters` takes bounds on the functions in some pieces, as a middle and a
    half-width, and the largest value so far.
    """
    begins, ends, best = breaks_ns[:-1], breaks_ns[1:], -math.inf
    nothing = np.empty((_DEGREE + 1, 0))
    done = [_Pieces(begins[:0], ends[:0], nothing, nothing)]
    while begins.size:
        if begins.size > _MOST + breaks_ns.size:
            raise ValueError('function: expected one that is smooth, found one that is not at '
                             f'{begins[0]} ns')
        computation, left = restart(), [(begins[:0], ends[:0])]
        for first in range(0, begins.size, _BLOCK):
            block = slice(first, first + _BLOCK)
            pieces, turned = _sampled(computation, function, begins[block], ends[block])
            size = max(size, float(np.abs(pieces.values).max()))
            best = max(best, float(pieces.values.max()))
            sizes, tiny = np.abs(pieces.terms), _ROUNDING * size
            change, error = sizes[1:].sum(axis=0), _DEGREE * sizes[-2:].sum(axis=0)
            slopes = chebder(pieces.terms)
            resolved = (change <= tiny) | (error <= tiny) & (
                _keeps_sign(slopes) | _keeps_sign(chebder(slopes)))
            near = matters(pieces.terms[0], change + error + tiny, best)
            parts = np.where(resolved | ~near, 1.0, _PARTS)
            parts = np.where(turned > _ANGLE, np.minimum(np.ceil(turned), _MOST_PARTS), parts)
            parts = np.minimum(parts, pieces.ends_ns - pieces.begins_ns).astype(np.int64)
            done.append(pieces.select(near & (parts == 1)))
            left.append(_split(pieces.select(parts > 1), parts[parts > 1]))
        begins, ends = map(np.concatenate, zip(*left))
    pieces = _Pieces(*(np.concatenate(parts, axis=-1) for parts in zip(*done)))  # in any order
    return pieces.select(np.argsort(pieces.begins_ns)), _ROUNDING * size


def _sampled(computation: Any, function: Function, begins_ns: Ints,
             ends_ns: Ints) -> tuple[_Pieces, Floats]:
    """Return pieces with their polynomials, and the angles by which the body turns in them."""
    spans = ends_ns - begins_ns
    times_ns = begins_ns + np.rint(0.5 * spans * (1.0 + _NODES[:, None])).astype(np.int64)
    times_ns[-1] = ends_ns
    motion = computation.advance(times_ns.T.ravel())
    values = np.asarray(function(motion), float)
    if values.shape != motion.times_ns.shape:
        raise ValueError('function: expected a finite number for each time, found shape '
                         f'{values.shape} for {times_ns.size} times')
    if not (finite := np.isfinite(values)).all():
        row = int(finite.argmin())
        raise ValueError('function: expected a finite number for each time, found '
                         f'{values[row]} at {motion.times_ns[row]} ns')
    speeds = np.linalg.norm(motion.angular_velocity, axis=1)
    values, speeds = (row.reshape(-1, _DEGREE + 1).T for row in (values, speeds))
    places = 2.0 * (times_ns - begins_ns) / spans - 1.0
    terms, short = _fitted(values), spans == 1
    for _ in range(_CORRECTIONS):
        terms += _fitted(values - chebval(places, terms, tensor=False))
    terms[:, short] = 0.0
    terms[:2, short] = 0.5 * np.stack([values[-1] + values[0], values[-1] - values[0]])[:, short]
    return _Pieces(begins_ns, ends_ns, values, terms), 1e-9 * spans * speeds.max(axis=0)


def _fitted(values: Floats) -> NDArray[Any]:
    """Return the Chebyshev coefficients of the polynomials with the given values at the nodes."""
    # A matrix product would add in an order that depends on the processor.
    return np.asarray(sum(row[:, None] * value for row, value in zip(_FIT, values)))


def _keeps_sign(terms: NDArray[Any]) -> NDArray[np.bool_]:
    """Return whether the coefficients of polynomials show that they have no root."""
    return np.asarray(np.abs(terms[0]) > np.abs(terms[1:]).sum(axis=0))


def _split(pieces: _Pieces, parts: Ints) -> tuple[Ints, Ints]:
    """Return the begins and the ends of the parts into which pieces are divided."""
    rows, stops = np.repeat(np.arange(parts.size), parts), np.cumsum(parts)
    part = np.arange(rows.size) - (stops - parts)[rows]
    whole, rest = np.divmod(pieces.ends_ns - pieces.begins_ns, parts)
    begins_ns = pieces.begins_ns[rows] + whole[rows] * part + rest[rows] * part // parts[rows]
    ends_ns = np.roll(begins_ns, -1)
    ends_ns[stops - 1] = pieces.ends_ns
    return begins_ns, ends_ns


def _extrema(pieces: _Pieces) -> tuple[Floats, Floats]:
    """
    Return three places in each piece, from -1 to 1, and the values there, piece by piece.

    The places are the begin, the extremum, if there is one, and the end.
    """
    slopes, middle = chebder(pieces.terms), np.ones(pieces.begins_ns.size)
    turns = chebval(-1.0, slopes) * chebval(1.0, slopes) < 0.0
    middle[turns] = _roots(slopes[:, turns], -middle[turns], middle[turns])
    first, last = pieces.values[0], pieces.values[-1]
    extremum = np.where(turns, chebval(middle, pieces.terms, tensor=False), last)
    return (np.stack([-np.ones(middle.size), middle, np.ones(middle.size)], axis=1).ravel(),
            np.stack([first, extremum, last], axis=1).ravel())


def _roots(terms: NDArray[Any], low: Floats, high: Floats) -> Floats:
    """Return the root of each polynomial between two places, where its sign changes."""
    slopes, places = chebder(terms), 0.5 * (low + high)
    rises = chebval(high, terms, tensor=False) > chebval(low, terms, tensor=False)
    for _ in range(_STEPS):
        values = chebval(places, terms, tensor=False)
        beyond = (values > 0.0) == rises
        low, high = np.where(beyond, low, places), np.where(beyond, places, high)
        with np.errstate(divide='ignore', invalid='ignore'):
            step = places - values / chebval(places, slopes, tensor=False)
        before, places = places, np.where((low < step) & (step < high), step, 0.5 * (low + high))
        if (np.abs(places - before) <= 2.0 ** -48).all():
            break
    return places
