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

"""The worst runs as scenes and recordings, from which `attitude_replay` computes them again."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
import re
import shlex

import numpy as np
from rigid_body_ros import recording
from rigid_body_ros.ensemble.runs import Ensemble
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.messages import WRENCH
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording import Column
from rigid_body_ros.runtime import files
from rigid_body_ros.scene import Scene
from rigid_body_ros.scene.text import text_of

#: The folder of the worst runs, in that of the ensemble, and the files in it.
FOLDER = 'worst'
_FILE = re.compile(r'\d+\.(mcap|yaml)')
_WHEELS = '/wheel_torque'


def write(path: Path, ensemble: Ensemble, scene: Scene, runs: Collection[int]) -> None:
    """
    Write the scenes and the torques of some runs to a folder, in place of those of others.

    Raises
    ------
    InputError
        A file cannot be written.

    """
    with files.reported(path):
        if runs:
            path.mkdir(exist_ok=True)
        for found in path.glob('*'):
            if _FILE.fullmatch(found.name):
                found.unlink()
    for run in runs:
        problem, values = ensemble.replayed(run)
        topics = [f'torque_{source}' for source in range(len(problem.logs) or 1)]
        changed = {**values, 'start_time': problem.start.time_ns, 'torque_topics': topics}
        with files.atomic_output(path / f'{run}.yaml', '.yaml') as part:
            part.write_text(f'# Run {run} of an ensemble.\n{text_of(scene, changed)}',
                            encoding='utf-8')
        _write_torques(path / f'{run}.mcap', problem, scene, topics)


def command(ensemble: Ensemble, path: str | Path, run: int) -> str:
    """Return the command that computes a run again from what is in the folder of an ensemble."""
    seconds = (ensemble.end_ns - ensemble.problem.start.time_ns) / 1e9
    files_of = Path(path) / FOLDER / str(run)
    return shlex.join(['attitude_replay', f'{files_of}.mcap', '--scene', f'{files_of}.yaml',
                       '--until', f'{seconds:.9f}'.rstrip('0').rstrip('.'), '-o',
                       f'run_{run}.mcap'])


def _write_torques(path: Path, problem: Problem, scene: Scene, topics: list[str]) -> None:
    # A replay needs torques, and begins where the first one does: one of zero changes nothing.
    none = TorqueLog([problem.start.time_ns], np.zeros((1, 3)))
    with recording.Writer(path) as writer:
        for topic, log in zip(topics, problem.logs or (none,)):
            _write_log(writer, f'/{topic}', log, scene)
        if problem.wheels:
            _write_log(writer, _WHEELS, problem.wheels, scene)


def _write_log(writer: recording.Writer, topic: str, log: TorqueLog, scene: Scene) -> None:
    writer.add_topic(topic, WRENCH)
    wrenches = np.concatenate([np.zeros((len(log), 3)), log.torques], axis=1)
    for in_space, frame in ((False, scene.body_frame), (True, scene.space_frame)):
        rows = log.in_space == in_space
        if rows.any():
            writer.write_columns(log.times_ns[rows], [Column(topic, frame, wrenches[rows])])
