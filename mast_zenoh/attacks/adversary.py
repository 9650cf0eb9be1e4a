"""The whole state machine of an adversary: one step per intercepted message. World frame throughout."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace

from mast_zenoh.attacks.application import apply
from mast_zenoh.attacks.campaign import NANOSECONDS, Campaign
from mast_zenoh.attacks.imitation import ForgedIds
from mast_zenoh.attacks.propagation import Propagation, TrajectoryPropagation
from mast_zenoh.attacks.selection import Selection, UncoordinatedSelection
from mast_zenoh.attacks.targets import Tampering, Targets
from mast_zenoh.states import Floats, ObjectStates


class Attack(ABC):
    """What an adversary does to the messages of its victim."""

    def bind(self, seed: int, name: str) -> None:  # noqa: B027 (a hook: what draws nothing needs no streams)
        """Name the adversary's random streams: all its draws are functions of (seed, name, purpose, frame)."""

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
        objects:        the victim's objects, world frame: tracks, or detections (velocity zero where there is none)
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


class UncoordinatedAttack(Attack):
    """An adversary by itself. Put on detections it feeds the victim's own trackers; on tracks, the broker.

    selection:        what to add, hide and move; None: UncoordinatedSelection()
    propagation:      how false objects move; None: TrajectoryPropagation()
    reselect_every_s: s, how often to choose new targets; None: never
    start_s:          s of scene time at which the attack begins
    max_range_m:      m, false objects farther from the victim are held back
    assign_radius_m:  m, how near an object must be to a target to be taken for it
    id_gap:           how far above the victim's highest track id the ids of false objects begin
    """

    def __init__(
        self,
        *,
        selection: Selection | None = None,
        propagation: Propagation | None = None,
        reselect_every_s: float | None = None,
        start_s: float = 4.0,
        max_range_m: float = 70.0,
        assign_radius_m: float = 6.0,
        id_gap: int = 1000,
    ) -> None:
        self._selection = selection or UncoordinatedSelection()
        self._campaign = Campaign(self._selection, propagation or TrajectoryPropagation(), reselect_every_s, start_s)
        self._max_range_m = max_range_m
        self._assign_radius_m = assign_radius_m
        self._ids = ForgedIds(id_gap)

    def bind(self, seed: int, name: str) -> None:
        self._campaign.bind(seed, name)

    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        self._ids.observe(objects.id)
        begun = self._campaign.begin(frame, time_ns, self._selection.view(objects), agent_position)
        if begun is None:
            return Tampering.nothing(len(objects))
        targets, elapsed = begun
        tampering = apply(
            targets,
            objects,
            agent_position,
            max_range_m=self._max_range_m,
            assign_radius_m=self._assign_radius_m,
            elapsed_s=elapsed,
        )
        self._campaign.hold(tampering.targets, time_ns)
        return _with_forged_ids(tampering, self._ids)


class CoordinatedAttack(Attack):
    """An adversary that does what its coordinator wants; the newest directive wins.

    A directive's targets are brought from its time to now at constant velocity. Without a newer one the adversary
    goes on by itself, its targets following their objects. A directive that came before `start_s` waits for it.
    The parameters are those of UncoordinatedAttack.
    """

    def __init__(
        self,
        *,
        start_s: float = 4.0,
        max_range_m: float = 70.0,
        assign_radius_m: float = 6.0,
        id_gap: int = 1000,
    ) -> None:
        self._start_ns = round(start_s * NANOSECONDS)
        self._max_range_m = max_range_m
        self._assign_radius_m = assign_radius_m
        self._ids = ForgedIds(id_gap)
        self._directive: Targets | None = None
        self._directive_ns = 0
        self._targets = Targets.empty()
        self._targets_ns = 0
        self._last_ns = 0

    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        self._ids.observe(objects.id)
        self._take(directive)
        self._last_ns = time_ns
        if time_ns < self._start_ns:
            return Tampering.nothing(len(objects))
        elapsed = (time_ns - self._targets_ns) / NANOSECONDS
        tampering = apply(
            self._targets.propagated(elapsed),
            objects,
            agent_position,
            max_range_m=self._max_range_m,
            assign_radius_m=self._assign_radius_m,
            elapsed_s=elapsed,
        )
        self._targets, self._targets_ns = tampering.targets, time_ns
        return _with_forged_ids(tampering, self._ids)

    def _take(self, directive: Targets | None) -> None:
        if directive is None or directive is self._directive:
            return
        made_ns = self._last_ns if directive.time_ns is None else directive.time_ns
        if self._directive is None or made_ns > self._directive_ns:
            self._directive, self._directive_ns = directive, made_ns
            self._targets, self._targets_ns = directive, made_ns


def _with_forged_ids(tampering: Tampering, ids: ForgedIds) -> Tampering:
    return replace(tampering, added=tampering.added.with_(id=ids.of(tampering.added.id)))
