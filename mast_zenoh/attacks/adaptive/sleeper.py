"""Honest periods between bursts of another attack."""

from __future__ import annotations

from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.attacks.adaptive.base import AdaptiveAttack
from mast_zenoh.attacks.adaptive.blind_spot import BlindSpot
from mast_zenoh.attacks.base import Attack
from mast_zenoh.attacks.knowledge import Trust, TrustWatch
from mast_zenoh.attacks.surroundings import Surroundings
from mast_zenoh.attacks.targets import Tampering, Targets
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.tracking.view import SensorView


class Sleeper(Attack):
    """Lets another attack act in bursts, with honest periods between them.

    The attack observes all the time; an attack with a budget saves it while it sleeps, so that its mean cost is that of
    the same attack without pauses. While the trust in the victim is more than `tolerance` below its highest value (an
    attacker that hears it), it sleeps on. Source: on-off attacks on reputation systems (Sun et al., 2006); with one
    second of memory, as in MATE's code, they are free.

    attack:    the attack of the bursts; None: BlindSpot()
    honest_s, lying_s: s, lengths of the periods; the first burst begins `start_s` s into the scene
    tolerance: 0 to 1, fall of the trust that is accepted
    start_s:   s of scene time of the first burst
    """

    def __init__(
        self,
        *,
        attack: Attack | None = None,
        honest_s: float = 3.0,
        lying_s: float = 1.5,
        tolerance: float = 0.05,
        start_s: float = 4.0,
    ) -> None:
        for name, value in (("honest_s", honest_s), ("lying_s", lying_s)):
            if not 0.0 < value < 1e6:
                raise ValueError(f"{name}: found {value}, expected more than 0")
        if not 0.0 <= start_s < 1e6:
            raise ValueError(f"start_s: found {start_s}, expected 0 or more")
        self._attack = attack or BlindSpot(start_s=start_s)
        self._honest_ns, self._lying_ns, self._start_ns = (round(s * 1e9) for s in (honest_s, lying_s, start_s))
        self._watch = TrustWatch(tolerance)
        self._victims: tuple[str, ...] = ()
        self._lying_frame = -1

    def inform(self, surroundings: Surroundings) -> None:
        self._victims = surroundings.victims
        self._attack.inform(surroundings)

    def bind(self, seed: int, name: str) -> None:
        self._attack.bind(seed, name)

    def look(self, view: SensorView, *, fused: bool) -> None:
        self._attack.look(view, fused=fused)

    def hear_picture(self, frame: int, time_ns: int, objects: ObjectStates) -> None:
        self._attack.hear_picture(frame, time_ns, objects)

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:
        self._watch.hear(trust, self._victims)
        self._attack.hear_trust(frame, time_ns, trust)

    def counts(self) -> dict[str, int]:
        return self._attack.counts()

    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        awake = self._awake(time_ns)
        if isinstance(self._attack, AdaptiveAttack):
            self._attack.dormant = not awake
        tampering = self._attack.step(frame, time_ns, objects, agent_position, directive)
        if not awake:
            return Tampering.nothing(len(objects), tampering.targets)
        self._lying_frame = frame
        return tampering

    def forge_view(self, frame: int, time_ns: int, swept: SweptView) -> SweptView:
        return self._attack.forge_view(frame, time_ns, swept) if frame == self._lying_frame else swept

    def forge_pose(self, frame: int, time_ns: int, position: Floats) -> Floats:
        return self._attack.forge_pose(frame, time_ns, position) if self._awake(time_ns) else position

    def _awake(self, time_ns: int) -> bool:
        """Whether it lies at a time."""
        since_ns = time_ns - self._start_ns
        in_burst = since_ns >= 0 and since_ns % (self._honest_ns + self._lying_ns) < self._lying_ns
        return in_burst and not self._watch.fallen
