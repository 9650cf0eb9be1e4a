"""What happens in a run: attacks, faults, absences, lies and suspensions over time, and each event in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.trust import AgentTrustSeries, Spans
from mast_zenoh.run_folder.finding import Finding, sentence
from mast_zenoh.run_folder.recording.churn import LOST
from mast_zenoh.runs.files import Table, boxes_of, column, rows
from mast_zenoh.runs.run import Run, agent_in_key

#: Manipulations that have a place.
PLACED = ("inserted", "removed", "moved")
#: Faults that separate agents from the command centre.
PARTITIONS = ("Partition", "HostPartition")


class Happening(NamedTuple):
    """Something that happened.

    frame: when;  kind: attack, fault, interception, suspension, undecided, effect, brake or collision;  text: in words
    x, y:  m, where, if it has a place
    """

    frame: int
    kind: str
    text: str
    x: float | None = None
    y: float | None = None


def happenings(run: Run, periods: list[dict[str, Any]], times: Floats) -> list[Happening]:
    """Beginnings and ends of periods and of nodes' absences, in any order; periods, times: as for `spans`."""
    result = []
    for each in periods:
        for at, words in ((each["from_s"], each["begins"]), (each["until_s"], each["ends"])):
            frame = int(np.searchsorted(times, at - 1e-6))
            if words and frame < len(times):
                result.append(Happening(frame, each["kind"], words))
    for node, start, end in node_absences(run):
        result.append(Happening(int(start), "fault", event(node, "down")))
        if end < len(times):
            result.append(Happening(int(end), "fault", event(node, "back")))
    return result


def event(who: str, what: str, where: str = "", cause: str = "", whom: str = "") -> str:
    """Something that happened, in the words of its phrase. whom: the agent or car to which it happened"""
    every = (who, whom) if whom else (who,)
    return sentence(Finding("event", every, what, where=where, cause=(cause,) if cause else ()))


def first_changes(run: Run) -> list[Happening]:
    """The first manipulation of each kind by each adversary."""
    table, result = run.manipulations, []
    if table is None:
        return []
    for name in np.unique(table["interposer"].astype(str)).tolist():
        for effect in np.unique(table["effect"][table["interposer"] == name].astype(str)).tolist():
            own = rows(table, (table["interposer"] == name) & (table["effect"] == effect))
            first = int(np.argmin(own["frame"]))
            when = "before" if effect == "removed" else "after"
            x, y = (float(own[f"{when}_{axis}"][first]) for axis in "xy")
            place = (round(x, 2), round(y, 2)) if effect in PLACED and np.isfinite([x, y]).all() else (None, None)
            agent = agent_in_key(str(own["wire"][first])) or ""
            kind = str(own["message"][first]) if effect == "reframed" else effect
            what = kind if kind in (*PLACED, "view", "command", "points") else "changed"
            text = event(name, what, cause=effect, whom=agent)
            result.append(Happening(int(own["frame"][first]), "effect", text, *place))
    return result


