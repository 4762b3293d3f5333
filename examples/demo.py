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

"""Replay the Space Station, run the node on a live stream of torques, compare live and replay."""

from __future__ import annotations

import os
from pathlib import Path
import sys
import time
import webbrowser

from live_session import ACCEPTED, COMMITTED, LiveSession, RELIABLE
import numpy as np
from rigid_body_ros import messages, recording, so3
from rigid_body_ros.commands.main import attitude_replay
from rigid_body_ros.runtime import interrupts
from tqdm import tqdm

ROOT = Path(__file__).resolve().parent.parent
CONFIG, RECORDINGS, OUTPUT = ROOT / 'config', ROOT / 'test' / 'recordings', ROOT / 'demo'
#: Simulated seconds per second of wall time.
SPEED = 6.0
BEGAN = time.monotonic()


def main() -> int:
    OUTPUT.mkdir(exist_ok=True)
    say('replay eight hours of the Space Station, and compare with NASA\'s states')
    replay(RECORDINGS / 'iss.mcap', CONFIG / 'iss.yaml', OUTPUT / 'iss.mcap')
    compare_with_nasa()
    say(f'run the node on a minute of torques over DDS, at {SPEED:g} times real time')
    run_live()
    say('replay the torques that the node accepted, and compare bit for bit')
    replay(OUTPUT / 'live.mcap', OUTPUT / 'live.yaml', OUTPUT / 'replay.mcap', '--topic', ACCEPTED,
           '--report', OUTPUT / 'report.html')
    status = compare_with_live()
    show(OUTPUT / 'report.html')
    return status


def say(step):
    """Print a step, with the time since the start."""
    print(f'\n[{time.monotonic() - BEGAN:4.1f} s] {step}\n', flush=True)


def show(page):
    """Open a page, if there is a display and a browser; otherwise, print where it is."""
    say(f'to watch the body move, open {os.path.relpath(page)} in a browser')
    if os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY'):
        webbrowser.open(page.as_uri())


def replay(recording_path, scene, output, *arguments):
    """Run attitude_replay as the command line does."""
    words = [recording_path, '--scene', scene, '-o', output, '--plot', output.with_suffix('.png'),
             '--overwrite', *arguments]
    status = attitude_replay([os.path.relpath(word) if isinstance(word, Path) else word
                              for word in words])
    if status:
        sys.exit(status)


def compare_with_nasa():
    """Print the difference between the replay and the states logged by NASA's JEOD."""
    ours = recording.read(OUTPUT / 'iss.mcap', '/attitude', messages.QUATERNION)
    logged = recording.read(RECORDINGS / 'iss.mcap', '/truth/attitude', messages.QUATERNION)
    rows = np.searchsorted(ours.stamps_ns, logged.stamps_ns)
    apart = so3.angle_between(ours.values[rows], logged.values)
    print('\nNASA JEOD RUN_9B, logged at    attitude error of the replay')
    for stamp_ns, angle in zip(logged.stamps_ns - logged.stamps_ns[0], apart):
        print(f'{stamp_ns * 1e-9:12.0f} s               {angle:10.1e} rad')


def run_live():
    """Stream the recording into the node and record its outputs."""
    source = recording.read(RECORDINGS / 'tumbler.mcap')
    start_ns, end_ns = source.stamps_ns[[0, -1]].tolist()
    domain = int(os.environ.get('ROS_DOMAIN_ID', 1 + os.getpid() % 100))
    with LiveSession(CONFIG / 'tumbler.yaml', domain, *RELIABLE, '-p', 'use_sim_time:=true',
                     '-p', f'start_time:={start_ns}') as live:
        while not live.received[COMMITTED]:  # the start state
            live.set_clock(start_ns)
            live.spin(0.05)
        print(f'The node is up. Streaming {len(source.stamps_ns)} torques.', flush=True)
        began, now_ns, row = time.monotonic(), start_ns, 0
        with tqdm(total=len(source.stamps_ns), desc='streaming', unit=' torques', leave=False,
                  disable=None) as bar:
            while now_ns < end_ns:
                now_ns = min(start_ns + round((time.monotonic() - began) * SPEED * 1e9), end_ns)
                live.set_clock(now_ns)
                while row < len(source.stamps_ns) and source.stamps_ns[row] <= now_ns:
                    live.publish(int(source.stamps_ns[row]), source.frame_ids[row],
                                 source.values[row, 3:])
                    row += 1
                    bar.update()
                live.spin(0.01)
        live.wait_for_torques(row)
        live.dump_parameters(OUTPUT / 'live.yaml')
        status = live.stop()
        live.write(OUTPUT / 'live.mcap')
        print(f'attitude_node exited with status {status}; it accepted '
              f'{len(live.torques)} of {row} torques and published '
              f'{len(live.received[COMMITTED])} committed states')


def compare_with_live():
    """Print at how many stamps the replay and the committed states are equal bit for bit."""
    source = recording.read(RECORDINGS / 'tumbler.mcap')
    committed = recording.read(OUTPUT / 'live.mcap', COMMITTED, messages.ODOMETRY)
    attitude = recording.read(OUTPUT / 'replay.mcap', '/attitude', messages.QUATERNION)
    rates = recording.read(OUTPUT / 'replay.mcap', '/angular_velocity', messages.VECTOR3)
    _, rows, live = np.intersect1d(attitude.stamps_ns, committed.stamps_ns, return_indices=True)
    states = committed.values[live]
    same = np.all(attitude.values[rows] == states[:, messages.ORIENTATION], axis=1)
    same &= np.all(rates.values[rows] == states[:, messages.ANGULAR_VELOCITY], axis=1)
    print(f'\nLive and replay agree bit for bit at {same.sum()} of {same.size} stamps.')
    print(f'The recordings (.mcap) and plots (.png) are in {os.path.relpath(OUTPUT)}.')
    return 0 if same.all() and same.size == len(source.stamps_ns) else 1


if __name__ == '__main__':
    try:
        with interrupts.deferred(until_exit=True):  # rclpy can drop the exception of Ctrl-C
            status = main()
    except KeyboardInterrupt:
        print('demo: interrupted', file=sys.stderr)
        status = 130  # as shells report SIGINT
    sys.exit(status)
