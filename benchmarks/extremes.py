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
Print the error of each solver for extreme bodies and motions.

    python benchmarks/extremes.py [--page docs/extremes.md]

With --page, write the largest errors of each family of scenes into that page, between the lines
that say so. The script takes two minutes.
"""

import argparse
from pathlib import Path
import sys

from rigid_body_ros.propagation import SOLVERS
from tables import header, row, write_into

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / 'test'))
from known import KNOWN, lost_momentum, ODE_LOSSES  # noqa: E402, I100
from scenes import FIXED_STEP, SCENES  # noqa: E402

#: Maximum number of steps of a fixed-step solver; a run with more steps would take too long.
MOST_STEPS = 3e6
#: The families of scenes on the page, each with the beginnings of the names of its scenes.
FAMILIES = {
    'rods, rulers': ('rod, ', 'ruler, '),
    'rods, rulers, full tensor, under torque': ('rod 1e', 'ruler 1e'),
    'plates': ('plate, I1', 'plate of'),
    'plates, full tensor, under torque': ('plate, full',),
    'discs, spheres, near-spheres': ('disc', 'almost a disc', 'sphere', 'near-sphere'),
    'a full tensor, times 1e-30 to 1e30': ('an ordinary', 'tensor of'),
    'rates of 1e4 to 1e8 rad/s': ('spin of', 'tumbling'),
    'rates of 1e-200 and 1e-9 rad/s': ('rates of',),
    'torque over inertia of 1e8': ('torque over', 'rod under'),
    'torques 1 ns apart': ('torques 1 ns',),
    'torques a day apart': ('torques a day',),
    'a coast of a day, a million turns': ('a coast', 'a million'),
    'on the separatrix': ('on the separatrix',),
    'off the separatrix by 1e-12 to 1e-3': ('off the separatrix',),
    'about the intermediate axis': ('about the intermediate',),
    'off it by 1e-15 to 1e-3': ('off the intermediate',),
    'MuJoCo #3553, a thin stick': ('MuJoCo',),
    "Gazebo's boxes": ('Gazebo',),
    'Avian #993': ('Avian',),
    "van Zon's top": ('van Zon',),
    'SciPy #8480, modulus near 1': ('SciPy',),
}


def error_of(scene, solver):
    """Return the largest error of a solver, rad, or as text the reason why there is none."""
    if solver not in scene.solvers:
        return '-'
    if solver in FIXED_STEP and scene.steps > MOST_STEPS:
        return 'not run'
    try:
        apart, _ = scene.errors(scene.propagate(solver))
    except ValueError as error:
        return f'rejected: {"step too long" if "may be too long" in str(error) else error}'
    return apart.max()


def number(value):
    """Return a number as text with two digits; text stays as it is."""
    return value if isinstance(value, str) else f'{value:.1e}' if value > 1e-30 else '0'


def scene_lines(errors):
    """Return the lines of the table of all scenes."""
    lines = header('scene', 'turned, rad', 'last-digit effect', *SOLVERS[:3], 'step, s',
                   *FIXED_STEP)
    for scene in SCENES:
        cells = [number(each) for each in errors[scene.name]]
        lines.append(row(scene.name, f'{scene.phase:.3g}',
                         number(scene.growth) if scene.amplifies else '', *cells[:3],
                         f'{scene.step:g}', *cells[3:]))
    return [*lines, '']


def families():
    """Return the families, each with its scenes."""
    return {family: [scene for scene in SCENES if scene.name.startswith(names)]
            for family, names in FAMILIES.items()}


def family_lines(errors):
    """Return the lines of the table of the page: the largest errors of each family."""
    shown = [SOLVERS.index(name) for name in ('auto', 'taylor', 'rk4', 'strang')]
    lines = header('bodies and motions', 'turned, rad', 'last-digit effect',
                   *(f'`{SOLVERS[place]}`' for place in shown))
    for family, scenes in families().items():
        growth = [scene.growth for scene in scenes if scene.amplifies]
        lines.append(row(
            family, f'{max(scene.phase for scene in scenes):.3g}',
            number(max(growth, default='')),
            *(number(largest([errors[scene.name][place] for scene in scenes]))
              for place in shown)))
    return lines


def largest(errors):
    """Return the largest error, or the first reason if no scene has an error."""
    return max((each for each in errors if not isinstance(each, str)), default=errors[0])


def momentum_lines():
    """Return the lines of the table of how much momentum Gazebo's boxes lose within 10 s."""
    lines = header('step, s', 'published loss of ODE', *reversed(FIXED_STEP), 'auto')
    for step, published in ODE_LOSSES.items():
        losses = [number(lost_momentum(solver, step)) for solver in (*FIXED_STEP[::-1], 'auto')]
        lines.append(row(f'{step:g}', f'{published:.1e}', *losses))
    return [*lines, '']


def known_lines():
    """Return the lines of the table of known results."""
    lines = header('quantity', 'exact', 'computed', 'relative error')
    for name, (quantity, _) in KNOWN.items():
        exact, found = quantity()
        lines.append(row(name, f'{exact:.15g}', f'{found:.15g}',
                         number(abs(found - exact) / abs(exact))))
    return lines


def main():
    """Print the tables, or write that of the families into the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--page', type=Path)
    page = parser.parse_args().page
    errors = {scene.name: [error_of(scene, solver) for solver in SOLVERS] for scene in SCENES}
    if page is None:
        print('\n'.join([*scene_lines(errors), *momentum_lines(), *known_lines()]))
        return
    write_into(page, __file__, '\n'.join(family_lines(errors)))


if __name__ == '__main__':
    main()
