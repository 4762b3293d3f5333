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

"""Save the last committed state to a file, so that a restarted node can continue from it."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
import hashlib
import json
import os
from pathlib import Path
import time
from typing import Any

from rigid_body_ros.common.errors import InputError, quoted
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.runtime import files
from rigid_body_ros.scene import Scene

_FORMAT, _SUFFIX = 'rigid_body_ros checkpoint 1', '.json'
#: Parameters and parameter groups that have no effect on the motion under given torques.
_OTHERS = frozenset([
    'checkpoint', 'euler_sequence', 'history', 'imu', 'max_future', 'max_past', 'mode', 'monitor',
    'odometry', 'on_time_jump', 'publish_clock', 'publish_rate', 'publish_tf', 'real_time_factor',
    'stale_after', 'stamp_offset_warning', 'step', 'time_source'])
#: A text longer than this many characters, such as a URDF, is replaced by its hash.
_LONGEST_TEXT = 200


class Checkpoint:
    """
    A file that contains the last committed state of a node.

    The file is written in a separate thread, because writing may take longer than the node's
    output period. It is always replaced as a whole, so at any moment it contains either the old
    state or the new one.

    Parameters
    ----------
    path : str
        The path of the file, which does not have to exist yet.
    scene : Scene
    node : str
        The full name of the node. It is stored in the file, so that two nodes with the same
        parameters cannot share a file.

    Attributes
    ----------
    start : State or None
        The state found in the file, or None if there was no file.

    Raises
    ------
    InputError
        The file is damaged, is not a checkpoint of this node and scene, or cannot be written.

    """

    def __init__(self, path: str, scene: Scene, node: str) -> None:
        self._path = Path(path).expanduser().absolute()
        self._defining = {'node': node, **_defining(scene)}
        self.start = self._read()
        files.check((self._path, _SUFFIX))
        #: The identity of the file when it was last read or written. None if there was no file.
        self._identity = _identity(self._path)
        self._saved = self.start
        self._pool = ThreadPoolExecutor(1, 'checkpoint')
        self._writing: Future[None] | None = None

    def __str__(self) -> str:
        return str(self._path)

    @property
    def age(self) -> float:
        """Return the time since the file was last written, s."""
        return max(0.0, time.time() - os.stat(self._path).st_mtime)

    def save(self, state: State | None) -> None:
        """
        Start writing a state, unless it is already saved or another write is still in progress.

        Raises
        ------
        InputError
            The previous state could not be written.

        """
        if state is None or state is self._saved or (
                self._writing and not self._writing.done()):
            return
        self.finish()
        self._saved = state
        self._writing = self._pool.submit(self._write, state)

    def save_last(self, state: State | None) -> None:
        """Write a state and wait for the write to finish; raise InputError if it fails."""
        self.finish()
        self.save(state)
        self.finish()

    def finish(self) -> None:
        """Wait for the last write to finish; raise InputError if it failed."""
        writing, self._writing = self._writing, None
        if writing:
            try:
                writing.result()
            except InputError:
                self._saved = None  # so that the next `save` writes again
                raise

    def _write(self, state: State) -> None:
        if _identity(self._path) != self._identity:
            raise InputError(f'checkpoint {self._path}: another program has changed the file; it '
                             'is left as it is')
        with files.atomic_output(self._path, _SUFFIX) as part:
            part.write_text(_text(self._defining, state), encoding='utf-8')
        self._identity = _identity(self._path)

    def _read(self) -> State | None:
        try:
            text = self._path.read_text(encoding='utf-8')
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f'checkpoint {self._path}: cannot read: {error}') from error
        state, defining = self._parsed(text)
        for name in sorted(self._defining.keys() | defining.keys()):
            here, there = self._defining.get(name), defining.get(name)
            if here != there:
                raise InputError(
                    f'checkpoint {self._path}: expected a checkpoint of this node and scene, '
                    f'found one with another {name}: {quoted(there)} there, {quoted(here)} here; '
                    'remove the file to start from the initial state')
        return state

    def _parsed(self, text: str) -> tuple[State, dict[str, Any]]:
        """
        Return the state and the defining parameter values that the text of a checkpoint contains.

        Raise InputError if the text is not exactly what `_text` would have returned.
        """
        try:
            data = json.loads(text)
            state = State(data['time_ns'], data['attitude'], data['angular_velocity'],
                          data['rotor_momentum'], data.get('wheel_speeds', ()))
            if _text(data['defining'], state) == text:
                return state, data['defining']
        except (ValueError, TypeError, KeyError, RecursionError):
            pass
        raise InputError(f'checkpoint {self._path}: expected a checkpoint that a node has '
                         f'written, found a damaged or other file of {len(text)} characters; '
                         'remove it to start from the initial state')


def _text(defining: dict[str, Any], state: State) -> str:
    data = {'format': _FORMAT, 'time_ns': state.time_ns, 'attitude': state.attitude.tolist(),
            'angular_velocity': state.angular_velocity.tolist(),
            'rotor_momentum': state.rotor_momentum.tolist(),
            **({'wheel_speeds': state.wheel_speeds.tolist()} if state.wheel_speeds.size else {}),
            'defining': defining}
    # Append a hash of all other entries, so that a damaged file is detected.
    digest = hashlib.sha256(json.dumps(data).encode()).hexdigest()
    return f'{json.dumps({**data, "sha256": digest}, indent=1)}\n'


def _defining(scene: Scene) -> dict[str, Any]:
    """Return the scene parameters that affect the motion, replacing long texts by hashes."""
    return {name: f'sha256 {hashlib.sha256(value.encode()).hexdigest()}'
            if isinstance(value, str) and len(value) > _LONGEST_TEXT else value
            for name, value in scene.values.items()
            if name.partition('.')[0] not in _OTHERS}


def _identity(path: Path) -> tuple[int, int, int] | None:
    with suppress(FileNotFoundError):
        status = os.stat(path)
        return status.st_dev, status.st_ino, status.st_mtime_ns
    return None
