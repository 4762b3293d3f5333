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
Extreme motions of bodies, each with an exact result of 50 digits, or of 25 under torque.

`test_extremes.py` checks every solver against these results, and `benchmarks/extremes.py` prints
the error of each solver. `python test/scenes.py` writes the results under torque to a file,
because it takes seconds to compute them.
"""

from dataclasses import dataclass
from functools import cached_property
import json
from pathlib import Path

from mpmath import mp
import numpy as np
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation import SOLVERS
import truth

SECOND = 10 ** 9
FILE = Path(__file__).with_name('truth_extremes.json')
#: Results under torque, by name: attitudes, rates, and the effect of a change of the last digits.
RESULTS = json.loads(FILE.read_text()) if FILE.exists() else {}
FIXED_STEP = ('rk4', 'strang', 'explicit_euler')
ULP = 2.0 ** -52
#: Rounding error of the steps for a turn of one radian. The errors are random, so the error of the
#: rates grows with the root of the angle. The error of the attitude, their sum, grows with the
#: power 3/2 (Brouwer, "On the accumulation of errors in numerical integration", 1937).
LOSS = 5e-17


@dataclass(frozen=True)
class Scene:
    """
    A body, a start from the identity, and torques one after the other.

    Attributes
    ----------
    group, name : str
    tensor : array, shape (3,) or (3, 3), kg m^2
        Principal moments, or the whole tensor.
    rates : (float, float, float), rad/s, body axes
    seconds : float
        Duration of the motion; ignored if there are torques.
    torques : [(duration_ns, torque, in_space)]
        Samples, each with the time to the next. The last sample is held.
    interpolation : str
        Interpolation between the samples.
    amplifies : bool
        Whether the motion itself amplifies rounding errors.

    """

    group: str
    name: str
    tensor: object
    rates: tuple
    seconds: float = 0.0
    torques: tuple = ()
    interpolation: str = 'hold'
    amplifies: bool = False

    @cached_property
    def body(self):
        tensor = np.asarray(self.tensor, float)
        return RigidBody(np.diag(tensor) if tensor.ndim == 1 else tensor)

    @cached_property
    def start(self):
        return State(0, angular_velocity=self.rates)

    @cached_property
    def times_ns(self):
        """Return the times at which the motion is compared with the truth."""
        if self.torques:
            return np.cumsum([duration for duration, _, _ in self.torques])
        end = round(self.seconds * SECOND)
        return np.array([end // 3, end])

    @cached_property
    def log(self):
        if not self.torques:
            return None
        durations, torques, in_space = zip(*self.torques)
        return TorqueLog(np.cumsum((0, *durations[:-1])), torques,
                         np.array(in_space), self.interpolation)

    @cached_property
    def solvers(self):
        """Return the solvers that can compute the motion."""
        return tuple(solver for solver in SOLVERS if solver != 'exact' or not self.torques)

    def propagate(self, solver, at=None, **options):
        step = self.step if solver in FIXED_STEP else None
        return propagate(self.body, self.start, self.log, at=self.times_ns if at is None else at,
                         **{'solver': solver, 'max_step': step, **options})

    @cached_property
    def truth(self):
        """Return the true attitudes and rates at `times_ns`."""
        tensor, attitude = self.body.inertia, self.start.attitude
        if self.torques:
            return [truth.exact(rows) for rows in RESULTS[self.name][:2]]
        return list(zip(*(truth.free(tensor, attitude, self.rates, time_ns)
                          for time_ns in self.times_ns.tolist())))

    def computed(self):
        """Return what `RESULTS` has of a motion under torque."""
        attitudes, rates = zip(*self._series(self.body.inertia, self.rates, self.log.torques))
        return [[[mp.nstr(x, 25) for x in row] for row in attitudes],
                [[mp.nstr(x, 25) for x in row] for row in rates],
                self._growth_under_torque(attitudes) if self.amplifies else 0.0]

    def _series(self, tensor, rates, torques, digits=25):
        between = truth.polynomials(self.log.times_ns, torques, self.interpolation)
        return truth.series(tensor, self.start.attitude, rates, [
            (duration, rows, in_space)
            for (duration, _, in_space), rows in zip(self.torques, between)], digits)

    def errors(self, motion):
        """Return the errors of a motion: angles, rad, and rates, rad/s."""
        attitudes, rates = self.truth
        return (np.array([truth.chord(q, p) for q, p in zip(attitudes, motion.attitude)]),
                np.array([np.linalg.norm((w - v).astype(float))
                          for w, v in zip(rates, motion.angular_velocity)]))

    @cached_property
    def _speeds(self):
        times = np.linspace(0, int(self.times_ns[-1]), 2001).astype(np.int64)
        return np.linalg.norm(self.propagate('auto', at=times).angular_velocity, axis=1)

    @cached_property
    def phase(self):
        """Return the integral of |w| dt, rad; for a long motion, estimated from samples."""
        return self._speeds.mean() * int(self.times_ns[-1]) * 1e-9

    @cached_property
    def fastest(self):
        """Return the largest |w|, rad/s."""
        return self._speeds.max()

    @cached_property
    def step(self):
        """Return the step, s, of solvers that need one: a power of ten, less than 0.1 rad long."""
        return 10.0 ** np.clip(np.floor(np.log10(0.1 / max(self.fastest, 1e-99))), -9, 6)

    @property
    def steps(self):
        """Return the number of these steps."""
        return int(self.times_ns[-1]) * 1e-9 / self.step

    @cached_property
    def bar(self):
        """Return the error, rad, of a solver that is exact to rounding."""
        return 1e-15 * (10.0 + self.phase)

    def bound(self, solver):
        """Return the bound on the error of a solver, rad; larger for the Taylor series."""
        if self.torques:
            return min(10.0 * self.bar, self.growth) if self.amplifies else self.bar
        if solver != 'taylor':
            return self.bar
        return self.bar + LOSS * self.phase ** 1.5 + (4.0 * self.growth if self.amplifies else 0.0)

    @cached_property
    def growth(self):
        """
        Return the effect, rad, of a change of the last digits.

        The changed numbers are the rates and, under torque, also the inertia and the torques.
        """
        return RESULTS[self.name][2] if self.torques else self._growth_of_rates()

    def _growth_under_torque(self, attitudes):
        random = np.random.default_rng(0)

        def moved(values):
            return np.nextafter(values, random.choice([-np.inf, np.inf], np.shape(values)))
        upper = np.triu(moved(self.body.inertia))
        # Eight digits suffice for a difference.
        states = self._series(upper + np.triu(upper, 1).T, moved(self.rates),
                              moved(self.log.torques), digits=8)
        return max(truth.chord(there, here.astype(float))
                   for (there, _), here in zip(states, attitudes))

    def _growth_of_rates(self):
        # The largest change for a perturbation at one of five instants.
        end = int(self.times_ns[-1])
        tensor, last = self.body.inertia, self.truth[0][-1]
        moved = []
        for moment in range(0, end, end // 5 + 1):
            attitude, rates = truth.free(tensor, self.start.attitude, self.rates, moment)
            with mp.workdps(50):
                rates = rates + truth.exact(ULP * float(max(abs(rates))) * np.ones(3))
            there, _ = truth.free(tensor, attitude, rates, end - moment)
            moved.append(truth.chord(there, last.astype(float)))
        return max(moved)


#: Rotation of the principal axes of a full tensor.
TURN = (0.3, -0.1, 0.7, 0.4)


def turned(moments, rates):
    """Return the tensor and the rates of a body whose principal axes are not the body axes."""
    rotation = so3.matrix(so3.normalize(TURN))
    tensor = rotation @ np.diag(moments) @ rotation.T
    return 0.5 * (tensor + tensor.T), tuple(rotation @ rates)


def gusts(count, seconds, sizes, *, in_space=False, seed=0):
    """Return random torques with given sizes along the axes of `turned`, or the space axes."""
    axes = np.eye(3) if in_space else so3.matrix(so3.normalize(TURN))
    random = np.random.default_rng(seed)
    return tuple(held(seconds, *(axes @ (sizes * random.normal(size=3))), in_space=in_space)
                 for _ in range(count))


def held(seconds, *torque, in_space=False):
    return (round(seconds * SECOND), torque, in_space)


ROD, ROD_RATES = (1e-6, 1.0, 1.0000005), (50.0, 1.0, 1.0)
PLATE, FREE_RATES = (1.0, 2.0, 3.0), (1.0, 0.4, 2.0)
FULL = np.array([[1.1, 0.15, -0.2], [0.15, 2.0, 0.05], [-0.2, 0.05, 2.7]])
FULL_RATES = (0.5, -0.7, 0.9)


def bodies():
    group = 'Rods, plates, near-spheres'
    yield Scene(group, 'rod, 1e-6 : 1 : 1 + 5e-7', ROD, ROD_RATES, 10.0)
    yield Scene(group, 'rod, 1e-6 : 1 : 1 + 5e-7, full tensor', *turned(ROD, ROD_RATES), 10.0)
    yield Scene(group, 'rod, 1e-6 : 1 : 1', (1e-6, 1.0, 1.0), ROD_RATES, 10.0)
    yield Scene(group, 'ruler, I1 + I2 = I3, 1e-6 : 1 : 1 + 1e-6', (1e-6, 1.0, 1.000001),
                ROD_RATES, 10.0)
    yield Scene(group, 'plate, I1 + I2 = I3', PLATE, FREE_RATES, 100.0)
    yield Scene(group, 'plate, I1 + I2 = I3, full tensor', *turned(PLATE, FREE_RATES), 100.0)
    yield Scene(group, 'plate of rounded digits, I3 > I1 + I2', (1.0, 2.0, 3.05), FREE_RATES,
                100.0)
    yield Scene(group, 'disc, 1 : 1 : 2', (1.0, 1.0, 2.0), FREE_RATES, 100.0)
    yield Scene(group, 'almost a disc, 1 : 1 + 1e-12 : 2', (1.0, 1.0 + 1e-12, 2.0), FREE_RATES,
                100.0)
    yield Scene(group, 'sphere', (1.0, 1.0, 1.0), FREE_RATES, 1000.0)
    for part in (1e-9, 1e-12, 2.0 ** -52):
        yield Scene(group, f'near-sphere, 1 : 1 + {part:.0e} : 1 + {2 * part:.0e}',
                    (1.0, 1.0 + part, 1.0 + 2 * part), FREE_RATES, 1000.0)
    yield Scene(group, 'near-sphere 1e-9, full tensor',
                *turned((1.0 - 1e-9, 1.0, 1.0 + 1e-9), FREE_RATES), 1000.0)
    yield from under_torque(group)


def under_torque(group):
    thin, across = (20.0, 3.0, 1.0), (1e-5, 0.5, 0.5)
    rod, wide, ruler, plate = (turned(moments, rates) for moments, rates in (
        (ROD, (40.0, 1.0, 1.0)), ((1e-4, 1.0, 1.00005), thin), ((1e-6, 1.0, 1.000001), thin),
        (PLATE, (1.0, 2.0, 3.0))))
    yield Scene(group, 'rod 1e-6, full tensor, body torques', *rod, torques=gusts(4, 1.0, across),
                amplifies=True)
    yield Scene(group, 'rod 1e-6, full tensor, linear body torque', *rod,
                torques=gusts(4, 1.0, across), interpolation='linear', amplifies=True)
    yield Scene(group, 'rod 1e-4, full tensor, space torques', *wide,
                torques=gusts(4, 1.5, 0.01 * np.ones(3), in_space=True), amplifies=True)
    yield Scene(group, 'ruler 1e-6, full tensor, cubic body torque', *ruler,
                torques=gusts(6, 1.2, across), interpolation='cubic', amplifies=True)
    yield Scene(group, 'plate, full tensor, body torques', *plate,
                torques=gusts(5, 6.0, np.ones(3)))
    yield Scene(group, 'plate, full tensor, linear space torque', *plate,
                torques=gusts(5, 4.0, np.ones(3), in_space=True), interpolation='linear')


def sizes():
    group = 'Large and small numbers'
    yield Scene(group, 'an ordinary body, full tensor', FULL, FULL_RATES, 100.0)
    for scale in (1e12, 1e-12, 1e30, 1e-30):
        yield Scene(group, f'tensor of the ordinary body times {scale:.0e}', scale * FULL,
                    FULL_RATES, 100.0)
    yield Scene(group, 'spin of 1e4 rad/s', FULL, (1e4, 1.0, -1.0), 1.0)
    yield Scene(group, 'tumbling at 1e4 rad/s', FULL, (5e3, -7e3, 6e3), 1.0)
    yield Scene(group, 'tumbling at 1e8 rad/s', FULL, (5e7, -7e7, 6e7), 1e-4)
    yield Scene(group, 'rates of 1e-9 rad/s, ten years', FULL, (5e-10, -7e-10, 6e-10), 3.15e8)
    yield Scene(group, 'rates of 1e-200 rad/s, a day', FULL, (5e-201, -7e-201, 6e-201), 86400.0)
    yield Scene(group, 'torque over inertia of 1e8, from rest', FULL, (0.0, 0.0, 0.0),
                torques=(held(3e-4, 1e8, -2e8, 1e8),))
    yield Scene(group, 'torque over inertia of 1e8, from rest, space axes', FULL, (0.0, 0.0, 0.0),
                torques=(held(3e-4, 1e8, -2e8, 1e8, in_space=True),))
    yield Scene(group, 'rod under torque across, 1e8 along', ROD, (0.0, 0.0, 0.0),
                torques=(held(3e-4, 100.0, 1e3, -1e3),))


def times():
    group = 'Short and long times'
    yield Scene(group, 'torques 1 ns apart', FULL, (1e4, -2e4, 1e4), torques=tuple(
        (1, tuple(torque), k % 2 == 0) for k, torque in enumerate(
            np.random.default_rng(1).normal(scale=1e8, size=(100, 3)))))
    yield Scene(group, 'torques a day apart', FULL, (2e-5, -1e-5, 1e-5), torques=(
        held(86400.0, 2e-10, -4e-10, 2e-10), held(86400.0, 0.0, 0.0, 0.0),
        held(86400.0, -2e-10, 1e-10, 3e-10, in_space=True)))
    yield Scene(group, 'a coast of a day', FULL, FULL_RATES, 86400.0)
    yield Scene(group, 'a million turns, plate', PLATE, FREE_RATES, 2.8e6)
    yield Scene(group, 'a million turns, full tensor', FULL, FULL_RATES, 5.1e6)
    yield Scene(group, 'a million turns, near-sphere 1e-9', (1.0, 1.0 + 1e-9, 1.0 + 2e-9),
                FREE_RATES, 2.8e6)


def unstable():
    group = 'Separatrix and intermediate axis'
    # I1 (I2 - I1) w1^2 = I3 (I3 - I2) w3^2 where w1 = 3 w3: exactly on the separatrix, even in
    # doubles.
    moments = (4.0, 5.0, 9.0)
    yield Scene(group, 'on the separatrix', moments, (3.0, 0.5, 1.0), 30.0, amplifies=True)
    for offset in (1e-3, 1e-6, 1e-9, 1e-12):
        for sign in (1.0, -1.0):
            yield Scene(group, f'off the separatrix by {sign * offset:+.0e}', moments,
                        (3.0, 0.5, 1.0 + sign * offset), 30.0, amplifies=True)
    yield Scene(group, 'about the intermediate axis', PLATE, (0.0, 1.0, 0.0), 1000.0)
    yield Scene(group, 'about the intermediate axis, full tensor',
                *turned(PLATE, (0.0, 1.0, 0.0)), 50.0, amplifies=True)
    for offset in (1e-3, 1e-8, 1e-15):
        yield Scene(group, f'off the intermediate axis by {offset:.0e}', PLATE,
                    (offset, 1.0, 0.0), 100.0, amplifies=True)


def published():
    group = 'Where others broke'
    yield Scene(group, 'MuJoCo #3553, a thin stick', (1.7231e-4, 6.58e-6, 1.7243e-4),
                (5.0, 20.0, 5.0), 10.0)
    yield Scene(group, "Gazebo's boxes", (0.80833, 0.68333, 0.14167), (0.1, 5.0, 0.1), 10.0,
                amplifies=True)
    yield Scene(group, 'Avian #993, about the largest moment', PLATE, (0.01, 0.01, 5.0), 1e4)
    yield Scene(group, 'Avian #993, about the smallest moment', PLATE, (5.0, 0.01, 0.01), 1e4)
    yield Scene(group, "van Zon's top", (10.0, 20.0, 26.0), (1.0, 15.0, 1.0), 10.0,
                amplifies=True)
    # m_c = 9e-11, where SciPy's `ellipj` is off by 2.
    yield Scene(group, 'SciPy #8480, modulus near 1', PLATE, (1e-5, 1.0, 0.0), 30.0,
                amplifies=True)


SCENES = (*bodies(), *sizes(), *times(), *unstable(), *published())

if __name__ == '__main__':
    FILE.write_text(json.dumps({scene.name: scene.computed() for scene in SCENES if scene.torques},
                               indent=0))
