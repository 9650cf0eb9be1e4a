"""The whole state machine of an adversary: one step per intercepted message. World frame throughout."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace

from mast_zenoh.arrays.geometry import within_range
from mast_zenoh.arrays.ordering import canonical_order
from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.attacks.application import carry_out
from mast_zenoh.attacks.campaign import NANOSECONDS, Campaign, check_start
from mast_zenoh.attacks.coverage import Coverage
from mast_zenoh.attacks.following import Follower
from mast_zenoh.attacks.imitation import ForgedIds, Imitation, VictimLike
from mast_zenoh.attacks.propagation import Propagation, TrajectoryPropagation
from mast_zenoh.attacks.selection import Selection, UncoordinatedSelection
from mast_zenoh.attacks.surroundings import UNKNOWN, Surroundings, unlimited
from mast_zenoh.attacks.targets import Tampering, Targets
from mast_zenoh.tracking.view import SensorView

#: m; an object within this of a coordinator's target, which is the mean of several agents' tracks, may be that target.
ATTACH_M = 2.5
#: m; a target that an adversary has chosen itself is at its object.
OWN_TARGET_M = 0.1
#: Messages in which an object must have been seen to be a target.
ESTABLISHED = 3
#: s, for how long objects are followed before the attack begins, so that their velocities are known.
LEAD_S = 1.0


class Attack(ABC):
    """What an adversary does to the messages of its victim."""

    def bind(self, seed: int, name: str) -> None:  # noqa: B027 (a hook: what draws nothing needs no streams)
        """Name the adversary's random streams: all its draws are functions of (seed, scene, name, purpose, frame)."""

    def inform(self, surroundings: Surroundings) -> None:  # noqa: B027 (a hook)
        """What the attacker knows of the scene in advance; called before `bind`."""

    def look(self, view: SensorView, *, fused: bool) -> None:  # noqa: B027 (a hook)
        """What the victim's sensor covers at the next step; fused: the objects are those of several agents."""

    def counts(self) -> dict[str, int]:
        """How many targets it has chosen, see `Campaign.counts`; {} if it chooses none itself."""
        return {}

    @abstractmethod
    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        """What happens to the objects of one message.

        frame:          index of the message's frame
        time_ns:        ns, its time since the scene began
        objects:        the victim's objects, world frame: tracks, or detections (velocity zero, ids below 0)
        agent_position: (3,) m, the victim, world frame
        directive:      the coordinator's newest targets of an earlier frame, if there are any

        The result does not depend on the order of the objects.
        """


class PassThrough(Attack):
    """Sits on the wire and changes nothing."""

    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        return Tampering.nothing(len(objects))


class _TargetedAttack(Attack):
    """What attacks with targets share: following objects, imitating the victim's rows, and doing it.

    start_s:          s of scene time at which the attack begins
    max_range_m:      m, false objects farther from the victim are held back
    assign_radius_m:  m, the farthest that an object may be from where its target is believed to be, however long ago it
                      was seen
    imitation:        how false objects are made to look; None: VictimLike()
    id_gap:           how far above the victim's highest track id the ids of false objects begin
    """

    def __init__(
        self,
        *,
        start_s: float,
        max_range_m: float,
        assign_radius_m: float,
        imitation: Imitation | None,
        id_gap: int,
    ) -> None:
        check_start(start_s)
        self._start_ns = round(start_s * NANOSECONDS)
        self._max_range_m = max_range_m
        self._imitation = imitation or VictimLike()
        self._ids = ForgedIds(id_gap)
        self._follower = Follower(assign_radius_m)
        self._surroundings = UNKNOWN
        self._view: SensorView | None = None
        self._fused = False

    def inform(self, surroundings: Surroundings) -> None:
        """See Attack."""
        self._surroundings = surroundings

    def bind(self, seed: int, name: str) -> None:
        """See Attack."""
        self._imitation.bind(seed, self._surroundings.scene, name)

    def look(self, view: SensorView, *, fused: bool) -> None:
        """See Attack."""
        self._view, self._fused = view, fused

    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        """See Attack."""
        order = canonical_order(objects)
        seen = objects.select(order)
        self._ids.observe(objects.id)
        self._imitation.observe(seen, time_ns, agent_position)
        if time_ns >= self._start_ns - LEAD_S * NANOSECONDS:
            self._follower.observe(seen, time_ns)
        view = unlimited(agent_position) if self._view is None else self._view
        coverage = Coverage(self._surroundings, (view,), time_ns / NANOSECONDS, self._fused)
        targets = self._targets_at(frame, time_ns, seen, coverage, directive)
        if targets is None:
            return Tampering.nothing(len(objects))
        targets, remove_row, move_row = self._follower.bring(targets, self._attach_m)
        near = targets.add.select(within_range(targets.add.position, agent_position, self._max_range_m))
        shown = self._imitation.show(frame, near, seen, coverage, view)
        tampering = carry_out(targets, shown, seen, order, remove_row, move_row)
        self._hold(tampering.targets, time_ns)
        return replace(tampering, added=shown.with_(id=self._ids.of(shown.id)))

    @abstractmethod
    def _targets_at(
        self, frame: int, time_ns: int, seen: ObjectStates, coverage: Coverage, directive: Targets | None
    ) -> Targets | None:
        """The targets at the time of a message; None before the attack begins."""

    @abstractmethod
    def _hold(self, targets: Targets, time_ns: int) -> None:
        """Keep the targets as they are now."""

    #: m, see `Follower.bring`.
    _attach_m: float


