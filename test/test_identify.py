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

"""Identify a body from measured motions: values, uncertainties, and what is undetermined."""

from dataclasses import dataclass, field, replace
from functools import cache
import json

from conftest import at_night
import numpy as np
import pytest
from rigid_body_ros import Actuator, EffortLog, RigidBody, State, TorqueLog, UniformField, Wheel
from rigid_body_ros.identification import Identification, identify
from rigid_body_ros.inference.fit import errors_of
from rigid_body_ros.inference.setup import channels_of, setup_of
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.states import Poses
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.recording.observed import Measurements
from rigid_body_ros.scene.quantities import components_of
from tumbling import INERTIA, mounted, SECOND, shifted, Truth, with_outliers

GUESS, TRUE = RigidBody(np.diag([0.03, 0.03, 0.03])), RigidBody(INERTIA)
ATTITUDE, RATE = 2e-3, 5e-3
INERTIA_NAMES = [f'inertia.i{entry}' for entry in ('xx', 'yy', 'zz', 'xy', 'xz', 'yz')]
ENTRIES = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
VECTOR, BIAS = np.array([0.12, -0.13, 0.09]), np.array([0.002, -0.001, 0.003])
DAMPING = np.array([[2e-3, 3e-4, 0.0], [3e-4, 1e-3, 0.0], [0.0, 0.0, 3e-3]])
#: A weight about a pivot, the guess that a fit starts from, and a motion.
MOMENT, GRAVITY = (0.002, -0.003, -0.02), (0.0, 0.0, -9.81)
PIVOT, NEAR = UniformField(MOMENT, GRAVITY), UniformField((0.0, 0.0, -0.01), GRAVITY, 'pivot')
WEIGHT = {'options': {'fields': [PIVOT]}}
#: A free body whose flywheel spins up.
FLYWHEEL = {'seconds': 6.0, 'amplitude': 0.0, 'measured_hz': 100, 'momentum': np.outer(
    0.05 * np.clip(np.arange(61) / 10 - 1.0, 0.0, 3.0) / 3.0, [0.6, 0.5, 0.6])}
#: A free body with wheels, whose momenta depend on the initial rate.
WHEELS = {'seconds': 20.0, 'amplitude': 0.0, 'options': {
    'wheels': [Wheel('x', (1.0, 0.0, 0.0), 2e-3, initial_speed=20.0, max_torque=0.02),
               Wheel('y', (0.0, 1.0, 0.0), 2e-3, initial_speed=-10.0),
               Wheel('skewed', (1.0, 1.0, 1.0), 1e-3)],
    'efforts': EffortLog(SECOND // 5 * np.arange(100), 0.03 * np.sin(
        np.outer(0.2 * np.arange(100), [0.7, 1.1, 1.7]) + np.arange(3.0)))}}


@cache
def tumble(seconds=10.0):
    return Truth(seconds)


def noisy(seed=0, **options):
    return tumble().measured(ATTITUDE, RATE, seed, **options)


def inertia_error(result, inertia=INERTIA):
    return np.abs(result.body.inertia - inertia).max() / inertia.max()


def inertia_truth(inertia=INERTIA):
    return dict(zip(INERTIA_NAMES, inertia[ENTRIES]))


def assert_covered(result, truth, width=4.0):
    for name, value in truth.items():
        one = result.estimates[name]
        assert one.identifiable
        assert abs(one.value - value) < width * one.sigma, name


@dataclass(frozen=True)
class Case:
    """A fit: what is estimated, the motion, the true values beside the inertia, and the rest."""

    estimate: str
    motion: dict = field(default_factory=dict)
    values: dict = field(default_factory=dict)
    guess: RigidBody = GUESS
    #: Turn a motion and the noise of attitudes and rates into measurements.
    sensors: object = lambda motion, attitude, rate: [motion.measured(attitude, rate)]
    experiment: dict = field(default_factory=dict)
    options: dict = field(default_factory=dict)

    def result(self, attitude, rate):
        """Return the result for noise of attitudes and of rates, and the motion."""
        motion = Truth(**{'seconds': 6.0, **self.motion}) if self.motion else tumble()
        given = motion.experiment(*self.sensors(motion, attitude, rate))
        return identify(self.guess, replace(given, **self.experiment),
                        estimate=self.estimate.split(), **self.options), motion

    @property
    def truth(self):
        """Return the true values of the components that are estimated."""
        found = inertia_truth(self.motion.get('inertia', INERTIA)) \
            if 'inertia' in self.estimate.split() else {}
        for name, value in self.values.items():
            found.update(zip(components_of(name), np.ravel(value).tolist(), strict=True))
        return found


