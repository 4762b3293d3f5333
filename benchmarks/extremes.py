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
Print what each solver gives at the edges, as it stands in docs/extremes.md.

    python benchmarks/extremes.py [--page docs/extremes.md]

With --page the tables there are made anew: all that follows the line `MARK`. It takes two minutes.
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
#: Of a solver of fixed step; more take too long for a table.
MOST_STEPS = 3e6
REMARKS = {
    'Rods, plates, near-spheres':
        "No ratio of moments makes Euler's equations stiff, but `(J w) x w` of a rod is the "
        'difference of terms a million times its size. It is formed from differences of moments, '
        'which are worked out beyond double precision, and they may be as small as they like. '
        'So is `J^-1 tau`, whose terms cancel as much. Under torque, *a last digit becomes* has '
        'how far the true motion moves if every entry of tensor, rates and torques changes by '
        'one unit in the last place: for a rod with a full tensor, far more than the errors of '
        '`auto`, which takes the digits at face value.',
    'Large and small numbers':
        'Only torque over inertia and rates over time matter. What `taylor` loses of the rates '
        'to rounding is random, and the attitude adds it up: its error grows with the power 3/2 '
        'of the angle turned, beyond some 1e4 rad to more than 1e-15 per radian. So does that of '
        '`auto` where a torque acts for as long.',
    'Short and long times':
        'Times are integer nanoseconds, so neither a long run nor a late epoch blurs a short '
        'step. The closed form is evaluated once from the start of a coast, with constants of 32 '
        'digits: a million turns cost it nothing.',
    'Separatrix and intermediate axis':
        'Here the motion itself magnifies what is lost. *A last digit becomes* has what the true '
        'motion makes of a change of the rates by 2.2e-16 of their size at the worst of five '
        'moments: no solver that steps in doubles can promise less. The closed form does not '
        'step, and is right beyond that, as near to the separatrix as doubles come.',
    'Where others broke':
        "With MuJoCo's stick `implicitfast` gave up at step 4294 of 1 ms (the rates here are "
        "ours). Avian's clamp of the momentum led every body to turn about its intermediate "
        "axis in the end. SciPy's `ellipj` is off by 2 for modulus near 1.",
}


def errors(scene):
    """Return the error of each solver, rad, in words."""
    return [told(scene, solver) for solver in SOLVERS]


def told(scene, solver):
    """Return the largest error of a solver, or why there is none."""
    if solver not in scene.solvers:
        return '-'
    if solver in FIXED_STEP and scene.steps > MOST_STEPS:
        return 'not run'
    try:
        apart, _ = scene.errors(scene.propagate(solver))
    except ValueError as error:
        return refused(error)
    return number(apart.max())


def refused(error):
    """Return in a few words why."""
    return 'refused: step too long' if 'may be too long' in str(error) else f'refused: {error}'


def number(value):
    """Return it with two digits."""
    return f'{value:.1e}' if value > 1e-30 else '0'


def row(*cells):
    """Return a row of a table."""
    return '| ' + ' | '.join(cells) + ' |'


def header(*cells):
    """Return the first two rows of a table."""
    return [row(*cells), '|' + '---|' * len(cells)]


def group_lines(group):
    """Return heading, remark and table of a group of scenes."""
    scenes = [scene for scene in SCENES if scene.group == group]
    grows = any(scene.amplifies for scene in scenes)
    more = ('a last digit becomes',) if grows else ()
    lines = [f'## {group}', '', REMARKS[group], '',
             *header('scene', 'turned, rad', *more, *SOLVERS[:3], 'step, s', *FIXED_STEP)]
    for scene in scenes:
        cells = errors(scene)
        more = (number(scene.growth) if scene.amplifies else '',) if grows else ()
        lines.append(row(scene.name, f'{scene.phase:.3g}', *more, *cells[:3], f'{scene.step:g}',
                         *cells[3:]))
    return [*lines, '']


def momentum_lines():
    """Return the table of Gazebo's boxes."""
    lines = ["## Gazebo's boxes: the momentum lost", '',
             'The largest change of L over L in 10 s, as published for ODE '
             '(github.com/scpeters/benchmark, BENCHMARK_boxes_dt.csv) and here. `explicit_euler` '
             'is 3 % off it because ODE turns the attitude by the rates after the step.', '',
             *header('step, s', 'ODE', *reversed(FIXED_STEP), 'auto')]
    for step, published in ODE_LOSSES.items():
        losses = [number(lost_momentum(solver, step)) for solver in (*FIXED_STEP[::-1], 'auto')]
        lines.append(row(f'{step:g}', f'{published:.1e}', *losses))
    return [*lines, '']


def known_lines():
    """Return the table of what is known otherwise."""
    lines = ['## Known in closed form, or published', '',
             'Computed by `auto`. Periods are 4 K / lambda, measured over a million of them; '
             'escapes K / lambda, so that they grow as the logarithm of the offset; '
             "Landau and Zener's sweep of a sphere under constant torque has parabolic cylinder "
             "functions; Boedewadt's symmetric body under a torque in body axes an integral.",
             '', *header('what', 'right', 'found', 'off by')]
    for name, (quantity, _) in KNOWN.items():
        right, found = quantity()
        lines.append(row(name, f'{right:.15g}', f'{found:.15g}',
                         number(abs(found - right) / abs(right))))
    return [*lines, '']


def refusals():
    """Generate what is refused, and how to try it."""
    def spun_by(torque):
        return propagate(RigidBody.from_moments(1.0, 2.0, 2.5), State(), at=[10 ** 9],
                         log=TorqueLog([0], [torque]))
    yield 'moments 3, 5, 9', lambda: RigidBody.from_moments(3.0, 5.0, 9.0)
    yield 'moments 0, 1, 1', lambda: RigidBody.from_moments(0.0, 1.0, 1.0)
    yield 'ixy = 5 with moments 1, 2, 2.5', lambda: RigidBody.from_moments(1.0, 2.0, 2.5, 5.0)
    yield 'a rate that is infinite', lambda: State(0, angular_velocity=(0.0, np.inf, 0.0))
    yield 'a torque of 1e12 N m on moments 1, 2, 2.5', lambda: spun_by((1e12, 0.0, 0.0))
    yield 'a torque that is no number', lambda: spun_by((np.nan, 0.0, 0.0))


def refusal_lines():
    """Return the table of what is refused."""
    lines = ['## Refused', '', 'Each is a `ValueError`:', '', *header('what', 'message')]
    for what, attempt in refusals():
        try:
            attempt()
        except ValueError as error:
            lines.append(row(what, str(error)))
    return lines


def main():
    """Print, or write into the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--page', type=Path)
    page = parser.parse_args().page
    lines = [line for group in REMARKS for line in group_lines(group)]
    tables = '\n'.join([*lines, *momentum_lines(), *known_lines(), *refusal_lines()]) + '\n'
    if page is None:
        print(tables, end='')
    else:
        page.write_text(page.read_text().split(MARK)[0] + f'{MARK}\n\n{tables}')


if __name__ == '__main__':
    main()
