"""The interposers and nodes of a run: wires, measured effects, agreement of reports, failures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mast_zenoh.mesh.control import failures
from mast_zenoh.mesh.control.failures import how_often
from mast_zenoh.runs.run import Run, agent_in_key

#: Effects with their own column; all others share one.
WITH_COLUMN = ("inserted", "removed", "moved", "altered", "delayed", "dropped", "repeated")
#: Verdicts that need attention.
BAD = ("crashed", "failed", "silent", "disagrees")
#: Effects on objects, counted in rows: an object in a message. The others are counted in messages.
OF_OBJECTS = ("inserted", "removed", "moved", "altered")


@dataclass(frozen=True, slots=True)
class Interposer:
    """A node on wires.

    wires:    keys;  agents: owners of these wires;  before: subscribers whose copy of a message alone passes through it
    partly:   those of its wires of which other subscribers receive messages that do not pass through it
    live:     first frame on its wire, if inserted during the run
    released: first frame after its removal, if removed during the run
    effects:  measured number of objects or messages by effect; None: not measured
    received: incoming messages; reports: changes that it reported; unreported: measured but not reported;
              unfounded: reported but not measured
    verdict:  "agrees", "silent", "disagrees", "nothing to report", "failed" (a handler), "crashed" (its process) or
              "not measured"
    failures: of its handlers, or how its process ended, in words; empty: none
    failed_frames: number of frames in which a handler failed
    objects:  by effect of OF_OBJECTS, number of scene objects in its rows, and whether some rows are clutter; only
              where this is known for all rows
    reframed: how many of its reframed messages are of a type with words of its own: view, what an agent says it sees,
              command, what a driver tells its car, or scan, the points of a lidar
    points:   by effect, number of points of a lidar that make up the objects of its rows
    """

    name: str
    role: str
    wires: tuple[str, ...]
    agents: tuple[str, ...] = ()
    before: tuple[str, ...] = ()
    partly: tuple[str, ...] = ()
    live: int | None = None
    released: int | None = None
    effects: Mapping[str, int] | None = None
    received: int | None = None
    reports: int = 0
    unreported: int = 0
    unfounded: int = 0
    verdict: str = "not measured"
    failures: str = ""
    failed_frames: int = 0
    objects: Mapping[str, tuple[int, bool]] = field(default_factory=dict)
    reframed: Mapping[str, int] = field(default_factory=dict)
    points: Mapping[str, int] = field(default_factory=dict)

    @property
    def is_link(self) -> bool:
        """Whether it models the network; all other interposers count as adversaries."""
        return self.role == "link"

    @property
    def effects_besides_named(self) -> dict[str, int]:
        """The measured effects, without those of `reframed`."""
        effects = dict(self.effects or {})
        if self.reframed:
            effects["reframed"] -= sum(self.reframed.values())
        return effects

    @property
    def changed(self) -> int:
        """The measured number of its changes."""
        return sum(count for name, count in (self.effects or {}).items() if name != "unsettled")

    @property
    def other(self) -> str:
        """Effects that are not in WITH_COLUMN, in words."""
        more = {name: n for name, n in self.effects_besides_named.items() if name not in WITH_COLUMN}
        more |= {f"{message}s changed": count for message, count in self.reframed.items()}
        return ", ".join(f"{count} {name}" for name, count in more.items() if count)

    @property
    def reports_text(self) -> str:
        """The number of its reports, with contradictions to measurements."""
        if not self.reports:
            return "nothing"
        contradictions = [f"{self.unreported} unreported"] * bool(self.unreported)
        contradictions += [f"{self.unfounded} unfounded"] * bool(self.unfounded)
        return str(self.reports) + (f" ({', '.join(contradictions)})" if contradictions else "")

    @property
    def place(self) -> str:
        """Its wires, and the subscribers that it serves, if not all."""
        whole = ", ".join(each for each in self.wires if each not in self.partly)
        partly = f"{', '.join(self.partly)} only before {', '.join(self.before)}" if self.before else ""
        return "; ".join(filter(None, (whole, partly)))

    @property
    def description(self) -> str:
        """Its name, and its frames if inserted live."""
        if self.live is None:
            return self.name
        frames = f"frame {self.live}" if self.released is None else f"frames {self.live} to {self.released - 1}"
        return f"{self.name} (inserted live in {frames})"


def interposers(run: Run) -> tuple[Interposer, ...]:
    """Every interposer of a run, including live ones: adversaries first, then links."""
    wires: dict[str, dict[str, None]] = {}
    before: dict[str, dict[str, None]] = {}
    partly: dict[str, dict[str, None]] = {}
    for wire in run.files.wiring.get("wires", []):
        for node in wire.get("interposers", ()):
            wires.setdefault(node, {})[wire["key"]] = None
        for leg in wire.get("legs", ()):
            if leg.get("before", wire.get("subject")) != wire.get("subject"):  # nobody else needs an agent's own wire
                before.setdefault(leg["from"], {})[leg["before"]] = None
                partly.setdefault(leg["from"], {})[wire["key"]] = None
    measured = run.files.summary.get("interposers", {})
    for node, summary in measured.items():
        wires.setdefault(node, {}).update(dict.fromkeys(summary.get("wires", ())))
    live: dict[str, int] = {}
    released: dict[str, int] = {}
    for event in run.files.record.get("interceptions", ()):
        node = event["node"]
        wires.setdefault(node, {}).update(dict.fromkeys(event.get("wires", ())))
        if event.get("before"):
            before.setdefault(node, {})[event["before"]] = None
            partly.setdefault(node, {}).update(dict.fromkeys(event.get("wires", ())))
        (live if event["action"] == "intercept" else released)[node] = event["frame"]
    result = []
    for node, keys in wires.items():
        crash, summary = _crash(run, node), measured.get(node, {})
        failed_frames = n_failed_frames(failures_of(run.files.record.get("nodes", {}).get(node, {})))
        agents = dict.fromkeys(agent for agent in map(agent_in_key, keys) if agent)
        result.append(
            Interposer(
                name=node,
                role=run.role(node),
                wires=tuple(keys),
                agents=tuple(agents),
                before=tuple(before.get(node, ())),
                partly=tuple(partly.get(node, ())),
                live=live.get(node),
                released=released.get(node),
                effects=summary.get("effects"),
                received=summary.get("messages"),
                reports=summary.get("reports", 0),
                unreported=summary.get("unreported", 0),
                unfounded=summary.get("unfounded", 0),
                verdict=_verdict(failed_frames, crash) or summary.get("agreement", "not measured"),
                failures=crash,
                failed_frames=failed_frames,
                objects=_objects(run, node, summary.get("effects") or {}),
                reframed=_reframed(run, node, summary.get("effects") or {}),
                points=_points(run, node),
            )
        )
    return tuple(sorted(result, key=lambda each: (each.is_link, not each.changed and not each.failures)))


def hostile(run: Run) -> list[Interposer]:
    """The interposers that do not model the network."""
    return [each for each in interposers(run) if not each.is_link]


def adversaries_by_agent(all_interposers: tuple[Interposer, ...]) -> dict[str, tuple[str, ...]]:
    """Adversaries by the agent on whose wires, or before which, they sit."""
    result: dict[str, list[str]] = {}
    for each in all_interposers:
        for agent in () if each.is_link else (*each.agents, *each.before):
            result.setdefault(agent, []).append(each.name)
    return {agent: tuple(names) for agent, names in sorted(result.items())}


def attacked_at(all_interposers: tuple[Interposer, ...], frame: int) -> set[str]:
    """The agents on whose wires, or before which, an adversary sits in a frame."""
    present = [
        each
        for each in all_interposers
        if (each.live is None or each.live <= frame) and (each.released is None or frame < each.released)
    ]
    return set(adversaries_by_agent(tuple(present)))


def _verdict(failed_frames: int, crash: str) -> str:
    """The verdict on failures; empty: none."""
    return "failed" if failed_frames else "crashed" if crash else ""


def _objects(run: Run, node: str, effects: Mapping[str, int]) -> dict[str, tuple[int, bool]]:
    """Number of objects and presence of clutter by effect, where every row is known."""
    targets = run.files.targets
    if targets is None:
        return {}
    objects = {}
    for effect in OF_OBJECTS:
        ids = targets["object"][(targets["adversary"] == node) & (targets["kind"] == effect)]
        if len(ids) and len(ids) == effects.get(effect):
            real = ids if effect == "inserted" else ids[ids >= 0]
            objects[effect] = len(np.unique(real)), len(real) < len(ids)
    return objects


def _reframed(run: Run, node: str, effects: Mapping[str, int]) -> dict[str, int]:
    """How many of the messages that a node reframed are views, commands or scans; at most as many as it reframed."""
    table, left, result = run.manipulations, effects.get("reframed", 0), {}
    if table is None or not left:
        return {}
    changed = table["message"][(table["interposer"] == node) & (table["effect"] == "reframed")]
    for message, name in {"view": "view", "command": "command", "points": "scan"}.items():
        if number := min(int((changed == message).sum()), left):
            result[name] = number
            left -= number
    return result


def _points(run: Run, node: str) -> dict[str, int]:
    """How many points a node inserted and removed, by effect; none of a run from before they were counted."""
    table = run.manipulations
    if table is None or "points" not in table:
        return {}
    rows = (table["interposer"] == node) & (table["points"] > 0)
    return {
        effect: int(table["points"][rows & (table["effect"] == effect)].sum())
        for effect in sorted(set(table["effect"][rows].tolist()))
    }


def n_failed_frames(failures: Sequence[Mapping[str, Any]]) -> int:
    """Number of frames with failures of the handler that failed most often."""
    return max((int(entry.get("frames", entry["count"])) for entry in failures), default=0)


def _crash(run: Run, node: str) -> str:
    """How a node's handlers or process failed, in words; empty: as expected."""
    record = run.files.record.get("nodes", {}).get(node, {})
    failures = failures_of(record)
    if failures:
        first = failures[0]
        return f"{first['handler']} failed {how_often(first)}"
    if record.get("exit") and not exit_expected(record) and run.files.record.get("status") != "interrupted":
        return str(record.get("ended") or f"exit code {record['exit']}")
    return ""


