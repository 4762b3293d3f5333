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
Replay a recording of torques in your own program, as `attitude_replay` does.

The example reads the recording of a tumbling CubeSat that comes with the package, or your own
recording (MCAP, rosbag2 or CSV; see docs/recordings.md) and scene.

    python examples/replay_log.py [RECORDING] [--scene FILE]
"""

import argparse
from pathlib import Path

from rigid_body_ros import replay, scene

ROOT = Path(__file__).resolve().parent.parent


def main():
    parser = argparse.ArgumentParser(description='Replay a recording of torques.')
    parser.add_argument('recording', metavar='RECORDING', nargs='?',
                        default=ROOT / 'test' / 'recordings' / 'tumbler.mcap',
                        help='recording of torques (default: %(default)s)')
    parser.add_argument('--scene', metavar='FILE', default=ROOT / 'config' / 'tumbler.yaml',
                        help='ROS 2 parameter file with the inertia and the initial state '
                        '(default: %(default)s)')
    options = parser.parse_args()
    try:
        result = replay.replay(options.recording, scene.load(options.scene))
    except scene.InputError as error:
        parser.error(str(error))

    seconds = (result.last.time_ns - result.start.time_ns) * 1e-9
    sequence = result.scene.values['euler_sequence']
    angles = result.trajectory.euler_angles(sequence)[-1]
    print('torques             ', result.account.samples, 'on', result.topic)
    print('motion              ', f'{seconds:.9g} s')
    print('final attitude      ', *result.last.attitude, '(x y z w)')
    print('final angles        ', *angles, f'rad ({sequence})')
    print('interpolation       ', result.interpolation)


if __name__ == '__main__':
    main()
