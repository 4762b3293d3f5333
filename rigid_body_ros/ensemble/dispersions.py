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

"""Read from a file which parameters vary, and draw their values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, quoted
from rigid_body_ros.ensemble.streams import normals, uniforms
from rigid_body_ros.runtime.limits import read_yaml
from rigid_body_ros.runtime.parameter_file import described, entries, number
from rigid_body_ros.runtime.parameters import BIG, resembled
from rigid_body_ros.scene import PARAMETERS
from rigid_body_ros.scene.fields import of_names, ORBIT
import yaml

#: Groups of scene parameters whose members can all vary.
_GROUPS = ('inertia', 'damping', 'initial_angular_velocity', 'initial_rotor_momentum',
           ORBIT)
#: Units of all keys that can have a normal or a uniform distribution, except keys of fields.
UNITS = {**{name: parameter.unit for name, parameter in PARAMETERS.items()
            if name.split('.')[0] in _GROUPS},
         'torque_gain': '', **{f'torque_bias.{axis}': 'N m' for axis in 'xyz'},
         'clock_offset': 's'}
#: Keys for which each run draws three numbers; for `NOISE`, three numbers per torque sample.
INERTIA, ATTITUDE, NOISE = 'inertia', 'initial_attitude', 'torque_noise'
_EXAMPLE = 'torque_gain: {normal: 0.03}'
#: Keys that accept only one kind of distribution, and this kind.
_SPECIAL = {INERTIA: 'relative', ATTITUDE: 'tilt', NOISE: 'normal'}


@dataclass(frozen=True)
class Dispersion:
    """
    The distribution of a parameter.

    Attributes
    ----------
    key : str
        A key of `units_with`, or 'inertia', 'initial_attitude' or 'torque_noise'.
    kind : str
        'normal', 'uniform', 'relative' (principal moments) or 'tilt' (rotation vector).
    bounds : tuple of float
        The lowest and the highest number if the kind is 'uniform'; otherwise, a standard
        deviation.
    relative : bool
        Whether the nominal value is multiplied by one plus the drawn number.

    """

    key: str
    kind: str
    bounds: tuple[float, ...]
    relative: bool = False

    def draw(self, seed: int, runs: NDArray[np.int64]) -> Floats:
        """
        Return the numbers that the given runs draw.

        Returns
        -------
        array, shape (n, 3) for 'relative' and 'tilt', otherwise (n, 1)
            Values if the kind is 'uniform' and `relative` is False; otherwise, deviations from the
            nominal values.

        """
        if self.kind == 'uniform':
            low, high = self.bounds
            return low + (high - low) * uniforms(seed, runs, self.key, 1)
        count = 3 if self.kind in ('relative', 'tilt') else 1
        return self.bounds[0] * normals(seed, runs, self.key, count)


def draws(dispersions: Sequence[Dispersion], seed: int,
          runs: NDArray[np.int64]) -> dict[str, Floats]:
    """
    Return the numbers that the given runs draw, by key.

    The numbers of a key depend only on the seed, the key and the number of the run. They do not
    depend on other keys. The result does not include the noise of the torque, because `Torques`
    draws this noise for each sample.
    """
    return {one.key: one.draw(seed, runs) for one in dispersions if one.key != NOISE}


def dispersed(dispersions: Sequence[Dispersion], nominal: Mapping[str, float],
              drawn: Mapping[str, Floats], count: int) -> dict[str, Floats]:
    """Return the values in `count` runs by key: nominal or dispersed values, shape (count,)."""
    values = {name: np.full(count, value) for name, value in nominal.items()}
    for one in dispersions:
        if one.key in values:
            draw = drawn[one.key][:, 0]
            if one.relative:
                values[one.key] *= 1.0 + draw
            else:
                values[one.key] = draw + (one.kind == 'normal') * values[one.key]
    return values


def units_with(fields: Iterable[str]) -> dict[str, str]:
    """Return `UNITS`, and the units of the keys of uniform fields with the given names."""
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
        The names of the uniform fields of the scene. The values of these fields can vary.

    Raises
    ------
    InputError
        The file cannot be read, a key is unknown or given twice, or a distribution is impossible.

    """
    root, units = read_yaml(path, 'dispersions'), units_with(fields)
    try:
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
    except InputError as error:
        raise InputError(f'{path}: {error}') from error
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
