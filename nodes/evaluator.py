"""The evaluator: hears the truth and what everyone believes, and scores it when the run is over.

Nothing listens to it, so it can change nothing. What it returns becomes metrics.json and the tables of the run folder.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mast_zenoh.attacks import ACTIONS
from mast_zenoh.geometry import states_to_world
from mast_zenoh.links import FATES, WIRES
from mast_zenoh.metrics import (
    Attribution,
    Reach,
    Record,
    Scorer,
    cause_counts,
    down,
    split,
    stopped,
    time_to_first_false,
)
from mast_zenoh.metrics.record import PICTURE
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.runtime.process import main
from mast_zenoh.states import ObjectStates


class Evaluator(Node):
    """agents: their names; scorer: how to score; skip_first, skip_last: frames left out of the summary, because

    tracks need some frames to begin with (kept when they would be more than half of the run).
    """

    role = "evaluator"
    inputs = {
        "clock": "clock",
        "truth": "truth",
        "tracks": "tracks",
        "mission": "tracks",
        "picture": "picture",
        "reports": "attack_report",
        "link_reports": "link_report",
    }

    def __init__(self, agents: tuple[str, ...], scorer: Scorer, skip_first: int = 6, skip_last: int = 10) -> None:
        if skip_first < 0 or skip_last < 0:
            raise ValueError(f"skip_first, skip_last: found {skip_first}, {skip_last}, expected 0 or more")
        self.record = Record(agents)
        self.scorer = scorer
        self.reach = Reach()
        self.skip = (skip_first, skip_last)
        self.reports: dict[tuple[str, int], Received] = {}
        self.times_ns: dict[int, int] = {}
        self.pictured: dict[int, int] = {}  # frame of a picture: the step in which it was sent
        self.links: dict[tuple[str, int, int], Received] = {}
        self.presence: list[tuple[str, str, int, bool]] = []  # who came or went: node, role, first frame, whether up
        self.heard: dict[tuple[str, int], int] = {}  # agent and frame of its tracks: the frame in which they came

    def joined(self, node: str, role: str, context: Context) -> None:
        """A node is there from the next frame on."""
        self.presence.append((node, role, context.frame + 1, True))

    def left(self, node: str, role: str, context: Context) -> None:
        """A node is not there any more."""
        self.presence.append((node, role, context.frame + 1, False))

    def on_clock(self, received: Received, context: Context) -> None:
        """Nothing is due: scoring waits for the end, when even the latest message has come."""
        self.times_ns[received.frame] = received.time_ns

    def on_truth(self, received: Received, context: Context) -> None:
        """Where everything really is."""
        body = received.body
        objects = ObjectStates.of(
            body["position"], id=body["id"], size=body["size"], yaw=body["yaw"], velocity=body["velocity"]
        )
        self.record.add_truth(received.frame, objects, body["points"], body["agent_position"], body["agent_object"])

    def on_tracks(self, received: Received, context: Context) -> None:
        """What an agent's own sensors tell it, as the agent says it: what links do on the way is not in it."""
        self.heard.setdefault((received.subject, received.frame), context.frame)
        body = received.body
        states = states_to_world(ObjectStates.from_columns(body), body["origin"], body["rotation"])
        self.record.add_tracks(received.frame, received.subject, "local", states)

    def on_mission(self, received: Received, context: Context) -> None:
        """What an agent believes with the help of the picture."""
        self.record.add_tracks(received.frame, received.subject, "mission", ObjectStates.from_columns(received.body))

    def on_picture(self, received: Received, context: Context) -> None:
        """The common picture, and when it was sent."""
        self.record.add_picture(received.frame, ObjectStates.from_columns(received.body))
        self.pictured.setdefault(received.frame, received.step)

    def on_reports(self, received: Received, context: Context) -> None:
        """What an adversary has changed."""
        self.reports[received.subject, received.frame] = received

    def on_link_reports(self, received: Received, context: Context) -> None:
        """What a link has done to messages in the step before."""
        self.links[received.subject, received.frame, received.message.header.seq] = received

    def finish(self, context: Context) -> dict[str, Any]:
        """The metrics and the tables of the run."""
        scores = self.scorer.score(self.record)
        frames = len(scores.frames)
        first, last = self.skip if sum(self.skip) <= frames // 2 else (0, 0)
        scored = slice(first, frames - last)
        times = self.times_ns
        attacks, links = self.attacks(), self.link_reports()
        period_s = (times[1] - times[0]) * 1e-9 if {0, 1} <= times.keys() else 0.1
        table = self.record.truth(scores.frames)
        absent, unheard = self.absence(scores.frames, period_s)
        silent = absent | stopped(links, self.record.agents, scores.frames)
        severed = self.reach.severed(
            scores.objects, table, self.record.agents, scores.frames, period_s, silent, unheard, self.scorer.min_points
        )
        truth = table.boxes.in_group(scores.frames[table.boxes.group])
        objects = dict(scores.objects)
        objects["cause"], objects["by"] = Attribution().label(objects, attacks, truth, period_s, severed)
        summary = scores.summary(scored)
        for agent, causes in cause_counts(objects, list(summary), scores.frames[scored]).items():
            if PICTURE in summary[agent]:
                told = {f"{what}_split": split(causes[what], len(scores.frames[scored])) for what in ("fn", "fp")}
                summary[agent][PICTURE] |= {"causes": causes, **told}
        latency = [times[step] - times[f] for f, step in sorted(self.pictured.items()) if {f, step} <= times.keys()]
        return {
            "metrics": {
                "frames": frames,
                "scored_frames": [int(frame) for frame in scores.frames[scored][[0, -1]]] if frames else [],
                "agents": summary,
                "time_to_first_false_s": time_to_first_false(objects, attacks, period_s),
                "latency_ms": {"sim_to_picture": percentiles(np.array(latency) * 1e-6)},
                "frames_per_second": 1e9 / times[1] if {0, 1} <= times.keys() else None,
            },
            "tables": {"metrics": scores.per_frame(), "objects": objects, "attacks": attacks}
            | ({"links": links} if self.links else {}),
        }

    def absence(self, frames: np.ndarray, period_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Of f frames and a agents, (f, a) bool each: who is not there, and whose tracks did not come in time."""
        agents = self.record.agents
        columns = zip(*self.presence, strict=True) if self.presence else ((),) * 4
        kinds = {"node": object, "role": object, "frame": np.int64, "up": bool}
        presence = {name: np.array(column, kind) for (name, kind), column in zip(kinds.items(), columns, strict=True)}
        within = self.reach.aged_s / period_s + 1e-6
        heard = [[self.heard.get((agent, f), np.inf) - f <= within for agent in agents] for f in frames.tolist()]
        unheard = ~np.array(heard, bool).reshape(len(frames), len(agents))
        return down(presence, agents, frames), unheard

    def link_reports(self) -> dict[str, np.ndarray]:
        """All reports of links as one table, a row per message that was not simply delivered."""
        order = sorted(self.links)
        bodies = [self.links[key].body for key in order]
        link = np.repeat(np.array([name for name, _, _ in order], object), [len(body["fate"]) for body in bodies])

        def column(name: str, kind: Any = np.int64) -> np.ndarray:
            return np.concatenate([np.zeros(0, kind), *(body[name] for body in bodies)]).astype(kind)

        def named(name: str, names: tuple[str, ...]) -> np.ndarray:
            return np.array([*names, "other"], object)[np.minimum(column(name), len(names))]

        return {
            "link": link,
            "agent": np.array([name.removeprefix("link_") for name in link], object),
            "port": named("port", WIRES),
            **{name: column(name) for name in ("frame", "seq")},
            "fate": named("fate", FATES),
            "rule": column("rule"),
            "delay_s": column("delay_s", np.float64),
        }

    def attacks(self) -> dict[str, np.ndarray]:
        """All reports of adversaries as one table, a row per object changed."""
        order = sorted(self.reports)
        bodies = [self.reports[key].body for key in order]
        counts = [len(body["action"]) for body in bodies]

        def column(name: str, shape: tuple[int, ...] = (0,)) -> np.ndarray:
            return np.concatenate([np.zeros(shape), *(body[name] for body in bodies)])

        before, after, velocity = (column(n, (0, 3)) for n in ("before_position", "after_position", "velocity"))
        return {
            "adversary": np.repeat(np.array([name for name, _ in order], dtype=object), counts),
            "frame": np.repeat(np.array([frame for _, frame in order], np.int64), counts),
            "action": np.array(ACTIONS, dtype=object)[column("action").astype(np.int64)],
            "target": column("target").astype(np.int64),
            **{f"before_{axis}": before[:, i] for i, axis in enumerate("xyz")},
            **{f"after_{axis}": after[:, i] for i, axis in enumerate("xyz")},
            **{f"v{axis}": velocity[:, i] for i, axis in enumerate("xyz")},
        }


def percentiles(latency_ms: np.ndarray) -> dict[str, float | None]:
    """p50, p95 and p99 of (n,) latencies; None of none."""
    if len(latency_ms) == 0:
        return {"p50": None, "p95": None, "p99": None}
    return {f"p{p}": float(np.percentile(latency_ms, p)) for p in (50, 95, 99)}


if __name__ == "__main__":
    main(Evaluator)
