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

"""Compute the runs that a folder lacks, by threads; the kernels release Python's lock."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from itertools import islice
from typing import Any

from rigid_body_ros.ensemble.folder import Folder
from rigid_body_ros.ensemble.runs import Columns, Ensemble

#: Wraps an iteration over blocks with a total number of runs, to show progress.
Track = Callable[[Iterable[Any], int], Iterable[Any]]
#: The first run of a block, the one after its last, and its rows.
Block = tuple[int, int, Columns]


def compute(ensemble: Ensemble, folder: Folder, workers: int, track: Track) -> None:
    """
    Compute and write all runs that a folder lacks.

    Raises
    ------
    InputError
        The folder cannot be written.
    KeyboardInterrupt
        A signal was received. The folder keeps all blocks that are complete.

    """
    spans = folder.missing()
    runs = sum(stop - first for first, stop in spans)
    try:
        for block in track(_computed(ensemble, spans, workers), runs):
            folder.add(*block)
    except KeyboardInterrupt as interrupt:
        interrupt.args += (f'; the same command goes on with what is in {folder.path}',)
        raise
    folder.complete()


def runs_of(block: Block) -> int:
    """Return the number of runs of a block."""
    return block[1] - block[0]


def _computed(ensemble: Ensemble, spans: list[tuple[int, int]], workers: int) -> Iterator[Block]:
    """Generate the blocks in the order in which they are complete, and only some ahead."""
    def compute_block(span: tuple[int, int]) -> Block:
        return *span, ensemble.rows(*span)
    waiting = iter(spans)
    pool = ThreadPoolExecutor(workers)
    try:
        busy: set[Future[Block]] = {pool.submit(compute_block, span)
                                    for span in islice(waiting, 2 * workers)}
        while busy:
            done, busy = wait(busy, return_when=FIRST_COMPLETED)
            busy |= {pool.submit(compute_block, span) for span in islice(waiting, len(done))}
            for future in done:
                yield future.result()
    finally:
        pool.shutdown(cancel_futures=True)
