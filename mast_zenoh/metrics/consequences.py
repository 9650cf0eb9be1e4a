"""Consequences of estimation errors for vehicles. Pure; see docs/metrics.md."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.causes import ATTACK_CAUSES, Labels
from mast_zenoh.metrics.driving import Ahead, Driving, Objects, Vehicle
from mast_zenoh.metrics.lookup import find
from mast_zenoh.metrics.record import LOCAL, MISSION, Record, Series, TruthTable
from mast_zenoh.metrics.scores import FALSE, MISSED, Scores, Table

TRUTH = "truth"
#: The estimates that a vehicle could use for driving.
ESTIMATES = (LOCAL, MISSION)


class Drive(NamedTuple):
    """The behaviour of one vehicle under one estimate in (f,) frames.

    objects, false, missed: (f,) in its corridor: tracks (or truth objects), false tracks, missed truth objects
    overlapping:  (f,) tracks (or truth objects) that overlap the vehicle itself and are ignored
    gap_m, ttc_s: (f,) least values over all objects; inf without objects
    brake:        (f,) bool
    needless, omitted: (f,) bool, braking without a reason in the truth, or the reverse
    attacked:     (f,) bool, the needless or omitted braking is due to an attack
    """

    objects: Ints
    false: Ints
    missed: Ints
    overlapping: Ints
    gap_m: Floats
    ttc_s: Floats
    brake: Bools
    needless: Bools
    omitted: Bools
    attacked: Bools


def drives(
    driving: Driving, record: Record, scores: Scores, labels: Labels, truth: TruthTable
) -> dict[tuple[str, str], Drive]:
    """The behaviour of each vehicle among the agents, by (agent, estimate).

    "truth" is one of the estimates.
    truth: of the frames of `scores`. Only agents that are objects of the scene in all frames are vehicles.
    """
    result: dict[tuple[str, str], Drive] = {}
    for column, agent in enumerate(record.agents):
        vehicle = _vehicle(truth, column, len(scores.frames))
        if vehicle is None:
            continue
        others = (truth.boxes.id != truth.agent_object[truth.boxes.group, column]).nonzero()[0]
        boxes = truth.boxes.select(others)
        real = Objects(boxes.group, boxes.position, truth.velocity[others], boxes.size, boxes.yaw)
        by_truth = driving.ahead(vehicle, real)
        ids = boxes.id[by_truth.row]
        result[agent, TRUTH] = _drive(by_truth, real, len(scores.frames))
        for estimate in ESTIMATES:
            if Series(agent, estimate) not in record.series():
                continue
            table = record.tracks([Series(agent, estimate)], scores.frames)
            tracks = Objects(table.boxes.group, table.boxes.position, table.velocity, table.boxes.size, table.boxes.yaw)
            ahead = driving.ahead(vehicle, tracks)
            series = scores.every_series[agent, estimate]
            false = _errors(scores, labels, series, FALSE, tracks.frame[ahead.row], table.boxes.id[ahead.row])
            missed = _errors(scores, labels, series, MISSED, real.frame[by_truth.row], ids)
            drive = _drive(ahead, tracks, len(scores.frames))
            result[agent, estimate] = _compare(
                drive, result[agent, TRUTH], (ahead, tracks, *false), (by_truth, real, *missed)
            )
    return result


def _vehicle(truth: TruthTable, agent: int, n_frames: int) -> Vehicle | None:
    own = (truth.boxes.id == truth.agent_object[truth.boxes.group, agent]) & (truth.boxes.id >= 0)
    rows = own.nonzero()[0]
    if n_frames == 0 or len(rows) != n_frames:
        return None
    boxes = truth.boxes.select(rows)
    length, width = boxes.size[0, :2].tolist()
    return Vehicle(boxes.position, truth.velocity[rows], boxes.yaw, length, width)


def _errors(scores: Scores, labels: Labels, series: int, outcome: int, frame: Ints, id_: Ints) -> tuple[Bools, Bools]:
    """Objects (n,) of a series with this outcome, and which of them are due to an attack."""
    judged = scores.judged
    rows = np.flatnonzero((judged.series == series) & (judged.outcome == outcome))
    at = find((scores.frames[frame], id_), (judged.frame[rows], judged.id[rows]))
    wrong = at >= 0
    cause = np.append(labels.cause[rows], -1)[at]
    return wrong, wrong & (cause >= 0) & (cause < len(ATTACK_CAUSES))


def _drive(ahead: Ahead, objects: Objects, n: int) -> Drive:
    frame = objects.frame[ahead.row]
    gap, ttc = np.full(n, np.inf), np.full(n, np.inf)
    np.minimum.at(gap, frame, ahead.gap_m)
    np.minimum.at(ttc, frame, ahead.ttc_s)
    none, never = np.zeros(n, np.int64), np.zeros(n, bool)
    brake = np.bincount(frame[ahead.brake], minlength=n) > 0
    overlapping = np.bincount(objects.frame[ahead.overlapping], minlength=n)
    return Drive(np.bincount(frame, minlength=n), none, none, overlapping, gap, ttc, brake, never, never, never)


def _compare(
    drive: Drive,
    by_truth: Drive,
    false: tuple[Ahead, Objects, Bools, Bools],
    missed: tuple[Ahead, Objects, Bools, Bools],
) -> Drive:
    """The behaviour under an estimate, compared with that under the truth.

    false, missed: objects ahead in the estimate and in the truth, which of them are errors, and which due to attacks
    """
    n = len(drive.brake)

    def frames(part: tuple[Ahead, Objects, Bools, Bools], mask: Bools) -> Ints:
        return np.bincount(part[1].frame[part[0].row][mask], minlength=n)

    needless, omitted = drive.brake & ~by_truth.brake, by_truth.brake & ~drive.brake
    attacked = needless & (frames(false, false[3] & false[0].brake) > 0)
    attacked |= omitted & (frames(missed, missed[3] & missed[0].brake) > 0)
    return drive._replace(
        false=frames(false, false[2]),
        missed=frames(missed, missed[2]),
        needless=needless,
        omitted=omitted,
        attacked=attacked,
    )


def summary(by_estimate: dict[tuple[str, str], Drive], scored: slice) -> dict[str, dict[str, dict[str, Any]]]:
    """Mean numbers of objects and fractions of frames, by agent and estimate.

    Over the scored frames.
    """
    result: dict[str, dict[str, dict[str, Any]]] = {}
    for (agent, estimate), drive in by_estimate.items():
        part = Drive._make(column[scored] for column in drive)
        if not len(part.brake):
            continue
        min_ttc_s = float(part.ttc_s.min())
        values = {
            "corridor_objects": float(part.objects.mean()),
            "overlapping_objects": float(part.overlapping.mean()),
            "min_ttc_s": min_ttc_s if np.isfinite(min_ttc_s) else None,
            "brake_share": float(part.brake.mean()),
        }
        if estimate != TRUTH:
            values |= {
                "corridor_false": float(part.false.mean()),
                "corridor_missed": float(part.missed.mean()),
                "needless_brake_share": float(part.needless.mean()),
                "missed_brake_share": float(part.omitted.mean()),
                "needless_brake_share_attack": float((part.needless & part.attacked).mean()),
                "missed_brake_share_attack": float((part.omitted & part.attacked).mean()),
            }
        result.setdefault(agent, {})[estimate] = values
    return result


def table(by_estimate: dict[tuple[str, str], Drive], frames: Ints) -> Table:
    """The columns of driving.parquet: a row per agent, estimate and frame."""
    keys: Sequence[tuple[str, str]] = list(by_estimate)
    count = len(frames)
    columns: Table = {
        "frame": np.tile(frames, len(keys)),
        "agent": np.repeat(np.array([agent for agent, _ in keys], object), count),
        "estimate": np.repeat(np.array([estimate for _, estimate in keys], object), count),
    }
    for name in Drive._fields:
        parts = [getattr(drive, name) for drive in by_estimate.values()]
        columns[name] = np.concatenate(parts) if parts else np.zeros(0)
    for name in ("gap_m", "ttc_s"):
        columns[name] = np.where(np.isfinite(columns[name]), columns[name], np.nan)
    return columns
