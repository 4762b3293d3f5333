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

"""One start state, and the torques applied since."""

from __future__ import annotations

import bisect
from collections.abc import Iterable
from typing import NamedTuple

from rigid_body_ros.body import State
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.propagation import Propagator
from rigid_body_ros.scene import Scene


class Torque(NamedTuple):
    """A torque, N m, that acts from its stamp on; the frame is 'body' or 'space'."""

    stamp_ns: int
    values: Floats
    frame: str


def _stamp_ns(torque: Torque) -> int:
    return torque.stamp_ns


class Epoch:
    """
    The motion from one start state on.

    Parameters
    ----------
    scene : Scene
    start : State
    torques : iterable of Torque
        Torques of an earlier epoch that still act.

    """

    def __init__(self, scene: Scene, start: State, torques: Iterable[Torque] = ()) -> None:
        self.start = start
        self._propagator = Propagator(scene.body, start, **scene.options,
                                      history=scene.values['history'])
        #: Sorted by stamp: the torque in force `history` before the newest stamp, and later ones.
        self._torques: list[Torque] = []
        #: Stamps, ascending, whose states are not committed yet.
        self._uncommitted: list[int] = []
        for torque in torques:
            self.apply(torque)

    @property
    def history_ns(self) -> int:
        """How much older than the newest stamp a torque may be, ns; older ones are dropped."""
        return self._propagator.history_ns

    @property
    def newest_ns(self) -> int | None:
        """Return the newest stamp, ns, or None before the first torque."""
        return self._torques[-1].stamp_ns if self._torques else None

    def at(self, time_ns: int, within: float) -> State:
        """Return the state at a time; arguments and errors are those of `Propagator.at`."""
        return self._propagator.at(time_ns, within)

    def apply(self, torque: Torque) -> bool:
        """Apply a torque; return False if it is too old, and raise as `Propagator.apply` does."""
        if not self._propagator.apply(*torque):
            return False
        place = bisect.bisect_left(self._torques, torque.stamp_ns, key=_stamp_ns)
        is_replacement = self.has_torque_at(torque.stamp_ns)
        self._torques[place:place + is_replacement] = [torque]
        if not is_replacement and torque.stamp_ns > self.start.time_ns:
            bisect.insort(self._uncommitted, torque.stamp_ns)
        horizon = self._torques[-1].stamp_ns - self.history_ns
        oldest = bisect.bisect_right(self._torques, horizon, key=_stamp_ns) - 1
        del self._torques[:max(oldest, 0)]
        return True

    def has_torque_at(self, stamp_ns: int) -> bool:
        """Return whether there is a torque with this stamp that may still be replaced."""
        place = bisect.bisect_left(self._torques, stamp_ns, key=_stamp_ns)
        return place < len(self._torques) and self._torques[place].stamp_ns == stamp_ns

    def uncommitted(self, horizon_ns: int | None = None) -> list[int]:
        """Return the stamps, up to a time if given, whose states are not committed yet."""
        if horizon_ns is None:
            return self._uncommitted.copy()
        return self._uncommitted[:bisect.bisect_right(self._uncommitted, horizon_ns)]

    def mark_committed(self, horizon_ns: int) -> None:
        """Record that the states at the stamps up to a time are committed."""
        del self._uncommitted[:bisect.bisect_right(self._uncommitted, horizon_ns)]

    def torques_since(self, time_ns: int) -> list[Torque]:
        """Return the torque that acts at a time, and all later ones."""
        place = bisect.bisect_right(self._torques, time_ns, key=_stamp_ns)
        return self._torques[max(place - 1, 0):]
