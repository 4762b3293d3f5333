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

"""Compute the missing runs of an ensemble in a pool of workers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict
from functools import partial
import hashlib
from importlib.metadata import version
import json
import math
from typing import Any, NoReturn, TYPE_CHECKING

from rigid_body_ros.common.errors import InputError
from rigid_body_ros.ensemble.runs import Columns, Ensemble, Span
from rigid_body_ros.propagation import Problem
from rigid_body_ros.runtime.fingerprint import fingerprint
from rigid_body_ros.runtime.pool import WorkerError, Workers
from rigid_body_ros.scene import Scene

if TYPE_CHECKING:  # never imported at run time, so that workers need neither Parquet nor MCAP
    from rigid_body_ros.ensemble.folder import Folder
    from rigid_body_ros.runtime.terminal import Track

#: A context manager that yields the workers to compute with.
Pool = AbstractContextManager[Workers]

#: Maximum number of runs in a block if there is a controller, because a run with a controller
#: takes about a second, or if there are requirements that hold from some time on.
_IN_LOOP = 16


def identity_of(ensemble: Ensemble, scene: Scene, times: float | str) -> dict[str, Any]:
    """Return all inputs of the runs as JSON types; runs with equal inputs have equal results."""
    controller, fitted, problem = ensemble.controller, ensemble.fitted, ensemble.problem
    varied = {'vary': dict(fitted.estimates), 'covariance': _hash(
        fitted.covariance.tobytes() + fitted.guess_attitude.tobytes())} if fitted else {
            'vary': [*map(asdict, ensemble.dispersions)]}
    # Convert to JSON and back, so that the result can be compared with the content of a file.
    return dict(json.loads(json.dumps({
        'seed': ensemble.seed, **varied,
        'scene': _hash(json.dumps(dict(scene.values), sort_keys=True).encode()),
        'recording': recording_hash(problem), 'start_ns': problem.start.time_ns,
        'end_ns': ensemble.end_ns, 'times': times,
        **({'controller': f'{controller.name} {controller.digest}'} if controller else {}),
        **({'columns': list(ensemble._results)} if ensemble.requirements else {}),
        'versions': {**fingerprint(), 'scipy': version('scipy')}})))


def recording_hash(problem: Problem) -> str:
    """Return a hash of all recorded torques: those on the body, the rotors and the wheels."""
    torques = hashlib.sha256()
    for log in problem.sources:
        for array in (log.times_ns, log.torques, log.in_space):
            torques.update(array.tobytes())
        torques.update(log.interpolation.encode())
    if problem.efforts:
        for array in (problem.efforts.times_ns, problem.efforts.efforts):
            torques.update(array.tobytes())
    return f'sha256:{torques.hexdigest()}'


def compute(ensemble: Ensemble, folder: Folder, pool: Pool, track: Track) -> None:
    """
    Compute all runs that are missing in a folder, and write them to the folder.

    Raises
    ------
    InputError
        The folder cannot be written, or the pool fails.
    KeyboardInterrupt
        A signal was received. The folder keeps all blocks that were already complete.

    """
    spans = folder.missing(_IN_LOOP if ensemble.in_python else None)
    if spans:
        with pool as workers:
            blocks = workers.results(partial(_rows, ensemble), _divided(spans, workers), _died)
            for rows in track(blocks, sum(stop - first for first, stop in spans)):
                folder.add(rows)
    folder.complete()


def _hash(data: bytes) -> str:
    return f'sha256:{hashlib.sha256(data).hexdigest()}'


def _died(span: Span, error: WorkerError) -> NoReturn:
    raise InputError(f'cannot compute runs {span[0]} to {span[1] - 1}: {error}; run the same '
                     'command again to compute what is missing') from error


def _rows(ensemble: Ensemble, span: Span) -> Columns:
    return ensemble.rows(*span)


def _divided(spans: Sequence[Span], workers: Workers) -> Iterator[Span]:
    """
    Divide blocks into smaller ones, so that all workers have something to compute.

    A block stays in one piece unless there are fewer remaining blocks than the workers can accept.
    """
    for left, (first, stop) in zip(range(len(spans), 0, -1), spans):
        parts = min(math.ceil(workers.ahead() / left), workers.parts)
        size = math.ceil((stop - first) / parts)
        for begin in range(first, stop, size):
            yield begin, min(begin + size, stop)
