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

"""Frames that are fixed to a body, and the torques of wrenches in these frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import listed, quoted


@dataclass(frozen=True, eq=False)
class Frame:
    """
    A frame that is fixed to a body.

    Attributes
    ----------
    rotation : array, shape (3, 3)
        Its axes as columns, in body axes: `v_body = rotation @ v_frame`.
    position : array, shape (3,), m, body axes
        Its origin relative to the centre of mass.

    """

    rotation: Floats
    position: Floats

    @cached_property
    def is_aligned(self) -> bool:
        """Return whether its axes are the body axes."""
        return np.array_equal(self.rotation, np.eye(3))

    @cached_property
    def has_arm(self) -> bool:
        """Return whether a force at its origin has a lever arm about the centre of mass."""
        return bool(self.position.any())

    @cached_property
    def _arm(self) -> Floats:
        """Return the matrix, shape (3, 3), m, that maps a force in the frame to its torque."""
        return np.cross(self.position, self.rotation, axisb=0, axisc=0)

    def torque(self, force: ArrayLike, torque: ArrayLike) -> Floats:
        """
        Return the torque of wrenches about the centre of mass: R torque + position x (R force).

        A torque without a force in an aligned frame keeps its bits.

        Parameters
        ----------
        force, torque : array, shape (..., 3), N and N m
            In the axes of the frame. The force acts at its origin.

        Returns
        -------
        array, shape (..., 3), N m, body axes
            Not finite if a torque, or a force with a lever arm, is not finite, or if the result
            does not fit a double.

        """
        force, torque = np.asarray(force, float), np.asarray(torque, float)
        with np.errstate(over='ignore', invalid='ignore'):
            if not self.is_aligned:
                torque = _product(self.rotation, torque)
            if not self.has_arm or not force.any():
                return torque
            moment = _product(self._arm, force)
            # Not always the sum, because -0.0 + 0.0 is 0.0.
            return np.where(moment, torque + moment, torque)


def _product(matrix: Floats, vectors: Floats) -> Floats:
    """Return the matrix times each vector, shape (..., 3), with sums of a fixed order."""
    # For a single vector Python's floats are faster, with the same bits.
    x, y, z = vectors.tolist() if vectors.ndim == 1 else np.moveaxis(vectors, -1, 0)
    product = np.empty(vectors.shape)
    for k, (a, b, c) in enumerate(matrix.tolist()):
        product[..., k] = a * x + b * y + c * z
    return product


class UnknownFrameError(KeyError, ValueError):
    """A frame is not fixed to the body; the message states why."""

    __str__ = ValueError.__str__  # that of KeyError adds quotes


class Frames(dict[str, Frame]):
    """
    The frames that are fixed to a link, by name; any other name raises UnknownFrameError.

    Attributes
    ----------
    link : str
        The link that is the body; '' if there are no frames.
    others : mapping
        For each other link of the URDF, why it is not fixed to the body.

    """

    def __init__(self, link: str = '', fixed: Mapping[str, Frame] | None = None,
                 others: Mapping[str, str] | None = None) -> None:
        super().__init__(fixed or {})
        self.link, self.others = link, others or {}

    def __missing__(self, name: str) -> Frame:
        reason = self.others.get(name, f'expected a link of the URDF that is fixed to '
                                       f'{quoted(self.link)}: {listed([*map(repr, self)])}')
        raise UnknownFrameError(f'frame {quoted(name)}: {reason}')

    def prefixed(self, prefix: str) -> Frames:
        """Return these frames with a prefix before each name, as robot_state_publisher has it."""
        if not prefix:
            return self
        return Frames(prefix + self.link, {prefix + name: self[name] for name in self},
                      {prefix + name: why for name, why in self.others.items()})

    def of_body(self, body_frame: str) -> Frame | None:
        """
        Return the frame that the name of the body axes refers to; None if there are no frames.

        That is the link of this name if its axes are the body axes, else the link that is the
        body: names of body frames need not be names of links.
        """
        named = self.get(body_frame)
        return named if named is not None and named.is_aligned else self.get(self.link)


#: Those of a body without a URDF.
NO_FRAMES = Frames()
