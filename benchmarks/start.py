"""
Time from the first import to the first result, in a process that does nothing else.

    python benchmarks/start.py

Prints seconds: one motion under torque, one free of it. Where NUMBA_CACHE_DIR names an empty
folder everything is compiled.
"""

import time

began = time.perf_counter()

from rigid_body_ros import propagate, RigidBody, State, TorqueLog  # noqa: E402

body = RigidBody.from_moments(1.0, 2.0, 3.0)
start = State(0, angular_velocity=(0.3, -0.2, 0.5))
log = TorqueLog([0, 1_000_000], [[0.1, 0.2, 0.3], [0.3, 0.2, 0.1]])
propagate(body, start, log, at=[3_000_000])
propagate(body, start, at=[3_000_000])
print(time.perf_counter() - began)
