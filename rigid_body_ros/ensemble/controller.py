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

"""
Run a controller written in Python in the loop with a motion.

The controller is called at each step, just as a node in lockstep waits for a torque at each step.
The torque that the controller returns acts until the next step. The motion is exactly the same as
the motion that `propagate` computes from the same torques.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
import hashlib
import heapq
from importlib import import_module
import inspect
from itertools import repeat
import math
from operator import itemgetter
from pathlib import Path
import sys
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.common.errors import InputError, quoted, reason
from rigid_body_ros.ensemble.applied import FARTHEST
from rigid_body_ros.mechanics.actuator import Actuator
from rigid_body_ros.mechanics.state import all_finite, State
from rigid_body_ros.mechanics.torque import FRAMES, TorqueLog
from rigid_body_ros.propagation import Problem, Propagator
from rigid_body_ros.runtime import interrupts

#: A control law: a function of the state and the time since the start, s, that returns a torque in
#: body axes, N m, shape (3,).
Law = Callable[[State, float], Any]
#: A function that takes the torque from a controller and returns the applied torque, both in N m.
Actuated = Callable[[Floats], Floats]
#: An input of a motion: the stamp of the input, ns, and a function that applies the input.
_Input = tuple[int, Callable[[], object]]


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
        return cls(name, folder, _digest(name, folder), step_ns, actuator)

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

    def begin(self) -> Law:
        """Return the control law for a run; raise ControllerError if the law cannot be created."""
        _, target = _imported(self.name, self.folder)
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
        returned = self._called(law, seconds, state, seconds)
        try:
            torque = np.array(returned, float)
            if torque.shape == (3,) and all_finite(torque.tolist()):
                return torque
        except (TypeError, ValueError):  # the error below says what was returned
            pass
        raise ControllerError(f'{seconds:.9g} s: controller {self.name}: expected a torque of '
                              f'three finite numbers (N m), found {quoted(returned)}')

    def check_same(self, first: Problem, again: Problem) -> None:
        """Raise ControllerError if the torques of a run differ when the run is computed again."""
        for log, other in zip(first.logs[-1:], again.logs[-1:]):
            differ = (log.torques.view(np.int64) != other.torques.view(np.int64)).any(axis=1)
            if differ.any():
                row = int(np.flatnonzero(differ)[0])
                seconds = (int(log.times_ns[row]) - first.start.time_ns) / 1e9
                raise ControllerError(
                    f'{seconds:.9g} s: controller {self.name}: expected the same torque when the '
                    f'run is repeated, found {log.torques[row].tolist()} and then '
                    f'{other.torques[row].tolist()} N m: it uses a clock, random numbers, or '
                    'memory that runs share; a class has memory for each run')

    def _called(self, function: Callable[..., Any], seconds: float, *arguments: Any) -> Any:
        try:
            return function(*arguments)
        except BaseException as error:  # even if a controller calls exit, only this run fails
            interrupts.check()
            raise ControllerError(f'{seconds:.9g} s: controller {self.name}: '
                                  f'{_described(error)}') from error


def closed_loop(problem: Problem, controller: Controller, times_ns: Ints,
                actuated: Actuated) -> tuple[Floats, TorqueLog]:
    """
    Propagate a motion with a controller in the loop.

    Parameters
    ----------
    problem : Problem
        The motion without the controller. The torques in its logs are held between samples.
    controller : Controller
        The controller. It is called for the first time at the start of the motion.
    times_ns : array of int64, shape (m,), ns
        The times at which to return states, in ascending order and not before the start. The
        motion ends at the last of these times.
    actuated : function
        A function that takes the torque from the controller and returns the applied torque, both
        in N m.

    Returns
    -------
    array, shape (m, 7)
        The motion: attitude, x y z w, and angular velocity, rad/s.
    TorqueLog
        The torques that `actuated` returned. To reproduce the motion with `propagate`, add this
        log to the problem after all other logs, with the actuator of the controller.

    Raises
    ------
    ValueError
        The controller fails (`ControllerError`), the body turns too far for its motion to be
        computed, or `Propagator` raises this error.
    KeyboardInterrupt
        A signal was received.

    """
    start_ns, step_ns = problem.start.time_ns, controller.step_ns
    motion, turned = _Motion(problem, controller), _Turned(problem, step_ns)
    wanted_ns: list[int] = times_ns.tolist()
    stamps = range(start_ns, wanted_ns[-1], step_ns)
    torques, states = list[Floats](), list[State]()
    with redirect_stdout(sys.stderr):  # standard output is reserved for results
        law = controller.begin()
        for stamp_ns in stamps:
            interrupts.check()
            state, seconds = motion.at(stamp_ns), (stamp_ns - start_ns) / 1e9
            torque = actuated(controller.torque(law, _copied(state), seconds))
            turned.check(state, torque, seconds)
            torques.append(torque)
            motion.apply(stamp_ns, torque)
            end = bisect_left(wanted_ns, stamp_ns + step_ns)
            states += map(motion.at, wanted_ns[len(states):end])
    if len(states) < len(wanted_ns):
        states.append(motion.at(wanted_ns[-1]))
    return (np.array([[*state.attitude, *state.angular_velocity] for state in states]),
            TorqueLog(np.array(stamps, np.int64), np.reshape(torques, (-1, 3))))


class _Motion:
    """A motion with a controller. It can be evaluated only at ascending times."""

    def __init__(self, problem: Problem, controller: Controller) -> None:
        self._source = len(problem.logs)
        wheels = problem.named_wheels.wheels if problem.named_wheels else None
        actuators = [*(problem.actuators or [None] * self._source), controller.actuator]
        # No state is requested more than one step before the latest torque.
        self._propagator = Propagator(problem.body, problem.start, wheels=wheels,
                                      fields=problem.fields, actuator=actuators,
                                      history=controller.step_ns / 1e9, **asdict(problem.options))
        self._recorded = heapq.merge(*self._inputs(problem), key=itemgetter(0))
        self._next = next(self._recorded, None)

    def at(self, time_ns: int) -> State:
        """Apply all recorded inputs up to a time, and return the state at this time."""
        while self._next and self._next[0] <= time_ns:
            self._next[1]()
            self._next = next(self._recorded, None)
        return self._propagator.at(time_ns)

    def apply(self, time_ns: int, torque: Floats) -> None:
        """Apply a torque from the controller, from the given time onward."""
        self._propagator.apply(time_ns, torque, source=self._source)

    def _inputs(self, problem: Problem) -> Iterator[Iterator[_Input]]:
        """Generate an iterator over the inputs of each source, then one over the body changes."""
        into, wheels, changes = self._propagator, problem.wheels, problem.changes
        for source, log in enumerate(problem.logs):
            frames = np.choose(log.in_space, FRAMES).tolist()
            yield _calls(into.apply, log.times_ns, log.torques, frames, repeat(source))
        if wheels:
            yield _calls(into.apply_wheels, wheels.times_ns, wheels.torques)
        if problem.named_wheels and problem.efforts:
            names, efforts = problem.named_wheels.names, problem.efforts
            yield _calls(into.apply_efforts, efforts.times_ns, [
                {name: effort for name, effort in zip(names, row) if effort == effort}
                for row in efforts.efforts.tolist()])
        if changes:
            yield _calls(into.apply_body, changes.times_ns, changes.bodies, repeat(changes.keep))


class _Turned:
    """
    An upper bound on the angle through which a body has turned.

    The bound is needed because motions with huge angles would take days to propagate.
    """

    def __init__(self, problem: Problem, step_ns: int) -> None:
        moments = problem.body.principal_moments
        self._least, self._seconds = float(moments.min()), step_ns / 1e9
        #: While the energy is constant, the angular velocity can grow by at most this factor.
        self._ratio = math.sqrt(float(moments.max()) / self._least)
        self._limit = math.inf if problem.options.record.fixed_step else FARTHEST
        #: The upper bound up to now, rad, and the largest torque up to now, N m. Earlier torques
        #: matter because an actuator may delay them.
        self._angle = self._largest = 0.0

    def check(self, state: State, torque: Floats, seconds: float) -> None:
        """Raise ValueError if, one step after `state`, the body may have turned too far."""
        self._largest = max(self._largest, math.hypot(*torque.tolist()))
        gained = self._largest / self._least * self._seconds
        rate = math.hypot(*state.angular_velocity.tolist()) * self._ratio + gained
        self._angle += rate * self._seconds
        if not self._angle < self._limit:
            raise ValueError(f'{seconds:.9g} s: the body may turn by {self._angle:.3g} rad, too '
                             f'far to be computed (limit {self._limit:.3g} rad): check the '
                             'controller')


def _calls(apply: Callable[..., object], times_ns: Ints,
           *columns: Iterable[Any]) -> Iterator[_Input]:
    """
    Generate the inputs of a source, one for each row.

    An input consists of a stamp and a function that calls `apply` with the values of the row.
    """
    return ((stamp_ns, partial(apply, stamp_ns, *row))
            for stamp_ns, *row in zip(times_ns.tolist(), *columns))


def _copied(state: State) -> State:
    """Return a copy of a state, which a controller may modify without affecting the motion."""
    return State._as_computed(state.time_ns, state._packed.copy(), None, state._rotors.copy())


@lru_cache
def _imported(name: str, folder: str) -> tuple[Path, Any]:
    """Import a controller, and return the source file of its module and the controller."""
    module, _, function = name.partition(':')
    if not (function.isidentifier() and all(map(str.isidentifier, module.split('.')))):
        raise InputError(f'controller: expected MODULE:FUNCTION, found {quoted(name)}')
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        with redirect_stdout(sys.stderr):  # standard output is reserved for results
            imported = import_module(module)
    except BaseException as error:  # a module may raise anything, even SystemExit
        interrupts.check()
        raise InputError(f'controller {name}: cannot import {module}: '
                         f'{_described(error)}') from error
    path = getattr(imported, '__file__', None)
    if path is None:
        raise InputError(f'controller {name}: expected a module with a source file, found one '
                         'without')
    if not hasattr(imported, function):
        raise InputError(f'controller {name}: expected a function {quoted(function)} in '
                         f'{module}, found none')
    target = getattr(imported, function)
    if not callable(target):
        raise InputError(f'controller {name}: expected a function or a class, found '
                         f'{quoted(target)}')
    return Path(path), target


def _digest(name: str, folder: str) -> str:
    """Return a hash of the source file of a controller."""
    path, _ = _imported(name, folder)
    try:
        return f'sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}'
    except OSError as error:
        raise InputError(f'controller {name}: cannot read {path}: {reason(error)}') from error


def _described(error: BaseException) -> str:
    text = ' '.join(str(error).split())
    return f'{type(error).__name__}: {text}' if text else type(error).__name__
