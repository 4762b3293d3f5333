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

"""Compute the runs that a folder lacks: in threads, or on the workers of a Dask scheduler."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing
from functools import partial
from itertools import groupby, islice
import math
from operator import itemgetter
from typing import NoReturn, TYPE_CHECKING

import numpy as np
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.ensemble.runs import Columns, Ensemble, Span
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.runtime.cluster import connected
from rigid_body_ros.runtime.terminal import Track

if TYPE_CHECKING:  # a worker needs no Parquet
    from rigid_body_ros.ensemble.folder import Folder

#: Wraps an iteration over blocks with a total number of runs, to show progress.
#: A span and its rows.
Block = tuple[int, int, Columns]
#: Generates the blocks of an ensemble in the order in which they are complete.
Pool = Callable[[Ensemble, list[Span]], Generator[Block]]
#: The span of a block, and that of a part of it.
Part = tuple[Span, Span]

#: s; how often to look for signals.
_INTERVAL = 0.1
#: Number of parts of a block, which different workers may compute: a block may take minutes.
_PARTS = 8
#: s; how long a task is computed on a worker: long enough for Dask's cost per task, a few
#: milliseconds, not to matter, and short enough to lose little with a worker. With motions the
#: results of a task are some 10 MB for each tenth of a second.
_TASK, _TASK_WITH_MOTIONS = 2.0, 0.25


def compute(ensemble: Ensemble, folder: Folder, pool: Pool, track: Track) -> None:
    """
    Compute and write all runs that a folder lacks.

    Raises
    ------
    InputError
        The folder cannot be written, or the pool fails.
    KeyboardInterrupt
        A signal was received. The folder keeps all blocks that are complete.

    """
    spans = folder.missing()
    runs = sum(stop - first for first, stop in spans)
    with closing(pool(ensemble, spans)) as blocks:
        for block in track(blocks, runs):
            folder.add(*block)
    folder.complete()


def runs_of(block: Block) -> int:
    """Return the number of runs of a block."""
    return block[1] - block[0]


def threads(workers: int) -> Pool:
    """Return a pool of threads; the kernels release Python's lock."""
    def blocks(ensemble: Ensemble, spans: list[Span]) -> Generator[Block]:
        waiting = iter(spans)
        pool = ThreadPoolExecutor(workers)
        try:
            busy: set[Future[Block]] = {pool.submit(_block, ensemble, span)
                                        for span in islice(waiting, 2 * workers)}
            while busy:
                done, busy = wait(busy, _INTERVAL, FIRST_COMPLETED)
                interrupts.check()
                busy |= {pool.submit(_block, ensemble, span)
                         for span in islice(waiting, len(done))}
                for future in done:
                    yield future.result()
        except BaseException:  # also if the consumer stops
            interrupts.abandon_threads()
            raise
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    return blocks


def cluster(scheduler: str, note: Callable[[str], None]) -> Pool:
    """Return the workers of a Dask scheduler, with the arguments and errors of `connected`."""
    def died(parts: Sequence[Part], why: str) -> NoReturn:
        raise InputError(f'{scheduler}: cannot compute runs {parts[0][1][0]} to '
                         f'{parts[-1][1][1] - 1}: {why}; their logs may have the reason')

    def blocks(ensemble: Ensemble, spans: list[Span]) -> Generator[Block]:
        if spans:
            parts = [part for span in spans for part in _parts(span)]
            seconds = _TASK if ensemble.times_ns is None else _TASK_WITH_MOTIONS
            with connected(scheduler, note) as found:
                yield from _joined(found.results(partial(_computed, ensemble), parts, died,
                                                 seconds))
    return blocks


def _block(ensemble: Ensemble, span: Span) -> Block:
    return *span, ensemble.rows(*span)


def _parts(span: Span) -> Iterator[Part]:
    size = math.ceil((span[1] - span[0]) / _PARTS)
    for first in range(*span, size):
        yield span, (first, min(first + size, span[1]))


def _computed(ensemble: Ensemble, parts: Sequence[Part]) -> list[tuple[Span, Block]]:
    """Compute, on a worker, consecutive parts; those of a block at once, which is faster."""
    found = []
    for span, same in groupby(parts, itemgetter(0)):
        spans = [part for _, part in same]
        found.append((span, _block(ensemble, (spans[0][0], spans[-1][1]))))
    return found


def _joined(parts: Iterable[tuple[Span, Block]]) -> Iterator[Block]:
    """Generate each block as soon as all of its parts are there."""
    waiting: dict[Span, list[Block]] = {}
    for span, part in parts:
        found = waiting.setdefault(span, [])
        found.append(part)
        if sum(map(runs_of, found)) == span[1] - span[0]:
            found.sort(key=itemgetter(0))
            yield *span, {name: np.concatenate([columns[name] for *_, columns in found])
                          for name in part[2]}
            del waiting[span]
