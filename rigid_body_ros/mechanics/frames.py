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

"""The frames of a body's links, and the torques of wrenches that are given in these frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import listed, quoted

#: A vector counts as parallel to an axis if the vector's component perpendicular to the axis is at
#: most this fraction of the vector's magnitude. If a publisher normalises the axis, multiplies it
#: by the thrust or rotates it by a quaternion, this causes an error of less than 16 eps. The limit
#: is four times larger, to leave room for a chain of rotations.
_ROUNDING = 64.0 * np.finfo(float).eps
#: The smallest normal double. For smaller numbers, rounding errors are not proportional to the
#: number.
_TINY = np.finfo(float).tiny


@dataclass(frozen=True, eq=False)
class Frame:
    """
    A frame that is fixed to a body.

    Attributes
    ----------
    rotation : array, shape (3, 3)
        The axes of the frame as columns, in body axes: `v_body = rotation @ v_frame`.
    position : array, shape (3,), m, body axes
        The origin of the frame relative to the centre of mass.

    """

    rotation: Floats
    position: Floats

    @cached_property
    def is_aligned(self) -> bool:
        """Return whether the axes of the frame are the body axes."""
        return np.array_equal(self.rotation, np.eye(3))

    @cached_property
    def has_arm(self) -> bool:
        """Return whether the origin of the frame is away from the centre of mass."""
        return bool(self.position.any())

    @cached_property
    def _arm(self) -> Floats:
        """Return the 3 by 3 matrix, in m, that maps a force in the frame to its torque."""
        return np.cross(self.position, self.rotation, axisb=0, axisc=0)

    def torque(self, force: ArrayLike, torque: ArrayLike) -> Floats:
        """
        Return the torque of wrenches about the centre of mass.

        The result is R torque + position x (R force), where R is `rotation`. If the frame is
        aligned and there is no force, the torque is returned unchanged, bit for bit.

        Parameters
        ----------
        force, torque : array, shape (..., 3), N and N m
            The wrenches in the axes of the frame. The force acts at the origin of the frame.

        Returns
        -------
        array, shape (..., 3), N m, body axes
            A result is not finite if its wrench has a torque that is not finite, or a force that
            is not finite and has a lever arm, or if the computation overflows.

        """
        force, torque = np.asarray(force, float), np.asarray(torque, float)
        with np.errstate(over='ignore', invalid='ignore'):
            if not self.is_aligned:
                torque = _product(self.rotation, torque)
            if not self.has_arm or not force.any():
                return torque
            moment = _product(self._arm, force)
            # Do not add a moment that is zero, because it would turn a torque of -0.0 into 0.0.
            return np.where(moment, torque + moment, torque)


@dataclass(frozen=True, eq=False)
class TurningFrame(Frame):
    """
    A frame that turns about an axis through its origin.

    The axis and the origin are fixed to the body, but the angle of the frame is unknown. The
    torque of a wrench can therefore be computed only if the wrench is along the axis.

    Attributes
    ----------
    rotation : array, shape (3, 3)
        The axes of the frame when its angle is zero, as columns, in body axes.
    joint : str
        Name of the joint that turns the frame.
    axis : array, shape (3,)
        Unit vector along the axis, in the axes of the frame.

    """

    joint: str
    axis: Floats

    @cached_property
    def is_aligned(self) -> bool:
        """Return False, because this frame is aligned with the body at one angle at most."""
        return False

    @cached_property
    def _projection(self) -> Floats:
        """Return the 3 by 3 matrix that projects a vector onto the axis."""
        return np.outer(self.axis, self.axis)

    def torque(self, force: ArrayLike, torque: ArrayLike) -> Floats:
        """
        Return the torque of wrenches about the centre of mass, as `Frame.torque` does.

        Raises
        ------
        OffAxisError
            A force or a torque is not along the axis within rounding. Forces and torques that are
            not finite are not checked.

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
    """
    Raised if a force or a torque in a TurningFrame is not along the axis of the frame.

    `row` is the index of the first such wrench.
    """

    def __init__(self, row: int, text: str) -> None:
        super().__init__(text)
        self.row = row


def _differ(vectors: Floats, others: Floats) -> NDArray[np.bool_]:
    """
    Return whether each vector differs from its counterpart by more than rounding errors.

    Both arrays have shape (..., 3).
    """
    size, error = np.abs(vectors).max(axis=-1), np.abs(vectors - others).max(axis=-1)
    differ: NDArray[np.bool_] = error > _ROUNDING * (size + _TINY)
    return differ


def _product(matrix: Floats, vectors: Floats) -> Floats:
    """Return the matrix times each vector, shape (..., 3), summed in a fixed order."""
    # For a single vector, Python's floats are faster and give the same bits.
    x, y, z = vectors.tolist() if vectors.ndim == 1 else np.moveaxis(vectors, -1, 0)
    product = np.empty(vectors.shape)
    for k, (a, b, c) in enumerate(matrix.tolist()):
        product[..., k] = a * x + b * y + c * z
    return product


class UnknownFrameError(KeyError, ValueError):
    """Raised if forces in a frame are not accepted; the message says why."""

    __str__ = ValueError.__str__  # KeyError.__str__ adds quotes


class Frames(dict[str, Frame]):
    """
    The frames in which forces are accepted, keyed by link name.

    Looking up any other name raises UnknownFrameError.

    Attributes
    ----------
    link : str
        Name of the link that represents the body, or '' if there are no frames.
    others : mapping
        For each other link of the URDF, the reason why forces in its frame are not accepted.
    notes : sequence of str
        Lines about the links whose masses belong to the body, and those whose masses do not. There
        are none if only one link has a mass.

    """

    def __init__(self, link: str = '', frames: Mapping[str, Frame] | None = None,
                 others: Mapping[str, str] | None = None, notes: Sequence[str] = ()) -> None:
        super().__init__(frames or {})
        self.link, self.others, self.notes = link, others or {}, notes

    def __missing__(self, name: str) -> Frame:
        reason = self.others.get(name, 'expected a link of the URDF whose forces are accepted: '
                                       f'{listed([*map(repr, self)])}')
        raise UnknownFrameError(f'frame {quoted(name)}: {reason}')

    def prefixed(self, prefix: str) -> Frames:
        """Return the frames with a prefix before each name, as in `robot_state_publisher`."""
        if not prefix:
            return self
        return Frames(prefix + self.link, {prefix + name: self[name] for name in self},
                      {prefix + name: why for name, why in self.others.items()}, self.notes)

    def of_body(self, body_frame: str) -> Frame | None:
        """
        Return the frame for forces given in the body frame, or None if there are no frames.

        The name of the body frame need not be the name of a link. If there is a link with this
        name and its axes are the body axes, the method returns the frame of that link. Otherwise,
        it returns the frame of the link that represents the body.
        """
        named = self.get(body_frame)
        return named if named is not None and named.is_aligned else self.get(self.link)


#: No frames, for a body without a URDF.
NO_FRAMES = Frames()
