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

"""Write the worst runs to files from which `attitude_replay` can recompute them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
import re
import shlex
from typing import Any

import numpy as np
from rigid_body_ros import recording
from rigid_body_ros.ensemble.runs import Ensemble
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.messages import INERTIA, inertia, joint_commands, WRENCH
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording import Column
from rigid_body_ros.runtime import files
from rigid_body_ros.scene import Scene
from rigid_body_ros.scene.parameters import ACTUATOR
from rigid_body_ros.scene.quantities import along
from rigid_body_ros.scene.scene import text_of

#: The name of the folder for the worst runs, which is inside the folder of the ensemble, and the
#: names of the files in it.
FOLDER = 'worst'
_FILE = re.compile(r'\d+\.(mcap|yaml)')
_WHEELS, _COMMANDS, _BODY = '/wheel_torque', '/wheel_command', '/inertia'


def write(path: Path, ensemble: Ensemble, scene: Scene, runs: Collection[int]) -> None:
    """
    Write a scene and a recording for each of the given runs, and remove the files of other runs.

    Raises
    ------
    InputError
        A file cannot be written.

    """
    with files.reported(path):
        if runs:
            path.mkdir(exist_ok=True)
        for file in path.glob('*'):
            if _FILE.fullmatch(file.name):
                file.unlink()
    for run in runs:
        problem, values = ensemble.replayed(run)
        topics = [f'torque_{source}' for source in range(len(problem.logs) or 1)]
        later_ns = _later_ns(problem)
        changed = {**values, 'start_time': problem.start.time_ns + later_ns,
                   'torque_topics': topics, **_actuated(problem, scene, topics),
                   **_turning(problem)}
        with files.atomic_output(path / f'{run}.yaml', '.yaml') as part:
            part.write_text(f'# Run {run} of an ensemble.\n{text_of(scene, changed)}',
                            encoding='utf-8')
        with recording.Writer(path / f'{run}.mcap') as writer:
            _write(writer, problem, scene, topics, later_ns)


def command(ensemble: Ensemble, path: str | Path, run: int) -> str:
    """Return the command that recomputes a run from its files in the folder of an ensemble."""
    seconds = (ensemble.end_ns - ensemble.problem.start.time_ns) / 1e9
    files_of = Path(path) / FOLDER / str(run)
    return shlex.join(['attitude_replay', f'{files_of}.mcap', '--scene', f'{files_of}.yaml',
                       '--until', f'{seconds:.9f}'.rstrip('0').rstrip('.'), '-o',
                       f'run_{run}.mcap'])


def _actuated(problem: Problem, scene: Scene, topics: Sequence[str]) -> dict[str, Any]:
    """Return the scene parameters for actuators, or none if the scene has no actuators."""
    if not scene.actuators:
        return {}
    commands = [topic for topic, actuator in zip(topics, problem.actuators) if actuator]
    # A scene with an actuator must name the topics whose torques go through the actuator. If there
    # are no such topics, remove the actuator from the scene.
    none = {} if commands else {parameter.name: parameter.default for parameter in ACTUATOR}
    return {**none, 'actuator.topics': commands}


def _turning(problem: Problem) -> dict[str, Any]:
    """Return the scene parameters for the initial wheel speeds, or none if there are no speeds."""
    start, wheels = problem.start, problem.named_wheels
    if not wheels or not len(start.wheel_speeds):
        return {}
    return {**{f'{name}.initial_speed': speed
               for name, speed in zip(wheels.names, start.wheel_speeds.tolist())},
            **dict(zip(along('initial_rotor_momentum'), wheels.others(start).tolist()))}


def _later_ns(problem: Problem) -> int:
    """Return the time shift, ns, that makes all stamps nonnegative and the start nonzero."""
    first_ns = min(problem.stamps_ns[:1].tolist(), default=0)
    return 1 - min(first_ns, 0) if first_ns < 0 or not problem.start.time_ns else 0


def _write(writer: recording.Writer, problem: Problem, scene: Scene, topics: Sequence[str],
           later_ns: int) -> None:
    """
    Write the torques of a problem, and any changes of the body, with all stamps shifted.

    The torques on the body are written to `topics`, with one topic for each log.
    """
    # A replay needs at least one torque, so write a zero torque if the problem has none.
    none = TorqueLog([problem.start.time_ns], np.zeros((1, 3)))
    for topic, log in zip(topics, problem.logs or (none,)):
        _write_log(writer, f'/{topic}', log, scene, later_ns)
    if problem.wheels:
        _write_log(writer, _WHEELS, problem.wheels, scene, later_ns)
    if problem.named_wheels and problem.efforts:
        kind = joint_commands(problem.named_wheels.names)
        writer.add_topic(_COMMANDS, kind)
        stamps_ns = problem.efforts.times_ns + later_ns
        for stamp_ns, efforts in zip(stamps_ns.tolist(), problem.efforts.efforts):
            writer.write(_COMMANDS, stamp_ns, kind.encode(stamp_ns, '', efforts))
    if problem.changes:
        writer.add_topic(_BODY, INERTIA)
        stamps_ns = problem.changes.times_ns + later_ns
        for stamp_ns, body in zip(stamps_ns.tolist(), problem.changes.bodies):
            writer.write(_BODY, stamp_ns, inertia(stamp_ns, scene.body_frame, body.entries))


def _write_log(writer: recording.Writer, topic: str, log: TorqueLog, scene: Scene,
               later_ns: int) -> None:
    writer.add_topic(topic, WRENCH)
    wrenches = np.concatenate([np.zeros((len(log), 3)), log.torques], axis=1)
    for in_space, frame in ((False, scene.body_frame), (True, scene.space_frame)):
        rows = log.in_space == in_space
        if rows.any():
            writer.write_columns(log.times_ns[rows] + later_ns,
                                 [Column(topic, frame, wrenches[rows])])
