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

"""One start state, and the torques taken since."""

from __future__ import annotations

import bisect
from collections.abc import Iterable
from typing import NamedTuple

from rigid_body_ros.body import State
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.propagation import Propagator
from rigid_body_ros.scene import Scene


class Torque(NamedTuple):
    """A torque, N m, from a stamp on; the frame is 'body' or 'space'."""

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
        What of an earlier epoch is still in force.

    """

    def __init__(self, scene: Scene, start: State, torques: Iterable[Torque] = ()) -> None:
        self.start = start
        self._propagator = Propagator(scene.body, start, **scene.options,
                                      history=scene.values['history'])
        #: The one in force `history` before the newest, and all since, by stamp.
        self._torques: list[Torque] = []
        #: Stamps whose states a late torque may still change, ascending.
        self._pending: list[int] = []
        for torque in torques:
            self.take(torque)

    @property
    def history_ns(self) -> int:
        """How much older than the newest stamp a torque is dropped."""
        return self._propagator.history_ns

    @property
    def newest_ns(self) -> int | None:
        """Return the newest stamp, or None before the first torque."""
        return self._torques[-1].stamp_ns if self._torques else None

    def at(self, time_ns: int, within: float) -> State:
        """Return the state at a time; errors as of `Propagator.at`."""
        return self._propagator.at(time_ns, within)

    def take(self, torque: Torque) -> bool:
        """Apply a torque; return False if it is too old."""
        if not self._propagator.apply(*torque):
            return False
        place = bisect.bisect_left(self._torques, torque.stamp_ns, key=_stamp_ns)
        repeated = self.holds(torque.stamp_ns)
        self._torques[place:place + repeated] = [torque]
        if not repeated and torque.stamp_ns > self.start.time_ns:
            bisect.insort(self._pending, torque.stamp_ns)
        horizon = self._torques[-1].stamp_ns - self.history_ns
        oldest = bisect.bisect_right(self._torques, horizon, key=_stamp_ns) - 1
        del self._torques[:max(oldest, 0)]
        return True

    def holds(self, stamp_ns: int) -> bool:
        """Return whether a torque of this stamp was taken, and may still be replaced."""
        place = bisect.bisect_left(self._torques, stamp_ns, key=_stamp_ns)
        return place < len(self._torques) and self._torques[place].stamp_ns == stamp_ns

    def due(self, horizon_ns: int) -> list[int]:
        """Return the stamps up to a time whose states are still to be committed."""
        return self._pending[:bisect.bisect_right(self._pending, horizon_ns)]

    def settle(self, horizon_ns: int) -> None:
        """Take the stamps up to a time off those that are due."""
        del self._pending[:bisect.bisect_right(self._pending, horizon_ns)]

    def since(self, time_ns: int) -> list[Torque]:
        """Return the torque in force at a time, and all later ones."""
        place = bisect.bisect_right(self._torques, time_ns, key=_stamp_ns)
        return self._torques[max(place - 1, 0):]
