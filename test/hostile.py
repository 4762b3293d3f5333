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

"""Run commands on hostile files within limits, and return their error lines."""

from contextlib import contextmanager, redirect_stderr
from functools import cache
import io
import signal

from conftest import CONFIG, memory_limit, RECORDINGS
import lz4.frame
import pytest
from rigid_body_ros import recording, scene
from rigid_body_ros.commands import main
from rigid_body_ros.common.errors import LONGEST
import zstandard

TUMBLER = CONFIG / 'tumbler.yaml'
#: 1 kB of YAML that would expand to 10^9 values.
LAUGHS = 'a: &a [x,x,x,x,x,x,x,x,x,x]\n' + ''.join(
    f'{name}: &{name} [{",".join(9 * [f"*{before}"])}]\n' for before, name in zip('abcdefgh',
                                                                                  'bcdefghi'))
# Compile the functions that read messages now, so that the limits do not apply to it.
recording.read(RECORDINGS / 'tumbler.mcap')


@contextmanager
def limits(most=300e6):
    """Fail after 10 s of processor time or 60 s of wall time, or if Python allocates `most` B."""
    def too_long(number, frame):
        pytest.fail('took more than 10 s of processor time, or 60 s of wall time')
    timers = [(signal.SIGPROF, signal.ITIMER_PROF, 10), (signal.SIGALRM, signal.ITIMER_REAL, 60)]
    before = [signal.signal(number, too_long) for number, _, _ in timers]
    for _, timer, seconds in timers:
        signal.setitimer(timer, seconds)
    try:
        with memory_limit(most):
            yield
    finally:
        for (number, timer, _), handler in zip(timers, before):
            signal.setitimer(timer, 0)
            signal.signal(number, handler)


@cache
def zeros(size, compression='zstd', says_its_size=False):
    """Return zeros, compressed to almost nothing, whose header may not state their number."""
    stated = size * says_its_size
    if compression == 'zstd':
        compressor = zstandard.ZstdCompressor().compressobj(stated or -1)
        pieces = [b'']
    else:
        compressor = lz4.frame.LZ4FrameCompressor()
        pieces = [compressor.begin(stated)]
    pieces += [compressor.compress(bytes(2 ** 20)) for _ in range(size // 2 ** 20)]
    return b''.join([*pieces, compressor.flush()])


def outcome(path, scene_path=TUMBLER):
    """Return the error line of a command that reads both files; '' if there is none."""
    def read():
        values = scene.load(scene_path).values
        recorded = recording.read(path)
        for epoch in recording.epochs(path, recorded):
            recording.torque_log(path, epoch, values['body_frame'], values['space_frame'])
        assert len(recorded.damage) <= LONGEST
        assert recorded.damage == '' or recorded.damage.isprintable()
        return 0
    return line_of(read, 'attitude_replay')


def line_of(run, command):
    """Return the error line of a function that runs in place of a command; '' if none."""
    with limits(), redirect_stderr(io.StringIO()) as printed:
        status = main._guarded(command, run, ())
    lines = printed.getvalue().splitlines()
    assert all(len(line) <= LONGEST and line.isprintable() for line in lines)
    errors = [line for line in lines
              if not line.startswith((f'{command}: note: ', f'{command}: warning: '))]
    assert (status, len(errors)) in ((0, 0), (2, 1))
    assert all(line.startswith(f'{command}: error: ') for line in errors)
    return ''.join(errors)
