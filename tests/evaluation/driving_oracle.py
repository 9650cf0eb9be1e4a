"""Consequences of estimates for driving, by plain loops over a recording."""

from __future__ import annotations

import math
from collections import defaultdict
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from played import Played
from shapely import LineString, Polygon, affinity

from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion
from mast_zenoh.messagelog.reader import read
from mast_zenoh.messages import codec

HORIZON_M, MARGIN_M = 60.0, 0.3
RESPONSE_S, ACCELERATION, BRAKING, BRAKING_AHEAD = 0.5, 2.0, 4.0, 8.0
ATTACKS = ("inserted", "removed", "moved", "altered")


class Thing(NamedTuple):
    """An object or a track: world frame."""

    id: int
    x: float
    y: float
    vx: float
    vy: float
    length: float
    width: float
    yaw: float


class Met(NamedTuple):
    """An object in the corridor: gap m, time to collision s, need to brake."""

    thing: Thing
    gap: float
    ttc: float
    brake: bool


def things(body: Any) -> list[Thing]:
    """The objects of a message."""
    position, velocity, yaw = body["position"], body["velocity"], body["yaw"]
    if "origin" in body:
        rotation = rotation_from_quaternion(body["rotation"])
        position, velocity = position @ rotation.T + body["origin"], velocity @ rotation.T
        yaw = yaw + heading(rotation)
    return [
        Thing(int(i), p[0], p[1], v[0], v[1], s[0], s[1], a)
        for i, p, v, s, a in zip(body["id"], position, velocity, body["size"], yaw, strict=True)
    ]


def expected(played: Played, agent: str, sources: dict[str, str]) -> dict[str, dict[int, dict[str, Any]]]:
    """By estimate and frame the columns of driving.parquet.

    sources: by estimate its key
    """
    truth: dict[int, Any] = {}
    believed: dict[str, dict[int, list[Thing]]] = defaultdict(dict)
    for message in read(played.folder):
        if message.key == "scene/truth":
            truth[message.frame] = codec.decode(message.payload, "truth").body
        for estimate, key in sources.items():
            if message.key == key:
                believed[estimate][message.frame] = things(codec.decode(message.payload, "tracks").body)
    column = list(truth[0]["agents"]).index(agent)
    own = {frame: int(body["agent_object"][column]) for frame, body in truth.items()}
    real = {frame: things(body) for frame, body in truth.items()}
    me = [next(thing for thing in real[frame] if thing.id == own[frame]) for frame in sorted(real)]
    path = Path(me)
    others = {frame: [thing for thing in each if thing.id != own[frame]] for frame, each in real.items()}
    by_truth = {frame: path.met(frame, each) for frame, each in others.items()}
    wrong = errors(played, agent)
    result: dict[str, dict[int, dict[str, Any]]] = defaultdict(dict)
    for frame, met in by_truth.items():
        result["truth"][frame] = row(met) | {"overlapping": path.overlapping(frame, others[frame])}
        for estimate in sources:
            obstacles = path.met(frame, believed[estimate].get(frame, []))
            false = [(each, wrong[estimate, frame, "false", each.thing.id]) for each in obstacles]
            missed = [(each, wrong[estimate, frame, "missed", each.thing.id]) for each in met]
            brakes, should = any(each.brake for each in obstacles), any(each.brake for each in met)
            guilty = (brakes and not should and any(e.brake and cause in ATTACKS for e, cause in false)) or (
                should and not brakes and any(e.brake and cause in ATTACKS for e, cause in missed)
            )
            result[estimate][frame] = row(obstacles) | {
                "overlapping": path.overlapping(frame, believed[estimate].get(frame, [])),
                "false": sum(bool(cause) for _, cause in false),
                "missed": sum(bool(cause) for _, cause in missed),
                "needless": brakes and not should,
                "omitted": should and not brakes,
                "attacked": guilty,
            }
    return result


def row(met: list[Met]) -> dict[str, Any]:
    """The columns of one estimate by itself."""
    return {
        "objects": len(met),
        "false": 0,
        "missed": 0,
        "gap_m": min((each.gap for each in met), default=math.nan),
        "ttc_s": min((each.ttc for each in met if math.isfinite(each.ttc)), default=math.nan),
        "brake": any(each.brake for each in met),
        "needless": False,
        "omitted": False,
        "attacked": False,
    }


