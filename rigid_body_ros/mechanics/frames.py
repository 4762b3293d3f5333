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

"""Frames of the links of a body, and the torques of wrenches in these frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import listed, quoted

#: Largest part of a vector across an axis, relative to the vector, that is rounding: a publisher
#: that normalises the axis, multiplies it by the thrust or rotates it by a quaternion rounds by
#: less than 16 eps; four times that leaves room for a chain of rotations.
_ROUNDING = 64.0 * np.finfo(float).eps
#: Smallest normal double; below it, rounding is not relative to the value.
_TINY = np.finfo(float).tiny


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


@dataclass(frozen=True, eq=False)
class TurningFrame(Frame):
    """
    A frame that turns about an axis through its origin; both are fixed to the body.

    The angle is unknown, so a wrench has a known torque only if it is along the axis.

    Attributes
    ----------
    rotation : array, shape (3, 3)
        As in `Frame`, at the angle zero.
    joint : str
        Name of the joint that turns it.
    axis : array, shape (3,)
        Unit vector along the axis, in the axes of the frame.

    """

    joint: str
    axis: Floats

    @cached_property
    def is_aligned(self) -> bool:
        """Return False: its axes are the body axes at one angle at most."""
        return False

    @cached_property
    def _projection(self) -> Floats:
        """Return the matrix, shape (3, 3), that maps a vector to its part along the axis."""
        return np.outer(self.axis, self.axis)

    def torque(self, force: ArrayLike, torque: ArrayLike) -> Floats:
        """
        Return the torque of wrenches about the centre of mass, as `Frame.torque` does.

        Raises
        ------
        OffAxisError
            A force or a torque is not along the axis within rounding. One that is not finite is
            not checked.

        """
        force, torque = np.asarray(force, float), np.asarray(torque, float)
        with np.errstate(over='ignore', invalid='ignore'):
            forces, torques = (_product(self._projection, vectors) for vectors in (force, torque))
            off = np.asarray(_differ(force, forces) | _differ(torque, torques))
        if off.any():
            row = int(off.argmax())
            found = [np.broadcast_to(vectors, (*off.shape, 3)).reshape(-1, 3)[row].tolist()
                     for vectors in (force, torque)]
            raise OffAxisError(row, f'expected force and torque along the axis '
                               f'{self.axis.tolist()} of joint {quoted(self.joint)} '
                               f'(continuous), found force {found[0]} and torque {found[1]}')
        return super().torque(forces, torques)


class OffAxisError(ValueError):
    """A wrench in a TurningFrame is not along the axis; `row` is the first of several."""

    def __init__(self, row: int, text: str) -> None:
        super().__init__(text)
        self.row = row


def _differ(vectors: Floats, others: Floats) -> NDArray[np.bool_]:
    """Return whether vectors, shape (..., 3), differ from others by more than rounding."""
    size, error = np.abs(vectors).max(axis=-1), np.abs(vectors - others).max(axis=-1)
    differ: NDArray[np.bool_] = error > _ROUNDING * (size + _TINY)
    return differ


def _product(matrix: Floats, vectors: Floats) -> Floats:
    """Return the matrix times each vector, shape (..., 3), with sums of a fixed order."""
    # For a single vector Python's floats are faster, with the same bits.
    x, y, z = vectors.tolist() if vectors.ndim == 1 else np.moveaxis(vectors, -1, 0)
    product = np.empty(vectors.shape)
    for k, (a, b, c) in enumerate(matrix.tolist()):
        product[..., k] = a * x + b * y + c * z
    return product


class UnknownFrameError(KeyError, ValueError):
    """Forces in a frame are not accepted; the message states why."""

    __str__ = ValueError.__str__  # that of KeyError adds quotes


class Frames(dict[str, Frame]):
    """
    Frames in which forces are accepted, by name of the link; others raise UnknownFrameError.

    Attributes
    ----------
    link : str
        The link that is the body; '' if there are no frames.
    others : mapping
        For each other link of the URDF, why its forces are not accepted.

    """

    def __init__(self, link: str = '', frames: Mapping[str, Frame] | None = None,
                 others: Mapping[str, str] | None = None) -> None:
        super().__init__(frames or {})
        self.link, self.others = link, others or {}

    def __missing__(self, name: str) -> Frame:
        reason = self.others.get(name, 'expected a link of the URDF whose forces are accepted: '
                                       f'{listed([*map(repr, self)])}')
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

        It is the link of this name if its axes are the body axes, otherwise the link that is the
        body: names of body frames need not be names of links.
        """
        named = self.get(body_frame)
        return named if named is not None and named.is_aligned else self.get(self.link)


#: Those of a body without a URDF.
NO_FRAMES = Frames()
