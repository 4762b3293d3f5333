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

"""Replay many recordings in parallel."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, ExitStack, redirect_stderr, suppress
from dataclasses import dataclass
from functools import partial
import io
import multiprocessing
from multiprocessing.connection import Connection, wait
import os
from pathlib import Path
import re
import threading
from typing import Any

from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.replay.batches import Collector
from rigid_body_ros.replay.single import replay
from rigid_body_ros.report.text import lines
from rigid_body_ros.runtime import files, interrupts
from rigid_body_ros.runtime.terminal import progress
from rigid_body_ros.scene import Scene
from tqdm import tqdm

#: s; how often to check for signals.
_CHECK_INTERVAL = 0.1
#: s; how long a worker process may take to clean up.
_PATIENCE = 10.0
#: Names of partial outputs.
_PARTIAL = '*.partial*.mcap'

#: A recording and the output for its motion.
Task = tuple[str, str]


@dataclass(frozen=True)
class Outcome:
    """
    The result for one recording: its output and a short summary, or the error.

    `collected` is what `collect` of the options of `replay` returned.
    """

    path: str
    output: str
    summary: str = ''
    error: str = ''
    collected: Collector | None = None


#: Generates the outcomes of tasks, with the options of `replay`, in any order.
Pool = Callable[[Sequence[Task], Scene, dict[str, Any]], Generator[Outcome]]


def replay_many(paths: Sequence[str], scene: Scene, folder: str | Path,
                pool: Pool | None = None, **options: Any) -> list[Outcome]:
    """
    Replay recordings into a folder, each to a file of the same name (see `outputs_in`).

    Parameters
    ----------
    paths : sequence of str
        The recordings.
    scene : Scene
        The scene of all recordings.
    folder : str or Path
        Created if it does not exist.
    pool : Pool, optional
        What replays them (default: a process for each processor).
    options
        As for `replay`.

    Returns
    -------
    list of Outcome
        In the order of the recordings.

    Raises
    ------
    InputError
        The folder cannot be created, two outputs would have the same name, or an output would
        replace a recording or the scene, or lie in the folder of a bag.
    KeyboardInterrupt
        A signal was received; its last argument names the partial outputs, if there are any.

    """
    with files.reading(*paths), files.protected('scene', scene.path):
        outputs = outputs_in(folder, paths)
        with files.reported(folder):
            Path(folder).mkdir(parents=True, exist_ok=True)
        with _partial_outputs_reported(Path(folder)), \
                closing((pool or _in_processes)([*zip(paths, outputs)], scene, options)
                        ) as outcomes:
            done = list(progress('recordings', ' files')(outcomes, len(paths)))
    return sorted(done, key=lambda outcome: outputs.index(outcome.output))


def outputs_in(folder: str | Path, paths: Sequence[str]) -> list[str]:
    """
    Return the outputs for the motions of recordings: FOLDER/NAME.mcap.

    NAME is the name of the recording without `.mcap`, `.db3` or `.csv` and without a `.zst` or
    `.zstd` that follows. Any other dot is part of the name.

    Raises
    ------
    InputError
        Two recordings have the same name, the folder has the name of a file, or an output is
        protected (see `files.protected`) or exists and must not be overwritten.

    """
    suffix = files.format_of(folder)
    if suffix and not os.path.isdir(folder):
        raise InputError(f'{folder}: expected a folder for several recordings, found a name '
                         f'ending in {suffix}')
    outputs: dict[str, str] = {}
    with ExitStack() as earlier:
        for path in paths:
            output = str(Path(folder) / f'{_name(path)}.mcap')
            if output in outputs:
                raise InputError(f'{output}: expected recordings with different names, found '
                                 f'{outputs[output]} and {path}')
            files.check_apart(output)
            files.check_new(output)
            earlier.enter_context(files.protected('output', output))
            outputs[output] = path
    return [*outputs]


def table(outcomes: Sequence[Outcome]) -> str:
    """Return a table with one line per recording."""
    width = max(len(outcome.path) for outcome in outcomes)
    rows = [f'{outcome.path:{width}}  {outcome.summary or f"failed: {outcome.error}"}'
            for outcome in outcomes]
    failed = sum(bool(outcome.error) for outcome in outcomes)
    return lines([*rows, f'{len(outcomes) - failed} of {len(outcomes)} written'])


def _name(path: str) -> str:
    name = os.path.basename(os.path.abspath(path))  # '.' becomes the name of the folder
    return re.sub(r'(?<=.)(\.(mcap|db3|csv))?(\.zstd?)?$', '', name, flags=re.IGNORECASE)


@contextmanager
def _partial_outputs_reported(folder: Path) -> Iterator[None]:
    """Add the names of new partial outputs to a KeyboardInterrupt."""
    before = {*folder.glob(_PARTIAL)}
    try:
        yield
    except KeyboardInterrupt as interrupt:
        partial = sorted(path.name for path in {*folder.glob(_PARTIAL)} - before)
        if partial:
            interrupt.args += (f'; what was written so far is in {folder}: {listed(partial)}',)
        raise


def _in_processes(tasks: Sequence[Task], scene: Scene, options: dict[str, Any]
                  ) -> Generator[Outcome]:
    """Generate the outcomes in the order in which the workers finish."""
    waiting = [*reversed(tasks)]
    idle: list[_Worker] = []
    busy: list[_Worker] = []
    try:
        while waiting or busy:
            while waiting and len(busy) < (os.cpu_count() or 1):
                busy.append(idle.pop() if idle else _Worker([path for path, _ in tasks]))
                busy[-1].begin(waiting.pop(), scene, options)
            ready = wait([worker.connection for worker in busy], _CHECK_INTERVAL)
            for worker in [worker for worker in busy if worker.connection in ready]:
                busy.remove(worker)
                outcome = worker.result()
                if worker.is_alive:
                    idle.append(worker)
                yield outcome
            interrupts.check()
    finally:
        for worker in busy:
            worker.interrupt()
        for worker in [*idle, *busy]:
            worker.end()


class _Worker:
    """
    A worker process that replays one recording at a time.

    Parameters
    ----------
    inputs : sequence of str
        All recordings; no output may replace them.

    """

    def __init__(self, inputs: Sequence[str]) -> None:
        # Spawn, because a fork would copy the locks of threads but not the threads.
        context = multiprocessing.get_context('spawn')
        self.connection, theirs = context.Pipe()
        self._process = context.Process(
            target=_run_worker, args=(theirs, inputs, files.may_overwrite()), daemon=True)
        with interrupts.blocked_in_children():
            self._process.start()
        theirs.close()  # otherwise the end of the process would go unnoticed
        self.is_alive = True

    def begin(self, task: Task, scene: Scene, options: dict[str, Any]) -> None:
        self._task = task
        with suppress(OSError):  # the process has died; `result` reports it
            self.connection.send((task, scene, options))

    def result(self) -> Outcome:
        try:
            outcome: Outcome = self.connection.recv()
        except (EOFError, OSError):
            self._process.join()
            self.is_alive = False
            code = self._process.exitcode or 0
            end = f'killed (signal {-code})' if code < 0 else f'exited with status {code}'
            return Outcome(*self._task, error=f'{self._task[0]}: worker process {end}')
        return outcome

    def interrupt(self) -> None:
        self._process.terminate()

    def end(self) -> None:
        self.connection.close()
        self._process.join(_PATIENCE)
        self._process.kill()  # in case it does not respond
        self._process.join()


def _run_worker(connection: Connection, inputs: Sequence[str], overwrite: bool) -> None:
    # Replace the default lock, a semaphore, which stays in the system if the process is killed.
    tqdm.set_lock(threading.RLock())
    with suppress(KeyboardInterrupt), interrupts.deferred(until_exit=True), \
            files.reading(*inputs), files.overwriting(overwrite):
        for work in iter(partial(_next_task, connection), None):
            with redirect_stderr(io.StringIO()):  # one progress bar is enough
                outcome = replayed(*work)
            with suppress(OSError):  # the parent process has exited
                connection.send(outcome)


def _next_task(connection: Connection) -> Any:
    """Return a task with scene and options; None if the parent process has exited."""
    try:
        return connection.recv()
    except (EOFError, OSError):
        return None


def replayed(task: Task, scene: Scene, options: dict[str, Any]) -> Outcome:
    """Return the result for one recording."""
    path, output = task
    try:
        result = replay(path, scene, output, **options)
    except InputError as error:
        return Outcome(path, output, error=str(error))
    lost = f'; lost: {result.damage}' if result.damage else ''
    warned = ''.join(f'; warning: {gaps.warning}' for gaps in result.gaps if gaps.warning)
    epochs = f'{len(result.earlier) + 1} epochs, the last: ' if result.earlier else ''
    return Outcome(path, output, f'{epochs}{result.messages} torques, '
                   f'{(result.last.time_ns - result.start.time_ns) * 1e-9:.9g} s -> {output}; '
                   f'{result.check}{lost}{warned}', collected=result.collected)
