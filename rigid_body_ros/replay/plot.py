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

"""Draw a replayed motion."""

from __future__ import annotations

from pathlib import Path

from rigid_body_ros.replay.result import Replay


def draw(path: str | Path, result: Replay, name: str) -> None:
    """
    Plot a motion and its torques in a PNG file.

    Parameters
    ----------
    path : str or Path
        The PNG file. Its name may have any suffix, and an existing file is overwritten.
    result : Replay
        The result of `replay` with `keep` set, so that it has the problem and the trajectory.
    name : str
        The name of the recording, which appears in the title.

    Raises
    ------
    OSError
        The file cannot be written.

    """
    from rigid_body_ros.report import figures  # matplotlib is slow to import
    problem, motion = result.problem, result.trajectory
    assert problem
    assert motion
    fields = problem.field_torque(motion.times_ns, motion.attitude) if problem.fields else None
    figures.motion(path, motion, problem.logs, result.scene.euler_sequence,
                   f'{name}: {result.topic}', result.scene.timeout_ns, fields)
