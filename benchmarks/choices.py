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
Measure the cost of calls, bodies and derivatives, and compare functions with those of SciPy.

    python benchmarks/choices.py [SECTION ...]

The sections are `calls` (from Python to a kernel), `bodies` (the constants of one body and of
many), `derivatives` (how many motions they take), `elliptic` and `so3` (this package and SciPy).
Times are processor times, the shortest of several. Errors are the largest differences from mpmath:
relative ones for `elliptic`, and those of components for `so3`. Outside of kernels, the functions
of `elliptic` run as plain Python, so they are not timed.
"""

import argparse
from functools import partial
import time
import timeit

from mpmath import mp
import numpy as np
from scipy import special
from scipy.spatial.transform import Rotation

#: Number of arguments for each function.
COUNT = 1000
RANDOM = np.random.default_rng(3)


def seconds(function):
    """Return the shortest processor time of a call, s."""
    function()
    timer = timeit.Timer(function, timer=time.process_time)
    number, _ = timer.autorange()
    return min(timer.repeat(7, number)) / number


def calls():
    """Print the time of a call from Python to a kernel that does almost nothing."""
    from rigid_body_ros import RigidBody
    from rigid_body_ros.engine import kernels, layout, state_layout
    stamps, flags, state = np.zeros(1, np.int64), np.zeros(1, bool), np.zeros(state_layout.SIZE)
    rows = layout.Rows(stamps, np.zeros((1, 1, 3)), flags, np.zeros(0))
    loop = (layout.begun(state, 0, state, 0, 0, 0), stamps, np.zeros(0, np.intp), np.zeros(7),
            np.zeros(2, bool), rows, RigidBody.from_moments(1.0, 2.0, 2.5)._constants,
            np.zeros(1, layout.METHOD))
    for name, kernel, arguments in (('one number', kernels.step_angle, (1e-15,)),
                                    ('the loop', kernels.run, loop)):
        print(f'calls: {name:10} {1e6 * seconds(partial(kernel, *arguments)):.2f} us')


def bodies():
    """Print the time per body for computing its constants, among 10 000 bodies and alone."""
    from rigid_body_ros import RigidBodies, RigidBody
    squares = RANDOM.uniform(0.02, 1.0, (10_000, 3))
    moments = squares.sum(axis=1, keepdims=True) - squares
    axes = np.linalg.qr(RANDOM.normal(size=(len(moments), 3, 3)))[0]
    full = (axes * moments[:, None]) @ axes.transpose(0, 2, 1)
    drag = np.diag([0.1, 0.2, 0.3])
    for name, tensors, damping in (('diagonal', moments[:, None] * np.eye(3), None),
                                   ('full', full, None), ('full, damped', full, drag)):
        many = seconds(partial(RigidBodies, tensors, damping)) / len(tensors)
        one = sum(seconds(partial(RigidBody, tensor, damping)) for tensor in tensors[:20]) / 20
        print(f'bodies: {name:12} {1e6 * many:.1f} us of many, {1e6 * one:.0f} us alone')


def derivatives():
    """Print the time of a motion, and of its derivatives by 1, 9 and 24 numbers."""
    from rigid_body_ros import Problem, RigidBody, State, TorqueLog
    start, full = State(angular_velocity=(0.5, -0.7, 0.9)), RigidBody.from_moments(
        1.1, 2.0, 2.7, 0.15, 0.05, -0.2)
    log = TorqueLog(np.arange(60_000) * 10 ** 6, RANDOM.normal(size=(60_000, 3)) * 0.01)
    for name, torques, at in (
            ('a torque for 1000 s', TorqueLog([0], [[0.01, 0.02, 0.0]]), [1000 * 10 ** 9]),
            ('a minute at 1 kHz', log, [60 * 10 ** 9])):
        problem = Problem(full, start, torques)
        one = seconds(partial(problem.propagate, at=at))
        print(f'derivatives: {name}: {1e3 * one:.2f} ms', end='')
        for names in (['torque_gain'], ['inertia', 'torque_bias'], [
                'inertia', 'start', 'torque_gains', 'torque_bias', 'damping']):
            found = problem.derivatives(names, at=at)
            more = seconds(partial(problem.derivatives, names, at=at))
            print(f'; by {len(found.names)}: {more / one:.1f} times', end='')
        print()


def elliptic():
    """Print the errors of elliptic functions and integrals, here and in SciPy."""
    from rigid_body_ros.kernels.elliptic import carlson_f, carlson_j, jacobi
    for complement in (1e-3, 1e-9, 1e-15):
        u = np.linspace(0.05, 0.95, 7) * float(special.ellipkm1(complement))
        exact = [mapped(lambda x, m, name=name: mp.ellipfun(name, x, m=m), u,
                        1 - mp.mpf(complement)) for name in ('sn', 'cn', 'dn')]
        ours = np.vectorize(jacobi)(u, complement)
        theirs = special.ellipj(u, 1.0 - complement)[:3]
        print(f'elliptic: sn, cn, dn at m_c = {complement:.0e}: error {largest(ours, exact):.1e}, '
              f'SciPy {largest(theirs, exact):.1e}')
    x, y = np.sort(10.0 ** RANDOM.uniform(-30, 0, (2, COUNT)), axis=0)
    p = 1.0 + 10.0 ** RANDOM.uniform(-20, 0, COUNT)
    for name, function, scipys, exact, given in (
            ('R_F', carlson_f, special.elliprf, mp.elliprf, (x, y, 1.0)),
            ('R_J', carlson_j, special.elliprj, mp.elliprj, (x, y, 1.0, p))):
        right = mapped(exact, *given)
        print(f'elliptic: {name}: ' + ', SciPy '.join(
            f'error {largest(each(*given), right):.1e}'
            for each in (np.vectorize(function), scipys)))


def rotations():
    """Print the errors of so3 and SciPy, and their times for 1000 rotations."""
    from rigid_body_ros.mechanics import so3
    vectors = RANDOM.normal(size=(COUNT, 3))
    vectors *= RANDOM.uniform(0.0, np.pi, (COUNT, 1)) / np.linalg.norm(vectors, axis=1)[:, None]
    right = np.array([exact_exp(vector) for vector in vectors])
    q, p = so3.exp(vectors), so3.exp(vectors[::-1])
    there, before = Rotation.from_quat(q), Rotation.from_quat(p)
    for name, ours, theirs, exact in (
            ('exp', lambda: so3.exp(vectors), lambda: Rotation.from_rotvec(vectors).as_quat(),
             right),
            ('log', lambda: so3.log(q), lambda: there.as_rotvec(),
             np.array([exact_log(one) for one in q])),
            ('rotate', lambda: so3.rotate(q, vectors), lambda: there.apply(vectors), None),
            ('multiply', lambda: so3.multiply(p, q), lambda: before * there, None)):
        print(f'so3: {name:8} ' + ', SciPy '.join(
            ('' if exact is None else f'error {np.abs(each() - exact).max():.1e}, ')
            + f'{1e3 * seconds(each):.3f} ms' for each in (ours, theirs)))
    change = np.abs(there.as_quat() - q).max()
    print(f'so3: SciPy changes components of a quaternion by up to {change:.1e}')


def exact_exp(vector):
    """Return the quaternion of a rotation vector, in mpmath numbers."""
    angle = mp.sqrt(sum(mp.mpf(x) ** 2 for x in vector))
    return [*(mp.mpf(x) * mp.sin(angle / 2) / angle for x in vector), mp.cos(angle / 2)]


def exact_log(q):
    """Return the rotation vector of a quaternion, in mpmath numbers."""
    x, y, z, w = map(mp.mpf, q)
    sine = mp.sqrt(x * x + y * y + z * z)
    return [2 * mp.atan2(sine, w) / sine * component for component in (x, y, z)]


def mapped(function, *columns):
    """Call a function of doubles for each row, and return its results as mpmath numbers."""
    return np.array([function(*map(mp.mpf, row)) for row in np.broadcast(*columns)])


def largest(found, exact):
    """Return the largest relative error."""
    return float(np.max(np.abs(np.asarray(found) / exact - 1)))


SECTIONS = {'calls': calls, 'bodies': bodies, 'derivatives': derivatives, 'elliptic': elliptic,
            'so3': rotations}


def main():
    """Run the given sections, or all."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('sections', nargs='*', metavar='SECTION',
                        help=f'any of {", ".join(SECTIONS)} (default: all)')
    chosen = parser.parse_args().sections or SECTIONS
    if unknown := sorted(set(chosen) - set(SECTIONS)):
        parser.error(f'SECTION: expected any of {", ".join(SECTIONS)}, '
                     f'found {", ".join(unknown)}')
    mp.dps = 40
    for section in chosen:
        SECTIONS[section]()


if __name__ == '__main__':
    main()
