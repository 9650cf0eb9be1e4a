"""Converts measured effects of interposers to manipulations. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.evaluation.effects import EFFECTS, Effects
from mast_zenoh.evaluation.effects.passages import Spoof
from mast_zenoh.evaluation.effects.scans import POINTS
from mast_zenoh.evaluation.effects.table import Poses, insertions
from mast_zenoh.evaluation.estimate_wires import Influences
from mast_zenoh.metrics import AttributionLimits, Boxes, Manipulations, Scores
from mast_zenoh.metrics.assignment import Places, nearest, occurs
from mast_zenoh.metrics.causes import ALTERED, INSERTED, KINDS, MOVED, REMOVED, ROW_COLUMNS
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.metrics.record import TruthTable
from mast_zenoh.wiring.model import InterposedWire, agent_of

#: Columns that say nothing of where an object is, or will be.
_OF_BOX = {"size", "yaw", "class_id"}

#: Types of messages from sensors, in their frame: a single one makes and loses no track.
SENSED = ("detections", POINTS)

#: Share of the frames of a second in which an agent that tracks an object sees it.
SEEN_SHARE = 0.8
#: Detections in two seconds without which no track begins.
LEAST_DETECTIONS = 3


def manipulations(
    effects: Effects,
    roles: Mapping[str, str],
    series: Sequence[tuple[str, str]],
    truth: Boxes,
    period_s: float,
    away: Bools,
    limits: AttributionLimits,
    influences: Influences,
) -> Manipulations:
    """The manipulations among the measured effects.

    roles:  of the nodes; effects of links count as faults
    series: s pairs (agent, estimator)
    truth:  all objects, world frame; group = frame
    away:   (n,) effects due to the absence of an interposer, which are not manipulations
    limits: which effects count, and for how long
    influences: what the passages can affect
    """
    is_link = np.array([roles.get(passage.node) == "link" for passage in effects.passages], bool)
    culprits = tuple(sorted({p.node for p, link in zip(effects.passages, is_link, strict=True) if not link}))
    culprit_row = np.array(
        [-1 if link else culprits.index(p.node) for p, link in zip(effects.passages, is_link, strict=True)], np.int64
    )

    inserted, episode, velocity = insertions(effects, period_s)
    hidden, kind, columns = _hidden(effects, limits)
    of_tracks = np.array([interposed.message not in SENSED for interposed in effects.passages], bool)
    of_box = np.array([set() < names <= _OF_BOX for names in columns], bool)
    of_box &= (kind == ALTERED) & of_tracks[effects.passage[hidden]]
    renamed = effects.passage[hidden[np.array(["id" in names for names in columns], bool)]]
    # What a passage carries is judged where it says, unless it is called by another name.
    wires = [(influences.of(each), each.wire) for each in effects.passages]
    as_sent = np.array(
        [[known is not None and known.carries(key, one) for one in series] for known, key in wires], bool
    )
    as_sent = as_sent.reshape(len(is_link), len(series)) & ~np.isin(np.arange(len(is_link)), renamed)[:, None]
    shown, delay = influences.reach(effects.passages, series, np.zeros(len(is_link), bool))
    # Whether the picture lacks an object because of a link depends on the others that report it (`metrics.cut_off`).
    reach, _ = influences.reach(effects.passages, series, is_link)
    hidden_places = Places(effects.frame[hidden], effects.before[hidden])
    truth_row, _ = nearest(hidden_places, Places(truth.group, truth.position), limits.hidden_m)
    rows = np.concatenate([inserted, hidden])
    passage = effects.passage[rows]
    lasts = np.array(
        [_lasts(interposed, link, limits, period_s) for interposed, link in zip(effects.passages, is_link, strict=True)]
    )
    result = Manipulations(
        culprits=culprits,
        reach=reach,
        altered=reach & ~as_sent,
        shown=shown,
        delay=delay,
        passage=passage,
        culprit=culprit_row[passage] if len(rows) else passage,
        kind=np.concatenate([np.full(len(inserted), INSERTED), kind]),
        frame=effects.frame[rows],
        object=np.concatenate(
            [episode, np.where(truth_row >= 0, np.append(truth.id, 0)[truth_row], -1 - np.arange(len(truth_row)))]
        ),
        position=np.where(np.isfinite(effects.after[rows]), effects.after[rows], effects.before[rows]),
        original=effects.before[rows],
        velocity=np.nan_to_num(np.concatenate([velocity, effects.velocity[hidden]])),
        lasts=lasts[passage] if len(rows) else passage,
        of_box=np.concatenate([np.zeros(len(inserted), bool), of_box]),
    )
    return result.select(~away[rows])


def _lasts(passage: InterposedWire, is_link: bool, limits: AttributionLimits, period_s: float) -> int:
    """Number of frames after its own for which a manipulation counts.

    Effects of links on tracks count only in their own frame; missing objects in the picture: `metrics.cut_off`.
    """
    if not is_link or passage.message in (*SENSED, "pose"):
        return round(limits.coast_s / period_s)
    return round(limits.late_picture_s / period_s) if passage.message == "picture" else 0


def _hidden(effects: Effects, limits: AttributionLimits) -> tuple[Ints, Ints, list[set[str]]]:
    """Rows and kinds of objects that were removed, moved far enough or altered, and what changed besides position."""
    rows = effects.rows("removed", "moved", "altered")
    rows = rows[np.isfinite(effects.before[rows]).all(axis=1)]
    kind = np.array([KINDS.index(name) if name in KINDS else -1 for name in EFFECTS])[effects.code[rows]]
    displacement = np.hypot(*(effects.after[rows] - effects.before[rows])[:, :2].T)
    columns = [set(names.split()) - {"position"} for names in effects.columns[rows].tolist()]
    unmoved = (kind == MOVED) & ~(displacement >= limits.least_move_m)
    kind[unmoved] = ALTERED  # if anything else changed
    counts = ~unmoved | np.array([bool(names) for names in columns], bool)
    return rows[counts], kind[counts], [columns[row] for row in np.flatnonzero(counts).tolist()]


def effects_of_absence(effects: Effects, absences: Mapping[str, Bools], frames: Ints) -> Bools:
    """(n,) effects on messages that were lost because an interposer was absent.

    absences: by node, (f,) bool, whether it was absent in each of (f,) frames
    """
    result = np.zeros(len(effects), bool)
    withheld = effects.whole.copy()
    withheld[effects.rows("dropped", "delayed", "unsettled")] = True
    for index, passage in enumerate(effects.passages):
        away = absences.get(passage.node)
        if away is not None and away.any():
            rows = ((effects.passage == index) & withheld).nonzero()[0]
            at = np.searchsorted(frames, effects.step[rows], side="right") - 1
            result[rows] = away[np.clip(at, 0, len(away) - 1)]
    return result


def first_change(effects: Effects, roles: Mapping[str, str], away: Bools) -> int | None:
    """The frame in which an interposer other than a link first changed a message; None: never.

    away: (n,) effects due to the absence of an interposer, which do not count
    """
    is_link = np.array([roles.get(passage.node) == "link" for passage in effects.passages], bool)
    counts = ~away & ~is_link[effects.passage]
    counts[effects.rows("unsettled")] = False
    return int(effects.step[counts].min()) if counts.any() else None


def stopped_by_links(
    effects: Effects,
    roles: Mapping[str, str],
    agents: Sequence[str],
    frames: Ints,
    influences: Influences,
    listener: str = "",
) -> Bools:
    """Whether a link stopped an agent's tracks of a frame, alone or in a batch: (f, a).

    To stop is to drop, damage or delay.
    listener: the agent for whose picture they are; empty: the common one
    """
    result = np.zeros((len(frames), len(agents)), bool)
    rows = effects.rows("dropped", "delayed", "corrupted", "unsettled")
    for index, passage in enumerate(effects.passages):
        picture = (listener, PICTURE)
        known, place = influences.of(passage), (passage.wire, passage.before)
        if known is None or roles.get(passage.node) != "link" or not known.arrives_at(*place, picture):
            continue
        senders = known.tracks_on(passage.wire) - {listener}
        after = known.frames(*place, picture) or 0
        lost = np.isin(frames - after, effects.frame[rows[effects.passage[rows] == index]])
        result[:, [name in senders for name in agents]] |= lost[:, None]
    return result


def displaced_by_links(manipulations: Manipulations, effects: Effects, scores: Scores, influences: Influences) -> Bools:
    """Whether a link moved an agent's track of a truth object: (n, a) of n rows of the truth."""
    keys, agents = (scores.truth.boxes.id, scores.truth_frame), scores.agents
    result = np.zeros((len(keys[0]), len(agents)), bool)
    moved = (manipulations.kind == MOVED) & (manipulations.culprit < 0)
    for index, passage in enumerate(effects.passages):
        rows = (moved & (manipulations.passage == index)).nonzero()[0]
        known = influences.of(passage)
        if len(rows) and known and passage.subject in agents and passage.subject in known.tracks_on(passage.wire):
            places = manipulations.object[rows], manipulations.frame[rows]
            result[:, agents.index(passage.subject)] |= occurs(keys, places)
    return result


