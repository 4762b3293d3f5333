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

"""Euler angles: all sequences, compared with their definition."""

from decimal import Decimal, localcontext
from itertools import product

import numpy as np
import pytest
from rigid_body_ros.mechanics import euler, so3
from scipy.spatial.transform import Rotation

EPS = np.finfo(float).eps
PROPER = ('XYX', 'XZX', 'YXY', 'YZY', 'ZXZ', 'ZYZ')
TAIT_BRYAN = ('XYZ', 'XZY', 'YXZ', 'YZX', 'ZXY', 'ZYX')
INTRINSIC = PROPER + TAIT_BRYAN
ALL = INTRINSIC + tuple(name.lower() for name in INTRINSIC)
#: Larger if long double has no more digits than double, because `turned` also rounds then.
ROUND_TRIP = 1e-15 if np.finfo(np.longdouble).eps < EPS else 2e-15
RANDOM = np.random.default_rng(313)
Q = so3.normalize(RANDOM.normal(size=(500, 4)))
W = RANDOM.normal(size=(500, 3))
#: Rotations of every axis to every other and halfway between, with zeros of both signs.
LATTICE = np.array([q for q in product((-1.0, -0.5, -0.0, 0.0, 0.5, 1.0), repeat=4) if any(q)])


def poles(sequence):
    return (0.0, np.pi) if sequence.upper() in PROPER else (-np.pi / 2, np.pi / 2)


def near_poles(sequence, outer=20):
    """Return attitudes at and close to the two poles of a sequence."""
    offsets = np.array([0.0, 5e-324, 1e-200, 1e-18, 1e-16, 1e-15, 1e-12, 1e-9, 1e-7, 1e-4, 1e-3])
    angles = [(a, pole + side * offset, c) for a, c in RANDOM.uniform(-3, 3, (outer, 2))
              for pole, side in zip(poles(sequence), (1, -1)) for offset in offsets]
    return euler.to_quaternion(angles, sequence)


def at_edges(sequence):
    """Return attitudes whose outer angles lie around the ends of their domain."""
    low, high = poles(sequence)
    ends = [end + nudge for end in (0.0, np.pi, -np.pi)
            for nudge in (0.0, 1e-17, -1e-17, 3e-16, -3e-16, 5e-16, -5e-16, 9e-16, -9e-16)]
    return euler.to_quaternion([*product(ends, np.linspace(low, high, 9), [*ends, 2.0])], sequence)


def hamilton(p, q):
    """Return Hamilton's product, with the numeric type of the factors."""
    (px, py, pz, pw), (qx, qy, qz, qw) = p, q
    return (pw * qx + px * qw + py * qz - pz * qy, pw * qy + py * qw + pz * qx - px * qz,
            pw * qz + pz * qw + px * qy - py * qx, pw * qw - px * qx - py * qy - pz * qz)


def turned(p, q):
    """Return the angle, rad, between attitudes of any norm, in extended precision if possible."""
    x, y, z, w = hamilton(so3.conjugate(p).T.astype(np.longdouble), q.T)
    return 2.0 * np.arctan2(np.sqrt(x * x + y * y + z * z), np.abs(w)).astype(float)


def exact_quaternion(angles, sequence):
    """Return the product of the three rotations, each from a power series, with 40 digits."""
    turns = []
    for letter, angle in zip(sequence.lower(), angles):
        half, terms = Decimal(angle) / 2, [Decimal(1)]
        while abs(terms[-1]) > Decimal('1e-40') or len(terms) < 4:
            terms.append(terms[-1] * half / len(terms))
        sine, cosine = sum(terms[1::4]) - sum(terms[3::4]), sum(terms[::4]) - sum(terms[2::4])
        turns.append([*(sine * (letter == axis) for axis in 'xyz'), cosine])
    first, second, third = turns if sequence.isupper() else turns[::-1]
    return hamilton(hamilton(first, second), third)


def test_313_is_space_z_then_line_of_nodes_then_body_z():
    phi, theta, psi = 0.3, 1.1, -0.7
    about_z, about_x = so3.exp([0, 0, phi]), so3.exp([theta, 0, 0])
    expected = so3.multiply(so3.multiply(about_z, about_x), so3.exp([0, 0, psi]))
    np.testing.assert_allclose(euler.to_quaternion([phi, theta, psi]), expected, rtol=0, atol=EPS)


