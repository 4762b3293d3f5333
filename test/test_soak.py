"""A long run at 1 kHz, cut short: benchmarks/soak.py."""

import pytest

pytest.importorskip('rclpy', reason='ROS 2 (rclpy) is not installed')

import soak

pytestmark = [pytest.mark.ros, pytest.mark.slow]


def test_every_torque_is_accounted_for_memory_is_flat_and_live_is_replay(domain):
    lines, _ = soak.soak(20.0, domain)
    assert not [line for line in lines if not (line.holds or line.name == soak.PROCESSOR_TIME)]
