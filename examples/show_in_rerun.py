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
Show a motion in Rerun: the moving body, its angular momentum, and plots.

The example replays the torques of a recording with a scene. It opens the viewer, or with --save
writes a file that `rerun FILE.rrd` opens. It needs the Python package rerun-sdk.

    python examples/show_in_rerun.py RECORDING --scene FILE [--save FILE.rrd]
"""

import argparse
from pathlib import Path
import sys

import numpy as np
from rigid_body_ros import scene, so3
from rigid_body_ros.replay import markers, replay

try:
    import rerun as rr
    import rerun.blueprint as rrb
except ModuleNotFoundError:
    sys.exit('rerun is not installed; run python3 -m pip install rerun-sdk')

BLUE, ORANGE, GREY = (0, 114, 178), (213, 94, 0), (179, 191, 204)
#: Length of the arrows; the box of the body is at most 1 long.
LENGTH = 1.2


def main():
    parser = argparse.ArgumentParser(description='Show a motion in Rerun.')
    parser.add_argument('recording', metavar='RECORDING', help='recording of the torques')
    parser.add_argument('--scene', metavar='FILE', required=True, help='ROS 2 parameter file')
    parser.add_argument('--save', metavar='FILE.rrd', help='write a file, and open no viewer')
    options = parser.parse_args()
    if options.save and Path(options.save).exists():
        parser.error(f'{options.save}: the file exists')
    try:
        loaded = scene.load(options.scene)
        motion = replay(options.recording, loaded).trajectory
    except scene.InputError as error:
        parser.error(str(error))
    rr.init(Path(options.recording).stem, spawn=not options.save)
    if options.save:
        rr.save(options.save)
    sequence = loaded.values['euler_sequence']
    names = [f'{axis}{number}' for number, axis in enumerate(sequence, 1)]
    elapsed = motion.times_ns - motion.times_ns[0]
    times = rr.TimeColumn('time', duration=elapsed.astype('timedelta64[ns]'))
    momentum = motion.angular_momentum_space
    send_body(motion, times)
    send_arrows('angular_momentum', times, momentum, ORANGE)
    send_arrows('angular_velocity', times, so3.rotate(motion.attitude, motion.angular_velocity),
                BLUE)
    space = rrb.Spatial3DView(
        origin='space', name='Body; directions of angular momentum (orange) and velocity (blue)')
    plots = [
        plot('euler_angles', f'Euler angles {sequence} (rad)', times,
             motion.euler_angles(sequence, continuous=True), names),
        plot('quaternion', 'Quaternion', times, motion.attitude, 'xyzw'),
        plot('angular_velocity', 'Angular velocity, body axes (rad/s)', times,
             motion.angular_velocity, ('ω₁', 'ω₂', 'ω₃')),
        plot('angular_momentum', 'Angular momentum, space axes (N m s)', times, momentum,
             ('L₁', 'L₂', 'L₃'))]
    rr.send_blueprint(rrb.Blueprint(rrb.Horizontal(space, rrb.Vertical(*plots)),
                                    rrb.TimePanel(timeline='time'), collapse_panels=True))


def send_body(motion, times):
    """Send a uniform box with the moments of inertia of the body, its axes, and its motion."""
    axes = rr.Quaternion(xyzw=so3.from_matrix(motion.body.principal_axes))
    rr.log('space', rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    rr.log('space/body', rr.TransformAxes3D(0.8), static=True)
    rr.log('space/body/box', rr.Boxes3D(
        half_sizes=[markers.box(motion.body) / 2.0], quaternions=[axes], colors=GREY,
        fill_mode='solid'), static=True)
    rr.send_columns('space/body', [times], rr.Transform3D.columns(quaternion=motion.attitude))


def send_arrows(name, times, vectors, colour):
    """Send the directions of vectors as arrows of equal length."""
    sizes = np.linalg.norm(vectors, axis=1, keepdims=True)
    arrows = np.divide(LENGTH * vectors, sizes, out=np.zeros_like(vectors), where=sizes > 0.0)
    rr.log(f'space/{name}', rr.Arrows3D.from_fields(colors=colour, radii=0.015), static=True)
    rr.send_columns(f'space/{name}', [times], rr.Arrows3D.columns(vectors=arrows))


def plot(name, title, times, values, names):
    """Send the columns of values as curves, and return a view of them."""
    path = f'plots/{name}'
    rr.log(path, rr.SeriesLines(names=[*names]), static=True)
    rr.send_columns(path, [times], rr.Scalars.columns(scalars=values))
    return rrb.TimeSeriesView(origin=path, name=title)


if __name__ == '__main__':
    main()
