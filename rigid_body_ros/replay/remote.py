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

"""Replay many recordings on the workers of a Dask scheduler, which share a file system."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
import os
import socket
from tempfile import TemporaryDirectory
from typing import Any

from rigid_body_ros.replay.many import Outcome, Pool, replayed, Task
from rigid_body_ros.runtime import files
from rigid_body_ros.runtime.cluster import connected
from rigid_body_ros.scene import Scene


def on_cluster(scheduler: str, note: Callable[[str], None]) -> Pool:
    """Return the workers of a scheduler, with the arguments and errors of `connected`."""
    def outcomes(tasks: Sequence[Task], scene: Scene, options: dict[str, Any]
                 ) -> Generator[Outcome]:
        given = {_absolute(task): task for task in tasks}
        folder = os.path.dirname(next(iter(given))[1])
        with files.reported(folder), \
                TemporaryDirectory(prefix='.', dir=folder, ignore_cleanup_errors=True) as shared, \
                connected(scheduler, note) as cluster:
            replay = _Replay([path for path, _ in given], shared, files.may_overwrite(), scene,
                             options)
            for outcome in cluster.results(replay, given, _died):
                path, output = given[outcome.path, outcome.output]
                yield replace(outcome, path=path, output=output)
    return outcomes


@dataclass(frozen=True)
class _Replay:
    """
    What a worker does with a recording.

    Attributes
    ----------
    inputs : sequence of str
        All recordings; no output may replace them.
    shared : str
        A folder that a worker finds only if it shares the file system of the command.
    overwrite : bool
        Whether outputs may replace existing files.
    scene : Scene
    options : dict
        As for `replay`.

    """

    inputs: Sequence[str]
    shared: str
    overwrite: bool
    scene: Scene
    options: dict[str, Any]

    def __call__(self, tasks: Sequence[Task]) -> list[Outcome]:
        return [self._outcome(task) for task in tasks]

    def _outcome(self, task: Task) -> Outcome:
        if not os.path.isdir(self.shared):
            return Outcome(*task, error=f'{task[1]}: expected a folder that all workers share, '
                           f'not found on {socket.gethostname()}')
        with files.reading(*self.inputs), files.overwriting(self.overwrite):
            return replayed(task, self.scene, self.options)


def _absolute(task: Task) -> Task:
    path, output = task
    return os.path.abspath(path), os.path.abspath(output)


def _died(tasks: Sequence[Task], why: str) -> list[Outcome]:
    return [Outcome(*task, error=f'{task[0]}: {why}') for task in tasks]
