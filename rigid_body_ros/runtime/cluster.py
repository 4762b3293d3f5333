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
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from functools import lru_cache
from importlib.metadata import version
import logging
import pickle
import re
import socket
from typing import Any, TYPE_CHECKING
import warnings

from rigid_body_ros.common.errors import InputError, quoted, reason
from rigid_body_ros.runtime.fingerprint import fingerprint, NAME, package_hash
from rigid_body_ros.runtime.limits import read_json
from rigid_body_ros.runtime.pool import WorkerError, Workers

if TYPE_CHECKING:  # importing distributed takes a second, and only --scheduler needs it
    from distributed import Client

#: How long to try to connect, s.
_PATIENCE = 10.0
_ADDRESS = re.compile(r'\w+://.+|[^/\s]+:\d+')
#: Unpickles a function; all tasks on a worker share one function.
_loaded = lru_cache(maxsize=1)(pickle.loads)


class Cluster(Workers):
    """
    The workers of a Dask scheduler; see `connected`.

    If a worker dies, its items are computed by other workers. Functions, items and results are
    pickled, and each worker receives a function only once.

    Parameters
    ----------
    name : str
        The name of the scheduler, for messages.
    client : distributed.Client
    note : callable
        Shows a line of text to the user.

    """

    #: Dask spends about 20 ms of overhead on each part.
    parts = 8

    def __init__(self, name: str, client: Client, note: Callable[[str], None]) -> None:
        self.client = client
        self._name, self._note, self._has_workers = name, note, True
        self._executor = client.get_executor(pure=False)
        self._versions = _versions()

    def ahead(self) -> int:
        """
        Return how many items to submit, by the same rule as `Workers`.

        Each call counts the workers again, because more workers may join at any time.
        """
        threads = sum(self.client.nthreads().values())
        if self._has_workers and not threads:
            self._note(f'{self._name}: no workers; waiting for one')
        self._has_workers, self._workers = bool(threads), max(threads, 1)
        return super().ahead()

    def results(self, function: Callable[[Any], Any], items: Iterable[Any],
                died: Callable[[Any, WorkerError], Any] | None = None) -> Iterator[Any]:
        """
        Generate the results of a function for all items, like `Workers.results`.

        Raises
        ------
        InputError
            The software versions on a worker differ from those of this process, the connection is
            lost, or the function raised InputError.
        KeyboardInterrupt
            A signal was received.

        """
        # Submit the function as a task. If all workers that hold the function die, Dask runs the
        # task again; if the function were scattered as data, it would be lost.
        self._function = self.client.submit(bytes, pickle.dumps(function), pure=False)
        try:
            yield from super().results(function, items, died)
        except OSError as error:
            raise InputError(f'{self._name}: lost the connection to the scheduler: '
                             f'{reason(error)}') from error

    def _submit(self, function: Callable[[Any], Any], item: Any) -> Future[Any]:
        call = pickle.dumps(_Call((self._versions, pickle.PickleBuffer(b''), item)), 5,
                            buffer_callback=list[Any]().append)  # out of band: returns None
        return self._executor.submit(pickle.loads, call, buffers=[self._function])

    def _result(self, future: Future[Any]) -> Any:
        from distributed import KilledWorker
        try:
            return future.result()
        except KilledWorker as error:
            raise WorkerError(f'{error.allowed_failures + 1} workers died one after the other; '
                              'their logs may have the reason') from error
        except ImportError as error:
            raise InputError(f'{self._name}: a worker cannot import what it needs of {NAME}: '
                             f'{reason(error)}') from error
        except CancelledError as error:
            raise InputError(f'{self._name}: lost the connection to the scheduler') from error


@contextmanager
def connected(scheduler: str, note: Callable[[str], None]) -> Iterator[Cluster]:
    """
    Connect to a Dask scheduler, and silence the output of Dask.

    Parameters
    ----------
    scheduler : str
        The address of the scheduler, such as tcp://10.0.0.1:8786, or the path of the file to which
        the scheduler has written its address.
    note : callable
        Shows a line of text to the user.

    Raises
    ------
    InputError
        The scheduler file cannot be read, or no scheduler responds at the address.

    """
    address = scheduler if _ADDRESS.fullmatch(scheduler) else _address_in(scheduler)
    with _quiet(), _client(scheduler, address) as client:
        yield Cluster(scheduler, client, note)


def _address_in(path: str) -> str:
    """Read the address of a scheduler from the file that the scheduler has written."""
    data = read_json(path, 'scheduler file (an address is HOST:PORT or tcp://HOST:PORT)')
    address = data.get('address') if isinstance(data, dict) else None
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
    """
    Find out what kind of server is at an address.

    The address is contacted without a `Client`, because a `Client` that cannot connect makes
    Python hang at exit.
    """
    from distributed import rpc, Security
    remote = rpc(address, connection_args=Security().get_connection_args('client'))
    try:
        identity = await asyncio.wait_for(remote.identity(), _PATIENCE)
        return str(identity['type'])
    finally:
        await remote.close_rpc()


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence Dask's loggers and warnings within a context; exceptions are still raised."""
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


def _versions() -> dict[str, str]:
    """Return the versions that must agree so that all processes compute the same bits."""
    return {**fingerprint(), 'scipy': version('scipy'),
            f'sources of {NAME}': package_hash()[:12]}


class _Call(tuple[Any, ...]):
    """
    The arguments of `_compute`, which is called when a worker unpickles this object.

    The user's function is passed as an out-of-band buffer, so the scheduler and the workers only
    see bytes and `pickle.loads`. A worker that has a different version of this package, or does
    not have the package at all, can then report an error. If such a worker received the function
    itself, Dask would end the worker process.
    """

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _compute, tuple(self)


def _compute(versions: Mapping[str, str], function: bytes, item: Any) -> Any:
    """Apply the function to an item; called in a worker."""
    for name, here in _versions().items():
        if here != versions.get(name):
            raise InputError(f'{socket.gethostname()}: expected the versions of this command, '
                             f'{name} {versions.get(name)}, found {here}; other versions may give '
                             'other bits')
    return _loaded(function)(item)
