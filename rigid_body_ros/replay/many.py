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
from contextlib import closing, contextmanager, ExitStack, redirect_stderr
from dataclasses import dataclass, field, replace
from functools import partial
import io
import os
from pathlib import Path
import re
import socket
from tempfile import TemporaryDirectory
import threading
from typing import Any

from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.replay.result import Replay
from rigid_body_ros.replay.single import replay
from rigid_body_ros.report.text import lines
from rigid_body_ros.runtime import files, protection
from rigid_body_ros.runtime.cluster import connected
from rigid_body_ros.runtime.pool import Processes, WorkerError
from rigid_body_ros.runtime.terminal import progress
from rigid_body_ros.scene import Scene
from tqdm import tqdm

#: Matches the file names of partial outputs.
_PARTIAL = '*.partial*.mcap'
#: The width and height of a picture, in SVG units, and the largest number of intervals in a curve.

#: The path of a recording, and the path of the output for its motion.
Task = tuple[str, str]


@dataclass(frozen=True)
class Outcome:
    """The outcome of replaying one recording: its output and a short summary, or the error."""

    path: str
    output: str
    summary: str = ''
    error: str = ''


Pool = Callable[[Sequence[Task], '_Replay'], Generator[Outcome]]


def replay_many(paths: Sequence[str], scene: Scene, folder: str | Path,
                pool: Pool | None = None, **options: Any) -> list[Outcome]:
    """
    Replay recordings, and write each motion to a file in a folder; `outputs_in` names the files.

    Parameters
    ----------
    paths : sequence of str
        The recordings.
    scene : Scene
        The scene that all recordings share.
    folder : str or Path
        The folder for the outputs, which is created if it does not exist.
    pool : Pool, optional
        The function that runs the replays. By default, they run in one process per processor.
    options
        Options for `replay`.

    Returns
    -------
    list of Outcome
        The outcomes in the order of the recordings.

    Raises
    ------
    InputError
        The folder cannot be created; two outputs would have the same name; an output would replace
        a recording or the scene; or an output would be in the folder of a bag.
    KeyboardInterrupt
        A signal was received. If there are partial outputs, the last argument of the exception
        contains their names.

    """
    with protection.reading(*paths, scene=scene.path):
        outputs = outputs_in(folder, paths)
        with files.reported(folder):
            Path(folder).mkdir(parents=True, exist_ok=True)
        with _partial_outputs_reported(Path(folder)), \
                closing((pool or _in_processes)(
                    [*zip(paths, outputs)], _Replay(paths, scene, options))) as outcomes:
            done = list(progress('recordings', ' files')(outcomes, len(paths)))
    return sorted(done, key=lambda outcome: outputs.index(outcome.output))


def outputs_in(folder: str | Path, paths: Sequence[str]) -> list[str]:
    """
    Return the names of the output files for recordings: FOLDER/NAME.mcap.

    NAME is the name of the recording without `.mcap`, `.db3` or `.csv`, and without any `.zst` or
    `.zstd` after that suffix. Other dots are part of the name.

    Raises
    ------
    InputError
        Two recordings have the same name; `folder` has the suffix of a file format, but is not a
        folder; an output is protected (see `protection.protected`); or an output exists and must
        not be overwritten.

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
            protection.check_apart(output)
            files.check_new(output)
            earlier.enter_context(protection.protected('output', output))
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
    suffixes = r'(?<=.)(\.(mcap|db3|csv))?(\.zstd?)?$'
    name = os.path.basename(os.path.abspath(path))  # turns '.' into the current folder's name
    return re.sub(suffixes, '', name, flags=re.IGNORECASE)


@contextmanager
def _partial_outputs_reported(folder: Path) -> Iterator[None]:
    """If KeyboardInterrupt is raised, add the names of new partial outputs to the exception."""
    before = {*folder.glob(_PARTIAL)}
    try:
        yield
    except KeyboardInterrupt as interrupt:
        partial = sorted(path.name for path in {*folder.glob(_PARTIAL)} - before)
        if partial:
            interrupt.args += (f'; what was written so far is in {folder}: {listed(partial)}',)
        raise


def _in_processes(tasks: Sequence[Task], replay: _Replay) -> Generator[Outcome]:
    """Replay recordings in processes, and generate the outcomes in the order of completion."""
    with Processes() as processes:
        yield from processes.results(partial(_in_process, replay), tasks, _died)


def on_cluster(scheduler: str, note: Callable[[str], None]) -> Pool:
    """
    Return a pool that runs tasks on a scheduler's workers.

    See `connected` for the arguments and errors.
    """
    def outcomes(tasks: Sequence[Task], replay: _Replay) -> Generator[Outcome]:
        given = {_absolute(task): task for task in tasks}
        folder = os.path.dirname(next(iter(given))[1])
        with files.reported(folder), \
                TemporaryDirectory(prefix='.', dir=folder, ignore_cleanup_errors=True) as shared, \
                connected(scheduler, note) as cluster:
            inputs = [path for path, _ in given]
            for outcome in cluster.results(replace(replay, inputs=inputs, shared=shared), given,
                                           _died):
                path, output = given[outcome.path, outcome.output]
                yield replace(outcome, path=path, output=output)
    return outcomes


@dataclass(frozen=True)
class _Replay:
    """
    Calls `replay` for one recording, in a worker process.

    Attributes
    ----------
    inputs : sequence of str
        All recordings; an output must not replace any of these files.
    scene : Scene
    options : dict
        Options for `replay`.
    shared : str
        The path of a folder that a worker can find only if it shares a file system with the
        command.
    overwrite : bool
        Whether outputs may replace existing files.

    """

    inputs: Sequence[str]
    scene: Scene
    options: dict[str, Any]
    shared: str = os.sep
    overwrite: bool = field(default_factory=files.may_overwrite)

    def __call__(self, task: Task) -> Outcome:
        path, output = task
        if not os.path.isdir(self.shared):
            return Outcome(path, output, error=f'{output}: expected a folder that all workers '
                           f'share, not found on {socket.gethostname()}')
        with protection.reading(*self.inputs), files.overwriting(self.overwrite):
            try:
                result = replay(path, self.scene, output, **self.options)
            except InputError as error:
                return Outcome(path, output, error=str(error))
        return Outcome(path, output, _summary(result, output))


def _in_process(replay: _Replay, task: Task) -> Outcome:
    # tqdm's default lock has a semaphore that would outlive a killed process, so use another lock.
    tqdm.set_lock(threading.RLock())
    with redirect_stderr(io.StringIO()):  # only the main process shows a progress bar
        return replay(task)


def _died(task: Task, error: WorkerError) -> Outcome:
    return Outcome(*task, error=f'{task[0]}: {error}')


def _absolute(task: Task) -> Task:
    path, output = task
    return os.path.abspath(path), os.path.abspath(output)


def _summary(result: Replay, output: str) -> str:
    lost = f'; lost: {result.damage}' if result.damage else ''
    warned = ''.join(f'; warning: {text}' for text in result.warnings)
    epochs = f'{len(result.earlier) + 1} epochs, the last: ' if result.earlier else ''
    return (f'{epochs}{result.account.samples} torques, '
            f'{(result.last.time_ns - result.start.time_ns) * 1e-9:.9g} s -> {output}; '
            f'{result.check}{lost}{warned}')
