"""Makes an honest agent look like the liar."""

from __future__ import annotations

from typing import Literal

import numpy as np

from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.attacks.adaptive.base import AdaptiveAttack, Lies, Moment
from mast_zenoh.attacks.adaptive.chosen import ChosenObjects
from mast_zenoh.attacks.coverage import boxes_of
from mast_zenoh.attacks.surroundings import AgentSensor

#: m; an object this near to the framed agent is the agent itself.
SELF_M = 4.0
#: m, by which a moved object is away from where the framed agent reports it.
OFFSET_M = 4.0
#: Cost of one more honest witness, in m of distance from the framed agent.
WITNESS_M = 1000.0


class Framing(AdaptiveAttack):
    """Contradicts one honest agent, about objects that few others see.

    Objects in the view of both the victim and the framed agent are hidden, or moved, those with the fewest further
    honest witnesses first; on the view's wire the victim also claims free space in their places. To the command centre
    the framed agent then reports objects through which others see. Several adversaries with the same `framed` confirm
    one another. The attacker knows sensors and routes. Source: disputes that turn trust against an honest agent,
    TrustFlip (arXiv 2605.22122), which arranges real objects instead.

    framed:  name of the honest agent; None: the one nearest to the victim when the attack begins, but not the ego
    action:  "hide" or "move" (by 4 m, away from the framed agent)
    budget:  lies per second, so the number of objects
    start_s: s of scene time at which the attack begins
    """

    def __init__(
        self,
        *,
        framed: str | None = None,
        action: Literal["hide", "move"] = "hide",
        budget: float = 2.0,
        start_s: float = 4.0,
    ) -> None:
        super().__init__(budget=budget, start_s=start_s)
        self._framed, self._action = framed, action
        self._chosen = ChosenObjects(self._follower, self.budget, self.numbers)

    def rest(self) -> None:
        self._chosen.clear()

    def lie(self, moment: Moment) -> Lies:
        sensor = self._framed_sensor(moment)
        cost = np.full(len(moment.seen), np.inf) if sensor is None else _cost(moment, sensor)
        numbers, rows = self._chosen.update(moment, cost)
        if self._action == "hide" or sensor is None:
            return Lies(hidden=rows, hidden_number=numbers)
        real = moment.seen.select(rows)
        return Lies(changed=rows, claims=_moved_away(real, sensor, moment.time_s), changed_number=numbers)

    def _framed_sensor(self, moment: Moment) -> AgentSensor | None:
        """The sensor of the framed agent; None if nobody can be framed."""
        sensors = self._surroundings.sensors
        if self._framed is None:
            ego = next(iter(sensors), None)
            others = [name for name in sensors if name not in (*self._surroundings.victims, ego)]
            distance = [
                float(np.hypot(*(sensors[name].route.at(moment.time_s)[0] - moment.position)[:2])) for name in others
            ]
            self._framed = others[int(np.argmin(distance))] if others else None
        return None if self._framed is None else sensors.get(self._framed)


def _cost(moment: Moment, sensor: AgentSensor) -> Floats:
    """(n,) m from the framed agent, more for further witnesses; infinite if it or the victim does not see an object."""
    seen, coverage = moment.seen, moment.coverage
    boxes = boxes_of(seen)
    pose = sensor.route.at(moment.time_s)
    offset = seen.position[:, :2] - pose[0][:2]
    distance = np.hypot(offset[:, 0], offset[:, 1])
    own = moment.position[:2] - seen.position[:, :2]
    both = coverage.visible(sensor.view(*pose), boxes, boxes) & coverage.visible(moment.view, boxes)
    both &= (distance > SELF_M) & (np.hypot(own[:, 0], own[:, 1]) > SELF_M)
    return np.where(both, distance + WITNESS_M * coverage.honest_viewers(seen, both), np.inf)


def _moved_away(real: ObjectStates, sensor: AgentSensor, time_s: float) -> ObjectStates:
    """The objects, OFFSET_M farther from a sensor's agent."""
    away = real.position - sensor.route.at(time_s)[0]
    away[:, 2] = 0.0
    length = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-6)
    return real.with_(position=real.position + away * (OFFSET_M / length)[:, None])