def spans(run: Run, times: Floats) -> list[dict[str, Any]]:
    """Attacks, faults, interceptions, suspensions and undecided states as periods.

    Each has label, kind, from_s, until_s (within the run, s), nodes, and `begins` and `ends`, what to say when it does;
    faults of links also `cut` or `impaired`, the agents whose link to the command centre is. Nothing is said of nodes
    that are lost: `node_absences` has them.
    """
    end = float(times[-1]) + run.period_s if len(times) else 0.0
    result: list[dict[str, Any]] = []

    def add(
        label: str, kind: str, start: float, until: float | None, nodes: Iterable[str], begins: str = "", ends: str = ""
    ) -> None:
        if start < end:
            until = end if until is None else min(until, end)
            period = {"from_s": round(start, 3), "until_s": round(until, 3), "begins": begins, "ends": ends}
            result.append({"label": label, "kind": kind, **period, "nodes": list(nodes)})

    for each in run.timeline:
        kind = "attack" if each["kind"] == "attack" else "fault"
        before, label = len(result), str(each["label"])
        words = event(label, "begins"), event(label, "ends" if kind == "attack" else "heals")
        add(label, kind, float(each["at_s"]), each.get("until_s"), each.get("nodes") or (), *words)
        if result[before:] and kind == "fault":
            result[-1] |= _affected_links(run, each)
    for node, start, until in absences(run):
        add(f"{node} lost", "fault", start * run.period_s, until * run.period_s, [node])
    opened: dict[str, dict[str, Any]] = {}
    for step in run.files.record.get("interceptions", ()):
        at, node = second(times, int(step["frame"])), step["node"]
        wires = ", ".join(step["wires"])
        if step["action"] == "intercept":
            words = event(node, "intercepts", wires), event(node, "left", wires, "removed")
            add(f"{node} inserted live", "interception", at, None, [node], *words)
            opened[node] = result[-1]
        elif node in opened:
            how = "released" if step["action"] == "release" else "cut off"
            opened.pop(node).update(until_s=round(at, 3), ends=event(node, "left", wires, how))
    for each in suspensions(run):
        agent, period = each["agent"], (float(each["from_s"]), each["until_s"])
        words = event(agent, "suspended"), event(agent, "not suspended")
        add(f"{agent} suspended", "suspension", *period, [agent], *words)
    for each in doubts(run):
        agent, period = each["agent"], (float(each["from_s"]), each["until_s"])
        words = event(agent, "undecided", cause=each["reason"] or ""), event(agent, "decided")
        add(f"{agent} undecided", "undecided", *period, [agent], *words)
    for each in result:
        each |= {name: run.worded(each[name]) for name in ("begins", "ends")}
    return sorted(result, key=lambda each: (each["from_s"], each["label"]))


def _affected_links(run: Run, fault: dict[str, Any]) -> dict[str, list[str]]:
    """The agents whose link to the command centre a fault cuts or impairs; {}: none, or a fault of processes."""
    if fault.get("backend") not in ("links", "network"):
        return {}
    agents = list(run.files.scene.agent_names) if run.files.scene else list(run.files.summary.get("agents", ()))
    nodes = fault.get("nodes") or ()
    # A partition of the centre's host separates the agents elsewhere.
    centre = any(run.role(node) in ("broker", "command_center") for node in nodes)
    separated = [agent for agent in agents if (agent in nodes) != centre]
    if not separated:
        return {}
    return {"cut" if str(fault.get("type")) in PARTITIONS else "impaired": separated}


def second(times: Floats, frame: int) -> float:
    """The time of a frame in s; of frames outside the run, that of its first or last."""
    return float(times[min(max(frame, 0), len(times) - 1)]) if len(times) else 0.0


def absences(run: Run) -> list[tuple[str, float, float]]:
    """(node, frame of its loss, frame of its return) of lost nodes."""
    return _periods((each["node"], each["frame"], each["what"] == LOST) for each in run.lost)


def node_absences(run: Run) -> list[tuple[str, float, float]]:
    """(node, first frame without it, frame of its return or inf): stopped, paused, cut off or lost."""
    steps = run.files.record.get("steps") or ()
    return absences(run) + _periods(
        (str(step["node"]), float(step["frame"]), step["action"] not in ("start", "resume", "connect"))
        for step in steps
    )


def _periods(changes: Iterable[tuple[str, float, bool]]) -> list[tuple[str, float, float]]:
    """(node, frame of its first change to True, frame of the next change to False or inf).

    changes: node, frame, and whether it is away from then on
    """
    periods, away_since = [], dict[str, float]()
    for node, frame, away in changes:
        if away:
            away_since.setdefault(node, frame)
        elif node in away_since:
            periods.append((node, away_since.pop(node), float(frame)))
    return [*periods, *((node, start, np.inf) for node, start in away_since.items())]


def states_at(run: Run, frame: int) -> dict[str, str]:
    """The state of each agent in a frame: the one in the latest message up to then."""
    states: dict[str, str] = {}
    if run.files.trust is not None:
        earlier = rows(run.files.trust, run.files.trust["frame"] <= frame)
        states.update(zip(earlier["agent"].tolist(), earlier["state"].tolist(), strict=True))  # sorted by frame
    return states


