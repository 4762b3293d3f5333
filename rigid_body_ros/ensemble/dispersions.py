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

"""Read the distributions of the parameters that vary, and draw values from them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
import zlib

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, located, quoted
from rigid_body_ros.runtime.limits import read_yaml
from rigid_body_ros.runtime.parameters import BIG, described, entries, number, resembled
from rigid_body_ros.scene import PARAMETERS
from rigid_body_ros.scene.fields import of_names, ORBIT
from rigid_body_ros.scene.quantities import along, quantity_of
import yaml


def units_of(*groups: str) -> dict[str, str]:
    """Return the units of all scene parameters in some groups, by name."""
    return {name: parameter.unit for name, parameter in PARAMETERS.items()
            if name.split('.')[0] in groups}


#: The keys that can have a normal or a uniform distribution, and their units. The keys of fields
#: are not included.
UNITS = {**units_of('inertia', 'damping', 'initial_angular_velocity', 'initial_rotor_momentum',
                    ORBIT),
         **{name: quantity_of(name).unit
            for name in ('torque_gain', *along('torque_bias'), 'clock_offset')}}
#: Keys for which each run draws three numbers. For `NOISE`, a run draws three numbers for each
#: torque sample.
INERTIA, ATTITUDE, NOISE = 'inertia', 'initial_attitude', 'torque_noise'
_EXAMPLE = 'torque_gain: {normal: 0.03}'
#: For each key that accepts only one kind of distribution, this kind.
_SPECIAL = {INERTIA: 'relative', ATTITUDE: 'tilt', NOISE: 'normal'}
#: Philox produces this many random numbers for each value of its counter.
_AT_ONCE = 4


@dataclass(frozen=True)
class Dispersion:
    """
    The distribution of a parameter.

    Attributes
    ----------
    key : str
        The parameter: a key of `units_with`, 'inertia', 'initial_attitude' or 'torque_noise'.
    kind : str
        The kind of distribution: 'normal', 'uniform', 'relative' for principal moments of inertia,
        or 'tilt' for a rotation vector.
    bounds : tuple of float
        For a uniform distribution, the lowest and the highest number. For all other kinds, only
        the standard deviation.
    relative : bool
        Whether the numbers are relative. The nominal value is then multiplied by one plus the
        drawn number.

    """

    key: str
    kind: str
    bounds: tuple[float, ...]
    relative: bool = False

    def draw(self, seed: int, runs: NDArray[np.int64]) -> Floats:
        """
        Draw the numbers for the given runs.

        Returns
        -------
        array, shape (n, 3) for 'relative' and 'tilt', otherwise (n, 1)
            The values of the parameter if the kind is 'uniform' and `relative` is False. In all
            other cases, deviations from the nominal value.

        """
        if self.kind == 'uniform':
            low, high = self.bounds
            return low + (high - low) * uniforms(seed, runs, self.key, 1)
        return self.bounds[0] * normals(seed, runs, self.key, len(self.moments))

    @property
    def moments(self) -> Floats:
        """Return the mean and the standard deviation of each number in a row of `draw`."""
        count = 3 if self.kind in ('relative', 'tilt') else 1
        moments = (0.0, *self.bounds) if self.kind != 'uniform' else (
            0.5 * sum(self.bounds), (self.bounds[1] - self.bounds[0]) / math.sqrt(12.0))
        return np.tile(moments, (count, 1))


def draws(dispersions: Sequence[Dispersion], seed: int,
          runs: NDArray[np.int64]) -> dict[str, Floats]:
    """
    Draw the numbers of all keys for the given runs.

    The numbers of a key depend only on the seed, the key and the run number. They stay the same
    when other keys are added or removed. Torque noise is not included, because `Torques` draws the
    noise for each torque sample.
    """
    return {one.key: one.draw(seed, runs) for one in dispersions if one.key != NOISE}


def dispersed(dispersions: Sequence[Dispersion], nominal: Mapping[str, float], seed: int,
              runs: NDArray[np.int64], drawn: Mapping[str, Floats] | None = None
              ) -> dict[str, Floats]:
    """
    Return the values of each key in the given runs, shape (n,).

    If the numbers of all keys are given in `drawn`, they take the place of those of `draws`.
    The values are dispersed if the key varies. Otherwise, all of them equal the nominal value. For
    keys without a nominal value, such as the inertia, the result contains the drawn numbers.
    """
    drawn = drawn or draws(dispersions, seed, runs)
    values = {**{key: np.full(len(runs), value) for key, value in nominal.items()}, **drawn}
    for one in dispersions:
        if one.key in nominal:
            draw, value = drawn[one.key][:, 0], nominal[one.key]
            values[one.key] = value * (1.0 + draw) if one.relative \
                else draw + (one.kind == 'normal') * value
    return values


def uniforms(seed: int, runs: NDArray[np.int64], key: str, count: int) -> Floats:
    """
    Return uniform random numbers for each run, strictly between 0 and 1.

    The generator, Philox, computes random numbers directly from a key and a counter. Each run has
    its own range of the counter, so that the random numbers of a run can be computed without those
    of earlier runs.

    Parameters
    ----------
    seed : int
        The seed, from 0 to 2**64 - 1.
    runs : array of int, shape (n,)
        The run numbers. They should be close together, because random numbers are computed for all
        runs from the lowest to the highest number.
    key : str
        The name of the stream, for example the key of a parameter.
    count : int
        Number of random numbers for each run.

    Returns
    -------
    array, shape (n, count)
        Row i depends only on the seed, `runs[i]`, the key and the count.

    """
    first, counters = int(runs.min()), -(-count // _AT_ONCE)
    generator = np.random.Philox(key=zlib.crc32(key.encode()) << 64 | seed,
                                 counter=first * counters)
    bits = generator.random_raw((int(runs.max()) + 1 - first) * counters * _AT_ONCE)
    chosen = bits.reshape(-1, counters * _AT_ONCE)[runs - first, :count]
    return ((chosen >> np.uint64(12)).astype(float) + 0.5) * 2.0 ** -52


def normals(seed: int, runs: NDArray[np.int64], key: str, count: int) -> Floats:
    """Return standard normal random numbers for each run; see `uniforms` for the arguments."""
    from scipy.special import ndtri  # slow to import
    return np.asarray(ndtri(uniforms(seed, runs, key, count)))


def units_with(fields: Iterable[str]) -> dict[str, str]:
    """Return `UNITS` together with the keys and units of the uniform fields with these names."""
    return {**UNITS, **{name: parameter.unit
                        for name, parameter in of_names(fields).items()}}


def load(path: str | Path, fields: Iterable[str] = ()) -> tuple[Dispersion, ...]:
    """
    Read dispersions from a YAML file.

    Parameters
    ----------
    path : str or Path
        The file.
    fields : iterable of str
        The names of the uniform fields in the scene. Their values can vary as well.

    Raises
    ------
    InputError
        The file cannot be read, a key is unknown or occurs twice, or a distribution is invalid.

    """
    root, units = read_yaml(path, 'dispersions'), units_with(fields)
    with located(path, InputError):
        found = tuple(_dispersion(key.value, value, units)
                      for key, value in entries(root, 'the file', _EXAMPLE))
        if not found:
            raise InputError('expected a parameter that varies, found none')
        keys = [one.key for one in found]
        for key in keys:
            if keys.count(key) > 1:
                raise InputError(f'{key}: expected each key once, found it twice')
            if INERTIA in keys and key.startswith(f'{INERTIA}.'):
                raise InputError(f'{key}: expected either {INERTIA} or its entries, found both')
    return found


def _dispersion(key: str, node: yaml.Node, units: Mapping[str, str]) -> Dispersion:
    known = (*units, *_SPECIAL)
    if key not in known:
        close = resembled(key, known)
        raise InputError(f'{key}: unknown key' + (f'; did you mean {close}?' if close else
                                                  f'; expected one of {", ".join(known)}'))
    given = [(name.value, value) for name, value in entries(node, key, _EXAMPLE)]
    values = dict(given)
    kinds = [name for name, _ in given if name != 'relative' or key == INERTIA]
    expected = (_SPECIAL[key],) if key in _SPECIAL else ('normal', 'uniform')
    if len(kinds) != 1 or kinds[0] not in expected or len(values) != len(given):
        raise InputError(f'{key}: expected {" or ".join(expected)}, found '
                         f'{quoted([name for name, _ in given])}')
    if key in _SPECIAL and len(given) > 1:
        raise InputError(f'{key}: expected only {expected[0]}, found relative as well')
    return Dispersion(key, kinds[0], _bounds(key, kinds[0], values[kinds[0]], units),
                      key not in _SPECIAL and _flag(key, values.get('relative')))


def _bounds(key: str, kind: str, node: yaml.Node,
            units: Mapping[str, str]) -> tuple[float, ...]:
    unit = {ATTITUDE: 'rad', NOISE: 'N m'}.get(key, units.get(key, ''))
    nodes = node.value if isinstance(node, yaml.SequenceNode) else [node]
    texts = [one.value if isinstance(one, yaml.ScalarNode) else described(one) for one in nodes]
    numbers = tuple(one for one in map(number, texts) if one is not None and abs(one) < BIG)
    possible = len(numbers) == len(texts) and (
        len(numbers) == 2 and numbers[0] < numbers[1] if kind == 'uniform' else
        len(numbers) == 1 and numbers[0] > 0.0)
    if not possible:
        expected = 'two ascending numbers' if kind == 'uniform' else 'a number greater than 0'
        raise InputError(f'{key}: {kind}: expected {expected}{unit and f" ({unit})"}, '
                         f'found {quoted(texts)}')
    return numbers


def _flag(key: str, node: yaml.Node | None) -> bool:
    if node is None:
        return False
    if node.value not in ('true', 'false'):
        raise InputError(f'{key}: relative: expected true or false, found {described(node)}')
    return bool(node.value == 'true')
