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

"""Compute on the workers of a Dask scheduler."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
import json
import logging
import math
from pathlib import Path
import pickle
from queue import Empty, SimpleQueue
import re
import socket
import time
from typing import Any, TYPE_CHECKING
import warnings

from rigid_body_ros.common.errors import InputError, quoted, reason
from rigid_body_ros.kernels.jit import sources_hash
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.runtime.fingerprint import fingerprint, NAME

if TYPE_CHECKING:  # takes a second to import, and only --scheduler needs it
    from distributed import Client, Future

#: Returns results for a list of items.
Function = Callable[[list[Any]], list[Any]]
#: Returns results for a list of items that no worker survives, and for the reason.
Died = Callable[[list[Any], str], list[Any]]

#: s; how long to try to connect, and how often to look for signals and new workers.
_PATIENCE, _INTERVAL = 10.0, 0.1
#: Tasks for each thread of the workers: one runs and one waits.
_AHEAD = 2
_ADDRESS = re.compile(r'\w+://.+|[^/\s]+:\d+')


@dataclass(frozen=True)
class Cluster:
    """
    A connection to a Dask scheduler.

    Attributes
    ----------
    name : str
        The scheduler, for messages.
    client : distributed.Client
    note : function
        Takes a line for the user.

    """

    name: str
    client: Client
    note: Callable[[str], None]

    def results(self, function: Function, items: Iterable[Any], died: Died,
                seconds: float = 0.0) -> Iterator[Any]:
        """
        Generate the results of a function for all items, in the order in which tasks finish.

        What a worker that dies had to compute is computed by others. If the iteration ends
        early, the tasks that did not begin are cancelled when the connection is closed.

        Parameters
        ----------
        function : function of a list of items
            Returns a list of results. Sent once to each worker, by pickle.
        items : iterable
            A task has consecutive ones, by pickle.
        died : function of a list of items and a reason
            Returns the results if all workers die that try to compute them.
        seconds : float, s
            Approximate duration of a task, which has at least one item.

        Raises
        ------
        InputError
            A worker has other versions, the connection is lost, or the function raised it.
        KeyboardInterrupt
            A signal was received.

        """
        work = _Work(self, function, deque(items), seconds)
        try:
            yield from work.results(died)
        except OSError as error:
            raise InputError(f'{self.name}: lost the connection to the scheduler: '
                             f'{reason(error)}') from error


@contextmanager
def connected(scheduler: str, note: Callable[[str], None]) -> Iterator[Cluster]:
    """
    Connect to a Dask scheduler, without any output of Dask.

    Parameters
    ----------
    scheduler : str
        Its address, such as tcp://10.0.0.1:8786, or the file that it wrote.
    note : function
        Takes a line for the user.

    Raises
    ------
    InputError
        The file cannot be read, or there is no scheduler at the address.

    """
    address = scheduler if _ADDRESS.fullmatch(scheduler) else _address_in(scheduler)
    with _quiet():
        client = _client(scheduler, address)
        with client:
            yield Cluster(scheduler, client, note)


def _address_in(path: str) -> str:
    """Return the address in a file of a scheduler."""
    try:
        address = json.loads(Path(path).read_text(encoding='utf-8'))['address']
    except OSError as error:
        raise InputError(f'{path}: cannot read the scheduler file: {reason(error)}; an address '
                         'is HOST:PORT or tcp://HOST:PORT') from error
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(f'{path}: expected the file of a Dask scheduler, JSON with an address, '
                         'found something else') from error
    if not isinstance(address, str) or not _ADDRESS.fullmatch(address):
        raise InputError(f'{path}: address: expected one such as tcp://HOST:PORT, found '
                         f'{quoted(address)}')
    return address


def _client(scheduler: str, address: str) -> Client:
    from distributed import Client
    try:
        kind = asyncio.run(_kind(address))
    except asyncio.TimeoutError as error:
        raise InputError(f'{scheduler}: expected a Dask scheduler, found no reply within '
                         f'{_PATIENCE:g} s') from error
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f'{scheduler}: cannot connect to a Dask scheduler: '
                         f'{reason(error)}') from error
    if kind != 'Scheduler':
        raise InputError(f'{scheduler}: expected a Dask scheduler, found a {kind.lower()}')
    return Client(address, timeout=_PATIENCE, set_as_default=False, name=NAME)


async def _kind(address: str) -> str:
    """Return what is at an address; a client that cannot connect would block at exit."""
    from distributed import rpc, Security
    remote = rpc(address, connection_args=Security().get_connection_args('client'))
    try:
        found = await asyncio.wait_for(remote.identity(), _PATIENCE)
        return str(found['type'])
    finally:
        await remote.close_rpc()


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the loggers and warnings of Dask; what matters is raised as well."""
    import dask
    from distributed.versions import VersionMismatchWarning
    before = logging.root.manager.disable
    logging.disable()
    try:
        with warnings.catch_warnings(), \
                dask.config.set({'distributed.admin.large-graph-warning-threshold': '1TB'}):
            warnings.simplefilter('ignore', VersionMismatchWarning)
            yield
    finally:
        logging.disable(before)


