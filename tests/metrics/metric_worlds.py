"""Synthetic runs and measured effects for tests of metrics, and slow reference implementations."""

from collections.abc import Mapping, Sequence
from itertools import combinations, permutations
from typing import Any

import numpy as np
from shapely import affinity
from shapely.geometry import box as shapely_box

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.evaluation.effects import Effects
from mast_zenoh.evaluation.effects.table import CODE
from mast_zenoh.evaluation.estimate_wires import Influences
from mast_zenoh.evaluation.from_effects import manipulations
from mast_zenoh.metrics import AttributionLimits, Attributor, Boxes, Record, Scorer, Scores, Series, cause_names
from mast_zenoh.metrics.record import Snapshot
from mast_zenoh.wiring.model import InterposedWire
from tests.support.wirings import wiring_of

PERIOD_S = 0.1
PICTURE, LOCAL, MISSION = Series("", "picture"), Series("ego", "local"), Series("ego", "mission")
NOTHING = ObjectStates.empty()


def cars(*positions, id=None, **columns) -> ObjectStates:
    """Cars at bird's-eye positions."""
    position = np.array([[*p, 0.75] for p in positions], float).reshape(-1, 3)
    n = len(position)
    id = np.arange(n) if id is None else np.asarray(id)
    return ObjectStates.of(position, id=id, size=np.tile([4.5, 1.8, 1.5], (n, 1)), **columns)


def recorded(
    truth: Sequence[ObjectStates],
    estimates: Mapping[Any, Sequence[ObjectStates]],
    *,
    agents: Sequence[str] = ("ego",),
    points: Any = 50,
    places: Any = (0.0, 0.0, 0.0),
    own: Any = -1,
) -> Record:
    """A run, from its truth by frame, and the tracks of each series (or of several with the same messages) by frame.

    points, places, own: of `Record.add_truth`, for all objects and agents, or a list of them by frame
    """
    record, a = Record(agents), len(agents)
    for frame, objects in enumerate(truth):
        hits, place, owned = (each[frame] if isinstance(each, list) else each for each in (points, places, own))
        hits = np.reshape(hits, (-1, a)) if np.ndim(hits) else hits
        seen = np.broadcast_to(np.asarray(hits, np.int32), (len(objects), a))
        position = np.broadcast_to(np.asarray(place, float), (a, 3))
        record.add_truth(frame, objects, seen, position, np.broadcast_to(np.asarray(owned, np.int64), a))
        for series, tracks in estimates.items():
            record.add(frame, [series] if isinstance(series, Series) else series, Snapshot.of(tracks[frame]))
    return record


#: Interposer, frame, effect, id of the object in the message, its position (removed: original; inserted, moved: new)
#: and its velocity; of a moved object instead its original position.
Row = tuple[str, int, str, int, tuple[float, float], tuple[float, float]]


def passage(node: str, port: str = "tracks", subject: str = "infra_9", before: str = "") -> InterposedWire:
    """The position of an interposer on a wire."""
    key = {"collated": "cc/collated", "picture": "cc/picture", "clock": "clock"}.get(port, f"agent/{subject}/{port}")
    message = {"broadcast": "tracks"}.get(port, port)
    return InterposedWire(node, key, subject, message, port, f"{port}/in", f"{port}/out", before)


def influences(agents: Sequence[str], *maps: str, peers: bool = False) -> Influences:
    """What can affect what, among agents with a command centre or with peers."""
    result = Influences(agents)
    result.follow(wiring_of([*dict.fromkeys((*agents, "ego", "other", "infra_9"))], *maps, peers=peers))
    return result


