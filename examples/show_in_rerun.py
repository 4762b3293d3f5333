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
Show a recorded motion in Rerun: the moving body, its angular momentum, and plots.

The example reads a motion that `attitude_replay` wrote, and the scene of the replay. It opens the
viewer, or with --save writes a file that `rerun FILE.rrd` opens. It needs the Python package
rerun-sdk.

    python examples/show_in_rerun.py MOTION.mcap --scene FILE [--save FILE.rrd]
"""

import argparse
from pathlib import Path
import sys

import numpy as np
from rigid_body_ros import messages, recording, scene, so3
from rigid_body_ros.replay import markers

try:
    import rerun as rr
    import rerun.blueprint as rrb
except ModuleNotFoundError:
    sys.exit('rerun is not installed; run python3 -m pip install rerun-sdk')

#: The colours of the plots of this package; colour-blind people can tell them apart.
BLUE, ORANGE, GREEN, PURPLE = (0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167)
GREY = (179, 191, 204)
#: m; longer than the body, whose longest edge is 1 m.
LENGTH = 1.2
BODY, MOMENTUM, VELOCITY = 'space/body', 'space/angular_momentum', 'space/angular_velocity'


def main():
    parser = argparse.ArgumentParser(description='Show a recorded motion in Rerun.')
    parser.add_argument('motion', metavar='MOTION', help='motion that attitude_replay wrote')
    parser.add_argument('--scene', metavar='FILE', required=True,
                        help='ROS 2 parameter file of the motion')
    parser.add_argument('--save', metavar='FILE.rrd', help='write a file, and open no viewer')
    options = parser.parse_args()
    if options.save and Path(options.save).exists():
        parser.error(f'{options.save}: the file exists')
    try:
        loaded = scene.load(options.scene)
        attitude = recording.read(options.motion, '/attitude', messages.QUATERNION)
        rates = recording.read(options.motion, '/angular_velocity', messages.VECTOR3)
        angles = recording.read(options.motion, '/euler_angles', messages.VECTOR3)
        momentum = loaded.body.angular_momentum(rates.values)
        if loaded.has_rotors:
            momentum += recording.read(options.motion, '/rotor_momentum', messages.VECTOR3).values
    except scene.InputError as error:
        parser.error(str(error))

    sequence = loaded.values['euler_sequence']
    rr.init(Path(options.motion).stem, spawn=not options.save)
    if options.save:
        rr.save(options.save)
    rr.send_blueprint(blueprint(sequence))
    send_body(loaded.body, attitude)
    momentum, velocity = (so3.rotate(attitude.values, vectors)
                          for vectors in (momentum, rates.values))
    send_arrows(MOMENTUM, attitude, momentum, ORANGE)
    send_arrows(VELOCITY, attitude, velocity, BLUE)
    names = [f'{axis}{number}' for number, axis in enumerate(sequence, 1)]
    send_curves('plots/euler_angles', angles, without_jumps(angles.values), names)
    send_curves('plots/quaternion', attitude, attitude.values, 'xyzw')
    send_curves('plots/angular_velocity', rates, rates.values, ('ω₁', 'ω₂', 'ω₃'))
    send_curves('plots/angular_momentum', attitude, momentum, ('L₁', 'L₂', 'L₃'))


def blueprint(sequence):
    """Return the layout: the body on the left, plots on the right."""
    plots = [rrb.TimeSeriesView(origin=f'plots/{path}', name=name) for path, name in (
        ('euler_angles', f'Euler angles {sequence} (rad)'), ('quaternion', 'Quaternion'),
        ('angular_velocity', 'Angular velocity, body axes (rad/s)'),
        ('angular_momentum', 'Angular momentum, space axes (N m s)'))]
    view = rrb.Spatial3DView(
        origin='space', name='Body; directions of angular momentum (orange) and velocity (blue)',
        eye_controls=rrb.EyeControls3D(position=(2.0, -2.4, 1.4), look_target=(0.0, 0.0, 0.0)))
    return rrb.Blueprint(rrb.Horizontal(view, rrb.Vertical(*plots)),
                         rrb.TimePanel(timeline='time', state='collapsed'), collapse_panels=True)


def send_body(body, attitude):
    """Send a uniform box with the moments of inertia of the body, its axes, and its motion."""
    rr.log('space', rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    axes = rr.Quaternion(xyzw=so3.from_matrix(body.principal_axes))
    rr.log(BODY, rr.TransformAxes3D(0.8), static=True)
    rr.log(f'{BODY}/box', rr.Boxes3D(half_sizes=[markers.box(body) / 2.0], quaternions=[axes],
                                     colors=GREY, fill_mode='solid'), static=True)
    rr.send_columns(BODY, [over(attitude)], rr.Transform3D.columns(quaternion=attitude.values))


def send_arrows(path, recorded, vectors, colour):
    """Send the directions of vectors as arrows of equal length."""
    sizes = np.linalg.norm(vectors, axis=1, keepdims=True)
    arrows = np.divide(LENGTH * vectors, sizes, out=np.zeros_like(vectors), where=sizes > 0.0)
    rr.log(path, rr.Arrows3D.from_fields(colors=colour, radii=0.015), static=True)
    rr.send_columns(path, [over(recorded)], rr.Arrows3D.columns(vectors=arrows))


def without_jumps(angles):
    """Return the angles with a gap at each jump, so that no line is drawn from 2 pi back to 0."""
    broken = angles.copy()
    broken[1:][np.abs(np.diff(angles, axis=0)) > np.pi] = np.nan
    return broken


def send_curves(path, recorded, values, names):
    """Send the columns of values at the times of a recorded topic."""
    colours = (BLUE, ORANGE, GREEN, PURPLE)[:len(names)]
    rr.log(path, rr.SeriesLines(names=[*names], colors=colours), static=True)
    rr.send_columns(path, [over(recorded)], rr.Scalars.columns(scalars=values))


def over(recorded):
    """Return the times of a recorded topic, relative to the first."""
    elapsed = recorded.stamps_ns - recorded.stamps_ns[0]
    return rr.TimeColumn('time', duration=elapsed.astype('timedelta64[ns]'))


if __name__ == '__main__':
    main()
