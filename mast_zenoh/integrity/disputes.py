"""What agents say of each object, who contradicts whom, and tracks that no honest agent sends.

Which agents must be lying, and which may be, given who disagrees with whom.

Two agents that disagree about what is there are not both honest. So the liars are a vertex cover of the graph of
disputes: a set of agents that contains one of each two that disagree. A set of fewer than half of the agents is an
explanation. What is true in every explanation holds whatever the liars say, as long as they are fewer than half; what
differs between explanations, nobody can know (secure state estimation: Fawzi, Tabuada, Diggavi, IEEE Transactions on
Automatic Control 2014, proposition 3).

Sets of agents are whole numbers, with bit i for agent i.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.matching import neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.integrity.base import Batch, ClusterBoxes
from mast_zenoh.integrity.deviations import column_medians, group_medians
from mast_zenoh.integrity.visibility import (
    RayEvidence,
    Sightings,
    better_known,
    carrying,
    current,
    lenient_sightings,
    out_of_view,
    passed_nearby,
    passed_to_others,
    rays_at,
)
from mast_zenoh.tracking.tracks import ONE_OBJECT, overlap

#: m, length, width and height of road users: from a small child to the longest and highest vehicles that Directive
#: 96/53/EC allows (18.75, 2.6 and 4.0 m), with half a metre for errors.
SMALLEST_M, LARGEST_M = (0.1, 0.1, 0.3), (19.25, 3.1, 4.5)
#: Steepest slope of the ground, and m by which the lower edge of a box may be off.
SLOPE, HEIGHT_ERROR_M = 0.12, 1.5
#: Share of ONE_OBJECT from which two tracks of one agent are of one object: trackers merge those at ONE_OBJECT, and
#: a batch moves them to another time.
REPEATED = 0.8 * ONE_OBJECT
#: Agents that must report an object before another one's silence about it contradicts them: trackers of honest agents
#: are late by some frames, and lose objects for some.
WITNESSES = 2
#: m, horizontally and vertically, from an agent's track to the middle box of its object, up to which others' denial of
#: the box contradicts the agent: two liars that report an object elsewhere move the box, and not the honest track.
SAME_PLACE_M, SAME_HEIGHT_M = 1.0, 0.75
#: m, between outlines of objects that nearly touch; m/s, from which objects drive, and by which the velocities of two
#: that drive as one differ at most. Who drives behind another one keeps more distance.
TOUCH_M, DRIVES_MPS, AS_ONE_MPS = 1.0, 3.0, 2.0
#: m, from an object, within which an agent's track may be of it: it is not silent about the object. The clusterer's
#: radius.
ABOUT_M = 2.0


def plausible_size(states: ObjectStates) -> Bools:
    """(n,) tracks of boxes that road users have."""
    return np.asarray(((states.size >= SMALLEST_M) & (states.size <= LARGEST_M)).all(axis=1))


def on_ground(states: ObjectStates, agent: Ints, agents: int) -> Bools:
    """(n,) tracks of boxes that may stand on the ground.

    agent: (n,) rows of the agents;  agents: how many there are, with those that report nothing

    Each agent's boxes stand at its median: one with many boxes does not move the ground. It is where it may be if fewer
    than half of all agents lie: between the medians that so many others leave below and above. It rises or falls by
    SLOPE at most.
    """
    if len(states) <= 2:
        return np.ones(len(states), np.bool_)
    bottom = states.position[:, 2] - 0.5 * states.size[:, 2]
    middles = group_medians(np.column_stack([states.position[:, :2], bottom]), agent)
    heights, last = np.sort(middles[:, 2]), len(middles) - 1
    liars = min((agents - 1) // 2, last)
    low, high = heights[min(liars, last - liars)], heights[max(liars, last - liars)]
    x, y = column_medians(middles[:, :2])
    reach = HEIGHT_ERROR_M + SLOPE * np.hypot(states.position[:, 0] - x, states.position[:, 1] - y)
    return np.asarray((bottom >= low - reach) & (bottom <= high + reach))


def of_tracks(batch: Batch, tracks: Bools) -> Bools:
    """(c, a) whether the agent reports the object by one of some tracks (n,)."""
    result = np.zeros(batch.reported.shape, np.bool_)
    result[batch.labels[tracks], batch.agent[tracks]] = True
    return result


def repeated(batch: Batch) -> Bools:
    """(n,) tracks that overlap an earlier one of the same agent, by id, so far that both are of one object."""
    states = batch.states
    result = np.zeros(len(states), np.bool_)
    reach = REPEATED * np.maximum(np.maximum(states.size[:, 0], states.size[:, 1]), 0.0)
    i, j, dx, dy = neighbours(states.position, states.position, np.minimum(reach, LARGEST_M[0]))
    pair = (batch.agent[i] == batch.agent[j]) & (i != j) & (states.id[i] <= states.id[j])
    i, j, offset = i[pair], j[pair], np.column_stack([dx[pair], dy[pair]])
    same = overlap(offset, states.size[i], states.yaw[i], states.size[j], states.yaw[j], REPEATED)
    result[j[same]] = True
    return result


def in_place(batch: Batch, boxes: ClusterBoxes) -> Bools:
    """(n,) tracks that are where the middle boxes of their clusters are."""
    away = np.abs(batch.states.position - boxes.position[batch.labels])
    return np.asarray((np.hypot(away[:, 0], away[:, 1]) <= SAME_PLACE_M) & (away[:, 2] <= SAME_HEIGHT_M))


def attached(boxes: ClusterBoxes, few: Bools, certain: Bools, beside: tuple[Ints, Ints, Floats]) -> tuple[Bools, Bools]:
    """(c,) objects of few agents close before or behind a certain one, in its path; (c,) those that drive as one.

    boxes: of the clusters; few: (c,) whether fewer than half of the agents report it; certain: (c,) whether it exists
    beside: see `better_known`
    """
    i, j, offset = beside
    velocity, other = boxes.velocity[i, :2], boxes.velocity[j, :2]
    across = np.abs(np.cos(boxes.yaw[j]) * offset[:, 1] - np.sin(boxes.yaw[j]) * offset[:, 0])
    grown = boxes.size + np.array([2.0 * TOUCH_M, 2.0 * TOUCH_M, 0.0])
    touches = few[i] & certain[j] & (across <= 0.5 * boxes.size[j, 1])
    touches &= overlap(offset, boxes.size[i], boxes.yaw[i], grown[j], boxes.yaw[j], 1.0)
    as_one = (np.linalg.norm(velocity, axis=1) >= DRIVES_MPS) & (np.linalg.norm(velocity - other, axis=1) <= AS_ONE_MPS)
    touching, driving = np.zeros((2, len(few)), np.bool_)
    touching[i[touches]] = True
    driving[i[touches & as_one]] = True
    return touching, driving


def reports_nearby(batch: Batch, boxes: ClusterBoxes) -> Bools:
    """(c, a) whether the agent has a track within ABOUT_M of the object, in any cluster. boxes: of the clusters"""
    result = batch.reported.copy()
    i, j, _, _ = neighbours(boxes.position, batch.states.position, np.full(batch.clusters, ABOUT_M))
    result[i, batch.agent[j]] = True
    return result


#: What counts against an agent, in words.
ACCUSATIONS = (
    "reports objects that others see through",
    "reports objects that no road user can be",
    "reports one object twice",
)
#: Of these, what an agent's own reports show.
OF_ITSELF = slice(1, None)
#: sr; an object that looks smaller may go unnoticed (a lidar with 0.2 by 0.9 degrees has some 50 returns of this).
CONSPICUOUS_SR = 2.5e-3
#: m, farther away nothing is conspicuous.
CONSPICUOUS_M = 60.0


def conspicuous(size: Floats, distance: Floats) -> Bools:
    """(c, a) whether objects of a size (c, 3) m are easy to notice from (c, a) m away."""
    area = 0.5 * (size[:, 0] + size[:, 1]) * size[:, 2]
    return np.asarray((distance <= CONSPICUOUS_M) & (area[:, None] >= CONSPICUOUS_SR * distance**2))


@dataclass(frozen=True, slots=True, eq=False)
class Testimonies:
    """What each of `a` agents says of each of `c` objects.

    claims: (c, a) reports it there, in its own view, and nothing that its own sensor shows speaks against it
    denies: (c, a) most of its rays pass through it
    silent: (c, a) does not report it, though its rays end there, it is clear to see, and WITNESSES report it
    impossible:   (c, a) reports it as a box that no road user has;  repeated: (c, a) reports it for the second time
    """

    claims: Bools
    denies: Bools
    silent: Bools
    impossible: Bools
    repeated: Bools

    @classmethod
    def of(
        cls,
        batch: Batch,
        boxes: ClusterBoxes,
        own: Bools,
        impossible: Bools,
        seen: Sightings,
        rays: RayEvidence,
        outside: Bools,
        voter: Bools,
    ) -> Testimonies:
        """The testimonies of a batch.

        boxes: of its clusters; own: (c, a) whether the agent sees through its own track of the object
        impossible: (c, a) see `Testimonies`
        seen, rays: what the sensors see of the objects, and what their rays show
        outside: (c, a) whether the agent reports the object outside its own view
        voter: (a,) agents that are not suspended: others accuse nobody
        """
        reported = batch.reported
        claims = reported & ~own & ~outside & ~impossible & of_tracks(batch, in_place(batch, boxes))
        silent = ~reports_nearby(batch, boxes) & ~rays.mostly_clear & rays.ends & seen.in_view
        least = np.full((batch.clusters, 3), np.inf)  # reported sizes: two liars can make the middle one large
        np.minimum.at(least, batch.labels, batch.states.size)
        silent &= conspicuous(least, seen.distance)
        return cls(
            claims=claims,
            denies=rays.mostly_clear & ~reported & voter,
            silent=silent & ((claims & voter).sum(axis=1) >= WITNESSES)[:, None],
            impossible=impossible,
            repeated=of_tracks(batch, repeated(batch)),
        )

    def between(self, counted: Bools) -> Ints:
        """(a, a) number of objects about which two agents contradict each other. counted: (c, a) reports that count"""
        against = (self.claims & counted).T.astype(np.int64) @ (self.denies | self.silent)
        return np.asarray(against + against.T)

    @property
    def contradicted(self) -> Bools:
        """(c, a) reports that others deny, or that contradict themselves."""
        denied = self.claims & self.denies.any(axis=1, keepdims=True)
        return np.asarray(denied | self.impossible | self.repeated)

    def accusations(self, word: Floats) -> Floats:
        """(3, c, a) 0 to 1, how much contradicts the reports of an agent, in the order of ACCUSATIONS.

        word: (a,) how much an agent's word counts against another's: 1 is enough; 0: it lies in every explanation

        Withheld, but no accusation, is what an agent's own sensor sees through: honest detectors make false detections
        where nothing is. What an agent does not report is none either: the object stays in the picture as long as
        another one reports it, and things that a sensor does not see are easier to make than things that are not there
        (TrustFlip).
        """
        denied = self.claims * np.minimum(self.denies @ word, 1.0)[:, None]
        return np.stack([denied, self.impossible, self.repeated])


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """A batch with the middle boxes of its clusters, what sensors see of them, and what agents say of them.

    out_of_view: (c, a) whether the agent reports the object outside its own view
    passed: (c, a) whether its rays pass the place of the object, beside another one or the sensor
    touching, attached: (c,) objects that few report close to another one, and those that drive as one with it
    """

    batch: Batch
    boxes: ClusterBoxes
    seen: Sightings
    rays: RayEvidence
    out_of_view: Bools
    passed: Bools
    touching: Bools
    attached: Bools
    testimonies: Testimonies

    @classmethod
    def of(cls, batch: Batch, voter: Bools) -> Evidence:
        """The evidence of a batch. voter: (a,) agents that are not suspended"""
        states = batch.states
        impossible = of_tracks(batch, ~(plausible_size(states) & on_ground(states, batch.agent, len(batch.agents))))
        boxes = ClusterBoxes.of(batch, ~impossible & voter)
        seen, own = lenient_sightings(batch, boxes)
        views = current(batch.views)
        rays = rays_at(batch, boxes, views)
        outside = of_tracks(batch, out_of_view(batch))
        testimonies = Testimonies.of(batch, boxes, own, impossible, seen, rays, outside, voter)
        claims = testimonies.claims & voter
        carried = carrying(boxes, views) & voter & ~batch.reported & claims.any(axis=1, keepdims=True)
        vouching = (claims | carried).sum(axis=1)
        beside = better_known(boxes, vouching)
        passed = passed_to_others(batch, boxes, rays, voter, beside) | passed_nearby(batch, boxes, seen, voter)
        certain = (2 * vouching > len(voter)) | (carried.any(axis=1) & ~testimonies.denies.any(axis=1))
        few = 2 * (batch.reported & voter).sum(axis=1) < len(voter)
        touching, driving = attached(boxes, few, certain, beside)
        return cls(batch, boxes, seen, rays, outside, passed, touching, driving, testimonies)


#: Results that are remembered for one graph of disputes: liars that flood it with disputes gain no memory by it.
_REMEMBERED = 4096
#: Branches of the search for covers, in one question; 40 agents need fewer. Beyond, nothing counts as certain.
BRANCHES = 10_000


class Verdict(NamedTuple):
    """What the explanations say of `a` agents.

    lying: (a,) whether the agent lies in every explanation
    undecided: (a,) whether it lies in one that needs it, and in another one it does not; without an explanation:
        whether it disagrees with anybody
    """

    lying: Bools
    undecided: Bools


class Explanations:
    """The sets of agents, fewer than half of all, that contain one of each two that disagree.

    disputes: (a, a) bool, symmetric, which agents disagree
    lying:    (a,) which agents are known to lie: they are in every set
    honest:   (a,) which are known to be honest: they are in none
    left_out: (a,) which disagree about something else, too, that is left out here; None: nobody
    branches: of the search for covers, in one question

    branches_left: of the last question; below 0: it took too long, and nothing counts as certain
    """

    def __init__(
        self, disputes: Bools, lying: Bools, honest: Bools, left_out: Bools | None = None, branches: int = BRANCHES
    ) -> None:
        a = len(lying)
        self._agents = a
        self._others = [mask_of(row) for row in disputes]
        self._lying, self._honest = mask_of(lying & ~honest), mask_of(honest)
        self._left_out = np.zeros(a, np.bool_) if left_out is None else left_out & ~honest
        self._most = (a - 1) // 2
        self._branches = self.branches_left = branches
        self._fewest_of: dict[int, int] = {}

    @property
    def whole(self) -> bool:
        """Whether they explain all disputes."""
        return not self._left_out.any()

    def possible(self, lying: int = 0, honest: int = 0) -> bool:
        """Whether there is an explanation in which some agents lie and others do not."""
        lying |= self._lying
        honest |= self._honest
        for agent in members(honest):
            lying |= self._others[agent]
        if lying & honest:
            return False
        return self._fewest(lying) <= self._most

    def verdict(self) -> Verdict:
        """What the explanations say of each agent."""
        self.branches_left = self._branches
        every = range(self._agents)
        if not self.possible():
            lying = np.array([bool(self._lying >> agent & 1) for agent in every], np.bool_)
            disputed = [bool(others) and not self._honest >> agent & 1 for agent, others in enumerate(self._others)]
            return Verdict(lying, ~lying & (self._left_out | np.array(disputed, np.bool_)))
        honest = [self.possible(honest=1 << agent) for agent in every]
        # An agent lies in an explanation that needs it if one of those that it disagrees with is honest there.
        needed = [
            any(honest[other] for other in members(others)) and not self._honest >> agent & 1
            for agent, others in enumerate(self._others)
        ]
        may_be_honest = np.array(honest, np.bool_)
        return Verdict(~may_be_honest, may_be_honest & (self._left_out | np.array(needed, np.bool_)))

    def false(self, claiming: Bools, denying: Bools) -> Bools:
        """(c,) which of c claims are false in every explanation.

        claiming, denying: (c, a) agents that make each claim, and that deny it

        Either all that claim it lie, or all that deny it. It is false if all that claim it may be lying, and in no
        explanation all that deny it lie while one that claims it is honest. Where neither side can be lying, nothing is
        proved. Without an explanation, what known liars alone claim is false.
        """
        self.branches_left = self._branches
        claims = [(mask_of(claim), mask_of(denial)) for claim, denial in zip(claiming, denying, strict=True)]
        if not self.possible():
            return np.array([not claim & ~self._lying for claim, _ in claims], np.bool_)
        result = [
            self.possible(claim) and not any(self.possible(denial, 1 << agent) for agent in members(claim))
            for claim, denial in claims
        ]
        return np.array(result, np.bool_)

    def _fewest(self, lying: int) -> int:
        """Size of the smallest cover that contains some agents; beyond `_most`, only that it is larger."""
        known = self._fewest_of.get(lying)
        if known is None:
            known = lying.bit_count() + self._cover(lying, self._most - lying.bit_count())
            if self.branches_left >= 0 and len(self._fewest_of) < _REMEMBERED:
                self._fewest_of[lying] = known
        return known

    def _cover(self, gone: int, most: int) -> int:
        """Size of the smallest cover of the disputes without some agents; more than `most` if it is larger.

        When all branches are used up, a lower bound, so that no agent seems to lie that may be honest.
        Branches on the agent with the most disputes left: it lies, or all that it disagrees with do.
        """
        left = [0 if gone >> agent & 1 else others & ~gone for agent, others in enumerate(self._others)]
        degrees = [others.bit_count() for others in left]
        degree = max(degrees, default=0)
        if degree == 0:
            return 0
        if most <= 0 or sum(degrees) > 2 * degree * most:  # `most` agents have fewer disputes
            return most + 1
        self.branches_left -= 1
        if self.branches_left < 0:
            return -(-sum(degrees) // (2 * degree))
        agent = degrees.index(degree)
        rest = gone | left[agent] | 1 << agent
        if degree == 1:  # pairs alone are left: either lies
            return 1 + self._cover(rest, most - 1)
        lies = 1 + self._cover(gone | 1 << agent, most - 1)
        most = min(most, lies - 1)
        return min(lies, degree + self._cover(rest, most - degree)) if degree <= most else lies


def explained(disputes: Bools, strength: Floats, lying: Bools, honest: Bools) -> Explanations:
    """The explanations of all disputes; where there is none, of the strongest.

    disputes, lying, honest: see `Explanations`;  strength: (a, a) of each dispute

    Disputes are taken the strongest first, those of one strength together, unless there is no explanation with them:
    honest agents disagree by chance, too. It is open whether those lie whose disputes are left out.
    """
    every = Explanations(disputes, lying, honest)
    if every.possible():
        return every
    kept, left = np.zeros_like(disputes), BRANCHES
    for level in np.unique(strength[disputes])[::-1].tolist():
        tried = Explanations(more := kept | (disputes & (strength == level)), lying, honest, branches=left)
        if tried.possible() and tried.branches_left >= 0:
            kept = more
        left = max(tried.branches_left, 0)
    return Explanations(kept, lying, honest, left_out=np.asarray((disputes & ~kept).any(axis=1)))


def mask_of(members: Bools) -> int:
    """The set of the agents (a,) for which it is true."""
    return sum(1 << agent for agent in np.flatnonzero(members).tolist())


def members(mask: int) -> Iterator[int]:
    """The agents of a set, in their order."""
    while mask:
        lowest = mask & -mask
        yield lowest.bit_length() - 1
        mask ^= lowest
