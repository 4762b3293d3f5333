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

"""Commands of the package in processes of their own, and what these processes use."""

import os
from pathlib import Path
import subprocess
import sys
import time

ROOT = Path(__file__).resolve().parent.parent
SCENE, RECORDING = ROOT / 'config' / 'tumbler.yaml', ROOT / 'test' / 'recordings' / 'tumbler.mcap'


def command(name, *arguments):
    """Return the words that run a command with these arguments."""
    return [sys.executable, '-c', f'import sys; from rigid_body_ros.commands.main import {name}; '
            f'sys.exit({name}())', *map(str, arguments)]


def measure(name, *arguments):
    """Run a command, hiding its summary; return the time, s, and the peak memory, bytes."""
    began = time.perf_counter()
    with subprocess.Popen(command(name, *arguments), stdout=subprocess.DEVNULL) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f'{name}: exit status {process.returncode}')
    return time.perf_counter() - began, usage.ru_maxrss * 1024


def domain():
    """Return the ROS domain of the environment, or one that other processes hardly use."""
    return int(os.environ.get('ROS_DOMAIN_ID', 1 + os.getpid() % 100))


def isolate():
    """Let the nodes of this process and of its children receive messages of each other only."""
    os.environ |= {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_DOMAIN_ID': str(domain())}


def processor_time(process):
    """Return the processor time so far, s, of a process of psutil."""
    times = process.cpu_times()
    return times.user + times.system
