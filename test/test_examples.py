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

"""The examples, run as by a user, compared with formulas, the truth and the commands."""

import re
import subprocess
import sys

from conftest import ROOT
import intermediate_axis
from mpmath import mp
import numpy as np
import plan_slew
import pytest
from rigid_body_ros import Problem, propagate, RigidBody, State, TorqueLog
from rigid_body_ros.autodiff import vjp

pytestmark = pytest.mark.slow
NUMBER = r'(?<!\w)[-+]?\d+\.?\d*(?:e[-+]?\d+)?'


def started(folder, name, *arguments):
    return subprocess.run([sys.executable, '-W', 'error', ROOT / 'examples' / f'{name}.py',
                           *arguments], cwd=folder, capture_output=True, text=True, check=False)


def printed(folder, name, *arguments):
    """Run an example, and return the lines that it prints, by their labels."""
    result = started(folder, name, *arguments)
    assert (result.returncode, result.stderr) == (0, '')
    return dict(re.split('  +', line.strip(), maxsplit=1) for line in result.stdout.splitlines())


def numbers(text):
    return [float(number) for number in re.findall(NUMBER, text)]


def textbook(moments, rates):
    """Return 2 K(k) / lambda, s, from Landau and Lifshitz (Mechanics, section 37)."""
    with mp.workdps(40):
        low, middle, high = (mp.mpf(moment) for moment in moments)
        rates = [mp.mpf(rate) for rate in rates]
        energy = low * rates[0] ** 2 + middle * rates[1] ** 2 + high * rates[2] ** 2
        square = (low * rates[0]) ** 2 + (middle * rates[1]) ** 2 + (high * rates[2]) ** 2
        if square < energy * middle:
            low, high = high, low
        one = (high - middle) * (square - energy * low)
        modulus = (middle - low) * (energy * high - square) / one
        return float(2 * mp.ellipk(modulus) * mp.sqrt(low * middle * high / one))


def test_the_wing_nut_flips_as_often_as_the_formula_says(tmp_path):
    lines = printed(tmp_path, 'intermediate_axis')
    flips = numbers(lines['flips at'])
    known = textbook(intermediate_axis.wing_nut().principal_moments, intermediate_axis.RATES)
    assert len(flips) >= 4
    np.testing.assert_allclose(np.diff(flips), known, atol=2e-3)
    for found in ('time between flips', 'textbook'):
        assert numbers(lines[found])[0] == pytest.approx(known, rel=1e-14, abs=0.0)
    assert numbers(lines['relative difference'])[0] < 1e-14


@pytest.mark.parametrize('rates', [(0.0, 6.0, 0.05), (0.05, 6.0, 0.0), (-0.3, -5.0, 0.7)])
@pytest.mark.parametrize('moments', [(4.06e-7, 1.65e-6, 1.756e-6), (1e-6, 1.2e-6, 2.1e-6)])
def test_flips_take_the_same_time_on_both_sides_of_the_separatrix(moments, rates):
    begin = State(angular_velocity=rates)
    motion = propagate(RigidBody.from_moments(*moments), begin, at=[intermediate_axis.END_NS])
    flips = intermediate_axis.flip_times(motion)
    known = textbook(moments, rates)
    np.testing.assert_allclose(np.diff(flips), known, rtol=1e-12)
    formula = intermediate_axis.textbook_time(np.array(moments), rates)
    assert formula == pytest.approx(known, rel=1e-14, abs=0.0)


def test_the_planned_slew_ends_at_rest_at_the_target(tmp_path):
    lines = printed(tmp_path, 'plan_slew')
    assert numbers(lines['attitude error'])[0] < 1e-9
    assert numbers(lines['rate at the end'])[0] < 1e-12
    assert numbers(lines['motions computed'])[0] < 50


def test_no_slew_near_the_planned_one_takes_less_effort():
    torques, _ = plan_slew.plan(plan_slew.SATELLITE, plan_slew.TARGET)
    size = np.abs(torques).max()
    problem = Problem(plan_slew.SATELLITE, State(), TorqueLog(plan_slew.STAMPS_NS, torques))
    _, pull = vjp(problem, {'torques': torques}, at=[plan_slew.END_NS])
    slopes = [pull(one[None, :4], one[None, 4:])['torques'].ravel() for one in np.eye(7)]
    # Lagrange: the gradient of the effort is a combination of those of the state at the end.
    factors, *_ = np.linalg.lstsq(np.transpose(slopes), torques.ravel(), rcond=None)
    np.testing.assert_allclose(factors @ slopes, torques.ravel(), atol=1e-5 * size)


def test_a_slew_of_a_sphere_takes_the_effort_of_the_formula():
    moment, angle, seconds, count = 0.1, np.radians(120.0), 30.0, plan_slew.COUNT
    torques, _ = plan_slew.plan(RigidBody(moment * np.eye(3)), plan_slew.TARGET)
    # With held torques, those of the linear law of a double integrator cost n^2 / (n^2 - 1) more.
    known = 12.0 * (moment * angle) ** 2 / seconds ** 3 * count ** 2 / (count ** 2 - 1)
    assert np.sum(torques ** 2) * seconds / count == pytest.approx(known, rel=1e-10)


def test_torch_fits_the_inertia_to_the_noise(tmp_path):
    pytest.importorskip('torch', reason='PyTorch (torch) is not installed')
    lines = printed(tmp_path, 'fit_inertia_torch')
    assert numbers(lines['largest error, fitted'])[0] < 1e-4
    assert numbers(lines['mean square misfit'])[0] == pytest.approx(1.0, abs=0.3)
