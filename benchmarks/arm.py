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
Compare the results of this machine with those of a 64-bit ARM machine, bit for bit.

    python benchmarks/arm.py [--count N]        (or: make arm)

The same motions are computed three times: on this machine, on this machine as on an older x86-64
processor, and on ARM, which QEMU emulates (`arm_machine.py`). The motions are random ones through
every solver, those of `test/scenes.py` and those of `test/recordings`. A recording that is
replayed on ARM is also verified here, and ARM compares its results with the committed vectors
(`vectors.py`). The exit status is 1 if a bit differs.
"""

import argparse
import json
import os
import subprocess
import sys
import time

import arm_machine
from arm_machine import FOLDER, ROOT
import bits
import numpy as np
import portable
from rigid_body_ros import TorqueLog

sys.path.insert(0, str(ROOT / 'test'))
from conftest import chord, program, Reference  # noqa: E402, I100
from scenes import SCENES  # noqa: E402
from test_reference import AMPLIFYING, cases  # noqa: E402

#: rad; solvers with steps compute only this much of a longer scene.
LONGEST = 1000.0
MOTIONS = FOLDER / 'motions.json'
ARM = 'arm64'
HERE = 'here'
OLD = 'x86-64-v2'
#: Names of the columns, and the environment in which this processor acts like an older one.
MACHINES = {
    HERE: {},
    # For fused multiply-add, the kernels call the C library; numpy and BLAS do without it.
    OLD: {'RIGID_BODY_ROS_KERNELS': OLD, 'OPENBLAS_CORETYPE': 'Prescott'},
}


def motions(count):
    """Return all motions by name, as `portable.plain` writes them."""
    found = {str(number): portable.plain(bits.random_motion(number), portable.RANDOM, number)
             for number in range(count)}
    found.update({scene.name: plain_scene(scene) for scene in SCENES})
    solvers = {}
    for name, solver in cases():
        solvers.setdefault(name, []).append(solver)
    found.update({name: plain_reference(name, solvers[name]) for name in solvers})
    return found


def plain_scene(scene):
    """Return a scene of the tests, with its end and with times that halve repeatedly."""
    end = int(scene.times_ns[-1])
    at = np.unique([*scene.times_ns, *(end >> np.arange(40))])
    steps_end = int(end * min(1.0, LONGEST / max(scene.phase, 1.0)))
    solvers = {name: end if name == 'exact' or (name == 'auto' and scene.log is None)
               else steps_end for name in scene.solvers if name in ('auto', 'taylor', 'exact')}
    log = TorqueLog([], []) if scene.log is None else scene.log
    motion = bits.Motion(scene.body, scene.start, log, at, {}, 0.0)
    return portable.plain(motion, portable.SCENE, solvers=solvers)


def plain_reference(name, solvers):
    """Return a recorded scene with a reference motion of fifty digits."""
    reference = Reference(name)
    motion = bits.Motion(reference.scene.body, reference.start, reference.log,
                         reference.times_ns, {}, 0.0)
    return portable.plain(motion, portable.SCENE,
                          solvers=dict.fromkeys(solvers, int(reference.times_ns[-1])))


def environment(machine):
    """Return the environment in which this processor acts like an older one."""
    found = {**os.environ, **MACHINES[machine], 'PYTHONPATH': str(ROOT)}
    if machine == OLD:
        from numpy._core import _multiarray_umath as numpy_core
        found['NPY_DISABLE_CPU_FEATURES'] = ' '.join(
            name for name in numpy_core.__cpu_dispatch__ if numpy_core.__cpu_features__[name])
    return found


def computed(machine):
    """Return the results of a machine, and the time taken, s."""
    target = FOLDER / f'{machine}.npz'
    program = ROOT / 'benchmarks' / 'portable.py'
    begin = time.monotonic()
    if machine == ARM:
        arm_machine.run(program, MOTIONS, target)
    else:
        subprocess.run([sys.executable, program, MOTIONS, target], env=environment(machine),
                       check=True)
    with np.load(target) as file:
        return dict(file), time.monotonic() - begin


def differences(there, here):
    """
    Return how many numbers of two arrays differ in a bit, and by how many ulps at most.

    Zeros with different signs differ by 0 ulps. If a solver accepts the motion on only one of the
    machines, all numbers differ.
    """
    if there.shape != here.shape:
        return max(there.size, here.size), np.inf
    count = np.count_nonzero(there.view(np.int64) != here.view(np.int64))
    a, b = ordinal(there), ordinal(here)
    ulps = np.maximum(a, b).view(np.uint64) - np.minimum(a, b).view(np.uint64)
    return count, float(ulps.max(initial=0))


def ordinal(values):
    """Return the rank of each double among all doubles."""
    places = values.view(np.int64)
    return np.where(places < 0, np.iinfo(np.int64).min - places, places)


def compared(there, here):
    """Return for each group the number of differences, the largest in ulps, and its motion."""
    found = {}
    for name in here:
        group, motion = name.split('/', 1)
        count, ulps = differences(there[name], here[name])
        before, most, worst = found.get(group, (0, -1.0, ''))
        found[group] = (before + count, *max((most, worst), (ulps, motion)))
    return found


def table(here, others):
    """Return lines with the differences by group and machine."""
    sizes = {}
    for name, values in here.items():
        group = name.split('/')[0]
        sizes[group] = sizes.get(group, 0) + values.size
    lines = [f'{"results":18}{"numbers":>9}' + ''.join(f'{name:>14}' for name in others)]
    for group, size in sizes.items():
        counts = [found[group][0] for found in others.values()]
        lines.append(f'{group:18}{size:9}' + ''.join(
            ('same bits' if not count else f'{count} differ').rjust(14) for count in counts))
    return lines + [
        f'{machine}, {group}: {count} differ, by up to {ulps:.2g} ulp in {worst!r}'
        for machine, found in others.items()
        for group, (count, ulps, worst) in found.items() if count]


def truth_errors(results):
    """Return the largest error against 50-digit references, and relative to the tests' bound."""
    worst, part = 0.0, 0.0
    for name, solver in cases():
        reference = Reference(name)
        count = len(reference.times_ns)
        attitude = results[f'scenes {solver}/{name}'][:4 * count].reshape(count, 4)
        error = chord(reference.attitude, attitude)
        bound = AMPLIFYING.get(name, 1e-15 * (10.0 + reference.phase()))
        worst, part = max(worst, error.max()), max(part, np.max(error / bound))
    return worst, part


