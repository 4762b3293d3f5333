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

"""Fixtures and helpers for all tests."""

from contextlib import contextmanager, ExitStack, suppress
import fcntl
from importlib.util import find_spec
import os
from pathlib import Path
import re
import resource
import subprocess
import sys
import tempfile
import tracemalloc

from hypothesis import settings
import numpy as np
import psutil
import pytest
import rigid_body_ros
from rigid_body_ros import messages, propagate, recording, scene, State
from rigid_body_ros.commands import main
from rigid_body_ros.mechanics import so3

ROOT = Path(__file__).resolve().parent.parent
# Like the setting `pythonpath`, which pytest 6 of Ubuntu 22.04 lacks.
sys.path[:0] = [str(ROOT / name) for name in ('benchmarks', 'docs', 'examples')]

settings.register_profile('reproducible', derandomize=True, deadline=None, print_blob=True)
settings.load_profile('reproducible')

PACKAGE = Path(rigid_body_ros.__file__).parent
NAME = 'rigid_body_ros'
RECORDINGS = ROOT / 'test' / 'recordings'
CONFIG = ROOT / 'config'
#: First stamp of the recordings, where adjacent doubles are 238 ns apart in seconds.
EPOCH_NS = 1_767_225_600_123_456_789
SECOND = 10 ** 9
#: Test files that need an optional module, by that module.
NEEDS = {
    'distributed': ['cluster'],
    'pyarrow': ['cluster', 'dispersions', 'ensemble', 'ensemble_folder', 'ensemble_loop',
                'ensemble_results', 'identify_command', 'wheel_command'],
    'zarr': ['cluster', 'ensemble', 'ensemble_folder', 'ensemble_loop', 'ensemble_results'],
    'rclpy': ['sources', *(
        path.stem.removeprefix('test_') for path in sorted(Path(__file__).parent.glob('test_*.py'))
        if re.search('^pytestmark.*mark.ros', path.read_text(encoding='utf-8'), re.MULTILINE))],
    'mpmath': ['actuators', 'arm', 'changes', 'elementary', 'examples', 'extremes',
               'fields', 'free_motion', 'laws', 'peers', 'reference', 'sensitivity',
               'sources', 'steppers', 'taylor', 'tradeoff', 'truth', 'validation',
               'wheels'],  # not known to rosdep
}
ABSENT = {module: [f'test_{name}.py' for name in names] for module, names in NEEDS.items()
          if find_spec(module) is None}
collect_ignore = [name for names in ABSENT.values() for name in names]


def pytest_report_header():
    """Report which test files are skipped, and why."""
    return [f'{module} is not installed, so these are skipped: {", ".join(names)}'
            for module, names in ABSENT.items()]


