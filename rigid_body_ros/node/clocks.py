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

"""Watch a node's clock: stamp messages on arrival, detect jumps, and check that time advances."""

from __future__ import annotations

import time
from typing import NamedTuple

from builtin_interfaces.msg import Time
from rclpy.clock import Clock
from rclpy.node import Node
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.live.events import FUTURE, LATE, RejectedError
from rosgraph_msgs.msg import Clock as ClockMessage

#: Diagnostics warn if the clock stands still for more than this many seconds.
_MAX_PAUSE = 1.0
#: Simulated time may run up to this many times as fast as real time. So after the node or the
#: publisher of /clock has paused, the clock may advance by up to this many times the length of the
#: pause without causing a jump to be reported.
_FASTEST = 10
#: If a publisher of /clock is silent for more than this many nanoseconds, we assume that it has
#: stopped.
_LONGEST_PAUSE_NS = 3 * 10 ** 9
#: A step ahead by less than this many nanoseconds never counts as a jump, even if `history` is
#: shorter.
_SMALLEST_JUMP_NS = 10 ** 8
#: If a stamp differs from the clock by more than this many nanoseconds, we assume that the stamp
#: comes from another clock.
OTHER_CLOCK_NS = 3600 * 10 ** 9
#: How long to look for another publisher of /clock, and how long to wait for the name of this
#: publisher once it has been found, in seconds.
_DISCOVERY_TIME, _NAME_DELAY = 3.0, 0.5
_CLOCK = '/clock'
_ADVICE = ('; if the messages come from a bag, play it with --clock and set use_sim_time, or set '
           'time_source:=arrival')


def check_stamp(stamp_ns: int, now_ns: int, lead: float, name: str = 'max_future',
                max_past: float = 0.0) -> None:
    """
    Check that a stamp is close enough to the present time.

    Raises
    ------
    RejectedError
        The stamp is ahead of the clock by more than `lead` seconds, or behind it by more than
        `max_past` seconds (0: no limit), or comes from another clock.

    """
    ahead_ns = stamp_ns - now_ns
    advice = _ADVICE if abs(ahead_ns) > OTHER_CLOCK_NS else ''
    if ahead_ns > duration_ns(lead, name):
        raise RejectedError(FUTURE, f'stamped {ahead_ns * 1e-9:.9g} s ahead of the clock, '
                            f'expected at most {name} ({lead:g} s){advice}')
    if advice:
        raise RejectedError(LATE, f'stamped {-ahead_ns * 1e-9:.9g} s behind the clock{advice}')
    if -ahead_ns > duration_ns(max_past, 'max_past') > 0:
        raise RejectedError(LATE, f'stamped {-ahead_ns * 1e-9:.9g} s behind the clock, expected '
                            f'at most max_past ({max_past:g} s)')


class ArrivalStamps:
    """
    Stamp messages with their arrival times, making each stamp later than the previous one.

    Simulated time advances in ticks. Between two ticks, the stamps keep advancing at the rate at
    which simulated time advanced during the previous tick, but by no more than the length of one
    tick. Jumps do not count as ticks.
    """

    def __init__(self, is_simulated: bool = True) -> None:
        self._is_simulated = is_simulated
        self._now_ns = self._tick_ns = self._newest_tick_ns = 0
        self._wall_tick_ns = 1
        self._wall_ns = time.monotonic_ns()
        self._last_ns = 0

    def tick(self, now_ns: int) -> None:
        """Record the clock time, ns. Call this method whenever the clock may have changed."""
        if now_ns == self._now_ns:
            return
        if now_ns < self._now_ns:  # the clock was set back, so set the stamps back, too
            self._last_ns = 0
        wall_ns = time.monotonic_ns()
        tick_ns = max(0, now_ns - self._now_ns) if self._now_ns else 0
        self._tick_ns, self._newest_tick_ns = min(tick_ns, self._newest_tick_ns), tick_ns
        self._wall_tick_ns = max(1, wall_ns - self._wall_ns)
        self._now_ns, self._wall_ns = now_ns, wall_ns

    def stamp(self, age_ns: int = 0) -> int:
        """Return the stamp in ns for a message that arrived `age_ns` ago."""
        passed_ns = time.monotonic_ns() - age_ns - self._wall_ns
        if self._is_simulated:
            ticks = max(-1.0, min(1.0, passed_ns / self._wall_tick_ns))
            passed_ns = round(ticks * self._tick_ns)
        stamp_ns = self._now_ns + passed_ns
        self._last_ns = max(self._last_ns + 1, stamp_ns)
        return self._last_ns


class ClockReading(NamedTuple):
    """The time of a clock, and the size of the jump since the last reading, both in ns."""

    now_ns: int
    jump_ns: int


