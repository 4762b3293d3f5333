"""Turn torques into attitude: the rotation of one rigid body, exact to rounding."""

from rigid_body_ros.body import RigidBody, State
from rigid_body_ros.propagate import propagate, Propagator, Trajectory
from rigid_body_ros.torque import TorqueLog

__all__ = ['Propagator', 'RigidBody', 'State', 'TorqueLog', 'Trajectory', 'propagate']
