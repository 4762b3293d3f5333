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

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, ExitStack, redirect_stderr
from dataclasses import dataclass
from functools import partial
import io
import os
from pathlib import Path
import re
import threading
from typing import Any

from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.replay.result import Replay
from rigid_body_ros.replay.single import replay
from rigid_body_ros.report.text import lines
from rigid_body_ros.runtime import files
from rigid_body_ros.runtime.pool import Processes, WorkerError
from rigid_body_ros.runtime.terminal import progress
from rigid_body_ros.scene import Scene
from tqdm import tqdm

#: Matches the file names of partial outputs.
_PARTIAL = '*.partial*.mcap'
#: The path of a recording, and the path of the output for its motion.
Task = tuple[str, str]


@dataclass(frozen=True)
class Outcome:
    """The outcome of replaying one recording: its output and a short summary, or the error."""

    path: str
    output: str
    summary: str = ''
    error: str = ''


def replay_many(paths: Sequence[str], scene: Scene, folder: str | Path,
                **options: Any) -> list[Outcome]:
    """
    Replay recordings, and write each motion to a file in a folder; `outputs_in` names the files.

    The replays run in one process per processor.

    Parameters
    ----------
    paths : sequence of str
        The recordings.
    scene : Scene
        The scene that all recordings share.
    folder : str or Path
        The folder for the outputs, which is created if it does not exist.
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
    with files.reading(*paths, scene=scene.path):
        outputs = outputs_in(folder, paths)
        with files.reported(folder):
            Path(folder).mkdir(parents=True, exist_ok=True)
        with _partial_outputs_reported(Path(folder)), Processes() as processes:
            run = partial(_replayed, paths, scene, options, files.may_overwrite())
            outcomes = processes.results(run, zip(paths, outputs), _died)
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
        folder; an output is protected (see `files.protected`); or an output exists and must
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


def _replayed(inputs: Sequence[str], scene: Scene, options: dict[str, Any], overwrite: bool,
              task: Task) -> Outcome:
    """
    Replay one recording, in a worker process.

    No output replaces any of `inputs`, which are all recordings; `overwrite` says whether outputs
    may replace other existing files.
    """
    path, output = task
    # tqdm's default lock has a semaphore that would outlive a killed process, so use another.
    tqdm.set_lock(threading.RLock())
    # Only the main process shows a progress bar.
    with redirect_stderr(io.StringIO()), files.reading(*inputs), files.overwriting(overwrite):
        try:
            result = replay(path, scene, output, **options)
        except InputError as error:
            return Outcome(path, output, error=str(error))
    return Outcome(path, output, _summary(result, output))


def _died(task: Task, error: WorkerError) -> Outcome:
    return Outcome(*task, error=f'{task[0]}: {error}')


def _summary(result: Replay, output: str) -> str:
    lost = f'; lost: {result.damage}' if result.damage else ''
    warned = ''.join(f'; warning: {text}' for text in result.warnings)
    epochs = f'{len(result.earlier) + 1} epochs, the last: ' if result.earlier else ''
    return (f'{epochs}{result.account.samples} torques, '
            f'{(result.last.time_ns - result.start.time_ns) * 1e-9:.9g} s -> {output}; '
            f'{result.check}{lost}{warned}')