def effects(*rows: Row, passages: Sequence[InterposedWire] = (), of: Sequence[int] | None = None) -> Effects:
    """Effects on objects. passages, of: their wires, by default of tracks."""
    nodes = sorted({row[0] for row in rows})
    ways = tuple(passages) or tuple(passage(node) for node in nodes)
    n = len(rows)
    before, after, velocity = (np.full((n, 3), np.nan) for _ in range(3))
    for k, (_, _, effect, _, where, more) in enumerate(rows):
        if effect in ("removed", "altered"):
            before[k] = [*where, 0.0]
        if effect != "removed":
            after[k] = [*where, 0.0]
        if effect == "moved":
            before[k], velocity[k] = [*more, 0.0], 0.0
        else:
            velocity[k] = [*more, 0.0]
    frame = np.array([row[1] for row in rows], np.int64)
    return Effects(
        passages=ways,
        passage=np.array([nodes.index(row[0]) for row in rows] if of is None else of, np.int64),
        code=np.array([CODE[row[2]] for row in rows], np.int64),
        **dict.fromkeys(("frame", "seq", "step"), frame),
        id=np.array([row[3] for row in rows], np.int64),
        before=before,
        after=after,
        velocity=velocity,
        whole=np.zeros(n, bool),
        **dict.fromkeys(("frames_late", "time_ns"), np.zeros(n, np.int64)),
        columns=np.array([""] * n, object),
        points=np.zeros(n, np.int64),
    )


def explained(record: Record, measured: Effects, roles: dict[str, str] | None = None, **more) -> dict[str, np.ndarray]:
    """The table of objects of a record with causes; more: see `Attributor`."""
    return labelled(record, measured, roles, **more)[1]


def labelled(record: Record, measured: Effects, roles: dict[str, str] | None = None, **more):
    """(scores, table of objects with causes, labels, manipulations) of a record."""
    scores: Scores = Scorer().score(record)
    boxes = scores.truth.boxes.in_group(scores.truth_frame)
    known = {way.node: "adversary" for way in measured.passages} | (roles or {})
    away = np.zeros(len(measured), bool)
    done = manipulations(
        measured, known, scores.series, boxes, PERIOD_S, away, AttributionLimits(), influences(scores.agents)
    )
    labels = Attributor(AttributionLimits(), scores, done, PERIOD_S, **more).labels()
    return scores, scores.objects() | {"cause": cause_names(labels.cause), "by": labels.by}, labels, done


def boxes(position, size=(4.0, 2.0, 1.5), yaw=0.0, group=0, id=None) -> Boxes:
    """Boxes at (n, 2) or (n, 3) positions; the remaining values are broadcast."""
    position = np.asarray(position, float)
    position = position.reshape(-1, position.shape[-1] if position.size else 3)
    n = len(position)
    if position.shape[1] == 2:
        position = np.column_stack([position, np.zeros(n)])
    return Boxes(
        np.broadcast_to(np.asarray(group, np.int64), n).copy(),
        np.arange(n, dtype=np.int64) if id is None else np.asarray(id, np.int64),
        position,
        np.broadcast_to(np.asarray(size, float), (n, 3)).copy(),
        np.broadcast_to(np.asarray(yaw, float), n).copy(),
    )


def outline(x: float, y: float, yaw: float, length: float, width: float):
    """The outline of a box from above."""
    shape = shapely_box(-length / 2, -width / 2, length / 2, width / 2)
    return affinity.translate(affinity.rotate(shape, yaw, origin=(0, 0), use_radians=True), x, y)


def overlap(a: Boxes, i: int, b: Boxes, j: int) -> tuple[float, float]:
    """Area of the intersection of two boxes from above, and intersection over union of their volumes, by shapely."""
    one, other = (outline(*each.position[k, :2], each.yaw[k], *each.size[k, :2]) for each, k in ((a, i), (b, j)))
    area = one.intersection(other).area
    top = min(a.position[i, 2] + a.size[i, 2] / 2, b.position[j, 2] + b.size[j, 2] / 2)
    bottom = max(a.position[i, 2] - a.size[i, 2] / 2, b.position[j, 2] - b.size[j, 2] / 2)
    common = area * max(top - bottom, 0.0)
    return area, common / (a.size[i].prod() + b.size[j].prod() - common)


def best_pairs(distance: np.ndarray, gate: float) -> tuple[int, float]:
    """Number of pairs and total distance of the best matching, by brute force."""
    rows, columns = distance.shape
    for count in range(min(rows, columns), 0, -1):
        totals = [
            sum(distance[r, c] for r, c in zip(chosen, partner, strict=True))
            for chosen in combinations(range(rows), count)
            for partner in permutations(range(columns), count)
            if all(distance[r, c] <= gate for r, c in zip(chosen, partner, strict=True))
        ]
        if totals:
            return count, min(totals)
    return 0, 0.0