def without_unseen(
    manipulations: Manipulations, effects: Effects, scores: Scores, min_points: int, begin: int
) -> Manipulations:
    """Manipulations in which a detection that was removed stands for an object only if the agent would track it.

    That is if its sensor has seen the object in most of the last `begin` frames: a single detection makes no track.
    min_points: lidar points from which an agent sees an object
    """
    object_ids = manipulations.object.copy()
    removed = (manipulations.kind == REMOVED) & (object_ids >= 0)
    truth_keys, agents = (scores.truth.boxes.id, scores.truth_frame), scores.agents
    for index, passage in enumerate(effects.passages):
        rows = (removed & (manipulations.passage == index)).nonzero()[0]
        agent = agent_of(passage.subject)
        if not len(rows) or passage.message not in SENSED or agent not in agents:
            continue
        seen = scores.truth.points[:, agents.index(agent)] >= min_points
        seen_keys = truth_keys[0][seen], truth_keys[1][seen]
        ids, frame = object_ids[rows], manipulations.frame[rows]
        count = sum(occurs((ids, frame - back), seen_keys).astype(np.int64) for back in range(begin))
        lost = sum(occurs((ids, frame - back), (ids, frame)).astype(np.int64) for back in range(2 * begin))
        unseen = rows[(count < SEEN_SHARE * begin) | (lost < LEAST_DETECTIONS)]
        object_ids[unseen] = -1 - len(object_ids) - np.arange(len(unseen))
    return replace(manipulations, object=object_ids)


