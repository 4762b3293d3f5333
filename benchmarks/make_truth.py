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
Write truth.json: the final attitudes of the problems with 30 digits.

    python benchmarks/make_truth.py [PROBLEM ...]

P4 takes some minutes, because it has 60 000 torques; the others take seconds.
"""

import json
import sys

from mpmath import mp
import numpy as np
from problems import IDENTITY, PROBLEMS, TRUTH, truth


def final_attitude(problem):
    """Return the attitude at the end; use the closed form if there is no torque."""
    tensor = np.diag(problem.moments)
    if not len(problem.torques):
        return truth.free(tensor, IDENTITY, problem.rates, problem.end_ns)[0]
    torques = [(problem.hold_ns, torque, False) for torque in problem.torques]
    return truth.series(tensor, IDENTITY, problem.rates, torques, digits=40)[-1][0]


def main():
    """Compute the given problems, or all, and keep the results of the others."""
    recorded = json.loads(TRUTH.read_text()) if TRUTH.exists() else {}
    for name in sys.argv[1:] or PROBLEMS:
        attitude = [mp.nstr(x, 30) for x in final_attitude(PROBLEMS[name])]
        recorded[name] = {'fingerprint': PROBLEMS[name].fingerprint, 'attitude': attitude}
        TRUTH.write_text(json.dumps(recorded, indent=2) + '\n')


if __name__ == '__main__':
    main()
