"""Attacks that stay below what a defence looks for: small shifts, blind areas, and lies only while trusted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.attacks.adaptive import Lies, Moment
from mast_zenoh.attacks.attack import Attack
from mast_zenoh.attacks.disputes import expect_agent
from mast_zenoh.attacks.knowledge import Trust
from mast_zenoh.attacks.phantoms import AHEAD_S, CautiousPhantoms, IntermittentAttack
from mast_zenoh.attacks.real_objects import SELF_M, ChosenObjects, SlowDrift
from mast_zenoh.attacks.regions import UnseenByEgo, path_ahead
from mast_zenoh.attacks.road_ahead import GhostAhead
from mast_zenoh.attacks.surroundings import UNKNOWN, Coverage, Surroundings, boxes_of
from mast_zenoh.attacks.targets import Tampering, Targets
from mast_zenoh.errors import nearest
from mast_zenoh.integrity.base import TRUSTED
from mast_zenoh.integrity.base import UNKNOWN as NOT_JUDGED
from mast_zenoh.tracking.view import SensorView

Direction = Literal["toward", "away", "sideways", "random"]
DIRECTIONS: tuple[Direction, ...] = ("toward", "away", "sideways", "random")


class PosePert(SlowDrift):
    """Shifts the real objects nearest to the ego by up to a metre.

    The shift grows to its full size in `rise_s`, and the claimed velocity agrees with it while it grows. It is in the
    order of the errors of honest tracks, so that a test of single messages cannot tell, and below the radius within
    which tracks are of one object. Each object is shifted in one direction as long as it is followed.

    Threat model: the attacker controls one agent's tracks or detections, and knows the ego's route; with the trust,
    shifts shrink while the trust in its agent is more than `tolerance` below its highest value.
    Source: PosePert (arXiv 2605.01301; zqzqz/PosePert 3c95189). We know its abstract, quotations and the code of its
    closed loop: there, a network changes feature maps so that an object is detected up to 1 m away, 0.5 m more in each
    frame (here rise_s=0.2 at 10 Hz, offset_m=1). Here its position is changed.

    offset_m:  m, size of the shift, at most 1
    direction: "toward" the ego's path ahead, "away" from it, "sideways" (to the left of the object's heading), or
               "random"; without a known path, the first two are relative to the victim
    rise_s:    s, in which the shift grows to its size
    tolerance: 0 to 1, fall of the trust that is accepted
    budget:    lies per second, so the number of objects
    start_s:   s of scene time at which the attack begins
    end_s:     s of scene time at which it ends, at once; None: never
    covariance_factor: by which the covariances of shifted objects are multiplied; below 1, a fusion believes them more,
               as features that are amplified there
    """

    def __init__(
        self,
        *,
        offset_m: float = 0.8,
        direction: Direction = "toward",
        rise_s: float = 1.0,
        tolerance: float = 0.05,
        budget: float = 2.0,
        start_s: float = 4.0,
        end_s: float | None = None,
        covariance_factor: float = 1.0,
    ) -> None:
        check("more than 0 and at most 1", offset_m=offset_m, covariance_factor=covariance_factor)
        check("more than 0, finite", rise_s=rise_s)
        if direction not in DIRECTIONS:
            raise ValueError(f"direction: found {direction!r}{nearest(str(direction), DIRECTIONS)}")
        super().__init__(
            rate_mps=offset_m / rise_s, limit_m=offset_m, tolerance=tolerance, budget=budget, start_s=start_s
        )
        if end_s is not None and not end_s > start_s:
            raise ValueError(f"end_s: found {end_s}, expected more than start_s, {start_s}")
        self._policy, self._end_s = direction, np.inf if end_s is None else end_s
        self._covariance = covariance_factor

    def observe(self, moment: Moment) -> None:
        super().observe(moment)
        if moment.time_s >= self._end_s - 1e-9:
            self.dormant = True

    def _claims(self, moment: Moment, numbers: Ints, real: ObjectStates) -> ObjectStates:
        claims = super()._claims(moment, numbers, real)
        return claims.with_(covariance=claims.covariance * self._covariance)

    def _directions(self, moment: Moment, numbers: Ints, real: ObjectStates) -> dict[int, float]:
        if self._policy == "random":
            return super()._directions(moment, numbers, real)
        if self._policy == "sideways":
            angle = real.yaw + 0.5 * np.pi
        else:
            path = path_ahead(moment.coverage)
            if path is None:
                offset = moment.position[None, :2] - real.position[:, :2]
                angle = np.arctan2(offset[:, 1], offset[:, 0])
            else:
                along, left = path.coordinates(real.position)
                angle = path.at(along)[1] - 0.5 * np.pi * np.where(left >= 0.0, 1.0, -1.0)
            angle = angle if self._policy == "toward" else angle + np.pi
        return dict(zip(numbers.tolist(), angle.tolist(), strict=True))


class BlindAreaConfusion(CautiousPhantoms):
    """Invents vehicles, or hides real objects, where one agent cannot see: the one that compares others with itself.

    A defence that checks each message against the ego's own sight has nothing to compare there. A false vehicle is
    withdrawn a second before that agent would look at it, and an object is hidden as long as it is out of its sight:
    out of range or field of view, behind buildings, or (real ones) behind other objects. Other honest agents may look.

    Threat model: the attacker controls one agent's tracks and view, or the picture on its way to the ego. It knows the
    buildings, and the deceived agent's sensor and route; with the picture, objects that it does not see itself; with
    the trust, it is honest while the trust in its agent is more than `tolerance` below its highest value.
    Source: blind area confusion, GCP (arXiv 2501.02450, abstract, and public code that follows the paper): the
    victim's own detections are compared with the collaborative ones to find its blind area, and features are perturbed
    there. Here the blind area comes from sensors, routes and buildings, and boxes are changed.

    deceived:  name of the agent in whose blind area it lies; None: the ego, or, if that is the compromised agent
               itself, the honest agent nearest to it
    action:    "insert" or "hide"
    speed_mps: σ per axis of the speed of false vehicles
    tolerance: 0 to 1, fall of the trust that is accepted
    budget:    lies per second, so the number of objects
    start_s:   s of scene time at which the attack begins
    """

    def __init__(
        self,
        *,
        deceived: str | None = None,
        action: Literal["insert", "hide"] = "insert",
        speed_mps: float = 5.0,
        tolerance: float = 0.05,
        budget: float = 2.0,
        start_s: float = 4.0,
    ) -> None:
        super().__init__(tolerance=tolerance, budget=budget, start_s=start_s, speed_mps=speed_mps)
        if action not in ("insert", "hide"):
            raise ValueError(f"action: found {action!r}{nearest(str(action), ('insert', 'hide'))}")
        self._deceived, self._action = deceived, action
        self._chosen = ChosenObjects(self._follower, self.budget, self.numbers)
        self.region = UnseenByEgo(deceived)

    def inform(self, surroundings: Surroundings) -> None:
        super().inform(surroundings)
        expect_agent("deceived", self._deceived, surroundings)

    def counts(self) -> dict[str, int]:
        counts = super().counts()
        return counts if self._action == "insert" else {**counts, "selected": counts["wanted"], "wanted": 0}

    def rest(self) -> None:
        super().rest()
        self._chosen.clear()

    def lie(self, moment: Moment) -> Lies:
        if self._deceived is None:
            self._deceived = self._default_deceived(moment)
            self.region = UnseenByEgo(self._deceived)
        if self._action == "insert" or self._watch.fallen:
            return super().lie(moment)
        numbers, rows = self._chosen.update(moment, self._cost(moment))
        return Lies(hidden=rows, hidden_number=numbers)

    def _default_deceived(self, moment: Moment) -> str | None:
        """The ego; the honest agent nearest to the victim if that is the ego, unless the ego gets the picture."""
        known = self._surroundings
        ego = next(iter(known.sensors), None)
        if ego not in known.victims or moment.coverage.fused:
            return ego
        honest = [name for name in known.sensors if name not in known.victims]
        return known.nearest_agent(honest, moment.position, moment.time_s)

    def _given_up(self, moment: Moment, phantoms: ObjectStates) -> Bools:
        observer = self._surroundings.sensors.get(self._deceived or "")
        if observer is None:
            return np.ones(len(phantoms), bool)
        coverage, none = moment.coverage, ObjectStates.empty()
        later = replace(coverage, time_s=coverage.time_s + AHEAD_S)
        seen = coverage.in_sight(observer, phantoms, none) | later.in_sight(observer, phantoms, none)
        return seen if coverage.fused else seen | ~coverage.visible(moment.view, boxes_of(phantoms))

    def _cost(self, moment: Moment) -> Floats:
        """(n,) m from the deceived agent; infinite for what it sees, and for the agent itself."""
        seen, observer = moment.seen, self._surroundings.sensors.get(self._deceived or "")
        if observer is None:
            return np.full(len(seen), np.inf)
        offset = seen.position[:, :2] - observer.route.position_at(moment.time_s)[:2]
        distance: Floats = np.hypot(offset[:, 0], offset[:, 1])
        unseen = (distance > SELF_M) & ~moment.coverage.in_sight(observer, seen, seen)
        return np.where(unseen, distance, np.inf)


#: Honest agents that look at an object, from which it is checked.
CHECKED_BY = 2


@dataclass(kw_only=True, eq=False)
class PretendBenign(IntermittentAttack):
    """Behaves honestly until its agent is trusted and not inspected, then lets another attack act for a moment.

    A burst is begun only if the defence has forgotten the last one, `memory_s` after it; it is the shorter, the smaller
    `duty` is. It ends early as soon as the trust falls. The victim is inspected while at least `inspected_share` of its
    objects are in view of two honest agents or more: no burst is begun then.

    Threat model: the attacker controls what its attack needs. It knows the defence's memory, the buildings, and the
    sensors and routes of all agents. With the trust (white box), it waits until its agent is trusted: the state
    "trusted", or "unknown" with a mean of 0.5 or more, and not more than `tolerance` below its highest value. Without
    it, it assumes to be trusted from `start_s` on.
    Source: Pretend Benign (Lin et al., ICCV 2025), of which we know the title and mentions in other papers alone, so
    only the idea is meant. Its schedule is our own; on-off attacks: Sun et al. (2006).

    attack:    the attack of the bursts; None: GhostAhead()
    memory_s:  s, how long the defence remembers, see the parameters of its class: the least honest time between bursts
    duty:      more than 0 and less than 1, the largest share of the time in which it lies: bursts last
               memory_s · duty / (1 - duty), by default 0.56 s: `FaultOrLie` needs 0.8 s for two lies at once
    inspected_share: more than 0 and at most 1; more than that: never inspected
    tolerance: 0 to 1, fall of the trust that is accepted
    start_s:   s of scene time from which bursts are begun
    """

    attack: Attack | None = None
    memory_s: float = 5.0
    duty: float = 0.1
    inspected_share: float = 1.0
    tolerance: float = 0.05
    start_s: float = 4.0

    def __post_init__(self) -> None:
        check("more than 0, finite", memory_s=self.memory_s, inspected_share=self.inspected_share)
        check("more than 0 and less than 1", duty=self.duty)
        check("0 or more, finite", start_s=self.start_s)
        self._wrap(self.attack or GhostAhead(start_s=self.start_s), self.tolerance)
        self._start_ns, self._honest_ns = round(self.start_s * 1e9), round(self.memory_s * 1e9)
        self._lying_ns = round(self.memory_s * self.duty / (1.0 - self.duty) * 1e9)
        self._surroundings, self._fused = UNKNOWN, False
        self._view: SensorView | None = None
        self._burst_ns: int | None = None  # time at which the present burst began
        self._honest_since_ns: int | None = None  # None: there has been no burst
        self._trusted, self._inspected = True, False

    def inform(self, surroundings: Surroundings) -> None:
        super().inform(surroundings)
        self._surroundings = surroundings

    def look(self, view: SensorView, *, fused: bool) -> None:
        super().look(view, fused=fused)
        self._view, self._fused = view, fused

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:
        super().hear_trust(frame, time_ns, trust)
        own = np.isin(trust.agents, self._victims)
        good = (trust.state == TRUSTED) | ((trust.state == NOT_JUDGED) & (trust.mean >= 0.5))
        self._trusted = bool(good[own].all()) and not self._watch.fallen

    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        self._inspected = self._is_inspected(time_ns, objects)
        return super().step(frame, time_ns, objects, agent_position, directive)

    def _is_inspected(self, time_ns: int, objects: ObjectStates) -> bool:
        """Whether enough of the victim's objects are in view of others; not if it has none."""
        if self._view is None or len(objects) == 0 or self.inspected_share > 1.0:
            return False
        coverage = Coverage(self._surroundings, (self._view,), time_ns * 1e-9, self._fused)
        checked = coverage.honest_viewers(objects, occluders=boxes_of(objects)) >= CHECKED_BY
        return float(checked.mean()) >= self.inspected_share

    def _awake(self, time_ns: int) -> bool:
        if self._burst_ns is not None:
            if time_ns - self._burst_ns < self._lying_ns and not self._watch.fallen:
                return True
            self._burst_ns, self._honest_since_ns = None, time_ns
        rested = self._honest_since_ns is None or time_ns - self._honest_since_ns >= self._honest_ns
        if time_ns >= self._start_ns and rested and self._trusted and not self._inspected:
            self._burst_ns = time_ns
        return self._burst_ns is not None
