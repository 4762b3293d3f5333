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
Fit an inertia to measured rates with PyTorch.

`attitude_identify` fits an inertia too, and says how certain it is. With PyTorch, the motion can
be part of a larger model, such as a network that computes the torques.

    pip install torch
    python examples/fit_inertia_torch.py
"""

import numpy as np
from rigid_body_ros import Problem, propagate, RigidBody, State, TorqueLog
from rigid_body_ros.autodiff import torch_motion
import torch

TRUE = RigidBody.from_moments(0.045, 0.120, 0.140, ixy=0.002, ixz=-0.001, iyz=0.003)
GUESS = RigidBody.from_moments(0.06, 0.10, 0.12)
START = State(angular_velocity=(0.1, 0.3, -0.2))
NOISE = 1e-4  # rad/s, standard deviation
AT_NS = np.arange(60) * 10 ** 9


def inertia(factor):
    """Return a tensor of inertia, which is physical for any factor, shape (3, 3), of moments."""
    moments = factor @ factor.T  # the integral of x x^T over the mass
    return moments.trace() * torch.eye(3) - moments


def main():
    torch.set_default_dtype(torch.float64)
    random = np.random.default_rng(1)
    log = TorqueLog(AT_NS, 1e-3 * random.normal(size=(60, 3)))
    exact = propagate(TRUE, START, log, at=AT_NS).angular_velocity
    measured = torch.tensor(exact + NOISE * random.normal(size=exact.shape))

    motion = torch_motion(Problem(GUESS, START, log), at=AT_NS)
    moments = 0.5 * np.trace(GUESS.inertia) * np.eye(3) - GUESS.inertia
    factor = torch.tensor(np.linalg.cholesky(moments), requires_grad=True)
    optimizer = torch.optim.LBFGS([factor], max_iter=200, line_search_fn='strong_wolfe')

    def misfit():
        optimizer.zero_grad()
        _, rate = motion({'inertia': inertia(factor)})
        loss = ((rate - measured) / NOISE).square().mean()
        loss.backward()
        return loss

    optimizer.step(misfit)
    fitted = inertia(factor).detach().numpy()
    print('largest error, guess   ', f'{np.abs(GUESS.inertia - TRUE.inertia).max():.2g} kg m^2')
    print('largest error, fitted  ', f'{np.abs(fitted - TRUE.inertia).max():.2g} kg m^2')
    print('mean square misfit     ', f'{misfit().item():.3f} of the variance of the noise')


if __name__ == '__main__':
    main()
