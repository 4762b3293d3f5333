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

"""A node that is killed and restarted: its log, and its checkpoint."""

from contextlib import contextmanager
import json
import re
import subprocess
import time

from conftest import at_night, SECOND
from geometry_msgs.msg import QuaternionStamped
from live import decoded, live_values, Session, TUMBLER
from live_session import ACCEPTED, ATTITUDE, COMMITTED, LiveSession, RELIABLE
import numpy as np
import pytest
from rigid_body_ros import messages, recording, scene
from rigid_body_ros.replay.verify import verify

pytestmark = pytest.mark.ros
RATE, STEP_NS = 200, SECOND // 200
MODES = {'realtime': RELIABLE,
         'lockstep': ('-p', 'mode:=lockstep', '-p', f'step:={1 / RATE}', '-p',
                      f'start_time:={SECOND}', '-p', 'history:=0.2', '-p', 'max_future:=0.1')}


def wobble(number):
    return [0.01 * np.sin(0.1 * number), 0.005, 0.01 * np.cos(0.03 * number)]


@contextmanager
def driven(mode, domain, *arguments, kind=Session):
    """Yield a session, and a function that drives it at 200 Hz or in lockstep for some time."""
    with kind(TUMBLER, domain, *MODES[mode], *arguments) as live:
        number = 0

        def on_state(data):
            stamp_ns = messages.QUATERNION.decode(data).stamp_ns
            live.publish(stamp_ns, '', wobble(stamp_ns // STEP_NS))
        if mode == 'lockstep':
            live.node.create_subscription(QuaternionStamped, 'attitude', on_state, 10, raw=True)

        def drive(seconds):
            nonlocal number
            until = time.monotonic() + seconds
            while (rest := until - time.monotonic()) > 0.0:
                if mode == 'realtime':
                    live.publish(live.now_ns(), '', wobble(number))
                number += 1
                live.spin(min(rest, 1 / RATE))
        yield live, drive


def epochs_of(live):
    """Return the start states in the markers of the log."""
    found = [messages.WRENCH.decode(data) for data in live.received[ACCEPTED]]
    return [messages.epoch_start(message.stamp_ns, message.frame_id) for message in found
            if messages.is_epoch_marker(message.frame_id)]


def numbers(state):
    return [*state.attitude.tolist(), *state.angular_velocity.tolist()]


def restart(live):
    """Kill the node as if it crashed, start it again, and wait for its start state."""
    live.process.kill()
    live.process.wait()
    live.spin(0.3)  # receive what it has sent
    count = len(live.received[COMMITTED])
    live.process = subprocess.Popen(live.command, env=live.environment)
    live.wait_until(lambda: len(live.received[COMMITTED]) > count, 'a start state')


@pytest.mark.parametrize(('mode', 'saved', 'seconds'), [
    ('lockstep', True, 1.5), *at_night(('realtime', False, 0.3), ('realtime', True, 2.2),
                                       ('lockstep', False, 1.1), ('lockstep', True, 0.3))])
def test_every_committed_state_of_both_lives_is_replayed(tmp_path, domain, monkeypatch, mode,
                                                         saved, seconds):
    # After a process is killed, the shared memory of Fast DDS may delay messages by seconds, or
    # crash the recorder.
    monkeypatch.setenv('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4')
    path, file = tmp_path / 'live.mcap', tmp_path / 'checkpoint.json'
    arguments = ('-p', f'checkpoint:={file}') if saved else ()
    with driven(mode, domain, *arguments, kind=LiveSession) as (live, drive):
        drive(seconds)
        restart(live)
        count = len(live.received[COMMITTED])
        while len(live.received[COMMITTED]) == count:
            drive(0.5)
        # Fast DDS may deliver the first messages of a topic only after its next heartbeat, in 3 s.
        live.wait_until(lambda: len(epochs_of(live)) == 2, 'the marker of the second life')
        assert live.stop() == 0
        live.write(path)
    result = verify(path, scene.load(TUMBLER), path,
                    recording.Topics((ACCEPTED,)), motion_topic=COMMITTED)
    assert result.same.all()
    assert len(result.same) == len(live.received[COMMITTED])
    if mode == 'lockstep':  # killed before it committed its last torques
        assert re.search(r'in 2 epochs; [0-9]+ torques have no committed state', result.text())
    begin, again = epochs_of(live)
    assert numbers(begin) == numbers(scene.load(TUMBLER).start)
    committed = recording.read(path, COMMITTED, messages.ODOMETRY)
    states = [*zip(committed.stamps_ns.tolist(), live_values(committed).tolist())]
    if saved:  # the second life begins with a committed state of the first
        assert states.count((again.time_ns, numbers(again))) == 2
    else:
        assert numbers(again) == numbers(begin)


@pytest.mark.parametrize('mode', MODES)
def test_a_node_goes_on_from_its_checkpoint_and_says_how_long_it_was_away(tmp_path, domain, mode):
    file = tmp_path / 'checkpoint.json'
    with driven(mode, domain, '-p', f'checkpoint:={file}') as (live, drive):
        drive(0.5)
        words, (start,) = live.end(), epochs_of(live)
        saved = json.loads(file.read_text())
        last = decoded(live, COMMITTED, messages.ODOMETRY)[-1]
    if mode == 'realtime':
        assert re.match(r'\[INFO\] .*: starts at the first clock reading from the initial state '
                        r'of the scene: attitude \(0, 0, 0, 1\) \(x y z w\), angular velocity',
                        words)
        assert f'start: a new epoch begins at {start.time_ns} ns' in words
    # After a regular end, the checkpoint is the last committed state.
    assert saved['time_ns'] == last.stamp_ns
    assert [*saved['attitude'], *saved['angular_velocity']] == [
        *last.values[messages.ORIENTATION], *last.values[messages.ANGULAR_VELOCITY]]
    with driven(mode, domain, '-p', f'checkpoint:={file}') as (live, drive):
        drive(0.2)
        if mode == 'lockstep':  # the loop continues at that stamp
            live.wait_until(lambda: live.torques, 'a torque')
            stamps = [message.stamp_ns for message in decoded(live, ACCEPTED, messages.WRENCH)]
            assert stamps == [*range(last.stamp_ns, last.stamp_ns + len(stamps) * STEP_NS,
                                     STEP_NS)]
        words = live.end()
        first = decoded(live, COMMITTED, messages.ODOMETRY)[0]
    assert first.stamp_ns == last.stamp_ns
    np.testing.assert_array_equal(first.values, last.values)
    assert words.splitlines()[0].split(': ', 1)[1].startswith(
        f'starts at {last.stamp_ns} ns from the checkpoint {file}: attitude')
    assert re.search(rf'WARN.* continues from the checkpoint {file}, after it was down for '
                     r'[0-9.]+ s: no torque acts in between', words)


def test_a_checkpoint_from_the_future_is_rejected_and_stays(tmp_path, domain):
    file = tmp_path / 'checkpoint.json'
    arguments = ('-p', f'checkpoint:={file}', '-p', 'start_time:=2000000000000000000')
    with driven('lockstep', domain, *arguments) as (live, _):
        live.publish(2_000_000_000 * SECOND, '', [0.01, 0.0, 0.0])
        live.wait_until(lambda: live.received[ATTITUDE], 'a state')
    before = file.read_bytes()
    with pytest.raises(scene.InputError, match=f'^checkpoint {file}: expected a state from before '
                       r'[0-9]+ ns, the present time, found one from 2000000000[0-9]+ ns'):
        Session(TUMBLER, domain, *arguments).__enter__()
    assert file.read_bytes() == before
