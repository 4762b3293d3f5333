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

"""attitude_replay, ended at any moment, leaves nothing wrong or incomplete under a final name."""

import itertools
import signal
import struct
import subprocess
import sys
import time
from typing import NamedTuple

from conftest import at_night, CONFIG
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
import numpy as np
import pytest
from replay import record

pytestmark = pytest.mark.slow

COMMAND = [sys.executable, '-c', 'import sys; from rigid_body_ros.commands import main; '
                                 'sys.exit(main.attitude_replay())']
MESSAGES = 20_000
#: Stages of a replay, in this order. Moments are fractions of the time from a stage to the end.
STAGES = {'started': lambda folder: True, 'writing': lambda folder: bool(parts(folder))}
KILLS = [*zip(itertools.cycle(STAGES), np.random.default_rng(6).random(10).round(3))]


class Whole(NamedTuple):
    """A replay that is not interrupted."""

    arguments: list
    #: Time from each stage to the end, s.
    seconds: dict
    data: bytes
    messages: list


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp('whole')
    path, output = folder / 'torque.mcap', folder / 'motion.mcap'
    record(path, MESSAGES)
    arguments = [path, '--scene', CONFIG / 'tumbler.yaml', '--overwrite', '-o']
    process, reached = start([*arguments, output]), {}
    for stage in STAGES:
        wait_for(stage, process, folder)
        reached[stage] = time.perf_counter()
    process.communicate()
    assert process.returncode == 0
    seconds = {stage: time.perf_counter() - when for stage, when in reached.items()}
    with open(output, 'rb') as stream:
        statistics = make_reader(stream, validate_crcs=True).get_summary().statistics
    found = readable(output)
    assert statistics.message_count == len(found) == 3 * MESSAGES
    return Whole(arguments, seconds, output.read_bytes(), found)


@pytest.fixture
def output(tmp_path):
    return tmp_path / 'motion.mcap'


def start(arguments):
    return subprocess.Popen([*COMMAND, *arguments], stdout=subprocess.DEVNULL,
                            stderr=subprocess.PIPE, text=True)


def wait_for(stage, process, folder):
    while not STAGES[stage](folder) and process.poll() is None:
        time.sleep(0.001)


def parts(folder):
    return list(folder.glob('.*.part'))


def interrupt(whole, output, number, stage, moment):
    """Send a signal to a replay; return its exit status and its output."""
    process = start([*whole.arguments, output])
    wait_for(stage, process, output.parent)
    time.sleep(moment * whole.seconds[stage])
    process.send_signal(number)
    _, words = process.communicate(timeout=60)
    return process.returncode, words


def check(whole, output):
    """Check the files that a replay left; return the number of messages in an unfinished one."""
    folder = output.parent
    partial = output.with_suffix('.partial.mcap')
    assert set(folder.iterdir()) <= {output, partial, *parts(folder)}
    if output.exists():
        assert output.read_bytes() == whole.data
    left = [*parts(folder), *([partial] if partial.exists() else [])]
    assert len(left) <= 1
    salvaged = [message for part in left for message in readable(part)]
    assert salvaged == whole.messages[:len(salvaged)]
    return len(salvaged)


def readable(path):
    """Return topics, times and bytes of a file that may break off anywhere."""
    topics, found = {}, []
    with open(path, 'rb') as stream:
        try:
            for one in StreamReader(stream, validate_crcs=True).records:
                if isinstance(one, Channel):
                    topics[one.id] = one.topic
                elif isinstance(one, Message):
                    found.append((topics[one.channel_id], one.sequence, one.log_time,
                                  one.publish_time, one.data))
        except (EndOfFile, struct.error):  # struct.error if it breaks off within a number
            pass
    return found


@pytest.mark.nightly
@pytest.mark.parametrize(('stage', 'moment'), KILLS)
def test_a_killed_replay_leaves_nothing_false(whole, output, stage, moment):
    status, _ = interrupt(whole, output, signal.SIGKILL, stage, moment)
    assert status in (0, -signal.SIGKILL)
    assert output.exists() or status != 0
    check(whole, output)


def test_what_a_killed_replay_wrote_can_be_read(whole, output):
    process = start([*whole.arguments, output])
    while not any(part.stat().st_size > len(whole.data) / 2 for part in parts(output.parent)):
        assert process.poll() is None, 'it was too quick for us'
        time.sleep(0.001)
    process.kill()
    process.communicate()
    assert not output.exists()
    assert check(whole, output) > MESSAGES


@pytest.mark.parametrize(('number', 'stage', 'moment'), [
    (signal.SIGTERM, 'writing', 0.1), *at_night((signal.SIGINT, 'writing', 0.5))])
def test_an_interrupted_replay_says_so(whole, output, number, stage, moment):
    status, words = interrupt(whole, output, number, stage, moment)
    check(whole, output)
    if status in (0, -number):  # it had finished, perhaps without signal handlers
        assert output.exists()
        assert not words
        return
    line, = words.splitlines()
    assert (status, line.startswith('attitude_replay: interrupted')) == (128 + number, True)
    partial = output.with_suffix('.partial.mcap')
    assert ('what was written so far is in ' in line) == partial.exists()
    assert not (partial.exists() and output.exists())


def test_signals_in_a_row_do_not_disturb_the_cleaning_up(whole, output):
    process = start([*whole.arguments, output, '--rate', '1000', '--until', '86400'])
    wait_for('writing', process, output.parent)
    for _ in range(50):
        process.send_signal(signal.SIGINT)
        time.sleep(0.001)
    _, words = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGINT
    *announced, last = words.splitlines()  # the estimate of the time may come first
    assert last.startswith('attitude_replay: interrupted')
    assert len(announced) <= 1
    assert not output.exists()
    assert not parts(output.parent)
