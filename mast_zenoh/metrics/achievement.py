"""Success of the adversaries: which of their manipulations were believed.

Also where, and for how long.

Pure; see docs/metrics.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.displacement import false_track_errors
from mast_zenoh.metrics.lookup import find
from mast_zenoh.metrics.manipulations import ALTERED, INSERTED, KINDS, MOVED, Manipulations
from mast_zenoh.metrics.places import Places, nearest
from mast_zenoh.metrics.record import MISSION, PICTURE, TruthTable
from mast_zenoh.metrics.scores import MATCHED, MISSED, UNEVALUATED, Scores, Table, Texts

#: m, maximum distance between an inserted object and its false track, as in `AttributionLimits.lie_m`.
ACCEPTED_M = 5.0
#: m; an object with a larger error of its estimate counts as displaced: half the gate of the metrics.
DISPLACED_M = 1.0


@dataclass(frozen=True, slots=True)
class Targets:
    """n objects that an adversary manipulated, each in one frame.

    Several passages of one adversary count once.

    adversary: (n,) row of `Manipulations.culprits`;  kind: (n,) index into KINDS
    frame, object: (n,), see Manipulations;  position: (n, 3) m, world frame, as manipulated, or before if hidden
    believed:  by estimate, (n,) bool: an inserted object is present, a hidden one is missed, a moved one is missed, off
               by more than DISPLACED_M, or has a false track at its manipulated position
    judged:    by estimate, (n,) bool: whether `believed` is defined: the object is in range and evaluated
    error_m:   by estimate, (n,) m, from the truth to the false track of a moved object, else to its matched track; NaN:
               none
    by_others: (n,) bool: an agent whose wires this adversary does not intercept sees the object; False for inserted
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
    manipulations: Manipulations,
    truth: TruthTable,
    agents: Sequence[str],
    ego: str,
    victims: dict[str, set[int]],
    range_m: float,
    min_points: int,
) -> Targets:
    """Evaluate every manipulated object in the picture and the ego's estimate.

    The ego's estimate is the mission-critical one.
    cause, by: of the rows of `scores.judged`
    truth:   of the frames of `scores`, of which `agents` are the columns
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
    for name, chosen in (("centre", picture), ("ego", mission)):
        scorers = [
            agents.index(agent) for (agent, _), is_chosen in zip(scores.series, chosen, strict=True) if is_chosen
        ]
        within = _in_range(attacks, truth.agent_position[:, scorers], scores.frames, range_m)
        believed[name], judged[name], error[name] = _judge(scores, cause, by, attacks, chosen, within)
    return Targets(
        attacks.culprit,
        attacks.kind,
        attacks.frame,
        attacks.object,
        attacks.position,
        believed,
        judged,
        error,
        _seen_by_others(attacks, truth, scores.frames, victims, min_points),
    )


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
    scores: Scores, cause: Ints, by: Texts, manipulations: Manipulations, chosen: Bools, within: Bools
) -> tuple[Bools, Bools, Floats]:
    """Whether manipulations are believed, whether that is defined, and the error m.

    A manipulation is believed if any of the series believes it.

    within: (n,) bool, whether it is in range of any agent of these series
    """
    judged, inside = scores.judged, chosen[scores.judged.series]
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
    false_track_error = false_track_errors(
        scores,
        inside & (cause == MOVED) & judged.is_track,
        by,
        manipulations,
        real_rows,
        row,
        near_m=ACCEPTED_M,
        off_m=DISPLACED_M,
    )
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
    manipulations: Manipulations, truth: TruthTable, frames: Ints, victims: dict[str, set[int]], min_points: int
) -> Bools:
    boxes = truth.boxes
    at = find((manipulations.object, manipulations.frame), (boxes.id, frames[boxes.group]))
    result = np.zeros(len(manipulations), bool)
    for index, name in enumerate(manipulations.culprits):
        free = [column for column in range(truth.points.shape[1]) if column not in victims.get(name, set())]
        rows = ((manipulations.culprit == index) & (manipulations.kind != INSERTED) & (at >= 0)).nonzero()[0]
        result[rows] = (truth.points[at[rows]][:, free] >= min_points).any(axis=1)
    return result
