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

    python benchmarks/arm.py        (or: make arm)

The same motions are computed three times: on this machine, on this machine as on an older x86-64
processor, and on ARM, which QEMU emulates (`arm_machine.py`). The motions are random ones through
every solver, and those of `test/scenes.py`. A recording that is replayed on ARM is also verified
here, and ARM compares its results with the committed vectors (`vectors.py`). The exit status is 1
if a bit differs.
"""

import os
import subprocess
import sys
import time

import arm_machine
from arm_machine import FOLDER, ROOT
import bits
import numpy as np
import portable
from processes import command
from rigid_body_ros import TorqueLog

sys.path.insert(0, str(ROOT / 'test'))
from scenes import SCENES  # noqa: E402, I100

#: rad; solvers with steps compute only this much of a longer scene.
LONGEST = 1000.0
MOTIONS = FOLDER / 'motions.pickle'
ARM = 'arm64'
HERE = 'here'
OLD = 'x86-64-v2'
#: Environments in which this processor acts as itself, and like an older one.
ENVIRONMENTS = {
    HERE: {},
    # For fused multiply-add, the kernels call the C library; numpy and BLAS do without it.
    OLD: {'RIGID_BODY_ROS_KERNELS': OLD, 'OPENBLAS_CORETYPE': 'Prescott'},
}


def motions(count):
    """Return the arguments of `portable.groups` for all motions, by name."""
    return {**{str(number): (bits.random_motion(number), number, {}) for number in range(count)},
            **{scene.name: of_scene(scene) for scene in SCENES}}


def of_scene(scene):
    """Return a scene of the tests, with its end and with times that halve repeatedly."""
    end = int(scene.times_ns[-1])
    at = np.unique([*scene.times_ns, *(end >> np.arange(40))])
    steps_end = int(end * min(1.0, LONGEST / max(scene.phase, 1.0)))
    solvers = {name: end if name == 'exact' or (name == 'auto' and scene.log is None)
               else steps_end for name in scene.solvers if name in ('auto', 'taylor', 'exact')}
    log = TorqueLog([], []) if scene.log is None else scene.log
    motion = bits.Motion(scene.body, scene.start, log, at, {}, 0.0)
    return motion, None, solvers


def environment(machine):
    """Return the environment in which this processor acts like a machine."""
    found = {**os.environ, **ENVIRONMENTS[machine], 'PYTHONPATH': str(ROOT)}
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


def differing(there, here):
    """Return the names of the results of two machines that differ in a bit."""
    return [name for name in here if there[name].tobytes() != here[name].tobytes()]


def verified():
    """Replay a recording on ARM and verify the motion here; return whether all bits agree."""
    motion = FOLDER / 'motion.mcap'
    motion.unlink(missing_ok=True)
    _, *replay = command('attitude_replay')
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
    try:
        arm_machine.install()
    except arm_machine.UnavailableError as error:
        print(f'arm: {error}', file=sys.stderr)
        return 2
    with MOTIONS.open('wb') as file:
        portable.Writer(file).dump(motions(bits.COUNT))
    here, _ = computed(HERE)
    same = True
    for machine in (OLD, ARM):
        found, seconds = computed(machine)
        names = differing(found, here)
        print(f'{machine}: {len(names)} of {len(here)} results differ; {seconds:.0f} s',
              *names, sep='\n  ', flush=True)
        same = same and not names
    print(f'A recording replayed on {ARM}, verified here:', flush=True)
    same = verified() and same
    print(f'{ARM} against the committed vectors:', flush=True)
    return 0 if has_committed_bits() and same else 1


if __name__ == '__main__':
    sys.exit(main())
