"""Counts and errors of every estimate, computed from a run's recording.

Shares no code with mast_zenoh.metrics, and uses py-motmetrics.
"""

import json
import math
from collections import defaultdict
from pathlib import Path
from typing import Any, NamedTuple

import motmetrics
import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.errors import MessageError
from mast_zenoh.messages import codec
from mast_zenoh.run_folder.recording.reader import read

RANGE_M, GATE_M, MIN_POINTS = 100.0, 2.0, 5
HELD = 5  # frames: agents use a picture for 0.5 s
#: An estimate: agent and estimator.
Series = tuple[str, str]
#: Objects by id: x and y, m, world frame.
Objects = dict[int, tuple[float, float]]


class Frame(NamedTuple):
    """Ground-truth objects and tracks in one frame of one estimate."""

    truth: Objects
    tracks: Objects


class Row(NamedTuple):
    """The scores of one frame of one estimate; rmse_m: NaN without a pair."""

    fn: int
    fp: int
    tp: int
    rmse_m: float
    id_switches: int


def frames_of(folder: Path) -> dict[Series, list[Frame]]:
    """Ground truth and tracks in every frame of every estimate of a recorded run."""
    wires = json.loads((folder / "wiring.json").read_text())["wires"]
    takes = _keys(wires)
    publisher = {leg["key"]: wire["publisher"] for wire in wires for leg in wire["legs"]}
    truths: dict[int, Any] = {}
    believed: dict[Series, dict[int, Objects]] = defaultdict(dict)
    arrived: dict[str, list[tuple[int, int, Objects]]] = defaultdict(list)  # by agent: step, frame, picture
    for message in read(folder):
        if message.key != "scene/truth" and message.key not in takes:
            continue
        try:
            header, body = codec.decode(message.payload, message.message)
        except MessageError:
            continue
        if header.source != publisher[message.key]:
            continue
        if message.key == "scene/truth":
            truths[header.frame] = body
            continue
        for series in takes[message.key]:
            objects = believed[series].setdefault(header.frame, _world(body))
            if series[1] == "picture_received":
                arrived[series[0]].append((message.step, header.frame, objects))
    for agent, pictures in arrived.items():
        held = believed[agent, "picture_on_arrival"]
        for now in truths:
            there = [(frame, objects) for step, frame, objects in pictures if step <= now]
            newest = max(there, key=lambda each: each[0], default=None)
            if newest is not None and now - newest[0] <= HELD:
                held[now] = newest[1]
    agents = list(truths[0]["agents"])
    result = {}
    for agent, estimator in believed:
        for name in [agent] if agent else agents:
            result[name, estimator] = [
                _frame(truths[frame], agents.index(name), believed[agent, estimator].get(frame, {}))
                for frame in sorted(truths)
            ]
    return result


def _keys(wires: list[dict[str, Any]]) -> dict[str, list[Series]]:
    """By key its estimates; an empty agent stands for all agents."""
    takes: dict[str, list[Series]] = defaultdict(list)
    agents = {wire["subject"] for wire in wires if wire["message"] == "pose"}
    for wire in wires:
        source = wire["legs"][0]["key"]
        ports = {leg["from_port"] for leg in wire["legs"][:1]}
        if ports == {"broadcast"}:
            continue  # what an agent says, not what it believes
        if wire["message"] == "picture":
            if wire["subject"] and wire["subject"] not in agents:
                continue  # of a region
            takes[source].append((wire["subject"], "picture"))
            for leg in wire["legs"]:
                for node, port in zip(leg["to"], leg["to_ports"], strict=True):
                    if node in wire["subscribers"] and port == "picture" and node not in wire["interposers"]:
                        takes[leg["key"]].append((node, "picture_received"))
        elif wire["message"] == "tracks":
            takes[source].append((wire["publisher"], "mission" if ports == {"mission"} else "local"))
            for leg in wire["legs"]:
                if "broker" in leg["to"] and ports != {"mission"}:
                    takes[leg["key"]].append((wire["publisher"], "received"))
    return takes


def _world(body: Any) -> Objects:
    position = body["position"]
    if "origin" in body:
        position = position @ rotation_from_quaternion(body["rotation"]).T + body["origin"]
    return {int(i): (float(x), float(y)) for i, (x, y, _) in zip(body["id"], position, strict=True)}


def _frame(truth: Any, agent: int, tracks: Objects) -> Frame:
    here = truth["agent_position"][agent]

    def near(x: float, y: float) -> bool:
        return math.hypot(x - here[0], y - here[1]) <= RANGE_M

    there = {}
    for id_, (x, y, _), points in zip(truth["id"], truth["position"], truth["points"], strict=True):
        if near(x, y) and max(points) >= MIN_POINTS:
            there[int(id_)] = (float(x), float(y))
    return Frame(there, {id_: place for id_, place in tracks.items() if near(*place)})


def _apart(frame: Frame, truth: int, track: int) -> float:
    (x, y), (u, v) = frame.truth[truth], frame.tracks[track]
    return math.hypot(x - u, y - v)


def by_motmetrics(estimates: dict[Series, list[Frame]]) -> dict[Series, list[Row]]:
    """The scores of all estimates of a run.

    CLEAR MOT keeps pairs of the previous frame while they are within the gate; our metrics match every frame
    independently. So every frame gets its own object ids; identity switches come from a second pass restricted to the
    resulting pairs.
    """
    keys = [(series, k) for series, frames in estimates.items() for k in range(len(frames))]
    frames = [estimates[series][k] for series, k in keys]
    codes: dict[Any, int] = {}  # py-motmetrics accepts numbers only

    def code(*name: Any) -> int:
        return codes.setdefault(name, len(codes))

    matching = motmetrics.MOTAccumulator()
    for number, frame in enumerate(frames):
        truth, tracks = ([code(number, id_) for id_ in each] for each in frame)
        distance = [[_apart(frame, t, k) for k in frame.tracks] for t in frame.truth]
        gated = np.where(np.array(distance) <= GATE_M, distance, np.nan) if truth and tracks else []
        matching.update(truth, tracks, gated, frameid=number)
    scores: list[dict[str, list[Any]]] = [defaultdict(list) for _ in keys]
    events = matching.mot_events
    columns = (events.index.get_level_values(0), events["Type"], events["OId"], events["HId"], events["D"])
    for number, kind, oid, hid, apart in zip(*(list(column) for column in columns), strict=True):
        scores[number][kind].append((oid, hid, apart))
    names = list(codes)
    switching = motmetrics.MOTAccumulator()
    for number, (series, _) in enumerate(keys):
        pairs = scores[number]["MATCH"]
        apart = np.full((len(pairs), len(pairs)), np.nan)
        np.fill_diagonal(apart, [pair[2] for pair in pairs])
        truth, tracks = ([code(series, names[int(pair[side])][1]) for pair in pairs] for side in (0, 1))
        switching.update(truth, tracks, apart, frameid=number)
    switches = [0] * len(keys)
    for number, kind in zip(switching.mot_events.index.get_level_values(0), switching.mot_events["Type"], strict=True):
        switches[number] += kind == "SWITCH"
    result: dict[Series, list[Row]] = defaultdict(list)
    for number, (series, _) in enumerate(keys):
        kinds = scores[number]
        apart = [pair[2] for pair in kinds["MATCH"]]
        rmse = math.sqrt(np.mean(np.square(apart))) if apart else math.nan
        result[series].append(Row(len(kinds["MISS"]), len(kinds["FP"]), len(apart), rmse, switches[number]))
    return result
