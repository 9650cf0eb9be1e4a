"""Attacks that turn on disputes: one word against another, where few agents or only some of them look."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, canonical_order
from mast_zenoh.attacks.adaptive import Budget, Lies, Moment
from mast_zenoh.attacks.coordination import CLUSTER_M, Coordinator
from mast_zenoh.attacks.knowledge import Trust, TrustWatch
from mast_zenoh.attacks.phantoms import AHEAD_S, PhantomAttack
from mast_zenoh.attacks.real_objects import SELF_M, WITNESS_M, Framing
from mast_zenoh.attacks.regions import FewWitnesses
from mast_zenoh.attacks.selection import Selection
from mast_zenoh.attacks.surroundings import Coverage, Surroundings, boxes_of
from mast_zenoh.attacks.targets import Targets
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.integrity.base import SUSPENDED


class OpenDispute(PhantomAttack):
    """Invents many standing cars where at most one honest agent looks, and lies about nothing else.

    Each car is one agent's word against another's. A command centre that counts such a dispute against neither (the
    third viewer is missing) keeps the liar, and has to keep or to drop all objects with two viewers. A car is withdrawn
    a second before another honest agent would look at it.

    Threat model: the attacker controls one agent's tracks and view. It knows the buildings, and the sensors and routes
    of all agents; with the picture, objects that it does not see itself; with the trust, it withdraws all cars while
    the trust in its agent is more than `tolerance` below its highest value.
    Source: our own, against rules that leave disputed places out of the trust, such as TrustReflect, the cure proposed
    with TrustFlip (arXiv 2605.22122, abstract only).

    witnesses: largest number of honest agents that look at a car, 0 or more
    tolerance: 0 to 1, fall of the trust that is accepted
    budget:    lies per second, so the number of cars
    start_s:   s of scene time at which the attack begins
    """

    def __init__(
        self, *, witnesses: int = 1, tolerance: float = 0.05, budget: float = 8.0, start_s: float = 4.0
    ) -> None:
        super().__init__(budget=budget, start_s=start_s, speed_mps=0.0)
        check("0 or more", witnesses=witnesses)
        self._witnesses = witnesses
        self.region = FewWitnesses(witnesses)
        self._watch = TrustWatch(tolerance)

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:
        self._watch.hear(trust, self._surroundings.victims)

    def lie(self, moment: Moment) -> Lies:
        if self._watch.fallen:
            self.rest()
            return Lies()
        return super().lie(moment)

    def _given_up(self, moment: Moment, phantoms: ObjectStates) -> Bools:
        if len(phantoms) == 0:
            return np.zeros(0, bool)
        coverage = moment.coverage
        later = replace(coverage, time_s=coverage.time_s + AHEAD_S)
        most = np.maximum(coverage.honest_viewers(phantoms), later.honest_viewers(phantoms))
        given_up = most > self._witnesses
        return given_up if coverage.fused else given_up | ~coverage.visible(moment.view, boxes_of(phantoms))


@dataclass(kw_only=True, eq=False)
class DeniedSelection(Selection):
    """Selects real objects that two compromised agents or more see, and few honest ones, to be hidden.

    Those with the fewest honest witnesses come first, of these the ones nearest to the ego. As long as there is
    nothing to hide, it selects again in every frame.

    budget:    lies per second of all adversaries together: each object costs one per adversary
    witnesses: largest number of honest agents that look at an object, 0 or more
    """

    until_found = True
    cluster_radius_m = CLUSTER_M

    budget: float = 4.0
    witnesses: int = 2

    def __post_init__(self) -> None:
        Budget(self.budget)
        check("0 or more", witnesses=self.witnesses)

    def select(self, objects: ObjectStates, coverage: Coverage, rng: np.random.Generator) -> Targets:
        objects = objects.select(canonical_order(objects))
        cost = self._cost(objects, coverage)
        hidden = np.argsort(cost, kind="stable")[: int(self.budget / max(1, len(coverage.victims)))]
        hidden = np.sort(hidden[np.isfinite(cost[hidden])])
        none = ObjectStates.empty()
        return Targets(none, objects.select(hidden), none, np.zeros((0, 3))).numbered(0)

    def _cost(self, objects: ObjectStates, coverage: Coverage) -> Floats:
        """(n,) m from the ego, more for each honest witness; infinite for what may not be hidden."""
        boxes = boxes_of(objects)
        liars = np.zeros(len(objects), np.int64)
        for view in coverage.victims:
            liars += coverage.visible(view, boxes, boxes)
        witnesses = coverage.honest_viewers(objects, occluders=boxes)
        ego = coverage.surroundings.ego_sensor
        distance = np.zeros(len(objects))
        if ego is not None:
            offset = objects.position[:, :2] - ego.route.position_at(coverage.time_s)[:2]
            distance = np.hypot(offset[:, 0], offset[:, 1])
        outnumbered = (liars >= 2) & (witnesses <= self.witnesses) & (distance > SELF_M if ego is not None else True)
        return np.where(outnumbered, distance + WITNESS_M * witnesses, np.inf)


class PairedDenial(Coordinator):
    """Lets two adversaries or more hide what at most two honest agents look at, and claim free space there.

    Two deny what one reports: a majority says that the honest witness lies. Two against two is a tie, and two against
    none simply removes the object. Each adversary needs a `CoordinatedAttack` on tracks and view.

    Threat model: the attackers control the tracks and the views of two agents or more, and share what these see. They
    know the buildings, and the sensors and routes of all agents; with the trust, all of them are honest while the trust
    in one of their agents is more than `tolerance` below its highest value.
    Source: our own; two liars among three viewers are beyond what a majority can settle.

    witnesses:        largest number of honest agents that look at an object, 0 or more
    budget:           lies per second of all adversaries together, at least as many as there are adversaries
    tolerance:        0 to 1, fall of the trust that is accepted
    reselect_every_s: s, interval between selections of new targets; None: select once
    start_s:          s of scene time at which the first targets are selected
    """

    def __init__(
        self,
        *,
        witnesses: int = 2,
        budget: float = 4.0,
        tolerance: float = 0.05,
        reselect_every_s: float | None = 5.0,
        start_s: float = 4.0,
    ) -> None:
        selection = DeniedSelection(budget=budget, witnesses=witnesses)
        super().__init__(selection=selection, reselect_every_s=reselect_every_s, start_s=start_s)
        self._watch = TrustWatch(tolerance)

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:
        self._watch.hear(trust, self._surroundings.victims)

    def step(
        self, frame: int, time_ns: int, objects: ObjectStates, source: Ints, agent_positions: Floats
    ) -> tuple[Targets, ...]:
        plans = super().step(frame, time_ns, objects, source, agent_positions)
        return (Targets.empty(time_ns),) * len(plans) if self._watch.fallen else plans


class TrustFlip(Framing):
    """Makes honest agents disagree about real objects, so that a defence distrusts one of them.

    Nothing is invented, and no agent lies. On the sensors of the target, objects that others see return nothing to it:
    it seems to deny what most report. On the sensors of other agents, objects that the target sees return nothing to
    them: it alone seems to report what is not there. Both cases follow from whose sensors the adversary is on. Without
    a defence the picture keeps these objects, because somebody reports them.

    Threat model: the attacker changes the surfaces of objects, so that they return nothing towards some sensors: it is
    on the wires detections and view, between the sensors and honest agents. It needs no agent. It knows the buildings,
    and the sensors and routes of all agents; with the trust, it stops as long as the target is suspended. A liar may
    use it, too: on tracks and view.
    Source: TrustFlip (arXiv 2605.22122). We know its abstract and quotations of the paper, not the paper: there,
    physical objects are shaped so that real detectors disagree. Which shapes can do that is no question here.

    target:    name of the honest agent to be distrusted; None: the agent whose sensors the adversary is on
    witnesses: least number of other honest agents that see what is hidden from the target; 2 outvote it
    budget:    lies per second, so the number of objects
    start_s:   s of scene time at which the attack begins
    """

    def __init__(
        self, *, target: str | None = None, witnesses: int = 2, budget: float = 2.0, start_s: float = 4.0
    ) -> None:
        super().__init__(framed=target, action="hide", budget=budget, start_s=start_s)
        check("1 or more", witnesses=witnesses)
        self._witnesses = witnesses
        self._distrusted = False

    def inform(self, surroundings: Surroundings) -> None:
        super().inform(surroundings)
        known = surroundings.sensors
        if self._framed is not None and known and self._framed not in known:
            raise ConfigurationError(f"target: no agent {self._framed!r}{nearest(self._framed, known)}")

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:
        if self._framed in trust.agents:
            self._distrusted = bool(trust.state[trust.agents.index(self._framed)] == SUSPENDED)

    def lie(self, moment: Moment) -> Lies:
        if self._distrusted:
            self.rest()
            return Lies()
        return super().lie(moment)

    def _cost(self, moment: Moment) -> Floats:
        own = self._own_name(moment)
        if self._framed is None:
            self._framed = own
        return super()._cost(moment) if own != self._framed else self._cost_of_blinding(moment)

    def _cost_of_blinding(self, moment: Moment) -> Floats:
        """(n,) m from the target, whose own sensors these are; infinite for what too few others see."""
        boxes = boxes_of(moment.seen)
        offset = moment.seen.position[:, :2] - moment.position[:2]
        distance: Floats = np.hypot(offset[:, 0], offset[:, 1])
        seen = (distance > SELF_M) & moment.coverage.visible(moment.view, boxes)
        witnesses = moment.coverage.honest_viewers(moment.seen, seen, boxes)
        return np.where(seen & (witnesses >= self._witnesses), distance, np.inf)

    def _own_name(self, moment: Moment) -> str | None:
        """The agent on whose wires the adversary is: the attacked one that is nearest; None if none is known."""
        routes = {
            name: self._surroundings.sensors[name].route
            for name in self._surroundings.victims
            if name in self._surroundings.sensors
        }
        distance = [
            float(np.hypot(*(route.position_at(moment.time_s) - moment.position)[:2])) for route in routes.values()
        ]
        return list(routes)[int(np.argmin(distance))] if distance else None
