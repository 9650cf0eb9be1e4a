"""The coordinator of several adversaries, which directs them to common targets."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates, canonical_order
from mast_zenoh.attacks.adaptive import Budget
from mast_zenoh.attacks.attack import OWN_TARGET_M
from mast_zenoh.attacks.campaign import NANOSECONDS, Campaign, Propagation, TrajectoryPropagation
from mast_zenoh.attacks.following import Follower
from mast_zenoh.attacks.knowledge import Attacker, TrustWatch, TrustWatcher
from mast_zenoh.attacks.phantoms import BOX
from mast_zenoh.attacks.regions import REGIONS, Shape
from mast_zenoh.attacks.selection import CoordinatedSelection, Selection, ground_height
from mast_zenoh.attacks.surroundings import UNKNOWN, Coverage, Surroundings, boxes_of, unlimited
from mast_zenoh.attacks.targets import Targets
from mast_zenoh.tracking.view import SensorView

#: m; a victim within this distance of the ego's route position is the ego.
EGO_M = 3.0
#: Number of frames in which an object must have been reported before it can be a target.
ESTABLISHED = 10


class Coordination(Attacker):
    """Base class of coordinators: directs adversaries, in every frame for the next."""

    def look(self, views: tuple[SensorView, ...]) -> None:
        """Set the victims' fields of view for the next step.

        In the order of `agent_positions` of `step`.
        """

    def locate(self, rotations: Floats, velocities: Floats) -> None:
        """Set the victims' orientations (a, 3, 3) and velocities (a, 3) m/s for the next step, world frame.

        Rotations are active, agent to world. The order is that of `agent_positions` of `step`.
        """

    @abstractmethod
    def step(
        self, frame: int, time_ns: int, objects: ObjectStates, source: Ints, agent_positions: Floats
    ) -> tuple[Targets, ...]:
        """The directive of this frame for each of a adversaries, valid at `time_ns`.

        time_ns:         ns since the start of the scene
        objects:         the original tracks of all victims before tampering, world frame
        source:          (n,) int64, row of `agent_positions` of the victim of each track
        agent_positions: (a, 3) m, the victims, world frame

        The result does not depend on the order of the objects.
        """


@dataclass(kw_only=True, eq=False)
class Coordinator(Coordination):
    """Directs every adversary to the same false objects and the same hidden objects.

    All adversaries in range insert the same false objects, so that the command centre sees each one confirmed by many;
    the number of false objects therefore saturates with the number of adversaries.

    selection:        which objects to add, hide and move; None: CoordinatedSelection()
    propagation:      motion of false objects; None: TrajectoryPropagation()
    reselect_every_s: s, interval between selections of new targets; None: select once
    start_s:          s of scene time at which the first targets are selected
    assign_radius_m:  m, maximum distance between a target and its object
    """

    selection: Selection | None = None
    propagation: Propagation | None = None
    reselect_every_s: float | None = 20.0
    start_s: float = 4.0
    assign_radius_m: float = 6.0

    def __post_init__(self) -> None:
        self._selection = self.selection or CoordinatedSelection()
        motion = self.propagation or TrajectoryPropagation()
        self._campaign = Campaign(self._selection, motion, self.reselect_every_s, self.start_s)
        self._follower = Follower(self.assign_radius_m)
        self._surroundings = UNKNOWN
        self._views: tuple[SensorView, ...] = ()

    def inform(self, surroundings: Surroundings) -> None:
        self._surroundings = surroundings

    def bind(self, seed: int, name: str) -> None:
        self._campaign.bind(seed, self._surroundings.scene, name)

    def counts(self) -> dict[str, int]:
        return self._campaign.counts

    def look(self, views: tuple[SensorView, ...]) -> None:
        self._views = views

    def step(
        self, frame: int, time_ns: int, objects: ObjectStates, source: Ints, agent_positions: Floats
    ) -> tuple[Targets, ...]:
        view = self._selection.view(objects, source)
        view = view.select(canonical_order(view))
        # The id of a cluster changes with its members, so it is ignored.
        self._follower.observe(view.with_(id=np.full(len(view), -1, np.int64)), time_ns)

        def scene() -> tuple[ObjectStates, Coverage]:
            coverage = self._coverage(time_ns / NANOSECONDS, objects, source, agent_positions)
            return view.select(self._follower.established(ESTABLISHED)), coverage

        targets = self._campaign.begin(frame, time_ns, scene)
        if targets is None:
            return (Targets.empty(time_ns),) * len(agent_positions)
        targets, _, _ = self._follower.follow(targets, OWN_TARGET_M)
        self._campaign.store(targets, time_ns)
        return (targets,) * len(agent_positions)

    def _coverage(self, time_s: float, objects: ObjectStates, source: Ints, agent_positions: Floats) -> Coverage:
        """What the agents cover; the arguments are those of `step`."""
        views = self._views if len(self._views) == len(agent_positions) else tuple(map(unlimited, agent_positions))
        agents = np.concatenate([agent_positions, self._surroundings.other_positions(time_s)])
        agents = agents[np.lexsort(agents.T)]  # the same draws whichever of them are compromised
        ego = ego_among(agent_positions, self._surroundings, time_s)
        ego_tracks = None if ego is None else objects.select(source == ego)
        return Coverage(self._surroundings, views, time_s, ego_tracks=ego_tracks, agents=agents)


def ego_among(agent_positions: Floats, surroundings: Surroundings, time_s: float) -> int | None:
    """Row of the victim (a, 3) m at the ego's route position; None if there is none."""
    ego = surroundings.ego_sensor
    if ego is None or len(agent_positions) == 0:
        return None
    offset = agent_positions[:, :2] - ego.route.at(time_s)[0][:2]
    distance = np.hypot(offset[:, 0], offset[:, 1])
    row = int(np.argmin(distance))
    return row if distance[row] < EGO_M else None


