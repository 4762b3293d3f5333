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

"""Import a controller written in Python, and call it for each state."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import lru_cache
import hashlib
from importlib import import_module
import inspect
import math
from pathlib import Path
import sys
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, quoted, reason
from rigid_body_ros.mechanics.actuator import Actuator
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation import Problem
from rigid_body_ros.runtime import interrupts

#: A control law: a function of the state and the time since the start, s, that returns a torque in
#: body axes, N m, shape (3,).
Law = Callable[[State, float], Any]


class ControllerError(ValueError):
    """Raised if a controller raises an exception, or returns something other than a torque."""


@dataclass(frozen=True)
class Controller:
    """
    A controller: a function, or a class whose instances are callable.

    A new instance of a class is created for each run.

    Attributes
    ----------
    name : str
        Where to find the controller: MODULE:FUNCTION or MODULE:CLASS.
    folder : str
        The folder where Python looks for the module first.
    digest : str
        Hash of the source file of the module.
    step_ns : int, ns
        The time between two calls.
    actuator : Actuator, optional
        The actuator that receives the torques of the controller as commands.

    """

    name: str
    folder: str
    digest: str
    step_ns: int
    actuator: Actuator | None = None

    @classmethod
    def load(cls, name: str, step_ns: int, actuator: Actuator | None = None) -> Controller:
        """
        Import a controller. The working directory is searched before all other folders.

        Raises
        ------
        InputError
            The module cannot be imported, has no source file, or does not define the controller.

        """
        folder = str(Path.cwd())
        found = cls(name, folder, _digest(name, folder), step_ns, actuator)
        found.check()
        return found

    def check(self) -> None:
        """
        Check that this process can use the same controller.

        Raise InputError if this process cannot import the controller, or finds different source
        code.
        """
        digest = _digest(self.name, self.folder)
        if digest != self.digest:
            raise InputError(f'controller {self.name}: expected the source file that the command '
                             f'has ({self.digest}), found another ({digest})')
        if not callable(_target(self.name, self.folder)):
            raise InputError(f'controller {self.name}: expected a function or a class, found '
                             f'{quoted(_target(self.name, self.folder))}')

    def begin(self) -> Law:
        """Return the control law for a run; raise ControllerError if the law cannot be created."""
        target = _target(self.name, self.folder)
        if not inspect.isclass(target):
            return target
        law = self._called(target, 0.0)
        if not callable(law):
            raise ControllerError(f'controller {self.name}: expected a class with __call__, found '
                                  'one without')
        return law

    def torque(self, law: Law, state: State, seconds: float) -> Floats:
        """
        Call a control law for a state, and return the torque in body axes, N m, shape (3,).

        Raises
        ------
        ControllerError
            The controller raised an exception, or did not return three finite numbers.
        KeyboardInterrupt
            A signal was received.

        """
        found = self._called(law, seconds, state, seconds)
        try:
            torque = np.array(found, float)
        except (TypeError, ValueError):
            torque = np.empty(0)
        if torque.shape != (3,) or not all(map(math.isfinite, torque.tolist())):
            raise ControllerError(f'{seconds:.9g} s: controller {self.name}: expected a torque of '
                                  f'three finite numbers (N m), found {quoted(found)}')
        return torque

    def check_same(self, first: Problem, again: Problem) -> None:
        """Raise ControllerError if the torques of a run differ when the run is computed again."""
        for one, other in zip(first.logs[-1:], again.logs[-1:]):
            differ = (one.torques.view(np.int64) != other.torques.view(np.int64)).any(axis=1)
            if differ.any():
                row = int(np.flatnonzero(differ)[0])
                seconds = (int(one.times_ns[row]) - first.start.time_ns) / 1e9
                raise ControllerError(
                    f'{seconds:.9g} s: controller {self.name}: expected the same torque when the '
                    f'run is repeated, found {one.torques[row].tolist()} and then '
                    f'{other.torques[row].tolist()} N m: it uses a clock, random numbers, or '
                    'memory that runs share; a class has memory for each run')

    def _called(self, function: Callable[..., Any], seconds: float, *arguments: Any) -> Any:
        try:
            return function(*arguments)
        except BaseException as error:  # even if a controller calls exit, only this run fails
            interrupts.check()
            raise ControllerError(f'{seconds:.9g} s: controller {self.name}: '
                                  f'{_described(error)}') from error


@lru_cache
def _target(name: str, folder: str) -> Any:
    module, _, function = name.partition(':')
    try:
        return getattr(_imported(name, folder), function)
    except AttributeError:
        raise InputError(f'controller {name}: expected a function {quoted(function)} in '
                         f'{module}, found none') from None


@lru_cache
def _imported(name: str, folder: str) -> Any:
    module, _, function = name.partition(':')
    if not (function.isidentifier() and all(map(str.isidentifier, module.split('.')))):
        raise InputError(f'controller: expected MODULE:FUNCTION, found {quoted(name)}')
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        with redirect_stdout(sys.stderr):  # standard output is reserved for results
            return import_module(module)
    except BaseException as error:  # a module may raise anything, even SystemExit
        interrupts.check()
        raise InputError(f'controller {name}: cannot import {module}: '
                         f'{_described(error)}') from error


def _digest(name: str, folder: str) -> str:
    """Return a hash of the source file of a controller."""
    path = getattr(_imported(name, folder), '__file__', None)
    if path is None:
        raise InputError(f'controller {name}: expected a module with a source file, found one '
                         'without')
    try:
        return f'sha256:{hashlib.sha256(Path(path).read_bytes()).hexdigest()}'
    except OSError as error:
        raise InputError(f'controller {name}: cannot read {path}: {reason(error)}') from error


def _described(error: BaseException) -> str:
    text = ' '.join(str(error).split())
    return f'{type(error).__name__}: {text}' if text else type(error).__name__
