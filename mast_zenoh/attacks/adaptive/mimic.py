"""False vehicles that repeat what real ones did."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import ObjectStates, concatenate
from mast_zenoh.attacks.adaptive.base import AdaptiveAttack, Lies, Moment
from mast_zenoh.attacks.adaptive.phantoms import MAX_PHANTOMS
from mast_zenoh.attacks.coverage import boxes_of, touching
from mast_zenoh.attacks.knowledge import Trust, TrustWatch
from mast_zenoh.attacks.propagation import MAX_ACCELERATION_MPS2
from mast_zenoh.attacks.regions import VEHICLE_M

#: s for which paths are remembered.
MEMORY_S = 60.0
#: m before the place where an object was first seen: if this is out of view, it has entered at the edge of the view.
ENTRY_M = 10.0
#: m/s, least speed of an object that enters.
ENTRY_MPS = 1.0
#: s ahead on its path that must be free, else the false vehicle brakes.
LOOKAHEAD_S = 2.0
#: s without a row of the original, or with a real object in its place, after which a false vehicle is given up.
LOST_S = 1.0


@dataclass(slots=True)
class _Copy:
    """A false vehicle.

    number: of the target; original: track id of the real one; path_ns: how far it is on its path; rate: of its
    progress, 1 is as fast as the original; blocked_ns: since when it has not been shown, -1: it is shown
    """

    number: int
    original: int
    path_ns: float
    rate: float = 1.0
    blocked_ns: int = -1


class Mimic(AdaptiveAttack):
    """Repeats the paths of real vehicles some seconds later, with their own noise.

    A vehicle that entered at the edge of the victim's view is followed by a false one, which enters at the same place
    `headway_s` later or more, repeats its rows (noise, covariance, score, size) and leaves where it left. It brakes
    behind real vehicles. With the picture it also keeps clear of objects that the victim does not see; an attacker that
    hears the trust begins no copy while the trust in the victim is more than `tolerance` below its highest value. Needs
    track ids: on detections it does nothing. Source: mimicry against anomaly detection (Wagner and Soto, CCS 2002).

    headway_s: s, least time behind the original
    tolerance: 0 to 1, fall of the trust that is accepted
    budget:    lies per second, so the number of false vehicles
    start_s:   s of scene time at which the attack begins; paths are recorded before
    """

    def __init__(
        self, *, headway_s: float = 2.0, tolerance: float = 0.05, budget: float = 2.0, start_s: float = 4.0
    ) -> None:
        super().__init__(budget=budget, start_s=start_s)
        if not 0.0 < headway_s <= MEMORY_S / 2:
            raise ValueError(f"headway_s: found {headway_s}, expected more than 0 and at most {MEMORY_S / 2}")
        self._headway_ns = round(headway_s * 1e9)
        self._watch = TrustWatch(tolerance)
        self._recorded: deque[tuple[int, ObjectStates]] = deque()
        self._entered_ns: dict[int, int] = {}  # by track id: when it entered at the edge of the view
        self._known: set[int] = set()
        self._copies: list[_Copy] = []
        self._copied: set[int] = set()

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:
        self._watch.hear(trust, self._surroundings.victims)

    def rest(self) -> None:
        self._copies = []

    def observe(self, moment: Moment) -> None:
        seen = moment.seen
        new = np.array([id >= 0 and id not in self._known for id in seen.id.tolist()], bool)
        if self._recorded and new.any():
            speed = np.hypot(seen.velocity[:, 0], seen.velocity[:, 1])
            rows = np.flatnonzero(new & (speed >= ENTRY_MPS) & (seen.size[:, 0] >= VEHICLE_M))
            boxes = boxes_of(seen.select(rows))
            boxes[:, :2] -= ENTRY_M * seen.velocity[rows, :2] / speed[rows, None]
            entered = rows[~moment.coverage.visible(moment.view, boxes)]
            self._entered_ns |= dict.fromkeys(seen.id[entered].tolist(), moment.time_ns)
        self._known.update(seen.id[new].tolist())
        self._recorded.append((moment.time_ns, seen))
        while self._recorded[0][0] < moment.time_ns - MEMORY_S * 1e9:
            self._recorded.popleft()

    def lie(self, moment: Moment) -> Lies:
        real = concatenate([moment.seen, self.known_objects(moment)])
        self._copies = self._copies[: self.budget.admit(len(self._copies), len(self._copies))]
        shown = [self._advance(copy, real, moment) for copy in self._copies]
        lost_ns = moment.time_ns - LOST_S * 1e9
        kept = [copy.blocked_ns < 0 or copy.blocked_ns > lost_ns for copy in self._copies]
        shown = [row for row, keep in zip(shown, kept, strict=True) if keep]
        self._copies = [copy for copy, keep in zip(self._copies, kept, strict=True) if keep]
        if not self._watch.fallen:
            self._begin(moment, real, shown)
        return Lies(inserted=concatenate([row for row in shown if row is not None]))

    def _begin(self, moment: Moment, real: ObjectStates, shown: list[ObjectStates | None]) -> None:
        """Begin copies of vehicles that entered long enough ago, the last ones first; adds their rows to `shown`."""
        allowed = self.budget.admit(len(self._copies), MAX_PHANTOMS)
        oldest_ns = self._recorded[0][0]
        candidates = sorted(
            (-entered_ns, id)
            for id, entered_ns in self._entered_ns.items()
            if oldest_ns <= entered_ns <= moment.time_ns - self._headway_ns and id not in self._copied
        )
        for negative_ns, original in candidates:
            if len(self._copies) >= allowed:
                return
            copy = _Copy(-1, original, float(-negative_ns))
            row = self._row(copy, copy.path_ns)
            occupied = concatenate([real, *(other for other in shown if other is not None)])
            if row is None or touching(row, occupied).any():
                continue
            copy.number = int(self.numbers(1)[0])
            self._copied.add(original)
            self._copies.append(copy)
            shown.append(row.with_(id=np.array([copy.number])))

    def _advance(self, copy: _Copy, real: ObjectStates, moment: Moment) -> ObjectStates | None:
        """Move a copy on along its path; its row, or None while it is not shown."""
        ahead = self._row(copy, copy.path_ns + LOOKAHEAD_S * 1e9)
        here = self._row(copy, copy.path_ns)
        speed = 1.0 if here is None else max(float(np.hypot(*here.velocity[0, :2])), 1.0)
        brakes = ahead is not None and bool(touching(ahead, real).any())
        change = MAX_ACCELERATION_MPS2 / speed * moment.elapsed_s
        copy.rate = max(copy.rate - change, 0.0) if brakes else min(copy.rate + change, 1.0)
        latest_ns = float(moment.time_ns - self._headway_ns)
        copy.path_ns = min(copy.path_ns + copy.rate * moment.elapsed_s * 1e9, latest_ns)
        row = self._row(copy, copy.path_ns)
        if row is None or touching(row, real).any():
            copy.blocked_ns = moment.time_ns if copy.blocked_ns < 0 else copy.blocked_ns
            return None
        copy.blocked_ns = -1
        return row.with_(id=np.array([copy.number]), velocity=row.velocity * copy.rate)

    def _row(self, copy: _Copy, path_ns: float) -> ObjectStates | None:
        """The row of a copy's original at a time, moved on from the message before; None if it has none."""
        message = None
        for time_ns, objects in self._recorded:
            if time_ns > path_ns:
                break
            message = time_ns, objects
        if message is None:
            return None
        time_ns, objects = message
        rows = np.flatnonzero(objects.id == copy.original)
        if len(rows) == 0 or path_ns - time_ns > LOST_S * 1e9:
            return None
        row = objects.select(rows[:1])
        return row.with_(position=row.position + row.velocity * ((path_ns - time_ns) * 1e-9))
