"""Achievements of adversaries, by plain loops over the tables and the truth."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Any, NamedTuple

from played import Played

RANGE_M, HIDDEN_M, MIN_MOVE_M, ACCEPTED_M, DISPLACED_M, LASTING_S, PERIOD_S = 100.0, 4.0, 0.5, 5.0, 1.0, 1.0, 0.1


class Target(NamedTuple):
    """An object manipulated in one frame; object: truth id, -1: none or inserted."""

    adversary: str
    kind: str
    frame: int
    object: int
    x: float
    y: float


class Verdict(NamedTuple):
    """Whether a manipulation succeeded and can be judged, and the track error, m."""

    believed: bool
    judged: bool
    error_m: float


class Run:
    """The tables of a run, by row."""

    def __init__(self, played: Played) -> None:
        self.truth = dict(played.bodies("scene/truth"))
        self.agents = list(self.truth[0]["agents"])
        self.attacks = rows(played.table("attacks"))
        self.boxes: dict[tuple[str, int], list[dict[str, Any]]] = defaultdict(list)
        same_as = played.metrics["same_as"]
        for row in rows(played.table("objects")):
            self.boxes[row["estimator"], row["frame"]].append(row)
            for twin, other in same_as.get(row["agent"], {}).items():
                if other == row["estimator"] and twin == "mission":
                    self.boxes[twin, row["frame"]].append(row)

    def targets(self) -> set[Target]:
        """Every object that an adversary, not a link, manipulated."""
        manipulated = set()
        for row in self.attacks:
            if row["role"] == "link":
                continue
            before, after = (row["before_x"], row["before_y"]), (row["after_x"], row["after_y"])
            kind, frame = row["effect"], row["frame"]
            if kind == "inserted":
                manipulated.add(Target(row["interposer"], kind, frame, -1, *after))
            elif kind in ("removed", "altered") or (kind == "moved" and math.dist(before, after) >= MIN_MOVE_M):
                place = before if kind == "removed" else after
                manipulated.add(Target(row["interposer"], kind, frame, self.nearest(frame, *before), *place))
        return manipulated

    def nearest(self, frame: int, x: float, y: float) -> int:
        """The nearest truth object within the gate."""
        body = self.truth[frame]
        apart = [
            (math.dist((x, y), place[:2]), int(id_)) for id_, place in zip(body["id"], body["position"], strict=True)
        ]
        best = min(apart, default=(math.inf, -1))
        return best[1] if best[0] <= HIDDEN_M else -1

    def verdict(self, target: Target, estimator: str, agents: list[str]) -> Verdict:
        """The achievements for one target in the estimates of some agents."""
        boxes = [row for row in self.boxes[estimator, target.frame] if row["agent"] in agents]
        if target.kind == "inserted":
            tracks = [row for row in boxes if row["kind"] == "track" and row["cause"] == "inserted"]
            near = any(math.dist((row["x"], row["y"]), (target.x, target.y)) <= ACCEPTED_M for row in tracks)
            places = self.truth[target.frame]["agent_position"]
            in_range = any(
                math.dist(places[self.agents.index(agent)][:2], (target.x, target.y)) <= RANGE_M for agent in agents
            )
            return Verdict(near, in_range, math.nan)
        matching = [row for row in boxes if row["kind"] == "truth" and row["id"] == target.object]
        matching = [row for row in matching if row["outcome"] != "unevaluated"]
        if not matching:
            return Verdict(False, False, math.nan)
        matched = [row for row in matching if row["outcome"] == "matched"]
        if (ghost := self.ghost(target, boxes, matching[0])) is not None:
            return Verdict(True, True, ghost)
        if not matched:
            return Verdict(True, True, math.nan)
        errors = [
            math.dist((row["x"], row["y"]), (track["x"], track["y"]))
            for row in matched
            for track in boxes
            if track["kind"] == "track" and track["agent"] == row["agent"] and track["id"] == row["match_id"]
        ]
        # The picture is the same for all agents.
        return Verdict(target.kind != "removed" and errors[0] > DISPLACED_M, True, errors[0])

    def ghost(self, target: Target, boxes: list[dict[str, Any]], truth: dict[str, Any]) -> float | None:
        """Distance, m, of the false track that follows a moved object; None: no track."""
        if target.kind != "moved":
            return None
        here, claimed = (truth["x"], truth["y"]), (target.x, target.y)
        others = [(each.x, each.y) for each in self.moved()[target.adversary, target.frame]]
        best: tuple[float, float] | None = None
        for row in boxes:
            at = row["x"], row["y"]
            if row["cause"] != "moved" or row["kind"] != "track" or target.adversary not in row["by"].split("+"):
                continue
            apart, off = math.dist(at, claimed), math.dist(at, here)
            follows = apart <= ACCEPTED_M and all(apart <= math.dist(at, other) for other in others)
            if follows and off > DISPLACED_M and apart < off and (best is None or apart < best[0]):
                best = apart, off
        return best and best[1]

    def moved(self) -> dict[tuple[str, int], list[Target]]:
        """The objects that each adversary moved, by frame."""
        if not hasattr(self, "_moved"):
            self._moved: dict[tuple[str, int], list[Target]] = defaultdict(list)
            for each in self.targets():
                if each.kind == "moved":
                    self._moved[each.adversary, each.frame].append(each)
        return self._moved


def rows(table: dict[str, Any]) -> list[dict[str, Any]]:
    """A table, row by row."""
    return [
        dict(zip(table, row, strict=True)) for row in zip(*(column.tolist() for column in table.values()), strict=True)
    ]


def summary(targets: list[dict[str, Any]], judge: str) -> dict[str, Any]:
    """Rows of targets.parquet summarised for an adversary, or all, by estimate."""
    result: dict[str, Any] = {}
    hits: list[int] = []
    real = [row for row in targets if row["kind"] == "inserted" or row["object"] >= 0]
    for what, kinds in (
        ("inserted", ("inserted",)),
        ("hidden", ("removed",)),
        ("moved", ("moved",)),
        ("altered", ("altered",)),
    ):
        by_object: dict[int, dict[tuple[str, int], dict[str, Any]]] = defaultdict(dict)
        for row in real:
            if row["kind"] in kinds:
                same = by_object[row["object"]].setdefault((row["kind"], row["frame"]), row)
                errors = [
                    each[f"error_m_{judge}"]
                    for each in (same, row)
                    if each[f"error_m_{judge}"] == each[f"error_m_{judge}"]
                ]
                by_object[row["object"]][row["kind"], row["frame"]] = same | {
                    f"believed_{judge}": same[f"believed_{judge}"] or row[f"believed_{judge}"],
                    f"error_m_{judge}": max(errors, default=math.nan),
                }
        result[what] = len(by_object)
        if not by_object:
            continue
        judged = [row for each in by_object.values() for row in each.values() if row[f"judged_{judge}"]]
        shares, lasting = [], []
        for each in by_object.values():
            possible = [row for row in each.values() if row[f"judged_{judge}"]]
            believed = [row for row in possible if row[f"believed_{judge}"]]
            success = bool(believed)
            if what != "inserted":
                success = round(len(believed) * PERIOD_S, 9) >= LASTING_S and 2 * len(believed) > len(possible)
            if possible:
                shares.append(success)
            if success:
                lasting.append(len(believed) * PERIOD_S)
                hits += [row["frame"] for row in believed]
        result[f"{what}_share_{judge}"] = sum(shares) / len(shares) if shares else None
        share = sum(row[f"believed_{judge}"] for row in judged) / len(judged) if judged else None
        result[f"{what}_time_share_{judge}"] = share
        if what == "inserted":
            result[f"inserted_s_{judge}"] = sum(lasting) / len(lasting) if lasting else None
        if what in ("moved", "altered"):
            known = [row[f"error_m_{judge}"] for each in by_object.values() for row in each.values()]
            known = [error for error in known if error == error]
            result[f"{what}_error_m_{judge}"] = sum(known) / len(known) if known else None
    result[f"success_{judge}"] = bool(hits)
    first = min((row["frame"] for row in real), default=0)
    result[f"first_success_s_{judge}"] = (min(hits) - first) * PERIOD_S if hits else None
    return result
