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
Print what others published beside what is found here, as it stands in docs/validation.md.

    python benchmarks/validation.py [--page docs/validation.md]

With --page the tables there are made anew: all between the lines `MARK` and `END`. It takes some
seconds, and the folder of NASA's check-case data in the environment variable NESC_DATA.
"""

import argparse
import os
from pathlib import Path
import sys

from extremes import header, number, row

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / 'test'))
from published import DataNotHereError, ROWS  # noqa: E402

MARK = '<!-- what follows is printed by benchmarks/validation.py -->'
END = '<!-- end of what is printed by benchmarks/validation.py -->'
#: By source: heading, reference, and what to know about it.
TEXTS = {
    'jeod': ("The Space Station of NASA's JEOD", [
        'NASA, JSC Engineering Orbital Dynamics (JEOD), github.com/nasa/jeod at commit 6550cf4e: '
        '`verif/SIM_dyncomp/SET_test_val/RUN_9B/log_state_ASCII.csv`, with the inertia of '
        '`verif/SIM_dyncomp/Modified_data/mass.py`.',
        'A full tensor, eight hours, and 10 N m about body x from 1000 s to 2000 s (read off the '
        'jumps of the logged acceleration). Rows of *32 digits* are held against a Taylor series '
        'of so many from the same start. They tell whose the difference at the end is: the last '
        'row is JEOD itself against them.']),
    'nesc': ("The tumbling brick of NASA's check-cases", [
        'Murri, Jackson and Shelton, Check-cases for verification of 6-degree-of-freedom flight '
        'vehicle simulations, NASA/TM-2015-218675: atmospheric case 3, tumbling brick with '
        'damping, simulation 4. Also in github.com/nasa/simupy-flight: '
        '`NESC_data/Atmospheric_checkcases/Atmos_03_TumblingBrickDamping/Atmos_03_sim_04.csv`.',
        'The logged moments are replayed with cubic interpolation. The data are not part of this '
        'project: this needs `atmos_03_sim_04.csv` in the folder that `NESC_DATA` names, and '
        'is skipped without.']),
    'toutatis': ('The asteroid Toutatis', [
        'Moments, start and what radar saw: Takahashi, Busch and Scheeres, Spin state and moment '
        'of inertia characterization of 4179 Toutatis, Astronomical Journal 146:95, 2013, as '
        'in github.com/mockingbirdnest/Principia at commit f6bc70e5, '
        '`physics/euler_solver_test.cpp`, test `Toutatis`, which also has how far off its own '
        'solution is. Periods: Zhao, Hu and Ji, Revisit of rotational dynamics of asteroid 4179 '
        "Toutatis from Chang'e-2's flyby, IAU Symposium 318, 156-159, 2016 (arXiv:1511.04357): "
        '5.38 +- 0.03 and 7.40 +- 0.03 days.',
        'No torque acts in this prediction from 1992-11-09. The periods are held to the published '
        'errors. The principal axes, from the smallest moment on, are some degrees off what radar '
        'saw: so are those of Principia, and by the same to the last digit it has, which is what '
        'is compared, at its first and last time of 1992.']),
    'tops': ('Bodies without torque from the literature', [
        'Bodies and starts: Hairer and Vilmart, Preprocessed discrete Moser-Veselov algorithm '
        'for the full dynamics of a rigid body, J. Phys. A 39, 13225, 2006; van Zon and '
        'Schofield, Numerical implementation of the exact dynamics of free rigid bodies, J. '
        'Comput. Phys. 225, 145, 2007, in github.com/JSBSim-Team/jsbsim: '
        '`check_cases/notebooks/rotation/Rotations.ipynb`; the boxes of '
        'github.com/scpeters/benchmark.',
        'No digits of theirs were at hand. The figures are by a Taylor series of 34 digits, from '
        'the decimals of the literature, that agrees with the closed form; doubles begin a last '
        'digit off. Periods are those of the rates, 4 K / lambda, measured over a million of '
        'them: a body that flips does so every half of one.']),
    'sweep': ('The sweep of Landau and Zener', [
        'Zener, Non-adiabatic crossing of energy levels, Proc. R. Soc. Lond. A 137, 696, 1932.',
        'A sphere under constant torque, w = (1, 0, t): an attitude under torque in closed form. '
        'Between finite times R33 has parabolic cylinder functions. In the limit it is '
        '2 exp(-pi / 2) - 1; how nearly is a matter of how long, not of rounding. Seen along the '
        'rates the limit comes soonest.']),
}


def cells(name, compare, bound):
    """Return the cells of a row."""
    try:
        reference, ours, apart = compare()
    except DataNotHereError as error:
        return name, '', str(error), '', f'{bound:g}'
    return name, reference, ours, number(apart), f'{bound:g}'


def source_lines(source):
    """Return heading, reference, remark, command and table of a source."""
    title, paragraphs = TEXTS[source]
    lines = [f'## {title}', '']
    for paragraph in paragraphs:
        lines += [paragraph, '']
    lines += [f'Again: `pytest test/test_validation.py -k {source}`', '',
              *header('what', 'reference', 'here', 'difference', 'held to')]
    lines += [row(*cells(name, *how)) for name, how in ROWS[source].items()]
    return [*lines, '']


def tables():
    """Return all that is printed."""
    return '\n'.join(line for source in ROWS for line in source_lines(source))


def main():
    """Print, or write into the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--page', type=Path)
    page = parser.parse_args().page
    if page is None:
        print(tables())
        return
    if 'NESC_DATA' not in os.environ:
        parser.error('--page: set NESC_DATA, or the page would lose what needs it')
    text = page.read_text()
    page.write_text(f'{text.split(MARK)[0]}{MARK}\n\n{tables()}\n{END}{text.split(END)[1]}')


if __name__ == '__main__':
    main()
