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

"""Compute in threads or processes; see `cluster` for the workers of a Dask scheduler."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, suppress
from itertools import islice
import multiprocessing
from multiprocessing.connection import Connection
import os
from threading import Thread
from typing import Any

from rigid_body_ros.runtime import interrupts

#: How often to check for signals and for new workers, s.
_INTERVAL = 0.1
#: How long a worker process may take to clean up, s.
_PATIENCE = 10.0


class WorkerError(Exception):
    """Raised if the process that computes an item has died; the message says how it died."""


class Workers(AbstractContextManager['Workers']):
    """
    A pool of threads, for functions that release the global interpreter lock; a context manager.

    Parameters
    ----------
    workers : int
        The number of threads.

    """

    #: Into how many parts it may pay to divide an item if the workers would accept more items.
    parts = 1

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._executor: Executor = ThreadPoolExecutor(workers)

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if kind:
            interrupts.abandon_threads()
        self._executor.shutdown(wait=False, cancel_futures=True)

    def results(self, function: Callable[[Any], Any], items: Iterable[Any],
                died: Callable[[Any, WorkerError], Any] | None = None) -> Iterator[Any]:
        """
        Apply a function to all items, and generate the results in the order they are completed.

        Parameters
        ----------
        function : callable
            Takes an item.
        items : iterable
            The items. The next item is taken when a worker becomes idle.
        died : callable, optional
            Called with an item whose worker has died, and with the WorkerError; returns the result
            to use for that item.

        Raises
        ------
        WorkerError
            A worker has died, and `died` is not given.
        KeyboardInterrupt
            A signal was received.

        """
        waiting, busy = iter(items), dict[Future[Any], Any]()
        while True:
            for item in islice(waiting, max(self.ahead() - len(busy), 0)):
                busy[self._submit(function, item)] = item
            if not busy:
                return
            done, _ = wait(busy, _INTERVAL, FIRST_COMPLETED)
            interrupts.check()
            for future in done:
                item = busy.pop(future)
                try:
                    result = self._result(future)
                except WorkerError as error:
                    if died is None:
                        raise
                    result = died(item, error)
                yield result

    def ahead(self) -> int:
        """Return how many items to submit: two for each worker, of which one waits."""
        return 2 * self._workers

    def _submit(self, function: Callable[[Any], Any], item: Any) -> Future[Any]:
        return self._executor.submit(function, item)

    def _result(self, future: Future[Any]) -> Any:
        return future.result()


class Processes(Workers):
    """
    A pool of processes. If a process dies, only the item that it was computing is affected.

    Functions, items and results are pickled.

    Parameters
    ----------
    workers : int, optional
        The number of processes; by default, one per processor.

    """

    def __init__(self, workers: int | None = None) -> None:
        super().__init__(workers or os.cpu_count() or 1)
        self._last: dict[_Process, Future[Any]] = {}

    def __exit__(self, *error: object) -> None:
        for process, future in self._last.items():
            if future.done():
                process.connection.close()
            else:
                process.process.terminate()
        for process in self._last:
            process.wait(_PATIENCE)
        super().__exit__(None)

    def ahead(self) -> int:
        """Return how many items to submit: one for each process, so that no item has to wait."""
        return self._workers

    def _submit(self, function: Callable[[Any], Any], item: Any) -> Future[Any]:
        idle = (process for process, future in self._last.items()
                if future.done() and not future.exception())
        process = next(idle, None) or _Process(_serve)
        self._last[process] = super()._submit(process.call, (function, item))
        return self._last[process]


class Child:
    """
    A process, and a connection to it.

    Parameters
    ----------
    target : callable
        The function that the process runs. Its first argument is the other end of the connection.
    arguments
        Further arguments of the function.

    """

    def __init__(self, target: Callable[..., None], *arguments: object) -> None:
        # Use spawn, because a fork would copy the locks that threads hold, but not the threads
        # that release them.
        context = multiprocessing.get_context('spawn')
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=target, args=(theirs, *arguments), daemon=True)
        with interrupts.blocked_in_children():
            self.process.start()
        theirs.close()  # otherwise we would not notice if the process ends

    def wait(self, seconds: float) -> None:
        """Wait until the process has ended, and kill it after the given time."""
        self.process.join(seconds)
        self.process.kill()  # in case it does not respond
        self.process.join()


class _Process(Child):
    """A process that computes one item at a time."""

    def call(self, work: tuple[Callable[[Any], Any], Any]) -> Any:
        try:
            self.connection.send(work)
            return self.connection.recv()
        except (EOFError, OSError):
            self.process.join()
            code = self.process.exitcode or 0
            end = f'killed (signal {-code})' if code < 0 else f'exited with status {code}'
            raise WorkerError(f'worker process {end}') from None


def _serve(connection: Connection) -> None:
    Thread(target=_end_with_parent, daemon=True).start()
    with suppress(KeyboardInterrupt), interrupts.deferred(until_exit=True):
        for function, item in _received(connection):
            result = function(item)
            with suppress(OSError):  # the parent process has exited
                connection.send(result)


def _end_with_parent() -> None:
    """End this process when its parent process ends, even if a user's function still runs."""
    if parent := multiprocessing.parent_process():
        parent.join()
        os._exit(1)


def _received(connection: Connection) -> Iterator[Any]:
    """Generate incoming messages until the connection is closed or the parent exits."""
    with suppress(EOFError, OSError):
        while True:
            yield connection.recv()
