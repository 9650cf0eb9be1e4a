"""The interposers of a run: where each sat, what it did by measurement, and whether its own reports agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mast_zenoh.control.failures import how_often
from mast_zenoh.report.runfolder import RunFolder, agent_of

#: Effects with a column of their own; all others are counted together.
EFFECTS = ("inserted", "removed", "moved", "altered", "delayed", "dropped", "repeated")
#: Verdicts that call for attention.
BAD = ("crashed", "failed", "silent", "disagrees")
#: Effects on objects, counted in rows: an object in a message. The others are counted in messages.
OF_OBJECTS = ("inserted", "removed", "moved", "altered")


@dataclass(frozen=True, slots=True)
class Interposer:
    """A node on wires.

    wires:    keys;  agents: on whose wires it sits;  before: agents before which alone it stands, on the picture's way
    live:     the frame from which on it was on its wire, if it was put there while the run went on
    released: the frame from which on it was not any more, if it was taken off
    effects:  what it did, by measurement: objects and messages by effect; None: not measured
    received: messages that came in; reports: changes that it reported; unreported: measured, and not reported;
              unfounded: reported, and not measured
    verdict:  "agrees", "silent", "disagrees", "nothing to report", "failed" (a handler), "crashed" (its process) or
              "not measured"
    failures: of its handlers, or how its process ended, in words; empty: none
    failed_frames: in how many frames a handler failed
    objects:  by effect of OF_OBJECTS, of how many objects of the scene the rows are, and whether some are of clutter;
              only where that is known of all rows
    """

    name: str
    role: str
    wires: tuple[str, ...]
    agents: tuple[str, ...] = ()
    before: tuple[str, ...] = ()
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

    @property
    def is_link(self) -> bool:
        """Whether it does what a network does; all others count as adversaries, whatever they call themselves."""
        return self.role == "link"

    @property
    def changed(self) -> int:
        """How many changes it made, by measurement."""
        return sum(count for name, count in (self.effects or {}).items() if name != "unsettled")

    @property
    def other(self) -> str:
        """Its further effects in words."""
        more = {name: n for name, n in (self.effects or {}).items() if name not in EFFECTS}
        return ", ".join(f"{count} {name}" for name, count in more.items())

    @property
    def reports_text(self) -> str:
        """What it reported, held against what was measured."""
        if not self.reports:
            return "nothing"
        contradictions = [f"{self.unreported} unreported"] * bool(self.unreported)
        contradictions += [f"{self.unfounded} unfounded"] * bool(self.unfounded)
        return str(self.reports) + (f" ({', '.join(contradictions)})" if contradictions else "")

    @property
    def place(self) -> str:
        """The wires that it sat on, and before whom alone."""
        before = f" before {', '.join(self.before)} alone" if self.before else ""
        return ", ".join(self.wires) + before

    @property
    def description(self) -> str:
        """Its name, and how it came where that is not from the start."""
        return f"{self.name} (inserted live in frame {self.live})" if self.live is not None else self.name


def interposers(run: RunFolder) -> tuple[Interposer, ...]:
    """Every interposer of a run, also those that came and went while it went on: adversaries first, then links."""
    wires: dict[str, dict[str, None]] = {}
    before: dict[str, dict[str, None]] = {}
    for wire in run.wiring.get("wires", []):
        for node in wire.get("interposers", ()):
            wires.setdefault(node, {})[wire["key"]] = None
        for leg in wire.get("legs", ()):
            if leg.get("before"):
                before.setdefault(leg["from"], {})[leg["before"]] = None
    measured = run.metrics.get("interposers", {})
    for node, summary in measured.items():
        wires.setdefault(node, {}).update(dict.fromkeys(summary.get("wires", ())))
    live: dict[str, int] = {}
    released: dict[str, int] = {}
    for done in run.run.get("interceptions", ()):
        node = done["node"]
        wires.setdefault(node, {}).update(dict.fromkeys(done.get("wires", ())))
        (live if done["action"] == "intercept" else released)[node] = done["frame"]
    result = []
    for node, keys in wires.items():
        crash, summary = _crash(run, node), measured.get(node, {})
        failed_frames = frames_of(failures_of(run.run.get("nodes", {}).get(node, {})))
        agents = dict.fromkeys(agent for agent in map(agent_of, keys) if agent)
        result.append(
            Interposer(
                name=node,
                role=run.role(node),
                wires=tuple(keys),
                agents=tuple(agents),
                before=tuple(before.get(node, ())),
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
            )
        )
    return tuple(sorted(result, key=lambda each: (each.is_link, not each.changed and not each.failures)))


def adversaries_by_agent(found: tuple[Interposer, ...]) -> dict[str, tuple[str, ...]]:
    """By agent, the interposers that are no links and sit on its wires, or before it on the picture's way."""
    result: dict[str, list[str]] = {}
    for each in found:
        for agent in () if each.is_link else (*each.agents, *each.before):
            result.setdefault(agent, []).append(each.name)
    return {agent: tuple(names) for agent, names in sorted(result.items())}


def _verdict(failed_frames: int, crash: str) -> str:
    """Of what did not end well; empty: nothing."""
    return "failed" if failed_frames else "crashed" if crash else ""


def _objects(run: RunFolder, node: str, effects: Mapping[str, int]) -> dict[str, tuple[int, bool]]:
    """By effect, of how many objects its rows are and whether some are of clutter, where each row is known."""
    if run.targets is None:
        return {}
    found = {}
    for effect in OF_OBJECTS:
        of = run.targets["object"][(run.targets["adversary"] == node) & (run.targets["kind"] == effect)]
        if len(of) and len(of) == effects.get(effect):
            real = of if effect == "inserted" else of[of >= 0]
            found[effect] = len(np.unique(real)), len(real) < len(of)
    return found


def frames_of(failures: Sequence[Mapping[str, Any]]) -> int:
    """In how many frames handlers failed, by the handler that failed in most."""
    return max((int(str(entry.get("frames", entry["count"]))) for entry in failures), default=0)


def _crash(run: RunFolder, node: str) -> str:
    """How handlers of a node failed or its process ended, in words; empty: well, or by the scenario or on request."""
    record = run.run.get("nodes", {}).get(node, {})
    entries = failures_of(record)
    if entries:
        first = entries[0]
        return f"{first['handler']} failed {how_often(first)}"
    if record.get("exit") and not exit_expected(record) and run.run.get("status") != "interrupted":
        return str(record.get("ended") or f"exit code {record['exit']}")
    return ""


def exit_expected(node: Mapping[str, Any]) -> bool:
    """Whether the scenario or a request ended a node of run.json; False if it crashed after a restart."""
    parts = str(node.get("ended")).split("; ")
    ends = parts if parts[-1] == "ok" else parts[-2:]
    return any(words in part for part in ends for words in ("by the scenario", "released", "told to leave"))


def failures_of(node: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The failed handlers of a node of run.json; of an older run, in which only their number was kept, without more."""
    failures = node.get("failures") or []
    if isinstance(failures, Mapping):
        unknown = "the exception is in the node's log, in a run of an older version"
        return [{"handler": name, "count": count, "exception": unknown} for name, count in failures.items()]
    return [dict(entry) for entry in failures]
