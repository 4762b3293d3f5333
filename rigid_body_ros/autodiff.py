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
Differentiate motions: in JAX, in PyTorch, or in an optimiser of your own.

The inputs of a motion are arrays by name. Those that are not given are as in the problem.

    ==================  =======  =============================================================
    `inertia`           (3, 3)   kg m^2, body axes, symmetric
    `damping`           (3, 3)   N m s/rad, body axes, symmetric
    `attitude`          (4,)     at the start, x y z w, body to space, of any norm but zero
    `angular_velocity`  (3,)     at the start, rad/s, body axes
    `rotor_momentum`    (3,)     at the start, N m s, body axes
    `torques`           (n, 3)   N m, body axes: the held samples of the first log, by time
    ==================  =======  =============================================================

The outputs at m times are the attitude (quaternions x y z w, shape (m, 4)) and the angular
velocity (rad/s, body axes, shape (m, 3)). A gradient has the shape of its input. The gradient by a
tensor is symmetric, and the gradient by the quaternion at the start is orthogonal to it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats, symmetric
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation import Problem, Trajectory
from rigid_body_ros.propagation.options import checked_times

#: The parameters of `Problem.derivatives` that give the gradient by an input, and the prefix of
#: their components.
_PARAMETERS = {'inertia': ('inertia', 'inertia.'), 'damping': ('damping', 'damping.'),
               'attitude': ('start', 'initial_attitude.'),
               'angular_velocity': ('start', 'initial_angular_velocity.'),
               'rotor_momentum': ('rotor_momentum', 'initial_rotor_momentum.')}
#: The places of the six entries of a symmetric tensor. An entry off the diagonal has two places,
#: each of which gets half of the derivative.
_PLACES = symmetric(np.arange(6)).astype(int)
_SHARES = 0.5 + 0.5 * np.eye(3)
#: The flow from the start is inverted only up to this condition number, because the inverse loses
#: as many digits as that has.
_INVERTED = 1e4
_outputs = attrgetter('attitude', 'angular_velocity')


def vjp(problem: Problem, inputs: Mapping[str, ArrayLike], *, at: ArrayLike
        ) -> tuple[Trajectory, Callable[[ArrayLike, ArrayLike], dict[str, Floats]]]:
    """
    Return a motion, and the function that takes gradients by the motion to those by its inputs.

    Parameters
    ----------
    problem : Problem
        The problem, from which all inputs come that are not given.
    inputs : mapping from str to array
        The inputs by which to differentiate; see the module.
    at : array of int, shape (m,), ns
        Times, in any order, none before the start.

    Returns
    -------
    motion : Trajectory
    pull : function
        Takes the gradients by the attitude, shape (..., m, 4), and by the angular velocity, shape
        (..., m, 3), and returns the gradients by the inputs, by name, with the same leading axes.
        It raises ValueError if `Problem.derivatives` does.

    Raises
    ------
    ValueError
        An input is unknown or its array is not as it must be, torques are given for a problem
        without a log or whose first log is interpolated, in space axes or that of an actuator, or
        `Problem.propagate` raises it.

    """
    arrays = {name: np.asarray(values, float) for name, values in inputs.items()}
    _check(problem, arrays)
    changed = _with_inputs(problem, arrays)
    motion = changed.propagate(at=at)
    return motion, partial(_gradients, changed, motion, arrays)


def jax_motion(problem: Problem, *, at: ArrayLike
               ) -> Callable[[Mapping[str, Any]], tuple[Any, Any]]:
    """
    Return a motion as a function for JAX, from inputs to attitude and angular velocity.

    The function works under `jax.grad`, `jax.jit` and `jax.vmap`, on the host. It has first
    derivatives in reverse mode only.

    Parameters
    ----------
    problem, at
        As for `vjp`.

    Raises
    ------
    ValueError
        A time is wrong. The function raises ValueError if JAX has no floats of 64 bits, or if a
        name or a shape is wrong. What else `vjp` raises is in the text of a `JaxRuntimeError`.

    """
    import jax
    times_ns, *_ = checked_times(at, problem.start.time_ns)
    on_host = partial(jax.pure_callback, vmap_method='sequential')

    def outputs(inputs: dict[str, Any]) -> tuple[Any, Any]:
        shapes = tuple(jax.ShapeDtypeStruct((len(times_ns), size), float) for size in (4, 3))
        return on_host(lambda arrays: _outputs(vjp(problem, arrays, at=times_ns)[0]), shapes,
                       inputs)

    def gradients(inputs: dict[str, Any], pulled: tuple[Any, Any]) -> tuple[dict[str, Any]]:
        return on_host(
            lambda arrays, pulls: (vjp(problem, arrays, at=times_ns)[1](*pulls),),
            ({name: jax.ShapeDtypeStruct(x.shape, float) for name, x in inputs.items()},),
            inputs, pulled)

    motion = jax.custom_vjp(outputs)
    motion.defvjp(lambda inputs: (motion(inputs), inputs), gradients)

    def checked(inputs: Mapping[str, Any]) -> tuple[Any, Any]:
        if not jax.config.jax_enable_x64:
            raise ValueError("jax_enable_x64: expected jax.config.update('jax_enable_x64', True), "
                             'found JAX with floats of 32 bits')
        arrays = {name: jax.numpy.asarray(values, float) for name, values in inputs.items()}
        _check(problem, arrays)  # here, because JAX reports errors on the host with a traceback
        return motion(arrays)

    return checked


