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

"""Reserve a private ROS domain, in which no other processes send or receive messages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import os
from pathlib import Path
import socket

from rigid_body_ros.common.errors import InputError

#: The domains to try. Their ports are below the range that Linux uses for outgoing connections.
#: The search begins with the highest number, because users tend to choose low numbers.
_DOMAINS = range(100, 0, -1)
#: The first port of domain 0, and the number of ports per domain. ROS nodes use the lowest free
#: ports of their domain.
_FIRST, _PORTS = 7400, 250
#: The environment variable that keeps all packets on this machine. The name of this variable in
#: ROS 2 Humble differs from its name in later releases.
_LOCAL = {'ROS_LOCALHOST_ONLY': '1'} if os.environ.get('ROS_DISTRO') == 'humble' else \
    {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
#: Environment variables that would connect the nodes to other machines.
_ELSEWHERE = 'ROS_STATIC_PEERS', 'ROS_DISCOVERY_SERVER'


@contextmanager
def private_domain() -> Iterator[int]:
    """
    Reserve a free ROS domain, and set up the environment so that new nodes use it.

    Raises
    ------
    InputError
        No domain is free.

    """
    number, lock = _reserved()
    before = dict(os.environ)
    try:
        os.environ.update({'ROS_DOMAIN_ID': str(number), **_LOCAL})
        for name in _ELSEWHERE:
            os.environ.pop(name, None)
        yield number
    finally:
        os.environ.clear()
        os.environ.update(before)
        lock.close()


def _reserved() -> tuple[int, socket.socket]:
    """Find an unused domain; return it, and a socket that keeps others from reserving it."""
    ours = os.environ.get('ROS_DOMAIN_ID')
    for number in _DOMAINS:
        if str(number) == ours:
            continue
        lock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with suppress(OSError):
            # The last port of a domain serves as its lock. The system frees this port when our
            # process ends.
            lock.bind(('127.0.0.1', _FIRST + _PORTS * (number + 1) - 1))
            if not _used(number):
                return number, lock
        lock.close()
    raise InputError(f'expected a free ROS domain from {_DOMAINS[-1]} to {_DOMAINS[0]}, found '
                     'nodes in all of them')


def _used(number: int) -> bool:
    """Return whether any process on this machine uses a port of a domain, except its lock port."""
    first = _FIRST + _PORTS * number
    for name in ('udp', 'udp6'):
        with suppress(OSError):  # these tables exist only on Linux
            for line in Path('/proc/net', name).read_text().splitlines()[1:]:
                if first <= int(line.split()[1].rpartition(':')[2], 16) < first + _PORTS - 1:
                    return True
    return False
