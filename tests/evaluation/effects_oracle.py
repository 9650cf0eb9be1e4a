"""The effects of interposers, by plain loops over their inputs and outputs.

Shares no code with mast_zenoh.evaluation.effects, but the ground of a scan, which detectors measure.
"""

import math
from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

import numpy as np
from observed_run import PERIOD_NS, Arrival, Decoded, ObservedRun, SentCopy

from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import SCHEMAS, Body, Message
from mast_zenoh.sensing.ground import points_and_ground
from mast_zenoh.sensing.points import Points
from mast_zenoh.wiring.model import InterposedWire

NAN3 = (math.nan, math.nan, math.nan)
FAR = [1e9, 1e9, 1e9]
#: Pose of an agent in a frame: position and rotation matrix.
Poses = dict[tuple[str, int], tuple[np.ndarray, np.ndarray]]
Row = dict[str, Any]


def poses_of(process: ObservedRun) -> Poses:
    """The poses of the agents."""
    recording = process.hosts["simulator"].node.recording  # type: ignore[attr-defined]
    prepared = {
        (agent.name, frame): (recording.agent_position[frame, k], recording.agent_rotation[frame, k])
        for k, agent in enumerate(recording.agents)
        for frame in range(len(recording.times_ns))
    }
    return prepared | process.poses


def expected(process: ObservedRun, frames: int) -> list[Row]:
    """The rows of attacks.parquet, unordered, without columns that need reports."""
    poses, rows = poses_of(process), []
    for passage in process.passages:
        arrivals = [arrival for arrival in process.arrivals if arrival.passage == passage]
        forged = [sent for way, sent in process.forgeries if way == passage]
        for row in _of_passage(process, passage, arrivals, forged, frames - 1, poses):
            blank = {"frame": -1, "seq": -1, "id": -1, "columns": "", "delay_s": math.nan}
            blank |= {"before": NAN3, "after": NAN3, "velocity": NAN3}
            place = {"interposer": passage.node, "wire": passage.wire, "message": passage.message}
            rows.append(blank | place | {"before_subscriber": passage.before} | row)
    return rows


def _of_passage(
    process: ObservedRun,
    passage: InterposedWire,
    arrivals: list[Arrival],
    forged: list[SentCopy],
    last: int,
    poses: Poses,
) -> Iterator[Row]:
    numbered: dict[tuple[int, int], tuple[list[tuple[Arrival, Decoded]], list[tuple[SentCopy, Decoded]]]] = {}
    damaged: list[tuple[Arrival, SentCopy]] = []
    for arrival in arrivals:
        read = process.read(passage, arrival.content, arrival.flaw)
        sent = [each for each in arrival.sent if each.step <= last]
        if read.header is None:
            copies = [each for each in sent if _same(each.content, arrival.content)]
            for _ in copies[1:]:
                yield {"effect": "repeated"}
            for _ in range(len(sent) - len(copies)):
                yield {"effect": "forged"}  # unreadable bytes cannot be recognised after more damage
            if not copies:
                yield {"effect": "dropped"}
            continue
        of_number = numbered.setdefault((read.header.frame, read.header.seq), ([], []))
        of_number[0].append((arrival, read))
        for each in sent:
            after = process.read(passage, each.content)
            if after.header is None:
                damaged.append((arrival, each))
            else:
                numbered.setdefault((after.header.frame, after.header.seq), ([], []))[1].append((each, after))
    for (frame, _), (came, went) in numbered.items():
        if came:
            continue
        for number, (others, gone) in numbered.items():  # forwarded under another number
            while number[0] == frame and len(others) > len(gone) and went:
                (arrival, read), (sent, after) = others[len(gone)], went[0]
                if not _renumbered(read, after):
                    break
                del others[len(gone)], went[0]
                yield {"effect": "reframed", "columns": "seq", "frame": frame, "seq": number[1]}
                if sent.step > arrival.step:
                    delay = _delay(sent.step - arrival.step)
                    yield {"effect": "delayed", "delay_s": delay, "frame": frame, "seq": number[1]}
    pairs = []
    for (frame, seq), (came, went) in numbered.items():
        went.sort(key=lambda each: each[0].step)
        if not came:
            for _ in went:
                yield {"effect": "forged", "frame": frame, "seq": seq}
            continue
        pairs += [(frame, seq, *pair) for pair in zip_longest(came, went)]
    lateness = [went[0].step - came[0].step for _, _, came, went in pairs if came and went]
    # A delay is usual when a twentieth of all messages are as late: one late message is not enough.
    usual = max((late for late in lateness if 20 * sum(each >= late for each in lateness) >= len(arrivals)), default=0)
    for frame, seq, came, went in pairs:
        number = {"frame": frame, "seq": seq}
        if went is None:
            copies = [pair for pair in damaged if pair[0] is came[0] and _resemble(pair[1].content, came[0].content)]
            if copies:
                damaged.remove(copies[0])
                yield number | {"effect": "corrupted"}
            else:
                # A message still in transit when the run ends is neither delivered nor dropped.
                known = came[0].step + usual <= last
                yield number | {"effect": "dropped" if known else "unsettled"}
        elif came is None:
            first, relayed = next((pair[2][0], pair[3][0]) for pair in pairs if pair[:2] == (frame, seq) and pair[2])
            if _same(relayed.content, went[0].content):
                yield number | {"effect": "repeated", "delay_s": _delay(went[0].step - first.step)}
            else:
                yield number | {"effect": "forged"}
        else:
            if went[0].step > came[0].step:
                yield number | {"effect": "delayed", "delay_s": _delay(went[0].step - came[0].step)}
            yield from (number | row for row in _changes(passage, came[0], came[1], went[0], went[1], poses))
    for _ in [*damaged, *(each for each in forged if each.step <= last)]:
        yield {"effect": "forged"}


