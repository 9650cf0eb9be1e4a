"""What the report shows of a command centre's trust: states, withheld objects, and when agents lied or were faulty."""

from __future__ import annotations

from collections.abc import Sequence

from mast_zenoh.metrics.study_results import AgentTrustSeries
from mast_zenoh.viewer.events import fault_spans, lie_spans, state_spans
from mast_zenoh.viewer.run import RunRecord, column, rows


def judged_agents(run: RunRecord) -> list[str]:
    """The agents in the trust table, those of the scene first and in its order."""
    if run.trust is None:
        return []
    names = set(run.trust["agent"].tolist())
    known = list(run.recording.agent_names) if run.recording else []
    return [name for name in known if name in names] + sorted(names - set(known))


def trust_in_agents(run: RunRecord, names: Sequence[str], value: str = "mean") -> tuple[list[AgentTrustSeries], float]:
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
