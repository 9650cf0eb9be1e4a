"""Attacks about real objects: moved, altered, hidden or shown again, so that single messages are not suspicious."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, concatenate, propagate
from mast_zenoh.attacks.adaptive import AdaptiveAttack, Budget, Lies, Moment
from mast_zenoh.attacks.attack import OWN_TARGET_M, Attack, ObjectsUnchanged
from mast_zenoh.attacks.campaign import NANOSECONDS
from mast_zenoh.attacks.following import Follower
from mast_zenoh.attacks.knowledge import TrustWatch, TrustWatcher
from mast_zenoh.attacks.surroundings import AgentSensor, Surroundings, boxes_of
from mast_zenoh.streams import stream

#: s after which an object that is no longer seen is given up.
UNSEEN_S = 1.0


class ChosenObjects:
    """The objects that an attack has chosen; each keeps its number for as long as it is seen.

    follower, budget: those of the attack; numbers: gives unused numbers
    """

    def __init__(self, follower: Follower, budget: Budget, numbers: Callable[[int], Ints]) -> None:
        self._follower, self.budget, self.numbers = follower, budget, numbers
        self._targets = ObjectStates.empty()
        self._seen_ns: Ints = np.zeros(0, np.int64)

    def clear(self) -> None:
        """Give up all objects."""
        self._targets, self._seen_ns = ObjectStates.empty(), np.zeros(0, np.int64)

    def update(self, moment: Moment, cost: Floats) -> tuple[Ints, Ints]:
        """The numbers (k,) of the chosen objects in a message, and their rows (k,) of `Moment.seen`.

        cost: (n,) objects with the least are chosen first, those without a finite one never; they are given up when
        their cost becomes infinite
        """
        self._targets = propagate(self._targets, moment.elapsed_s)
        row = self._located(moment)
        given_up = (row >= 0) & ~np.isfinite(cost[row]) if len(cost) else np.zeros(len(row), bool)
        given_up |= moment.time_ns - self._seen_ns > UNSEEN_S * 1e9
        row = self._keep(~given_up, row)
        allowed = self.budget.admit(len(row), len(row) + len(cost))
        row = self._keep(np.arange(len(row)) < allowed, row)
        if allowed > len(row):
            free = np.isfinite(cost) & moment.established
            free[row[row >= 0]] = False
            rows = np.flatnonzero(free)
            new = rows[np.argsort(cost[rows], kind="stable")][: allowed - len(row)]
            if len(new):
                states = moment.seen.select(new).with_(id=self.numbers(len(new)))
                self._targets = concatenate([self._targets, states])
                self._seen_ns = np.concatenate([self._seen_ns, np.full(len(new), moment.time_ns, np.int64)])
                row = self._located(moment)
        present = row >= 0
        return self._targets.id[present], row[present]

    def _located(self, moment: Moment) -> Ints:
        """(k,) row of each chosen object, -1: not in the message."""
        self._follower.release_others(self._targets.id)
        if len(self._targets) == 0:
            return np.zeros(0, np.int64)
        self._targets, row = self._follower.locate(self._targets, OWN_TARGET_M)
        self._seen_ns = np.where(row >= 0, moment.time_ns, self._seen_ns)
        return row

    def _keep(self, rows: Bools, row: Ints) -> Ints:
        if rows.all():
            return row
        self._targets, self._seen_ns = self._targets.select(rows), self._seen_ns[rows]
        return row[rows]


class ChangingAttack(AdaptiveAttack):
    """Base of attacks that change real objects, by default those nearest to the ego."""

    def __init__(self, *, budget: float, start_s: float) -> None:
        super().__init__(budget=budget, start_s=start_s)
        self._chosen = ChosenObjects(self._follower, self.budget, self.numbers)

    def rest(self) -> None:
        self._chosen.clear()

    def lie(self, moment: Moment) -> Lies:
        numbers, rows = self._chosen.update(moment, self._cost(moment))
        claims = self._claims(moment, numbers, moment.seen.select(rows))
        if claims is None:
            return Lies(hidden=rows, hidden_number=numbers)
        return Lies(changed=rows, claims=claims, changed_number=numbers)

    def _cost(self, moment: Moment) -> Floats:
        """(n,) m from the ego on its route, from the victim without a route; infinite for the ego itself."""
        ego = moment.coverage.surroundings.ego_sensor
        centre = moment.position if ego is None else ego.route.at(moment.time_s)[0]
        offset = moment.seen.position[:, :2] - centre[:2]
        distance: Floats = np.hypot(offset[:, 0], offset[:, 1])
        return distance if ego is None else np.where(distance < 3.0, np.inf, distance)

    @abstractmethod
    def _claims(self, moment: Moment, numbers: Ints, real: ObjectStates) -> ObjectStates | None:
        """What to claim instead of the chosen objects (k); None: that they are not there. numbers: (k,)"""


class SlowDrift(TrustWatcher, ChangingAttack):
    """Moves the objects nearest to the ego by an offset that grows so slowly that no single message is suspicious.

    Each object drifts in a direction drawn once; its velocity agrees with the drift. While the trust in the victim is
    more than `tolerance` below its highest value (an attacker that hears it), offsets shrink at the same rate.
    Source: biases that stay below a detector's threshold, Murguia and Ruths (2019); small shifts of objects, PosePert
    (arXiv 2605.01301).

    rate_mps:  m/s by which an offset grows
    limit_m:   m, largest offset
    tolerance: 0 to 1, fall of the trust that is accepted
    budget:    lies per second, so the number of objects that drift
    start_s:   s of scene time at which the attack begins
    """

    def __init__(
        self,
        *,
        rate_mps: float = 0.2,
        limit_m: float = 2.0,
        tolerance: float = 0.05,
        budget: float = 2.0,
        start_s: float = 4.0,
    ) -> None:
        super().__init__(budget=budget, start_s=start_s)
        check("more than 0, finite", rate_mps=rate_mps, limit_m=limit_m)
        self._rate_mps, self._limit_m = rate_mps, limit_m
        self._watch = TrustWatch(tolerance)
        self._offset_m: dict[int, float] = {}  # by number
        self._direction: dict[int, float] = {}

    def _claims(self, moment: Moment, numbers: Ints, real: ObjectStates) -> ObjectStates:
        rate = -self._rate_mps if self._watch.fallen else self._rate_mps
        offset, speed, angle = np.zeros((3, len(real)))
        new = np.array([number not in self._direction for number in numbers.tolist()], bool)
        if new.any():
            self._direction |= self._directions(moment, numbers[new], real.select(new))
        limit = self._limits(moment, real)
        for i, number in enumerate(numbers.tolist()):
            before = self._offset_m.get(number, 0.0)
            after = min(max(before + rate * moment.elapsed_s, 0.0), limit[i])
            self._offset_m[number] = offset[i] = after
            speed[i] = rate if after != before and 0.0 < after < limit[i] else 0.0
            angle[i] = self._direction[number]
        direction = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
        moves = np.where(real.velocity.any(axis=1), speed, 0.0)  # detections have no velocity
        return real.with_(
            position=real.position + direction * offset[:, None], velocity=real.velocity + direction * moves[:, None]
        )

    def _limits(self, moment: Moment, real: ObjectStates) -> Floats:
        """(k,) m, the largest offset of each of the chosen objects."""
        return np.full(len(real), self._limit_m)

    def _directions(self, moment: Moment, numbers: Ints, real: ObjectStates) -> dict[int, float]:
        """By number, the direction, rad, in which each of k newly chosen objects drifts."""
        draws = [self.stream("direction", number).uniform(-np.pi, np.pi) for number in numbers.tolist()]
        return dict(zip(numbers.tolist(), map(float, draws), strict=True))


class StatePerturbation(ChangingAttack):
    """Changes all about the objects nearest to the ego but their positions.

    A false velocity spoils predictions, a small covariance gives the victim more weight in the fusion, a low score less
    credit to a true object. Objects keep their places, so that nothing is found where positions are compared.
    Source: false fields of V2X messages, VeReMi (van der Heijden et al., 2018).

    velocity_mps:      m/s added along the heading (tracks; detections have no velocity)
    heading_rad:       rad added to the heading
    size_factor, covariance_factor, score_factor: by which these are multiplied, more than 0; a score is at most 1
    budget:            lies per second, so the number of objects
    start_s:           s of scene time at which the attack begins
    """

    def __init__(
        self,
        *,
        velocity_mps: float = 5.0,
        heading_rad: float = 0.0,
        size_factor: float = 1.0,
        covariance_factor: float = 0.25,
        score_factor: float = 1.0,
        budget: float = 2.0,
        start_s: float = 4.0,
    ) -> None:
        super().__init__(budget=budget, start_s=start_s)
        factors = {
            "size_factor": size_factor,
            "covariance_factor": covariance_factor,
            "score_factor": score_factor,
        }
        check("more than 0 and at most 1000", **factors)
        check("-1000 to 1000", velocity_mps=velocity_mps, heading_rad=heading_rad)
        self._velocity_mps, self._heading_rad = velocity_mps, heading_rad
        self._size, self._covariance, self._score = factors.values()

    def _claims(self, moment: Moment, numbers: Ints, real: ObjectStates) -> ObjectStates:
        heading = np.column_stack([np.cos(real.yaw), np.sin(real.yaw), np.zeros(len(real))])
        moves = np.any(real.velocity, axis=1, keepdims=True)
        return real.with_(
            velocity=real.velocity + self._velocity_mps * heading * moves,
            yaw=wrap_angle(real.yaw + self._heading_rad),
            size=real.size * self._size,
            covariance=real.covariance * self._covariance,
            score=np.minimum(real.score * self._score, 1.0),
        )


class Overconfidence(ChangingAttack):
    """Moves objects a little and claims to be certain about them, so that a fusion by covariances believes it alone.

    All objects move alike, in a direction drawn once; the offset is too small for them to be other objects. Fusion
    weighs by the inverse of the reported covariance, so a sender sets its own weight. Source: no linear combination
    withstands a single liar (Blanchard et al., Machine Learning with Adversaries, NeurIPS 2017, Lemma 1).

    offset_m:          m, from where the objects are
    covariance_factor: by which covariances are multiplied, more than 0
    budget:            lies per second, so the number of objects, those nearest to the ego first
    start_s:           s of scene time at which the attack begins
    """

    def __init__(
        self, *, offset_m: float = 1.9, covariance_factor: float = 1e-6, budget: float = 2.0, start_s: float = 4.0
    ) -> None:
        super().__init__(budget=budget, start_s=start_s)
        check("0 or more, finite", offset_m=offset_m)
        check("more than 0 and at most 1000", covariance_factor=covariance_factor)
        self._offset_m, self._factor = offset_m, covariance_factor
        self._direction = np.zeros(3)

    def bind(self, seed: int, name: str) -> None:
        super().bind(seed, name)
        angle = float(self.stream("direction").uniform(-np.pi, np.pi))
        self._direction = np.array([np.cos(angle), np.sin(angle), 0.0])

    def _claims(self, moment: Moment, numbers: Ints, real: ObjectStates) -> ObjectStates:
        return real.with_(
            position=real.position + self._offset_m * self._direction, covariance=real.covariance * self._factor
        )


#: m; an object this near to the framed agent is the agent itself.
SELF_M = 4.0
#: m, by which a moved object is away from where the framed agent reports it.
OFFSET_M = 4.0
#: Cost of one more honest witness, in m of distance from the framed agent.
WITNESS_M = 1000.0


class Framing(ChangingAttack):
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

    def _cost(self, moment: Moment) -> Floats:
        """(n,) m from the framed agent, more for further witnesses; infinite for what one of both misses."""
        seen, coverage, sensor = moment.seen, moment.coverage, self._framed_sensor(moment)
        if sensor is None:
            return np.full(len(seen), np.inf)
        boxes = boxes_of(seen)
        pose = sensor.route.at(moment.time_s)
        offset = seen.position[:, :2] - pose[0][:2]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        own = moment.position[:2] - seen.position[:, :2]
        both = coverage.visible(sensor.view(*pose), boxes, boxes) & coverage.visible(moment.view, boxes)
        both &= (distance > SELF_M) & (np.hypot(own[:, 0], own[:, 1]) > SELF_M)
        return np.where(both, distance + WITNESS_M * coverage.honest_viewers(seen, both), np.inf)

    def _claims(self, moment: Moment, numbers: Ints, real: ObjectStates) -> ObjectStates | None:
        sensor = self._framed_sensor(moment)
        if self._action == "hide" or sensor is None:
            return None
        away = real.position - sensor.route.at(moment.time_s)[0]
        away[:, 2] = 0.0
        length = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-6)
        return real.with_(position=real.position + away * (OFFSET_M / length)[:, None])

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


class Replay(AdaptiveAttack):
    """Shows the objects as they were `delay_s` before, in messages with today's header.

    An object with the same track id then and now is moved back to where it was; one that has left since is shown again;
    one that has come since is hidden. Objects with the lowest ids come first, up to the budget; with a budget above the
    number of objects the whole message is old. Detections have no ids: those of now are hidden and the old ones shown.
    Source: replay in V2X, ETSI TR 102 893.

    delay_s: s, the age of what is shown
    budget:  lies per second, so the number of objects
    start_s: s of scene time at which the attack begins; at least `delay_s` after the first message
    """

    def __init__(self, *, delay_s: float = 3.0, budget: float = 2.0, start_s: float = 4.0) -> None:
        super().__init__(budget=budget, start_s=start_s)
        if not 0.0 < delay_s <= 60.0:
            raise ValueError(f"delay_s: found {delay_s}, expected more than 0 and at most 60")
        self._delay_ns = round(delay_s * 1e9)
        self._recorded: deque[tuple[int, ObjectStates]] = deque()
        self._told: set[int] = set()  # numbers of the lies in the last message
        self._number_of: dict[int, int] = {}  # by track id

    def observe(self, moment: Moment) -> None:
        self._recorded.append((moment.time_ns, moment.seen))
        while len(self._recorded) > 1 and self._recorded[1][0] <= moment.time_ns - self._delay_ns:
            self._recorded.popleft()

    def rest(self) -> None:
        self._told = set()

    def lie(self, moment: Moment) -> Lies:
        time_ns, old = self._recorded[0]
        if time_ns > moment.time_ns - self._delay_ns:
            return Lies()
        now = moment.seen
        old_row, row = _same_ids(old, now)
        gone, new = np.ones(len(old), bool), np.ones(len(now), bool)
        gone[old_row], new[row] = False, False
        kind = np.repeat([0, 1, 2], [len(row), int(gone.sum()), int(new.sum())])
        index = np.concatenate([np.arange(len(row)), np.flatnonzero(gone), np.flatnonzero(new)])
        ids = np.concatenate([now.id[row], old.id[gone], now.id[new]])
        order = np.lexsort([index, kind, ids])
        numbers = self._numbers_of(kind[order], index[order], ids[order])
        begun = np.isin(numbers, list(self._told))
        first = order[np.argsort(~begun, kind="stable")]
        chosen = first[: self.budget.admit(int(begun.sum()), len(first))]
        numbers_by_lie = np.empty(len(order), np.int64)
        numbers_by_lie[order] = numbers
        self._told = set(numbers_by_lie[chosen].tolist())
        chosen = np.sort(chosen)
        moved, shown, hidden = (chosen[kind[chosen] == each] for each in (0, 1, 2))
        return Lies(
            inserted=old.select(index[shown]).with_(id=numbers_by_lie[shown]),
            hidden=index[hidden],
            hidden_number=numbers_by_lie[hidden],
            changed=row[index[moved]],
            claims=old.select(old_row[index[moved]]),
            changed_number=numbers_by_lie[moved],
        )

    def _numbers_of(self, kind: Ints, index: Ints, ids: Ints) -> Ints:
        """The number of each lie: one for each track id; detections are numbered in order."""
        keys = np.where(ids >= 0, ids, -1 - (2 * index + (kind == 2)))
        for key in keys.tolist():
            if key not in self._number_of:
                self._number_of[key] = int(self.numbers(1)[0])
        return np.array([self._number_of[key] for key in keys.tolist()], np.int64)


def _same_ids(old: ObjectStates, now: ObjectStates) -> tuple[Ints, Ints]:
    """Rows (k,) of objects of two messages with the same track id."""
    if len(old) == 0 or len(now) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    _, first_old = np.unique(old.id, return_index=True)
    _, first_now = np.unique(now.id, return_index=True)
    old_row, now_row = first_old[old.id[first_old] >= 0], first_now[now.id[first_now] >= 0]
    same: Bools = old.id[old_row][:, None] == now.id[now_row]
    i, j = same.nonzero()
    return old_row[i], now_row[j]


@dataclass(kw_only=True, eq=False)
class PoseDrift(ObjectsUnchanged, Attack):
    """Moves the pose that an agent believes by an offset that grows slowly; on the wire `pose`.

    The agent then misplaces all its objects by as much. Source: spoofing of a vehicle's positioning, Shen et al.
    (USENIX Security 2020). It has no budget: every object of the agent is moved.

    rate_mps: m/s by which the offset grows, in a direction drawn once
    limit_m:  m, largest offset
    start_s:  s of scene time at which the attack begins
    """

    rate_mps: float = 0.2
    limit_m: float = 2.0
    start_s: float = 4.0

    def __post_init__(self) -> None:
        check("0 or more, finite", start_s=self.start_s)
        check("more than 0, finite", rate_mps=self.rate_mps, limit_m=self.limit_m)
        self._direction = np.array([1.0, 0.0, 0.0])
        self._scene = ""

    def inform(self, surroundings: Surroundings) -> None:
        self._scene = surroundings.scene

    def bind(self, seed: int, name: str) -> None:
        angle = float(stream(seed, self._scene, name, "direction").uniform(-np.pi, np.pi))
        self._direction = np.array([np.cos(angle), np.sin(angle), 0.0])

    def forge_pose(self, frame: int, time_ns: int, position: Floats) -> Floats:
        offset_m = min(self.rate_mps * (time_ns / NANOSECONDS - self.start_s), self.limit_m)
        return position if offset_m <= 0.0 else position + offset_m * self._direction
