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

With --page, replace everything between the lines `MARK` and `END` of the page. The option needs
NASA's check-case data: set the environment variable NESC_DATA to the folder of the data.
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
#: For each source: its heading, then the reference and the remarks.
TEXTS = {
    'jeod': ("The Space Station of NASA's JEOD", [
        "The reference is a log from NASA's JSC Engineering Orbital Dynamics (JEOD), in "
        'github.com/nasa/jeod at commit 6550cf4e: '
        '`verif/SIM_dyncomp/SET_test_val/RUN_9B/log_state_ASCII.csv`. The inertia is from '
        '`verif/SIM_dyncomp/Modified_data/mass.py` in the same repository.',
        'The inertia is a full tensor. The run lasts eight hours, and a torque of 10 N m about '
        'body x acts from 1000 s to 2000 s. These two times were found from the jumps in the '
        'logged acceleration. In the rows *against 32 digits*, the reference is a Taylor series '
        'with 32 digits from the same initial state. The last row compares JEOD with this '
        "series, and shows that JEOD's own error explains the difference between JEOD and this "
        'package at the end of the run.']),
    'nesc': ("The tumbling brick of NASA's check-cases", [
        'The reference is simulation 4 of atmospheric case 3, the tumbling brick with damping, in '
        'Murri, Jackson and Shelton, Check-cases for verification of 6-degree-of-freedom flight '
        'vehicle simulations, NASA/TM-2015-218675. The data are also in '
        'github.com/nasa/simupy-flight: '
        '`NESC_data/Atmospheric_checkcases/Atmos_03_TumblingBrickDamping/Atmos_03_sim_04.csv`.',
        'For the first two rows, the package replays the logged moments (torques) with cubic '
        'interpolation. For the last row, the package fits the inertia to the logged moments, '
        'attitudes and rates, starting from a sphere as the guess, and compares it with the '
        'inertia of the check-case, in slug ft^2. The data are not part of this project. To '
        'repeat the comparison, set `NESC_DATA` to the folder that contains '
        '`atmos_03_sim_04.csv`. If `NESC_DATA` is not set, the test is skipped.']),
    'toutatis': ('The asteroid Toutatis', [
        'The moments, the initial state and the radar observations are from Takahashi, Busch '
        'and Scheeres, Spin state and moment of inertia characterization of 4179 Toutatis, '
        'Astronomical Journal 146:95, 2013. The numbers are the same as in the test `Toutatis` '
        'in `physics/euler_solver_test.cpp` of github.com/mockingbirdnest/Principia at commit '
        "f6bc70e5. That test also lists how far Principia's solution deviates from the radar "
        'observations. The published periods are 5.38 +- 0.03 and 7.40 +- 0.03 days, from Zhao, '
        "Hu and Ji, Revisit of rotational dynamics of asteroid 4179 Toutatis from Chang'e-2's "
        'flyby, IAU Symposium 318, 156-159, 2016 (arXiv:1511.04357).',
        'The prediction starts on 1992-11-09 and assumes no torque. The bound for each period '
        'is its published uncertainty. The predicted principal axes, numbered from the smallest '
        'moment to the largest, deviate from the radar observations by several degrees. The '
        'axes that Principia predicts deviate by the same angles, to all the digits that '
        "Principia's test lists. The last two rows compare the angles from Principia "
        '(reference) with those from this package (computed), at the first and the last '
        'observation of 1992.']),
    'tops': ('Bodies without torque from the literature', [
        'The bodies and the initial states come from three sources: Hairer and Vilmart, '
        'Preprocessed discrete Moser-Veselov algorithm for the full dynamics of a rigid body, '
        'J. Phys. A 39, 13225, 2006; van Zon and Schofield, Numerical implementation of the '
        'exact dynamics of free rigid bodies, J. Comput. Phys. 225, 145, 2007, as in '
        '`check_cases/notebooks/rotation/Rotations.ipynb` of github.com/JSBSim-Team/jsbsim; and '
        'the boxes in github.com/scpeters/benchmark.',
        'The sources do not list final states with enough digits, so the reference states come '
        'from a Taylor series with 34 digits, which agrees with the closed form. The series '
        'starts from the decimal numbers in the literature, whereas this package starts from '
        'the same numbers rounded to doubles. The [period of the '
        'rates](theory.md#motion-without-torque-in-closed-form) is 4 K / lambda, and the '
        'computed period is an average over a million periods. If a body flips, it turns over '
        'once in each half period.']),
    'sweep': ('The sweep of Landau and Zener', [
        'The source is Zener, Non-adiabatic crossing of energy levels, Proc. R. Soc. Lond. A 137, '
        '696, 1932.',
        'For a sphere under a constant torque, with the angular velocity w = (1, 0, t), the '
        'attitude is known in closed form. R33 is the last entry of the rotation matrix. '
        'Parabolic cylinder functions give its value after a finite time, and after an infinite '
        'time it is 2 exp(-pi / 2) - 1. The last row compares the motion with this limit. '
        'Instead of R33, this row uses the cosine of the angle between the final angular '
        'velocity and the reversed initial angular velocity, in space axes, because this cosine '
        'approaches the limit faster than R33 does. The difference in this row comes from the '
        'finite duration of the motion, not from rounding.']),
    'gyrostat': ('Rotors and damping', [
        'The symmetric gyrostat follows Hughes, Spacecraft Attitude Dynamics, 1986. The dual spin '
        'follows Schaub and Junkins, Analytical Mechanics of Space Systems, 2nd edition, 2009, '
        'chapter 4, and Likins, Attitude stability criteria for dual spin spacecraft, J. '
        'Spacecraft Rockets 4, 1638, 1967.',
        'A symmetric body with a rotor of momentum h on its axis precesses: w1 + i w2 turns at '
        'the rate ((I3 - I1) w3 + h) / I1. A sphere with the damping d turns about a fixed '
        'axis, and its rate decays as exp(-d t / I). The wheels of a satellite can turn the '
        'satellite, but they cannot change the total momentum in space. A spin about the '
        'intermediate axis is stable if a rotor on that axis turns fast enough. For moments of '
        '1, 2 and 3 kg m^2 and a spin of 1 rad/s, this spin is stable if |h| exceeds 1 N m s. A '
        'spin about axis 1, the axis of the smallest moment, is unstable if h is between 1 and '
        '2 N m s and stable for any other h, so its stability depends on the sign of h. In the '
        'last four rows, the spin starts with a deviation of 1e-8 rad/s. The rate at which this '
        'deviation grows or oscillates is known to first order in the deviation.']),
}


def cells(name, compare, bound):
    """Return the cells of a table row."""
    try:
        reference, ours, apart = compare()
    except DataNotHereError as error:
        return name, '', str(error), '', f'{bound:g}'
    return name, reference, ours, number(apart), f'{bound:g}'


def source_lines(source):
    """Return the lines of a section: heading, reference, remarks, command and table."""
    title, paragraphs = TEXTS[source]
    lines = [f'## {title}', '']
    for paragraph in paragraphs:
        lines += [paragraph, '']
    lines += [f'To repeat: `pytest test/test_validation.py -k {source}`', '',
              *header('quantity', 'reference', 'computed', 'difference', 'bound')]
    lines += [row(*cells(name, *how)) for name, how in ROWS[source].items()]
    return [*lines, '']


def tables():
    """Return the text of all sections, one for each source."""
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
