"""The trust of a trial over time: kept with its metrics, and chosen for the figure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.metrics.study_results import AgentTrustSeries, Spans, TrustPanel
from mast_zenoh.report.trust_facts import trust_in_agents
from mast_zenoh.viewer.run import RunRecord

#: States that the figure shows.
_DRAWN_STATES = ("faulty", "suspended")
#: s, from one kept value of the log-odds to the next. Spans are exact.
_STEP_S = 0.2
#: Agents in a panel.
MAX_AGENTS = 5


def trace(folder: Path) -> dict[str, Any] | None:
    """The trust in each agent of a run, as JSON values; None: nobody is judged."""
    agents, end_s = trust_in_agents(RunRecord.load(folder), _DRAWN_STATES, "log_odds")
    if not agents:
        return None
    return {"end_s": round(end_s, 6), "agents": {agent.agent: _agent_trace(agent) for agent in agents}}


def panel(content: Mapping[str, Any], title: str) -> TrustPanel:
    """The panel of a trace; of many agents, those that lied, were faulty or were judged to be so come first."""
    agents = [_agent_series(name, each) for name, each in content["agents"].items()]
    uneventful = [not (agent.lies or agent.faults or any(agent.states.values())) for agent in agents]
    chosen = sorted(np.argsort(uneventful, kind="stable")[:MAX_AGENTS].tolist())
    return TrustPanel(title, [agents[index] for index in chosen], len(agents) - len(chosen), content["end_s"])


def suspends(content: Mapping[str, Any]) -> bool:
    """Whether a trace has a suspension."""
    return any(agent["states"]["suspended"] for agent in content["agents"].values())


def _agent_trace(agent: AgentTrustSeries) -> dict[str, Any]:
    period_s = float(np.diff(agent.time_s).min(initial=_STEP_S))
    every = max(1, round(_STEP_S / period_s)) if period_s > 0.0 else 1
    values = [None if math.isnan(value) else round(value, 2) for value in agent.value[::every].tolist()]
    return {
        "time_s": np.round(agent.time_s[::every], 3).tolist(),
        "log_odds": values,
        "states": {state: _round_spans(spans) for state, spans in agent.states.items()},
        "lies": _round_spans(agent.lies),
        "faults": [[kind, *span] for (kind, *times) in agent.faults for span in _round_spans([(times[0], times[1])])],
    }


def _agent_series(name: str, content: Mapping[str, Any]) -> AgentTrustSeries:
    return AgentTrustSeries(
        name,
        np.array(content["time_s"], np.float64),
        np.array([math.nan if value is None else value for value in content["log_odds"]], np.float64),
        {state: [(start, stop) for start, stop in spans] for state, spans in content["states"].items()},
        [(start, stop) for start, stop in content["lies"]],
        [(kind, start, stop) for kind, start, stop in content["faults"]],
    )


def _round_spans(spans: Spans) -> list[list[float]]:
    return [[round(start, 3), round(stop, 3)] for start, stop in spans]
