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
Send more torques than the node can process, and account for each.

    python benchmarks/overload.py [--seconds 30] [--rate 5000]

A separate process sends the torques of `soak.py`, but half of them late. Two more processes keep
the processors busy. Meanwhile the node must respond to service calls and publish diagnostics.
Afterwards it must return to real time. A second load ends with SIGINT, and a replay of the log
must reproduce the committed states.
"""

import argparse
from contextlib import contextmanager
from pathlib import Path
import select
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

import numpy as np
from processes import domain
from rcl_interfaces.srv import GetParameters
from rclpy.time import Time
from rigid_body_ros import messages
from rigid_body_ros.live import events

sys.path.extend(str(Path(__file__).resolve().parent.parent / name)
                for name in ('examples', 'test'))
from live import replayed, TUMBLER  # noqa: E402, I100
from live_session import LiveSession  # noqa: E402
from soak import DELAYED, Line, Plan, printed, replayed_bits, SHARES  # noqa: E402

#: s; duration of the load before SIGINT.
LAST = 3.0
#: s; limits for a service call, between two diagnostics, and for the return to real time.
SERVICE, DIAGNOSIS, RECOVERY = 1.0, 2.0, 5.0
#: Fraction of the torques that are late.
LATE = 0.5


def send(rate, seconds):
    """Send torques, and print their number and the time, ns, of the second to last."""
    from geometry_msgs.msg import WrenchStamped
    import rclpy
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    rclpy.init(args=[])
    node = rclpy.create_node('overload')
    publisher = node.create_publisher(WrenchStamped, 'torque', QoSProfile(
        depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT))
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    time.sleep(0.5)  # the node must discover this publisher first
    plan = Plan(seconds, rate, node.get_clock().now().nanoseconds, {**SHARES, DELAYED: LATE})
    for row, due_ns in enumerate(plan.due_ns.tolist()):
        time.sleep(max(0, due_ns - node.get_clock().now().nanoseconds) * 1e-9)
        publisher.publish(plan.message(row))
    end_ns = node.get_clock().now().nanoseconds
    # One more torque, which reveals a gap before it.
    time.sleep(1.0)
    publisher.publish(messages.wrench(node.get_clock().now().nanoseconds, '', [0.01, 0.0, 0.0]))
    print(len(plan) + 1, end_ns, flush=True)
    time.sleep(1.0)


@contextmanager
def started(*command, **options):
    """Run a process within the context, and end it."""
    with subprocess.Popen([sys.executable, *map(str, command)], **options) as process:
        try:
            yield process
        finally:
            process.kill()


@contextmanager
def busy():
    """Keep both processors busy."""
    spin = ('-c', 'while True: pass')
    with started(*spin), started(*spin):
        yield


@contextmanager
def load(live, rate, seconds):
    """Send torques to the node of a session."""
    with started(__file__, '--send', '--rate', rate, '--seconds', seconds, env=live.environment,
                 stdout=subprocess.PIPE, text=True) as sender:
        yield sender


def overload(rate, seconds, domain):
    """
    Overload the node for some seconds, in a ROS domain.

    Returns
    -------
    list of Line

    """
    with TemporaryDirectory() as folder, LiveSession(TUMBLER, domain) as live:
        live.disconnect()
        with busy(), load(live, rate, seconds) as sender:
            latency = _longest_service(live, sender)
            sent, end_ns = map(int, sender.stdout.readline().split())
        recovery = _recovery(live, end_ns)
        counts, _, _ = live.diagnosis('torques')
        with busy(), load(live, rate, 10 * LAST):
            live.spin(LAST)
            began = time.monotonic()
            live.dump_parameters(Path(folder, 'live.yaml'))
            status = live.stop()
            ending = time.monotonic() - began
        run = replayed(Path(folder), live)
    stamps = [_stamp_ns(array) * 1e-9 for array in live.diagnostics]
    rejected = sum(counts[events.rejections(cause)] for cause in events.CAUSES)
    received, lost, applied = map(counts.get, (events.RECEIVED, events.LOST, events.APPLIED))
    print(f'sent {sent}: applied {applied}, rejected {rejected}, {events.LOST} {lost}; '
          f'ended in {ending:.2g} s')
    return [Line('sent, received or lost', received + lost, sent),
            Line('received, applied or rejected', applied + rejected, received),
            Line(events.WAITING, counts[events.WAITING], 0),
            Line('longest service call, s', latency, SERVICE, True),
            Line('longest time between diagnostics, s', max(np.diff(stamps)), DIAGNOSIS, True),
            Line('until real time again, s', recovery, RECOVERY, True),
            Line('exit status', status, 0),
            replayed_bits(run)]


def _longest_service(live, sender):
    longest, request = 0.0, {'names': ['solver']}
    while not _has_printed(sender):
        began = time.monotonic()
        live.call(GetParameters, 'get_parameters', **request)
        longest = max(longest, time.monotonic() - began)
        live.spin(0.5)
    return longest


def _has_printed(process):
    return bool(select.select([process.stdout], [], [], 0.0)[0])


def _recovery(live, end_ns):
    # Judge by the stamps of the node, because this process has its own queue.
    def caught_up():
        return [array for array in live.diagnostics if _stamp_ns(array) > end_ns
                and _is_in_real_time(array)][1:]
    live.wait_until(caught_up, 'real time')
    return (_stamp_ns(caught_up()[0]) - end_ns) * 1e-9


def _is_in_real_time(diagnosis):
    torques, motion = diagnosis.status
    waiting, = (int(pair.value) for pair in torques.values if pair.key == events.WAITING)
    return not waiting and events.MISSED not in motion.message


def _stamp_ns(diagnosis):
    return Time.from_msg(diagnosis.header.stamp).nanoseconds


def main():
    """Print the table, and mark values beyond their limits."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--rate', type=int, default=5000, help='Hz')
    parser.add_argument('--seconds', type=float, default=30.0)
    parser.add_argument('--send', action='store_true', help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.send:
        send(arguments.rate, arguments.seconds)
        return 0
    return printed(overload(arguments.rate, arguments.seconds, domain()))


if __name__ == '__main__':
    sys.exit(main())
