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
Measure the cost of calls and of bodies, and compare elliptic functions and rotations with SciPy.

    python benchmarks/choices.py [SECTION ...]

The sections are `calls` (how arguments are passed from Python to a kernel), `bodies` (the
constants of many bodies, and of one), `elliptic` and `so3` (this package and SciPy). Times are
processor times, the shortest of several. Errors are the largest differences from mpmath: relative
for `elliptic`, of components for `so3`.
"""

import argparse
from functools import partial
import time
import timeit

from mpmath import mp
import numba
import numpy as np
from scipy import special
from scipy.spatial.transform import Rotation

#: Arguments of each function.
COUNT = 1000
RANDOM = np.random.default_rng(3)


def seconds(function):
    """Return the shortest processor time of a call, s."""
    function()
    timer = timeit.Timer(function, timer=time.process_time)
    number, _ = timer.autorange()
    return min(timer.repeat(7, number)) / number


def calls():
    """Print the time of a call from Python to a kernel that does nothing."""
    from rigid_body_ros.kernels import layout
    stamps, order, flags = np.zeros(2, np.int64), np.zeros(0, np.intp), np.zeros(2, bool)
    values, method = np.zeros(48), layout.Method(1, False, 16.0, 1e-15, 1.0, 0)
    rows = layout.Rows(stamps, np.zeros((1, 1, 3)), flags, np.zeros(0))
    outputs = layout.Requested(stamps, order, values, flags)
    vector = (1.0, 2.0, 3.0, 0.0)
    axes, state = (vector, vector, vector), (vector, vector, vector, vector)
    body = layout.Body(((vector,) * 9, (vector,) * 9, vector, vector), 0,
                       (vector, vector, axes, axes))
    records = (method, rows, outputs, layout.Place(0, 0, -1, 0), body,
               layout.GridStates(state, state, state))
    shared = np.zeros(1, layout.PROGRESS), *outputs, rows, values, np.zeros(1, layout.METHOD)
    fields = [*shared[:-3], *rows, *shared[-2:]]
    empty = numba.njit(lambda *arguments: None)
    for name, arguments in (('6 records', records), ('as the loop is called', shared),
                            ('with arrays only', fields)):
        print(f'calls: {name:24} {1e6 * seconds(partial(empty, *arguments)):.1f} us')


def bodies():
    """Print the time of the constants of a body, in 10 000 bodies and alone."""
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


def elliptic():
    """Print the errors and times of elliptic functions and integrals, here and in SciPy."""
    from rigid_body_ros.kernels.elliptic import carlson_f, carlson_j, jacobi
    functions = [numba.vectorize(lambda u, complement: jacobi(u, complement)[0]),
                 numba.vectorize(lambda u, complement: jacobi(u, complement)[1]),
                 numba.vectorize(lambda u, complement: jacobi(u, complement)[2])]
    for complement in (1e-3, 1e-9, 1e-15):
        u = np.linspace(0.05, 0.95, 7) * float(special.ellipkm1(complement))
        exact = [mapped(lambda x, m, name=name: mp.ellipfun(name, x, m=m), u,
                        1 - mp.mpf(complement)) for name in ('sn', 'cn', 'dn')]
        ours = [function(u, complement) for function in functions]
        theirs = special.ellipj(u, 1.0 - complement)[:3]
        print(f'elliptic: sn, cn, dn at m_c = {complement:.0e}: error {largest(ours, exact):.1e}, '
              f'SciPy {largest(theirs, exact):.1e}')
    x, y = np.sort(10.0 ** RANDOM.uniform(-30, 0, (2, COUNT)), axis=0)
    p = 1.0 + 10.0 ** RANDOM.uniform(-20, 0, COUNT)
    first = numba.vectorize(lambda x, y, z: carlson_f(x, y, z))
    third = numba.vectorize(lambda x, y, z, p: carlson_j(x, y, z, p))
    for name, function, scipys, exact, given in (
            ('R_F', first, special.elliprf, mp.elliprf, (x, y, 1.0)),
            ('R_J', third, special.elliprj, mp.elliprj, (x, y, 1.0, p))):
        right = mapped(exact, *given)
        print(f'elliptic: {name}: ' + ', SciPy '.join(
            f'error {largest(each(*given), right):.1e}, '
            f'{1e9 * seconds(partial(each, *given)) / COUNT:.0f} ns'
            for each in (function, scipys)))


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
    """Return a function of doubles, one call for each row, in mpmath numbers."""
    return np.array([function(*map(mp.mpf, row)) for row in np.broadcast(*columns)])


def largest(found, exact):
    """Return the largest relative error."""
    return float(np.max(np.abs(np.asarray(found) / exact - 1)))


SECTIONS = {'calls': calls, 'bodies': bodies, 'elliptic': elliptic, 'so3': rotations}


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
