"""Attacks that turn on disputes: one word against another, where few agents or only some of them look.

An attack on what agents say about whom they trust.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, canonical_order, propagate
from mast_zenoh.attacks.adaptive import Budget, Lies, Moment
from mast_zenoh.attacks.attack import Attack, ObjectsUnchanged
from mast_zenoh.attacks.campaign import NANOSECONDS
from mast_zenoh.attacks.coordination import CLUSTER_M, Coordinator
from mast_zenoh.attacks.knowledge import Trust, TrustWatch, TrustWatcher
from mast_zenoh.attacks.phantoms import AHEAD_S, CautiousPhantoms
from mast_zenoh.attacks.real_objects import SELF_M, WITNESS_M, ChangingAttack
from mast_zenoh.attacks.regions import FewWitnesses
from mast_zenoh.attacks.selection import Selection
from mast_zenoh.attacks.surroundings import Coverage, Surroundings, boxes_of
from mast_zenoh.attacks.targets import Targets
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.integrity.base import SUSPENDED


class OpenDispute(CautiousPhantoms):
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
        super().__init__(tolerance=tolerance, budget=budget, start_s=start_s, speed_mps=0.0)
        check("0 or more", witnesses=witnesses)
        self._witnesses = witnesses
        self.region = FewWitnesses(witnesses)

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
        cost = self.cost(objects, coverage)
        hidden = np.argsort(cost, kind="stable")[: int(self.budget / max(1, len(coverage.victims)))]
        hidden = np.sort(hidden[np.isfinite(cost[hidden])])
        none = ObjectStates.empty()
        return Targets(none, objects.select(hidden), none, np.zeros((0, 3))).numbered(0)

    def cost(self, objects: ObjectStates, coverage: Coverage) -> Floats:
        """(n,) m from the ego, more for each honest witness; infinite for what may not be hidden.

        An object of which another honest agent would become a witness within a second may not be hidden either.
        """
        boxes = boxes_of(objects)
        liars = np.zeros(len(objects), np.int64)
        for view in coverage.victims:
            liars += coverage.visible(view, boxes, boxes)
        later = replace(coverage, time_s=coverage.time_s + AHEAD_S)
        witnesses = np.maximum(coverage.honest_viewers(objects), later.honest_viewers(propagate(objects, AHEAD_S)))
        ego = coverage.surroundings.ego_sensor
        distance = np.zeros(len(objects))
        if ego is not None:
            offset = objects.position[:, :2] - ego.route.position_at(coverage.time_s)[:2]
            distance = np.hypot(offset[:, 0], offset[:, 1])
        outnumbered = (liars >= 2) & (witnesses <= self.witnesses) & (distance > SELF_M if ego is not None else True)
        return np.where(outnumbered, distance + WITNESS_M * witnesses, np.inf)


class PairedDenial(TrustWatcher, Coordinator):
    """Lets two adversaries or more hide what at most two honest agents look at, and claim free space there.

    Two deny what one reports: a majority says that the honest witness lies. Two against two is a tie, and two against
    none simply removes the object. An object is reported again a second before a third honest agent would look at it.
    Each adversary needs a `CoordinatedAttack` on tracks and view.

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
        self._denied = DeniedSelection(budget=budget, witnesses=witnesses)
        super().__init__(selection=self._denied, reselect_every_s=reselect_every_s, start_s=start_s)
        self._watch = TrustWatch(tolerance)

    def step(
        self, frame: int, time_ns: int, objects: ObjectStates, source: Ints, agent_positions: Floats
    ) -> tuple[Targets, ...]:
        plans = super().step(frame, time_ns, objects, source, agent_positions)
        if self._watch.fallen or not plans:
            return (Targets.empty(time_ns),) * len(plans)
        coverage = self._coverage(time_ns / NANOSECONDS, objects, source, agent_positions)
        denied = plans[0].remove
        kept = np.isfinite(self._denied.cost(denied, coverage))
        return (replace(plans[0], remove=denied.select(kept)),) * len(plans)


