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

With --page, replace everything after the line `MARK` of that page. It takes two minutes.
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
#: Limit for a fixed-step solver; more steps take too long for a table.
MOST_STEPS = 3e6
REMARKS = {
    'Rods, plates, near-spheres':
        "No ratio of moments makes Euler's equations stiff. But for a rod, `(J w) x w` is the "
        'difference of terms a million times larger. It is therefore computed from differences of '
        'moments, which are evaluated beyond double precision, however small they are. With a '
        'full tensor the terms of `J^-1 tau` cancel as much, so the series sums them in twice the '
        'working precision. Under torque, the *last-digit '
        'effect* is the change of the true motion if every entry of tensor, rates and torques '
        'changes by one unit in the last place. For a rod with a full tensor it is far larger '
        'than the error of `auto`, which takes all digits as exact.',
    'Large and small numbers':
        'Only torque over inertia, and rate times time, matter. `taylor` loses digits of the '
        'rates at random, and the attitude integrates them: its error grows with the power 3/2 '
        'of the angle turned, and beyond some 1e4 rad it exceeds 1e-15 per radian. The same holds '
        'for `auto` while a torque acts.',
    'Short and long times':
        'Times are integer nanoseconds, so a short step loses no digits in a long run or at a '
        'late epoch. The closed form is evaluated once from the start of a coast, with constants '
        'of 32 digits, so a million turns cost no accuracy.',
    'Separatrix and intermediate axis':
        'Here the motion itself magnifies small errors. The *last-digit effect* is the largest '
        'change of the true final attitude if the angular velocity changes by 2.2e-16 of its size '
        'at one of five instants. No solver that steps in doubles can guarantee a smaller error. '
        'The closed form does not step, and stays exact as close to the separatrix as doubles '
        'allow.',
    'Where others broke':
        "With MuJoCo's stick, `implicitfast` failed at step 4294 of 1 ms (the rates here are our "
        'own). Avian clamped the momentum, so that every body ended up turning about its '
        "intermediate axis. SciPy's `ellipj` has an error of 2 for a modulus near 1.",
}


def errors(scene):
    """Return the error of each solver, rad, as text."""
    return [error_of(scene, solver) for solver in SOLVERS]


def error_of(scene, solver):
    """Return the largest error of a solver, or the reason for its absence, as text."""
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
    """Return a short reason."""
    return f'rejected: {"step too long" if "may be too long" in str(error) else error}'


def number(value):
    """Return a number with two digits."""
    return f'{value:.1e}' if value > 1e-30 else '0'


def row(*cells):
    """Return a row of a table."""
    return '| ' + ' | '.join(cells) + ' |'


def header(*cells):
    """Return the first two rows of a table."""
    return [row(*cells), '|' + '---|' * len(cells)]


def group_lines(group):
    """Return heading, remark and table for a group of scenes."""
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
    """Return the table for Gazebo's boxes."""
    lines = ["## Gazebo's boxes: loss of momentum", '',
             'The largest relative change of the angular momentum in 10 s: published for ODE '
             '(github.com/scpeters/benchmark, BENCHMARK_boxes_dt.csv), and computed here. '
             '`explicit_euler` differs from ODE by 3 % because ODE rotates the attitude with the '
             'rates after the step.', '',
             *header('step, s', 'ODE', *reversed(FIXED_STEP), 'auto')]
    for step, published in ODE_LOSSES.items():
        losses = [number(lost_momentum(solver, step)) for solver in (*FIXED_STEP[::-1], 'auto')]
        lines.append(row(f'{step:g}', f'{published:.1e}', *losses))
    return [*lines, '']


def known_lines():
    """Return the table of known results."""
    lines = ['## Known results', '',
             'Computed by `auto`. Periods are 4 K / lambda, measured over a million periods. '
             'Escape times are K / lambda, so they grow with the logarithm of the offset. '
             "The exact result for Landau and Zener's sweep of a sphere under constant torque "
             "uses parabolic cylinder functions; that for Boedewadt's symmetric body under a "
             'torque in body axes is an integral.',
             '', *header('quantity', 'exact', 'computed', 'relative error')]
    for name, (quantity, _) in KNOWN.items():
        exact, found = quantity()
        lines.append(row(name, f'{exact:.15g}', f'{found:.15g}',
                         number(abs(found - exact) / abs(exact))))
    return [*lines, '']


def rejections():
    """Generate invalid inputs: a description, and a function that raises the error."""
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
    """Return the table of invalid inputs."""
    lines = ['## Invalid input', '', 'Each raises a `ValueError`:', '',
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