def without_undetected(
    manipulations: Manipulations,
    effects: Effects,
    detected: Mapping[str, Mapping[int, Floats]],
    poses: Poses,
    reach_m: float,
) -> Manipulations:
    """Manipulations of points as far as they led a detector.

    Inserted points count if something is detected there in the same scan, removed ones if nothing is, and both only as
    long as there are detections. Where nobody can know what is detected, all count.

    detected: by subject and frame, (n, 3) m, frame of the agent
    reach_m:  m, maximum distance from the middle of points to what is detected in them
    """
    counts, lasts = np.ones(len(manipulations), bool), manipulations.lasts.copy()
    for index, passage in enumerate(effects.passages):
        if passage.message != POINTS or passage.subject not in detected:
            continue
        rows = (manipulations.passage == index).nonzero()[0]
        frame, agent = manipulations.frame[rows], agent_of(passage.subject)
        scans = {key: position for key, position in detected[passage.subject].items() if (agent, key) in poses}
        among = [
            position @ rotation_from_quaternion(poses[agent, key].rotation).T + poses[agent, key].position
            for key, position in scans.items()
        ]
        groups = np.repeat(np.array([*scans], np.int64), [len(position) for position in among])
        places = Places(groups, np.concatenate([np.zeros((0, 3)), *among]))
        there = nearest(Places(frame, manipulations.position[rows]), places, reach_m)[0] >= 0
        counts[rows] = np.isin(frame, [*scans]) & (there != (manipulations.kind[rows] == REMOVED))
        lasts[rows] = np.clip(lasts[rows], 0, np.maximum(max(scans, default=0) - frame, 0))
    return replace(manipulations, lasts=lasts).select(counts)


#: Effects on a pose that leave an agent without its pose, so that it cannot locate objects.
_WITHHELD = ("dropped", "delayed", "corrupted", "unsettled")


def add_pose_manipulations(
    manipulations: Manipulations,
    effects: Effects,
    spoofs: Sequence[Sequence[Spoof]],
    scores: Scores,
    min_points: int,
    lasts: int,
) -> Manipulations:
    """Add the objects that an agent misplaces or omits because of a false pose.

    spoofs: by passage of `effects`
    min_points: lidar points from which an agent sees an object;  lasts: frames for which it counts after its own
    """
    parts, truth, of_frame, agents = [manipulations], scores.truth, scores.truth_frame, scores.agents
    for index, passage in enumerate(effects.passages):
        if passage.message != "pose" or passage.subject not in agents:
            continue
        culprit = manipulations.culprits.index(passage.node) if passage.node in manipulations.culprits else -1
        seen = truth.points[:, agents.index(passage.subject)] >= min_points
        withheld_rows = effects.rows(*_WITHHELD)
        withheld = np.isin(of_frame, effects.frame[withheld_rows[effects.passage[withheld_rows] == index]])
        groups = [((seen & withheld).nonzero()[0], REMOVED, truth.boxes.position)]
        for spoof in spoofs[index]:
            groups.append(((seen & (of_frame == spoof.frame)).nonzero()[0], MOVED, _apparent_positions(spoof, truth)))
        for rows, kind, position in groups:
            n = len(rows)
            parts.append(
                replace(
                    manipulations,
                    passage=np.full(n, index),
                    culprit=np.full(n, culprit),
                    kind=np.full(n, kind),
                    frame=of_frame[rows],
                    object=truth.boxes.id[rows],
                    position=position[rows],
                    original=truth.boxes.position[rows],
                    velocity=truth.velocity[rows],
                    lasts=np.full(n, lasts),
                    of_box=np.zeros(n, bool),
                )
            )
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in ROW_COLUMNS}
    return replace(manipulations, **columns)


def _apparent_positions(spoof: Spoof, truth: TruthTable) -> Floats:
    """Apparent positions (n, 3) m of objects for an agent with a false pose."""
    rotation = rotation_from_quaternion(spoof.false_rotation) @ rotation_from_quaternion(spoof.rotation).T
    return np.asarray((truth.boxes.position - spoof.position) @ rotation.T + spoof.false_position)