def verified():
    """Replay a recording on ARM and verify the motion here; return whether all bits agree."""
    motion = FOLDER / 'motion.mcap'
    motion.unlink(missing_ok=True)
    _, *replay = program('attitude_replay')
    arguments = [ROOT / 'test' / 'recordings' / 'tumbler.mcap', '--scene',
                 ROOT / 'config' / 'tumbler.yaml']
    arm_machine.run(*replay, *arguments, '-o', motion)
    return subprocess.run([sys.executable, *replay, *arguments, '--verify', motion],
                          env=environment(HERE)).returncode == 0


def has_committed_bits():
    """Compare ARM with the committed vectors; return whether all bits agree."""
    try:
        arm_machine.run(ROOT / 'benchmarks' / 'vectors.py')
    except subprocess.CalledProcessError:
        return False
    return True


def main():
    """Compare the machines; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--count', type=int, default=bits.COUNT,
                        help=f'random motions; {bits.COUNT} by default')
    count = parser.parse_args().count
    try:
        arm_machine.install()
    except arm_machine.UnavailableError as error:
        print(f'arm: {error}', file=sys.stderr)
        return 2
    MOTIONS.write_text(json.dumps(motions(count)), encoding='utf-8')
    results, seconds = {}, {}
    for machine in (*MACHINES, ARM):
        results[machine], seconds[machine] = computed(machine)
        print(f'{machine}: {seconds[machine]:.0f} s', flush=True)
    here = results.pop(HERE)
    others = {machine: compared(found, here) for machine, found in results.items()}
    print('', *table(here, others), '', sep='\n')
    error, part = truth_errors(results[ARM])
    print(f'{ARM} against 50 digits: error at most {error:.2g} rad, {part:.2f} of the bound in '
          'test/test_reference.py')
    print(f'A recording replayed on {ARM}, verified here:', flush=True)
    same = verified()
    print(f'{ARM} against the committed vectors:', flush=True)
    same = has_committed_bits() and same and not any(
        count for found in others.values() for count, *_ in found.values())
    return 0 if same and part <= 1.0 else 1


if __name__ == '__main__':
    sys.exit(main())