def _renumbered(one: Decoded, other: Decoded) -> bool:
    """Whether two messages about one frame differ only in their numbers."""
    if one.body is None or other.body is None or one.header is None or other.header is None:
        return False
    return one.header._replace(seq=0) == other.header._replace(seq=0) and all(
        _equal(column, other.body[name]) for name, column in one.body.items()
    )


def _changes(
    passage: InterposedWire, arrival: Arrival, before: Decoded, sent: SentCopy, after: Decoded, poses: Poses
) -> Iterator[Row]:
    """The differences between a message and its relayed version."""
    if _same(arrival.content, sent.content):
        return
    if before.body is None or after.body is None:
        yield {"effect": "corrupted"}
        return
    assert before.header is not None
    assert after.header is not None
    if after.header.time_ns != before.header.time_ns:
        later = (after.header.time_ns - before.header.time_ns) * 1e-9
        yield {"effect": "restamped", "delay_s": later}
    schema = SCHEMAS[passage.message]
    where = passage.subject, before.header.frame
    if passage.message == "points":
        if changed := [column.name for column in schema.columns if not _alike(before.body, after.body, column.name)]:
            yield {"effect": "reframed", "columns": " ".join(changed)}
        yield from _of_scan(before.body, after.body, where, poses)
        return
    names = [column.name for column in schema.columns if column.shape[:1] == ("n",)]
    others = [c.name for c in schema.columns if c.name not in names]
    if not any(column.name == "position" and column.shape == ("n", 3) for column in schema.columns):
        names, others = [], [column.name for column in schema.columns]
    changed = [name for name in others if not _equal(before.body[name], after.body[name])]
    if changed:
        effect = "slandered" if passage.message == "gossip" else "reframed"
        yield {"effect": effect, "columns": " ".join(changed)}
    for i, j in _objects(before.body, after.body, names):
        yield from _object(before.body, after.body, names, i, j, where, poses)


def _alike(a: Body, b: Body, name: str) -> bool:
    return a[name].shape == b[name].shape and a[name].tobytes() == b[name].tobytes()


def _of_scan(a: Body, b: Body, where: tuple[str, int], poses: Poses) -> Iterator[Row]:
    """The objects that points make which were taken away, or added: beams that return from elsewhere do both."""
    beams = [
        {
            (time.tobytes(), int(channel)): place
            for time, channel, place in zip(body["time_s"], body["channel"], body["position"].tolist(), strict=True)
        }
        for body in (a, b)
    ]
    _, ground = points_and_ground(Points.from_columns(a).turned(_turned(a["level_rotation"])).position)
    for effect, body, own, other in (("removed", a, *beams), ("inserted", b, *reversed(beams))):
        alone = [place for key, place in other.items() if key not in own]
        places = [
            place
            for key, place in own.items()
            if min(math.dist(place, there) for there in ([other[key]] if key in other else [*alone, FAR])) >= 0.3
        ]
        level = _turned(body["level_rotation"])
        for group in _touching([level @ np.array(place) for place in places]):
            low, high = np.min(group, axis=0), np.max(group, axis=0)
            if sum(height > 0.25 for height in ground.height_of(np.array(group))) < 5:
                continue
            middle = tuple(_world(level.T @ ((low + high) / 2.0), body, where, poses))
            yield {"effect": effect, "before" if effect == "removed" else "after": middle}


