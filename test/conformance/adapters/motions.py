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

"""What all adapters share: read the motions, and write the results."""

import argparse
from itertools import pairwise
import json
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).resolve().parents[1] / 'motions'
#: Inputs that a motion may have besides a body, a start and torques.
TERMS = ('damping_xx_yy_zz_xy_xz_yz', 'rotor_momentum', 'uniform_field', 'orbit')


class UnsupportedError(Exception):
    """Raised for a motion that a program cannot compute."""


class Motion:
    """The inputs of a motion, and the times of its outputs."""

    def __init__(self, path):
        written = json.loads(path.read_text())
        self.name, self.inputs = path.stem, written['inputs']
        self.times_ns = [row[0] for row in written['truth_t_ns_attitude_xyzw_angular_velocity']]
        self.inertia = tensor(self.inputs['inertia_xx_yy_zz_xy_xz_yz'])
        self.start = np.array(self.inputs['attitude_xyzw'] + self.inputs['angular_velocity'])
        self.in_space = self.inputs['torque_frame'] == 'space'

    def supports(self, *terms):
        """Raise UnsupportedError if the motion has inputs that are not among the given ones."""
        if others := [name for name in TERMS if name in self.inputs and name not in terms]:
            raise UnsupportedError(', '.join(others))

    def spans(self):
        """Yield begin and end, ns, and the torque, for spans without a change of the torque."""
        torques = {row[0]: np.array(row[1:]) for row in self.inputs['torques_t_ns_x_y_z']}
        marks, torque = sorted({0, *torques, *self.times_ns}), np.zeros(3)
        for begin_ns, end_ns in pairwise(marks):
            torque = torques.get(begin_ns, torque)
            yield begin_ns, end_ns, torque


def tensor(entries):
    """Return a symmetric tensor from its entries xx, yy, zz, xy, xz, yz."""
    xx, yy, zz, xy, xz, yz = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def steps(begin_ns, end_ns, longest):
    """Return how many equal steps fill a span, and their length, s."""
    count = max(1, round((end_ns - begin_ns) / 1e9 / longest))
    return count, (end_ns - begin_ns) / 1e9 / count


def run(propagate, description, **options):
    """
    Compute all motions, and write a file for each.

    `propagate(motion, step, **options)` yields the time, ns, and the state at the end of each span
    of the motion: attitude x, y, z, w, body to space, and angular velocity in body axes, rad/s.
    """
    parser = argparse.ArgumentParser(description=description.strip().splitlines()[0])
    parser.add_argument('results', type=Path, help='folder to write, which must not exist')
    parser.add_argument('--step', type=float, default=0.001, help='s')
    for name, default in options.items():
        parser.add_argument(f'--{name}', default=default, help=f'{default} if not given')
    arguments = vars(parser.parse_args())
    folder, step = arguments.pop('results'), arguments.pop('step')
    folder.mkdir(parents=True)
    for path in sorted(FOLDER.glob('*.json')):
        motion = Motion(path)
        try:
            rows = [[time_ns, *state] for time_ns, state in propagate(motion, step, **arguments)
                    if time_ns in motion.times_ns]
        except UnsupportedError as reason:
            print(f'left out: {motion.name}: no {reason}')
            continue
        (folder / f'{motion.name}.csv').write_text(''.join(
            f'{int(time_ns)},{",".join(map(repr, map(float, state)))}\n'
            for time_ns, *state in rows))
