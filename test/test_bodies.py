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

"""One body and many have the bits of exact arithmetic, and the same errors."""

import numpy as np
import pytest
from rigid_body_ros import RigidBodies, RigidBody
from rigid_body_ros.kernels import body_layout
from rigid_body_ros.kernels import tensor as exact

COUNT = 40
RANDOM = np.random.default_rng(31)


def turned(moments):
    """Return tensors with principal axes in random directions."""
    axes = np.stack([np.linalg.qr(one)[0] for one in RANDOM.normal(size=(len(moments), 3, 3))])
    return (axes * moments[:, None]) @ axes.transpose(0, 2, 1)


def turned_about_one_axis(moments):
    """Return tensors with one principal axis that is a body axis: x, y and z in turn."""
    angles = RANDOM.uniform(0.0, 2.0 * np.pi, len(moments))
    axes = np.array([[np.cos(angles), -np.sin(angles)], [np.sin(angles), np.cos(angles)]])
    axes, tensors = axes.transpose(2, 0, 1), diagonal(moments)
    tensors[:, :2, :2] = (axes * moments[:, None, :2]) @ axes.transpose(0, 2, 1)
    return np.array([np.roll(tensor, row % 3, axis=(0, 1)) for row, tensor in enumerate(tensors)])


def diagonal(moments):
    return np.where(np.eye(3, dtype=bool), moments[:, :, None], 0.0)


def ordinary():
    """Return the moments of random bodies of any size."""
    squares = RANDOM.uniform(0.02, 1.0, (COUNT, 3))
    sizes = 10.0 ** RANDOM.uniform(-12, 12, (COUNT, 1))
    return sizes * (squares.sum(axis=1, keepdims=True) - squares)


def about(moments, spread):
    return np.array(moments) * (1.0 + spread * RANDOM.normal(size=(COUNT, 3)))


def rod(moments):
    """Return moments of thin rods, in which two moments differ by no more than the smallest."""
    moments[:, 2] = moments[:, 1] + 0.5 * moments[:, 0]
    return moments


def symmetric_with(entries):
    return entries + entries.transpose(0, 2, 1)


