"""The causes of errors, by plain loops over a run's tables and the truth."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Any

from achievement_oracle import Run, rows
from played import Played

ATTACKS = ("inserted", "removed", "moved", "altered")
COAST, FRESH = 40, 10  # frames: 4 s and 1 s
LIE_M, OBJECT_M, ASTRAY_M = 2.0, 3.0, 6.0
MIN_POINTS = 5
DOWNLINK = ("picture_received", "picture_on_arrival", "mission")
Row = dict[str, Any]


def reaches(attack: Row, agent: str, estimator: str) -> bool:
    """Whether an interposer on a wire can affect an estimate of an agent."""
    own = attack["wire"].split("/")[1] == agent
    if attack["message"] == "detections":
        return own or estimator in ("picture", *DOWNLINK)
    if attack["message"] == "tracks":
        return (own and estimator == "received") or estimator in ("picture", *DOWNLINK)
    assert attack["message"] == "picture"
    return estimator in DOWNLINK and attack["before_subscriber"] in ("", agent)


def apart(a: Row, b: Row) -> float:
    return math.dist((a["x"], a["y"]), (b["x"], b["y"]))


class Causes:
    """The rows of a run by series and frame, and the expected cause of each."""

    def __init__(self, played: Played) -> None:
        self.run = Run(played)
        self.rows = rows(played.table("objects"))
        self.at: dict[tuple[str, str, int], list[Row]] = defaultdict(list)
        self.of: dict[tuple[str, str, str, int], dict[int, Row]] = defaultdict(dict)
        for row in self.rows:
            self.at[row["agent"], row["estimator"], row["frame"]].append(row)
            self.of[row["agent"], row["estimator"], row["kind"], row["id"]][row["frame"]] = row
        self.local = {
            agent: played.metrics["same_as"].get(agent, {}).get("local", "local") for agent in self.run.agents
        }
        self.arrived = {
            agent: played.metrics["same_as"].get(agent, {}).get("received", "received") for agent in self.run.agents
        }
        self.attacks = [row for row in self.run.attacks if row["role"] != "link" and row["effect"] in ATTACKS]
        self.hiding: dict[int, list[Row]] = defaultdict(list)
        self.showing: dict[int, list[Row]] = defaultdict(list)
        for attack in self.attacks:
            before, after = (attack["before_x"], attack["before_y"]), (attack["after_x"], attack["after_y"])
            attack["object"] = -1
            small = attack["effect"] == "moved" and math.dist(before, after) < 0.5
            if attack["effect"] != "inserted" and not small:
                attack["object"] = self.run.nearest(attack["frame"], *before)
            if attack["effect"] in ("inserted", "moved") and not small:
                self.showing[attack["frame"]].append(attack)
            if attack["object"] >= 0:
                self.hiding[attack["object"]].append(attack)

    def hidden(self, row: Row) -> dict[str, set[str]]:
        """Adversaries that manipulated a missed object in the last second, by kind."""
        by_kind: dict[str, set[str]] = defaultdict(set)
        central = row["estimator"] not in ("local", "received")
        for attack in self.hiding[row["id"]]:
            late = row["frame"] - attack["frame"]
            if attack["effect"] == "removed" and attack["message"] != "picture" and central and self.received(row):
                continue
            if attack["effect"] == "removed" and attack["message"] == "detections" and not self.would_track(attack):
                continue
            if 0 <= late <= FRESH and reaches(attack, row["agent"], row["estimator"]):
                by_kind[attack["effect"]].add(attack["interposer"])
        return by_kind

    def received(self, row: Row) -> bool:
        """Whether the broker received a good track of a truth object from some agent."""
        return any(
            self.of[agent, self.arrived[agent], "truth", row["id"]].get(row["frame"], {}).get("outcome") == "matched"
            for agent in self.run.agents
        )

    def would_track(self, attack: Row) -> bool:
        """Whether an agent would have a track of an object of which a detection was removed."""
        agent = self.run.agents.index(attack["wire"].split("/")[1])
        seen = 0
        for frame in range(attack["frame"] - FRESH + 1, attack["frame"] + 1):
            body = self.run.truth.get(frame)
            ids = [] if body is None else body["id"].tolist()
            seen += attack["object"] in ids and body["points"][ids.index(attack["object"]), agent] >= MIN_POINTS
        removed = {
            other["frame"]
            for other in self.hiding[attack["object"]]
            if other["wire"] == attack["wire"] and other["effect"] == "removed"
        }
        recent = range(attack["frame"] - 2 * FRESH + 1, attack["frame"] + 1)
        return seen >= 0.8 * FRESH and len(removed.intersection(recent)) >= 3

    def genuine(self, row: Row) -> bool:
        """Whether an agent has a false track there without an attack, and this is another estimate."""
        return row["estimator"] != "local" and any(
            other["outcome"] == "false" and other["cause"] not in ATTACKS and apart(other, row) <= LIE_M
            for agent in self.run.agents
            for other in self.at[agent, self.local[agent], row["frame"]]
        )

    def shown(self, row: Row) -> bool:
        """Whether an adversary inserted an object at a false track, in its frame."""
        return not self.genuine(row) and any(
            math.dist((attack["after_x"], attack["after_y"]), (row["x"], row["y"])) <= LIE_M
            and reaches(attack, row["agent"], row["estimator"])
            for attack in self.showing[row["frame"]]
        )

    def active(self, row: Row) -> set[str]:
        """The interposers that may have caused an error in the last 8 s."""
        return {
            attack["interposer"]
            for attack in self.attacks
            if 0 <= row["frame"] - attack["frame"] <= 2 * COAST and reaches(attack, row["agent"], row["estimator"])
        }

    def natural_track(self, row: Row) -> str:
        """The cause of a false track without an inserted object."""
        now = self.at[row["agent"], row["estimator"], row["frame"]]
        truths = [other for other in now if other["kind"] == "truth"]
        near = [other for other in truths if apart(other, row) <= ASTRAY_M]
        if any(other["outcome"] == "missed" for other in near):
            return "lag"
        if any(other["outcome"] == "matched" and apart(other, row) <= OBJECT_M for other in near):
            return "duplicate"
        body = self.run.truth[row["frame"]]
        if any(math.dist(place[:2], (row["x"], row["y"])) <= OBJECT_M for place in body["position"]):
            return "occlusion or range"
        last = self.last_match(row)
        if last is None:
            return "clutter"
        exists = last in body["id"].tolist()
        evaluated = any(other["id"] == last and other["outcome"] != "unevaluated" for other in truths)
        return "occlusion or range" if exists and not evaluated else "lag"

    def last_match(self, row: Row) -> int | None:
        """The last match of a track or object within 4 s."""
        history = self.of[row["agent"], row["estimator"], row["kind"], row["id"]]
        for frame in range(row["frame"], row["frame"] - COAST - 1, -1):
            if frame in history and history[frame]["outcome"] == "matched":
                return history[frame]["match_id"]
        return None

    def natural_miss(self, row: Row) -> str:
        """The cause of a missed object that was not hidden."""
        history = self.of[row["agent"], row["estimator"], "truth", row["id"]]
        begun = row["frame"]
        while begun - 1 in history and history[begun - 1]["outcome"] != "unevaluated":
            begun -= 1
        if row["frame"] - begun < FRESH:
            return "lag"
        now = self.at[row["agent"], row["estimator"], row["frame"]]
        strays = [o for o in now if o["outcome"] == "false" and o["cause"] in ("lag", "link or fault")]
        if any(apart(stray, row) <= ASTRAY_M for stray in strays):
            return "lag"
        own = row["estimator"] in ("local", "received")
        if own:
            body = self.run.truth[row["frame"]]
            points = body["points"][body["id"].tolist().index(row["id"]), self.run.agents.index(row["agent"])]
            return "tracking" if points >= MIN_POINTS else "occlusion or range"
        by_any = any(
            self.of[agent, self.local[agent], "truth", row["id"]].get(row["frame"], {}).get("outcome") == "matched"
            for agent in self.run.agents
        )
        return "fusion" if by_any else "occlusion or range"
