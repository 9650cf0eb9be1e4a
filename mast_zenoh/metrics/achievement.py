"""What each adversary achieved: which of the objects that it inserted, hid or moved were believed, by whom and for how
long. Pure; see docs/metrics.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.displacement import followed
from mast_zenoh.metrics.lookup import find
from mast_zenoh.metrics.manipulations import ALTERED, INSERTED, KINDS, MOVED, REMOVED, Manipulations
from mast_zenoh.metrics.places import Places, nearest
from mast_zenoh.metrics.record import MISSION, PICTURE, TruthTable
from mast_zenoh.metrics.scores import MATCHED, MISSED, UNEVALUATED, Scores, Table, Texts

#: Name in the summary of all adversaries together.
ALL = "all"
#: m, from an inserted object to a false track that is taken for it, as in `Attribution.lie_m`.
ACCEPTED_M = 5.0
#: m; an object whose estimate is off by more was displaced: half the gate of the metrics.
DISPLACED_M = 1.0
#: s; a hidden or moved object counts as such when it was missed or displaced for so long, and in more than half of the
#: frames in which the adversary tried: honest errors are short.
LASTING_S = 1.0


@dataclass(frozen=True, slots=True)
class Targets:
    """n objects that an adversary manipulated, each in one frame; several passages of one adversary count once.

    adversary: (n,) row of `Manipulations.culprits`;  kind: (n,) index into KINDS
    frame, object: (n,), see Manipulations;  position: (n, 3) m, world frame, where the object was shown or had been
    believed:  by estimate, (n,) bool: an inserted object is there, a hidden one is missed, a moved one is off by more
               than DISPLACED_M, missed, or followed by a false track to where it was moved
    judged:    by estimate, (n,) bool: whether that can be said, because the object is in range and evaluated
    error_m:   by estimate, (n,) m, from the truth to the false track that follows a moved object, else to the track
               that is matched with it; NaN: there is none
    by_others: (n,) bool: an agent on none of whose wires this adversary sits sees the object; False for inserted ones
    """

    adversary: Ints
    kind: Ints
    frame: Ints
    object: Ints
    position: Floats
    believed: dict[str, Bools]
    judged: dict[str, Bools]
    error_m: dict[str, Floats]
    by_others: Bools

    def table(self, culprits: tuple[str, ...]) -> Table:
        """The columns of targets.parquet."""
        columns: Table = {
            "adversary": np.array([*culprits, ""], object)[self.adversary],
            "kind": np.array(KINDS, object)[self.kind],
            "object": self.object,
            "frame": self.frame,
            **{axis: self.position[:, i] for i, axis in enumerate("xyz")},
            "seen_by_others": self.by_others,
        }
        for name in self.believed:
            columns[f"believed_{name}"] = self.believed[name]
            columns[f"judged_{name}"] = self.judged[name]
            columns[f"error_m_{name}"] = self.error_m[name]
        return columns


def targets(
    scores: Scores,
    cause: Ints,
    by: Texts,
    done: Manipulations,
    truth: TruthTable,
    agents: Sequence[str],
    ego: str,
    victims: dict[str, set[int]],
    range_m: float,
    min_points: int,
) -> Targets:
    """What became of every manipulated object in the centre's picture and in what the ego acts on.

    cause, by: of the rows of `scores.judged`
    truth:   of the frames of `scores`, of which `agents` are the columns
    ego:     whose mission-critical estimate it is
    victims: by adversary, columns of the agents on whose wires it sits
    range_m: m, from an agent to the objects that its estimates are scored on
    min_points: lidar points with which an agent sees an object
    """
    mine = done.select((done.culprit >= 0).nonzero()[0])
    key = np.column_stack([mine.culprit, mine.kind, mine.object, mine.frame]) if len(mine) else np.zeros((0, 4), int)
    _, first = np.unique(key, axis=0, return_index=True)
    mine = mine.select(first)
    picture = np.array([estimator == PICTURE for _, estimator in scores.series], bool)
    mission = np.array([each == (ego, MISSION) for each in scores.series], bool)
    believed, judged, error = {}, {}, {}
    for name, chosen in (("centre", picture), ("ego", mission)):
        scorers = [agents.index(agent) for (agent, _), mine_too in zip(scores.series, chosen, strict=True) if mine_too]
        within = _in_range(mine, truth.agent_position[:, scorers], scores.frames, range_m)
        believed[name], judged[name], error[name] = _judge(scores, cause, by, mine, chosen, within)
    return Targets(
        mine.culprit,
        mine.kind,
        mine.frame,
        mine.object,
        mine.position,
        believed,
        judged,
        error,
        _seen_by_others(mine, truth, scores.frames, victims, min_points),
    )


def _in_range(done: Manipulations, place: Floats, frames: Ints, range_m: float) -> Bools:
    """(n,) bool: whether the object of each manipulation is in range of any of a agents, which are at (f, a, 3) m."""
    at = find((done.frame,), (frames,))
    if not (at >= 0).any():
        return np.zeros(len(done), bool)
    offset = place[at] - done.position[:, None]
    return np.asarray((at >= 0) & (np.hypot(offset[..., 0], offset[..., 1]) <= range_m).any(axis=1))


def _judge(
    scores: Scores, cause: Ints, by: Texts, done: Manipulations, chosen: Bools, within: Bools
) -> tuple[Bools, Bools, Floats]:
    """Of each manipulation whether it is believed in some series, whether that can be said, and the error, m.

    within: (n,) bool, whether it is in range of any agent of these series
    """
    judged, inside = scores.judged, chosen[scores.judged.series]
    believed, known = np.zeros(len(done), bool), np.zeros(len(done), bool)
    error = np.full(len(done), np.nan)
    shown = np.flatnonzero(done.kind == INSERTED)
    false = np.flatnonzero(inside & (cause == INSERTED) & judged.is_track)
    lies = Places(judged.frame[false], judged.boxes.position[false])
    believed[shown] = nearest(Places(done.frame[shown], done.position[shown]), lies, ACCEPTED_M)[0] >= 0
    known[shown] = within[shown]
    others = np.flatnonzero(done.kind != INSERTED)
    rows = np.flatnonzero(inside & ~judged.is_track & (judged.outcome != UNEVALUATED))
    wanted = done.object[others], done.frame[others]
    at = find(wanted, (judged.id[rows], judged.frame[rows]))
    # An object that any of the agents has is not hidden.
    matched = (judged.outcome[rows] == MATCHED).nonzero()[0]
    seen = find(wanted, (judged.id[rows[matched]], judged.frame[rows[matched]]))
    at[seen >= 0] = matched[seen[seen >= 0]]
    known[others] = at >= 0
    others, row = others[at >= 0], rows[at[at >= 0]]
    missed = judged.outcome[row] == MISSED
    error[others] = _error(scores, row, np.flatnonzero(inside & judged.is_track & (judged.outcome == MATCHED)))
    off = np.isin(done.kind[others], (MOVED, ALTERED)) & (np.nan_to_num(error[others]) > DISPLACED_M)
    ghost = followed(
        scores, inside & (cause == MOVED) & judged.is_track, by, done, others, row, near_m=ACCEPTED_M, off_m=DISPLACED_M
    )
    error[others] = np.where(np.isfinite(ghost), ghost, error[others])
    believed[others] = missed | off | np.isfinite(ghost)
    return believed, known, error


def _error(scores: Scores, rows: Ints, tracks: Ints) -> Floats:
    """(n,) m: bird's-eye distance from truth rows of `scores.judged` to those of matched tracks; NaN without."""
    judged, error = scores.judged, np.full(len(rows), np.nan)
    wanted = judged.series[rows], judged.frame[rows], judged.match_id[rows]
    at = find(wanted, (judged.series[tracks], judged.frame[tracks], judged.id[tracks]))
    hit = (at >= 0) & (judged.outcome[rows] == MATCHED)
    offset = judged.boxes.position[tracks[at[hit]]] - judged.boxes.position[rows[hit]]
    error[hit] = np.hypot(offset[:, 0], offset[:, 1])
    return error