def torch_motion(problem: Problem, *, at: ArrayLike
                 ) -> Callable[[Mapping[str, Any]], tuple[Any, Any]]:
    """
    Return a motion as a function for PyTorch, from inputs to attitude and angular velocity.

    The function has first derivatives. Its tensors are on the host.

    Parameters
    ----------
    problem, at
        As for `vjp`. The function raises ValueError as `vjp` does, and if a tensor is not of
        float64.

    """
    import torch

    class TorchMotion(torch.autograd.Function):  # type: ignore[misc]

        @staticmethod
        def forward(context: Any, names: Sequence[str], *tensors: Any) -> tuple[Any, ...]:
            for name, tensor in zip(names, tensors):
                if tensor.dtype != torch.float64:
                    raise ValueError(f'{name}: expected a tensor of torch.float64, '
                                     f'found {tensor.dtype}')
            inputs = {name: tensor.detach().numpy() for name, tensor in zip(names, tensors)}
            motion, context.pull = vjp(problem, inputs, at=at)
            context.names = names
            return tuple(map(torch.tensor, _outputs(motion)))

        @staticmethod
        @torch.autograd.function.once_differentiable  # type: ignore[untyped-decorator]
        def backward(context: Any, *pulls: Any) -> tuple[Any, ...]:
            gradients = context.pull(*[pull.detach().numpy() for pull in pulls])
            return None, *[torch.from_numpy(gradients[name]) for name in context.names]

    return lambda inputs: TorchMotion.apply(tuple(inputs), *inputs.values())


def _check(problem: Problem, inputs: Mapping[str, Any]) -> None:
    shapes = {'inertia': (3, 3), 'damping': (3, 3), 'attitude': (4,), 'angular_velocity': (3,),
              'rotor_momentum': (3,), 'torques': (len(problem.logs[0]) if problem.logs else 0, 3)}
    for name, values in inputs.items():
        if name not in shapes:
            raise ValueError(f'inputs: expected names among {", ".join(shapes)}, found {name!r}')
        if values.shape != shapes[name]:
            raise ValueError(f'{name}: expected shape {shapes[name]}, found {values.shape}')
    if 'torques' in inputs:
        _check_log(problem)


def _check_log(problem: Problem) -> None:
    log = problem.logs[0] if problem.logs else None
    for text, has in (('none', not log),
                      ('interpolated torques', log and log.interpolation != 'hold'),
                      ('torques in space axes', log and log.in_space.any()),
                      ('an actuator', any(problem.actuators[:1]))):
        if has:
            raise ValueError('torques: expected a first log with torques that are held, in body '
                             f'axes and without an actuator, found {text}')


def _with_inputs(problem: Problem, inputs: Mapping[str, Floats]) -> Problem:
    body, start, log = problem.body, problem.start, None
    if inputs.keys() & {'inertia', 'damping'}:
        body = RigidBody(inputs.get('inertia', body.inertia), inputs.get('damping', body.damping))
    if inputs.keys() & {'attitude', 'angular_velocity', 'rotor_momentum'}:
        start = State(start.time_ns, inputs.get('attitude', start.attitude),
                      inputs.get('angular_velocity', start.angular_velocity),
                      inputs.get('rotor_momentum', start.rotor_momentum), start.wheel_speeds)
    if 'torques' in inputs:
        log = [problem.logs[0].with_torques(inputs['torques']), *problem.logs[1:]]
    return problem.replaced(body=body, start=start, log=log)


def _turns(attitude: Floats) -> Floats:
    """Return twice the change of quaternions per rad about each body axis, shape (..., 3, 4)."""
    return so3.multiply(attitude[..., None, :], np.eye(3, 4))