def withheld_at(run: Run, frame: int) -> Boxes:
    """The objects that the command centre withholds in a frame."""
    table = run.files.trust_objects
    if table is None:
        return Boxes.join(())
    return boxes_of(rows(table, (table["frame"] == frame) & table["withheld"].astype(bool)))


def state_spans(table: Table, state: str, end_s: float) -> Spans:
    """When an agent was in a state.

    table: its rows of the trust table;  end_s: s, of the run
    """
    times = np.append(column(table, "time_s"), end_s)
    return _spans(np.asarray(table["state"] == state), times)


def lie_frames(run: Run, agent: str) -> Ints:
    """(n,) The frames in which adversaries changed what an agent sent, as measured on its wires."""
    changes = run.manipulations
    if changes is None:
        return np.zeros(0, np.int64)
    known = run.estimate_wires
    changed = known.influence.wires.keys() & set(changes["wire"].tolist())
    wires = [wire for wire in sorted(changed) if known.speaker(wire) == agent]
    return np.unique(changes["frame"][np.isin(changes["wire"], wires)]).astype(np.int64)


def lie_spans(run: Run, agent: str) -> Spans:
    """When adversaries changed what an agent sent, as measured on its wires."""
    frames = lie_frames(run, agent)
    if not len(frames):
        return []
    every = np.arange(frames[0], frames[-1] + 2)
    return _spans(np.isin(every[:-1], frames), run.times(every))


def fault_spans(run: Run, agent: str, end_s: float) -> list[tuple[str, float, float]]:
    """Type, beginning and end of the faults of an agent, as planned; end_s: s, of the run."""
    config = run.evaluator_config or {}
    return [
        (str(kind), float(start), end_s if end is None else min(float(end), end_s))
        for kind, start, end in config.get("faults", {}).get(agent, ())
    ]


def suspensions(run: Run) -> list[dict[str, Any]]:
    """All suspensions of a run in the order of their beginnings, each with its agent."""
    return _judgements(run, "suspensions")


def doubts(run: Run) -> list[dict[str, Any]]:
    """All periods in which an agent was undecided, as from `suspensions`; [] for runs of versions without the state."""
    return _judgements(run, "undecided")


def _judgements(run: Run, name: str) -> list[dict[str, Any]]:
    agents = run.files.summary.get("integrity", {}).get("agents", {})
    every = [{"agent": agent, **each} for agent, measured in agents.items() for each in measured.get(name, ())]
    return sorted(every, key=lambda each: (each["from_s"], each["agent"]))


def _spans(active: Bools, times: Floats | Sequence[float]) -> Spans:
    """Periods in which something holds; times: (n + 1,) s, of n rows and of the end."""
    edges = np.diff(active.astype(np.int8), prepend=0, append=0)
    starts, ends = np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist()
    return [(float(times[start]), float(times[end])) for start, end in zip(starts, ends, strict=True)]


def judged_agents(run: Run) -> list[str]:
    """The agents in the trust table, those of the scene first and in its order."""
    if run.files.trust is None:
        return []
    names = set(run.files.trust["agent"].tolist())
    known = list(run.files.scene.agent_names) if run.files.scene else []
    return [name for name in known if name in names] + sorted(names - set(known))


def trust_in_agents(run: Run, names: Sequence[str], value: str = "mean") -> tuple[list[AgentTrustSeries], float]:
    """The trust in every judged agent, and the end of the run, s; [] without trust.

    names: of the states of interest;  value: column of the trust table: mean or log_odds
    """
    if run.files.trust is None or not len(run.files.trust["agent"]):
        return [], 0.0
    end_s = float(column(run.files.trust, "time_s").max()) + run.period_s
    agents = []
    for agent in judged_agents(run):
        table = rows(run.files.trust, run.files.trust["agent"] == agent)
        states = {name: state_spans(table, name, end_s) for name in names}
        times, values = column(table, "time_s"), column(table, value)
        agents.append(
            AgentTrustSeries(agent, times, values, states, lie_spans(run, agent), fault_spans(run, agent, end_s))
        )
    return agents, end_s
