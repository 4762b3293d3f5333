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

"""A private ROS domain, in which no other processes receive or send messages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import os
from pathlib import Path
import socket

from rigid_body_ros.common.errors import InputError

#: Domains whose ports are below the ports that Linux uses for outgoing connections. The search
#: begins with the highest number, because users tend to choose low numbers.
_DOMAINS = range(100, 0, -1)
#: First port of domain 0, and number of ports per domain. Participants use the lowest free ports.
_FIRST, _PORTS = 7400, 250
#: The environment variable that keeps all packets on this machine; Humble uses another variable
#: than later releases.
_LOCAL = {'ROS_LOCALHOST_ONLY': '1'} if os.environ.get('ROS_DISTRO') == 'humble' else \
    {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
#: Environment variables that would connect nodes with other machines.
_ELSEWHERE = 'ROS_STATIC_PEERS', 'ROS_DISCOVERY_SERVER'


@contextmanager
def private_domain() -> Iterator[int]:
    """
    Reserve a free ROS domain, and set the environment so that new nodes use this domain.

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
    """Return a domain without nodes, and a socket that keeps others from reserving the domain."""
    ours = os.environ.get('ROS_DOMAIN_ID')
    for number in _DOMAINS:
        if str(number) == ours:
            continue
        lock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with suppress(OSError):
            # The last port of a domain is its lock. The system frees it when this process ends.
            lock.bind(('127.0.0.1', _FIRST + _PORTS * (number + 1) - 1))
            if not _used(number):
                return number, lock
        lock.close()
    raise InputError(f'expected a free ROS domain from {_DOMAINS[-1]} to {_DOMAINS[0]}, found '
                     'nodes in all of them')


def _used(number: int) -> bool:
    """Return whether a process on this machine uses a port of a domain, except the lock port."""
    first = _FIRST + _PORTS * number
    for name in ('udp', 'udp6'):
        with suppress(OSError):  # only Linux has these tables
            for line in Path('/proc/net', name).read_text().splitlines()[1:]:
                if first <= int(line.split()[1].rpartition(':')[2], 16) < first + _PORTS - 1:
                    return True
    return False
