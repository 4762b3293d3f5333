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
#: Maximum number of steps of a fixed-step solver; a run with more steps would take too long.
MOST_STEPS = 3e6
REMARKS = {
    'Rods, plates, near-spheres':
        "Euler's equations do not become stiff, however unequal the moments are. For a rod, "
        'though, `(J w) x w` is the small difference of terms that are a million times larger '
        'than the difference itself. The solvers therefore compute `(J w) x w` from the '
        'differences between the moments, and compute even the smallest of these differences '
        'with more than double precision. For a rod with a full tensor, the terms of `J^-1 tau` '
        'cancel in the same way, so the Taylor series sums these terms in twice the working '
        'precision. For scenes under torque, the column *last-digit effect* shows how much the '
        'true motion changes if every entry of the tensor, the rates and the torques changes by '
        'one unit in the last place. A cell in this column is empty if the motion does not '
        'magnify rounding errors. For a rod with a full tensor, the last-digit effect is far '
        'larger than the error of `auto`, which treats all digits as exact.',
    'Large and small numbers':
        'A motion depends only on the ratio of torque to inertia and on the product of rate and '
        'time. With `taylor`, the rates accumulate random rounding errors, and the attitude is '
        'the integral of the rates, so the attitude error grows with the 3/2 power of the angle '
        'turned. Once the body has turned by more than about 1e4 rad, this error exceeds '
        '1e-15 rad per radian. The same is true of `auto` while a torque acts.',
    'Short and long times':
        'Times are integer nanoseconds, so a short step does not lose digits, even late in a '
        'long run or at large time stamps. During a coast, which is a span without torque, the '
        'closed form computes each state directly from the start of the coast with constants of '
        '32 digits, so even a million turns cost no accuracy.',
    'Separatrix and intermediate axis':
        'The separatrix is the boundary between motions around the axis of the largest moment '
        'and motions around the axis of the smallest moment. Near the separatrix, the motion '
        'itself magnifies small errors. To measure the *last-digit effect*, the angular '
        'velocity is changed by 2.2e-16 of its size at one of five instants; the column shows '
        'the largest resulting change of the true final attitude. A cell in this column is '
        'empty if the motion does not magnify rounding errors. No solver that steps through the '
        'motion in doubles can guarantee an error below the last-digit effect. The closed form '
        'needs no steps and is exact to rounding even next to the separatrix.',
    'Where others broke':
        "MuJoCo's integrator `implicitfast` failed on the thin stick at step 4294, with steps "
        'of 1 ms. The scene in the table has the same stick, but starts with different rates. '
        'Avian clamped the momentum, so every body ended up turning about its intermediate '
        "axis. SciPy's `ellipj` returns a result with an error of 2 for a modulus near 1.",
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
    """Return the lines for a group of scenes: heading, remark and table."""
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
    """Return the lines of the section on how much momentum Gazebo's boxes lose."""
    lines = ["## Gazebo's boxes: loss of momentum", '',
             'The table shows the largest relative change of the angular momentum within 10 s. '
             'The values for *ODE* (Open Dynamics Engine) were published in '
             'BENCHMARK_boxes_dt.csv in github.com/scpeters/benchmark; the other columns were '
             'computed with this package. The values for `explicit_euler` differ from those for '
             'ODE by up to 3 %, because ODE rotates the attitude with the rates after the step, '
             'whereas `explicit_euler` rotates it with the rates before the step.',
             '', *header('step, s', 'ODE', *reversed(FIXED_STEP), 'auto')]
    for step, published in ODE_LOSSES.items():
        losses = [number(lost_momentum(solver, step)) for solver in (*FIXED_STEP[::-1], 'auto')]
        lines.append(row(f'{step:g}', f'{published:.1e}', *losses))
    return [*lines, '']


def known_lines():
    """Return the lines of the section on known results."""
    lines = ['## Known results', '',
             'The periods in the column *computed* come from `exact`, and all other values from '
             '`auto`. In the [closed form](theory.md#motion-without-torque-in-closed-form), the '
             'rates repeat after the period 4 K / lambda. The computed period is an average '
             'over a million periods. The escape time K / lambda is the time until the rate '
             'about the intermediate axis is zero, and it grows with the logarithm of 1 / '
             "offset. In Landau and Zener's sweep, a constant torque accelerates a sphere, and "
             "the exact result is written with parabolic cylinder functions. In Boedewadt's "
             'problem, a torque held in body axes acts on a symmetric body, and the exact '
             'result is an integral. In the last row, a constant torque accelerates a spin '
             'about a principal axis from -1e4 to about 1.5e4 rad/s.',
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
