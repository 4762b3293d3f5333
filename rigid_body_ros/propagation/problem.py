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

"""Everything that determines a motion, and the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.mechanics.actuator import Actuators
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.changes import BodyLog
from rigid_body_ros.mechanics.efforts import EffortLog
from rigid_body_ros.mechanics.fields import Field
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import Logs, TorqueLog
from rigid_body_ros.mechanics.wheels import Wheels
from rigid_body_ros.propagation.derivatives import derivatives as derivatives_of
from rigid_body_ros.propagation.inputs import MotionInputs, Rotors
from rigid_body_ros.propagation.integration import Integration
from rigid_body_ros.propagation.options import Options
from rigid_body_ros.propagation.origin import without_origin
from rigid_body_ros.propagation.trajectory import Derivatives, Trajectory
from rigid_body_ros.propagation.wheels import joined_log

#: `Problem.carried` takes the mean effort of a wheel at its largest speed over this time, ns.
_PIECE_NS = 10 ** 7


class Problem(MotionInputs):
    """
    Everything that determines a motion: a body, its start, its torques, and the solver.

    Parameters
    ----------
    body : RigidBody
        The body. It rotates about its centre of mass, which may move in any way.
    start : State
        The state at which the motion begins. If `Propagator.at` returned this state, the motion
        continues with the same bits as in the `Propagator`.
    log : TorqueLog or sequence of TorqueLog, optional
        The torques on the body, or None for torque-free motion. The torques of several logs add
        up. Each log is held, interpolated and timed out independently of the other logs, and its
        torque is zero before its first sample.
    wheels : TorqueLog or sequence of Wheel, optional
        Either a log of the motor torque on the rotors, in body axes, or a sequence of named
        wheels, whose commands are in `efforts`. The body feels the opposite torque.
    efforts : EffortLog, optional
        The motor torques commanded to named wheels.
    fields : sequence of UniformField or GravityGradient
        Torques that depend on the attitude. At most one of them may be a gravity gradient.
    changes : BodyLog, optional
        The bodies that replace `body`, each at its own stamp. If any of these stamps lie at or
        before the start, the motion starts with the body that has the latest of them.
    actuator : Actuator, or sequence of Actuator or None, optional
        The actuators, which delay, limit and lag the torques: one actuator for all logs, or one
        for each log. The samples of a log with an actuator are commands, which must be held, not
        interpolated. `torque_timeout` counts from the stamp of a command, but the actuator delays
        the effect of the timeout, too.
    solver : str
        'auto' uses the simplest model that the scene allows: the closed form for a long coast (a
        span without torques), and a Taylor series for anything else. 'taylor' always uses the
        series. 'exact' is the closed form and handles torque-free motion only. 'rk4', 'strang' and
        'explicit_euler' take fixed steps.
    tolerance : float
        Bound on the truncation error of the attitude per radian turned, 1e-15 to 1. The bound does
        not include rounding errors.
    max_step : float, optional, s
        Upper limit on the length of a step. Solvers with fixed steps require `max_step`, which is
        then the length of their steps.
    torque_timeout : float, s
        If positive, a sample acts for at most this long. After this time, the torque is zero until
        the next sample.

    Attributes
    ----------
    body : RigidBody
    start : State
    logs : tuple of TorqueLog
        The logs that contain samples.
    wheels : TorqueLog, optional
        The torque on the rotors. None if the given log has no samples, or if named wheels were
        given.
    named_wheels : Wheels, optional
        The named wheels.
    efforts : EffortLog, optional
        None if there are no commands.
    fields : tuple of UniformField or GravityGradient
        The fields. A gravity gradient that was given without a time gets the time of the start.
    changes : BodyLog, optional
        None if the body does not change.
    actuators : tuple of Actuator or None
        The actuator of each log; empty if there are no actuators.
    acting_logs : tuple of TorqueLog
        The logs with the delays and limits of the actuators applied, but without the lags.
    options : Options

    Raises
    ------
    ValueError
        An option is out of its range; the torque on rotors is in space axes; there are two gravity
        gradients; the named wheels do not fit the body or the start; the efforts do not fit
        the wheels; a gravity gradient is combined with named wheels, which is not supported yet;
        the commands of an actuator are interpolated; or the solver does not handle the torques,
        rotors, damping, friction or fields that are given.

    """

    def carried(self) -> Problem:
        """
        Return a problem with the same motion, in which rotors replace the named wheels.

        The bodies of the returned problem lack the axial inertia of the wheels. While a wheel is
        at its largest speed, its effort is replaced by means over 10 ms. If there are no named
        wheels, the method returns the problem itself.

        Raises
        ------
        ValueError
            A wheel has friction, so the torque on its rotor depends on the motion.

        """
        if not self.named_wheels:
            return self
        wheels, changes = self.named_wheels, self.changes
        if found := ', '.join(wheel.name for wheel in wheels.wheels if wheel.friction):
            raise ValueError('wheels: expected none with friction, which only a propagation '
                             f'computes, found {found}')
        unlimited = Wheels([replace(wheel, max_speed=0.0) for wheel in wheels.wheels]) \
            if wheels.is_limited else wheels
        start, _ = unlimited.begun(self.start)
        carrier = unlimited.carrier
        end_ns = int(self.efforts.times_ns.max(initial=self.start.time_ns)) if self.efforts \
            else self.start.time_ns
        motion = self.propagate(at=[end_ns])
        log = joined_log([part.wheels for part in motion._parts if part.wheels])
        if motion.at_limit:
            log = self._mean_efforts(motion, end_ns)
        return self.replaced(
            body=carrier(self.body), start=without_origin(start), wheels=log,
            changes=changes and BodyLog(changes.times_ns, [*map(carrier, changes.bodies)],
                                        changes.keep))

    def _mean_efforts(self, motion: Trajectory, end_ns: int) -> TorqueLog:
        """Return the mean torque on the wheels between all times at which it may change."""
        assert self.named_wheels
        times_ns = np.unique(np.concatenate([
            [self.start.time_ns, end_ns], self.stamps_ns,
            *(np.append(np.arange(span.begin_ns, span.end_ns, _PIECE_NS), span.end_ns)
              for span in motion.at_limit),
            *(part.timeline.times_ns for part in motion._parts)]))
        times_ns = times_ns[(times_ns >= self.start.time_ns) & (times_ns <= end_ns)]
        exact = self.propagate(at=times_ns)
        momenta = exact._coupled(slice(None))[:, :len(self.named_wheels)]
        efforts = np.diff(momenta, axis=0) / np.diff(times_ns)[:, None] * 1e9
        return TorqueLog(times_ns, self.named_wheels.torque(
            np.concatenate([efforts, exact.wheel_efforts[-1:]])))

    def rotor_momentum(self, times_ns: NDArray[np.int64]) -> Floats:
        """Return the rotor momentum at given times, N m s, body axes, shape (m, 3)."""
        if self.named_wheels:  # the momentum of named wheels depends on the motion
            return self.propagate(at=times_ns).rotor_momentum
        return Integration(self.with_first_body()).rotor_momentum(times_ns)

    def angular_acceleration(self, times_ns: NDArray[np.int64], attitude: Floats,
                             angular_velocity: Floats) -> Floats:
        """
        Return the angular acceleration in a motion, rad/s^2, body axes, shape (m, 3).

        Parameters
        ----------
        times_ns : array of int, shape (m,), ns
            The times, in any order.
        attitude : array, shape (m, 4)
            The attitudes at these times, x y z w.
        angular_velocity : array, shape (m, 3), rad/s, body axes
            The angular velocities at these times.

        """
        torque = self.torque(times_ns, attitude) - angular_velocity @ self.body.damping
        if self.has_rotors:
            torque += np.cross(self.rotor_momentum(times_ns), angular_velocity)
        if self.wheels:
            torque -= self.wheels.at(times_ns, self.options.timeout_ns)[0]
        return self.body.angular_acceleration(angular_velocity, torque)

    def propagate(self, *, at: ArrayLike) -> Trajectory:
        """
        Return the motion at given times.

        Parameters
        ----------
        at : array of int, shape (m,), ns
            The times, in any order, none before the start.

        Returns
        -------
        Trajectory
            The state at each time, in the order of `at`.

        Raises
        ------
        ValueError
            A time lies before the start.
            A time is not an integer that fits in int64.
            The torques accelerate the body beyond 1e9 rad/s.

        """
        return Integration(self).advance(at)

    def derivatives(self, names: Sequence[str], *, at: ArrayLike) -> Derivatives:
        """
        Return how the motion changes with its start and with parameters.

        The derivatives are those of the Taylor series of the motion, whatever the solver. They are
        accurate to rounding errors, which grow as the motion itself amplifies changes.

        Parameters
        ----------
        names : sequence of str
            'inertia' (six entries), 'start' (attitude as a rotation vector in body axes, and
            angular velocity), 'torque_gain', 'torque_gains', 'torque_bias', 'torque_delay',
            'torque_lag', 'damping', 'rotor_momentum', and 'NAME.moment' of a uniform field with a
            name, as in `attitude_identify --estimate`. The torques of the logs are multiplied by
            the gains, in their own axes. A delay and a lag add to those of the actuators; for a
            log without a lag, a small lag acts like a delay. The bias acts from the start. The
            inertia and the damping are those of `body`, until it changes.
        at : array of int, shape (m,), ns
            Times, in any order, none before the start.

        Returns
        -------
        Derivatives
            Gains, delay and lag come last, otherwise in the order of `names`. At the stamp of a
            torque that jumps, the derivative by a delay is that of a longer delay.

        Raises
        ------
        ValueError
            A name is unknown or given twice, no name is given, a time is before the start, or the
            body turns too fast. Wheels with friction or a largest speed have no derivatives yet.

        """
        return derivatives_of(self, names, at)


def propagate(body: RigidBody, start: State, log: Logs = None, *, at: ArrayLike,
              wheels: Rotors = None, efforts: EffortLog | None = None,
              fields: Sequence[Field] = (), changes: BodyLog | None = None,
              actuator: Actuators = None,
              solver: str = Options.solver, tolerance: float = Options.tolerance,
              max_step: float | None = Options.max_step,
              torque_timeout: float = Options.torque_timeout,
              derivatives: Sequence[str] = ()) -> Trajectory:
    """
    Integrate Euler's equations under torque logs, and return the motion at given times.

    Parameters
    ----------
    at : array of int, shape (m,), ns
        The times, in any order, none before the start.
    body, start, log, wheels, efforts, fields, changes, actuator
        See `Problem`.
    solver, tolerance, max_step, torque_timeout
        See `Problem`.
    derivatives : sequence of str
        Names for `Problem.derivatives`, whose result becomes an attribute of the motion.

    Returns
    -------
    Trajectory
        The state at each time, in the order of `at`.

    Raises
    ------
    ValueError
        A time lies before the start, or is not an integer that fits in int64.
        An option is out of its range, or torques are given to the solver 'exact'.
        The torques accelerate the body beyond 1e9 rad/s.
        `Problem.derivatives` raises it.

    """
    problem = Problem(
        body, start, log, wheels=wheels, efforts=efforts, fields=fields, changes=changes,
        actuator=actuator, solver=solver, tolerance=tolerance, max_step=max_step,
        torque_timeout=torque_timeout)
    motion = problem.propagate(at=at)
    return replace(motion, derivatives=problem.derivatives(derivatives, at=at)) if derivatives \
        else motion
