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

"""A robot as a URDF, and wrenches in the frames of its links."""

import bags
import numpy as np
from rigid_body_ros.mechanics import urdf
from scipy.spatial.transform import Rotation

SHIFT = ' xyz="0.25 0 -0.5" rpy="0.3 -0.2 1"'
#: A force at the origin of the thruster acts 0.75 m ahead of the centre of mass, along the body's
#: y axis.
THRUSTER = ('fixed', 'base_link', 'thruster', '1 0 -0.5', '0 0 1.5707963267948966')
JOINTS = (THRUSTER, ('fixed', 'base_link', 'mast', '0 0 0.5', '0 0 0'),
          ('fixed', 'mast', 'lamp', '0 0.5 0', '0.1 0.2 0.3'),
          ('fixed', 'footprint', 'base_link', '0 0 2', '0 0 0'),
          ('revolute', 'mast', 'arm', '0 0 1', '0 0 0'),
          ('fixed', 'arm', 'hand', '1 0 0', '0 0 0'),
          ('continuous', 'mast', 'propeller', '0 0.2 0.1', '0.4 -0.1 0.3', '1 2 2'))


def robot(*joints, body='base_link', origin=SHIFT, loose=(), inertials=None):
    """
    Return a URDF with joints, given as type, parent, child, xyz, rpy and optionally axis.

    `inertials` contains the text of an <inertial> for each link that has one; by default, the body
    has one with this origin.
    """
    names = dict.fromkeys([body, *(name for joint in joints for name in joint[1:3]), *loose])
    inertials = inertials or {body: (
        f'<inertial><origin{origin}/><mass value="2"/><inertia ixx="0.05" iyy="0.12" '
        'izz="0.14" ixy="0.002" ixz="0" iyz="0"/></inertial>')}
    links = [f'<link name="{name}">{inertials.get(name, "")}</link>' for name in names]
    parts = [f'<joint name="to_{child}" type="{kind}"><parent link="{parent}"/>'
             f'<child link="{child}"/><origin xyz="{xyz}" rpy="{rpy}"/>'
             + ''.join(f'<axis xyz="{xyz}"/>' for xyz in axis) + '</joint>'
             for kind, parent, child, xyz, rpy, *axis in joints]
    return '<robot name="it">' + ''.join(links + parts) + '</robot>'


def text(numbers):
    return ' '.join(map(repr, np.asarray(numbers, float).tolist()))


def tree(random, kinds):
    """Return joints of these kinds between random links, and each link's axes and position."""
    joints, places = [], {'l0': (Rotation.identity(), np.zeros(3))}
    for child, kind in enumerate(kinds, 1):
        parent = f'l{random.integers(child)}'
        shift, angles = random.normal(size=3), random.uniform(-7.0, 7.0, 3)
        joints.append((kind, parent, f'l{child}', text(shift), text(angles)))
        turn, place = places[parent]
        places[f'l{child}'] = turn * Rotation.from_euler('xyz', angles), place + turn.apply(shift)
    return joints, places


#: The arm and the hand can move, and the label is not attached.
ROBOT = robot(*JOINTS, loose=['label'])


def wrenches(count, frames=('base_link', 'world', '', 'thruster', 'mast', 'lamp', 'footprint',
                            'propeller')):
    """Return small random wrenches in several frames, some without a force."""
    sent = bags.torques(count, frames)
    sent.values[:] = np.random.default_rng(3).normal(size=(count, 6)) * 1e-3
    sent.values[::5, :3] = 0.0
    turning = np.array(sent.frame_ids) == 'propeller'
    along = np.repeat(sent.values[turning][:, [0, 3]], 3, axis=1)
    sent.values[turning] = along * [1.0, 2.0, 2.0, 1.0, 2.0, 2.0]
    return sent


def converted(sent):
    """Convert wrenches to torques about the centre of mass, in body or in space axes."""
    frames = urdf.fixed_frames(ROBOT)
    values = np.zeros_like(sent.values)
    for row, frame_id, wrench in zip(values, sent.frame_ids, sent.values):
        row[3:] = wrench[3:] if frame_id == 'world' else \
            frames[frame_id or 'base_link'].torque(wrench[:3], wrench[3:])
    frame_ids = ['world' if name == 'world' else 'base_link' for name in sent.frame_ids]
    return bags.Torques(sent.stamps_ns, frame_ids, values)