@pytest.mark.parametrize('sequence', ALL)
def test_the_attitude_of_given_angles_is_rounded_once(sequence):
    angles = [*RANDOM.uniform(-7.0, 7.0, (30, 3)), *RANDOM.uniform(-2e-9, 2e-9, (5, 3)),
              *product((0.0, 2.0 * np.pi), poles(sequence), (-np.pi / 2, 3.0))]
    with localcontext() as context:
        context.prec = 50
        apart = [float(Decimal(ours) - exact) for triple in angles for ours, exact in
                 zip(euler.to_quaternion(triple, sequence), exact_quaternion(triple, sequence))]
    assert np.abs(apart).max() < EPS / 4 * 1.001


@pytest.mark.slow
@pytest.mark.parametrize('sequence', ALL)
def test_round_trip_keeps_the_attitude_everywhere(sequence):
    attitudes = np.concatenate([so3.normalize(RANDOM.normal(size=(10_000, 4))), LATTICE,
                                near_poles(sequence, outer=100), at_edges(sequence)])
    back = euler.to_quaternion(euler.from_quaternion(attitudes, sequence), sequence)
    assert turned(back, attitudes).max() < ROUND_TRIP


@pytest.mark.parametrize('sequence', ALL)
def test_angles_are_scipys_and_lie_in_their_domains(sequence):
    np.testing.assert_array_equal(euler.from_quaternion(LATTICE, sequence),
                                  euler.from_quaternion(LATTICE + 0.0, sequence))
    angles, theirs = euler.from_quaternion(Q, sequence), Rotation.from_quat(Q).as_euler(sequence)
    np.testing.assert_array_equal(euler.from_quaternion(-Q, sequence), angles)
    attitude = euler.to_quaternion(theirs, sequence)
    np.testing.assert_allclose(np.abs(np.sum(attitude * Q, axis=1)), 1.0, rtol=0, atol=8 * EPS)
    first, middle, third = euler.from_quaternion(np.concatenate(
        [Q, LATTICE, near_poles(sequence), at_edges(sequence)]), sequence).T
    is_proper, (low, high) = sequence.upper() in PROPER, poles(sequence)
    for outer in (first, third):
        assert np.all(outer >= 0.0 if is_proper else outer > -np.pi)
        assert np.all(outer < 2.0 * np.pi if is_proper else outer <= np.pi)
        assert not np.signbit(outer[outer == 0.0]).any()
    assert low <= middle.min() <= middle.max() <= high
    identity = euler.to_quaternion([0.0, 0.0, 0.0], sequence)
    np.testing.assert_array_equal(identity, [0.0, 0.0, 0.0, 1.0])
    assert not np.signbit(identity).any()


def test_just_below_zero_an_angle_goes_to_the_nearer_end_of_the_domain():
    # The last double below 2 pi is 1.13e-15 from zero.
    half = 0.5 * np.array([1e-17, 3e-16, 8e-16, 1.1e-15])
    attitudes = np.stack([np.cos(half), -np.sin(half), -np.sin(half), np.cos(half)], axis=-1)
    last = np.nextafter(2.0 * np.pi, 0.0)
    np.testing.assert_array_equal(euler.from_quaternion(attitudes)[:, 0], [0.0, 0.0, last, last])


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_at_theta_zero_the_sum_is_kept_and_split_evenly(sign):
    q = sign * so3.exp([0.0, 0.0, 1.2])
    np.testing.assert_allclose(np.mod(euler.from_quaternion(q), np.pi), [0.6, 0.0, 0.6],
                               rtol=0, atol=4 * EPS)
    np.testing.assert_allclose(euler.from_quaternion(so3.exp([-0.0, -0.0, 1.2])), [0.6, 0, 0.6])


def test_at_theta_pi_the_difference_is_kept_and_split_evenly():
    phi, theta, psi = euler.from_quaternion([np.cos(0.4), np.sin(0.4), 0.0, 0.0])
    assert theta == np.pi
    np.testing.assert_allclose([phi, psi], [0.4, 2.0 * np.pi - 0.4], rtol=EPS)


def test_degenerate_marks_the_poles():
    angles = [[1.0, 0.0, 2.0], [1.0, 9e-8, 2.0], [1.0, 1.1e-7, 2.0], [1.0, np.pi, 2.0]]
    assert euler.degenerate(angles).tolist() == [True, True, False, True]
    assert euler.degenerate([[0.0, np.pi / 2, 0.0], [0.0, 0.0, 0.0]], 'ZYX').tolist() == [
        True, False]