def _gradients(problem: Problem, motion: Trajectory, inputs: Mapping[str, Floats],
               attitude: ArrayLike, angular_velocity: ArrayLike) -> dict[str, Floats]:
    """Return the gradients by the inputs; see `vjp`."""
    turned = 0.5 * np.einsum('mij,...mj->...mi', _turns(motion.attitude),
                             np.asarray(attitude, float))
    pulls = np.concatenate([turned, angular_velocity], axis=-1)
    # Whatever has no derivatives is found here, before wheels become rotors.
    derivatives = problem.derivatives(
        sorted({'start', *(_PARAMETERS[name][0] for name in inputs if name in _PARAMETERS)}),
        at=motion.times_ns)
    by_component = np.einsum('mip,...mi->...p', derivatives.both, pulls)
    gradients = {}
    for name in inputs:
        if name == 'torques':
            gradients[name] = _by_torques(problem.carried(), motion.times_ns, pulls)
            continue
        prefix = _PARAMETERS[name][1]
        gradients[name] = by_component[..., [
            component.startswith(prefix) for component in derivatives.names]]
        if name in ('inertia', 'damping'):
            gradients[name] = _SHARES * gradients[name][..., _PLACES]
        elif name == 'attitude':
            gradients[name] = 2.0 / np.linalg.norm(inputs[name]) * (
                gradients[name] @ _turns(problem.start.attitude))
    return gradients


def _by_torques(problem: Problem, times_ns: NDArray[np.int64], pulls: Floats) -> Floats:
    """Return the gradient by the torques of the first log, shape (..., n, 3)."""
    starts_ns, samples = problem.logs[0].segments(problem.options.timeout_ns)
    ends_ns = np.array([problem.start.time_ns, times_ns.max(initial=problem.start.time_ns)])
    between = (ends_ns[0] < starts_ns) & (starts_ns < ends_ns[1])
    grid_ns = np.unique(np.concatenate([ends_ns, times_ns, starts_ns[between]]))
    by_interval, _ = _by_intervals(
        problem, grid_ns, _summed(pulls, np.searchsorted(grid_ns, times_ns), len(grid_ns)))
    acting = np.append(-1, samples)[np.searchsorted(starts_ns, grid_ns[:-1], 'right')]
    # The intervals in which no sample acts have the row -1.
    return _summed(by_interval, acting, len(problem.logs[0]) + 1)[..., :-1, :]


def _summed(values: Floats, rows: NDArray[np.intp], count: int) -> Floats:
    """Return `count` rows, each the sum of the values that belong to it, shape (..., count, c)."""
    sums = np.zeros((*values.shape[:-2], count, values.shape[-1]))
    places: Any = (..., rows, slice(None))
    np.add.at(sums, places, values)
    return sums


def _by_intervals(problem: Problem, times_ns: NDArray[np.int64], pulls: Floats
                  ) -> tuple[Floats, Floats]:
    """
    Return the gradients by torques that act between times, and by the state at the first time.

    With the flow F(t) from the first time, and the change b(t) under a constant torque, a torque
    from s to t changes the state at u >= t by F(u) (F(t)^-1 b(t) - F(s)^-1 b(s)).

    Parameters
    ----------
    problem : Problem
        A problem without named wheels.
    times_ns : array of int, shape (k,), ns
        Ascending times, from the start of the problem on.
    pulls : array, shape (..., k, 6)
        Gradients by the rotation vector and the angular velocity at these times.

    Returns
    -------
    by_torques : array, shape (..., k - 1, 3)
    by_start : array, shape (..., 6)

    """
    flow, bias = np.split(problem.derivatives(
        ['start', 'torque_bias'], at=times_ns).both, [6], axis=2)
    if np.linalg.cond(flow[-2:][0]) > _INVERTED:
        return _in_halves(problem, times_ns, pulls)
    at_start = np.einsum('kij,...ki->...kj', flow, pulls)
    after = np.cumsum(at_start[..., ::-1, :], axis=-2)[..., ::-1, :]
    back = np.linalg.solve(flow[:-1], bias[:-1])
    by_torques = -np.einsum('kij,...ki->...kj', back, after[..., 1:, :])
    by_torques[..., :-1, :] += np.einsum('kij,...ki->...kj', back[1:], after[..., 1:-1, :])
    by_torques[..., -1:, :] += pulls[..., -1:, :] @ bias[-1]
    return by_torques, after[..., 0, :]


def _in_halves(problem: Problem, times_ns: NDArray[np.int64], pulls: Floats
               ) -> tuple[Floats, Floats]:
    """Return what `_by_intervals` does, from two flows, each from its own start."""
    middle = len(times_ns) // 2
    motion = problem.propagate(at=times_ns[middle:middle + 1])
    state = State(int(times_ns[middle]), *map(np.ravel, (
        motion.attitude, motion.angular_velocity, motion.rotor_momentum)))
    later, at_middle = _by_intervals(
        problem.replaced(start=state), times_ns[middle:], pulls[..., middle:, :])
    pulls = pulls[..., :middle + 1, :].copy()
    pulls[..., -1, :] = at_middle
    earlier, at_start = _by_intervals(problem, times_ns[:middle + 1], pulls)
    return np.concatenate([earlier, later], axis=-2), at_start
