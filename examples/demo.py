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
from rigid_body_ros import recording
from rigid_body_ros.commands import main as commands
from rigid_body_ros.runtime import interrupts
from tqdm import tqdm

ROOT = Path(__file__).resolve().parent.parent
CONFIG, RECORDINGS, OUTPUT = ROOT / 'config', ROOT / 'test' / 'recordings', ROOT / 'demo'
STATION, LIVE, REPORT = RECORDINGS / 'iss.mcap', OUTPUT / 'live.mcap', OUTPUT / 'report.html'
#: Simulated seconds per second of wall time.
SPEED = 6.0
BEGAN = time.monotonic()


def main() -> None:
    OUTPUT.mkdir(exist_ok=True)
    say("replay eight hours of the Space Station, and compare with NASA's states")
    scene = '--scene', CONFIG / 'iss.yaml'
    run('attitude_replay', STATION, *scene, '-o', OUTPUT / 'iss.mcap', '--plot',
        OUTPUT / 'iss.png', '--overwrite')
    run('attitude_compare', STATION, *scene, '--measured', '/truth/attitude')
    say(f'run the node on a minute of torques over DDS, at {SPEED:g} times real time')
    run_live()
    say('replay the torques that the node accepted, and compare bit for bit')
    accepted = LIVE, '--scene', OUTPUT / 'live.yaml', '--topic', ACCEPTED
    run('attitude_replay', *accepted, '-o', OUTPUT / 'replay.mcap', '--plot',
        OUTPUT / 'replay.png', '--report', REPORT, '--overwrite')
    run('attitude_replay', *accepted, '--verify', LIVE)
    say(f'to watch the body move, open {os.path.relpath(REPORT)} in a browser')
    if os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY'):
        webbrowser.open(REPORT.as_uri())


def say(step):
    """Print a step, with the time since the start."""
    print(f'\n[{time.monotonic() - BEGAN:4.1f} s] {step}\n', flush=True)


def run(command, *arguments):
    """Run a command as from the command line; end the demo if it fails."""
    words = [os.path.relpath(word) if isinstance(word, Path) else word for word in arguments]
    print('$', command, *words, flush=True)
    if status := getattr(commands, command)(words):
        sys.exit(status)


def run_live():
    """Stream the recording into the node and record its outputs."""
    source = recording.read(RECORDINGS / 'tumbler.mcap')
    count, start_ns = len(source.stamps_ns), int(source.stamps_ns[0])
    domain = int(os.environ.get('ROS_DOMAIN_ID', 1 + os.getpid() % 100))
    with LiveSession(CONFIG / 'tumbler.yaml', domain, *RELIABLE, '-p', 'use_sim_time:=true',
                     '-p', f'start_time:={start_ns}') as live:
        while not live.received[COMMITTED]:  # the start state
            live.set_clock(start_ns)
            live.spin(0.05)
        print(f'The node is up. Streaming {count} torques.', flush=True)
        began = time.monotonic()
        torques = zip(source.stamps_ns.tolist(), source.frame_ids, source.values[:, 3:])
        for stamp_ns, frame_id, torque in tqdm(torques, 'streaming', count, unit=' torques',
                                               leave=False, disable=None):
            live.set_clock(stamp_ns)
            live.publish(stamp_ns, frame_id, torque)
            due = began + (stamp_ns - start_ns) * 1e-9 / SPEED
            live.spin(max(1e-3, due - time.monotonic()))
        live.wait_for_torques(count)
        live.dump_parameters(OUTPUT / 'live.yaml')
        status = live.stop()
        live.write(LIVE)
        print(f'The node accepted {len(live.torques)} of {count} torques, and exited with status '
              f'{status}.')


if __name__ == '__main__':
    try:
        with interrupts.deferred(until_exit=True):  # rclpy can drop the exception of Ctrl-C
            main()
    except KeyboardInterrupt:
        print('demo: interrupted', file=sys.stderr)
        sys.exit(130)  # as shells report SIGINT