def _seen_by_others(
    done: Manipulations, truth: TruthTable, frames: Ints, victims: dict[str, set[int]], min_points: int
) -> Bools:
    boxes = truth.boxes
    at = find((done.object, done.frame), (boxes.id, frames[boxes.group]))
    result = np.zeros(len(done), bool)
    for index, name in enumerate(done.culprits):
        free = [column for column in range(truth.points.shape[1]) if column not in victims.get(name, set())]
        rows = ((done.culprit == index) & (done.kind != INSERTED) & (at >= 0)).nonzero()[0]
        result[rows] = (truth.points[at[rows]][:, free] >= min_points).any(axis=1)
    return result


def summary(
    found: Targets,
    culprits: tuple[str, ...],
    scores: Scores,
    switch_by: Texts,
    ego: str,
    period_s: float,
    scored: slice = slice(None),
) -> dict[str, dict[str, Any]]:
    """By adversary, and of ALL together, what was achieved; {} where there is no adversary. See docs/metrics.md.

    switch_by: of `scores.switches`, the adversaries that each is due to
    scored:    the frames in which identity switches count, as in the summary of scores
    """
    if not culprits:
        return {}
    real = (found.kind == INSERTED) | (found.object >= 0)
    groups = {name: (real & (found.adversary == index)).nonzero()[0] for index, name in enumerate(culprits)}
    counts = np.zeros(len(scores.frames), bool)
    counts[scored] = True
    result = {}
    together = _together(found, real.nonzero()[0])
    of_each = {name: (found, rows) for name, rows in groups.items()} | {ALL: (together, np.arange(len(together.kind)))}
    for name, (targets_of, rows) in of_each.items():
        due = np.array([by != "" if name == ALL else name in by.split("+") for by in switch_by.tolist()], bool)
        result[name] = _achieved(targets_of, rows, period_s)
        for who, estimate in (("centre", (ego, PICTURE)), ("ego", (ego, MISSION))):
            mine = np.array([each == estimate for each in scores.series], bool)
            counted = due & mine[scores.switches.series] & counts[scores.switches.frame]
            result[name][f"id_switches_{who}"] = int(np.count_nonzero(counted))
    return result


