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

"""Collect the inputs that the runs of an ensemble depend on."""

from __future__ import annotations

from dataclasses import asdict
import hashlib
from importlib.metadata import version
import json
from typing import Any

from rigid_body_ros.ensemble.runs import Ensemble
from rigid_body_ros.propagation import Problem
from rigid_body_ros.runtime.fingerprint import fingerprint
from rigid_body_ros.scene import Scene


def identity_of(ensemble: Ensemble, scene: Scene, times: float | str) -> dict[str, Any]:
    """Return all inputs of the runs as JSON types; runs with equal inputs have equal results."""
    values, controller = json.dumps(dict(scene.values), sort_keys=True), ensemble.controller
    # Convert to JSON and back, so that the result can be compared with the content of a file.
    return dict(json.loads(json.dumps({
        'seed': ensemble.seed, **_varied(ensemble),
        'scene': f'sha256:{hashlib.sha256(values.encode()).hexdigest()}',
        'recording': recording_hash(ensemble.problem),
        'start_ns': ensemble.problem.start.time_ns, 'end_ns': ensemble.end_ns, 'times': times,
        **({'controller': f'{controller.name} {controller.digest}'} if controller else {}),
        'versions': {**fingerprint(), 'scipy': version('scipy')}})))


def recording_hash(problem: Problem) -> str:
    """Return a hash of all recorded torques: those on the body, the rotors and the wheels."""
    torques = hashlib.sha256()
    for log in problem.sources:
        for array in (log.times_ns, log.torques, log.in_space):
            torques.update(array.tobytes())
        torques.update(log.interpolation.encode())
    if problem.efforts:
        for array in (problem.efforts.times_ns, problem.efforts.efforts):
            torques.update(array.tobytes())
    return f'sha256:{torques.hexdigest()}'


def _varied(ensemble: Ensemble) -> dict[str, Any]:
    fitted = ensemble.fitted
    if fitted is None:
        return {'vary': [asdict(one) for one in ensemble.dispersions]}
    distribution = fitted.covariance.tobytes() + fitted.guess_attitude.tobytes()
    return {'vary': dict(fitted.estimates),
            'covariance': f'sha256:{hashlib.sha256(distribution).hexdigest()}'}
