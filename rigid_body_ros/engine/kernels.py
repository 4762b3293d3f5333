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

"""Load the kernels that Python code calls."""

from rigid_body_ros.engine.binding import bind
from rigid_body_ros.kernels import (
    arrays,
    euler_angles,
    interpolation,
    lags,
    loop,
    many_loop,
    messages,
    principal_axes,
    summation,
    taylor,
    tensors,
)

add_lag = bind(lags.add_lag)
decode = bind(messages.decode)
extent = bind(arrays.extent)
fill_angles = bind(euler_angles.fill_angles)
fill_arctangents = bind(arrays.fill_arctangents)
fill_attitudes = bind(euler_angles.fill_attitudes)
fill_components = bind(principal_axes.fill_components)
fill_constants = bind(tensors.fill_constants)
fill_cubics = bind(interpolation.fill_cubics)
fill_exponentials = bind(arrays.fill_exponentials)
fill_sines_cosines = bind(arrays.fill_sines_cosines)
fill_slopes = bind(interpolation.fill_slopes)
fill_triangle = bind(arrays.fill_triangle)
find_transforms = bind(messages.find_transforms)
lag_slopes = bind(lags.lag_slopes)
make_rows_continuous = bind(euler_angles.make_rows_continuous)
momentum_at = bind(summation.momentum_at)
run = bind(loop.run)
run_each = bind(many_loop.run_each)
run_tangents = bind(loop.run_tangents)
scan = bind(messages.scan)
step_angle = bind(taylor.step_angle)
sum_logs = bind(summation.sum_logs)
sum_rows = bind(summation.sum_rows)