#: m, within which tracks of different adversaries are one object.
CLUSTER_M = 3.0


@dataclass(kw_only=True, eq=False)
class ColludingSelection(Selection):
    """Selects false objects and objects to hide where the compromised agents outnumber the honest ones that look.

    Half of the objects are false ones, in the region "outnumbered"; the others are real ones that more compromised than
    honest agents see, those with the fewest honest witnesses first. If there are too few of these, fewer are hidden. As
    long as there is nothing to lie about, it selects again in every frame.

    budget:    lies per second of all adversaries together: each target costs one per adversary
    speed_mps: σ per axis of the speed of false objects
    """

    until_found = True
    cluster_radius_m = CLUSTER_M

    budget: float = 4.0
    speed_mps: float = 5.0

    def __post_init__(self) -> None:
        Budget(self.budget)
        check("0 or more, finite", speed_mps=self.speed_mps)

    def select(self, objects: ObjectStates, coverage: Coverage, rng: np.random.Generator) -> Targets:
        objects = objects.select(canonical_order(objects))
        total = int(self.budget / max(1, len(coverage.victims)))
        cost = self._cost(objects, coverage)
        hidden = np.argsort(cost, kind="stable")[: total // 2]
        hidden = np.sort(hidden[np.isfinite(cost[hidden])])
        wanted = total - total // 2 if coverage.victims else 0
        shape = Shape(30.0, self.speed_mps, BOX)
        false = REGIONS["outnumbered"].objects(wanted, shape, objects, ground_height(objects), coverage, rng)
        none = ObjectStates.empty()
        found = len(false) + len(hidden) > 0
        targets = Targets(false, objects.select(hidden), none, np.zeros((0, 3)), wanted=wanted if found else 0)
        return targets.numbered(0)

    @staticmethod
    def _cost(objects: ObjectStates, coverage: Coverage) -> Floats:
        """(n,) honest witnesses of each object, infinite where they are not outnumbered."""
        boxes = boxes_of(objects)
        liars = np.zeros(len(objects), np.int64)
        for view in coverage.victims:
            liars += coverage.visible(view, boxes, boxes)
        witnesses = coverage.honest_viewers(objects)
        return np.where(liars > witnesses, witnesses.astype(np.float64), np.inf)


class Collusion(TrustWatcher, Coordinator):
    """Lets adversaries confirm one another's false objects and suppress real ones together, at a common budget.

    Where more liars than honest agents look, neither a majority nor a k-of-n rule can tell who is right. Each adversary
    needs a `CoordinatedAttack`. While the trust in one of their agents is more than `tolerance` below its highest
    value (a coordinator that hears it), all of them are honest. Source: the bound
    of secure state estimation, which needs a majority of honest observers.

    budget:           lies per second of all adversaries together, at least as many as there are adversaries
    speed_mps:        σ per axis of the speed of false objects
    tolerance:        0 to 1, fall of the trust that is accepted
    reselect_every_s: s, interval between selections of new targets; None: select once
    start_s:          s of scene time at which the first targets are selected
    """

    def __init__(
        self,
        *,
        budget: float = 4.0,
        speed_mps: float = 5.0,
        tolerance: float = 0.05,
        reselect_every_s: float | None = 5.0,
        start_s: float = 4.0,
    ) -> None:
        selection = ColludingSelection(budget=budget, speed_mps=speed_mps)
        super().__init__(selection=selection, reselect_every_s=reselect_every_s, start_s=start_s)
        self._watch = TrustWatch(tolerance)

    def step(
        self, frame: int, time_ns: int, objects: ObjectStates, source: Ints, agent_positions: Floats
    ) -> tuple[Targets, ...]:
        plans = super().step(frame, time_ns, objects, source, agent_positions)
        return (Targets.empty(time_ns),) * len(plans) if self._watch.fallen else plans
