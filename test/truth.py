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
Motions of a rigid body with fifty digits, as references for results in double precision.

There are two methods, which share no code. `series` integrates the equations of motion by Taylor
series, and `free` evaluates the closed form of torque-free motion. Both treat doubles (or mpmath
numbers) as exact, and take times in integer nanoseconds. They return numpy arrays of mpmath
numbers: the attitude (x, y, z, w; body to space; continuous from the start, without changes of
sign) and the body rates.
"""

from typing import NamedTuple

from mpmath import mp
import numpy as np

#: Additional digits. A phase of 1e7 rad loses 7 digits, and a motion close to the separatrix 17.
GUARD = 25
#: Angle of a step of `series`, rad, that requires the least work for 50 digits.
STEP_ANGLE = 0.4
ZERO = np.zeros((3, 3))

exact = np.vectorize(mp.mpf, otypes=[object])


def series(tensor, attitude, rates, torques, digits=50, momentum=(0, 0, 0), damping=ZERO,
           motor=(0, 0, 0), fields=(), orbit=(0, (1, 0, 0), (0, 1, 0)), lag=0):
    """
    Return the motion under torques as [(attitude, rates)], one pair for the end of each torque.

    The result has `digits` digits, or fewer if the motion amplifies rounding errors.

    Parameters
    ----------
    tensor : array, shape (3, 3), kg m^2
        Inertia about the centre of mass, body axes.
    attitude : array, shape (4,), any norm
        Attitude at the start; x y z w, body to space.
    rates : array, shape (3,), rad/s, body axes
        Rates at the start.
    torques : [(duration_ns, torque, in_space)]
        Consecutive torques, N m, in body or space axes. A torque of shape (3,) is held; one of
        shape (degree + 1, 3) is a polynomial in the fraction of the duration. A negative duration
        continues the motion backwards.
    digits : int
        Digits of the result; the computation uses `GUARD` more.
    momentum : array, shape (3,), N m s, body axes
        Momentum of rotors at the start.
    damping : array, shape (3, 3), N m s/rad
        Damping tensor; the torque is `-damping @ rates`.
    motor : array, shape (3,), N m, body axes
        Constant torque on the rotors.
    fields : [(moment, field)]
        Uniform fields, in space axes, and the moments, in body axes, on which they act.
    orbit : (mean motion, position, along)
        The mean motion of a circular orbit, rad/s, and two unit vectors at the start, in space
        axes: that from the planet to the body, and the direction of motion.
    lag : float, s
        Time constant with which an actuator, at rest at the start, follows the torques; 0 if none
        does. The torques must be held, and in the same axes.

    """
    with mp.workdps(digits + GUARD):
        tensor, q, w = exact(tensor), _unit(exact(attitude)), exact(rates)
        others = _Others(*map(exact, (momentum, damping, motor)),
                         exact(np.reshape([m for m, _ in fields], (-1, 3))),
                         exact(np.reshape([f for _, f in fields], (-1, 3))), *map(exact, orbit),
                         exact(np.zeros(3)), 1 / mp.mpf(lag) if lag else mp.zero)
        inverse = _array(mp.inverse(mp.matrix(tensor.tolist())))
        size = mp.mnorm(mp.matrix(inverse.tolist()), 'f')
        states, before = [], 0
        for duration_ns, torque, in_space in torques:
            seconds, torque = _seconds(duration_ns), np.atleast_2d(exact(torque))
            if lag:
                others = others._replace(excess=others.excess + before - torque[0])
                before = torque[0]
            push = size * others.torque(tensor) + sum(
                size * _length(row) if in_space else _length(inverse @ row) for row in torque)
            fraction = mp.zero
            while fraction < 1:
                # The inverse of this rate bounds the radius of convergence from below.
                rate = _length(w) + mp.sqrt(push) + others.decay + others.mean_motion + size * (
                    _length(others.momentum) + abs(others.damping).sum())
                part = min(1 - fraction, STEP_ANGLE / rate / abs(seconds)) if rate else mp.one
                q, w = _step(q, w, part * seconds, tensor, inverse,
                             _shifted(torque, fraction, part), in_space, others)
                others = others.after(part * seconds)
                fraction += part
            states.append((q, w))
        return states


class _Others(NamedTuple):
    """What acts on a body besides torques; see `series`."""

    momentum: np.ndarray
    damping: np.ndarray
    motor: np.ndarray
    moments: np.ndarray
    fields: np.ndarray
    mean_motion: mp.mpf
    position: np.ndarray
    along: np.ndarray
    #: A torque, in the axes of the torques, that decays, and the rate at which it does.
    excess: np.ndarray
    decay: mp.mpf

    def torque(self, tensor):
        """Return a bound on the torques, N m."""
        return (_length(self.motor) + _length(self.excess)
                + sum(_length(m) * _length(f) for m, f in zip(self.moments, self.fields))
                + 3 * self.mean_motion ** 2 * abs(tensor).sum())

    def after(self, seconds):
        """Return what acts some seconds later."""
        sine, cosine = mp.sin(self.mean_motion * seconds), mp.cos(self.mean_motion * seconds)
        return self._replace(momentum=self.momentum + seconds * self.motor,
                             position=cosine * self.position + sine * self.along,
                             along=cosine * self.along - sine * self.position,
                             excess=self.excess * mp.exp(-self.decay * seconds))

    def vectors(self, q):
        """Return the fields, and the directions of the orbit if there is one, in body axes."""
        directions = [self.position, self.along] if self.mean_motion else []
        return [rotate(_conjugate(q), one) for one in [*self.fields, *directions]]


def polynomials(times_ns, torques, interpolation):
    """
    Return the torque between samples, and after the last, as exact polynomials for `series`.

    Parameters
    ----------
    times_ns : array of int, shape (n,)
        Ascending times of the samples.
    torques : array, shape (n, 3), N m
        The samples.
    interpolation : str
        'hold', 'linear' or 'cubic', as for `TorqueLog`.

    """
    with mp.workdps(60):
        times, values = [_seconds(time_ns) for time_ns in times_ns], exact(torques)
        found = []
        for i, (span, rise) in enumerate(zip(np.diff(times), np.diff(values, axis=0))):
            if interpolation == 'cubic':
                a, b = (span * _slope(times, values, k) for k in (i, i + 1))
                rows = [a, 3 * rise - 2 * a - b, a + b - 2 * rise]
            else:
                rows = [rise] if interpolation == 'linear' else []
            found.append(np.array([values[i], *rows]))
        return [*found, values[-1:]]


def _slope(times, values, i):
    # The slope, at a sample, of the polynomial through the five nearest samples (barycentric
    # weights).
    count = min(5, len(times))
    first = min(max(i - count // 2, 0), len(times) - count)
    near = [k for k in range(first, first + count) if k != i]
    total = np.array([mp.zero] * 3)
    for j in near:
        weight = 1 / (times[j] - times[i])
        for k in near:
            if k != j:
                weight *= (times[i] - times[k]) / (times[j] - times[k])
        total += weight * (values[j] - values[i])
    return total


def free(tensor, attitude, rates, time_ns, digits=50):
    """
    Return the torque-free motion at one time after the start as (attitude, rates).

    See Celledoni, Fassò, Säfström and Zanna, "The exact computation of the free rigid body motion
    and its use in splitting methods" (2008), with the corrections of Principia's `EulerSolver`.
    The parameters are those of `series`.
    """
    with mp.workdps(digits + GUARD):
        tensor, q, w = exact(tensor), _unit(exact(attitude)), exact(rates)
        t, m = _seconds(time_ns), tensor @ w
        if _length(np.cross(m, w)) <= 1000 * mp.eps * _length(m) * _length(w):
            return times(q, turn(w, t)), w  # about a principal axis, or any axis of a sphere
        moments, axes = _frame(tensor, m)
        turned, m = _tumble(moments, axes.T @ m, t)
        # A rotation about v in principal axes is a rotation about `axes @ v` in body axes.
        return times(q, np.append(axes @ turned[:3], turned[3])), axes @ (m / moments)


def chord(truth, attitude):
    """Return the angle, rad, between a true and a computed attitude; q and -q differ."""
    with mp.workdps(50):
        # Rounding may make the chord longer than 2.
        return float(4 * mp.asin(min(mp.one, _length(truth - _unit(exact(attitude))) / 2)))


def rotate(q, v):
    """Return the vector v rotated by the unit quaternion q."""
    return times(times(q, _pure(v)), _conjugate(q))[:3]


def _step(q, w, h, tensor, inverse, torque, in_space, others):
    # With h as the unit of time and the size of the tensor as the unit of inertia, all numbers are
    # of order one. So fixed-point integers suffice, ten times as fast as mpmath's floats.
    size = abs(tensor).max()
    bits = mp.prec + 16 + 2 * mp.mag(abs(inverse).max() * size)  # the inverse magnifies rounding
    fixed = np.vectorize(lambda x: int(mp.nint(mp.ldexp(x, bits))), otypes=[object])
    torque = np.array([*torque, others.excess])
    if in_space:
        torque = np.array([rotate(_conjugate(q), row) for row in torque])
    unit = h / size
    vectors = np.array([*(torque * h * unit), *others.vectors(q)])
    sums = _sums(*map(fixed, (q, w * h, tensor @ w * unit, vectors, tensor / size, inverse * size,
                              others.momentum * unit, others.damping * unit,
                              others.motor * h * unit, others.moments * h * unit,
                              others.mean_motion * h, others.decay * h)),
                 len(torque) - 1, in_space, bits)
    q, w = (exact(s) * mp.ldexp(1, -bits) for s in sums)
    return _unit(q), w / h


def _sums(q, w, m, vectors, tensor, inverse, momentum, damping, motor, moments, mean_motion,
          decay, count, in_space, bits):
    # The sums of the series of q and w after one unit of time.
    orders, negligible = 4 * mp.dps, 1 << bits - mp.prec
    qs, ws, ms = (np.full((orders + 1, n), 0, dtype=object) for n in (4, 3, 3))
    qs[0], ws[0], ms[0] = q, w, m
    # The coefficients of the torque and its excess, in body axes or fixed in space, and then other
    # vectors that are fixed in space.
    vs = np.full((len(vectors), orders + 1, 3), 0, dtype=object)
    vs[:, 0] = vectors
    uniform = slice(count + 1, count + 1 + len(moments))
    turning = slice(0 if in_space else count + 1, None)
    for k in range(orders):
        past = ws[k::-1]
        push = sum(vs[i, k - i] for i in range(min(k + 1, count))) + vs[count, k]
        if k == 0:
            push = push - motor
        push = push + (_cross(momentum, ws[k]) + _cross(motor, ws[k - 1]) - damping @ ws[k]
                       + _cross(moments, vs[uniform, k]).sum(axis=0) >> bits)
        if mean_motion:
            push += _cross(vs[-2, :k + 1], (vs[-2, k::-1] @ tensor) * 3 * mean_motion ** 2
                           >> 3 * bits).sum(axis=0) >> bits
        ms[k + 1] = ((_cross(ms[:k + 1], past).sum(axis=0) >> bits) + push) // (k + 1)
        ws[k + 1] = inverse @ ms[k + 1] >> bits
        qs[k + 1] = (times(qs[:k + 1], _pure(past)).sum(axis=0) >> bits) // (2 * (k + 1))
        change = _cross(vs[turning, :k + 1], past).sum(axis=1)
        if mean_motion:
            change[-2:] += mean_motion * vs[[-1, -2], k] * [[1], [-1]]
        vs[turning, k + 1] = (change >> bits) // (k + 1)
        vs[count, k + 1] -= (decay * vs[count, k] >> bits) // (k + 1)
        # If the body starts at rest, only every (degree + 2)nd term is nonzero.
        last = slice(max(0, k + 1 - count), k + 2)
        if k >= count and max(abs(qs[last]).max(), abs(ws[last]).max()) < negligible:
            return qs.sum(axis=0), ws.sum(axis=0)
    raise ArithmeticError('the series does not converge: is the inertia that of a body?')


def _shifted(torque, fraction, part):
    # The coefficients in the fraction of a part: a Taylor shift.
    result = torque.copy()
    for i in range(len(result)):
        for k in range(len(result) - 2, i - 1, -1):
            result[k] += fraction * result[k + 1]
    return result * np.array([[part ** k] for k in range(len(result))], dtype=object)


def _frame(tensor, m):
    # The principal moments and right-handed axes, chosen so that m circles the third axis and has
    # positive components along the first and the third axis.
    moments, axes = map(_array, mp.eigsy(mp.matrix(tensor.tolist())))
    (low, middle, high), p = moments, axes.T @ m
    if p[2] ** 2 * (high - middle) / high < p[0] ** 2 * (middle - low) / low:
        moments, axes, p = moments[::-1], axes[:, ::-1], p[::-1]
    first, third = (axes[:, i] * (-1 if p[i] < 0 else 1) for i in (0, 2))
    return moments, np.array([first, np.cross(third, first), third]).T


def _tumble(moments, m, t):
    # The rotation since the start, and the momentum, both in principal axes. The moments are in
    # ascending or descending order; differences and deltas change sign together.
    i1, i2, i3 = moments
    i21, i31, i32 = i2 - i1, i3 - i1, i3 - i2
    delta1 = m[1] ** 2 * i21 / i2 + m[2] ** 2 * i31 / i3
    delta3 = -(m[0] ** 2 * i31 / i1 + m[1] ** 2 * i32 / i2)
    extent = np.array([mp.sqrt(-i1 * delta3 / i31), -mp.sqrt(-i2 * delta3 / i32),
                       mp.sqrt(i3 * delta1 / i31)])
    rate = -mp.sign(i32) * mp.sqrt(delta1 * i32 / (i1 * i2 * i3))
    k2 = -delta3 * i21 / (delta1 * i32)
    k2 = k2 if 1 - k2 > 1000 * mp.eps else mp.one  # on the separatrix
    n, skew = -i3 * i21 / (i1 * i32), mp.sqrt(i2 * i31 / (i1 * i32))
    start = mp.ellipf(mp.atan2(m[1] / extent[1], m[0] / extent[0]), k2)
    (pi0, turn0, _), (pi1, turn1, functions) = (
        _jacobi(u, k2, n, skew) for u in (start, start + rate * t))
    now, g = extent * functions, _length(m)
    psi = g / i3 * (t + i31 / (rate * i1) * (pi1 - pi0)) + turn1 - turn0
    spin = np.array([0, 0, mp.sin(psi / 2), mp.cos(psi / 2)])
    return times(times(_conjugate(_to_third(m)), spin), _to_third(now)), now


def _jacobi(u, k2, n, skew):
    # The integral of the third kind, atan(skew tan(am u)), and (cn, sn, dn). Whole half turns of
    # the amplitude are subtracted first, because both angles must be continuous.
    halves = 0 if k2 == 1 else int(mp.nint(u / (2 * mp.ellipk(k2))))
    sn, cn, dn = (mp.ellipfun(name, u - 2 * halves * mp.ellipk(k2) if halves else u, m=k2)
                  for name in ('sn', 'cn', 'dn'))
    integral = mp.ellippi(n, mp.atan2(sn, cn), k2)
    if halves:
        integral += 2 * halves * mp.ellippi(n, k2)
    sign = (-1) ** halves
    return (integral, mp.atan2(skew * sn, cn) + halves * mp.pi,
            np.array([sign * cn, sign * sn, dn]))


def _to_third(m):
    # The shortest rotation of m to the third axis.
    return _unit(np.array([m[1], -m[0], mp.zero, _length(m) + m[2]]))


def turn(w, seconds):
    """Return the rotation of a body that turns at a constant rate w for some seconds."""
    speed, half = _length(w), _length(w) * seconds / 2
    return np.append(w / speed * mp.sin(half) if speed else w, mp.cos(half))


def times(p, q):
    """Return the product of quaternions."""
    u, a, v, b = p[..., :3], p[..., 3:], q[..., :3], q[..., 3:]
    return np.concatenate([a * v + b * u + _cross(u, v),
                           a * b - (u * v).sum(axis=-1, keepdims=True)], axis=-1)


def _cross(u, v):
    # For objects, np.cross takes twice as long.
    return u[..., [1, 2, 0]] * v[..., [2, 0, 1]] - u[..., [2, 0, 1]] * v[..., [1, 2, 0]]


def _pure(v):
    return np.concatenate([v, np.zeros_like(v[..., :1])], axis=-1)


def _conjugate(q):
    return q * [-1, -1, -1, 1]


def _unit(q):
    return q / _length(q)


def _length(v):
    return mp.sqrt(v @ v)


def _array(matrix):
    return np.array(matrix.tolist()).squeeze()


def _seconds(time_ns):
    return mp.mpf(time_ns) / 10 ** 9