def biased(motion, _, rate):
    gyro = motion.measured(None, rate)
    return [replace(gyro, angular_velocity=gyro.angular_velocity + 10.0 * BIAS)]


#: Fits that are exact without noise; the guess of the start is that of the motion.
EXACT = {
    'a guess three times off': Case('inertia start', guess=RigidBody(
        3.0 * np.diag(np.diag(INERTIA)))),
    'attitudes': Case('inertia start', sensors=lambda motion, *_: [motion.measured(0.0, None)]),
    'rates': Case('inertia start', sensors=lambda motion, *_: [motion.measured(None, 0.0)]),
    'three moments': Case('inertia_diagonal start', guess=RigidBody(
        INERTIA + np.diag([0.01, 0.004, -0.01]))),
    'a turned sensor': Case('start mount', {'seconds': 5.0}, {'mount': VECTOR}, TRUE,
                            lambda motion, *_: [mounted(motion.measured(), VECTOR)]),
    'a flywheel without torque': Case('inertia start', FLYWHEEL),
    'a known weight without torque': Case('inertia start', {'amplitude': 0.0, **WEIGHT},
                                          experiment={'fields': [PIVOT]}),
    'the moment of a field': Case('inertia start pivot.moment', WEIGHT,
                                  {'pivot.moment': MOMENT},
                                  experiment={'fields': [NEAR]}),
    'a weight': Case('inertia start weight', WEIGHT, {'weight': MOMENT},
                     options={'gravity': GRAVITY}),
    'a log in space axes': Case('inertia start', {'frame': 'space'}),
    'wheels with names without torque': Case('inertia start', WHEELS,
                                             experiment={'start': State()}),
    'a lag': Case('start torque_lag', {'options': {'actuator': Actuator(time_constant=0.12)}},
                  {'torque_lag': 0.12}, TRUE),
    'a delay': Case('start torque_delay torque_gain', {'options': {'actuator': Actuator(0.03)}},
                    {'torque_delay': 0.03, 'torque_gain': 1.0}, TRUE),
    'a bias, which does not time out': Case(
        'start torque_bias', {'seconds': 2.0, 'amplitude': 0.0, 'bias': BIAS},
        {'torque_bias': BIAS}, TRUE, experiment={'log': None}, options={'torque_timeout': 0.03}),
    # As in NASA's check-case of a brick, which test_validation.py fits if its data is available.
    'a sphere, weak torque and few samples': Case('inertia start', {
        'seconds': 30.0, 'measured_hz': 10, 'amplitude': 2e-5, 'rates': (0.17, 0.35, 0.52),
        'attitude': (0.0, 0.0, 0.0, 1.0), 'inertia': np.diag([0.0019, 0.0062, 0.0072])},
        guess=RigidBody(0.005 * np.eye(3)))}


@pytest.mark.slow
@pytest.mark.parametrize('name', EXACT)
def test_a_fit_is_exact_without_noise(name):
    case = EXACT[name]
    result, motion = case.result(0.0, 0.0)
    assert result.converged
    assert result.unidentifiable == []
    assert inertia_error(result, motion.inertia) < 1e-11
    for component, value in case.truth.items():
        assert result.estimates[component].value == pytest.approx(
            value, rel=1e-10, abs=1e-9 if component == 'torque_delay' else  # whole nanoseconds
            1e-11 * motion.inertia.max())
    assert ('initial_attitude.x' in result.estimates) == (name != 'rates')
    assert result.training.samples > 0
    if name != 'rates':  # the result gives the motion again
        fields = result.fields or case.experiment.get('fields', ())
        again = motion.problem.replaced(body=result.body, start=result.starts[0], fields=fields)
        assert so3.angle_between(again.propagate(at=motion.stamps_ns).attitude,
                                 motion.q).max() < 1e-10


