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
Print the error of each solver for extreme bodies and motions, as in docs/extremes.md.

    python benchmarks/extremes.py [--page docs/extremes.md]

With --page, replace everything after the line `MARK` of the page. The script takes two minutes.
"""

import argparse
from pathlib import Path
import sys

import numpy as np
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from rigid_body_ros.propagation import SOLVERS

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / 'test'))
from known import KNOWN, lost_momentum, ODE_LOSSES  # noqa: E402, I100
from scenes import FIXED_STEP, SCENES  # noqa: E402

MARK = '<!-- what follows is printed by benchmarks/extremes.py -->'
#: Maximum number of steps of a fixed-step solver; more would take too long for a table.
MOST_STEPS = 3e6
REMARKS = {
    'Rods, plates, near-spheres':
        "No ratio of moments makes Euler's equations stiff. For a rod, however, `(J w) x w` is a "
        'small difference of terms that are a million times larger than this difference. The '
        'solvers therefore compute `(J w) x w` from the differences of the moments, and compute '
        'even the smallest difference with more than double precision. For a rod with a full '
        'tensor, the terms of `J^-1 tau` cancel in the same way. The Taylor series therefore '
        'sums these terms in twice the working precision. Under torque, the *last-digit effect* '
        'is the change of the true motion if every entry of the tensor, the rates and the '
        'torques changes by one unit in the last place. For a rod with a full tensor, this '
        'effect is far larger than the error of `auto`, which treats all digits as exact. In '
        'this column, a cell is empty if the motion does not magnify rounding errors.',
    'Large and small numbers':
        'A motion depends only on the ratio of torque to inertia and on the product of rate and '
        'time. With `taylor`, the rates accumulate random rounding errors, and the attitude is '
        'the integral of the rates. The error of the attitude therefore grows with the power 3/2 '
        'of the angle turned. Beyond about 1e4 rad, this error exceeds 1e-15 rad per radian. The '
        'same is true of `auto` while a torque acts.',
    'Short and long times':
        'Times are integer nanoseconds, so a short step does not lose digits late in a long run '
        'or at large time stamps. In a coast, a span without torque, the closed form computes '
        'each state directly from the start of the coast, with constants of 32 digits. A million '
        'turns therefore cost no accuracy.',
    'Separatrix and intermediate axis':
        'The separatrix is the boundary between motions around the axis of the largest moment '
        'and motions around the axis of the smallest moment. Near the separatrix, the motion '
        'itself magnifies small errors. The *last-digit effect* is the largest change of the '
        'true final attitude if the angular velocity changes by 2.2e-16 of its size at one of '
        'five instants. In this column, a cell is empty if the motion does not magnify rounding '
        'errors. No solver that computes with doubles step by step can guarantee an error below '
        'the last-digit effect. The closed form needs no steps, and is exact to rounding even '
        'next to the separatrix.',
    'Where others broke':
        "MuJoCo's integrator `implicitfast` failed on the stick at step 4294, with steps of 1 "
        'ms; the table uses different initial rates. Avian clamped the momentum, so every body '
        "ended up turning about its intermediate axis. SciPy's `ellipj` has an error of 2 for a "
        'modulus near 1.',
}


def errors(scene):
    """Return the error, rad, of each solver as text."""
    return [error_of(scene, solver) for solver in SOLVERS]


def error_of(scene, solver):
    """Return the largest error of a solver as text, or the reason why there is none."""
    if solver not in scene.solvers:
        return '-'
    if solver in FIXED_STEP and scene.steps > MOST_STEPS:
        return 'not run'
    try:
        apart, _ = scene.errors(scene.propagate(solver))
    except ValueError as error:
        return rejected(error)
    return number(apart.max())


def rejected(error):
    """Return a short reason for a rejection."""
    return f'rejected: {"step too long" if "may be too long" in str(error) else error}'


def number(value):
    """Return a number as text with two digits."""
    return f'{value:.1e}' if value > 1e-30 else '0'


def row(*cells):
    """Return a row of a table."""
    return '| ' + ' | '.join(cells) + ' |'


def header(*cells):
    """Return the first two rows of a table."""
    return [row(*cells), '|' + '---|' * len(cells)]


def group_lines(group):
    """Return the lines of the heading, the remark and the table of a group of scenes."""
    scenes = [scene for scene in SCENES if scene.group == group]
    grows = any(scene.amplifies for scene in scenes)
    more = ('last-digit effect',) if grows else ()
    lines = [f'## {group}', '', REMARKS[group], '',
             *header('scene', 'turned, rad', *more, *SOLVERS[:3], 'step, s', *FIXED_STEP)]
    for scene in scenes:
        cells = errors(scene)
        more = (number(scene.growth) if scene.amplifies else '',) if grows else ()
        lines.append(row(scene.name, f'{scene.phase:.3g}', *more, *cells[:3], f'{scene.step:g}',
                         *cells[3:]))
    return [*lines, '']


def momentum_lines():
    """Return the lines of the section on the loss of momentum of Gazebo's boxes."""
    lines = ["## Gazebo's boxes: loss of momentum", '',
             'The table lists the largest relative change of the angular momentum in 10 s. The '
             'column *ODE* (Open Dynamics Engine) contains published values from '
             'BENCHMARK_boxes_dt.csv in github.com/scpeters/benchmark; this package computed the '
             'other columns. `explicit_euler` differs from ODE by up to 3 %, because ODE rotates '
             'the attitude with the rates after the step, and `explicit_euler` rotates it with '
             'the rates before the step.',
             '', *header('step, s', 'ODE', *reversed(FIXED_STEP), 'auto')]
    for step, published in ODE_LOSSES.items():
        losses = [number(lost_momentum(solver, step)) for solver in (*FIXED_STEP[::-1], 'auto')]
        lines.append(row(f'{step:g}', f'{published:.1e}', *losses))
    return [*lines, '']


