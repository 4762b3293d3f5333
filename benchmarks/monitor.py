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
Measure how often a live check raises a false alarm, and how soon it finds an error.

Run `python benchmarks/monitor.py [--hours N] [--colour C]` for the false alarms of a right model,
if one an hour is allowed. Run it with `--delays` or `--windows` for the tables of
`docs/monitor.md`: by the size of the noise, or by the length of the window, s, at nominal noise. A
body tumbles under pulses at 20 Hz. A mocap at 50 Hz and a gyro at 100 Hz measure it, with white
noise or with AR(1) noise. Every hour has its own seed.
"""

import argparse
from functools import partial
from multiprocessing import Pool
import os

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import numpy as np  # noqa: E402
from rigid_body_ros import Problem, RigidBody, so3, State, TorqueLog  # noqa: E402
from rigid_body_ros.inference.monitor import ERROR, Monitor, Settings  # noqa: E402
from scipy.signal import lfilter  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402
from simulated import ATTITUDE_NOISE, RATE_NOISE, SECOND  # noqa: E402
from tables import header, row  # noqa: E402

TORQUE_HZ, MOCAP_HZ, GYRO_HZ = 20, 50, 100
#: kg m^2; the body of `config/tumbler.yaml`.
INERTIA = np.array([[0.045, 0.002, -0.001], [0.002, 0.120, 0.003], [-0.001, 0.003, 0.140]])
#: s; length of a simulated piece, and how late a message may be, which must be longer.
PIECE, HISTORY = 60, 61.0
#: Torque against a rate of 1 rad/s that keeps the body from spinning up, and size of pulses, N m.
BRAKE, PULSE = 5e-4, 4e-3
#: Errors of the model, with the arguments of `pieces`.
ERRORS = {
    '5 % of the largest moment': {'inertia': np.diag([0.0, 0.0, 0.05])},
    '5 % of all moments': {'inertia': 0.05 * np.eye(3)},
    'torque of 1 mN m about x': {'bias': (1e-3, 0.0, 0.0)},
    'torque of 0.05 mN m about x': {'bias': (5e-5, 0.0, 0.0)},
    'gyro turned by 3 degrees': {'mount': (0.0, 0.0, np.radians(3.0))},
    'friction of 1 mN m s/rad': {'friction': 1e-3},
}


def noise(random, count, colour, size, memory):
    """Return AR(1) noise, shape (count, 3), that continues that of the previous piece."""
    white = random.normal(size=(count, 3)) * size * np.sqrt(1.0 - colour ** 2)
    found, memory[:] = lfilter([1.0], [1.0, -colour], white, axis=0, zi=memory)
    return found


def pieces(seed, seconds, colour=0.0, level=1.0, inertia=0.0, bias=(0.0, 0.0, 0.0), friction=0.0,
           mount=(0.0, 0.0, 0.0), rates=(TORQUE_HZ, MOCAP_HZ, GYRO_HZ), piece=PIECE,
           actuator=None):
    """
    Generate what was logged in each piece: torques, and stamps and values of mocap and gyro.

    The noise is `level` times the nominal noise. The relative error of the inertia is `inertia`. A
    torque `bias` and friction act in addition to the logged torque. The gyro is turned by `mount`.
    `rates` are those of torques, mocap and gyro, Hz; the gyro's is a multiple of the mocap's. A
    piece lasts for `piece`, s. An `actuator` begins each piece without a torque.
    """
    random, memories = np.random.default_rng(seed), np.zeros((2, 1, 3))
    torque_hz, mocap_hz, gyro_hz = rates
    turned = Rotation.from_rotvec(mount)
    body = RigidBody(INERTIA * (1.0 + inertia), friction * np.eye(3) if friction else None)
    state = State(0, (0.0, 0.0, 0.0, 1.0), random.normal(size=3) * 0.4)
    for begin_ns in range(0, seconds * SECOND, piece * SECOND):
        end_ns = begin_ns + piece * SECOND
        times_ns = np.arange(begin_ns, end_ns, SECOND // torque_hz)
        torques = random.normal(size=(len(times_ns), 3)) * PULSE - BRAKE * state.angular_velocity
        problem = Problem(body, state, TorqueLog(times_ns, torques), actuator=actuator).biased(
            np.array(bias), end_ns + SECOND)
        at_ns = np.arange(begin_ns, end_ns, SECOND // gyro_hz)
        motion = problem.propagate(at=np.append(at_ns, end_ns))
        state = State(end_ns, so3.normalize(motion.attitude[-1]), motion.angular_velocity[-1])
        mocap = slice(0, -1, gyro_hz // mocap_hz)
        attitude = so3.multiply(motion.attitude[mocap], so3.exp(noise(
            random, len(at_ns[mocap.start::mocap.step]), colour, level * ATTITUDE_NOISE,
            memories[0])))
        rates = turned.inv().apply(motion.angular_velocity[:-1]) + noise(
            random, len(at_ns), colour, level * RATE_NOISE, memories[1])
        yield (times_ns, torques), (at_ns[mocap.start::mocap.step], attitude), (at_ns, rates)


def judgements(found, hours, level=1.0, window=5.0):
    """Run a live check on pieces, and generate its judgements."""
    monitor = Monitor(Problem(RigidBody(INERTIA), State(0)), Settings(
        window, HISTORY, level * ATTITUDE_NOISE, level * RATE_NOISE, hours))
    for torques, mocap, gyro in found:
        monitor.apply(*torques)
        monitor.measure('/mocap', *mocap, np.full((len(mocap[0]), 3), np.nan))
        monitor.measure('/gyro', gyro[0], np.full((len(gyro[0]), 4), np.nan), gyro[1])
        yield from monitor.judgements()


def false_alarms(colour, seed):
    """Return the number of alarms and of windows in an hour with a right model."""
    found = list(judgements(pieces(seed, 3600 + 2 * PIECE, colour), 1.0))
    # The result of a test of several windows persists until the next such test, so count it once.
    alarms = {(one.windows, one.since_ns) for one in found if one.level == ERROR}
    return len(alarms), len(found)


def delay(name, level, window, seed):
    """Return the time, s, until an error is found; infinity if not within ten minutes."""
    found = judgements(pieces(seed, 660, 0.0, level, **ERRORS[name]), 24.0, level, window)
    return next((1e-9 * one.error.end_ns for one in found if one.level == ERROR), np.inf)


def main():
    """Print the rate of false alarms, or the delays."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--hours', type=int, default=100)
    parser.add_argument('--colour', type=float, default=0.0, help='of the AR(1) noise')
    parser.add_argument('--delays', action='store_true')
    parser.add_argument('--windows', type=float, nargs='+', metavar='SECONDS')
    options = parser.parse_args()
    with Pool(os.cpu_count()) as pool:
        if options.delays or options.windows:
            columns = {f'{window:g} s': (1.0, window) for window in options.windows or ()} or {
                'nominal noise': (1.0, 5.0), 'ten times the noise': (10.0, 5.0)}
            print(*header('what is wrong', *columns), sep='\n')
            for name in ERRORS:
                cells = [np.median(pool.map(partial(delay, name, *column), range(5)))
                         for column in columns.values()]
                print(row(name, *(f'{cell:.0f} s' if cell < np.inf else 'not within 10 min'
                                  for cell in cells)), flush=True)
            return
        count = windows = 0
        for hour, (alarms, judged) in enumerate(pool.imap(
                partial(false_alarms, options.colour), range(options.hours)), 1):
            count, windows = count + alarms, windows + judged
            print(f'{hour} h, {windows} windows: {count} alarms', flush=True)


if __name__ == '__main__':
    main()
