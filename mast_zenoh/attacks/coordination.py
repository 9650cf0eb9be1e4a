"""The coordinator of several adversaries: one set of targets for all, so that their lies confirm each other."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace

import numpy as np

from mast_zenoh.arrays.ordering import canonical_order
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.attacks.adversary import OWN_TARGET_M
from mast_zenoh.attacks.campaign import NANOSECONDS, Campaign
from mast_zenoh.attacks.coverage import Coverage
from mast_zenoh.attacks.following import Follower
from mast_zenoh.attacks.propagation import Propagation, TrajectoryPropagation
from mast_zenoh.attacks.selection import CoordinatedSelection, Selection
from mast_zenoh.attacks.surroundings import UNKNOWN, Surroundings, unlimited
from mast_zenoh.attacks.targets import Targets
from mast_zenoh.tracking.view import SensorView

#: m; a victim that is nearer than this to where the ego's route has it, is the ego.
EGO_M = 3.0
#: Frames in which an object must have been reported to be a target.
ESTABLISHED = 10


class Coordination(ABC):
    """Tells adversaries, every frame, what to do in the next."""

    def bind(self, seed: int, name: str) -> None:  # noqa: B027 (a hook: what draws nothing needs no streams)
        """Name the coordinator's random streams: all draws are functions of (seed, scene, name, purpose, frame)."""

    def inform(self, surroundings: Surroundings) -> None:  # noqa: B027 (a hook)
        """What the attackers know of the scene in advance; called before `bind`."""

    def look(self, views: tuple[SensorView, ...]) -> None:  # noqa: B027 (a hook)
        """What the sensors of the victims cover at the next step, in the order of its `agent_positions`."""

    def counts(self) -> dict[str, int]:
        """How many targets it has chosen, see `Campaign.counts`; {} if that is not known."""
        return {}

    @abstractmethod
    def step(
        self, frame: int, time_ns: int, objects: ObjectStates, source: Ints, agent_positions: Floats
    ) -> tuple[Targets, ...]:
        """The directive of this frame for each of a adversaries, valid at `time_ns`.

        time_ns:         ns since the scene began
        objects:         the tracks of all victims, as they were before any tampering, world frame
        source:          (n,) int64, row of `agent_positions` of the victim that each track is from
        agent_positions: (a, 3) m, the victims, world frame

        The result does not depend on the order of the objects.
        """


class Coordinator(Coordination):
    """The same false objects and the same hidden objects for every adversary.

    All adversaries that have a place in range insert the same false objects of the world, so the centre sees one
    object confirmed by many; the number of false objects therefore saturates with the number of adversaries.

    selection:        what to add, hide and move; None: CoordinatedSelection()
    propagation:      how false objects move; None: TrajectoryPropagation()
    reselect_every_s: s, how often to choose new targets; None: never
    start_s:          s of scene time at which the first targets are chosen
    assign_radius_m:  m, how near an object must be to a target to be taken for it
    """

    def __init__(
        self,
        *,
        selection: Selection | None = None,
        propagation: Propagation | None = None,
        reselect_every_s: float | None = 20.0,
        start_s: float = 4.0,
        assign_radius_m: float = 6.0,
    ) -> None:
        self._selection = selection or CoordinatedSelection()
        self._campaign = Campaign(self._selection, propagation or TrajectoryPropagation(), reselect_every_s, start_s)
        self._follower = Follower(assign_radius_m)
        self._surroundings = UNKNOWN
        self._views: tuple[SensorView, ...] = ()

    def inform(self, surroundings: Surroundings) -> None:
        """See Coordination."""
        self._surroundings = surroundings

    def bind(self, seed: int, name: str) -> None:
        """See Coordination."""
        self._campaign.bind(seed, self._surroundings.scene, name)

    def counts(self) -> dict[str, int]:
        """See Coordination."""
        return self._campaign.counts

    def look(self, views: tuple[SensorView, ...]) -> None:
        """See Coordination."""
        self._views = views

    def step(
        self, frame: int, time_ns: int, objects: ObjectStates, source: Ints, agent_positions: Floats
    ) -> tuple[Targets, ...]:
        """See Coordination."""
        view = self._selection.view(objects, source)
        view = view.select(canonical_order(view))
        views = self._views if len(self._views) == len(agent_positions) else tuple(map(unlimited, agent_positions))
        time_s = time_ns / NANOSECONDS
        coverage = Coverage(self._surroundings, views, time_s)
        # The members of a cluster change, and with them its id: it says nothing.
        self._follower.observe(view.with_(id=np.full(len(view), -1, np.int64)), time_ns)
        if self._campaign.due(time_ns):
            view = view.select(self._follower.established(ESTABLISHED))
            ego = ego_among(agent_positions, self._surroundings, time_s)
            coverage = replace(coverage, ego_tracks=None if ego is None else objects.select(source == ego))
        targets = self._campaign.begin(frame, time_ns, view, coverage)
        if targets is None:
            return (Targets.empty(time_ns),) * len(agent_positions)
        targets, _, _ = self._follower.bring(targets, OWN_TARGET_M)
        self._campaign.hold(targets, time_ns)
        return (targets,) * len(agent_positions)


def ego_among(agent_positions: Floats, surroundings: Surroundings, time_s: float) -> int | None:
    """Row of the victim (a, 3) m that is where the ego's route has it at a time; None if none is."""
    ego = surroundings.ego_sensor
    if ego is None or len(agent_positions) == 0:
        return None
    offset = agent_positions[:, :2] - ego.route.at(time_s)[0][:2]
    distance = np.hypot(offset[:, 0], offset[:, 1])
    row = int(np.argmin(distance))
    return row if distance[row] < EGO_M else None
