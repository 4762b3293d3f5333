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

"""The names under which the node counts what happens to torques and to the motion."""

from __future__ import annotations

from typing import Protocol

RECEIVED, APPLIED, WAITING = 'received', 'applied', 'waiting'
#: The causes for which a message can be rejected.
MALFORMED, FRAME, NOT_FINITE, TOO_LARGE = 'malformed', 'unknown frame', 'not finite', 'too large'
NO_CLOCK, FUTURE, LATE, OVERLOAD = 'no clock', 'future', 'late', 'overload'
NO_STATE, ENDED, STALE = 'state not computable', 'epoch ended', 'before the reset'
DIFFERS, IMPOSSIBLE = 'duplicate, differs (same stamp)', 'no body has this inertia'
CAUSES = (MALFORMED, FRAME, NOT_FINITE, TOO_LARGE, NO_CLOCK, FUTURE, LATE, OVERLOAD, NO_STATE,
          ENDED, DIFFERS, STALE, IMPOSSIBLE)
#: The causes for which a torque is rejected because of a reset, and not because its sender made a
#: mistake.
OF_RESETS = (ENDED, STALE)
NO_TIME = 'no time was received on /clock yet'
#: Names of the other counts for torques.
REPLACED, FORCE = 'replaced (same stamp)', 'force ignored'
LOST, UNSTAMPED = 'lost', 'stamp 0, act on arrival'
#: Names of the counts for wheel commands.
CLIPPED, TOO_FAST = 'clipped to max_torque', 'limited at max_speed'
#: Names of the counts for the motion.
MISSED, NOT_COMPUTABLE, UNSENT = 'deadlines missed', 'states not computable', 'publish failures'
UNSAVED, TIME_JUMP = 'checkpoint failures', 'clock jumps'
STATES, STATES_REJECTED = 'initial states', 'initial states rejected'
#: The counts that diagnostics report of torques and inertias, of commands, and of the motion.
OF_TORQUES = REPLACED, FORCE, LOST, UNSTAMPED
OF_COMMANDS = REPLACED, CLIPPED, TOO_FAST, LOST, UNSTAMPED
OF_MOTION = MISSED, NOT_COMPUTABLE, UNSENT, UNSAVED, TIME_JUMP, STATES, STATES_REJECTED
#: If a count in `ERRORS` has increased since the last report, the level of the status is ERROR.
#: If a count in `MOTION_WARNINGS` or `TORQUE_WARNINGS` has increased, the level is WARN.
ERRORS = MISSED, NOT_COMPUTABLE, UNSENT, UNSAVED, STATES_REJECTED
MOTION_WARNINGS, TORQUE_WARNINGS = (TIME_JUMP,), (REPLACED, TOO_FAST, LOST)


def rejections(cause: str) -> str:
    """Return the key under which torques rejected for the given cause are counted."""
    return f'rejected: {cause}'


class RejectedError(ValueError):
    """Raised when a message is rejected; `cause` is the name under which it is counted."""

    def __init__(self, cause: str, text: str) -> None:
        super().__init__(text)
        self.cause = cause


class Events(Protocol):
    """Protocol of an object that counts and reports events."""

    def count(self, name: str, source: int, number: int = 1) -> None:
        """Count events that concern the torques of a source. Do not log these events."""

    def count_force(self, source: int) -> None:
        """Count a force that was ignored."""

    def ignore_mass(self) -> None:
        """Log once that the mass and the centre of mass of an inertia message are ignored."""

    def count_lost(self, source: int, number: int, is_first: bool = False) -> None:
        """Count the torques lost between two torques of a publisher, and log a warning."""

    def reject(self, rejected: RejectedError, source: int) -> None:
        """Count a torque that was rejected, and log the reason."""

    def event(self, name: str, text: str, kind: str = '') -> None:
        """Count a problem with the motion, and log it unless this kind was logged recently."""