def known_lines():
    """Return the lines of the section on known results."""
    lines = ['## Known results', '',
             'The column *computed* uses `exact` for the periods, and `auto` for all other rows. '
             'In the [closed form](theory.md#motion-without-torque-in-closed-form), the period '
             'of the rates is 4 K / lambda; the computed period is an average over a million '
             'periods. The escape time is K / lambda, the time until the rate about the '
             'intermediate axis is zero; the escape time grows with the logarithm of 1 / offset. '
             "In Landau and Zener's sweep, a constant torque accelerates a sphere; the exact "
             "result uses parabolic cylinder functions. In Boedewadt's problem, a torque held in "
             'body axes acts on a symmetric body; the exact result is an integral. In the last '
             'row, a constant torque accelerates a spin about a principal axis from -1e4 to '
             'about 1.5e4 rad/s.',
             '', *header('quantity', 'exact', 'computed', 'relative error')]
    for name, (quantity, _) in KNOWN.items():
        exact, found = quantity()
        lines.append(row(name, f'{exact:.15g}', f'{found:.15g}',
                         number(abs(found - exact) / abs(exact))))
    return [*lines, '']


def rejections():
    """Generate invalid inputs, each as a description and a function that raises the error."""
    def spun_by(torque):
        return propagate(RigidBody.from_moments(1.0, 2.0, 2.5), State(), at=[10 ** 9],
                         log=TorqueLog([0], [torque]))
    yield 'moments 3, 5, 9', lambda: RigidBody.from_moments(3.0, 5.0, 9.0)
    yield 'moments 0, 1, 1', lambda: RigidBody.from_moments(0.0, 1.0, 1.0)
    yield 'ixy = 5 with moments 1, 2, 2.5', lambda: RigidBody.from_moments(1.0, 2.0, 2.5, 5.0)
    yield 'an infinite rate', lambda: State(0, angular_velocity=(0.0, np.inf, 0.0))
    yield 'a torque of 1e12 N m on moments 1, 2, 2.5', lambda: spun_by((1e12, 0.0, 0.0))
    yield 'a torque that is NaN', lambda: spun_by((np.nan, 0.0, 0.0))


def rejection_lines():
    """Return the lines of the section on invalid input."""
    lines = ['## Invalid input', '', 'Each of these inputs raises a `ValueError`:', '',
             *header('input', 'message')]
    for what, attempt in rejections():
        try:
            attempt()
        except ValueError as error:
            lines.append(row(what, str(error)))
    return lines


def main():
    """Print the tables, or write them into the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--page', type=Path)
    page = parser.parse_args().page
    lines = [line for group in REMARKS for line in group_lines(group)]
    tables = '\n'.join([*lines, *momentum_lines(), *known_lines(), *rejection_lines()]) + '\n'
    if page is None:
        print(tables, end='')
    else:
        page.write_text(page.read_text().split(MARK)[0] + f'{MARK}\n\n{tables}')


if __name__ == '__main__':
    main()
