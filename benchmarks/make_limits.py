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
Compute the motions in test/truth_limits.json, whose wheels reach their largest speed: 50 digits.

    python benchmarks/make_limits.py [SCENE ...]

The equations are integrated by Taylor series that share no code with the package. A command that
would drive a wheel beyond its largest speed does not act while the wheel is faster, and acts only
as far as it holds the speed while the wheel is at its largest speed. At an event, the efforts of
the wheels at their largest speed are the only ones that satisfy these rules.

In `grazing`, the largest speed is the double nearest to that of the first maximum without a limit.
In `at_the_instant`, every number is a power of two, so the wheel reaches its limit exactly at two
seconds. To add a scene, write its inputs into the file.
"""

from itertools import product
import json
from pathlib import Path
import sys

from mpmath import mp
import numpy as np

PATH = Path(__file__).resolve().parents[1] / 'test' / 'truth_limits.json'
SECOND = 10 ** 9
#: Order of the series.
ORDER = 60
#: What counts as zero.
ROUNDING = mp.mpf(10) ** -40
FREE, OVER, HELD = 'free', 'over', 'held'

exact = np.vectorize(mp.mpf, otypes=[object])


class Motion:
    """A body with wheels, and its motion up to a time."""

    def __init__(self, values):
        xx, yy, zz, xy, xz, yz = values['inertia_ixx_iyy_izz_ixy_ixz_iyz']
        tensor = exact([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        wheels = values['wheels']
        axes = exact([wheel['axis'] for wheel in wheels])
        self.axes = np.array([axis / mp.sqrt(axis @ axis) for axis in axes])
        self.inertia, self.friction, self.most, self.clip = (
            exact([wheel.get(name, 0.0) for wheel in wheels])
            for name in ('inertia', 'friction', 'max_speed', 'max_torque'))
        self.carrier = tensor - np.einsum('j,ja,jb->ab', self.inertia, self.axes, self.axes)
        self.q = exact(values['initial_attitude_xyzw'])
        self.w = exact(values['initial_angular_velocity'])
        speeds = exact([wheel.get('initial_speed', 0.0) for wheel in wheels])
        self.momenta = self.inertia * (speeds + self.axes @ self.w)
        self.seconds, self.efforts, self.torque = mp.mpf(0), exact(np.zeros(len(wheels))), \
            exact(np.zeros(3))
        self.modes, self.events = [FREE] * len(wheels), []

    @property
    def speeds(self):
        """Return the speeds of the wheels relative to the body, rad/s."""
        return self.momenta / self.inertia - self.axes @ self.w

    def series(self):
        """Return the series of attitude, rates and momenta."""
        held = [mode == HELD for mode in self.modes]
        body = self.carrier + sum((self.inertia[j] * np.multiply.outer(self.axes[j], self.axes[j])
                                   for j in np.flatnonzero(held)), np.zeros((3, 3), int))
        inverse = np.array((mp.matrix(body.tolist()) ** -1).tolist())
        efforts = self.efforts * [mode == FREE for mode in self.modes]
        q, w, momenta, total = [self.q], [self.w], [self.momenta], []
        for k in range(ORDER):
            total.append(self.carrier @ w[k] + self.axes.T @ momenta[k])
            right = sum(np.cross(total[i], w[k - i]) for i in range(k + 1))
            rates = -self.friction * (momenta[k] / self.inertia - self.axes @ w[k])
            if k == 0:
                right, rates = right + self.torque, rates + efforts
            rates[held] *= 0
            change = inverse @ (right - self.axes.T @ rates)
            rates[held] = (self.inertia * (self.axes @ change))[held]
            q.append(sum(_times(q[i], w[k - i]) for i in range(k + 1)) / (2 * (k + 1)))
            w.append(change / (k + 1))
            momenta.append(rates / (k + 1))
        return q, w, momenta

    def conditions(self, j, series):
        """Return polynomials that are positive while wheel j stays in its mode."""
        sign, mode = mp.sign(self.efforts[j]), self.modes[j]
        if not (sign and self.most[j]):
            return []
        _, w, momenta = series
        speeds = [sign * (h[j] / self.inertia[j] - self.axes[j] @ u) for h, u in zip(momenta, w)]
        if mode != HELD:
            speeds[0] -= self.most[j]
            return [speeds if mode == OVER else [-c for c in speeds]]
        effort = [sign * self.inertia[j] * (k + 1) * (self.axes[j] @ w[k + 1])
                  for k in range(ORDER)]
        effort[0] += self.friction[j] * self.most[j]
        left = [-c for c in effort]
        left[0] += abs(self.efforts[j])
        return [effort, left]

    def choose(self, near, modes):
        """Take modes, except for wheels near their largest speed: those whose conditions hold."""
        before = self.modes
        for chosen in product((HELD, FREE, OVER), repeat=len(near)):
            self.modes = list(modes)
            for j, mode in zip(near, chosen):
                self.modes[j] = mode
            series = self.series()
            if all(mp.polyval(c[::-1], mp.mpf(10) ** -9) > -ROUNDING
                   for j in near for c in self.conditions(j, series)):
                self.events += [[mp.nstr(self.seconds * SECOND, 40), j, old, new]
                                for j, (old, new) in enumerate(zip(before, self.modes))
                                if old != new]
                return
        raise ValueError(f'no modes at {self.seconds} s')

    def command(self, efforts):
        """Take new commands."""
        limit = np.array([clip or mp.inf for clip in self.clip])
        self.efforts = np.clip(exact(efforts), -limit, limit)
        excess = [mp.sign(u) * speed - most if u and most else -mp.inf
                  for u, speed, most in zip(self.efforts, self.speeds, self.most)]
        self.choose([j for j, more in enumerate(excess) if abs(more) < ROUNDING],
                    [OVER if more > 0 else FREE for more in excess])

    def choose_again(self, which=()):
        """Choose the modes of some wheels, and of all that are held at their largest speed."""
        held = [j for j, mode in enumerate(self.modes) if mode == HELD]
        self.choose(sorted({*which, *held}), self.modes)

    def advance(self, end):
        """Continue the motion to a time, s."""
        while self.seconds < end:
            series = self.series()
            step = min(end - self.seconds, _radius(series))
            first, which = step, None
            for j in range(len(self.modes)):
                for condition in self.conditions(j, series):
                    root = _first_root(condition, step)
                    if root is not None and root < first:
                        first, which = root, j
            self.q, self.w, self.momenta = (
                sum(c * first ** k for k, c in enumerate(terms)) for terms in series)
            self.seconds = end if first == end - self.seconds else self.seconds + first
            if which is not None:
                self.choose_again([which])


def _times(q, w):
    x, y, z, s = q
    a, b, c = w
    return np.array([s * a + y * c - z * b, s * b + z * a - x * c, s * c + x * b - y * a,
                     -(x * a + y * b + z * c)])


def _radius(series):
    """Return a step whose truncation error is below the working precision."""
    sizes = [(max(map(abs, [*q, *w])), max(map(abs, h))) for q, w, h in zip(*series)]
    steps = [(mp.mpf(10) ** -mp.dps * (1 + sizes[0][part]) / sizes[k][part]) ** (mp.mpf(1) / k)
             for part in (0, 1) for k in (ORDER - 1, ORDER) if sizes[k][part]]
    return min([*steps, mp.mpf(1)])


def _first_root(condition, step):
    """Return where a polynomial first becomes negative in (0, step], or None."""
    points = [step * k / 64 for k in range(65)]
    condition = [condition[0] + ROUNDING, *condition[1:]]
    values = [mp.polyval(condition[::-1], t) for t in points]
    for (a, fa), (b, fb) in zip(zip(points[1:], values[1:]), zip(points[2:], values[2:])):
        if fa > 0 >= fb or (a == points[1] and fa <= 0):
            if fa <= 0:
                a, b = points[0], points[1]
            low, high = a, b
            for _ in range(4 * mp.dps):
                middle = (low + high) / 2
                low, high = (middle, high) if mp.polyval(condition[::-1], middle) > 0 \
                    else (low, middle)
            return high
    return None


def solved(values):
    """Return the motion of a scene: rows at eight times, and the events."""
    motion, rows = Motion(values), []
    stamps = [row[0] for row in values['efforts_t_ns_each'] + values['torque_t_ns_x_y_z']]
    efforts = {row[0]: row[1:] for row in values['efforts_t_ns_each']}
    torques = {row[0]: row[1:] for row in values['torque_t_ns_x_y_z']}
    outputs = [values['end_ns'] * k // 8 for k in range(1, 9)]
    for time_ns in sorted({*stamps, *outputs}):
        motion.advance(mp.mpf(time_ns) / SECOND)
        if time_ns in torques:
            motion.torque = exact(torques[time_ns])
        if time_ns in efforts:
            motion.command(efforts[time_ns])
        elif time_ns in torques:
            motion.choose_again()
        if time_ns in outputs:
            rows.append([time_ns, *([mp.nstr(x, 30) for x in part] for part in (
                motion.q, motion.w, motion.speeds))])
    return {'rows_t_ns_attitude_rates_speeds': rows, 'events_t_ns_wheel_before_after':
            motion.events}


def main(names):
    """Write the file, with new results for the named scenes, or for all."""
    found = json.loads(PATH.read_text())
    with mp.workdps(75):
        for name in names or found:
            found[name] |= solved(found[name])
            print(name, *found[name]['events_t_ns_wheel_before_after'], sep='\n  ', flush=True)
            PATH.write_text(json.dumps(found, indent=0) + '\n')


if __name__ == '__main__':
    main(sys.argv[1:])
