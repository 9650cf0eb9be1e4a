"""The coordinator of several adversaries: one set of targets for all, so that their lies confirm each other."""

from __future__ import annotations

from abc import ABC, abstractmethod

from mast_zenoh.attacks.application import follow
from mast_zenoh.attacks.campaign import Campaign
from mast_zenoh.attacks.propagation import Propagation, TrajectoryPropagation
from mast_zenoh.attacks.selection import CoordinatedSelection, Selection
from mast_zenoh.attacks.targets import Targets
from mast_zenoh.states import Floats, Ints, ObjectStates


class Coordination(ABC):
    """Tells adversaries, every frame, what to do in the next."""

    def bind(self, seed: int, name: str) -> None:  # noqa: B027 (a hook: what draws nothing needs no streams)
        """Name the coordinator's random streams: all its draws are functions of (seed, name, purpose, frame)."""

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
        self._assign_radius_m = assign_radius_m

    def bind(self, seed: int, name: str) -> None:
        self._campaign.bind(seed, name)

    def step(
        self, frame: int, time_ns: int, objects: ObjectStates, source: Ints, agent_positions: Floats
    ) -> tuple[Targets, ...]:
        view = self._selection.view(objects, source)
        begun = self._campaign.begin(frame, time_ns, view, agent_positions)
        if begun is None:
            return (Targets.empty(time_ns),) * len(agent_positions)
        targets, elapsed = begun
        targets, _, _ = follow(targets, view, assign_radius_m=self._assign_radius_m, elapsed_s=elapsed)
        self._campaign.hold(targets, time_ns)
        return (targets,) * len(agent_positions)
