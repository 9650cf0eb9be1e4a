"""An attack on the time of the command centre."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import CLASS_INDEX, Floats, Ints, ObjectStates, canonical_order
from mast_zenoh.attacks.attack import ObservingAttack, alter
from mast_zenoh.attacks.imitation import typical
from mast_zenoh.attacks.phantoms import BOX
from mast_zenoh.attacks.selection import ground_height
from mast_zenoh.attacks.targets import Tampering, Targets
from mast_zenoh.integrity.views import SweptView

#: Largest number of rows of a flooded message.
MAX_ROWS = 20_000
#: Difference between the victim's highest track id and the first id of a false object.
ID_GAP = 1000


class Flood(ObservingAttack):
    """Fills each message with standing cars up to a number of rows, so that the command centre is slow.

    The cars stand in a square grid around the victim, whether it could see them or not: this attack is after processor
    time, and does not hide. Their scores are the highest, so that a receiver that cuts messages drops real rows first
    (docs/explanation-security.md). On the view's wire the sensor claims to see nothing, so that the agent's own view
    contradicts no car. It has no budget, and goes on whatever is thought of its agent, because a suspended agent's rows
    are still received, clustered and judged.

    Threat model: the attacker controls one agent's tracks (and view), or its detections, and knows nothing but these.
    It needs to know about how many rows receivers accept: 16, and twice the most that an agent detects in the scene.
    Source: latency attacks on cooperative perception, CP-FREEZER (arXiv 2508.01062, abstract only): there, perturbed
    features make the victim propose many boxes, which are compared pair by pair. Here the boxes themselves are sent.

    rows:      number of rows of a message, with the victim's own, at most 20,000
    spacing_m: m, between neighbouring cars: below the radius of the clusterer (2 m), they are of one object for it
    score:     0 to 1, of the cars
    start_s:   s of scene time at which the attack begins
    """

    def __init__(self, *, rows: int = 60, spacing_m: float = 3.0, score: float = 1.0, start_s: float = 4.0) -> None:
        super().__init__(start_s, gate_m=1.0, id_gap=ID_GAP)
        if not 1 <= rows <= MAX_ROWS:
            raise ValueError(f"rows: found {rows}, expected 1 to {MAX_ROWS}")
        check("more than 0, finite", spacing_m=spacing_m)
        check("0 to 1", score=score)
        self._rows, self._spacing_m, self._score = rows, spacing_m, score
        self._flooded_frame = -1

    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: Floats,
        directive: Targets | None = None,
    ) -> Tampering:
        self._ids.observe(objects.id)
        count = self._rows - len(objects)
        if time_ns < self._start_ns or count <= 0:
            return Tampering.nothing(len(objects))
        self._flooded_frame = frame
        seen = objects.select(canonical_order(objects))
        tampering = alter(objects, insert=self._cars(count, seen, agent_position))
        return replace(tampering, added=tampering.added.with_(id=self._ids.of(tampering.added.id)))

    def forge_view(self, frame: int, time_ns: int, swept: SweptView) -> SweptView:
        return replace(swept, free=np.zeros_like(swept.free)) if frame == self._flooded_frame else swept

    def _cars(self, count: int, seen: ObjectStates, agent_position: Floats) -> ObjectStates:
        """`count` standing cars around the victim, with covariances like those of what it sees."""
        position = np.column_stack([square_grid(count) * self._spacing_m, np.zeros(count)]) + agent_position
        position[:, 2] = ground_height(seen) + 0.5 * BOX[2]
        cars = ObjectStates.of(
            position, size=np.tile(BOX, (count, 1)), class_id=np.full(count, CLASS_INDEX["car"], np.uint8)
        )
        return typical(cars, seen).with_(score=np.full(count, self._score))


def square_grid(count: int) -> Ints:
    """(count, 2) points of the integer grid, those nearest to the origin first, without the origin itself."""
    half = 1 + int(np.ceil(0.5 * np.sqrt(count + 1)))
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-half, half + 1), np.arange(-half, half + 1)))
    order = np.lexsort([y, x, np.maximum(np.abs(x), np.abs(y))])[1 : count + 1]
    return np.column_stack([x, y])[order]
