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

"""The kernels that Python calls."""

from rigid_body_ros.kernels import jit, lanes
from rigid_body_ros.kernels.elementary_arrays import (
    fill_arctangents,
    fill_exponentials,
    fill_sines_cosines,
)
from rigid_body_ros.kernels.euler_angles import fill_angles, fill_attitudes, make_rows_continuous
from rigid_body_ros.kernels.extent import extent
from rigid_body_ros.kernels.interpolation import fill_cubics, fill_slopes
from rigid_body_ros.kernels.loop import run
from rigid_body_ros.kernels.many_loop import run_each
from rigid_body_ros.kernels.messages import decode, find_transforms, scan
from rigid_body_ros.kernels.principal_axes import fill_components
from rigid_body_ros.kernels.rotors import momentum_at
from rigid_body_ros.kernels.summation import sum_logs, sum_rows
from rigid_body_ros.kernels.taylor import step_angle
from rigid_body_ros.kernels.tensors import fill_constants
from rigid_body_ros.kernels.triangles import fill_triangle

__all__ = ['LANES', 'decode', 'extent', 'fill_angles', 'fill_arctangents', 'fill_attitudes',
           'fill_components', 'fill_constants', 'fill_cubics', 'fill_exponentials',
           'fill_sines_cosines', 'fill_slopes', 'fill_triangle', 'find_transforms',
           'make_rows_continuous', 'momentum_at', 'run', 'run_each', 'scan', 'step_angle',
           'sum_logs', 'sum_rows']

#: Runs in a group: plain Python has no lanes.
LANES = lanes.LANES if jit.COMPILES else 1