class UncoordinatedAttack(_TargetedAttack):
    """An adversary by itself. Put on detections it feeds the victim's own trackers; on tracks, the broker.

    selection:        what to add, hide and move; None: UncoordinatedSelection()
    propagation:      how false objects move; None: TrajectoryPropagation()
    reselect_every_s: s, how often to choose new targets; None: never
    The others are those of _TargetedAttack: start_s, max_range_m, assign_radius_m, imitation, id_gap.
    """

    _attach_m = OWN_TARGET_M

    def __init__(
        self,
        *,
        selection: Selection | None = None,
        propagation: Propagation | None = None,
        reselect_every_s: float | None = 20.0,
        start_s: float = 4.0,
        max_range_m: float = 70.0,
        assign_radius_m: float = 6.0,
        imitation: Imitation | None = None,
        id_gap: int = 1000,
    ) -> None:
        super().__init__(
            start_s=start_s,
            max_range_m=max_range_m,
            assign_radius_m=assign_radius_m,
            imitation=imitation,
            id_gap=id_gap,
        )
        self._selection = selection or UncoordinatedSelection()
        self._campaign = Campaign(self._selection, propagation or TrajectoryPropagation(), reselect_every_s, start_s)

    def bind(self, seed: int, name: str) -> None:
        """See Attack."""
        super().bind(seed, name)
        self._campaign.bind(seed, self._surroundings.scene, name)

    def counts(self) -> dict[str, int]:
        """See Attack."""
        return self._campaign.counts

    def _targets_at(
        self, frame: int, time_ns: int, seen: ObjectStates, coverage: Coverage, directive: Targets | None
    ) -> Targets | None:
        view = self._selection.view(seen)
        if self._campaign.due(time_ns):
            view = view.select(self._follower.established(ESTABLISHED))
        return self._campaign.begin(frame, time_ns, view, coverage)

    def _hold(self, targets: Targets, time_ns: int) -> None:
        self._campaign.hold(targets, time_ns)


class CoordinatedAttack(_TargetedAttack):
    """An adversary that does what its coordinator wants; the newest directive wins.

    A directive's targets are brought from its time to now at constant velocity. Without a newer one the adversary
    goes on by itself, its targets following their objects. A directive that came before `start_s` waits for it.
    The parameters are those of UncoordinatedAttack.
    """

    _attach_m = ATTACH_M

    def __init__(
        self,
        *,
        start_s: float = 4.0,
        max_range_m: float = 70.0,
        assign_radius_m: float = 6.0,
        imitation: Imitation | None = None,
        id_gap: int = 1000,
    ) -> None:
        super().__init__(
            start_s=start_s,
            max_range_m=max_range_m,
            assign_radius_m=assign_radius_m,
            imitation=imitation,
            id_gap=id_gap,
        )
        self._directive: Targets | None = None
        self._directive_ns = 0
        self._targets = Targets.empty()
        self._targets_ns = 0
        self._last_ns = 0

    def _targets_at(
        self, frame: int, time_ns: int, seen: ObjectStates, coverage: Coverage, directive: Targets | None
    ) -> Targets | None:
        self._take(directive)
        self._last_ns = time_ns
        if time_ns < self._start_ns:
            return None
        return self._targets.propagated((time_ns - self._targets_ns) / NANOSECONDS)

    def _hold(self, targets: Targets, time_ns: int) -> None:
        self._targets, self._targets_ns = targets, time_ns

    def _take(self, directive: Targets | None) -> None:
        if directive is None or directive is self._directive:
            return
        made_ns = self._last_ns if directive.time_ns is None else directive.time_ns
        if self._directive is None or made_ns > self._directive_ns:
            self._directive, self._directive_ns = directive, made_ns
            self._targets, self._targets_ns = directive, made_ns