def _touching(places: list[np.ndarray]) -> Iterator[list[np.ndarray]]:
    """Groups of places whose cells, seen from above, are the same or beside each other."""
    cells: dict[tuple[int, int], list[np.ndarray]] = {}
    for place in places:
        cells.setdefault((math.floor(place[0] / 0.8), math.floor(place[1] / 0.8)), []).append(place)
    while cells:
        waiting, group = [next(iter(cells))], []
        while waiting:
            x, y = waiting.pop()
            group += cells.pop((x, y), [])
            waiting += [(x + i, y + j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (x + i, y + j) in cells]
        yield group


def _object(a: Body, b: Body, names: list[str], i: int, j: int, where: tuple[str, int], poses: Poses) -> Iterator[Row]:
    """The row of one object: row i of the input, row j of the output; -1: absent."""
    differ = [name for name in names if i >= 0 and j >= 0 and not _equal(a[name][i], b[name][j])]
    if i >= 0 and j >= 0 and not differ:
        return
    effect = "inserted" if i < 0 else "removed" if j < 0 else "moved" if "position" in differ else "altered"
    body, row = (b, j) if j >= 0 else (a, i)
    ids = [int(c["id"][k]) for c, k in ((a, i), (b, j)) if k >= 0 and "id" in c]
    velocity = NAN3
    if "velocity" in body:
        # A velocity is in the frame of reference of the sent, or else the received, message.
        velocity = tuple(_world(body["velocity"][row], body, where, poses, place=False))
    yield {
        "effect": effect,
        "id": ids[0] if ids else -1,
        "before": tuple(_world(a["position"][i], a, where, poses)) if i >= 0 else NAN3,
        "after": tuple(_world(b["position"][j], b, where, poses)) if j >= 0 else NAN3,
        "velocity": velocity,
        "columns": " ".join(differ),
    }


def _objects(a: Body, b: Body, names: list[str]) -> list[tuple[int, int]]:
    """Pairs of rows about the same object; -1: no partner."""
    if not names:
        return []
    left, right = list(range(len(a["position"]))), list(range(len(b["position"])))
    pairs: list[tuple[int, int]] = []

    def take(fits: Any) -> None:
        """Pair compatible rows, the nearest first."""
        possible = [(_apart(a["position"][i], b["position"][j]), i, j) for i in left for j in right if fits(i, j)]
        for _, i, j in sorted(possible):
            if i in left and j in right:
                pairs.append((i, j))
                left.remove(i)
                right.remove(j)

    def alike(*columns: str) -> Any:
        return lambda i, j: all(_equal(a[name][i], b[name][j]) for name in columns)

    take(lambda i, j: all(a[name][i].tobytes() == b[name][j].tobytes() for name in names))
    if "id" in names:
        take(alike(*(name for name in names if name != "id")))
        take(alike("id"))
    else:
        take(alike("class_id", "size", "score", "covariance"))
        take(alike("class_id", "size"))
        take(lambda i, j: _apart(a["position"][i], b["position"][j]) <= 2.0)
    return [*pairs, *((i, -1) for i in left), *((-1, j) for j in right)]


def _apart(a: np.ndarray, b: np.ndarray) -> float:
    return math.hypot(a[0] - b[0], a[1] - b[1])


def _equal(a: Any, b: Any) -> bool:
    """Whether two values, or arrays, are equal up to rounding."""
    a, b = np.asarray(a), np.asarray(b)
    if a.shape != b.shape:
        return False
    if a.dtype.kind != "f":
        return bool((a == b).all())
    return all(
        abs(x - y) <= 1e-9 * max(1.0, abs(x)) for x, y in zip(a.ravel().tolist(), b.ravel().tolist(), strict=True)
    )


def _same(a: bytes | Message, b: bytes | Message) -> bool:
    """Whether two messages have the same bytes."""
    if a is b:
        return True
    one, other = (each if isinstance(each, bytes) else codec.encode(each) for each in (a, b))
    return one == other


def _resemble(damaged: bytes | Message, original: bytes | Message) -> bool:
    """Whether bytes are a damaged copy of a message: nine in ten unchanged."""
    one, other = (each if isinstance(each, bytes) else codec.encode(each) for each in (damaged, original))
    equal = sum(one[k] == other[k] for k in range(min(len(one), len(other))))
    return equal >= 0.9 * max(len(one), len(other))


def _delay(frames: int) -> float:
    return frames * PERIOD_NS * 1e-9 if frames > 0 else math.nan


def _world(vector: np.ndarray, body: Body, where: tuple[str, int], poses: Poses, *, place: bool = True) -> np.ndarray:
    """A position, or a velocity, of a message in the world frame."""
    if "mount_position" in body:
        position, rotation = poses[where]
        vector = _turned(body["mount_rotation"]) @ vector + (body["mount_position"] if place else 0.0)
        return rotation @ vector + (position if place else 0.0)
    if "origin" in body:
        return _turned(body["rotation"]) @ vector + (body["origin"] if place else 0.0)
    return vector


def _turned(quaternion: np.ndarray) -> np.ndarray:
    """(3, 3) rotation matrix of a quaternion w x y z, from q v q*."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    columns = []
    for v in np.eye(3):
        u = np.array([x, y, z])
        columns.append(v + 2.0 * np.cross(u, np.cross(u, v) + w * v))
    return np.column_stack(columns)