def errors(played: Played, agent: str) -> dict[tuple[str, int, str, int], str]:
    """Causes of an agent's errors, by estimate, frame, outcome and id."""
    table, same_as = played.table("objects"), played.metrics["same_as"].get(agent, {})
    causes: dict[tuple[str, int, str, int], str] = defaultdict(str)
    names = ("agent", "estimator", "frame", "outcome", "id", "cause")
    for agent_name, estimator, frame, outcome, id_, cause in zip(
        *(table[name].tolist() for name in names), strict=True
    ):
        if agent_name == agent and outcome in ("false", "missed"):
            for estimate in (estimator, *(twin for twin, other in same_as.items() if other == estimator)):
                causes[estimate, frame, outcome, id_] = cause
    return causes


class Path:
    """The path of a vehicle in steps of 1 m, extended straight ahead."""

    def __init__(self, me: list[Thing]) -> None:
        self.me = me
        self.here = [0.0]
        for before, after in pairwise(me):
            self.here.append(self.here[-1] + math.hypot(after.x - before.x, after.y - before.y))
        last = me[-1]
        far = HORIZON_M + last.length
        line = LineString(
            [(t.x, t.y) for t in me] + [(last.x + far * math.cos(last.yaw), last.y + far * math.sin(last.yaw))]
        )
        self.points = [line.interpolate(m) for m in range(math.ceil(line.length - 1e-9))]

    def heading(self, k: int) -> float:
        a, b = self.points[max(k - 1, 0)], self.points[min(k + 1, len(self.points) - 1)]
        return math.atan2(b.y - a.y, b.x - a.x)

    def met(self, frame: int, objects: list[Thing]) -> list[Met]:
        """The objects in the corridor in a frame."""
        me, here, obstacles = self.me[frame], self.here[frame], []
        speed = math.hypot(me.vx, me.vy)
        for thing in objects:
            near = [
                (math.hypot(thing.x - point.x, thing.y - point.y), k)
                for k, point in enumerate(self.points)
                if k >= here - 1.0
            ]
            apart, k = min(near)
            if apart > 8.0 or overlaps(me, thing):
                continue
            turn = self.heading(k)
            dx, dy = thing.x - self.points[k].x, thing.y - self.points[k].y
            ahead = dx * math.cos(turn) + dy * math.sin(turn)
            lateral = dy * math.cos(turn) - dx * math.sin(turn)
            c, s = abs(math.cos(thing.yaw - turn)), abs(math.sin(thing.yaw - turn))
            centre = k + ahead - here
            gap = centre - (thing.length * c + thing.width * s) / 2 - me.length / 2
            beside = abs(lateral) - (thing.length * s + thing.width * c) / 2
            if centre <= 0.0 or gap > HORIZON_M or beside > me.width / 2 + MARGIN_M:
                continue
            gap = max(gap, 0.0)
            speed_along = thing.vx * math.cos(turn) + thing.vy * math.sin(turn)
            ttc = gap / (speed - speed_along) if speed - speed_along > 1e-9 else math.inf
            faster = speed + RESPONSE_S * ACCELERATION
            safe = speed * RESPONSE_S + ACCELERATION * RESPONSE_S**2 / 2 + faster**2 / (2 * BRAKING)
            safe -= max(speed_along, 0.0) ** 2 / (2 * BRAKING_AHEAD)
            obstacles.append(Met(thing, gap, ttc, speed > 0.3 and gap < max(safe, 0.0)))
        return obstacles

    def overlapping(self, frame: int, objects: list[Thing]) -> int:
        """The number of objects that overlap the vehicle in a frame."""
        me = self.me[frame]
        return sum(overlaps(me, thing) for thing in objects)


def overlaps(me: Thing, thing: Thing) -> bool:
    """Whether a box overlaps the vehicle or is centred on it."""
    near = math.hypot(thing.x - me.x, thing.y - me.y)
    return near <= 2.0 or (near < 20.0 and outline(me).intersection(outline(thing)).area > 1e-6)


def outline(thing: Thing) -> Polygon:
    """The outline of a box from above."""
    x, y = thing.length / 2, thing.width / 2
    turned = affinity.rotate(Polygon([(x, y), (-x, y), (-x, -y), (x, -y)]), thing.yaw, (0, 0), use_radians=True)
    return affinity.translate(turned, thing.x, thing.y)


def compare(table: dict[str, np.ndarray], agent: str, rows: dict[str, dict[int, dict[str, Any]]]) -> int:
    """Assert that driving.parquet has these rows; returns their number."""
    count = 0
    for estimate, by_frame in rows.items():
        for frame, values in by_frame.items():
            at = (table["agent"] == agent) & (table["estimate"] == estimate) & (table["frame"] == frame)
            assert at.sum() == 1, (estimate, frame)
            for name, value in values.items():
                measured = table[name][at][0]
                np.testing.assert_allclose(measured, value, atol=1e-6, err_msg=f"{agent} {estimate} {frame} {name}")
            count += 1
    return count