BODIES = {
    'diagonal': diagonal(ordinary()),
    'full': turned(ordinary()),
    'one axis': turned_about_one_axis(ordinary()),
    'rods': turned(rod(about([1e-6, 1.0, 1.0], 1e-3))),
    'diagonal rods': diagonal(rod(about([1e-20, 1.0, 1.0], 1e-3))),
    'plates': turned(about([1.0, 1.5, 2.5], 1e-9)),
    'symmetric tops': turned(np.tile([1.0, 1.0, 1.5], (COUNT, 1))),
    'diagonal symmetric tops': diagonal(np.tile([1.5, 1.0, 1.5], (COUNT, 1))),
    'spheres': turned(about([1.0, 1.0, 1.0], 0.0)),
    'near spheres': turned(about([1.0, 1.0, 1.0], 10.0 ** RANDOM.uniform(-16, -2, (COUNT, 1)))),
    'almost diagonal': diagonal(about([1.0, 1.5, 2.0], 0.1)) + symmetric_with(
        10.0 ** RANDOM.uniform(-40, -1, (COUNT, 1, 1)) * RANDOM.normal(size=(COUNT, 3, 3))),
    'short numbers': diagonal(RANDOM.integers(6, 12, (COUNT, 3)) / 10.0),
    'integers': symmetric_with(RANDOM.integers(-2, 3, (COUNT, 3, 3)).astype(float))
    + diagonal(RANDOM.integers(6, 12, (COUNT, 3)).astype(float)),
    'signed zeros': np.array([np.diag([1.0, 2.0, 2.5]) * sign for sign in np.where(
        RANDOM.integers(0, 2, (COUNT, 3, 3)) | np.eye(3, dtype=int), 1.0, -1.0)]),
    'exact quotients': np.array([[[5.0, 2.0, 0.0], [2.0, 4.0, 0.0], [0.0, 0.0, moment]]
                                 for moment in RANDOM.uniform(4.2, 8.9, COUNT)]),
    # After the first rotation, the difference of two moments is zero or a rounding error.
    'ambiguous rotations': np.array([
        [[3.0 + a, 0.5 + b, x], [0.5 + b, 3.0 + a, -y], [x, -y, 2.5 + a - b]]
        for a, b, x, y in RANDOM.integers(1, 32, (COUNT, 4)) / 64.0]),
    'half components': np.array([[[3.0, 1.0, x], [1.0, 3.0, x], [x, x, 4.0]]
                                 for x in RANDOM.uniform(0.1, 0.9, COUNT)]),
    'extreme': turned(ordinary()) * 10.0 ** RANDOM.uniform(-300, 290, (COUNT, 1, 1)),
    'invalid': RANDOM.normal(size=(COUNT, 3, 3)) * RANDOM.choice(
        [1.0, 1e-13, 1e-11, np.inf, np.nan], (COUNT, 3, 3)) + diagonal(ordinary()),
    'impossible': diagonal(RANDOM.uniform(-0.1, 1.0, (COUNT, 3))),
}
DAMPING = {
    'full': turned(RANDOM.uniform(0.0, 1.0, (COUNT, 3))),
    'singular': turned(np.tile([0.0, 0.0, 1.0], (COUNT, 1))),
    'diagonal': diagonal(RANDOM.uniform(-0.02, 1.0, (COUNT, 3))),
    'strong': diagonal(10.0 ** RANDOM.uniform(8, 10, (COUNT, 3))),
    'asymmetric': diagonal(np.ones((COUNT, 3))) + RANDOM.choice([1e-13, 1e-11], (COUNT, 3, 3)),
    'extreme': diagonal(10.0 ** RANDOM.uniform(-300, 300, (COUNT, 3))),
    'not finite': diagonal(RANDOM.choice([1.0, np.inf, np.nan], (COUNT, 3))),
}


def alone(tensor, damping=None):
    """Return the constants of one body in exact arithmetic as text, or its error."""
    try:
        body = RigidBody(tensor, damping)
    except ValueError as error:
        return str(error)
    drag = exact.damping_coefficients(body.inertia, body.damping) if body.is_damped \
        else np.zeros((2, 3, 3))
    constants = body_layout.pack(exact.euler_coefficients(body.inertia),
                                 *exact.principal(body.inertia), drag)
    np.testing.assert_array_equal(body._constants.view(np.int64), constants.view(np.int64))
    return constants.tobytes().hex()


def rows(bodies):
    return [message or constants.tobytes().hex()
            for message, constants in zip(bodies.messages, bodies._constants)]


@pytest.mark.slow
@pytest.mark.parametrize('name', BODIES)
def test_many_bodies_have_the_bits_and_the_errors_of_one(name):
    inertia = BODIES[name]
    assert rows(RigidBodies(inertia)) == [*map(alone, inertia)]


@pytest.mark.slow
@pytest.mark.parametrize('name', DAMPING)
@pytest.mark.parametrize('inertia', ['diagonal', 'full'])
def test_damped_bodies_have_the_bits_and_the_errors_of_one(inertia, name):
    inertia, damping = BODIES[inertia], DAMPING[name]
    with np.errstate(over='ignore', invalid='ignore'):
        size = np.ones(COUNT) if name == 'extreme' else np.abs(inertia).max(axis=(1, 2))
        damping = damping * size[:, None, None]
    assert rows(RigidBodies(inertia, damping)) == [*map(alone, inertia, damping)]


def test_one_damping_is_that_of_all():
    inertia, damping = BODIES['full'], np.diag([1e-30, 0.0, 1e-20])
    assert rows(RigidBodies(inertia, damping)) == [alone(tensor, damping) for tensor in inertia]
