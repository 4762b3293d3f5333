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
Measure what rotors, damping, several sources and fields cost, relative to a run without them.

    python benchmarks/terms.py [WORD]
    python benchmarks/terms.py --peer

With WORD, only rows whose names contain it are measured. The two runs of a row alternate. The
ratio is that of the median times, with a 95 % confidence interval from the ratios of single
rounds. The upper end of the interval must not exceed the limit. Strong damping has no limit,
because the steps must follow it. A top is compared with the same body under a constant torque,
which takes as many steps. If heyoka is installed, the top is also compared with heyoka, which must
be slower.

With --peer, print how many steps heyoka takes with rotors, relative to the steps without. Rotors
make a free body nutate faster, so every integrator that follows the motion needs more steps.
"""

from dataclasses import replace
import sys

from mpmath import mp
import numpy as np
from pairs import compare
from problems import IDENTITY, PROBLEMS, truth, wave
from rigid_body_ros import (
    GravityGradient,
    Problem,
    propagate,
    RigidBody,
    State,
    TorqueLog,
    UniformField,
)
from rigid_body_ros.mechanics import so3

SECOND = 10 ** 9
MOMENTS, RATES = (1.0, 2.0, 3.0), (0.3, -0.2, 0.5)
HELD = TorqueLog([0], [[0.02, -0.01, 0.03]])
#: Stamps over a minute at 1 kHz.
STAMPS = np.arange(60_000) * (SECOND // 1000)
STREAM = TorqueLog(STAMPS, wave())
DAMPING = np.diag([0.01, 0.02, 0.03])
#: Limits of the ratios.
LINEAR, SOURCES, TOP = 1.25, 2.0, 1.6
#: A top over a minute, in its principal axes. The step, s, is shorter than the bodies need under
#: any of the torques, so all runs take the same number of steps.
TOP_MOMENTS, TOP_ATTITUDE, TOP_RATES = (0.2, 0.2, 0.1), (0.3, 0.0, 0.0, 0.9), (0.5, 0.0, 20.0)
WEIGHT = UniformField((0.0, 0.0, 0.3), (0.0, 0.0, -9.81))
TOP_STEP, TOP_SECONDS = 0.02, 60


class Run:
    """A motion over a minute, for `compare`."""

    def __init__(self, log=None, wheels=None, rotors=(0.0, 0.0, 0.0), damping=None, at=60):
        """Take torques, the momentum of rotors, a damping tensor, and the end, s, or times."""
        self._body = RigidBody(np.diag(MOMENTS), damping)
        self._start = State(0, angular_velocity=RATES, rotor_momentum=rotors)
        self._log = log
        self._options = {'wheels': wheels, 'solver': 'taylor',
                         'at': [at * SECOND] if isinstance(at, int) else at}

    def reset(self):
        """Do nothing: a motion is a function of its scene."""

    def run(self):
        """Propagate."""
        propagate(self._body, self._start, self._log, **self._options)


class Top:
    """The motion of a top, or of the same body under a constant torque, for `compare`."""

    def __init__(self, torque=None, fields=(), axes=IDENTITY, max_step=TOP_STEP):
        """Take a torque, N m, and fields in principal axes, and the attitude of these axes."""
        turn = so3.matrix(axes)
        start = State(0, so3.multiply(TOP_ATTITUDE, so3.conjugate(axes)), turn @ TOP_RATES)
        log = None if torque is None else TorqueLog([0], [turn @ torque])
        self.problem = Problem(
            RigidBody(turn * TOP_MOMENTS @ turn.T), start, log, solver='taylor',
            max_step=max_step, fields=[replace(one, moment=turn @ one.moment)
                                       if isinstance(one, UniformField) else one
                                       for one in fields])

    def reset(self):
        """Do nothing: a motion is a function of its scene."""

    def run(self):
        """Propagate."""
        self._motion = self.problem.propagate(at=[TOP_SECONDS * SECOND])

    def attitude(self):
        """Return x y z w at the end."""
        return self._motion.attitude[-1]


def linear_rows():
    """Yield the name, the limit and both runs of rows for rotors and damping."""
    for name, log, at in (('coast', None, 60), ('held torque', HELD, 60),
                          ('1 kHz', STREAM, PROBLEMS['P4'].at)):
        plain = Run(log, at=at)
        for share in (0.1, 1.0):
            rotors = share * np.multiply(MOMENTS, RATES)
            yield (f'{name}, rotors {share:g} J w', LINEAR, plain, Run(log, None, rotors, at=at))
        yield f'{name}, damping', LINEAR, plain, Run(log, damping=DAMPING, at=at)


def source_rows():
    """Yield rows for a minute at 1 kHz with wheels and two sources."""
    at = PROBLEMS['P4'].at
    wheels = TorqueLog(STAMPS, 0.1 * wave()[::-1])
    for name, other in (
            ('two sources in body axes', TorqueLog(STAMPS, 0.2 * wave()[::-1])),
            ('sources in body and space axes', TorqueLog(STAMPS, 0.2 * wave()[::-1], 'space')),
            ('second source at 100 Hz', TorqueLog(STAMPS[::10], 0.2 * wave()[::10], 'space')),
            ('second source between the stamps', TorqueLog(STAMPS + 300_000, 0.2 * wave()))):
        yield (f'1 kHz, wheels, {name}', SOURCES, Run(STREAM, at=at),
               Run([STREAM, other], wheels, at=at))


def strong_rows():
    """Yield rows for strong damping under a torque, without a limit."""
    for rate in (5.0, 50.0, 500.0, 5000.0):
        yield (f'held torque, damping of {rate:g} 1/s', np.inf, Run(HELD),
               Run(HELD, damping=rate * np.diag(MOMENTS)))


def top_rows():
    """Yield rows for a top, relative to a constant torque; other fields have no limit."""
    for name, axes in (('diagonal', IDENTITY), ('full', so3.normalize([0.1, 0.2, -0.3, 0.9]))):
        plain = Top(torque=(0.2, -0.1, 0.0), axes=axes)
        yield f'top, {name} tensor', TOP, plain, Top(fields=[WEIGHT], axes=axes)
        for count in (2, 3):
            yield (f'top, {name} tensor, {count} fields', np.inf, plain,
                   Top(fields=[WEIGHT] * count, axes=axes))
        yield (f'gravity gradient, {name} tensor', np.inf, plain,
               Top(fields=[GravityGradient(3.0)], axes=axes))


def print_duel():
    """Print the times of a top with this package and with heyoka, and both errors, rad."""
    try:
        import fields  # test/fields.py; problems.py sets the path
        import heyoka_peer
    except ImportError as problem:
        print(f'skipped: {problem}')
        return
    ours = Top(fields=[WEIGHT], max_step=None)
    with mp.workdps(30):
        (expected, _), = fields.lagrange_top(ours.problem, [TOP_SECONDS * SECOND])
        for carried in (False, True):
            peer = heyoka_peer.Top(TOP_MOMENTS, ours.problem.start, WEIGHT.moment, WEIGHT.field,
                                   TOP_SECONDS, carried)
            times = compare(ours, peer)
            errors = [truth.chord(expected, one.attitude()) for one in (ours, peer)]
            print(f'{"top, heyoka, " + peer.label:50} {1e6 * np.median(times.ours):9.1f} us '
                  f'{1e6 * np.median(times.peers):9.1f} us  '
                  'ratio {:.3g} [{:.3g}, {:.3g}]'.format(*times.ratio)
                  + f' at least 1  {"pass" if times.ratio[1] >= 1.0 else "MISS"}'
                  + '  errors {:.1e}, {:.1e} rad'.format(*errors), flush=True)


def steps_of_peer(torque, rotors):
    """Return the number of steps of heyoka over a minute under a held torque, with rotors."""
    import heyoka as hy

    a, b, c, x, y, z, w = hy.make_vars('a', 'b', 'c', 'x', 'y', 'z', 'w')
    k, m, n = (i * rate + h for i, rate, h in zip(MOMENTS, (a, b, c), rotors))
    torques = m * c - n * b, n * a - k * c, k * b - m * a
    rates = [(one + other) / i for one, other, i in zip(torques, torque, MOMENTS)]
    turn = [w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a,
            -(x * a + y * b + z * c)]
    equations = [*zip((a, b, c), rates), *zip((x, y, z, w), (0.5 * each for each in turn))]
    integrator = hy.taylor_adaptive(equations, [*RATES, 0.0, 0.0, 0.0, 1.0], tol=1e-15)
    return integrator.propagate_until(60.0)[3]


def print_peer():
    """Print the number of steps of heyoka with rotors, relative to those without."""
    for name, torque in (('coast', np.zeros(3)), ('held torque', HELD.torques[0])):
        plain, *others = (steps_of_peer(torque, share * np.multiply(MOMENTS, RATES))
                          for share in (0.0, 0.1, 1.0))
        ratios = [f'rotors {share:g} J w {steps / plain:.2f}'
                  for share, steps in zip((0.1, 1.0), others)]
        print(f'{name}: {plain} steps; {", ".join(ratios)}')


def main():
    """Print a row for each comparison."""
    if sys.argv[1:] == ['--peer']:
        print_peer()
        return
    word = ' '.join(sys.argv[1:])
    for name, limit, plain, other in (*linear_rows(), *source_rows(), *strong_rows(),
                                      *top_rows()):
        if word in name:
            times = compare(plain, other)
            ratio = times.ratio
            verdict = '' if limit == np.inf else \
                f' limit {limit:g}  {"pass" if ratio[2] <= limit else "MISS"}'
            print(f'{name:50} {1e6 * np.median(times.ours):9.1f} us '
                  f'{1e6 * np.median(times.peers):9.1f} us  '
                  'ratio {:.3g} [{:.3g}, {:.3g}]'.format(*ratio) + verdict, flush=True)
    if word in 'top, heyoka':
        print_duel()


if __name__ == '__main__':
    main()
