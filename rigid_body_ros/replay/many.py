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

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
import io
import multiprocessing
import os
from pathlib import Path
import sys
from typing import Any

from rigid_body_ros.replay import bar, replay
from rigid_body_ros.scene import InputError, Scene


@dataclass(frozen=True)
class Outcome:
    """What became of a recording: where its motion is, in short what happened, or the error."""

    path: str
    output: str
    summary: str = ''
    error: str = ''


def replay_many(paths: Sequence[str], scene: Scene, folder: str | Path,
                prepare: Callable[[], None], **options: Any) -> list[Outcome]:
    """
    Replay recordings into a folder, as files of their names.

    Parameters
    ----------
    paths : sequence of str
        Each goes to a file NAME.mcap, where NAME is its own up to the first dot.
    scene : Scene
        One for all of them.
    folder : str or Path
        Made if it is not there.
    prepare : callable
        What each process does first.
    options
        As of `replay`.

    Returns
    -------
    list of Outcome
        In the order of the paths.

    Raises
    ------
    InputError
        The folder cannot be made, or two outputs would have one name.

    """
    outputs = [str(Path(folder) / f'{Path(path).name.split(".")[0]}.mcap') for path in paths]
    twice = [name for name in outputs if outputs.count(name) > 1]
    if twice:
        raise InputError(f'{twice[0]}: expected recordings of different names, found two that '
                         'would be written there')
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f'{folder}: cannot write: {error.strerror}') from error
    # Spawned: a fork would take over half of what threads of this process are about.
    context = multiprocessing.get_context('spawn')
    with context.Pool(min(len(paths), os.cpu_count() or 1), _begin, (prepare,)) as pool:
        work = partial(_outcome, scene, options)
        done = bar('recordings', ' files')(pool.imap(work, zip(paths, outputs)), len(paths))
        return list(done)


def table(outcomes: Sequence[Outcome]) -> str:
    """Return a line a recording."""
    width = max(len(outcome.path) for outcome in outcomes)
    lines = [f'{outcome.path:{width}}  {outcome.summary or f"failed: {outcome.error}"}'
             for outcome in outcomes]
    failed = sum(bool(outcome.error) for outcome in outcomes)
    return '\n'.join([*lines, f'{len(outcomes) - failed} of {len(outcomes)} written'])


def _begin(prepare: Callable[[], None]) -> None:
    sys.stderr = io.StringIO()  # one progress bar is enough
    prepare()


def _outcome(scene: Scene, options: dict[str, Any], names: tuple[str, str]) -> Outcome:
    path, output = names
    try:
        result = replay(path, scene, output, **options)
    except InputError as error:
        return Outcome(path, output, error=str(error))
    lost = f'; lost: {result.damage}' if result.damage else ''
    return Outcome(path, output, f'{result.messages} torques, '
                   f'{(result.last.time_ns - result.start.time_ns) * 1e-9:.9g} s -> {output}; '
                   f'{result.check}{lost}')
