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
Make test/truth_limits.json: motions with wheels that reach their largest speed, fifty digits.

    python benchmarks/make_limits.py [SCENE ...]

The equations are integrated by Taylor series that share no code with the package. A command that
would drive a wheel beyond its largest speed does not act while the wheel is faster, and acts only
as far as it holds the speed while the wheel is at its largest speed. At an event, the efforts of
the wheels at their largest speed are the only ones that satisfy these rules.
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


def scenes(grazed):
    """Return the scenes by name; `grazed` is the largest speed of the wheel that grazes it."""
    body = [0.045, 0.12, 0.14, 0.002, -0.001, 0.003]
    pyramid = [{'name': name, 'axis': axis, 'inertia': 0.002, 'initial_speed': speed,
                'max_torque': 0.02, 'max_speed': 60.0} for name, axis, speed in (
        ('a', [1, 1, 1], 10.0), ('b', [-1, 1, 1], -25.0), ('c', [-1, -1, 1], 40.0),
        ('d', [1, -1, 1], 0.0))]
    rng = np.random.default_rng(58)
    slew = [[k * 2 * SECOND + int(rng.integers(0, SECOND)), *rng.uniform(-0.02, 0.02, 4).tolist()]
            for k in range(10)]
    rubbing = [{'name': 'rw1', 'axis': [1, 0, 0], 'inertia': 0.002, 'initial_speed': 50.0,
                'friction': 1e-4, 'max_speed': 55.0},
               {'name': 'rw2', 'axis': [0, 1, 1], 'inertia': 0.002, 'initial_speed': -30.0,
                'friction': 2e-4, 'max_torque': 0.03, 'max_speed': 40.0},
               {'name': 'rw3', 'axis': [0, 0, 1], 'inertia': 0.003, 'friction': 1e-4,
                'max_torque': 0.04}]
    rubbed = [[0, 0.02, -0.025, 0.01], [4 * SECOND, 0.0, -0.025, 0.02],
              [7_123_456_789, -0.02, 0.03, -0.02], [15 * SECOND, 0.008, 0.012, 0.03]]
    one = {'name': 'rw', 'axis': [0, 0, 1], 'inertia': 0.002}
    return {
        'one_wheel': scene(body, [0.1, 0.3, -0.2], [one | {'max_speed': 40.0}], [
            [SECOND, 0.01], [15_500_000_001, -0.02], [18 * SECOND, 0.015]], 30 * SECOND),
        'four_skewed': scene(body, [0.2, -0.1, 0.15], pyramid, slew, 22 * SECOND),
        'friction': scene(body, [0.1, 0.3, -0.2], rubbing, rubbed, 20 * SECOND),
        # The body tumbles under a torque, so the wheel reaches its limit with a small effort.
        'by_the_body': scene(body, [0.5, 3.0, 0.4], [one | {
            'inertia': 0.02, 'axis': [1, 0.5, 0], 'initial_speed': 1.0, 'max_speed': 2.5}],
            [[0, 1e-3], [6 * SECOND, 2e-2], [11 * SECOND, 0.0], [12 * SECOND, 5e-3]],
            18 * SECOND, [[0, 0.05, -0.02, 0.03], [5 * SECOND, -0.1, 0.0, 0.02]]),
        # The largest speed is the double nearest to that of the first maximum without a limit.
        'grazing': scene(body, [0.5, 3.0, 0.4], [one | {
            'inertia': 0.02, 'axis': [1, 0.5, 0], 'initial_speed': 1.0,
            'max_speed': grazed}], [[0, 1e-4]], 8 * SECOND),
        # Everything is a power of two, so the wheel reaches its limit exactly at two seconds.
        'at_the_instant': scene([2.0, 2.0, 2.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [one | {
            'inertia': 1.0, 'max_speed': 4.0}], [[0, 1.0], [2 * SECOND, 0.5], [3 * SECOND, -0.25],
                                                 [4 * SECOND, 0.25]], 8 * SECOND,),
    }


def scene(inertia, rates, wheels, efforts, end_ns, torques=()):
    """Return a scene: a body, its wheels and their commands, and a torque on the body."""
    return {'inertia_ixx_iyy_izz_ixy_ixz_iyz': inertia, 'initial_attitude_xyzw': [0, 0, 0, 1],
            'initial_angular_velocity': rates, 'wheels': wheels, 'efforts_t_ns_each': efforts,
            'torque_t_ns_x_y_z': [*torques], 'end_ns': end_ns}


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

    def series(self, modes):
        """Return the series of attitude, rates, momenta, and the efforts that act."""
        held = [mode == HELD for mode in modes]
        body = self.carrier + sum((self.inertia[j] * np.multiply.outer(self.axes[j], self.axes[j])
                                   for j in np.flatnonzero(held)), np.zeros((3, 3), int))
        inverse = np.array((mp.matrix(body.tolist()) ** -1).tolist())
        efforts = np.array([effort * (mode == FREE) for effort, mode in zip(self.efforts, modes)])
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

    def conditions(self, j, mode, series):
        """Return polynomials that are positive while wheel j stays in its mode."""
        sign = mp.sign(self.efforts[j])
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

    def choose(self, near):
        """Choose the modes of the wheels at their largest speed, so that all conditions hold."""
        for chosen in product((HELD, FREE, OVER), repeat=len(near)):
            modes = list(self.modes)
            for j, mode in zip(near, chosen):
                modes[j] = mode
            series = self.series(modes)
            if all(mp.polyval(c[::-1], mp.mpf(10) ** -9) > -ROUNDING
                   for j in near for c in self.conditions(j, modes[j], series)):
                self.modes = modes
                return
        raise ValueError(f'no modes at {self.seconds} s')

    def command(self, efforts):
        """Take new commands."""
        before = self.modes
        limit = np.array([clip or mp.inf for clip in self.clip])
        self.efforts = np.array([max(-most, min(most, effort))
                                 for most, effort in zip(limit, exact(efforts))])
        excess = [mp.sign(u) * speed - most
                  for u, speed, most in zip(self.efforts, self.speeds, self.most)]
        limited = [bool(u and most) for u, most in zip(self.efforts, self.most)]
        self.modes = [OVER if acts and more > 0 else FREE for acts, more in zip(limited, excess)]
        self.choose([j for j, more in enumerate(excess)
                     if limited[j] and abs(more) < ROUNDING])
        self.note(before)

    def note(self, before):
        """Note the wheels whose modes have changed."""
        for j, (old, new) in enumerate(zip(before, self.modes)):
            if old != new:
                self.events.append([mp.nstr(self.seconds * SECOND, 40), j, old, new])

    def advance(self, end):
        """Continue the motion to a time, s."""
        while self.seconds < end:
            series = self.series(self.modes)
            step = min(end - self.seconds, _radius(series))
            first, which = step, None
            for j, mode in enumerate(self.modes):
                for condition in self.conditions(j, mode, series):
                    root = _first_root(condition, step)
                    if root is not None and root < first:
                        first, which = root, j
            self.q, self.w, self.momenta = (
                sum(c * first ** k for k, c in enumerate(terms)) for terms in series)
            self.seconds = end if first == end - self.seconds else self.seconds + first
            if which is not None:
                before = self.modes
                self.choose(sorted({which, *(j for j, mode in enumerate(before)
                                             if mode == HELD)}))
                self.note(before)


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
            before = motion.modes
            motion.choose([j for j, mode in enumerate(before) if mode == HELD])
            motion.note(before)
        if time_ns in outputs:
            rows.append([time_ns, *([mp.nstr(x, 30) for x in part] for part in (
                motion.q, motion.w, motion.speeds))])
    return {'rows_t_ns_attitude_rates_speeds': rows, 'events_t_ns_wheel_before_after':
            motion.events}


def grazed_speed():
    """Return the first largest speed of the wheel that grazes it, rounded to a double, rad/s."""
    motion = Motion(scenes(0.0)['grazing'])
    motion.efforts = exact(scenes(0.0)['grazing']['efforts_t_ns_each'][0][1:])
    while True:
        q, w, momenta = series = motion.series(motion.modes)
        step = _radius(series)
        slope = [(k + 1) * (momenta[k + 1][0] / motion.inertia[0] - motion.axes[0] @ w[k + 1])
                 for k in range(ORDER)]
        first = _first_root(slope, step) if slope[0] > 0 else None
        motion.q, motion.w, motion.momenta = (
            sum(c * (first or step) ** k for k, c in enumerate(terms))
            for terms in (q, w, momenta))
        if first is not None:
            return float(motion.speeds[0])


def main(names):
    """Write the file, with new results for the named scenes, or for all."""
    found = json.loads(PATH.read_text()) if PATH.exists() else {}
    with mp.workdps(75):
        for name, values in scenes(grazed_speed()).items():
            if not names or name in names:
                found[name] = values | solved(values)
                print(name, *found[name]['events_t_ns_wheel_before_after'], sep='\n  ', flush=True)
                PATH.write_text(json.dumps(found, indent=0) + '\n')


if __name__ == '__main__':
    main(sys.argv[1:])