#: Fits of noisy measurements.
COVERED = {
    'gyro_bias': Case('inertia start gyro_bias', {}, {'gyro_bias': 10.0 * BIAS}, sensors=biased),
    'clock_offset of seconds': Case('inertia start clock_offset', {}, {
        'clock_offset': 1.5}, sensors=lambda motion, *noise: [
            shifted(motion.measured(*noise), 1.5)]),
    'torque_gain and torque_bias': Case('start torque_gain torque_bias', {
        'bias': BIAS, 'gain': 0.9}, {'torque_gain': 0.9, 'torque_bias': BIAS}, TRUE),
    'damping': Case('inertia start damping', {'damping': DAMPING}, {'damping': DAMPING[ENTRIES]}),
    'rotor_momentum': Case('start rotor_momentum', {
        'momentum': np.tile([0.0, 0.01, 0.02], (61, 1))}, {'rotor_momentum': (0.0, 0.01, 0.02)},
        TRUE, experiment={'start': State(0, (0.1, -0.2, 0.3, 0.9), (0.5, 1.0, 0.2)),
                          'wheels': None}),
    'a field': Case('pivot.moment inertia start', WEIGHT, {'pivot.moment': MOMENT},
                    experiment={'fields': [NEAR]})}


@pytest.mark.slow
@pytest.mark.parametrize('name', COVERED)
def test_intervals_cover_the_truth(name):
    result, _ = COVERED[name].result(ATTITUDE, RATE)
    assert result.unidentifiable == []
    assert_covered(result, COVERED[name].truth)
    if 'clock_offset' in result.estimates:
        assert result.estimates['clock_offset'].sigma < 1e-3
    if name == 'damping':
        assert np.linalg.eigvalsh(result.body.damping)[0] >= 0.0
    if name == 'rotor_momentum':
        np.testing.assert_allclose(result.starts[0].rotor_momentum, (0.0, 0.01, 0.02), atol=1e-4)
    if name == 'a field':
        assert [*result.estimates][:9] == [*INERTIA_NAMES, *components_of('pivot.moment')]
        assert {result.estimates[one].unit for one in components_of('pivot.moment')} == {
            'kg m or A m^2'}


