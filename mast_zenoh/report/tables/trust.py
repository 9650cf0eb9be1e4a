"""The report's tables of a command centre's trust: suspensions, and conduct against state."""

from __future__ import annotations

from typing import Any, NamedTuple

from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.trust_facts import suspensions

_NONE = "\u2013"
#: Suspensions that the terminal shows.
_MOST_LINES = 8


class SuspensionRow(NamedTuple):
    """A suspension as the page shows it.

    false_alarm: whether the agent was honest
    """

    agent: str
    from_s: str
    until_s: str
    conduct: str
    after_s: str
    reason: str
    false_alarm: bool


def suspension_rows(run: RunFolder) -> list[SuspensionRow]:
    """All suspensions, with the reason that the command centre gave for each."""
    agents = run.metrics.get("integrity", {}).get("agents", {})
    result, detected = [], set()
    for each in suspensions(run):
        agent = each["agent"]
        delay_s = agents[agent].get("suspended_after_s")
        first = delay_s is not None and agent not in detected and each["from_s"] >= agents[agent]["first_lie_s"]
        detected |= {agent} if first else set()
        result.append(
            SuspensionRow(
                agent,
                f"{each['from_s']:.1f}",
                "end" if each["until_s"] is None else f"{each['until_s']:.1f}",
                each["conduct"],
                f"{delay_s:.1f}" if first else _NONE,
                each["reason"] or _NONE,
                each["conduct"] == "honest",
            )
        )
    return result


def conduct_rows(run: RunFolder) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """States, and for each conduct the seconds of all agents in each state; ([], []) without trust."""
    seconds = run.metrics.get("integrity", {}).get("seconds", {})
    states = list(next(iter(seconds.values()), {}))
    return states, [
        (conduct, [f"{of_state[state]:.1f}" for state in states])
        for conduct, of_state in seconds.items()
        if any(of_state.values())
    ]


def trust_sentences(run: RunFolder) -> list[str]:
    """The result in sentences: who was never suspended, false alarms, and withheld objects."""
    part: dict[str, Any] = run.metrics.get("integrity", {})
    if not part:
        return []
    missed = [
        f"{name} was never suspended in the {agent['observed_s']:.1f} s after its first lie"
        for name, agent in part["agents"].items()
        if agent["lied"] and agent["suspended_after_s"] is None
    ]
    honest = part["honest_suspended"]
    times = "once" if part["false_alarms"] == 1 else f"{part['false_alarms']} times"
    alarms = f"Honest agents were suspended {times}: {', '.join(honest)}" if honest else ""
    withheld = part.get("withheld", {})
    objects = (
        f"Withheld from the picture, per frame: {withheld['false']:.2f} false and {withheld['true']:.2f} true objects"
    )
    return [*missed, alarms or "No honest agent was suspended", *([objects] if withheld else [])]


def suspension_lines(run: RunFolder) -> list[str]:
    """Which agents the command centre suspended, when and why, a line each."""
    lines = [
        f"the command centre suspended {row.agent} ({row.conduct}) at {row.from_s} s"
        + (f", {row.after_s} s after its first lie" if row.after_s != _NONE else "")
        + (f": {row.reason}" if row.reason != _NONE else "")
        for row in suspension_rows(run)
    ]
    more = f"  and {len(lines) - _MOST_LINES} suspensions more, see the report"
    return [*lines[:_MOST_LINES], more] if len(lines) > _MOST_LINES else lines
