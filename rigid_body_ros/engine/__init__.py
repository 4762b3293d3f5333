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

"""The interface to the compiled kernels, and the data layouts that kernels and Python share."""

from rigid_body_ros.engine import kernels
from rigid_body_ros.kernels import (
    body_layout,
    interpolation,
    layout,
    many_loop,
    motion_layout,
    state_layout,
    tangents,
    tensor,
    tensors,
)
from rigid_body_ros.kernels.fields import FIELDS
from rigid_body_ros.kernels.fields import MOST as MOST_FIELDS
from rigid_body_ros.kernels.friction import FREE
from rigid_body_ros.kernels.lags import CommandChanges, EXPIRY
from rigid_body_ros.kernels.lags import MOST as MOST_LAGS
from rigid_body_ros.kernels.layout import FASTEST, Friction, Lags, Rows, Samples, Sums, Terms
from rigid_body_ros.kernels.messages import Contents, RawMessages
from rigid_body_ros.kernels.state_layout import MOST_WHEELS

__all__ = ['EXPIRY', 'FASTEST', 'FIELDS', 'FREE', 'MOST_FIELDS', 'MOST_LAGS', 'MOST_WHEELS',
           'CommandChanges', 'Contents', 'Friction', 'Lags', 'RawMessages', 'Rows', 'Samples',
           'Sums', 'Terms', 'body_layout', 'interpolation', 'kernels', 'layout', 'many_loop',
           'motion_layout', 'state_layout', 'tangents', 'tensor', 'tensors']
