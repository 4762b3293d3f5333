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
Propagate given motions and write every result, for `arm.py` to compare between machines.

    python benchmarks/portable.py MOTIONS.pickle RESULTS.npz

Bodies, starts, torques and times are read rather than drawn, because numpy draws and scales random
numbers with functions whose last bit depends on the machine.
"""

from collections.abc import Iterator
import pickle
import sys

import bits
import numpy as np
from rigid_body_ros import GravityGradient, propagate, RigidBody, State, UniformField
from rigid_body_ros.common.arrays import ENTRIES
from rigid_body_ros.mechanics import euler, so3, urdf

#: The attributes that are the arguments of a class.
ARGUMENTS = {RigidBody: ['inertia'], State: ['time_ns', 'attitude', 'angular_velocity'],
             UniformField: ['moment', 'field'],
             GravityGradient: ['mean_motion', 'position', 'normal', 'time_ns']}
#: Written in place of results if a solver rejects a motion.
REJECTED = np.array([np.nan])
_URDF = ('<robot name="robot"><link name="body"><inertial><origin rpy="0.3 -1.1 2.5"/>'
         '<mass value="2"/><inertia {}/></inertial></link></robot>')


class Writer(pickle.Pickler):
    """Writes the arguments of objects, so that another machine computes the rest itself."""

    def reducer_override(self, value):
        """Return the class and the arguments of an object, if it is one of ARGUMENTS."""
        names = ARGUMENTS.get(type(value))
        if names is None:
            return NotImplemented
        return type(value), tuple(getattr(value, name) for name in names)


def groups(motion: bits.Motion, number: int | None,
           solvers: dict[str, int]) -> Iterator[tuple[str, Iterator[np.ndarray]]]:
    """
    Yield the name of each group of a motion's results, and its arrays.

    Parameters
    ----------
    motion : bits.Motion
        Body, start, torques, times, options and fields.
    number : int or None
        For a random motion, the seed of the order in which a Propagator is asked for states.
    solvers : dict
        For a scene, the last time, ns, that each solver computes, by name.

    """
    yield 'bodies', described(motion)
    yield 'urdf, point masses', read_bodies(motion)
    yield 'so3', turned(motion)
    if number is not None:
        yield from bits.groups(motion, number)
        yield 'euler functions', converted(motion)
    for solver, last_ns in solvers.items():
        yield f'scenes {solver}', scene(motion, solver, last_ns)


def described(motion: bits.Motion) -> Iterator[np.ndarray]:
    """Yield the quantities that the library computes from a body and its start."""
    body, rates = motion.body, motion.start.angular_velocity
    for factor in (3.0, 0.7, 1.0 + 2.0 ** -50, 1.0 - 2.0 ** -50):
        yield State(0, factor * motion.start.attitude).attitude
    yield from (body.principal_moments, body.principal_axes, body.angular_momentum(rates),
                body.kinetic_energy(rates), body.angular_acceleration(rates, rates),
                body.torque(rates, rates), body.moment_about((1.0, 2.0, 3.0)))


def read_bodies(motion: bits.Motion) -> Iterator[np.ndarray]:
    """Yield inertia tensors that are read from a URDF, and computed from point masses."""
    tensor = motion.body.inertia
    entries = ' '.join(f'i{name}="{tensor.item(place)}"' for name, place in ENTRIES.items())
    yield urdf.inertia(_URDF.format(entries))
    masses = 1.0 + np.arange(12.0) / 7.0
    places = np.arange(36.0).reshape(12, 3) ** 2 % 7.0
    yield RigidBody.from_point_masses(masses, places + motion.start.attitude[:3]).inertia


def turned(motion: bits.Motion) -> Iterator[np.ndarray]:
    """Yield results of the functions of `so3` for the start."""
    attitude, rates = motion.start.attitude, motion.start.angular_velocity
    turn = so3.exp(rates)
    yield turn
    yield so3.log(attitude)
    yield so3.log(turn)
    yield so3.multiply(attitude, turn)
    yield so3.rotate(attitude, rates)
    yield so3.matrix(attitude)
    yield so3.from_matrix(so3.matrix(attitude))
    yield so3.angle_between(attitude, turn)


def converted(motion: bits.Motion) -> Iterator[np.ndarray]:
    """Yield attitudes from Euler angles, and rates converted there and back, in all sequences."""
    trajectory = propagate(motion.body, motion.start, motion.log, at=motion.at, **motion.options)
    for sequence in bits.SEQUENCES:
        for name in (sequence, sequence.lower()):
            angles = euler.from_quaternion(trajectory.attitude, name)
            yield angles
            yield euler.to_quaternion(angles, name)
            rates = euler.rates(angles, trajectory.angular_velocity, name)
            yield rates
            yield euler.angular_velocity(angles, rates, name)
            yield euler.rotation_axes(angles, name)


def scene(motion: bits.Motion, solver: str, last_ns: int) -> Iterator[np.ndarray]:
    """Yield attitude, rates and Euler angles by a solver up to a time."""
    trajectory = propagate(motion.body, motion.start, motion.log,
                           at=motion.at[motion.at <= last_ns], **motion.solver_options(solver))
    yield trajectory.attitude
    yield trajectory.angular_velocity
    for sequence in ('ZXZ', 'ZYX'):
        yield trajectory.euler_angles(sequence)
        yield trajectory.euler_angles(sequence, continuous=True)


def results(motions: dict[str, tuple]) -> dict[str, np.ndarray]:
    """Return the results of all motions, each under the key 'group/name of the motion'."""
    found = {}
    for name, arguments in motions.items():
        for group, arrays in groups(*arguments):
            try:
                rows = [np.asarray(array, float).ravel() for array in arrays]
            except ValueError:
                rows = [REJECTED]
            found[f'{group}/{name}'] = np.concatenate(rows)
    return found


def main() -> None:
    """Read motions, and write results."""
    source, target = sys.argv[1:]
    with open(source, 'rb') as file:
        motions = pickle.load(file)
    np.savez(target, **results(motions))


if __name__ == '__main__':
    main()
