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
Known motions under fields: closed forms, conserved quantities, and magnification of errors.

The closed forms are those of Whittaker, "A treatise on the analytical dynamics of particles and
rigid bodies", 1937: the pendulum in section 44, the top in sections 71 and 72. They share no code
with the series.
"""

from typing import NamedTuple

from mpmath import mp
import numpy as np
from rigid_body_ros import GravityGradient, Problem, RigidBody, State, UniformField
from rigid_body_ros.mechanics import so3
import terms
from terms import SECOND
import truth

#: Change of the start, rad, with which `magnification` measures the sensitivity. The motions stay
#: close even if it is magnified by 1e9, and rounding is at most a ten-thousandth of it.
_CHANGE = 1e-11


def magnification(run, start, times_ns, coordinates=range(6)):
    """
    Return by how much a motion magnifies a change of its start, at least 1, by time, shape (m,).

    Each coordinate of the start is changed by 1e-11 in both directions. The coordinates are a
    rotation about each body axis, rad, and each component of the angular velocity, relative to the
    largest rate of the motion. The differences of the changed motions, divided by the differences
    of their starts, form a 6 by 6 matrix for each time. The result is its largest singular value.

    Parameters
    ----------
    run : callable
        Returns the motion from a start at times, ns.
    start : State
        The start that is changed.
    times_ns : array of int, shape (m,)
        The times of the result.
    coordinates : sequence of int
        The coordinates to change: 0, 1, 2 are rotations about the axes, and 3, 4, 5 are rates.

    """
    speed = np.linalg.norm(run(start, times_ns).angular_velocity, axis=1).max()
    columns = []
    for change in _CHANGE * np.eye(6)[list(coordinates)]:
        one, other = (run(_moved(start, sign * change, speed), times_ns) for sign in (1.0, -1.0))
        turned = so3.log(so3.multiply(so3.conjugate(other.attitude), one.attitude))
        rates = (one.angular_velocity - other.angular_velocity) / speed
        columns.append(np.hstack([turned, rates]) / (2.0 * _CHANGE))
    return np.maximum(1.0, np.linalg.norm(np.stack(columns, axis=-1), 2, axis=(1, 2)))


def _moved(start, change, speed):
    return State(start.time_ns, so3.multiply(start.attitude, so3.exp(change[:3])),
                 start.angular_velocity + speed * change[3:], start.rotor_momentum)


def bound(problem, times_ns):
    """Return `terms.bound` of a motion at times, shape (m,)."""
    fine = np.union1d(times_ns, np.linspace(
        problem.start.time_ns, times_ns[-1], 20_001).astype(np.int64))
    return terms.bound(problem.propagate(at=fine))[np.searchsorted(fine, times_ns)]


def errors(motion, expected):
    """
    Return the errors of a motion against [(attitude, rates)] in mpmath numbers, by time.

    The results are angles, rad, and errors of the rates relative to the largest rate, each of
    shape (m,).
    """
    attitude = np.array([truth.chord(q, found) for (q, _), found in zip(
        expected, motion.attitude)])
    apart = np.array([w - found for (_, w), found in zip(expected, motion.angular_velocity)])
    speed = np.linalg.norm(motion.angular_velocity, axis=1).max()
    return attitude, np.linalg.norm(apart.astype(float), axis=1) / speed


def plane_pendulum(problem, times_ns):
    """
    Return the motion about the body's x axis under one uniform field as [(attitude, rates)].

    The x axis is principal and starts along space x; moment and field have no x component.
    """
    one, = problem.fields
    (_, my, mz), (_, fy, fz) = truth.exact(one.moment), truth.exact(one.field)
    x, _, _, w = truth.exact(problem.start.attitude)
    turned, rate = 2 * mp.atan2(x, w), mp.mpf(problem.start.angular_velocity[0])
    square = (mp.sqrt((my * my + mz * mz) * (fy * fy + fz * fz))
              / mp.mpf(problem.body.inertia[0, 0]))
    # The angle between moment and field, which is zero at the bottom.
    ahead = mp.atan2(mz, my) - mp.atan2(fz, fy)
    start = mp.atan2(mp.sin(turned + ahead), mp.cos(turned + ahead))
    found = []
    for angle, speed in _pendulum(start, rate, mp.sqrt(square), times_ns):
        half = (turned + angle - start) / 2
        found.append((np.array([mp.sin(half), mp.zero, mp.zero, mp.cos(half)]),
                      np.array([speed, mp.zero, mp.zero])))
    return found


def _pendulum(angle, rate, small, times_ns):
    # Yield angle and rate, given the rate of small swings. The pendulum swings, or goes round.
    half, k = mp.sin(angle / 2), mp.sqrt(mp.sin(angle / 2) ** 2 + (rate / small) ** 2 / 4)
    for time_ns in times_ns:
        t = mp.mpf(int(time_ns)) / SECOND
        if k < 1:
            amplitude = mp.atan2(half / k, rate / (2 * k * small))
            u = small * t + mp.ellipf(amplitude, k * k)
            yield (2 * mp.asin(k * mp.ellipfun('sn', u, m=k * k)),
                   2 * k * small * mp.ellipfun('cn', u, m=k * k))
            continue
        m, sign = 1 / (k * k), mp.sign(rate)
        u, period = sign * k * small * t + mp.ellipf(angle / 2, m), 2 * mp.ellipk(m)
        halves = int(mp.nint(u / period))
        rest = u - halves * period
        yield (2 * (halves * mp.pi + mp.asin(mp.ellipfun('sn', rest, m=m))),
               2 * sign * k * small * mp.ellipfun('dn', rest, m=m))


def lagrange_top(problem, times_ns):
    """
    Return the motion of a symmetric top under its weight as [(attitude, rates)].

    The field lies along the z axis of space, the moment along the axis of symmetry, the body's z
    axis, and neither is zero; the motion is neither vertical nor a steady precession.
    """
    one, = problem.fields
    weight = -mp.mpf(one.moment[2]) * mp.mpf(one.field[2])
    across, _, along = truth.exact(np.diag(problem.body.inertia))
    q, w = truth.exact(problem.start.attitude), truth.exact(problem.start.angular_velocity)
    q = q / mp.sqrt(q @ q)
    vertical = truth.rotate(np.append(-q[:3], q[3]), truth.exact([0, 0, 1]))  # body axes
    spin = along * w[2]
    momentum = across * (vertical[:2] @ w[:2]) + vertical[2] * spin
    energy = across * (w[:2] @ w[:2]) / 2 + weight * vertical[2]
    ratio = 2 / across
    nutation = _Nutation(
        (ratio * weight, -ratio * energy - (spin / across) ** 2,
         2 * momentum * spin / across ** 2 - ratio * weight,
         ratio * energy - (momentum / across) ** 2),
        vertical[2], vertical[0] * w[1] - vertical[1] * w[0])

    def precession(t):
        u = nutation.height(t)
        return (momentum - spin * u) / (across * (1 - u * u))

    phi, psi = _first_and_last(q)
    found, before = [], mp.zero
    for time_ns in times_ns:
        t = mp.mpf(int(time_ns)) / SECOND
        # The integrals of phi' and of phi' cos(theta), as one complex number.
        both = nutation.integral(
            lambda s: precession(s) * mp.mpc(1, nutation.height(s)), before, t)
        phi, psi = phi + both.real, psi + w[2] * (t - before) - both.imag
        found.append(_state_of_top(phi, psi, nutation, precession(t), w[2], t))
        before = t
    return found


class _Nutation:
    """The height u = cos(theta) of a top by time, s; the square of its rate is a cubic in u."""

    def __init__(self, cubic, height, slope):
        """Take the coefficients, highest power first, and the height and its rate at the start."""
        self._low, self._high, outside = sorted(_real_roots(*cubic), reverse=cubic[0] < 0)
        self._m = (self._high - self._low) / (outside - self._low)
        self._rate = mp.sqrt(cubic[0] * (outside - self._low)) / 2
        amplitude = mp.asin(mp.sqrt((height - self._low) / (self._high - self._low)))
        self._begin = mp.ellipf(amplitude, self._m)
        if slope * (self._high - self._low) < 0:
            self._begin = -self._begin

    def height(self, t):
        sn, = self._functions(t, 'sn')
        return self._low + (self._high - self._low) * sn * sn

    def slope(self, t):
        """Return the rate of the height at a time."""
        return 2 * (self._high - self._low) * self._rate * mp.fprod(
            self._functions(t, 'sn', 'cn', 'dn'))

    def integral(self, function, begin, end):
        """Return the integral over times of a function of the height."""
        period = 2 * mp.ellipk(self._m) / self._rate
        count = int((end - begin) / period)
        last = begin + count * period
        pieces = [self._quadrature(function, last, end, period)]
        if count:
            pieces.append(count * self._quadrature(function, begin, begin + period, period))
        return sum(pieces)

    def _functions(self, t, *names):
        return [mp.ellipfun(name, self._rate * t + self._begin, m=self._m) for name in names]

    @staticmethod
    def _quadrature(function, begin, end, period):
        pieces = mp.linspace(begin, end, 2 + int(4 * (end - begin) / period))
        return mp.quad(function, pieces, method='gauss-legendre')


def _real_roots(a, b, c, d):
    # Return the roots of a x^3 + b x^2 + c x + d, which are all real, by Viete's formula.
    shift = b / (3 * a)
    p, q = c / a - 3 * shift ** 2, 2 * shift ** 3 - shift * c / a + d / a
    size = mp.sqrt(-p / 3)
    angle = mp.acos(-q / (2 * size ** 3))
    return [2 * size * mp.cos((angle + 2 * k * mp.pi) / 3) - shift for k in range(3)]


def _state_of_top(phi, psi, nutation, precession, spin, t):
    # Return attitude and rates from the Euler angles 3-1-3 and their rates.
    theta = mp.acos(nutation.height(t))
    half, most, least = theta / 2, (phi + psi) / 2, (phi - psi) / 2
    attitude = np.array([mp.sin(half) * mp.cos(least), mp.sin(half) * mp.sin(least),
                         mp.cos(half) * mp.sin(most), mp.cos(half) * mp.cos(most)])
    sine = mp.sin(theta)
    nods = -nutation.slope(t) / sine
    return attitude, np.array([
        precession * sine * mp.sin(psi) + nods * mp.cos(psi),
        precession * sine * mp.cos(psi) - nods * mp.sin(psi), spin])


def _first_and_last(q):
    # Return the Euler angles phi and psi, 3-1-3, of a quaternion, from their half sum and half
    # difference.
    most, least = mp.atan2(q[2], q[3]), mp.atan2(q[1], q[0])
    return most + least, most - least


class Conserved(NamedTuple):
    """A quantity that a motion conserves."""

    #: The value at each time, shape (m,).
    values: np.ndarray
    #: The sum of the magnitudes of its terms.
    scale: float

    def drift(self):
        """Return the largest difference from the first value, relative to the scale."""
        return float(abs(self.values - self.values[0]).max() / self.scale)


def energy(problem, motion):
    """Return kinetic plus potential energy, J."""
    kinetic = motion.kinetic_energy
    return Conserved(kinetic + sum(one.potential_energy(
        problem.body, motion.times_ns, motion.attitude) for one in problem.fields), kinetic.max())


def momentum_along(problem, motion):
    """Return the momentum, N m s, about the direction of the fields, which they share."""
    direction, momentum = np.asarray(problem.fields[0].field), motion.angular_momentum_space
    return Conserved(momentum @ direction / np.linalg.norm(direction),
                     np.linalg.norm(momentum, axis=1).max())


@mp.workdps(30)
def jacobi_integral(problem, motion):
    """
    Return Jacobi's integral, J, the energy as seen from the orbit, computed with 30 digits.

    It is T - n (normal . L) + V, with the kinetic energy T, the momentum L in space axes, and the
    potential V of the gravity gradient, which is the only field. Double precision would round the
    angle of the orbit.
    """
    orbit, = problem.fields
    tensor, n = truth.exact(problem.body.inertia), mp.mpf(orbit.mean_motion)
    rotors = truth.exact(problem.start.rotor_momentum)
    position, along = truth.exact(orbit.position), truth.exact(orbit.along)
    found = []
    for time_ns, q, w in zip(motion.times_ns.tolist(), motion.attitude, motion.angular_velocity):
        q, w, angle = truth.exact(q), truth.exact(w), n * (time_ns - orbit.time_ns) / SECOND
        q = q * [-1, -1, -1, 1] / mp.sqrt(q @ q)  # from space to body
        r, normal = (truth.rotate(q, v) for v in (
            mp.cos(angle) * position + mp.sin(angle) * along, np.cross(position, along)))
        momentum = tensor @ w
        found.append(w @ momentum / 2 - n * (normal @ (momentum + rotors))
                     + 3 * n * n * (r @ (tensor @ r)) / 2)
    return Conserved(np.array(found), motion.kinetic_energy.max())


def kovalevskaya_integral(problem, motion):
    """
    Return Kovalevskaya's integral, 1/s^4.

    The moments of inertia about x and y are equal, and twice the moment about z. The moment of the
    only field lies in the xy plane.
    """
    one, = problem.fields
    x, y = motion.angular_velocity.T[:2]
    field = so3.rotate(so3.conjugate(motion.attitude), np.broadcast_to(
        one.field, (len(motion.attitude), 3)))
    moment = complex(one.moment[0], one.moment[1]) / problem.body.inertia[2, 2]
    values = abs((x + 1j * y) ** 2 + moment * (field[:, 0] + 1j * field[:, 1])) ** 2
    return Conserved(values, values[0])


def under_one_field(name, seed):
    """Return the problem of a top: asymmetric, Lagrange's, Kovalevskaya's, or with rotors."""
    random = np.random.default_rng(seed)
    attitude, rates = random.normal(size=4), random.normal(size=3)
    down = (0.0, 0.0, -9.81)
    if name == 'Lagrange':
        return Problem(RigidBody.from_moments(0.2, 0.2, 0.1),
                       State(0, attitude, 0.5 * rates + [0.0, 0.0, 10.0]),
                       fields=[UniformField((0.0, 0.0, 0.3), down)])
    if name == 'Kovalevskaya':
        return Problem(RigidBody.from_moments(2.0, 2.0, 1.0), State(0, attitude, 3.0 * rates),
                       fields=[UniformField((0.3, 0.4, 0.0), down)])
    given = [UniformField((0.1, -0.2, 0.3), (0.4, -0.2, -2.5))]
    rotors = (0.0, 0.0, 0.0)
    if name == 'gyrostat':  # with two fields of one direction
        given.append(UniformField((0.3, -0.1, 0.2), (0.8, -0.4, -5.0)))
        rotors = (0.2, 0.4, -0.3)
    return Problem(RigidBody.from_moments(1.1, 2.0, 2.7, 0.15, -0.2, 0.05),
                   State(0, attitude, rates, rotors), fields=given)


def in_orbit(name, seed):
    """Return the problem of a satellite, without or with a wheel."""
    random = np.random.default_rng(seed)
    rotors = (0.002, -0.001, 0.004) if name == 'satellite with a wheel' else (0.0, 0.0, 0.0)
    return Problem(RigidBody.from_moments(10.0, 12.0, 6.0, 0.2, -0.1, 0.3),
                   State(0, random.normal(size=4), 1e-3 * random.normal(size=3), rotors),
                   fields=[GravityGradient(1.1e-3, (1.0, 2.0, 3.0), (3.0, 0.0, -1.0))])


def turns(problem, count):
    """Return 2001 times, ns, over about this many turns of the body."""
    speed = np.linalg.norm(problem.start.angular_velocity)
    at = np.linspace(0, 100.0 / speed * SECOND, 500).astype(np.int64)
    speed = np.linalg.norm(problem.propagate(at=at).angular_velocity, axis=1).mean()
    return np.linspace(0, 2.0 * np.pi * count / speed * SECOND, 2001).astype(np.int64)
