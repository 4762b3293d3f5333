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

"""The parameters of actuators, which turn the commands on some torque topics into torques."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigid_body_ros.common.errors import InputError, listed, quoted
from rigid_body_ros.common.times import LONGEST
from rigid_body_ros.mechanics.actuator import Actuator
from rigid_body_ros.runtime.parameters import BIG, Parameter

_TOPICS, _DELAY, _LAG = 'actuator.topics', 'actuator.delay', 'actuator.time_constant'
_LIMITS = tuple(f'actuator.limit.{axis}' for axis in 'xyz')
PARAMETERS = (
    Parameter(_TOPICS, [], '', 'the torque_topics that carry actuator commands; an actuator has a '
              'delay, a limit and a lag'),
    Parameter(_DELAY, 0.0, 's', 'time from the stamp of an actuator command until the command '
              'takes effect', (0.0, LONGEST)),
    Parameter(_LAG, 0.0, 's', 'time constant of the first-order lag with which the actuator '
              'torque follows its command; 0 means no lag, and any other value must be at least '
              '1e-9',
              (0.0, LONGEST)),
    *(Parameter(name, 0.0, 'N m', 'largest torque about this axis, in the axes (body or space) of '
                'the command; larger commands are clipped; 0 means no limit', (0.0, BIG))
      for name in _LIMITS),
)


def actuators_of(values: Mapping[str, Any]) -> tuple[Actuator | None, ...] | None:
    """
    Return the actuator for each topic in `torque_topics`, or None if no topic has one.

    Raises
    ------
    InputError
        A topic in `actuator.topics` is not a torque topic, or is given twice; `actuator.topics`
        is empty although other `actuator` parameters are set; or the time constant is too short.

    """
    topics, given = values[_TOPICS], [name.removeprefix('/') if isinstance(name, str) else name
                                      for name in values[_TOPICS]]
    known = [str(name).removeprefix('/') for name in values['torque_topics']]
    for number, name in enumerate(given):
        if name not in known:
            raise InputError(f'{_TOPICS}: expected topics among torque_topics '
                             f'({listed(values["torque_topics"])}), found '
                             f'{quoted(topics[number])}')
        if name in given[:number]:
            raise InputError(f'{_TOPICS}: expected each topic once, found {topics[number]!r} '
                             'twice')
    for name in (_DELAY, _LAG, *_LIMITS):
        if values[name] and not given:
            raise InputError(f'{_TOPICS}: expected at least one topic, because {name} is '
                             f'{values[name]:g}, found an empty list')
    if not given:
        return None
    try:
        found = Actuator(values[_DELAY], values[_LAG], [values[name] for name in _LIMITS])
    except ValueError as error:
        raise InputError(f'{_LAG}: {error}') from error
    return tuple(found if name in given else None for name in known)
