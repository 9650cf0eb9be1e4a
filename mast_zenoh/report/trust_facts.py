"""What the report shows of a command centre's trust: states, withheld objects, and when agents lied or were faulty."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.evaluation.trust import UPSTREAM
from mast_zenoh.metrics.study_results import AgentTrustSeries, Spans
from mast_zenoh.report.files import Table, column, rows
from mast_zenoh.report.runfolder import RunFolder, agent_of


def judged_agents(run: RunFolder) -> list[str]:
    """The agents in the trust table, those of the scene first and in its order."""
    if run.trust is None:
        return []
    names = set(run.trust["agent"].tolist())
    known = list(run.recording.agent_names) if run.recording else []
    return [name for name in known if name in names] + sorted(names - set(known))


def states_at(run: RunFolder, frame: int) -> dict[str, str]:
    """The state of each agent in a frame: the one in the latest message up to then."""
    states: dict[str, str] = {}
    if run.trust is not None:
        earlier = rows(run.trust, run.trust["frame"] <= frame)
        states.update(zip(earlier["agent"].tolist(), earlier["state"].tolist(), strict=True))  # sorted by frame
    return states


def withheld_at(run: RunFolder, frame: int) -> tuple[Floats, Floats, Floats]:
    """Positions (n, 3) m, sizes (n, 3) m and yaws (n,) rad of the objects withheld in a frame."""
    table = run.trust_objects
    if table is None:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    here = rows(table, (table["frame"] == frame) & table["withheld"].astype(bool))
    position, size = (np.column_stack([column(here, name) for name in names]) for names in ("xyz", "lwh"))
    return position, size, column(here, "yaw")


def trust_in_agents(run: RunFolder, names: Sequence[str], value: str = "mean") -> tuple[list[AgentTrustSeries], float]:
    """The trust in every judged agent, and the end of the run, s; [] without trust.

    names: of the states of interest;  value: column of the trust table: mean or log_odds
    """
    if run.trust is None or not len(run.trust["agent"]):
        return [], 0.0
    end_s = float(column(run.trust, "time_s").max()) + run.period_s
    agents = []
    for agent in judged_agents(run):
        table = rows(run.trust, run.trust["agent"] == agent)
        states = {name: state_spans(table, name, end_s) for name in names}
        times, values = column(table, "time_s"), column(table, value)
        agents.append(
            AgentTrustSeries(agent, times, values, states, lie_spans(run, agent), fault_spans(run, agent, end_s))
        )
    return agents, end_s


def state_spans(table: Table, state: str, end_s: float) -> Spans:
    """When an agent was in a state.

    table: its rows of the trust table;  end_s: s, of the run
    """
    times = np.append(column(table, "time_s"), end_s)
    return _spans(np.asarray(table["state"] == state), times)


def lie_spans(run: RunFolder, agent: str) -> Spans:
    """When adversaries changed what an agent sent, as measured on its wires."""
    changes = run.attacks
    if changes is None or "wire" not in changes:
        return []
    wires = [
        wire
        for wire in np.unique(changes["wire"]).tolist()
        if agent_of(wire) == agent and wire.rpartition("/")[2] in UPSTREAM
    ]
    frames = np.unique(changes["frame"][np.isin(changes["wire"], wires)]).astype(np.int64)
    if not len(frames):
        return []
    every = np.arange(frames[0], frames[-1] + 2)
    seconds = run.seconds(every)
    times = every * run.period_s if seconds is None else seconds
    return _spans(np.isin(every[:-1], frames), times)


def fault_spans(run: RunFolder, agent: str, end_s: float) -> list[tuple[str, float, float]]:
    """Type, beginning and end of the faults of an agent, as planned; end_s: s, of the run."""
    config = run.evaluator_config or {}
    return [
        (str(kind), float(start), end_s if end is None else min(float(end), end_s))
        for kind, start, end in config.get("faults", {}).get(agent, ())
    ]


def suspensions(run: RunFolder) -> list[dict[str, Any]]:
    """All suspensions of a run in the order of their beginnings, each with its agent; see docs/metrics.md."""
    agents = run.metrics.get("integrity", {}).get("agents", {})
    every = [{"agent": name, **each} for name, agent in agents.items() for each in agent["suspensions"]]
    return sorted(every, key=lambda each: (each["from_s"], each["agent"]))


def _spans(active: Bools, times: Floats | Sequence[float]) -> Spans:
    """Periods in which something holds; times: (n + 1,) s, of n rows and of the end."""
    edges = np.diff(active.astype(np.int8), prepend=0, append=0)
    starts, ends = np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist()
    return [(float(times[start]), float(times[end])) for start, end in zip(starts, ends, strict=True)]
