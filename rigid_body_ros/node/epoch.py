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
from collections.abc import Callable, Iterable
from functools import partial
from typing import NamedTuple

from rigid_body_ros import euler
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels.jit import announced
from rigid_body_ros.propagation import Propagator
from rigid_body_ros.propagation.segment import WHEELS
from rigid_body_ros.scene import Scene
from rigid_body_ros.state import State

#: Logged before the compilation.
_COMPILING = ('compiling the kernels, or waiting for a process that does: usually up to a minute, '
              'once after each installation; python3 -m rigid_body_ros.warm_up does it in '
              'advance')


class Torque(NamedTuple):
    """A torque, N m, that acts from its stamp on; the frame is 'body' or 'space'."""

    stamp_ns: int
    values: Floats
    frame: str
    #: Of `Propagator.apply`; WHEELS for a torque on the rotors.
    source: int = 0


def _stamp_ns(torque: Torque) -> int:
    return torque.stamp_ns


def warm_up_for(scene: Scene, log: Callable[[str], object]) -> None:
    """
    Compile the kernels that a scene needs, or load the code of an earlier process.

    Parameters
    ----------
    scene : Scene
        The scene.
    log : callable
        Receives a message before a kernel is compiled.

    """
    always_has_terms = scene.body.is_damped or scene.start.rotor_momentum.any()
    with announced(partial(log, _COMPILING)):
        if not always_has_terms:
            start = Propagator(scene.body, State()).at(1)
        if always_has_terms or scene.wheels or len(scene.torque_topics) > 1:
            start = Propagator(scene.body, State(rotor_momentum=(1.0, 0.0, 0.0))).at(1)
        euler.from_quaternion(start.attitude, scene.values['euler_sequence'])


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
        #: The newest stamp of all sources, ns, or None before the first torque.
        self.newest_ns: int | None = None
        #: By source, sorted by stamp: the torque in force `history` before the newest stamp, and
        #: later ones.
        self._torques: dict[int, list[Torque]] = {}
        #: Stamps, ascending, whose states are not committed yet.
        self._uncommitted: list[int] = []
        for torque in torques:
            self.apply(torque)

    @property
    def history_ns(self) -> int:
        """How much older than the newest stamp a torque may be, ns; older ones are dropped."""
        return self._propagator.history_ns

    def newest_of(self, source: int) -> int | None:
        """Return the newest stamp of a source, ns, or None before its first torque."""
        return self._torques[source][-1].stamp_ns if source in self._torques else None

    def at(self, time_ns: int, within: float) -> State:
        """Return the state at a time; arguments and errors are those of `Propagator.at`."""
        return self._propagator.at(time_ns, within)

    def apply(self, torque: Torque) -> bool:
        """Apply a torque; return False if it is too old, and raise as `Propagator.apply` does."""
        stamp_ns, values, _, source = torque
        is_taken = self._propagator.apply_wheels(stamp_ns, values) if source == WHEELS else \
            self._propagator.apply(*torque)
        if not is_taken:
            return False
        is_replacement = self.has_torque_at(stamp_ns, source)
        torques = self._torques.setdefault(source, [])
        place = bisect.bisect_left(torques, stamp_ns, key=_stamp_ns)
        torques[place:place + is_replacement] = [torque]
        if not is_replacement and stamp_ns > self.start.time_ns:
            self._await_commitment(stamp_ns)
        self.newest_ns = stamp_ns if self.newest_ns is None else max(self.newest_ns, stamp_ns)
        oldest = bisect.bisect_right(torques, self.newest_ns - self.history_ns, key=_stamp_ns) - 1
        del torques[:max(oldest, 0)]
        return True

    def _await_commitment(self, stamp_ns: int) -> None:
        place = bisect.bisect_left(self._uncommitted, stamp_ns)
        if self._uncommitted[place:place + 1] != [stamp_ns]:  # one state for all sources
            self._uncommitted.insert(place, stamp_ns)

    def has_torque_at(self, stamp_ns: int, source: int) -> bool:
        """Return whether a source has a torque of this stamp that may still be replaced."""
        torques = self._torques.get(source, [])
        place = bisect.bisect_left(torques, stamp_ns, key=_stamp_ns)
        return place < len(torques) and torques[place].stamp_ns == stamp_ns

    def uncommitted(self, horizon_ns: int | None = None) -> list[int]:
        """Return the stamps, up to a time if given, whose states are not committed yet."""
        if horizon_ns is None:
            return self._uncommitted.copy()
        return self._uncommitted[:bisect.bisect_right(self._uncommitted, horizon_ns)]

    def mark_committed(self, horizon_ns: int) -> None:
        """Record that the states at the stamps up to a time are committed."""
        del self._uncommitted[:bisect.bisect_right(self._uncommitted, horizon_ns)]

    def torques_since(self, time_ns: int) -> list[Torque]:
        """Return, sorted by stamp, the torques that act at a time, and all later ones."""
        found: list[Torque] = []
        for torques in self._torques.values():
            place = bisect.bisect_right(torques, time_ns, key=_stamp_ns)
            found += torques[max(place - 1, 0):]
        return sorted(found, key=_stamp_ns)
