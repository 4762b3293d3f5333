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
Print the tables of docs/validation.md: published values, and how far this package is from them.

    python benchmarks/validation.py [--page docs/validation.md]

With --page, replace everything between the lines of the page that say so. The option needs NASA's
check-case data: set the environment variable NESC_DATA to the folder of the data.
"""

import argparse
import os
from pathlib import Path
import sys

from extremes import number
from tables import header, row, write_into

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / 'test'))
from published import DataNotHereError, ROWS  # noqa: E402, I100

#: For each source: its heading and the remarks.
TEXTS = {
    'jeod': ("The Space Station of NASA's JEOD",
             'A log of github.com/nasa/jeod at commit 6550cf4e, '
             '`verif/SIM_dyncomp/SET_test_val/RUN_9B/log_state_ASCII.csv`; a full tensor, eight '
             'hours, 10 N m about body x from 1000 s to 2000 s. *Against 32 digits*: against a '
             "Taylor series with 32 digits, which shows that the final difference is JEOD's."),
    'nesc': ("The tumbling brick of NASA's check-cases",
             'Atmospheric case 3, simulation 4, of Murri, Jackson and Shelton, '
             'NASA/TM-2015-218675 (`NESC_data/Atmospheric_checkcases/'
             'Atmos_03_TumblingBrickDamping/'
             'Atmos_03_sim_04.csv` in github.com/nasa/simupy-flight; set `NESC_DATA` to its '
             'folder). Logged moments are replayed with `cubic`; the inertia, slug ft^2, is '
             'fitted from a sphere.'),
    'toutatis': ('The asteroid Toutatis',
                 'Moments, initial state and radar observations: Takahashi, Busch and Scheeres, '
                 'Astronomical Journal 146:95, 2013. Periods, +- 0.03 days: Zhao, Hu and Ji, '
                 'arXiv:1511.04357. The last rows compare how far the axes are from radar with '
                 'the test `Toutatis` of github.com/mockingbirdnest/Principia at f6bc70e5.'),
    'tops': ('Bodies without torque from the literature',
             'Hairer and Vilmart, J. Phys. A 39, 13225, 2006; van Zon and Schofield, J. Comput. '
             "Phys. 225, 145, 2007; Gazebo's boxes in github.com/scpeters/benchmark. States are "
             'compared with a Taylor series with 34 digits. The period is that [of the '
             'rates](theory.md#motion-without-torque-in-closed-form), averaged over a million.'),
    'sweep': ('The sweep of Landau and Zener',
              'Zener, Proc. R. Soc. Lond. A 137, 696, 1932: a sphere under a constant torque with '
              'w = (1, 0, t). R33 of the attitude is known in parabolic cylinder functions; its '
              'limit is 2 exp(-pi / 2) - 1.'),
    'gyrostat': ('Rotors and damping',
                 'Hughes, Spacecraft Attitude Dynamics, 1986; Schaub and Junkins, Analytical '
                 'Mechanics of Space Systems, 2009, chapter 4; Likins, J. Spacecraft Rockets 4, '
                 '1638, 1967. A symmetric gyrostat precesses at ((I3 - I1) w3 + h) / I1; a damped '
                 'sphere slows as exp(-d t / I). With moments 1, 2, 3 kg m^2 and a spin of '
                 '1 rad/s, a spin about axis 2 is stable if |h| exceeds 1 N m s, and about axis 1 '
                 'unless h is between 1 and 2 N m s.'),
}


def cells(name, compare):
    """Return the cells of a table row."""
    try:
        reference, _, apart = compare()
    except DataNotHereError as error:
        return name, str(error), ''
    return name, reference, number(apart)


def source_lines(source):
    """Return the lines of a section: heading, remarks and table."""
    title, remarks = TEXTS[source]
    lines = [f'### {title}', '', remarks, '', *header('quantity', 'reference', 'difference')]
    lines += [row(*cells(name, compare)) for name, (compare, _) in ROWS[source].items()]
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
    write_into(page, __file__, tables())


if __name__ == '__main__':
    main()