class _Work:
    """
    Items that are computed in tasks.

    Parameters
    ----------
    cluster : Cluster
    function : function of a list of items
    items : deque
    seconds : float, s
        Approximate duration of a task.

    """

    def __init__(self, cluster: Cluster, function: Function, items: deque[Any],
                 seconds: float) -> None:
        self._cluster, self._items, self._seconds = cluster, items, seconds
        # A task, unlike scattered data, is computed again if all workers die that have it.
        self._function = cluster.client.submit(bytes, pickle.dumps(function), pure=False)
        self._versions = _versions()
        self._busy: dict[Future, list[Any]] = {}
        self._done: SimpleQueue[Future] = SimpleQueue()
        #: Items per second of one thread, in the task that finished last.
        self._rate = 0.0
        self._has_workers = True

    def results(self, died: Died) -> Iterator[Any]:
        """Generate the results; `died` returns those of items which no worker survives."""
        self._submit()
        while self._busy:
            done = self._next()
            items = self._busy.pop(done)
            results = self._results(done, items, died)
            self._submit()
            yield from results

    def _submit(self) -> None:
        """Submit as many tasks as the workers can begin soon."""
        threads = sum(self._cluster.client.nthreads().values())
        if self._has_workers and not threads:
            self._cluster.note(f'{self._cluster.name}: no workers; waiting for one')
        self._has_workers = bool(threads)
        while self._items and len(self._busy) < _AHEAD * max(threads, 1):
            items = [self._items.popleft() for _ in range(self._size(threads))]
            call = pickle.dumps(_Call(self._versions, items), 5, buffer_callback=_out_of_band)
            task = self._cluster.client.submit(pickle.loads, call, buffers=[self._function],
                                               pure=False)
            self._busy[task] = items
            task.add_done_callback(self._done.put)

    def _size(self, threads: int) -> int:
        """Return the number of items for a task; towards the end, every thread gets some."""
        share = math.ceil(len(self._items) / (_AHEAD * max(threads, 1)))
        return max(1, min(round(self._rate * self._seconds), share))

    def _next(self) -> Future:
        while True:
            interrupts.check()
            try:
                return self._done.get(timeout=_INTERVAL)
            except Empty:
                self._submit()  # new workers may have joined

    def _results(self, done: Future, items: list[Any], died: Died) -> list[Any]:
        from distributed import KilledWorker
        try:
            results, seconds = done.result()
        except KilledWorker as error:
            return died(items, f'{error.allowed_failures + 1} workers died one after the other')
        except ImportError as error:
            raise InputError(f'{self._cluster.name}: a worker cannot import what it needs of '
                             f'{NAME}: {reason(error)}') from error
        except CancelledError as error:
            raise InputError(f'{self._cluster.name}: lost the connection to the '
                             'scheduler') from error
        self._rate = len(items) / max(seconds, 1e-9)
        return results


def _versions() -> dict[str, str]:
    """Return what has to be the same in all processes, so that their bits are the same."""
    return {**fingerprint(), 'scipy': version('scipy'),
            f'sources of {NAME}': sources_hash()[:12]}


@dataclass(frozen=True)
class _Call:
    """
    The call of `_compute`, made when its pickle is loaded; the function is a buffer of the pickle.

    The scheduler and the workers receive only bytes and `pickle.loads`. So a worker without this
    package, or with another version of it, reports an error; Dask would end its process.
    """

    versions: Mapping[str, str]
    items: list[Any]

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _compute, (self.versions, pickle.PickleBuffer(b''), self.items)


def _out_of_band(buffer: pickle.PickleBuffer) -> None:
    """Leave a buffer out of a pickle."""


def _compute(versions: Mapping[str, str], function: bytes, items: list[Any]
             ) -> tuple[list[Any], float]:
    """Return, on a worker, the results for some items, and how long they took, s."""
    for name, found in _versions().items():
        if found != versions.get(name):
            raise InputError(f'{socket.gethostname()}: expected the versions of this command, '
                             f'{name} {versions.get(name)}, found {found}; other versions may '
                             'give other bits')
    began = time.perf_counter()
    results = _loaded(function)(items)
    return results, time.perf_counter() - began


@lru_cache(maxsize=1)  # for all tasks of a worker
def _loaded(function: bytes) -> Function:
    loaded: Function = pickle.loads(function)
    return loaded