def exit_expected(node: Mapping[str, Any]) -> bool:
    """Whether a node ended by scenario or request, without a crash after restart."""
    parts = str(node.get("ended")).split("; ")
    endings = parts if parts[-1] == "ok" else parts[-2:]
    return any(words in part for part in endings for words in ("by the scenario", "released", "told to leave"))


def failures_of(node: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The failed handlers of a node of run.json."""
    return [dict(entry) for entry in node.get("failures") or []]


def node_row(run: Run, name: str) -> dict[str, Any]:
    """What run.json says about a node, for a row of the table."""
    record = run.files.record["nodes"][name]
    return {key: record.get(key) for key in ("pid", "exit", "restarts")} | {
        "role": run.role(name),
        "ended": record.get("ended") or "not known",
        "bad": record.get("ended") != "ok" and not exit_expected(record),
        "last_frame": record.get("last_frame"),
        "troubles": _troubles(record),
    }


def failure_lines(run: Run) -> list[str]:
    """A line for each handler that failed."""
    nodes = run.files.record.get("nodes", {})
    failed = {name: failures_of(node) for name, node in nodes.items()}
    return failures.lines(failed, {name: nodes[name].get("log") or "not written" for name in failed})


def _troubles(record: Mapping[str, Any]) -> str:
    """Rejected messages and handler failures of a node; empty: none."""
    refused, foreign = (sum((record.get(key) or {}).values()) for key in ("rejected", "foreign"))
    counts = (
        (refused, "messages rejected"),
        (foreign, "messages from outside the run"),
        (sum(entry["count"] for entry in failures_of(record)), "handler failures"),
    )
    return ", ".join(f"{number} {label}" for number, label in counts if number)


def all_wires(run: Run) -> list[dict[str, Any]]:
    """The final wires of wiring.json, with interposers that were removed earlier."""
    wires = {wire["key"]: wire for wire in run.files.wiring.get("wires", [])}
    for each in interposers(run):
        for key in each.wires if each.live is not None else ():
            wire = wires.get(key)
            if wire is not None and each.name not in wire.get("interposers", ()):
                wires[key] = _with_interposer(wire, each.name, each.before[0] if each.before else "")
    return list(wires.values())


def _with_interposer(wire: dict[str, Any], node: str, before: str) -> dict[str, Any]:
    """A wire with another interposer at the end of its trunk, or of the branch of the subscriber `before`.

    Its key is not known.
    """
    legs = list(wire.get("legs", ()))
    ends = [i for i, leg in enumerate(legs) if (leg.get("before") == before if before else leg["key"] == wire["key"])]
    index = ends[-1] if ends else None
    if index is not None:
        last = legs[index]
        legs[index : index + 1] = [{**last, "key": "", "to": [node]}, {**last, "from": node}]
    return {**wire, "legs": legs, "interposers": [*wire.get("interposers", ()), node]}