@pytest.mark.parametrize('sequence', ALL)
def test_rates_grow_large_only_where_degenerate_says_so(sequence):
    angles = euler.from_quaternion(near_poles(sequence), sequence)
    turning = RANDOM.normal(size=angles.shape)
    size = np.abs(euler.rates(angles, turning, sequence)).max(axis=1)
    marked = euler.degenerate(angles, sequence)
    assert np.all(np.isfinite(size))
    assert size[marked].max() > 1e7
    bound = 2.0 * np.linalg.norm(turning, axis=1) / euler.DEGENERATE
    assert np.all(marked | (size < bound))
    assert 0 < np.count_nonzero(marked) < len(marked)


@pytest.mark.parametrize('sequence', ALL)
def test_the_axes_are_one_of_space_the_line_of_nodes_and_one_of_the_body(sequence):
    angles = euler.from_quaternion(Q, sequence)
    axes = np.moveaxis(euler.rotation_axes(angles, sequence), -2, 0)
    named = np.eye(3)[['xyz'.index(letter) for letter in sequence.lower()]]
    if sequence.islower():
        axes, named = axes[::-1], named[::-1]
    (of_space, node, of_body), (first, _, last) = axes, named
    np.testing.assert_allclose(of_space, so3.rotate(so3.conjugate(Q), first), rtol=0, atol=8 * EPS)
    np.testing.assert_array_equal(of_body, np.broadcast_to(last, of_body.shape))
    for other, size in ((of_space, 0.0), (of_body, 0.0), (node, 1.0)):
        np.testing.assert_allclose(np.sum(node * other, axis=1), size, rtol=0, atol=8 * EPS)


@pytest.mark.parametrize('sequence', ALL)
def test_rates_are_the_time_derivative_of_the_angles_and_undone_by_their_inverse(sequence):
    h = 1e-4
    angles = euler.from_quaternion(Q, sequence)
    rates = euler.rates(angles, W, sequence)
    away = np.abs(np.sin(angles[:, 1] + (
        0.0 if sequence.upper() in PROPER else np.pi / 2))) > 0.2
    before, after = (euler.from_quaternion(so3.multiply(Q, so3.exp(t * W)), sequence)
                     for t in (-h, h))
    change = np.remainder(after - before + np.pi, 2 * np.pi) - np.pi
    np.testing.assert_allclose(change[away] / (2 * h), rates[away], rtol=1e-4, atol=1e-5)
    back = euler.angular_velocity(angles, rates, sequence)
    assert (np.linalg.norm(back - W, axis=1) / np.linalg.norm(rates, axis=1)).max() < 8 * EPS
    for middle in poles(sequence):  # where rates are finite, and keep what is determined
        angles = np.array([0.3, middle, 0.8])
        axes = euler.rotation_axes(angles, sequence)
        turning = 0.7 * axes[0] + 0.2 * axes[1]
        rates = euler.rates(angles, turning, sequence)
        np.testing.assert_allclose(euler.angular_velocity(angles, rates, sequence), turning,
                                   rtol=0, atol=1e-15)


def test_rates_are_finite_close_to_a_pole_and_split_evenly_there():
    for theta in (0.0, 5e-324, 1e-320, 1e-300, 1e-200):
        assert np.all(np.isfinite(euler.rates([0.0, theta, 0.0], [1e6, 1e6, 0.0])))
    rates = euler.rates([0.3, 0.0, 0.5], [0.1, 0.2, 1.4])
    np.testing.assert_allclose(rates, [0.7, 0.1 * np.cos(0.5) - 0.2 * np.sin(0.5), 0.7],
                               rtol=0, atol=EPS)


@pytest.mark.parametrize('sequence', ALL)
def test_unwrapped_angles_name_the_same_attitudes_without_jumps(sequence):
    times = np.linspace(0.0, 20.0, 4001)[:, None]
    attitude = so3.multiply(so3.exp(times * [0.9, 0.3, -0.2]), so3.exp(times * [0.1, -0.4, 1.1]))
    angles = euler.unwrap(euler.from_quaternion(attitude, sequence), sequence)
    assert so3.angle_between(euler.to_quaternion(angles, sequence), attitude).max() < 1e-14
    assert np.abs(np.diff(angles, axis=0)).max() < 0.5
    assert euler.unwrap(np.zeros((0, 3)), sequence).shape == (0, 3)


