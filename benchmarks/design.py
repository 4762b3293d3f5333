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
Measure whether the intervals that `attitude_design` expects are those of simulated flights.

For each of five vehicles, `python benchmarks/design.py` designs a maneuver, flies it 200 times in
the simulator of `simulated.py`, which shares no code with the package, fits every flight with
`identify`, and prints a line. It takes about an hour.
"""

from multiprocessing import Pool
import os
from typing import NamedTuple

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import numpy as np  # noqa: E402
import rigid_body_ros as ros  # noqa: E402
from rigid_body_ros.design.information import Instrument, Question  # noqa: E402
from rigid_body_ros.design.maneuver import Maneuvers, NO_LIMITS  # noqa: E402
from rigid_body_ros.design.search import design  # noqa: E402
import simulated  # noqa: E402

SENSORS = [Instrument('/mocap', True, simulated.ATTITUDE_NOISE, simulated.SENSOR_HZ),
           Instrument('/imu', False, simulated.RATE_NOISE, simulated.SENSOR_HZ)]
#: Number of flights of each vehicle.
FLIGHTS = 200


class Vehicle(NamedTuple):
    """A vehicle, its limits, and what is asked of its flight."""

    inertia: list
    limits: dict
    seconds: float = 20.0
    estimate: tuple = ('inertia',)
    priors: dict = {}  # noqa: RUF012
    #: The moment of the weight, and the axial inertia of each of three wheels.
    weight: tuple = (0.0, 0.0, 0.0)
    wheel: float = 0.0

    def parts(self):
        """Return the wheels, one about each axis, and the field of the weight, as keywords."""
        return {'wheels': [ros.Wheel(f'rw_{axis}', tuple(unit), self.wheel) for axis, unit in zip(
            'xyz', np.eye(3))] if self.wheel else None, 'fields': [
                ros.UniformField(self.weight, simulated.GRAVITY, 'weight')] * any(self.weight)}


VEHICLES = {
    'quadrotor': Vehicle([0.010, 0.012, 0.020], {
        'torque': [0.1, 0.1, 0.05], 'rate': [2.0], 'angle': [np.radians(40.0)]}),
    'CubeSat with wheels': Vehicle([0.036, 0.035, 0.0065], {
        'torque': [2e-3] * 3, 'rate': [0.3], 'wheel_speed': [600.0]}, wheel=2e-5),
    'rod': Vehicle([0.02, 0.02, 0.001], {
        'torque': [0.05, 0.05, 0.005], 'rate': [2.0], 'angle': [1.0]}),
    'air-bearing table': Vehicle([1.0, 1.2, 2.0], {
        'torque': [0.5] * 3, 'rate': [0.5], 'angle': [np.radians(20.0)]},
        estimate=('inertia', 'weight.moment'), weight=(0.002, -0.001, -0.02)),
    'thrown device': Vehicle([0.020, 0.030, 0.040, 0.001, -0.002, 0.0005], {
        'torque': [0.0] * 3, 'rate': [6.0]}, seconds=2.0, priors={'inertia.ixx': '1%'}),
}


def maneuvers_of(vehicle):
    """Return the maneuvers of a vehicle, with torques at the rate of the simulator."""
    body = ros.RigidBody.from_moments(*vehicle.inertia)
    problem = ros.Problem(body, ros.State(0), **vehicle.parts())
    limits = {name: np.array(limit) for name, limit in vehicle.limits.items()}
    return Maneuvers(problem, {**NO_LIMITS, **limits}, vehicle.seconds, simulated.TORQUE_HZ)


def flown(name, problem, expected, seed):
    """Simulate a flight and fit it; return the errors and the half-widths of the estimates."""
    vehicle, random = VEHICLES[name], [np.random.default_rng((1, seed))]
    efforts, tensor = problem.efforts, problem.body.inertia - vehicle.wheel * np.eye(3)
    kind = simulated.Kind(name, seconds=vehicle.seconds + 0.1, inertia=tensor,
                          weight=vehicle.weight)
    torques = np.zeros((1, round(kind.seconds * simulated.TORQUE_HZ), 3))
    if efforts or problem.logs:
        log = -efforts.efforts if efforts else problem.logs[0].torques
        torques[0, :len(log)] = log
    # The flight begins within a few percent of the limits from the planned start.
    limits = [vehicle.limits.get('angle', [1.0]), vehicle.limits['rate']]
    off = 0.02 * np.array(limits)[:, None] * random[0].standard_normal((2, 1, 3)) * (
        not vehicle.wheel)
    start = simulated.exponential(off[0]), problem.start.angular_velocity + off[1]
    attitudes, rates = simulated.integrated(kind, simulated.acting(kind, torques, random), start,
                                            bool(vehicle.wheel))
    times_ns = np.arange(torques.shape[1]) * (simulated.SECOND // simulated.TORQUE_HZ)
    seen = simulated.measured(kind, random[0], times_ns, torques[0], attitudes[:, 0], rates[:, 0],
                              1.0)
    experiment = ros.Experiment(
        ros.State(0), ros.TorqueLog(times_ns, torques[0]) if problem.logs else None,
        [ros.Measured('/mocap', seen.attitude_ns, seen.attitude, None),
         ros.Measured('/imu', seen.rate_ns, None, seen.rates)],
        efforts=efforts and ros.EffortLog(times_ns, -torques[0]), **vehicle.parts())
    factor = 1.0 + 0.01 * random[0].standard_normal() if vehicle.priors else 1.05
    fit = ros.identify(ros.RigidBody(factor * problem.body.inertia), experiment, estimate=(
        *vehicle.estimate, 'start'), priors=vehicle.priors)
    found = [fit.estimates[one] for one in expected.names]
    values = [one.value for one in found] - expected.values
    return values, [0.5 * np.ptp(one.interval_95 or (-np.inf, np.inf)) for one in found]


def main():
    """Print a line for each vehicle."""
    for name, vehicle in VEHICLES.items():
        result = design(maneuvers_of(vehicle), Question(vehicle.estimate, SENSORS, vehicle.priors))
        usual = min(one.widest for one in result.usual.values())
        with Pool(os.cpu_count()) as pool:
            found = pool.starmap(flown, [(name, result.flown, result.expected._replace(priors={}),
                                          seed) for seed in range(FLIGHTS)])
        values, widths = map(np.array, zip(*found))
        of_errors = result.expected.half_widths / (1.96 * np.sqrt(np.mean(values ** 2, axis=0)))
        of_fits = result.expected.half_widths / np.median(widths, axis=0)
        print(f'{name}: expected / found from the errors {of_errors.min():.2f} to '
              f'{of_errors.max():.2f}, from the fits {of_fits.min():.2f} to {of_fits.max():.2f}; '
              f'{100.0 * np.mean(np.abs(values) <= widths):.1f} % covered; '
              f'{usual / result.expected.widest:.1f} times narrower than the usual', flush=True)


if __name__ == '__main__':
    main()
