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
Print the tables of docs/validation.md: published values, computed values and their differences.

    python benchmarks/validation.py [--page docs/validation.md]

With --page the tables are written into that file, between its lines `MARK` and `END`. This needs
NASA's check-case data: set the environment variable NESC_DATA to their folder.
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
#: By source: heading, reference, and remarks.
TEXTS = {
    'jeod': ("The Space Station of NASA's JEOD", [
        'NASA, JSC Engineering Orbital Dynamics (JEOD), github.com/nasa/jeod at commit 6550cf4e: '
        '`verif/SIM_dyncomp/SET_test_val/RUN_9B/log_state_ASCII.csv`, with the inertia of '
        '`verif/SIM_dyncomp/Modified_data/mass.py`.',
        'The inertia is a full tensor. The run lasts eight hours, with a torque of 10 N m about '
        'body x from 1000 s to 2000 s; the jumps of the logged acceleration show these times. The '
        'rows *against 32 digits* compare with a Taylor series of 32 digits from the same initial '
        'state. The last row compares JEOD with that series: it shows that the difference at the '
        'end of the run comes from JEOD.']),
    'nesc': ("The tumbling brick of NASA's check-cases", [
        'Murri, Jackson and Shelton, Check-cases for verification of 6-degree-of-freedom flight '
        'vehicle simulations, NASA/TM-2015-218675: atmospheric case 3, tumbling brick with '
        'damping, simulation 4. Also in github.com/nasa/simupy-flight: '
        '`NESC_data/Atmospheric_checkcases/Atmos_03_TumblingBrickDamping/Atmos_03_sim_04.csv`.',
        'The logged moments are replayed with cubic interpolation. The last row fits the inertia '
        'to the logged moments, attitudes and rates, with a sphere as the guess; the reference is '
        'the inertia of the check-case, slug ft^2. The data are not part of this project. To '
        'repeat the comparison, set `NESC_DATA` to the folder that contains '
        '`atmos_03_sim_04.csv`; otherwise the test is skipped.']),
    'toutatis': ('The asteroid Toutatis', [
        'Moments, initial state and radar observations: Takahashi, Busch and Scheeres, Spin state '
        'and moment of inertia characterization of 4179 Toutatis, Astronomical Journal 146:95, '
        '2013, as in github.com/mockingbirdnest/Principia at commit f6bc70e5, '
        '`physics/euler_solver_test.cpp`, test `Toutatis`, which also states the deviation of '
        "Principia's own solution from radar. Periods: Zhao, Hu and Ji, Revisit of rotational "
        "dynamics of asteroid 4179 Toutatis from Chang'e-2's flyby, IAU Symposium 318, 156-159, "
        '2016 (arXiv:1511.04357): 5.38 +- 0.03 and 7.40 +- 0.03 days.',
        'The prediction starts on 1992-11-09 and is free of torque. The bounds of the periods are '
        'their published errors. The principal axes, numbered from the smallest moment to the '
        'largest, deviate from the radar observations by several degrees. Those of Principia '
        'deviate by the same angles, to all the digits that its test states. The rows compare '
        'these angles at the first and the last observation of 1992.']),
    'tops': ('Bodies without torque from the literature', [
        'Bodies and initial states: Hairer and Vilmart, Preprocessed discrete Moser-Veselov '
        'algorithm for the full dynamics of a rigid body, J. Phys. A 39, 13225, 2006; van Zon and '
        'Schofield, Numerical implementation of the exact dynamics of free rigid bodies, J. '
        'Comput. Phys. 225, 145, 2007, in github.com/JSBSim-Team/jsbsim: '
        '`check_cases/notebooks/rotation/Rotations.ipynb`; the boxes of '
        'github.com/scpeters/benchmark.',
        'No published states with enough digits were available. The references come from a Taylor '
        'series of 34 digits, which agrees with the closed form and starts from the decimals of '
        'the literature. This package starts from the same decimals rounded to doubles. The '
        'period of the rates, 4 K / lambda, is measured over a million periods; a body that flips '
        'does so once every half period.']),
    'sweep': ('The sweep of Landau and Zener', [
        'Zener, Non-adiabatic crossing of energy levels, Proc. R. Soc. Lond. A 137, 696, 1932.',
        'For a sphere under a constant torque, with w = (1, 0, t), the attitude is known in '
        'closed form. Over a finite time R33, the last entry of the rotation matrix, is given by '
        'parabolic cylinder functions. Over an infinite time it is 2 exp(-pi / 2) - 1. The '
        'difference in the last row comes from the finite time, not from rounding. That row '
        'compares the cosine of the angle between the final and the reversed initial angular '
        'velocity, in space axes, because it approaches the limit faster than R33.']),
    'gyrostat': ('Rotors and damping', [
        'Symmetric gyrostat: Hughes, Spacecraft Attitude Dynamics, 1986. Dual spin: Schaub and '
        'Junkins, Analytical Mechanics of Space Systems, 2nd edition, 2009, chapter 4; Likins, '
        'Attitude stability criteria for dual spin spacecraft, J. Spacecraft Rockets 4, 1638, '
        '1967.',
        'A symmetric body with a rotor on its axis precesses: w1 + i w2 turns at the rate '
        '((I3 - I1) w3 + h) / I1. A sphere with the damping d slows down as exp(-d t / I) about a '
        'fixed axis. Wheels turn a satellite but leave its momentum in space as it was. A spin '
        'about the intermediate axis is stable if a rotor on that axis is fast enough: for '
        'moments of 1, 2 and 3 kg m^2 and a spin of 1 rad/s, if |h| exceeds 1 N m s. A spin about '
        'axis 1, that of the smallest moment, is unstable if h is between 1 and 2 N m s, and '
        'stable for any other h, so these rows depend on the sign of h. A deviation of 1e-8 rad/s '
        'grows or swings at rates known to first order in the deviation.']),
}


def cells(name, compare, bound):
    """Return the cells of a row of a table."""
    try:
        reference, ours, apart = compare()
    except DataNotHereError as error:
        return name, '', str(error), '', f'{bound:g}'
    return name, reference, ours, number(apart), f'{bound:g}'


def source_lines(source):
    """Return the heading, reference, remarks, command and table of a source."""
    title, paragraphs = TEXTS[source]
    lines = [f'## {title}', '']
    for paragraph in paragraphs:
        lines += [paragraph, '']
    lines += [f'To repeat: `pytest test/test_validation.py -k {source}`', '',
              *header('quantity', 'reference', 'computed', 'difference', 'bound')]
    lines += [row(*cells(name, *how)) for name, how in ROWS[source].items()]
    return [*lines, '']


def tables():
    """Return the text of all sources."""
    return '\n'.join(line for source in ROWS for line in source_lines(source))


def main():
    """Print the tables, or write them into the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--page', type=Path, metavar='FILE', help='write the tables into FILE')
    page = parser.parse_args().page
    if page is None:
        print(tables())
        return
    if 'NESC_DATA' not in os.environ:
        parser.error('--page: NESC_DATA is not set, so the rows that need it would be lost')
    text = page.read_text()
    page.write_text(f'{text.split(MARK)[0]}{MARK}\n\n{tables()}\n{END}{text.split(END)[1]}')


if __name__ == '__main__':
    main()
