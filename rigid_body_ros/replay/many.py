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

"""Many recordings in one call, by processes side by side."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import closing, ExitStack, redirect_stderr, suppress
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

from rigid_body_ros.common.errors import InputError
from rigid_body_ros.replay.single import bar, replay
from rigid_body_ros.runtime import files, interrupts
from rigid_body_ros.scene import Scene
from tqdm import tqdm

#: s; how often to look for signals.
_HEED_EVERY = 0.1
#: s; how long a process may clean up.
_PATIENCE = 10.0

#: A recording, and where its motion goes.
Task = tuple[str, str]


@dataclass(frozen=True)
class Outcome:
    """What became of a recording: where its motion is, in short what happened, or the error."""

    path: str
    output: str
    summary: str = ''
    error: str = ''


def replay_many(paths: Sequence[str], scene: Scene, folder: str | Path,
                **options: Any) -> list[Outcome]:
    """
    Replay recordings into a folder, as files of their names (see `outputs_in`).

    Parameters
    ----------
    paths : sequence of str
        The recordings.
    scene : Scene
        One for all of them.
    folder : str or Path
        Created if it does not exist.
    options
        As of `replay`.

    Returns
    -------
    list of Outcome
        In the order of the paths.

    Raises
    ------
    InputError
        The folder cannot be created, two outputs would have one name, or one of them would
        replace a recording or the scene, or lie inside the folder of a bag that is read.

    """
    with files.reading(*paths), files.protected('scene', scene.path):
        outputs = outputs_in(folder, paths)
        with files.reported(folder):
            Path(folder).mkdir(parents=True, exist_ok=True)
        with closing(_side_by_side([*zip(paths, outputs)], scene, options)) as outcomes:
            done = list(bar('recordings', ' files')(outcomes, len(paths)))
    return sorted(done, key=lambda outcome: outputs.index(outcome.output))


def outputs_in(folder: str | Path, paths: Sequence[str]) -> list[str]:
    """
    Return where the motions of recordings go: to FOLDER/NAME.mcap.

    NAME is that of the recording without `.mcap`, `.db3` or `.csv`, and without `.zst` or `.zstd`
    after it. Any other dot is part of the name.

    Raises
    ------
    InputError
        Two recordings have one name, the folder has the name of a file, or an output is
        protected (see `files.protected`).

    """
    suffix = files.format_of(folder)
    if suffix and not os.path.isdir(folder):
        raise InputError(f'{folder}: expected a folder for several recordings, found a name that '
                         f'ends in {suffix}')
    outputs: dict[str, str] = {}
    with ExitStack() as earlier:
        for path in paths:
            output = str(Path(folder) / f'{_name(path)}.mcap')
            if output in outputs:
                raise InputError(f'{output}: expected recordings of different names, found '
                                 f'{outputs[output]} and {path}')
            files.check_apart(output)
            earlier.enter_context(files.protected('output', output))
            outputs[output] = path
    return [*outputs]


def table(outcomes: Sequence[Outcome]) -> str:
    """Return a line a recording."""
    width = max(len(outcome.path) for outcome in outcomes)
    lines = [f'{outcome.path:{width}}  {outcome.summary or f"failed: {outcome.error}"}'
             for outcome in outcomes]
    failed = sum(bool(outcome.error) for outcome in outcomes)
    return '\n'.join([*lines, f'{len(outcomes) - failed} of {len(outcomes)} written'])


def _name(path: str) -> str:
    name = os.path.basename(os.path.abspath(path))  # of '.' that of the folder
    return re.sub(r'(?<=.)(\.(mcap|db3|csv))?(\.zstd?)?$', '', name, flags=re.IGNORECASE)


def _side_by_side(tasks: Sequence[Task], scene: Scene, options: dict[str, Any]
                  ) -> Generator[Outcome]:
    """Generate what becomes of each, in the order in which processes get through."""
    waiting = [*reversed(tasks)]
    idle: list[_Worker] = []
    busy: list[_Worker] = []
    try:
        while waiting or busy:
            while waiting and len(busy) < (os.cpu_count() or 1):
                busy.append(idle.pop() if idle else _Worker([path for path, _ in tasks]))
                busy[-1].begin(waiting.pop(), scene, options)
            ready = wait([worker.connection for worker in busy], _HEED_EVERY)
            for worker in [worker for worker in busy if worker.connection in ready]:
                busy.remove(worker)
                outcome = worker.result()
                if worker.is_there:
                    idle.append(worker)
                yield outcome
            interrupts.heed()
    finally:
        for worker in busy:
            worker.interrupt()
        for worker in [*idle, *busy]:
            worker.end()


class _Worker:
    """
    A process that replays recordings, one at a time.

    Parameters
    ----------
    inputs : sequence of str
        All recordings, which no output may replace.

    """

    def __init__(self, inputs: Sequence[str]) -> None:
        # Spawned: a fork would take over half of what threads of this process are about.
        context = multiprocessing.get_context('spawn')
        self.connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, inputs), daemon=True)
        with interrupts.kept_from_children():
            self._process.start()
        theirs.close()  # or the end of the process would not be seen
        self.is_there = True

    def begin(self, task: Task, scene: Scene, options: dict[str, Any]) -> None:
        self._task = task
        with suppress(OSError):  # it has ended, which the result will tell
            self.connection.send((task, scene, options))

    def result(self) -> Outcome:
        try:
            outcome: Outcome = self.connection.recv()
        except (EOFError, OSError):
            self._process.join()
            self.is_there = False
            return Outcome(*self._task, error=f'{self._task[0]}: the process at work on it ended '
                           f'with status {self._process.exitcode}')
        return outcome

    def interrupt(self) -> None:
        self._process.terminate()

    def end(self) -> None:
        self.connection.close()
        self._process.join(_PATIENCE)
        self._process.kill()  # if it is stopped, say
        self._process.join()


def _serve(connection: Connection, inputs: Sequence[str]) -> None:
    # What it would take otherwise is left over where a process is killed.
    tqdm.set_lock(threading.RLock())
    with suppress(KeyboardInterrupt), interrupts.listening(to_the_end=True), \
            files.reading(*inputs):
        for work in iter(partial(_received, connection), None):
            with redirect_stderr(io.StringIO()):  # one progress bar is enough
                outcome = _outcome(*work)
            with suppress(OSError):  # nobody is there any more
                connection.send(outcome)


def _received(connection: Connection) -> Any:
    try:
        return connection.recv()
    except (EOFError, OSError):
        return None


def _outcome(task: Task, scene: Scene, options: dict[str, Any]) -> Outcome:
    path, output = task
    try:
        result = replay(path, scene, output, **options)
    except InputError as error:
        return Outcome(path, output, error=str(error))
    lost = f'; lost: {result.damage}' if result.damage else ''
    return Outcome(path, output, f'{result.messages} torques, '
                   f'{(result.last.time_ns - result.start.time_ns) * 1e-9:.9g} s -> {output}; '
                   f'{result.check}{lost}')