class TrustFlip(ChangingAttack):
    """Makes honest agents disagree about real objects, so that a defence distrusts one of them.

    Nothing is invented, and no agent lies. On the sensors of the target, objects that several others see return
    nothing: it seems to deny what most report. On the sensors of several other agents, objects that the target sees
    return nothing, where they outnumber it and all other viewers: it alone seems to report what is not there. Which of
    the two follows from whose sensors the adversary is on. Without a defence the picture keeps these objects, because
    somebody reports them.

    Threat model: the attacker changes the surfaces of objects, so that they return nothing towards some sensors: it is
    on the wires detections and view, between sensors and honest agents; one adversary on all sensors that it blinds. It
    needs no agent. It knows the buildings, and the sensors and routes of all agents; with the trust, it stops as long
    as the target is suspended. A liar may use it, too: on tracks and view.
    Source: TrustFlip (arXiv 2605.22122). We know its abstract and quotations of the paper, not the paper: there,
    physical objects are shaped so that real detectors disagree. Which shapes can do that is no question here. Its
    TrustReflect is no attack, but the cure: disputed places say nothing about trust. `OpenDispute` turns on that.

    target:    name of the honest agent to be distrusted; None: the agent whose sensors the adversary is on
    witnesses: least number of agents that contradict the target about an object
    budget:    lies per second, so the number of objects on each agent's sensors
    start_s:   s of scene time at which the attack begins
    """

    def __init__(
        self, *, target: str | None = None, witnesses: int = 2, budget: float = 2.0, start_s: float = 4.0
    ) -> None:
        super().__init__(budget=budget, start_s=start_s)
        check("1 or more", witnesses=witnesses)
        self._target, self._witnesses = target, witnesses
        self._distrusted = False

    def inform(self, surroundings: Surroundings) -> None:
        super().inform(surroundings)
        expect_agent("target", self._target, surroundings)

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:
        if self._target in trust.agents:
            self._distrusted = bool(trust.state[trust.agents.index(self._target)] == SUSPENDED)

    def counts(self) -> dict[str, int]:
        return {"selected": self._numbers_used, "placed": 0, "wanted": 0}

    def lie(self, moment: Moment) -> Lies:
        if self._distrusted:
            self.rest()
            return Lies()
        return super().lie(moment)

    def _claims(self, moment: Moment, numbers: Ints, real: ObjectStates) -> ObjectStates | None:
        return None

    def _cost(self, moment: Moment) -> Floats:
        """(n,) m from the target; infinite for what it does not see, and where too few contradict it."""
        known, coverage, boxes = self._surroundings, moment.coverage, boxes_of(moment.seen)
        own = known.nearest_agent(known.victims, moment.position, moment.time_s)
        self._target = self._target or own
        target = known.sensors.get(self._target or "")
        if target is None:
            return np.full(len(boxes), np.inf)
        pose = target.route.at(moment.time_s)
        offset = moment.seen.position[:, :2] - pose[0][:2]
        distance: Floats = np.hypot(offset[:, 0], offset[:, 1])
        disputable = (distance > SELF_M) & coverage.visible(target.view(*pose), boxes, boxes)
        viewers = coverage.honest_viewers(moment.seen, disputable, boxes)
        if own == self._target:
            return np.where(disputable & (viewers >= self._witnesses), distance, np.inf)
        blinded = np.zeros(len(boxes), np.int64)
        for name in known.victims:
            if name in known.sensors:
                blinded += coverage.in_sight(known.sensors[name], moment.seen, moment.seen)
        outnumbered = (blinded >= self._witnesses) & (blinded > viewers)
        return np.where(disputable & outnumbered, distance, np.inf)


def expect_agent(parameter: str, name: str | None, known: Surroundings) -> None:
    """Raise ConfigurationError if a parameter names an agent that is not known; None, and no known agents, are fine."""
    if name is not None and known.sensors and name not in known.sensors:
        raise ConfigurationError(f"{parameter}: no agent {name!r}{nearest(name, known.sensors)}")


@dataclass(kw_only=True, eq=False)
class Slander(ObjectsUnchanged, Attack):
    """Changes what an agent says about whom it trusts, on its way to others (keyexpr_maps/on_gossip.toml).

    It tells no trust in some agents, and full trust in the teller and in others: bad-mouthing and ballot stuffing
    (Dellarocas, Immunizing Online Reputation Reporting Systems, EC 2000).

    slandered, praised: names of agents
    start_s: s of scene time at which it begins
    """

    slandered: tuple[str, ...] = ()
    praised: tuple[str, ...] = ()
    start_s: float = 4.0

    def __post_init__(self) -> None:
        check("0 or more, finite", start_s=self.start_s)

    def forge_trust(self, time_ns: int, teller: str, agents: tuple[str, ...], trust: Floats) -> Floats:
        if time_ns < self.start_s * NANOSECONDS:
            return trust
        praised = np.isin(agents, (*self.praised, teller))
        return np.where(praised, 1.0, np.where(np.isin(agents, self.slandered), 0.0, trust))