def _together(found: Targets, rows: Ints) -> Targets:
    """The targets in `rows`, an object that several adversaries hid, or moved, in one frame being one target.

    It is believed if it is by what any of them did, and its error is the greatest.
    """
    _, first, of = np.unique(
        np.column_stack([found.kind, found.object, found.frame])[rows], axis=0, return_index=True, return_inverse=True
    )
    believed = {name: np.bincount(of, mine[rows], len(first)) > 0 for name, mine in found.believed.items()}
    error = {name: np.full(len(first), np.nan) for name in found.error_m}
    for name, mine in found.error_m.items():
        np.fmax.at(error[name], of, mine[rows])
    kept = rows[first]
    return Targets(
        found.adversary[kept],
        found.kind[kept],
        found.frame[kept],
        found.object[kept],
        found.position[kept],
        believed,
        {name: mine[kept] for name, mine in found.judged.items()},
        error,
        found.by_others[kept],
    )


def _achieved(found: Targets, rows: Ints, period_s: float) -> dict[str, Any]:
    result: dict[str, Any] = {}
    success = dict.fromkeys(found.believed, rows[:0])
    for what, kinds in (
        ("inserted", (INSERTED,)),
        ("hidden", (REMOVED,)),
        ("moved", (MOVED,)),
        ("altered", (ALTERED,)),
    ):
        mine = rows[np.isin(found.kind[rows], kinds)]
        objects, of = np.unique(found.object[mine], return_inverse=True)
        result[what] = len(objects)
        if not len(objects):
            continue
        result[f"{what}_frames"] = len(mine)
        for who in found.believed:
            judged, believed = found.judged[who][mine], (found.believed[who] & found.judged[who])[mine]
            frames = np.bincount(of, believed, len(objects))
            possible = np.bincount(of, judged, len(objects))
            if what == "inserted":
                lasting = frames > 0
            else:
                lasting = (frames * period_s > LASTING_S - 1e-9) & (2 * frames > possible)
            result[f"{what}_share_{who}"] = float(lasting[possible > 0].mean()) if possible.any() else None
            result[f"{what}_time_share_{who}"] = float(believed[judged].mean()) if judged.any() else None
            if what == "inserted":
                result[f"inserted_s_{who}"] = float(frames[lasting].mean() * period_s) if lasting.any() else None
            if what in ("moved", "altered"):
                error = found.error_m[who][mine]
                known = error[np.isfinite(error)]
                result[f"{what}_error_m_{who}"] = float(known.mean()) if len(known) else None
            success[who] = np.concatenate([success[who], mine[believed & lasting[of]]])
        if what != "inserted":
            result[f"{what}_seen_by_others"] = float(found.by_others[mine].mean())
    for who, hits in success.items():
        result[f"success_{who}"] = bool(len(hits))
        waited = found.frame[hits].min() - found.frame[rows].min() if len(hits) else None
        result[f"first_success_s_{who}"] = None if waited is None else float(waited * period_s)
    return result
