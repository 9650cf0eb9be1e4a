"""Success of the adversaries: which of their manipulations were believed, where, and for how long.

Pure; see docs/explanation-metrics-and-causes.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.assignment import Places, find, nearest
from mast_zenoh.metrics.causes import ALTERED, INSERTED, KINDS, MOVED, REMOVED, CauseLabels, Manipulations
from mast_zenoh.metrics.estimates import MISSION, PICTURE
from mast_zenoh.metrics.scores import MATCHED, MISSED, UNEVALUATED, Scores, Table, Texts

#: m, maximum distance between a false position and the track that follows it.
ACCEPTED_M = 5.0
#: m; an object with a larger error of its estimate counts as displaced: half the gate of the metrics.
DISPLACED_M = 1.0


def false_track_errors(
    scores: Scores, tracks: Bools, by: Texts, manipulations: Manipulations, targets: Ints, truth: Ints
) -> Floats:
    """(n,) m, distance between each displaced object and its false track; NaN: none.

    A false track caused by an adversary belongs to the nearest object that this adversary moved, within ACCEPTED_M of
    its false position, if the track is nearer to the false than to the true position, and more than DISPLACED_M from
    the latter.

    tracks:         (m,) bool, the rows of `scores.judged` that are such tracks
    by:             (m,) the adversaries responsible for each row
    targets, truth: (n,) rows of `manipulations`, and of the true objects in `scores.judged`
    """
    judged, result = scores.judged, np.full(len(targets), np.nan)
    nearest_m = np.full(len(targets), np.inf)
    row_of = np.full(len(manipulations), -1)
    row_of[targets] = np.arange(len(targets))
    for index, name in enumerate(manipulations.culprits):
        moved = np.flatnonzero((manipulations.kind == MOVED) & (manipulations.culprit == index))
        track_rows = np.flatnonzero(tracks)
        track_rows = track_rows[np.array([name in each.split("+") for each in by[track_rows].tolist()], bool)]
        places = Places(judged.frame[track_rows], judged.boxes.position[track_rows])
        at, distance = nearest(places, Places(manipulations.frame[moved], manipulations.position[moved]), ACCEPTED_M)
        track_rows, target, distance = track_rows[at >= 0], row_of[moved[at[at >= 0]]], distance[at >= 0]
        track_rows, target, distance = track_rows[target >= 0], target[target >= 0], distance[target >= 0]
        offset = (judged.boxes.position[track_rows] - judged.boxes.position[truth[target]])[:, :2]
        error = np.hypot(offset[:, 0], offset[:, 1])
        follows = (error > DISPLACED_M) & (distance < error)
        for k in np.flatnonzero(follows)[np.argsort(distance[follows], kind="stable")].tolist():
            if distance[k] < nearest_m[target[k]]:
                nearest_m[target[k]], result[target[k]] = distance[k], error[k]
    return result


@dataclass(frozen=True, slots=True)
class Manipulated:
    """n objects that an adversary manipulated, each in one frame.

    Several passages of one adversary count once.

    attacks:   n manipulations by adversaries
    believed:  by estimate, (n,) bool: an inserted object is present, a hidden one is missed, a moved one is missed, off
               by more than DISPLACED_M, or has a false track at its manipulated position
    judged:    by estimate, (n,) bool: whether `believed` is defined: the object is in range and evaluated
    error_m:   by estimate, (n,) m, from the truth to the false track of a moved object, else to its matched track; NaN:
               none
    by_others: (n,) bool: an agent whose wires this adversary does not intercept sees the object; False for inserted
    """

    attacks: Manipulations
    believed: dict[str, Bools]
    judged: dict[str, Bools]
    error_m: dict[str, Floats]
    by_others: Bools

    def select(self, rows: Bools) -> Manipulated:
        """The rows selected by a mask."""
        return Manipulated(
            self.attacks.select(rows),
            {name: values[rows] for name, values in self.believed.items()},
            {name: values[rows] for name, values in self.judged.items()},
            {name: values[rows] for name, values in self.error_m.items()},
            self.by_others[rows],
        )

    @classmethod
    def joined(cls, parts: Sequence[Manipulated]) -> Manipulated:
        """The targets of several parts of a run, in that order."""
        names = parts[0].believed
        return cls(
            Manipulations.joined([part.attacks for part in parts]),
            {name: np.concatenate([part.believed[name] for part in parts]) for name in names},
            {name: np.concatenate([part.judged[name] for part in parts]) for name in names},
            {name: np.concatenate([part.error_m[name] for part in parts]) for name in names},
            np.concatenate([part.by_others for part in parts]),
        )

    def table(self) -> Table:
        """The columns of targets.parquet.

        Columns:
        adversary, kind: who did it; `inserted`, `removed`, `moved` or `altered`
        object: number of an inserted object, otherwise the true object's id
        frame: number of the frame, from 0
        x, y, z: m, where it is shown, or was
        seen_by_others: whether an agent without this adversary sees it too
        believed_centre, believed_ego: whether it worked in this frame, in the picture and in the ego's estimate
        judged_centre, judged_ego: whether it can be judged there: in range, and evaluated
        error_m_centre, error_m_ego: m, from the truth to the track; missing where it does not apply
        """
        attacks = self.attacks
        columns: Table = {
            "adversary": np.array([*attacks.culprits, ""], object)[attacks.culprit],
            "kind": np.array(KINDS, object)[attacks.kind],
            "object": attacks.object,
            "frame": attacks.frame,
            **{axis: attacks.position[:, i] for i, axis in enumerate("xyz")},
            "seen_by_others": self.by_others,
        }
        for name in self.believed:
            columns[f"believed_{name}"] = self.believed[name]
            columns[f"judged_{name}"] = self.judged[name]
            columns[f"error_m_{name}"] = self.error_m[name]
        return columns


def targets(
    scores: Scores,
    labels: CauseLabels,
    manipulations: Manipulations,
    ego: str,
    victims: dict[str, set[int]],
    range_m: float,
    min_points: int,
) -> Manipulated:
    """Evaluate every manipulated object in the picture and the ego's estimate.

    The ego's estimate is the mission-critical one.
    ego:     name of the agent with the mission-critical estimate
    victims: by adversary, columns of the agents whose wires it intercepts
    range_m: m, from an agent to the objects that its estimates are scored on
    min_points: lidar points from which an agent sees an object
    """
    attacks = manipulations.select((manipulations.culprit >= 0).nonzero()[0])
    key = (
        np.column_stack([attacks.culprit, attacks.kind, attacks.object, attacks.frame])
        if len(attacks)
        else np.zeros((0, 4), int)
    )
    _, first = np.unique(key, axis=0, return_index=True)
    attacks = attacks.select(first)
    picture = np.array([estimator == PICTURE for _, estimator in scores.series], bool)
    mission = np.array([each == (ego, MISSION) for each in scores.series], bool)
    believed, judged, error = {}, {}, {}
    column = np.array([scores.agents.index(agent) for agent, _ in scores.series], np.int64)
    for name, chosen in (("centre", picture), ("ego", mission)):
        within = _in_range(attacks, scores.truth.agent_position[:, column[chosen]], scores.frames, range_m)
        believed[name], judged[name], error[name] = _judge(scores, labels, attacks, chosen, within)
    return Manipulated(attacks, believed, judged, error, _seen_by_others(attacks, scores, victims, min_points))


def _in_range(manipulations: Manipulations, place: Floats, frames: Ints, range_m: float) -> Bools:
    """Whether each manipulated object (n,) is in range of any of a agents.

    place: (f, a, 3) m
    """
    at = find((manipulations.frame,), (frames,))
    if not (at >= 0).any():
        return np.zeros(len(manipulations), bool)
    offset = place[at] - manipulations.position[:, None]
    return np.asarray((at >= 0) & (np.hypot(offset[..., 0], offset[..., 1]) <= range_m).any(axis=1))


def _judge(
    scores: Scores, labels: CauseLabels, manipulations: Manipulations, chosen: Bools, within: Bools
) -> tuple[Bools, Bools, Floats]:
    """Whether manipulations are believed, whether that is defined, and the error m.

    A manipulation is believed if any of the series believes it.

    within: (n,) bool, whether it is in range of any agent of these series
    """
    judged, inside, cause = scores.judged, chosen[scores.judged.series], labels.cause
    believed, defined = np.zeros(len(manipulations), bool), np.zeros(len(manipulations), bool)
    error = np.full(len(manipulations), np.nan)
    inserted = np.flatnonzero(manipulations.kind == INSERTED)
    false = np.flatnonzero(inside & (cause == INSERTED) & judged.is_track)
    false_places = Places(judged.frame[false], judged.boxes.position[false])
    believed[inserted] = (
        nearest(Places(manipulations.frame[inserted], manipulations.position[inserted]), false_places, ACCEPTED_M)[0]
        >= 0
    )
    defined[inserted] = within[inserted]
    real_rows = np.flatnonzero(manipulations.kind != INSERTED)
    rows = np.flatnonzero(inside & ~judged.is_track & (judged.outcome != UNEVALUATED))
    object_frame = manipulations.object[real_rows], manipulations.frame[real_rows]
    found_row = find(object_frame, (judged.id[rows], judged.frame[rows]))
    # An object that any of the agents tracks is not hidden.
    matched = (judged.outcome[rows] == MATCHED).nonzero()[0]
    matched_row = find(object_frame, (judged.id[rows[matched]], judged.frame[rows[matched]]))
    found_row[matched_row >= 0] = matched[matched_row[matched_row >= 0]]
    defined[real_rows] = found_row >= 0
    real_rows, row = real_rows[found_row >= 0], rows[found_row[found_row >= 0]]
    missed = judged.outcome[row] == MISSED
    error[real_rows] = _error(scores, row, np.flatnonzero(inside & judged.is_track & (judged.outcome == MATCHED)))
    displaced = np.isin(manipulations.kind[real_rows], (MOVED, ALTERED)) & (
        np.nan_to_num(error[real_rows]) > DISPLACED_M
    )
    tracks = inside & (cause == MOVED) & judged.is_track
    false_track_error = false_track_errors(scores, tracks, labels.by, manipulations, real_rows, row)
    error[real_rows] = np.where(np.isfinite(false_track_error), false_track_error, error[real_rows])
    believed[real_rows] = missed | displaced | np.isfinite(false_track_error)
    return believed, defined, error


def _error(scores: Scores, rows: Ints, tracks: Ints) -> Floats:
    """Bird's-eye distances (n,) m from truth rows to matched tracks; NaN without.

    rows, tracks: of `scores.judged`
    """
    judged, error = scores.judged, np.full(len(rows), np.nan)
    keys = judged.series[rows], judged.frame[rows], judged.match_id[rows]
    at = find(keys, (judged.series[tracks], judged.frame[tracks], judged.id[tracks]))
    matched = (at >= 0) & (judged.outcome[rows] == MATCHED)
    offset = judged.boxes.position[tracks[at[matched]]] - judged.boxes.position[rows[matched]]
    error[matched] = np.hypot(offset[:, 0], offset[:, 1])
    return error


def _seen_by_others(
    manipulations: Manipulations, scores: Scores, victims: dict[str, set[int]], min_points: int
) -> Bools:
    truth = scores.truth
    at = find((manipulations.object, manipulations.frame), (truth.boxes.id, scores.truth_frame))
    result = np.zeros(len(manipulations), bool)
    for index, name in enumerate(manipulations.culprits):
        free = [column for column in range(truth.points.shape[1]) if column not in victims.get(name, set())]
        rows = ((manipulations.culprit == index) & (manipulations.kind != INSERTED) & (at >= 0)).nonzero()[0]
        result[rows] = (truth.points[at[rows]][:, free] >= min_points).any(axis=1)
    return result


#: Name in the summary of all adversaries together.
ALL = "all"
#: s; a hidden or moved object counts as such if it was missed or displaced for longer than this and in more than half
#: of the manipulated frames: natural errors are short.
LASTING_S = 1.0


def switches(scores: Scores, switch_by: Texts, ego: str, scored: slice = slice(None)) -> dict[str, list[str]]:
    """The adversaries responsible for each identity switch of the picture ("centre") and of the ego's estimate ("ego").

    switch_by: those responsible for each of `scores.switches`
    scored:    the frames in which identity switches count, as in the summary of scores
    """
    counted = np.zeros(len(scores.frames), bool)
    counted[scored] = True
    rows, of = scores.every_series, scores.switches
    return {
        name: switch_by[(of.series == rows.get((ego, estimator), -1)) & counted[of.frame]].tolist()
        for name, estimator in (("centre", PICTURE), ("ego", MISSION))
    }


def summary(targets_: Manipulated, switched: Mapping[str, Sequence[str]], period_s: float) -> dict[str, dict[str, Any]]:
    """Results by adversary, and of ALL together; {} without adversaries.

    switched: see `switches`

    What ends in `…` is of the picture, `centre`, and of the ego's mission estimate, `ego`. A share is None if no object
    counts; docs/explanation-metrics-and-causes.md says what counts.

    Keys:
    inserted, hidden, moved, altered: number of objects
    inserted_frames, hidden_frames, moved_frames, altered_frames: in how many frames, summed over objects
    hidden_seen_by_others, moved_seen_by_others, altered_seen_by_others: 0 to 1, frames in which an agent without this
        adversary sees the object, too
    inserted_share_…: 0 to 1, objects that were accepted in any frame
    hidden_share_…, moved_share_…, altered_share_…: 0 to 1, objects that were missed, off or followed for long enough
    inserted_time_share_…, hidden_time_share_…, moved_time_share_…, altered_time_share_…: 0 to 1, frames in which it
        worked, of those with such objects
    inserted_s_…: s, mean time for which an accepted object was accepted
    moved_error_m_…, altered_error_m_…: m, mean distance from the truth to the track that follows the object
    success_…: whether any of this succeeded
    first_success_s_…: s, from the first manipulation to the first success
    id_switches_…: number of identity switches that it caused, in the scored frames
    """
    attacks, culprits = targets_.attacks, targets_.attacks.culprits
    if not culprits:
        return {}
    real = (attacks.kind == INSERTED) | (attacks.object >= 0)
    groups = {name: (real & (attacks.culprit == index)).nonzero()[0] for index, name in enumerate(culprits)}
    result = {}
    merged = _merge(targets_, real.nonzero()[0])
    by_name = {name: (targets_, rows) for name, rows in groups.items()} | {
        ALL: (merged, np.arange(len(merged.attacks)))
    }
    for name, (targets_of, rows) in by_name.items():
        result[name] = _results(targets_of, rows, period_s)
        for estimate_name, switch_by in switched.items():
            attributed = sum(by != "" if name == ALL else name in by.split("+") for by in switch_by)
            result[name][f"id_switches_{estimate_name}"] = attributed
    return result


def _merge(targets_: Manipulated, rows: Ints) -> Manipulated:
    """The targets in `rows`, merged if they have the same object and frame.

    Several adversaries may have manipulated the same object.
    A merged target is believed if any of its parts is; its error is the largest.
    """
    _, first, group = np.unique(
        np.column_stack([targets_.attacks.kind, targets_.attacks.object, targets_.attacks.frame])[rows],
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    believed = {name: np.bincount(group, values[rows], len(first)) > 0 for name, values in targets_.believed.items()}
    error = {name: np.full(len(first), np.nan) for name in targets_.error_m}
    for name, values in targets_.error_m.items():
        np.fmax.at(error[name], group, values[rows])
    first_rows = rows[first]
    return Manipulated(
        targets_.attacks.select(first_rows),
        believed,
        {name: values[first_rows] for name, values in targets_.judged.items()},
        error,
        targets_.by_others[first_rows],
    )


def _results(targets_: Manipulated, rows: Ints, period_s: float) -> dict[str, Any]:
    result: dict[str, Any] = {}
    attacks = targets_.attacks
    success = dict.fromkeys(targets_.believed, rows[:0])
    for kind_name, kinds in (
        ("inserted", (INSERTED,)),
        ("hidden", (REMOVED,)),
        ("moved", (MOVED,)),
        ("altered", (ALTERED,)),
    ):
        of_kind = rows[np.isin(attacks.kind[rows], kinds)]
        objects, object_row = np.unique(attacks.object[of_kind], return_inverse=True)
        result[kind_name] = len(objects)
        if not len(objects):
            continue
        result[f"{kind_name}_frames"] = len(of_kind)
        for estimate_name in targets_.believed:
            judged, believed = (
                targets_.judged[estimate_name][of_kind],
                (targets_.believed[estimate_name] & targets_.judged[estimate_name])[of_kind],
            )
            frames = np.bincount(object_row, believed, len(objects))
            judged_frames = np.bincount(object_row, judged, len(objects))
            if kind_name == "inserted":
                lasting = frames > 0
            else:
                lasting = (frames * period_s > LASTING_S - 1e-9) & (2 * frames > judged_frames)
            result[f"{kind_name}_share_{estimate_name}"] = (
                float(lasting[judged_frames > 0].mean()) if judged_frames.any() else None
            )
            result[f"{kind_name}_time_share_{estimate_name}"] = float(believed[judged].mean()) if judged.any() else None
            if kind_name == "inserted":
                result[f"inserted_s_{estimate_name}"] = (
                    float(frames[lasting].mean() * period_s) if lasting.any() else None
                )
            if kind_name in ("moved", "altered"):
                error = targets_.error_m[estimate_name][of_kind]
                finite = error[np.isfinite(error)]
                result[f"{kind_name}_error_m_{estimate_name}"] = float(finite.mean()) if len(finite) else None
            success[estimate_name] = np.concatenate([success[estimate_name], of_kind[believed & lasting[object_row]]])
        if kind_name != "inserted":
            result[f"{kind_name}_seen_by_others"] = float(targets_.by_others[of_kind].mean())
    for estimate_name, hits in success.items():
        result[f"success_{estimate_name}"] = bool(len(hits))
        delay_frames = attacks.frame[hits].min() - attacks.frame[rows].min() if len(hits) else None
        result[f"first_success_s_{estimate_name}"] = None if delay_frames is None else float(delay_frames * period_s)
    return result
