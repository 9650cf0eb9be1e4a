"""The coordinator of several adversaries, which directs them to common targets."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from mast_zenoh.arrays.ordering import canonical_order
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.attacks.attack import OWN_TARGET_M
from mast_zenoh.attacks.campaign import NANOSECONDS, Campaign
from mast_zenoh.attacks.coverage import Coverage
from mast_zenoh.attacks.following import Follower
from mast_zenoh.attacks.knowledge import Trust
from mast_zenoh.attacks.propagation import Propagation, TrajectoryPropagation
from mast_zenoh.attacks.selection import CoordinatedSelection, Selection
from mast_zenoh.attacks.surroundings import UNKNOWN, Surroundings, unlimited
from mast_zenoh.attacks.targets import Targets
from mast_zenoh.tracking.view import SensorView

#: m; a victim within this distance of the ego's route position is the ego.
EGO_M = 3.0
#: Number of frames in which an object must have been reported before it can be a target.
ESTABLISHED = 10


class Coordination(ABC):
    """Base class of coordinators: directs adversaries, in every frame for the next."""

    def bind(self, seed: int, name: str) -> None:  # noqa: B027 (a hook: without random numbers it needs no streams)
        """Set the random streams, named by (seed, scene, name, purpose, frame)."""

    def inform(self, surroundings: Surroundings) -> None:  # noqa: B027 (a hook)
        """Set the attackers' prior knowledge of the scene; called before `bind`."""

    def look(self, views: tuple[SensorView, ...]) -> None:  # noqa: B027 (a hook)
        """Set the victims' fields of view for the next step.

        In the order of `agent_positions` of `step`.
        """

    def locate(self, rotations: Floats, velocities: Floats) -> None:  # noqa: B027 (a hook)
        """Set the victims' orientations (a, 3, 3) and velocities (a, 3) m/s for the next step, world frame.

        Rotations are active, agent to world. The order is that of `agent_positions` of `step`.
        """

    def hear_picture(self, frame: int, time_ns: int, objects: ObjectStates) -> None:  # noqa: B027 (a hook)
        """Take note of a picture that arrived in an earlier frame, see `Attack.hear_picture`."""

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:  # noqa: B027 (a hook)
        """Take note of the command centre's trust from an earlier frame, see `Attack.hear_trust`."""

    def counts(self) -> dict[str, int]:
        """Numbers of selected targets, see `Campaign.counts`; {} if unknown."""
        return {}

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