def nearest_rank(numbers, percentages):
    """Return percentiles that are among the numbers, as NumPy can from 1.22 on."""
    ordered = np.sort(numbers)
    return [float(ordered[-(-k * len(ordered) // 100) - 1]) for k in percentages]


def at_night(*values):
    """Return values of a parameter, or tuples of several, that only `make nightly` tests."""
    return [pytest.param(*(value if isinstance(value, tuple) else (value,)),
                         marks=pytest.mark.nightly) for value in values]


@pytest.fixture(autouse=True)
def _floating_point_errors_are_errors():
    with np.errstate(divide='raise', invalid='raise', over='raise'):
        yield


def readable_by_all(path, flags):
    """Open a lock file that every user of the machine can lock; an opener for `open`."""
    with suppress(FileExistsError):
        made = os.open(path, os.O_CREAT | os.O_EXCL)
        os.fchmod(made, 0o644)
        return made
    return os.open(path, os.O_RDONLY)


@contextmanager
def locked(path):
    """Hold a machine-wide lock; raise BlockingIOError if another process holds it."""
    with open(path, opener=readable_by_all) as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield


@pytest.fixture(scope='session')
def domain():
    """Yield a ROS domain that no other process of tests on this machine uses."""
    with ExitStack() as stack:
        for number in range(1, 101):
            path = Path(tempfile.gettempdir()) / f'rigid_body_ros.{number}.lock'
            with suppress(BlockingIOError, PermissionError):
                stack.enter_context(locked(path))
                break
        else:
            raise RuntimeError('expected a free ROS domain, found none from 1 to 100')
        yield number


@pytest.fixture
def context(domain):
    """Yield an rclpy context in its own domain."""
    import rclpy
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    yield context
    rclpy.try_shutdown(context=context)


@pytest.fixture
def stranger(domain):
    """Yield a node with its own participant, which a topic of another type needs."""
    import rclpy
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node('stranger', context=context)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


@pytest.fixture
def short_trades(monkeypatch):
    limit_trades(monkeypatch)


def limit_trades(monkeypatch):
    """Limit the steps and the repetitions of each setting that `attitude_tradeoff` measures."""
    monkeypatch.setattr('rigid_body_ros.tradeoff.trade._MOST_STEPS', 20_000)
    monkeypatch.setattr('rigid_body_ros.tradeoff.trade._MOST_REPEATS', 3)


@pytest.fixture(scope='session')
def installed(tmp_path_factory):
    """Install the package as `pip install .` does, into a prefix that all tests share."""
    folder = tmp_path_factory.getbasetemp()
    if 'PYTEST_XDIST_WORKER' in os.environ:
        folder = folder.parent  # common to all workers
    # A build writes into the checkout, so only one may run at a time.
    with open(ROOT / 'setup.py') as checkout:
        fcntl.flock(checkout, fcntl.LOCK_EX)
        if not (folder / 'installed').exists():
            _install(folder)
    return folder / 'prefix'


def _install(folder):
    pip = [sys.executable, '-m', 'pip', '--disable-pip-version-check', '--quiet']
    subprocess.run([*pip, 'wheel', '--no-deps', '--no-build-isolation', '-w', folder, ROOT],
                   check=True)
    wheel, = folder.glob('*.whl')
    # Without --ignore-installed, pip would uninstall the package from the test environment.
    subprocess.run([*pip, 'install', '--no-deps', '--ignore-installed', '--prefix',
                    folder / 'prefix', wheel], check=True)
    (folder / 'installed').touch()


@pytest.fixture
def refusal(capsys):
    """Return a function that runs a command, expects one line of error, and returns the line."""
    def run(command, *arguments):
        capsys.readouterr()
        assert getattr(main, command)([*map(str, arguments)]) == 2
        captured = capsys.readouterr()
        line, = captured.err.splitlines()
        assert line.startswith(f'{command}: error: ')
        assert captured.out == ''
        return line
    return run


@pytest.fixture
def scene_with(tmp_path):
    """Return a function that adds lines to a scene, and returns the path of the new scene."""
    def write(*lines, base=CONFIG / 'tumbler.yaml'):
        path = tmp_path / 'scene.yaml'
        path.write_text(base.read_text() + ''.join(f'    {line}\n' for line in lines))
        return str(path)
    return write


def write_torques(path, rows, topic='/torque', kind=recording.Writer):
    """Write WrenchStamped messages from rows of stamp, frame_id and torque; return the path."""
    with kind(path) as writer:
        writer.add_topic(topic, messages.WRENCH)
        for stamp_ns, frame_id, torque in rows:
            writer.write(topic, int(stamp_ns), messages.wrench(int(stamp_ns), frame_id, torque))
    return str(path)


def program(command):
    """Return the words that start a command of the package, without an installed script."""
    return [sys.executable, '-c', 'import sys; from rigid_body_ros.commands import main; '
            f'sys.exit(main.{command}())']


@contextmanager
def memory_limit(most):
    """Fail if Python and its libraries allocate more than `most` bytes."""
    tracemalloc.start()
    try:
        yield
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < most


@contextmanager
def files_up_to(size):
    """Limit the file size, B, of this process: writes beyond it fail, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield  # Python ignores the signal SIGXFSZ
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


class Reference:
    """A recorded scene with its reference motion, read with the reader of the package."""

    def __init__(self, name):
        path = RECORDINGS / f'{name}.mcap'
        config = RECORDINGS / f'{name}.yaml'
        self.scene = scene.load(config if config.exists() else CONFIG / f'{name}.yaml')
        values = self.scene.values
        self.log = recording.torque_log(path, recording.read(path), values['body_frame'],
                                        values['space_frame'])
        attitude = recording.read(path, '/truth/attitude', messages.QUATERNION)
        rates = recording.read(path, '/truth/angular_velocity', messages.VECTOR3)
        self.times_ns, self.attitude = attitude.stamps_ns, attitude.values
        self.angular_velocity = rates.values
        self.start = State(int(self.times_ns[0]), self.scene.start.attitude,
                           self.scene.start.angular_velocity)

    def propagate(self, **options):
        return propagate(self.scene.body, self.start, self.log, at=self.times_ns, **options)

    def bound(self):
        """Return the bound on the errors, rad, at the times of the reference."""
        return bound_at(self.times_ns, lambda at: propagate(
            self.scene.body, self.start, self.log, at=at), self.start.time_ns)


def bound(motion):
    """Return 1e-15 (10 + integral of |w| dt), by time, for a motion at close times."""
    speed = np.linalg.norm(motion.angular_velocity, axis=1)
    turned = 0.5 * (speed[1:] + speed[:-1]) * np.diff(motion.times_ns) / 1e9
    return 1e-15 * (10.0 + np.append(0.0, np.cumsum(turned)))


def bound_at(times_ns, run, start_ns, count=20_001):
    """Return `bound` at ascending times, for the motion that `run` computes at close times."""
    fine = np.union1d(times_ns, start_ns + np.linspace(
        0, times_ns[-1] - start_ns, count).astype(np.int64))
    return bound(run(fine))[np.searchsorted(fine, times_ns)]


def chord(p, q):
    """Return the angle, rad, between attitudes; q and -q count as different."""
    return 2.0 * np.linalg.norm(so3.normalize(p) - q, axis=-1)


@pytest.fixture
def fifty_digits():
    """Let mpmath compute with fifty digits."""
    from mpmath import mp
    with mp.workdps(50):
        yield


def running(mark):
    """Return the other processes that still run and have a mark in their command line."""
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if mark in ' '.join(process.cmdline()) and process.pid != os.getpid() \
                    and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found