class WatchedClock:
    """
    Detect whether a clock jumps between one reading and the next, and whether it stands still.

    Simulated time has jumped if it is set back at all, or if it advances by more than a limit.
    When the node or the publisher of /clock has paused, the messages on /clock have piled up, so
    the limit is larger for the next few readings. A wall clock has jumped if it moves ahead or
    back by more than the limit, relative to the steady clock.

    Parameters
    ----------
    clock : Clock
    is_simulated : bool
    limit_ns : int
        The limit for jumps ahead, ns. For a wall clock, this is also the limit for jumps back.
    ahead_ns : int
        The smallest limit for jumps ahead, ns. If `limit_ns` is smaller, jumps ahead are compared
        with `ahead_ns` instead.

    """

    def __init__(self, clock: Clock, is_simulated: bool, limit_ns: int = 0,
                 ahead_ns: int = _SMALLEST_JUMP_NS) -> None:
        self._clock = clock
        self._is_simulated = is_simulated
        self._most_back_ns = 0 if is_simulated else limit_ns
        self.most_ahead_ns = max(limit_ns, ahead_ns)
        #: The last reading of the clock, followed by three times on the steady clock: just before
        #: the reading, just after the reading, and when the clock last advanced. All four are in
        #: ns.
        self._now_ns = self._read_at_ns = self._read_by_ns = self._advanced_at_ns = 0
        #: The length of the longest recent pause minus the time since that pause ended, in ns.
        self._pause_ns = 0

    def read(self) -> ClockReading:
        """
        Read the clock, and compare it with the last reading.

        The time is 0 before simulated time begins. The jump is 0 if the clock has not jumped.
        """
        before_ns = time.monotonic_ns()
        now_ns = self._clock.now().nanoseconds
        if not now_ns:
            return ClockReading(0, 0)
        if not self._now_ns:
            self._now_ns, self._read_at_ns, self._advanced_at_ns = now_ns, before_ns, before_ns
            self._read_by_ns = before_ns
        # `elapsed_ns` is only an upper bound, because the process may be interrupted while it
        # reads the clocks.
        after_ns = time.monotonic_ns()
        elapsed_ns = after_ns - self._read_at_ns
        silence_ns = min(after_ns - self._advanced_at_ns, _LONGEST_PAUSE_NS)
        self._pause_ns = max(elapsed_ns, silence_ns, self._pause_ns - elapsed_ns)
        expected_ns = _FASTEST * self._pause_ns if self._is_simulated else elapsed_ns
        ahead_ns = now_ns - self._now_ns
        behind_ns = -ahead_ns if self._is_simulated else before_ns - self._read_by_ns - ahead_ns
        self._now_ns, self._read_at_ns, self._read_by_ns = now_ns, before_ns, after_ns
        if ahead_ns:
            self._advanced_at_ns = before_ns
        has_jumped = (behind_ns > self._most_back_ns
                      or ahead_ns > self.most_ahead_ns + expected_ns)
        return ClockReading(now_ns, ahead_ns if has_jumped else 0)

    def problems(self) -> list[str]:
        """Return what is wrong with simulated time, by the last readings. Wall time advances."""
        if not self._is_simulated:
            return []
        if not self._now_ns:
            return ['no time yet: use_sim_time is true, but no time was received on /clock']
        pause = (time.monotonic_ns() - self._advanced_at_ns) * 1e-9
        if pause > _MAX_PAUSE:
            return [f'/clock has not advanced for {pause:.0f} s: it stands at {self._now_ns} ns']
        return []


class ClockPublisher:
    """
    Publish simulated time on /clock, as the only node that does so.

    Raises
    ------
    InputError
        The node itself follows simulated time, or another node publishes /clock. `key` is the
        parameter that asks for the clock.

    """

    def __init__(self, node: Node, key: str) -> None:
        self._node = node
        if node.get_parameter('use_sim_time').value:
            raise InputError(f'{key}: expected use_sim_time false, because a node cannot follow '
                             'the clock that it publishes')
        until = time.monotonic() + _DISCOVERY_TIME
        while time.monotonic() < until:
            if node.count_publishers(_CLOCK):
                time.sleep(_NAME_DELAY)
                info = node.get_publishers_info_by_topic(_CLOCK)[0]
                raise InputError(f'{key}: expected no other publisher of {_CLOCK}, found '
                                 f'{info.node_name}')
            time.sleep(0.05)
        self._publisher = node.create_publisher(ClockMessage, _CLOCK, 10)

    def publish(self, time_ns: int) -> None:
        """Publish a time."""
        self._publisher.publish(ClockMessage(clock=message_of(time_ns)))

    @property
    def has_rival(self) -> bool:
        """Return whether another node publishes /clock, too."""
        return self._node.count_publishers(_CLOCK) > 1

    def destroy(self) -> None:
        """Stop publishing, because of a rival."""
        self._node.destroy_publisher(self._publisher)
        self._node.get_logger().error(f'{_CLOCK}: another node publishes it, too; this node stops '
                                      'publishing it')


def message_of(time_ns: int) -> Time:
    """Return a time as a message."""
    seconds, nanoseconds = divmod(time_ns, 10 ** 9)
    return Time(sec=seconds, nanosec=nanoseconds)