@pytest.mark.slow
def test_the_start_is_fitted_from_a_wrong_one():
    wrong = State(0, (0.5, 0.1, 0.0, 1.0), (0.0, 0.0, 0.0))
    result = identify(GUESS, tumble().experiment(tumble().measured(), start=wrong))
    assert so3.angle_between(result.starts[0].attitude, tumble().start.attitude) < 1e-9
    np.testing.assert_allclose(result.starts[0].angular_velocity, tumble().rates, rtol=0,
                               atol=1e-9)
    turned = so3.log(so3.multiply(so3.conjugate(wrong.attitude), tumble().start.attitude))
    found = [result.estimates[f'initial_attitude.{axis}'].value for axis in 'xyz']
    np.testing.assert_allclose(found, turned, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_given_start_is_kept():
    result = identify(GUESS, tumble().experiment(noisy()), estimate=['inertia'])
    assert [*result.estimates] == INERTIA_NAMES
    assert result.starts[0].angular_velocity.tolist() == list(tumble().rates)
    assert_covered(result, inertia_truth())


@pytest.mark.slow
def test_noise_levels_intervals_and_outliers():
    # Many drivers fill in constant covariances, and a wrong constant would give a wrong interval.
    measured, bad = with_outliers(noisy(), 0.02)
    constant = np.tile(np.eye(3), (len(measured.stamps_ns), 1, 1))
    result = identify(GUESS, tumble().experiment(replace(
        measured, attitude_covariance=constant, rate_covariance=constant)), validate=0.3)
    assert_covered(result, inertia_truth())
    assert result.noise == pytest.approx({'/imu attitude': ATTITUDE,
                                          '/imu angular_velocity': RATE}, rel=0.05)
    for one in result.estimates.values():
        low, high = one.interval_95
        assert high - low == pytest.approx(2 * 1.96 * one.sigma, rel=1e-4)
    first, _, last, _ = result.residuals
    assert [one.is_training for one in result.residuals] == [True, True, False, False]
    stamps_ns = np.concatenate([first.stamps_ns, last.stamps_ns])
    assert stamps_ns.tolist() == measured.stamps_ns.tolist()
    among = bad[:len(first.stamps_ns)].sum()
    assert abs(np.sum(~first.inliers) - among) <= 1
    assert 2 * among - 2 <= result.training.outliers <= 2 * among + 2
    assert abs(first.autocorrelation) < 0.1


@pytest.mark.slow
def test_chi_square_with_given_noise():
    result = identify(GUESS, tumble().experiment(noisy()), attitude_noise=ATTITUDE,
                      rate_noise=RATE)
    assert 0.9 < result.training.chi2_per_dof < 1.1
    assert result.training.samples == 2 * len(tumble().stamps_ns)


@pytest.mark.slow
@pytest.mark.parametrize(('axes', 'name', 'reason'), [
    ((0.0, 0.0, 0.0), 'torque_gain', 'torque_gain: the interval contains 0: the logged torque has '
     'no visible effect'),
    ((1.0, 0.0, 1.0), 'torque_gains', 'torque_gains.y: the interval contains 0: the logged torque '
     'has no visible effect about y')])
def test_a_logged_torque_that_did_not_act_is_a_reason_against_the_model(axes, name, reason):
    truth = Truth(axes=axes)
    noise = np.random.default_rng(3).normal(scale=0.01, size=(201, 3)) * (1.0 - np.array(axes))
    experiment = replace(truth.experiment(truth.measured(ATTITUDE, RATE)),
                         log=TorqueLog(truth.times, truth.torques + noise))
    result = identify(TRUE, experiment, estimate=['start', name])
    assert all(one.identifiable for one in result.estimates.values())
    assert (result.verdict.level, result.verdict.reasons) == ('approximate', [reason])


@pytest.mark.slow
@pytest.mark.parametrize('delay', [1.7, 2.3])
def test_a_torque_delay_keeps_within_two_seconds_and_is_not_determined_there(delay):
    log = TorqueLog(tumble(8.0).times - round(delay * SECOND), tumble(8.0).torques)
    experiment = replace(tumble(8.0).experiment(tumble(8.0).measured()), log=log)
    result = identify(RigidBody(INERTIA), experiment, estimate=['torque_gain', 'torque_delay'])
    found = result.estimates['torque_delay']
    assert found.value == pytest.approx(min(delay, 2.0), abs=1e-8 if delay < 2.0 else 2e-3)
    assert found.identifiable == (delay < 2.0)
    assert result.estimates['torque_gain'].identifiable
    reasons = [one['reason'] for one in result.as_dict()['unidentifiable']
               if [*one['direction']] == ['torque_delay']]
    assert [reason.split(':')[0] for reason in reasons] == (
        [] if delay < 2.0 else ['at its bound of 2 s'])
    assert ('not determined   torque_delay: at its bound' in result.text()) == (delay > 2.0)


@pytest.mark.slow
def test_heavy_wheels_need_no_gyro():
    times, inertia = np.arange(400) * (SECOND // 20), np.diag([0.045, 0.12, 0.14])
    wheels = [Wheel('x', (1.0, 0.0, 0.0), 5e-3), Wheel('z', (0.0, 0.0, 1.0), 5e-3)]
    efforts = EffortLog(times, 0.01 * np.stack([np.sin(1e-9 * times), np.cos(7e-10 * times)], 1))
    truth = Truth(amplitude=0.0, measured_hz=100, inertia=inertia, rates=(0.15, 0.3, -0.1),
                  options={'wheels': wheels, 'efforts': efforts})
    # A rate guessed from noisy attitudes would give the wheels a wrong momentum in later windows.
    result = identify(RigidBody(inertia), truth.experiment(truth.measured(ATTITUDE, None)),
                      validate=0.2)
    assert result.verdict.level == 'explained', result.verdict.reasons
    assert_covered(result, inertia_truth(inertia))


@pytest.mark.slow
def test_two_recordings_with_different_sensors_give_one_inertia_and_two_starts():
    other = Truth(rates=(-0.3, 0.2, 0.9), seconds=10.0)
    of_rates = other.experiment(other.measured(None, RATE))
    both = identify(GUESS, [tumble().experiment(tumble().measured(ATTITUDE, None)), of_rates])
    assert both.unidentifiable == []
    assert 'initial_attitude.x' in both.estimates
    assert 'initial_attitude.x[2]' not in both.estimates
    assert_covered(both, {**inertia_truth(), 'initial_angular_velocity.x[2]': -0.3})
    alone = identify(GUESS, of_rates).estimates['inertia.ixx']
    assert both.estimates['inertia.ixx'].sigma < alone.sigma
    assert len(both.starts) == 2


@pytest.mark.slow
def test_validation_is_kept_out_of_the_fit():
    whole = noisy()
    result = identify(GUESS, tumble().experiment(whole), validate=0.3)
    assert result.training.samples == pytest.approx(1.4 * len(whole.stamps_ns), rel=0.01)
    assert result.training.samples + result.validation.samples == 2 * len(whole.stamps_ns)
    assert result.validation.attitude_rms < 2 * ATTITUDE
    spoilt = replace(whole, angular_velocity=whole.angular_velocity.copy())
    spoilt.angular_velocity[-100:] += 1.0
    again = identify(GUESS, tumble().experiment(spoilt), validate=0.3)
    assert np.array_equal(again.body.inertia, result.body.inertia)
    assert again.validation.rate_rms > 0.5


#: Fits that the recordings do not determine: what they do not, what they do, and the reason.
RATIO = 'only the ratio of torque to inertia enters the motion'
UNDETERMINED = {
    'no torque': (Case('inertia start', {'amplitude': 0.0}), INERTIA_NAMES,
                  'initial_angular_velocity.x', 'ratios'),
    'gain and inertia': (Case('inertia start torque_gain'), ['torque_gain', *INERTIA_NAMES[:3]],
                         'initial_angular_velocity.x', RATIO),
    'moment and inertia': (Case('inertia start pivot.moment', {'amplitude': 0.0, **WEIGHT},
                                experiment={'fields': [NEAR]}),
                           ['pivot.moment.z', *INERTIA_NAMES[:3]], 'initial_attitude.x', RATIO),
    'one axis': (Case('inertia start', {'inertia': np.diag([0.02, 0.03, 0.04]), 'axes': (0, 0, 1),
                                        'rates': (0.0, 0.0, 0.3)}),
                 INERTIA_NAMES[:2], 'inertia.izz', '')}


@pytest.mark.slow
@pytest.mark.parametrize('name', UNDETERMINED)
@pytest.mark.parametrize('noise', [(ATTITUDE, RATE), *at_night(((0.0, 0.0),))])
def test_what_a_recording_does_not_determine_is_named(name, noise):
    case, unknown, known, reason = UNDETERMINED[name]
    result, _ = case.result(*noise)
    assert not any(result.estimates[one].identifiable for one in unknown)
    assert all(result.estimates[one].interval_95 is None for one in unknown)
    assert result.estimates[known].identifiable
    assert reason in ' '.join(one.reason for one in result.unidentifiable)
    if reason == RATIO:
        direction, = result.unidentifiable
        assert {unknown[0], 'inertia.izz'} <= {*direction.components}
    if known == 'inertia.izz':
        assert_covered(result, {known: 0.04}, width=4.0 if noise[0] else 1e9)


@pytest.mark.slow
def test_the_result_as_json(tmp_path):
    result = identify(GUESS, tumble().experiment(noisy()),
                      estimate=['inertia', 'start', 'torque_gain'], validate=0.2)
    data = json.loads(json.dumps(result.as_dict(), allow_nan=False))
    assert data['estimates']['torque_gain'] == {
        'value': result.estimates['torque_gain'].value, 'unit': '', 'start': 1.0, 'sigma': None,
        'systematic': 0.0, 'interval_95': None, 'identifiable': False}
    assert data['covariance']['names'] == [*data['estimates']]
    matrix = np.array(data['covariance']['matrix'], float)  # NaN where it is null
    sigmas = np.array([one['sigma'] for one in data['estimates'].values()], float)
    np.testing.assert_allclose(np.sqrt(np.diag(matrix)), sigmas, rtol=1e-12)
    known = np.isfinite(sigmas)
    assert np.array_equal(np.isfinite(matrix), np.outer(known, known))
    assert np.array_equal(matrix, matrix.T, equal_nan=True)
    assert data['training'].keys() == data['validation'].keys() == {
        'samples', 'outliers', 'attitude_rms_rad', 'rate_rms_rad_s', 'chi2_per_dof'}
    (tmp_path / 'fit.json').write_text(json.dumps(data))
    saved = Identification.load(tmp_path / 'fit.json')
    for name, one in result.estimates.items():
        assert (saved.values[name], saved.units[name]) == (one.value, one.unit)
    np.testing.assert_array_equal(saved.covariance, result.covariance)
    assert saved.guess_attitude.tolist() == tumble().start.attitude.tolist()
    assert (saved.converged, saved.level) == (result.converged, result.verdict.level)


def bad(**changes):
    measured = tumble().measured()
    fields = {'topic': '/pose', 'stamps_ns': measured.stamps_ns, 'attitude': measured.attitude,
              'angular_velocity': None}
    return tumble().experiment(Measured(**{**fields, **changes}))


@pytest.mark.parametrize(('experiment', 'options', 'message'), [
    (lambda: bad(attitude=np.nan * tumble().q), {}, '/pose: expected finite attitudes'),
    (lambda: bad(stamps_ns=tumble().stamps_ns - 100 * SECOND), {},
     '/pose: expected attitudes from'),
    (lambda: bad(stamps_ns=tumble().stamps_ns[:3], attitude=tumble().q[:3]), {},
     '/pose: expected at least 8 attitudes'),
    (lambda: tumble().experiment(), {}, 'expected at least one measured topic'),
    (lambda: [bad(), replace(bad(), wheels=[Wheel('x', (1.0, 0.0, 0.0), 1e-3)])], {},
     'expected the same wheels in all recordings, found others'),
    (bad, {'estimate': ['mass']}, "estimate: expected names among inertia.*found 'mass'"),
    (bad, {'estimate': ['inertia', 'inertia_diagonal']}, 'expected one of'),
    (bad, {'estimate': ['pivot.moment']},
     r"expected moments of the fields of the scene \(none\), found 'pivot'"),
    (lambda: replace(bad(), fields=[replace(NEAR, name='weight')]), {'estimate': ['weight']},
     'weight: expected a scene without a field of that name, found one; estimate weight.moment'),
    (bad, {'estimate': ['weight'], 'gravity': (0.0, 0.0, 0.0)}, 'gravity: expected a field other'),
    (bad, {'estimate': ['pivot.field']}, "NAME.moment of a field, found 'pivot.field'"),
    *((bad, {'estimate': [name]}, f'expected @TOPIC after the parameter of a sensor .*{name}')
      for name in ('start@/pose', 'inertia@', 'mount@')),
    (bad, {'estimate': []}, 'at least one name'),
    (bad, {'estimate': ['start', 'start']}, 'each name once'),
    (bad, {'attitude_noise': 0.0}, 'attitude_noise: expected a number greater than zero'),
    (bad, {'validate': 1.0}, 'validate: expected a fraction'),
    (bad, {'priors': {'mounting': 0.1}}, 'prior: expected parameters that are estimated or may be '
     r"suspects \(inertia, .*\), found 'mounting'"),
    (bad, {'priors': {'damping': '5%'}},
     'damping.dxx: expected a standard deviation greater than zero, found 5% of a guess of 0'),
    (bad, {'priors': {'torque_bias': -1.0}}, 'found -1.0 of a guess of 0'),
])
def test_bad_input_is_named(experiment, options, message):
    with pytest.raises(ValueError, match=message):
        identify(GUESS, experiment(), **options)


@pytest.mark.nightly
def test_intervals_cover_the_truth_and_are_as_short_as_possible():
    covered, chi2, distances = [], [], []
    for seed in range(20):
        result = identify(GUESS, tumble().experiment(noisy(seed)), attitude_noise=ATTITUDE,
                          rate_noise=RATE)
        estimates = [result.estimates[name] for name in INERTIA_NAMES]
        error = [one.value - value for one, value in zip(estimates, inertia_truth().values())]
        covered += [abs(each) < 1.96 * one.sigma for each, one in zip(error, estimates)]
        chi2.append(result.training.chi2_per_dof)
        distances.append(error @ np.linalg.solve(result.covariance[:6, :6], error))
    assert abs(np.mean(distances) - 6) < 4 * np.sqrt(2 * 6 / 20)  # chi-square with 6 degrees
    assert 0.88 <= np.mean(covered) <= 1.0  # 120 intervals that are correlated
    assert 0.9 < min(chi2) < max(chi2) < 1.1


@pytest.mark.slow
def test_a_known_actuator_is_part_of_the_model():
    truth = Truth(8.0, options={'actuator': Actuator(0.02, 0.1, (0.015,) * 3)})
    result = identify(GUESS, (truth.problem, Measurements([truth.measured()])))
    assert result.training.attitude_rms < 1e-9
    assert inertia_error(result) < 1e-8


@pytest.mark.parametrize('lag', [0.0, 0.1])
def test_slopes_of_predictions_are_the_limits_of_differences(lag):
    names = ('inertia', 'torque_gain', 'torque_gains', 'torque_bias', 'torque_delay', 'torque_lag',
             'weight', 'clock_offset', 'clock_drift', 'mount', 'gyro_bias', 'gyro_scale@/imu',
             'damping', 'rotor_momentum')
    problem, measured = tumble(2.0).experiment(tumble(2.0).measured(ATTITUDE, RATE)).observed(
        GUESS, 0.0)
    gyro = Measured('/gyro', measured.sensors[0].stamps_ns[::3], None,
                    measured.sensors[0].angular_velocity[::3])
    # Samples between the stamps of torques, so that no step goes from one torque to the next.
    apart = [replace(one, stamps_ns=one.stamps_ns + 2_500_000)
             for one in channels_of([*measured.sensors, gyro], 0)]
    setup = setup_of([problem], [apart], [name for name in names if name != 'torque_gain'])
    window, = setup.windows(setup.span_ns, setup.given)
    state = Poses(problem.start.attitude, problem.start.angular_velocity)
    physics = setup.parameters.guess
    for name, value in (('torque_lag', [lag]), ('mount', [0.1, -0.2, 0.3]),
                        ('torque_gains', [0.9, 1.1, 1.2]), ('weight', [0.0, 0.0, 1e-3]),
                        ('torque_bias', [1e-3, 0.0, 2e-3]), ('damping', 3 * [1e-3] + 3 * [0.0]),
                        ('gyro_scale@/imu', [1.1, 1.2, 0.9])):
        physics = physics.with_value(name, np.array(value))
    predicted, slopes = window.linearize(physics, state, names)
    for found, expected in zip(predicted, window.predict(physics, state)):
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)
    at = [replace(channel, **{'attitude' if channel.is_attitude else 'angular_velocity': each})
          for channel, each in zip(window.channels, predicted)]
    components = [(name, entry) for name in names for entry in np.eye(len(components_of(name)))]
    for row, (name, entry) in enumerate(components, 6):
        step = (1e-5 if name in ('weight', 'damping', 'inertia') else 1e-4) * entry
        values = physics.value(*name.split('@'))
        errors = [errors_of(at, window.predict(physics.with_value(
            name, values + times * step), state)) for times in range(4)]
        for channel, slope, (none, one, two, three) in zip(window.channels, slopes, zip(*errors)):
            change = (18.0 * one - 9.0 * two + 2.0 * three - 11.0 * none) / (6.0 * step.sum())
            # Without a lag, the first derivative is that of a delay.
            limit = 1e-5 if name != 'torque_lag' or lag else 0.1
            assert np.abs(slope[row] - change).max() < limit * np.abs(change).max(initial=1e-3), (
                name, channel.topic)