@pytest.mark.parametrize('sequence', ALL)
@pytest.mark.parametrize('start', [0.0, 1e-3])
def test_unwrapped_angles_go_through_both_poles_and_around(sequence, start):
    # With and without samples at the poles.
    middle = start + np.arange(-500, 501) * (np.pi / 100)
    given = np.stack([0 * middle + 0.8, middle, 0 * middle - 2.1], axis=1)
    attitude = euler.to_quaternion(given, sequence)
    angles = euler.unwrap(euler.from_quaternion(attitude, sequence), sequence)
    sense = np.sign(angles[1, 1] - angles[0, 1])
    off = np.abs(angles - angles[0] - (given - given[0]) * [1.0, sense, 1.0])
    # The closer to a pole, the less a rounded attitude determines the outer angles.
    noise = np.minimum(0.5, 8 * EPS / np.maximum(EPS, np.abs(np.sin(2 * middle))))
    assert np.all(off[:, 1] < 32 * EPS)
    assert np.all(off[:, ::2] < noise[:, None] + 32 * EPS)
    assert turned(euler.to_quaternion(angles, sequence), attitude).max() < 32 * EPS


@pytest.mark.parametrize('sequence', ALL)
def test_at_a_pole_the_neighbouring_sample_tells_what_is_left_open(sequence):
    middle = np.mean(poles(sequence))
    for pole in poles(sequence):
        beside, at_pole = np.array([[0.8, 0.9 * pole + 0.1 * middle, -2.1], [0.8, pole, -2.1]])
        attitude = euler.to_quaternion(at_pole, sequence)
        alike = next(angles for angles in at_pole + np.array([[0.7, 0, 0.7], [0.7, 0, -0.7]])
                     if turned(euler.to_quaternion(angles, sequence), attitude) < 4 * EPS)
        for forth in (1, -1):
            angles = euler.unwrap([beside, alike][::forth], sequence)[::forth]
            np.testing.assert_allclose(angles, [beside, at_pole], rtol=0, atol=4 * EPS)


@pytest.mark.parametrize('name', ['', 'ZX', 'ZZX', 'XZZ', 'ZxZ', 'ABC', 'ZXZX'])
def test_unknown_sequences_are_named(name):
    with pytest.raises(ValueError, match=f"Euler sequence: .* found '{name}'"):
        euler.from_quaternion([0, 0, 0, 1], name)


@pytest.mark.parametrize('sequence', ['ZXZ', 'ZYX', 'xyz'])
@pytest.mark.parametrize('power', [-1000, -700, 700, 1020])
def test_the_norm_of_a_quaternion_does_not_matter(sequence, power):
    scaled = Q / 2.0 * 2.0 ** power
    np.testing.assert_array_equal(euler.from_quaternion(scaled, sequence),
                                  euler.from_quaternion(Q, sequence))


@pytest.mark.parametrize('q', [[0.0, 0.0, 0.0, 0.0], [np.nan, 0.0, 0.0, 1.0],
                               [0.0, np.inf, 0.0, 1.0], [np.inf, 0.0, 0.0, -np.inf]])
def test_what_is_not_an_attitude_has_no_angles(q):
    assert np.isnan(euler.from_quaternion(q)).all()
    assert np.isnan(euler.from_quaternion([Q[0], q], 'ZYX')[1]).all()


def test_an_angle_next_to_a_pole_keeps_its_digits():
    half = 10.0 ** RANDOM.uniform(-300, -10, 50)
    attitude = np.stack([half, 0.5 * half, 0 * half + 0.6, 0 * half + 0.8], axis=1)
    np.testing.assert_allclose(euler.from_quaternion(attitude)[:, 1],
                               2.0 * np.sqrt(1.25) * half, rtol=4 * EPS)


def test_arrays_of_any_layout_are_converted():
    attitude = np.asfortranarray(Q.reshape(5, 100, 4))
    attitude.flags.writeable = False
    angles = euler.from_quaternion(attitude[:, ::2], 'xyz')
    assert angles.shape == (5, 50, 3)
    np.testing.assert_array_equal(angles[1, 2], euler.from_quaternion(Q[104], 'xyz'))
    np.testing.assert_array_equal(euler.to_quaternion(angles[:, ::-1], 'xyz')[1, 47],
                                  euler.to_quaternion(angles[1, 2], 'xyz'))
