"""What was done to a run: manipulations, the state of every agent in every frame, attacks and faults over time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Floats
from mast_zenoh.report.figures.style import STATES
from mast_zenoh.report.figures.timeaxis import absences
from mast_zenoh.report.figures.view import downlinks
from mast_zenoh.report.files import column, rows
from mast_zenoh.report.playback.columns import Packer
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.trust_facts import lie_spans, suspensions

#: Manipulations that have a place, by the number that stands for them.
EFFECTS = ("inserted", "removed", "moved")
#: Faults that separate agents from the command centre.
PARTITIONS = ("Partition", "HostPartition")
#: Flags of an agent in a frame, above its state (0: not judged, else 1 + the row of STATES).
DOWN, LYING = 8, 16


def add_manipulations(packer: Packer, run: RunFolder) -> dict[str, Any]:
    """Add the columns `effects.*`: a row per object that an adversary inserted, removed or moved in a message."""
    table = run.attacks if run.attacks is not None else {}
    placed = rows(table, np.isin(table["effect"], EFFECTS)) if table else {}
    if placed:
        order = np.lexsort((placed["frame"], placed["interposer"]))
        placed = {name: values[order] for name, values in placed.items()}
    downlink, subscriber = downlinks(placed) if placed else (np.zeros(0, bool), np.zeros(0, str))
    adversaries = _distinct(placed.get("interposer", np.zeros(0, str)))
    subscribers = _distinct(subscriber)
    numbers: dict[str, NDArray[Any]] = {
        "frame": placed.get("frame", np.zeros(0)),
        "effect": np.array([EFFECTS.index(each) for each in placed.get("effect", ())]),
        "by": np.array([adversaries.index(each) for each in placed.get("interposer", ())]),
        "downlink": downlink,
        "subscriber": np.array([subscribers.index(each) for each in subscriber]),
    }
    for name, values in numbers.items():
        packer.add(f"effects.{name}", values)
    for name in ("before_x", "before_y", "before_z", "after_x", "after_y", "after_z"):
        packer.add(f"effects.{name}", np.nan_to_num(column(placed, name)) if placed else np.zeros(0), scale=0.01)
    return {"effects": EFFECTS, "adversaries": adversaries, "subscribers": subscribers}


def add_withheld(packer: Packer, run: RunFolder) -> None:
    """Add the columns `withheld.*`: the objects that the command centre withholds."""
    table = run.trust_objects
    withheld = rows(table, table["withheld"].astype(bool)) if table is not None else None
    if withheld is not None:
        order = np.lexsort((withheld["frame"], withheld["id"]))
        withheld = {name: values[order] for name, values in withheld.items()}
    for name in ("frame", "id", "x", "y", "z", "l", "w", "h", "yaw"):
        scale = 1.0 if name in ("frame", "id") else 0.002 if name == "yaw" else 0.01
        packer.add(f"withheld.{name}", column(withheld, name) if withheld is not None else np.zeros(0), scale=scale)


def add_agent_states(packer: Packer, run: RunFolder, names: list[str], times: Floats) -> dict[str, Any]:
    """Add the states of agents and `trust`, a row per agent and frame.

    times: (f,) s, of the frames
    """
    frames = len(times)
    state, trust = np.zeros((len(names), frames), np.int64), np.full((len(names), frames), -1.0)
    if run.trust is not None:
        judged = run.trust
        for row, name in enumerate(names):
            own = rows(judged, judged["agent"] == name)
            place = np.searchsorted(own["frame"], np.arange(frames), side="right") - 1
            if len(own["frame"]):
                numbers = np.array([1 + list(STATES).index(each) for each in own["state"].tolist()])
                state[row] = np.where(place >= 0, numbers[place], 0)
                trust[row] = np.where(place >= 0, column(own, "mean")[place], -1.0)
    for name, start, end in node_absences(run):
        if name in names:
            state[names.index(name), int(start) : int(min(end, frames))] += DOWN
    for row, name in enumerate(names):
        for start, end in lie_spans(run, name):
            state[row, (times >= start - 1e-9) & (times < end - 1e-9)] += LYING
    packer.add("agents.state", state)
    packer.add("trust", trust, scale=0.001)
    return {"states": list(STATES), "flags": {"down": DOWN, "lying": LYING}, "judged": run.trust is not None}


def node_absences(run: RunFolder) -> list[tuple[str, float, float]]:
    """(node, first frame without it, frame of its return or inf): stopped, paused, cut off or lost."""
    result, down_since = absences(run), dict[str, float]()
    for step in run.run.get("steps") or ():
        node, frame = str(step["node"]), float(step["frame"])
        if step["action"] not in ("start", "resume", "connect"):
            down_since.setdefault(node, frame)
        elif node in down_since:
            result.append((node, down_since.pop(node), frame))
    return [*result, *((node, since, float("inf")) for node, since in down_since.items())]


def spans(run: RunFolder, times: Floats) -> list[dict[str, Any]]:
    """Attacks, faults, interceptions and suspensions as periods.

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
        words = f"{label} begins", f"{label} {'ends' if kind == 'attack' else 'heals'}"
        add(label, kind, float(each["at_s"]), each.get("until_s"), each.get("nodes") or (), *words)
        if result[before:] and kind == "fault":
            result[-1] |= _affected_links(run, each)
    for node, start, until in absences(run):
        add(f"{node} lost", "fault", start * run.period_s, until * run.period_s, [node])
    opened: dict[str, dict[str, Any]] = {}
    for event in run.run.get("interceptions", ()):
        at, node = second(times, int(event["frame"])), event["node"]
        wires = ", ".join(event["wires"])
        if event["action"] == "intercept":
            words = f"{node} inserted on {wires}", f"{node} removed from {wires}"
            add(f"{node} inserted live", "interception", at, None, [node], *words)
            opened[node] = result[-1]
        elif node in opened:
            verb = "released" if event["action"] == "release" else "cut off"
            opened.pop(node).update(until_s=round(at, 3), ends=f"{node} {verb} from {wires}")
    for each in suspensions(run):
        agent, period = each["agent"], (float(each["from_s"]), each["until_s"])
        words = f"the command centre suspends {agent}", f"the suspension of {agent} is lifted"
        add(f"{agent} suspended", "suspension", *period, [agent], *words)
    return sorted(result, key=lambda each: (each["from_s"], each["label"]))


def _affected_links(run: RunFolder, fault: dict[str, Any]) -> dict[str, list[str]]:
    """The agents whose link to the command centre a fault cuts or impairs; {}: none, or a fault of processes."""
    if fault.get("backend") not in ("links", "network"):
        return {}
    agents = list(run.recording.agent_names) if run.recording else list(run.metrics.get("agents", ()))
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


def _distinct(values: NDArray[Any]) -> list[str]:
    return sorted({str(each) for each in values.tolist()})
